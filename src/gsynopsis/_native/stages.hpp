// The stages of one variant; kernels.cpp puts them into its table.
#pragma once

#include "raster.hpp"

namespace gsyn {
namespace GSYN_VARIANT {

void project(const Cloud &, const Scene &, Chunk &);
void blend(const Scene &, int tile, uint64_t *keys, const Images &);
void blend_backward(const Scene &, int tile, const ImageGradients &);
void project_backward(const Cloud &, const Scene &, const Chunk &, const CloudGradients &);
void hashgrid_forward(const HashGrid &, const float *points, int64_t begin, int64_t end,
                      const float *tables, float *out);
void hashgrid_backward(const HashGrid &, const float *points, int64_t count, int level,
                       const float *grad_out, float *grad_tables);

}  // namespace GSYN_VARIANT
}  // namespace gsyn
