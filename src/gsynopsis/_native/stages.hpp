// The stages of one variant; kernels.cpp puts them into its table.
#pragma once

#include "raster/raster.hpp"

namespace gsyn {
namespace GSYN_VARIANT {

void project(const Cloud &, const Scene &, Chunk &);
void blend(const Scene &, int tile, uint64_t *keys, const Images &);
void blend_backward(const Scene &, int tile, const ImageGradients &);
void blend_removal(const Scene &, int tile, const float *image);
void project_backward(const Cloud &, const Scene &, const Chunk &, const CloudGradients &);
void hashgrid_forward(const HashGrid &, const float *points, int64_t begin, int64_t end,
                      const float *tables, float *out);
void hashgrid_backward(const HashGrid &, const float *points, int64_t count, int level,
                       const float *grad_out, float *grad_tables);
void cull(const Anchors &, const View &, int64_t begin, int64_t end, uint8_t *seen);
void activate(const Slots &, int64_t begin, int64_t end, float *activated, int64_t *counts);
void assemble(const Slots &, const Drawn &, int64_t begin, int64_t end, const DrawnOut &);
void assemble_backward(const Slots &, const Drawn &, int64_t begin, int64_t end,
                       const DrawnGradients &, const SlotGradients &);
LossSums loss_patch(const LossImages &, const LossPatch &, float *memory);
void adam(const Moved &, float epsilon);
void choose(const float *logits, const int64_t *rows, int64_t begin, int64_t end, int entries,
            int64_t *codes);
void heads_forward(const PackedHeads &, const HeadRows &, int64_t begin, int64_t end,
                   float *scratch);
void heads_backward(const PackedHeads &, const HeadRows &, const HeadGradients &, int64_t begin,
                    int64_t end, const HeadShare &, float *scratch);

}  // namespace GSYN_VARIANT
}  // namespace gsyn
