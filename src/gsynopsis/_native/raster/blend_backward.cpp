// The gradient of blending one tile: a second walk front to back over the blocks noted by blend.
//
// With w = T alpha, g the gradient of a pixel's colour and D what the colour still owes behind
// this splat (the sum of later w (colour · g), background included), the gradient of ln alpha is
// s = w (colour · g) − D alpha / (1 − alpha). D starts as image · g, so nothing is divided by T.
#include "raster/blocks.hpp"
#include "stages.hpp"

namespace gsyn {
namespace GSYN_VARIANT {
namespace {

// One vector of pixels. Kept together: five arrays of 4 KiB each would share their cache sets.
struct Pixels {
    Floats transmittance;  // negative once the pixel has ended
    Floats red, green, blue;  // of the gradient
    Floats owed;
};

struct BackwardCanvas {
    Pixels pixels[BLOCKS][PARTS];
};

void read_block(const Scene &scene, const ImageGradients &in, int x0, int y0, int block,
                BackwardCanvas &canvas) {
    alignas(64) float transmittance[BLOCK_PIXELS], channels[3][BLOCK_PIXELS], owed[BLOCK_PIXELS];
    const int width = scene.view.width, height = scene.view.height;
    for (int i = 0; i < BLOCK_PIXELS; i++) {
        const int x = x0 + i % BLOCK, y = y0 + i / BLOCK;
        const bool inside = x < width && y < height;
        const int64_t at = inside ? 3 * ((int64_t)y * width + x) : 0;
        transmittance[i] = inside ? 1.f : -1.f;
        owed[i] = 0.f;
        for (int c = 0; c < 3; c++) {
            channels[c][i] = inside ? in.grad_image[at + c] : 0.f;
            owed[i] += inside ? in.grad_image[at + c] * in.image[at + c] : 0.f;
        }
    }
    for (int part = 0; part < PARTS; part++) {
        const int at = part * LANES;
        canvas.pixels[block][part] = Pixels{load(transmittance + at), load(channels[0] + at),
                                            load(channels[1] + at), load(channels[2] + at),
                                            load(owed + at)};
    }
}

// Alphas from here on are taken to be capped, and have no gradient.
constexpr float CAPPED = 0.99f * (1.f - 4e-6f);

// Writes the pair's row of partial sums.
void splat_backward(BackwardCanvas &canvas, const Splat &s, const PixelCentres &from_splat,
                    uint64_t mask, float *row) {
    Floats alphas[BLOCKS * PARTS];
    alphas_of(s, from_splat, mask, alphas);
    const Floats *next = alphas;
    Floats sums[PARTIAL_SUMS] = {};
    for (uint64_t todo = mask; todo; todo &= todo - 1) {
        const int block = __builtin_ctzll(todo);
        const Offsets at = offsets_of(from_splat, block);
        for (int part = 0; part < PARTS; part++) {
            const Floats alpha = *next++, dx = at.dx, dy = at.dy[part];
            Pixels &p = canvas.pixels[block][part];
            Mask seen = both(less(Floats{}, alpha), less(Floats{}, p.transmittance));
            // Worth a mispredicted branch only where a vector is a quarter of a block.
            if (PARTS > 2 && !any(seen)) continue;
            const Mask open = less(alpha, all(CAPPED));
            const Floats weight = pass_splat(p.transmittance, alpha, seen);
            const Floats paid = weight * (p.red * s.red + p.green * s.green + p.blue * s.blue);
            const Floats owed = p.owed - paid;
            p.owed = owed;
            const Floats slope = kept(both(seen, open), paid - owed * alpha * reciprocal(1.f - alpha));
            const Floats slope_x = slope * dx, slope_y = slope * dy;
            sums[0] += slope;
            sums[1] += slope_x;
            sums[2] += slope_y;
            sums[3] += slope_x * dx;
            sums[4] += slope_x * dy;
            sums[5] += slope_y * dy;
            sums[6] += weight * p.red;
            sums[7] += weight * p.green;
            sums[8] += weight * p.blue;
        }
    }
    store_sums(row, sums);
    row[8] = sum_of(sums[8]);
}

}  // namespace

void blend_backward(const Scene &scene, int tile, const ImageGradients &in) {
    const uint32_t start = scene.tile_starts[tile], end = scene.tile_starts[tile + 1];
    const int left = TILE * (tile % scene.tiles_x), top = TILE * (tile / scene.tiles_x);
    BackwardCanvas canvas;
    for (int block = 0; block < BLOCKS; block++) {
        read_block(scene, in, left + BLOCK * (block % TILE_BLOCKS),
                   top + BLOCK * (block / TILE_BLOCKS), block, canvas);
    }
    const PixelCentres centres = pixel_centres();
    for (uint32_t i = start; i < end; i++) {
        if (i + 8 < end) {
            const Entry soon = scene.entries[i + 8];
            __builtin_prefetch(scene.splats + soon.gaussian);
            __builtin_prefetch(scene.partials + (int64_t)soon.slot * PARTIAL_STRIDE, 1);
        }
        const Entry entry = scene.entries[i];
        float *row = scene.partials + (int64_t)entry.slot * PARTIAL_STRIDE;
        if (scene.block_masks[i] == 0) {
            memset(row, 0, PARTIAL_SUMS * sizeof *row);
            continue;
        }
        const Splat &splat = scene.splats[entry.gaussian];
        splat_backward(canvas, splat, centres_from(splat, centres, left, top), scene.block_masks[i],
                       row);
    }
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
