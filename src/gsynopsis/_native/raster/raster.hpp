// What the stages of the rasteriser pass to each other; plain data, the same for every variant.
//
// The stages (frame.cpp drives them):
//   project    a chunk of Gaussians -> splats, and the list of tiles that each touches
//   scatter    chunks -> per tile the list of its (depth, Gaussian) pairs, in input order
//   blend      a tile: sort its list by depth, blend front to back, note which blocks were touched
//   blend_backward    a tile: walk forward again; one row of partial sums per pair
//   project_backward  a chunk of Gaussians: add its rows in a fixed order, then the chain rule
//   blend_removal     a tile: walk forward again; the squared change without each pair's Gaussian
// No two threads write the same place and no sum depends on who ran what, so images and gradients
// are the same bits for any number of threads.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

#include "decode/heads.hpp"
#include "training/training.hpp"

namespace gsyn {

constexpr int BLOCK = 4;                   // a block is 4 × 4 pixels: one vector with AVX-512
constexpr int BLOCK_PIXELS = BLOCK * BLOCK;
constexpr int TILE_BLOCKS = 8;             // a tile is 8 × 8 blocks: one bit each in a 64-bit mask
constexpr int TILE = BLOCK * TILE_BLOCKS;  // 32 pixels
constexpr int BLOCKS = TILE_BLOCKS * TILE_BLOCKS;

// The constants of gsynopsis.render.base.
constexpr float NEAR_PLANE = 0.01f;
constexpr float LOG_ALPHA_MAX = -0.01449956969511509f;  // log2 0.99
constexpr float LOG_ALPHA_MIN = -7.994353436858858f;    // log2 (1/255)
constexpr float TRANSMITTANCE_MIN = 1e-4f;
constexpr float FOV_CLAMP = 1.3f;

struct View {
    float rotation[9];  // world to camera, row by row
    float translation[3];
    float fx, fy, cx, cy;  // pixels
    int width, height;
    float own, dilation;  // px² on the diagonal of covariances: a Gaussian's own, and all of it
};

// G Gaussians; arrays of structures, float32, contiguous.
struct Cloud {
    int64_t count;
    const float *means;      // [G, 3]
    const float *quats;      // [G, 4] w x y z, any length
    const float *scales;     // [G, 3]
    const float *opacities;  // [G]
    const float *colors;     // [G, 3]; not needed backward
};

struct CloudGradients {
    float *means, *quats, *scales, *opacities, *colors;
    float *screen;  // [G, 2] of the projected centre, 1/pixels
};

// A projected Gaussian, one cache line. The binary logarithm of alpha at (dx, dy) from the centre
// is log_opacity + xx dx² + xy dx dy + yy dy².
struct alignas(64) Splat {
    float x, y;
    float xx, xy, yy;
    float log_opacity;
    float red, green, blue;
    // Where alpha >= 1/255: the ellipse |dx| <= half_width, |dy| <= half_height, and at a height
    // dy: slope dy ± bulge √(half_height² − dy²). It is widest to the right at dy = tip.
    float half_width, half_height, slope, bulge, tip;
    float depth;
};

// A Gaussian in a tile's list: where it is, and the pair's own place in the order of input.
struct Entry {
    uint32_t gaussian;
    uint32_t slot;
};

// A row of sums over the pixels of a pair: ln alpha's gradient s as Σ s, Σ s dx, Σ s dy, Σ s dx²,
// Σ s dx dy, Σ s dy², then the gradient of the three colours.
constexpr int PARTIAL_SUMS = 9;
constexpr int PARTIAL_STRIDE = 16;  // one cache line

// The tiles that the Gaussians of a chunk touch, Gaussian by Gaussian; the scatter replaces each
// tile by the slot of the pair.
struct TileList {
    uint32_t *items = nullptr;
    size_t size = 0, capacity = 0;
    bool failed = false;  // no memory; the frame reports it
};

// Makes room for `extra` more items. False if there is no memory.
bool grow(TileList &list, size_t extra);

struct Chunk {
    int64_t begin, end;     // Gaussians
    TileList tiles;
    uint32_t *tile_counts;  // [tiles] of the frame; after the prefix sum: the next free slot
};

// A frame as the kernels see it.
struct Scene {
    View view;
    int tiles_x, tiles_y;
    float background[3];
    int64_t pairs_max;               // listing ends where there are more
    std::atomic<int64_t> *listed;    // pairs so far, of all chunks
    Splat *splats;            // [G], written where visible
    uint32_t *touched;        // [G] number of tiles, 0 where culled
    uint64_t *pairs;          // [P] depth bits above, Gaussian below
    Entry *entries;           // [P] each tile's list by depth
    uint64_t *block_masks;    // [P] beside entries: the blocks a pair was blended into
    float *partials;          // [P, PARTIAL_STRIDE]; of removals [P]
    const uint32_t *tile_starts;  // [tiles + 1]
};

struct Images {
    float *image;  // [H, W, 3]
    float *alpha;  // [H, W]
};

struct ImageGradients {
    const float *image;       // [H, W, 3] as blended
    const float *grad_image;  // [H, W, 3]
};

// One level-by-level hash grid; rows of `features` floats, level l has rows offsets[l] up.
struct HashGrid {
    int levels, features;
    int64_t stride;  // floats from one point's features, or their gradients, to the next point's
    const int64_t *resolutions, *offsets, *sizes;  // [L]
};

// The hot functions of one instruction set.
struct Kernels {
    void (*project)(const Cloud &, const Scene &, Chunk &);
    // `keys` has room for twice the pairs of the tile.
    void (*blend)(const Scene &, int tile, uint64_t *keys, const Images &);
    void (*blend_backward)(const Scene &, int tile, const ImageGradients &);
    // `image` is [H, W, 3] as blended.
    void (*blend_removal)(const Scene &, int tile, const float *image);
    void (*project_backward)(const Cloud &, const Scene &, const Chunk &, const CloudGradients &);
    void (*hashgrid_forward)(const HashGrid &, const float *points, int64_t begin, int64_t end,
                             const float *tables, float *out);
    void (*hashgrid_backward)(const HashGrid &, const float *points, int64_t count, int level,
                              const float *grad_out, float *grad_tables);
    // 1 or 0 for anchors begin to end: could touch the image.
    void (*cull)(const Anchors &, const View &, int64_t begin, int64_t end, uint8_t *seen);
    // tanh of the opacities of anchors begin to end, and how many slots of each are drawn.
    void (*activate)(const Slots &, int64_t begin, int64_t end, float *activated, int64_t *counts);
    void (*assemble)(const Slots &, const Drawn &, int64_t begin, int64_t end, const DrawnOut &);
    void (*assemble_backward)(const Slots &, const Drawn &, int64_t begin, int64_t end,
                              const DrawnGradients &, const SlotGradients &);
    // A patch of the loss and, where there is room for it, of its gradient; `memory` has LOSS_ROOM.
    LossSums (*loss_patch)(const LossImages &, const LossPatch &, float *memory);
    // One step of Adam on a stretch of a tensor.
    void (*adam)(const Moved &, float epsilon);
    // The column of the largest of the logits at each of rows begin to end, the first of equal ones.
    void (*choose)(const float *logits, const int64_t *rows, int64_t begin, int64_t end,
                   int entries, int64_t *codes);
    // Rows begin to end of the heads; `scratch` has room for `heads_scratch` floats.
    void (*heads_forward)(const PackedHeads &, const HeadRows &, int64_t begin, int64_t end,
                          float *scratch);
    void (*heads_backward)(const PackedHeads &, const HeadRows &, const HeadGradients &,
                           int64_t begin, int64_t end, const HeadShare &, float *scratch);
};

namespace baseline { extern const Kernels kernels; }
namespace avx2 { extern const Kernels kernels; }
namespace avx512 { extern const Kernels kernels; }

}  // namespace gsyn
