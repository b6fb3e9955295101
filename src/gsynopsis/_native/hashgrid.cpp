// The multiresolution hash grid: 8 corners a level, corners computed where they are used.
#include "raster.hpp"
#include "simd.hpp"
#include "stages.hpp"

namespace gsyn {
namespace GSYN_VARIANT {
namespace {

constexpr uint32_t PRIME_Y = 2654435761u, PRIME_Z = 805459861u;

struct Level {
    uint32_t resolution, size;
    bool dense;
};

Level level_of(const HashGrid &grid, int level) {
    const int64_t r = grid.resolutions[level], size = grid.sizes[level];
    return {(uint32_t)r, (uint32_t)size, r * r * r <= size};
}

struct Corners {
    uint32_t row[8];
    float weight[8];
};

GSYN_INLINE void axis(float u, uint32_t resolution, uint32_t &cell, float &fraction) {
    const float position = u * (float)(resolution - 1);
    const float highest = (float)(resolution - 2);
    float low = floorf(position);
    low = low > 0.f ? low : 0.f;  // also where u is NaN
    low = low < highest ? low : highest;
    cell = (uint32_t)low;
    fraction = position - low;
}

GSYN_INLINE void corners_of(const Level &level, const float *u, Corners &out) {
    uint32_t cell[3];
    float fraction[3];
    for (int k = 0; k < 3; k++) axis(u[k], level.resolution, cell[k], fraction[k]);
    const float x[2] = {1.f - fraction[0], fraction[0]};
    const float y[2] = {1.f - fraction[1], fraction[1]};
    const float z[2] = {1.f - fraction[2], fraction[2]};
    const bool power_of_two = (level.size & (level.size - 1)) == 0;
    for (uint32_t c = 0; c < 8; c++) {
        const uint32_t dx = c & 1, dy = c >> 1 & 1, dz = c >> 2;
        const uint32_t X = cell[0] + dx, Y = cell[1] + dy, Z = cell[2] + dz;
        if (level.dense) {
            out.row[c] = X + level.resolution * (Y + level.resolution * Z);
        } else {
            const uint32_t hash = X ^ Y * PRIME_Y ^ Z * PRIME_Z;
            out.row[c] = power_of_two ? hash & (level.size - 1) : hash % level.size;
        }
        out.weight[c] = x[dx] * y[dy] * z[dz];
    }
}

}  // namespace

void hashgrid_forward(const HashGrid &grid, const float *points, int64_t begin, int64_t end,
                      const float *tables, float *out) {
    const int F = grid.features, row_length = grid.levels * F;
    for (int l = 0; l < grid.levels; l++) {
        const Level level = level_of(grid, l);
        const float *table = tables + grid.offsets[l] * F;
        for (int64_t v = begin; v < end; v++) {
            Corners corners;
            corners_of(level, points + 3 * v, corners);
            float *to = out + v * row_length + l * F;
            if (F == 4) {
                Float4 sum{};
                for (int c = 0; c < 8; c++) {
                    Float4 row;
                    memcpy(&row, table + 4 * (int64_t)corners.row[c], sizeof row);
                    sum += corners.weight[c] * row;
                }
                memcpy(to, &sum, sizeof sum);
                continue;
            }
            for (int f = 0; f < F; f++) to[f] = 0.f;
            for (int c = 0; c < 8; c++) {
                const float *row = table + (int64_t)corners.row[c] * F;
                for (int f = 0; f < F; f++) to[f] += corners.weight[c] * row[f];
            }
        }
    }
}

void hashgrid_backward(const HashGrid &grid, const float *points, int64_t count, int l,
                       const float *grad_out, float *grad_tables) {
    const int F = grid.features, row_length = grid.levels * F;
    const Level level = level_of(grid, l);
    float *table = grad_tables + grid.offsets[l] * F;
    for (int64_t v = 0; v < count; v++) {
        Corners corners;
        corners_of(level, points + 3 * v, corners);
        const float *from = grad_out + v * row_length + l * F;
        if (F == 4) {
            Float4 grad;
            memcpy(&grad, from, sizeof grad);
            for (int c = 0; c < 8; c++) {
                float *to = table + 4 * (int64_t)corners.row[c];
                Float4 row;
                memcpy(&row, to, sizeof row);
                row += corners.weight[c] * grad;
                memcpy(to, &row, sizeof row);
            }
            continue;
        }
        for (int c = 0; c < 8; c++) {
            float *row = table + (int64_t)corners.row[c] * F;
            for (int f = 0; f < F; f++) row[f] += corners.weight[c] * from[f];
        }
    }
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
