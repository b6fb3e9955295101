// What the files of Python bindings share.
#pragma once

#include <string>
#include <tuple>

#include "arrays.hpp"
#include "raster/raster.hpp"

namespace gsyn {

// The kernels of a variant, the fastest if the name is empty; a ValueError if it cannot run here.
const Kernels &kernels_or_throw(const std::string &variant);

using Intrinsics = std::tuple<float, float, float, float>;
using Dilations = std::tuple<float, float>;  // own, all
View make_view(const ReadArray &w2c, const Intrinsics &intrinsics, int64_t width, int64_t height);

// Rows of the tables of `count` anchors, ascending, or a ValueError.
const int64_t *checked_rows(const ReadArray &rows, int64_t visible, int64_t count);

void bind_training(nb::module_ &m);
void bind_heads(nb::module_ &m);

}  // namespace gsyn
