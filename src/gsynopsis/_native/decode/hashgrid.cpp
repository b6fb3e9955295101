// The multiresolution hash grid: 8 corners a level, computed where they are used.
//
// Compiled without fused multiply-add: values are the same bits for every variant.
#include "simd.hpp"
#include "stages.hpp"

namespace gsyn {
namespace GSYN_VARIANT {
namespace {

typedef uint32_t UInts __attribute__((vector_size(4 * GSYN_LANES)));

constexpr uint32_t PRIME_Y = 2654435761u, PRIME_Z = 805459861u;
constexpr int CORNERS = 8;

struct Level {
    uint32_t resolution, size;
    bool dense, power_of_two;
};

Level level_of(const HashGrid &grid, int level) {
    const int64_t r = grid.resolutions[level], size = grid.sizes[level];
    return {(uint32_t)r, (uint32_t)size, r * r * r <= size, (size & (size - 1)) == 0};
}

// Of LANES points: the rows of their corners (x fastest) and how much each counts.
struct Corners {
    alignas(64) uint32_t row[CORNERS][LANES];
    alignas(64) float weight[CORNERS][LANES];
};

// Lower cell along one axis, and the weights of it and the next.
GSYN_INLINE UInts cell_of(Floats u, uint32_t resolution, Floats *weight) {
    const Floats position = u * (float)(resolution - 1);
    // Limited before it becomes an integer, so that no point reaches outside; NaN becomes 0.
    const Floats limited = clamp(position, 0.f, (float)(resolution - 2));
    const UInts cell = __builtin_convertvector(limited, UInts);
    weight[1] = position - __builtin_convertvector(cell, Floats);
    weight[0] = 1.f - weight[1];
    return cell;
}

GSYN_INLINE void corners_of(const Level &level, const Floats *u, Corners &out) {
    Floats x[2], y[2], z[2];
    const UInts cx = cell_of(u[0], level.resolution, x);
    const UInts cy = cell_of(u[1], level.resolution, y);
    const UInts cz = cell_of(u[2], level.resolution, z);
    // Each axis' share of the row, for its lower and upper corner.
    const uint32_t by_y = level.dense ? level.resolution : PRIME_Y;
    const uint32_t by_z = level.dense ? level.resolution * level.resolution : PRIME_Z;
    const UInts xs[2] = {cx, cx + 1u}, ys[2] = {cy * by_y, cy * by_y + by_y};
    const UInts zs[2] = {cz * by_z, cz * by_z + by_z};
    for (int c = 0; c < CORNERS; c++) {
        const int dx = c & 1, dy = c >> 1 & 1, dz = c >> 2;
        UInts row = level.dense ? xs[dx] + ys[dy] + zs[dz] : xs[dx] ^ ys[dy] ^ zs[dz];
        if (!level.dense) row = level.power_of_two ? row & (level.size - 1) : row % level.size;
        const Floats weight = x[dx] * y[dy] * z[dz];
        memcpy(out.row[c], &row, sizeof row);
        memcpy(out.weight[c], &weight, sizeof weight);
    }
}

// The corners of points [begin, begin + LANES), the last repeated where there are fewer.
GSYN_INLINE void corners_at(const Level &level, const float *points, int64_t begin, int64_t end,
                            Corners &out) {
    alignas(64) float u[3][LANES];
    for (int i = 0; i < LANES; i++) {
        const float *point = points + 3 * (begin + i < end ? begin + i : end - 1);
        for (int k = 0; k < 3; k++) u[k][i] = point[k];
    }
    const Floats lanes[3] = {load(u[0]), load(u[1]), load(u[2])};
    corners_of(level, lanes, out);
}

// A row of F floats, in a register where the compiler knows F; F = 0: any number of features.
template <int F>
struct Row {
    typedef float Values __attribute__((vector_size(4 * F)));
};

template <int F>
GSYN_INLINE void gather_point(const Corners &at, int lane, const float *table, int features,
                              float *to) {
    if constexpr (F > 0) {
        typename Row<F>::Values sum{}, row;
        for (int c = 0; c < CORNERS; c++) {
            memcpy(&row, table + (int64_t)at.row[c][lane] * F, sizeof row);
            sum += at.weight[c][lane] * row;
        }
        memcpy(to, &sum, sizeof sum);
    } else {
        for (int f = 0; f < features; f++) to[f] = 0.f;
        for (int c = 0; c < CORNERS; c++) {
            const float *row = table + (int64_t)at.row[c][lane] * features;
            for (int f = 0; f < features; f++) to[f] += at.weight[c][lane] * row[f];
        }
    }
}

template <int F>
GSYN_INLINE void scatter_point(const Corners &at, int lane, float *table, int features,
                               const float *from) {
    if constexpr (F > 0) {
        typename Row<F>::Values grad, row;
        memcpy(&grad, from, sizeof grad);
        for (int c = 0; c < CORNERS; c++) {
            float *to = table + (int64_t)at.row[c][lane] * F;
            memcpy(&row, to, sizeof row);
            row += at.weight[c][lane] * grad;
            memcpy(to, &row, sizeof row);
        }
    } else {
        for (int c = 0; c < CORNERS; c++) {
            float *row = table + (int64_t)at.row[c][lane] * features;
            for (int f = 0; f < features; f++) row[f] += at.weight[c][lane] * from[f];
        }
    }
}

template <int F>
void forward(const HashGrid &grid, const float *points, int64_t begin, int64_t end,
             const float *tables, float *out) {
    const int width = F ? F : grid.features;
    // Level by level: one table at a time stays in the cache.
    for (int l = 0; l < grid.levels; l++) {
        const Level level = level_of(grid, l);
        const float *table = tables + grid.offsets[l] * width;
        for (int64_t start = begin; start < end; start += LANES) {
            Corners corners;
            corners_at(level, points, start, end, corners);
            for (int i = 0; i < LANES && start + i < end; i++) {
                float *to = out + (start + i) * grid.stride + l * width;
                gather_point<F>(corners, i, table, width, to);
            }
        }
    }
}

template <int F>
void backward(const HashGrid &grid, const float *points, int64_t count, int l,
              const float *grad_out, float *grad_tables) {
    const int width = F ? F : grid.features;
    const Level level = level_of(grid, l);
    float *table = grad_tables + grid.offsets[l] * width;
    for (int64_t start = 0; start < count; start += LANES) {
        Corners corners;
        corners_at(level, points, start, count, corners);
        for (int i = 0; i < LANES && start + i < count; i++) {
            const float *from = grad_out + (start + i) * grid.stride + l * width;
            scatter_point<F>(corners, i, table, width, from);
        }
    }
}

}  // namespace

void hashgrid_forward(const HashGrid &grid, const float *points, int64_t begin, int64_t end,
                      const float *tables, float *out) {
    const auto run = grid.features == 4 ? forward<4> : grid.features == 2 ? forward<2> : forward<0>;
    run(grid, points, begin, end, tables, out);
}

void hashgrid_backward(const HashGrid &grid, const float *points, int64_t count, int level,
                       const float *grad_out, float *grad_tables) {
    const auto run =
        grid.features == 4 ? backward<4> : grid.features == 2 ? backward<2> : backward<0>;
    run(grid, points, count, level, grad_out, grad_tables);
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
