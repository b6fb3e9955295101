// What the files of Python bindings share.
#pragma once

#include <string>

#include "arrays.hpp"
#include "raster.hpp"

namespace gsyn {

// The kernels of a variant, the fastest if the name is empty; a ValueError if it cannot run here.
const Kernels &kernels_or_throw(const std::string &variant);

void bind_training(nb::module_ &m);
void bind_heads(nb::module_ &m);

}  // namespace gsyn
