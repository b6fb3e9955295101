// What the passes over a tile share: which blocks of it a splat covers, and its alpha there.
#pragma once

#include "raster/raster.hpp"
#include "simd.hpp"

namespace gsyn {
namespace GSYN_VARIANT {

constexpr int PARTS = BLOCK_PIXELS / LANES;  // vectors in a block

// Centres of a block's pixels from its corner; part k holds BLOCK / PARTS rows.
struct PixelCentres {
    Floats x, y[PARTS];
};

GSYN_INLINE PixelCentres pixel_centres() {
    alignas(64) float x[BLOCK_PIXELS], y[BLOCK_PIXELS];
    for (int i = 0; i < BLOCK_PIXELS; i++) {
        x[i] = (float)(i % BLOCK) + 0.5f;
        y[i] = (float)(i / BLOCK) + 0.5f;
    }
    PixelCentres centres;
    centres.x = load(x);
    for (int part = 0; part < PARTS; part++) centres.y[part] = load(y + part * LANES);
    return centres;
}

// The binary logarithm of the splat's alpha at this offset from its centre.
GSYN_INLINE Floats log_alpha(const Splat &s, Floats dx, Floats dy) {
    return (s.xx * dx + s.xy * dy) * dx + (s.yy * dy * dy + s.log_opacity);
}

// Moves one vector of pixels behind a splat, and gives its weight T alpha: 0 where `seen`, which
// tells who could see it, is false, and where it ends the pixel, which does not see it either.
GSYN_INLINE Floats pass_splat(Floats &transmittance, Floats alpha, Mask &seen) {
    Floats weight = kept(seen, transmittance * alpha);
    Floats after = transmittance - weight;
    const Mask stop = both(less(after, all(TRANSMITTANCE_MIN)), seen);
    if (__builtin_expect(any(stop), 0)) {
        seen = without(seen, stop);
        weight = kept(seen, weight);
        after = negated(stop, transmittance - weight);
    }
    transmittance = after;
    return weight;
}

// Eight lanes at most: one for each row of blocks in a tile.
#if GSYN_LANES >= 8
typedef Float8 Rows;
typedef Int8 RowInts;
#else
typedef Float4 Rows;
typedef Int4 RowInts;
#endif
constexpr int ROW_LANES = sizeof(Rows) / sizeof(float);

GSYN_INLINE Rows row_numbers(int first) {
    Rows rows;
    for (int i = 0; i < ROW_LANES; i++) rows[i] = (float)(first + i);
    return rows;
}

// One bit for each block of the tile at (left, top) that the splat's ellipse may touch, row by row.
GSYN_INLINE uint64_t covered_blocks(const Splat &s, float left, float top) {
    constexpr float SLACK = 0.01f;  // px, for rounding
    const Rows zero{};
    const float centre_y = s.y - top, centre_x = s.x - left;
    const Rows height = zero + s.half_height, tip = zero + s.tip;
    uint64_t mask = 0;
    for (int first = 0; first < TILE_BLOCKS; first += ROW_LANES) {
        const Rows corner = row_numbers(first) * (float)BLOCK - centre_y;
        const Rows low = larger(corner + (0.5f - SLACK), -height);
        const Rows high = smaller(corner + ((float)BLOCK - 0.5f + SLACK), height);
        const Rows right_y = smaller(larger(tip, low), high);
        const Rows left_y = smaller(larger(-tip, low), high);
        const Rows height2 = height * height;
        const Rows right = s.slope * right_y + s.bulge * root(larger(height2 - right_y * right_y, zero));
        const Rows left = s.slope * left_y - s.bulge * root(larger(height2 - left_y * left_y, zero));
        // Columns [begin, end): begin rounds up, end is one more than rounding down.
        const Rows inverse = zero + 1.f / (float)BLOCK, most = zero + (float)TILE_BLOCKS;
        const Rows from = (left + (centre_x - SLACK - ((float)BLOCK - 0.5f))) * inverse;
        const Rows to = (right + (centre_x + SLACK - 0.5f)) * inverse + 1.f;
        const RowInts begin =
            TILE_BLOCKS - __builtin_convertvector(smaller(larger(most - from, zero), most), RowInts);
        const RowInts end = __builtin_convertvector(smaller(larger(to, zero), most), RowInts);
        const RowInts one = RowInts{} + 1;
        RowInts bits = (one << end) - (one << begin);
        bits &= (RowInts)(low <= high) & (RowInts)(bits > 0);
#if defined(__AVX512VL__)
        mask = (uint64_t)_mm_cvtsi128_si64(_mm256_cvtepi32_epi8((__m256i)bits));
#else
        for (int i = 0; i < ROW_LANES; i++) {
            mask |= (uint64_t)(uint32_t)bits[i] << (TILE_BLOCKS * (first + i));
        }
#endif
    }
    return mask;
}

// The pixels of a block, relative to a splat's centre.
struct Offsets {
    Floats dx, dy[PARTS];
};

GSYN_INLINE Offsets offsets_of(const PixelCentres &from_splat, int block) {
    const float left = (float)(BLOCK * (block % TILE_BLOCKS));
    const float top = (float)(BLOCK * (block / TILE_BLOCKS));
    Offsets offsets;
    offsets.dx = from_splat.x + left;
    for (int part = 0; part < PARTS; part++) offsets.dy[part] = from_splat.y[part] + top;
    return offsets;
}

// Alpha in each block of the mask, one after the other; 0 where it is below the cut-off. A loop of
// its own: each of its passes waits for nothing but the splat, so that many run at once.
GSYN_INLINE void alphas_of(const Splat &s, const PixelCentres &from_splat, uint64_t mask,
                           Floats *alphas) {
    for (uint64_t todo = mask; todo; todo &= todo - 1) {
        const Offsets at = offsets_of(from_splat, __builtin_ctzll(todo));
        for (int part = 0; part < PARTS; part++) {
            const Floats exponent = log_alpha(s, at.dx, at.dy[part]);
            const Floats alpha = exp2_small(smaller(exponent, all(LOG_ALPHA_MAX)));
            *alphas++ = kept(at_least(exponent, all(LOG_ALPHA_MIN)), alpha);
        }
    }
}

// The pixels of the tile at (left, top), relative to a splat's centre.
GSYN_INLINE PixelCentres centres_from(const Splat &splat, PixelCentres centres, int left, int top) {
    centres.x += (float)left - splat.x;
    for (int part = 0; part < PARTS; part++) centres.y[part] += (float)top - splat.y;
    return centres;
}

// The blocks of a tile that have a pixel inside the image.
GSYN_INLINE uint64_t blocks_in_image(int columns, int rows) {
    const int across = (columns + BLOCK - 1) / BLOCK, down = (rows + BLOCK - 1) / BLOCK;
    const uint64_t row = (1u << across) - 1u;
    uint64_t mask = 0;
    for (int i = 0; i < down; i++) mask |= row << (TILE_BLOCKS * i);
    return mask;
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
