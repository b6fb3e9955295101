// Front to back blending of one tile, after sorting its list by depth.
#include "raster/blocks.hpp"
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
        __builtin_prefetch(scene.splats + (uint32_t)pairs[i], 0, 2);
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

// What one vector of pixels has gathered so far.
struct Pixels {
    Floats transmittance;  // negative once the pixel has ended
    Floats red, green, blue;
};

struct Canvas {
    Pixels pixels[BLOCKS][PARTS];
};

void clear(Canvas &canvas, int columns, int rows) {
    const PixelCentres centres = pixel_centres();
    for (int block = 0; block < BLOCKS; block++) {
        const float right = (float)(columns - BLOCK * (block % TILE_BLOCKS));
        const float bottom = (float)(rows - BLOCK * (block / TILE_BLOCKS));
        for (int part = 0; part < PARTS; part++) {
            const Mask inside = both(less(centres.x, all(right)), less(centres.y[part], all(bottom)));
            canvas.pixels[block][part] = Pixels{select(inside, all(1.f), all(-1.f)), {}, {}, {}};
        }
    }
}

// A run of splats of a tile, and for each block the bits of those that cover it. Block by block,
// a pixel stays in registers while they go by.
constexpr int WORDS = 4, BATCH = 64 * WORDS;
struct Batch {
    Splat splats[BATCH];
    uint64_t covering[WORDS][BLOCKS];  // first a row of blocks for each splat, then transposed
};

// One step of transposing 64 × 64 bits: swaps the squares of STEP × STEP off the diagonal.
template <int STEP>
GSYN_INLINE void swap_squares(uint64_t *rows, uint64_t low) {
    for (int from = 0; from < 64; from += 2 * STEP) {
        for (int i = from; i < from + STEP; i++) {
            const uint64_t differing = (rows[i] >> STEP ^ rows[i + STEP]) & low;
            rows[i] ^= differing << STEP;
            rows[i + STEP] ^= differing;
        }
    }
}

void transpose(uint64_t *rows) {
    swap_squares<32>(rows, 0x00000000FFFFFFFFu);
    swap_squares<16>(rows, 0x0000FFFF0000FFFFu);
    swap_squares<8>(rows, 0x00FF00FF00FF00FFu);
    swap_squares<4>(rows, 0x0F0F0F0F0F0F0F0Fu);
    swap_squares<2>(rows, 0x3333333333333333u);
    swap_squares<1>(rows, 0x5555555555555555u);
}

// Blends the batch into one vector of a block, whose pixel centres are at (x, y).
GSYN_INLINE void blend_part(Pixels &pixels, const Batch &batch, int block, Floats x, Floats y) {
    Pixels p = pixels;
    for (int word = 0; word < WORDS; word++) {
        for (uint64_t todo = batch.covering[word][block]; todo; todo &= todo - 1) {
            const Splat &s = batch.splats[64 * word + __builtin_ctzll(todo)];
            const Floats exponent = log_alpha(s, x - s.x, y - s.y);
            Mask seen =
                both(at_least(exponent, all(LOG_ALPHA_MIN)), less(Floats{}, p.transmittance));
            const Floats alpha = exp2_small(smaller(exponent, all(LOG_ALPHA_MAX)));
            const Floats weight = pass_splat(p.transmittance, alpha, seen);
            p.red += weight * s.red;
            p.green += weight * s.green;
            p.blue += weight * s.blue;
        }
    }
    pixels = p;
}

// Blends the batch into a block whose corner is at (left, top). False once all pixels have ended.
bool blend_block(Canvas &canvas, const Batch &batch, int block, float left, float top) {
    const PixelCentres centres = pixel_centres();
    bool lives = false;
    for (int part = 0; part < PARTS; part++) {
        Pixels &pixels = canvas.pixels[block][part];
        blend_part(pixels, batch, block, centres.x + left, centres.y[part] + top);
        lives |= any(less(Floats{}, pixels.transmittance));
    }
    return lives;
}

// Loads up to BATCH splats; writes beside their entries which blocks of `alive` each covers.
void fill(Batch &batch, const Scene &scene, uint32_t first, uint32_t last, float left, float top,
          uint64_t alive) {
    memset(batch.covering, 0, sizeof batch.covering);
    for (uint32_t i = 0; first + i < last && i < BATCH; i++) {
        const Entry *entry = scene.entries + first + i;
        if (first + i + 8 < last) __builtin_prefetch(scene.splats + entry[8].gaussian);
        batch.splats[i] = scene.splats[entry->gaussian];
        const uint64_t mask = covered_blocks(batch.splats[i], left, top) & alive;
        scene.block_masks[first + i] = batch.covering[i / 64][i % 64] = mask;
    }
    for (int word = 0; word < WORDS; word++) transpose(batch.covering[word]);
}

void write_images(const Scene &scene, const Canvas &canvas, int left, int top, const Images &out) {
    const int width = scene.view.width, height = scene.view.height;
    for (int block = 0; block < BLOCKS; block++) {
        const int x0 = left + BLOCK * (block % TILE_BLOCKS), y0 = top + BLOCK * (block / TILE_BLOCKS);
        if (x0 >= width || y0 >= height) continue;
        alignas(64) float rest[BLOCK_PIXELS], channels[3][BLOCK_PIXELS];
        for (int part = 0; part < PARTS; part++) {
            const int at = part * LANES;
            const Pixels &p = canvas.pixels[block][part];
            const Floats left_over = larger(p.transmittance, -p.transmittance);
            store(rest + at, left_over);
            store(channels[0] + at, p.red + left_over * scene.background[0]);
            store(channels[1] + at, p.green + left_over * scene.background[1]);
            store(channels[2] + at, p.blue + left_over * scene.background[2]);
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
    const uint32_t start = scene.tile_starts[tile], end = scene.tile_starts[tile + 1];
    sort_tile(scene, start, end - start, keys);
    const int left = TILE * (tile % scene.tiles_x), top = TILE * (tile / scene.tiles_x);
    const int columns = scene.view.width - left < TILE ? scene.view.width - left : TILE;
    const int rows = scene.view.height - top < TILE ? scene.view.height - top : TILE;
    Canvas canvas;
    clear(canvas, columns, rows);
    uint64_t alive = blocks_in_image(columns, rows);
    Batch batch;
    uint32_t next = start;
    for (; next < end && alive; next = end - next < BATCH ? end : next + BATCH) {
        fill(batch, scene, next, end, (float)left, (float)top, alive);
        for (uint64_t todo = alive; todo; todo &= todo - 1) {
            const int block = __builtin_ctzll(todo);
            const float x = (float)(left + BLOCK * (block % TILE_BLOCKS));
            const float y = (float)(top + BLOCK * (block / TILE_BLOCKS));
            if (!blend_block(canvas, batch, block, x, y)) alive &= ~(todo & -todo);
        }
    }
    memset(scene.block_masks + next, 0, (end - next) * sizeof(uint64_t));
    write_images(scene, canvas, left, top, out);
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
