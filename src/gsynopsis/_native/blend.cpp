// Front to back blending of one tile, after sorting its list by depth.
#include "blocks.hpp"
#include "stages.hpp"

namespace gsyn {
namespace GSYN_VARIANT {
namespace {

constexpr int DIGIT_BITS = 9, DIGITS = 1 << DIGIT_BITS;

// Stable sort by the upper 32 bits, whose spread is `bits` bits wide. Gives the sorted half.
uint64_t *radix_sort(uint64_t *keys, uint64_t *spare, uint32_t count, int bits) {
    for (int shift = 0; shift < bits; shift += DIGIT_BITS) {
        uint32_t place[DIGITS];
        memset(place, 0, sizeof place);
        for (uint32_t i = 0; i < count; i++) place[(keys[i] >> (32 + shift)) & (DIGITS - 1)]++;
        uint32_t sum = 0;
        for (int digit = 0; digit < DIGITS; digit++) {
            const uint32_t here = place[digit];
            place[digit] = sum;
            sum += here;
        }
        for (uint32_t i = 0; i < count; i++) {
            spare[place[(keys[i] >> (32 + shift)) & (DIGITS - 1)]++] = keys[i];
        }
        uint64_t *swap = keys;
        keys = spare;
        spare = swap;
    }
    return keys;
}

void insertion_sort(uint64_t *keys, uint32_t count) {
    for (uint32_t i = 1; i < count; i++) {
        const uint64_t key = keys[i];
        uint32_t j = i;
        for (; j > 0 && keys[j - 1] > key; j--) keys[j] = keys[j - 1];
        keys[j] = key;
    }
}

// Fills the tile's entries from its pairs, nearest first, equal depths in the order of input.
void sort_tile(const Scene &scene, uint32_t start, uint32_t count, uint64_t *keys) {
    const uint64_t *pairs = scene.pairs + start;
    uint32_t nearest = UINT32_MAX, farthest = 0;
    for (uint32_t i = 0; i < count; i++) {
        const uint32_t depth = (uint32_t)(pairs[i] >> 32);
        nearest = depth < nearest ? depth : nearest;
        farthest = depth > farthest ? depth : farthest;
    }
    for (uint32_t i = 0; i < count; i++) {
        keys[i] = (uint64_t)((uint32_t)(pairs[i] >> 32) - nearest) << 32 | i;
    }
    if (count <= 48) {
        insertion_sort(keys, count);
    } else if (farthest > nearest) {
        const int bits = 32 - __builtin_clz(farthest - nearest);
        keys = radix_sort(keys, keys + count, count, bits);
    }
    Entry *entries = scene.entries + start;
    for (uint32_t i = 0; i < count; i++) {
        const uint32_t place = (uint32_t)keys[i];
        entries[i] = Entry{(uint32_t)pairs[place], start + place};
    }
}

// What the pixels of a tile have gathered so far, block by block.
struct Canvas {
    Floats transmittance[BLOCKS][PARTS];  // negative once the pixel has ended
    Floats red[BLOCKS][PARTS], green[BLOCKS][PARTS], blue[BLOCKS][PARTS];
};

void clear(Canvas &canvas, int columns, int rows) {
    const PixelCentres centres = pixel_centres();
    for (int block = 0; block < BLOCKS; block++) {
        const float right = (float)(columns - BLOCK * (block % TILE_BLOCKS));
        const float bottom = (float)(rows - BLOCK * (block / TILE_BLOCKS));
        for (int part = 0; part < PARTS; part++) {
            const Mask inside = both(less(centres.x, all(right)), less(centres.y[part], all(bottom)));
            canvas.transmittance[block][part] = select(inside, all(1.f), all(-1.f));
            canvas.red[block][part] = canvas.green[block][part] = canvas.blue[block][part] = Floats{};
        }
    }
}

// Blends one splat into the blocks of `mask`. Gives the blocks where some pixel saw it; removes
// from `alive` those whose pixels have all ended.
uint64_t blend_splat(Canvas &canvas, const Splat &s, const PixelCentres &centres, float left,
                     float top, uint64_t mask, uint64_t &alive) {
    uint64_t seen_in = 0;
    for (uint64_t todo = mask; todo; todo &= todo - 1) {
        const int block = __builtin_ctzll(todo);
        const float corner_x = left + (float)(BLOCK * (block % TILE_BLOCKS)) - s.x;
        const float corner_y = top + (float)(BLOCK * (block / TILE_BLOCKS)) - s.y;
        const Floats dx = centres.x + corner_x;
        bool ended = false, seen_any = false;
        for (int part = 0; part < PARTS; part++) {
            const Floats dy = centres.y[part] + corner_y;
            const Floats exponent = (s.xx * dx + s.xy * dy) * dx + (s.yy * dy * dy + s.log_opacity);
            Floats &transmittance = canvas.transmittance[block][part];
            const Mask seen = both(at_least(exponent, all(LOG_ALPHA_MIN)),
                                   less(Floats{}, transmittance));
            if (!any(seen)) continue;
            seen_any = true;
            const Floats alpha = exp_small(smaller(exponent, all(LOG_ALPHA_MAX)));
            Floats weight = kept(seen, transmittance * alpha);
            const Floats after = transmittance - weight;
            const Mask stop = both(less(after, all(TRANSMITTANCE_MIN)), seen);
            if (any(stop)) {
                weight = kept(without(seen, stop), weight);
                transmittance = negated(stop, transmittance - weight);
                ended = true;
            } else {
                transmittance = after;
            }
            canvas.red[block][part] += weight * s.red;
            canvas.green[block][part] += weight * s.green;
            canvas.blue[block][part] += weight * s.blue;
        }
        if (seen_any) seen_in |= todo & -todo;
        if (ended) {
            bool lives = false;
            for (int part = 0; part < PARTS; part++) {
                lives |= any(less(Floats{}, canvas.transmittance[block][part]));
            }
            if (!lives) alive &= ~(todo & -todo);
        }
    }
    return seen_in;
}

void write_images(const Scene &scene, const Canvas &canvas, int left, int top, const Images &out) {
    const int width = scene.view.width, height = scene.view.height;
    for (int block = 0; block < BLOCKS; block++) {
        const int x0 = left + BLOCK * (block % TILE_BLOCKS), y0 = top + BLOCK * (block / TILE_BLOCKS);
        if (x0 >= width || y0 >= height) continue;
        alignas(64) float rest[BLOCK_PIXELS], channels[3][BLOCK_PIXELS];
        for (int part = 0; part < PARTS; part++) {
            const int at = part * LANES;
            const Floats t = canvas.transmittance[block][part], left_over = larger(t, -t);
            store(rest + at, left_over);
            store(channels[0] + at, canvas.red[block][part] + left_over * scene.background[0]);
            store(channels[1] + at, canvas.green[block][part] + left_over * scene.background[1]);
            store(channels[2] + at, canvas.blue[block][part] + left_over * scene.background[2]);
        }
        const int columns = width - x0 < BLOCK ? width - x0 : BLOCK;
        const int rows = height - y0 < BLOCK ? height - y0 : BLOCK;
        for (int y = 0; y < rows; y++) {
            const int64_t pixel = (int64_t)(y0 + y) * width + x0;
            for (int x = 0; x < columns; x++) {
                out.alpha[pixel + x] = 1.f - rest[BLOCK * y + x];
                for (int c = 0; c < 3; c++) out.image[3 * (pixel + x) + c] = channels[c][BLOCK * y + x];
            }
        }
    }
}

}  // namespace

void blend(const Scene &scene, int tile, uint64_t *keys, const Images &out) {
    const uint32_t start = scene.tile_starts[tile], count = scene.tile_starts[tile + 1] - start;
    sort_tile(scene, start, count, keys);
    const int left = TILE * (tile % scene.tiles_x), top = TILE * (tile / scene.tiles_x);
    const int columns = scene.view.width - left < TILE ? scene.view.width - left : TILE;
    const int rows = scene.view.height - top < TILE ? scene.view.height - top : TILE;
    Canvas canvas;
    clear(canvas, columns, rows);
    uint64_t alive = blocks_in_image(columns, rows);
    const PixelCentres centres = pixel_centres();
    const Entry *entries = scene.entries + start;
    uint64_t *masks = scene.block_masks + start;
    uint32_t i = 0;
    for (; i < count && alive; i++) {
        if (i + 8 < count) __builtin_prefetch(scene.splats + entries[i + 8].gaussian);
        const Splat &splat = scene.splats[entries[i].gaussian];
        const uint64_t covered = covered_blocks(splat, (float)left, (float)top) & alive;
        masks[i] = blend_splat(canvas, splat, centres, (float)left, (float)top, covered, alive);
    }
    if (i < count) memset(masks + i, 0, (count - i) * sizeof *masks);
    write_images(scene, canvas, left, top, out);
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
