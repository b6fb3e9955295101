// The squared change of one tile's image if a splat were left out: a second walk front to back over
// the blocks noted by blend.
//
// With w = T alpha and D what the colour still owes behind this splat (the sum of later w colour,
// background included), the image without it has D / (1 − alpha) in place of w colour + D. So it
// changes by w colour − D alpha / (1 − alpha), but for pixels that had ended and would go on.
#include "raster/blocks.hpp"
#include "stages.hpp"

namespace gsyn {
namespace GSYN_VARIANT {
namespace {

// One vector of pixels.
struct Pixels {
    Floats transmittance;  // negative once the pixel has ended
    Floats red, green, blue;  // owed
};

struct RemovalCanvas {
    Pixels pixels[BLOCKS][PARTS];
};

void read_block(const Scene &scene, const float *image, int x0, int y0, int block,
                RemovalCanvas &canvas) {
    alignas(64) float transmittance[BLOCK_PIXELS], channels[3][BLOCK_PIXELS];
    const int width = scene.view.width, height = scene.view.height;
    for (int i = 0; i < BLOCK_PIXELS; i++) {
        const int x = x0 + i % BLOCK, y = y0 + i / BLOCK;
        const bool inside = x < width && y < height;
        const int64_t at = inside ? 3 * ((int64_t)y * width + x) : 0;
        transmittance[i] = inside ? 1.f : -1.f;
        for (int c = 0; c < 3; c++) channels[c][i] = inside ? image[at + c] : 0.f;
    }
    for (int part = 0; part < PARTS; part++) {
        const int at = part * LANES;
        canvas.pixels[block][part] = Pixels{load(transmittance + at), load(channels[0] + at),
                                            load(channels[1] + at), load(channels[2] + at)};
    }
}

// The pair's sum over its pixels and channels.
float splat_removal(RemovalCanvas &canvas, const Splat &s, const PixelCentres &from_splat,
                    uint64_t mask) {
    Floats alphas[BLOCKS * PARTS];
    alphas_of(s, from_splat, mask, alphas);
    const Floats *next = alphas;
    Floats sum{};
    for (uint64_t todo = mask; todo; todo &= todo - 1) {
        const int block = __builtin_ctzll(todo);
        for (int part = 0; part < PARTS; part++) {
            const Floats alpha = *next++;
            Pixels &p = canvas.pixels[block][part];
            Mask seen = both(less(Floats{}, alpha), less(Floats{}, p.transmittance));
            // Worth a mispredicted branch only where a vector is a quarter of a block.
            if (PARTS > 2 && !any(seen)) continue;
            const Floats weight = pass_splat(p.transmittance, alpha, seen);
            const Floats shown_more = kept(seen, alpha * reciprocal(1.f - alpha));
            const auto change = [&](Floats &owed, float color) {
                const Floats paid = weight * color;
                owed -= paid;
                return paid - owed * shown_more;
            };
            const Floats red = change(p.red, s.red), green = change(p.green, s.green);
            const Floats blue = change(p.blue, s.blue);
            sum += red * red + green * green + blue * blue;
        }
    }
    return sum_of(sum);
}

}  // namespace

void blend_removal(const Scene &scene, int tile, const float *image) {
    const uint32_t start = scene.tile_starts[tile], end = scene.tile_starts[tile + 1];
    const int left = TILE * (tile % scene.tiles_x), top = TILE * (tile / scene.tiles_x);
    RemovalCanvas canvas;
    for (int block = 0; block < BLOCKS; block++) {
        read_block(scene, image, left + BLOCK * (block % TILE_BLOCKS),
                   top + BLOCK * (block / TILE_BLOCKS), block, canvas);
    }
    const PixelCentres centres = pixel_centres();
    for (uint32_t i = start; i < end; i++) {
        if (i + 8 < end) __builtin_prefetch(scene.splats + scene.entries[i + 8].gaussian);
        const Entry entry = scene.entries[i];
        const Splat &splat = scene.splats[entry.gaussian];
        const uint64_t mask = scene.block_masks[i];
        scene.partials[entry.slot] =
            mask ? splat_removal(canvas, splat, centres_from(splat, centres, left, top), mask) : 0.f;
    }
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
