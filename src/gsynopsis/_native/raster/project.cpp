// Gaussians to splats, and the tiles that each splat touches.
#include "raster/projection.hpp"
#include "stages.hpp"

namespace gsyn {
namespace GSYN_VARIANT {
namespace {

// Slack for rounding, px: a tile too many costs a little time, one too few would be an error.
constexpr float SLACK = 0.01f;

// LANES splats, one array per member of Splat, and which of them are to be drawn.
struct Splats {
    alignas(64) float x[LANES], y[LANES], xx[LANES], xy[LANES], yy[LANES], log_opacity[LANES];
    alignas(64) float half_width[LANES], half_height[LANES], slope[LANES], bulge[LANES], tip[LANES];
    alignas(64) float depth[LANES];
    alignas(64) float drawn[LANES];  // 1 or 0
};

constexpr float LN_2 = 0.6931471805599453f, LOG2_E = 1.4426950408889634f;

// The binary logarithm of positive lanes; whatever for others.
GSYN_INLINE Floats log2_of(Floats v) {
    alignas(64) float lane[LANES];
    store(lane, v);
    for (int i = 0; i < LANES; i++) lane[i] = log2f(lane[i]);
    return load(lane);
}

// Whether opacity and colours are finite too, which the projection does not look at.
GSYN_INLINE Mask colors_finite(const Cloud &cloud, const int64_t *index) {
    Floats sum = gather(cloud.colors, 3, 0, index) * 0.f;
    for (int k = 1; k < 3; k++) sum += gather(cloud.colors, 3, k, index) * 0.f;
    return equal(sum, Floats{});
}

void project_splats(const Cloud &cloud, const View &view, const int64_t *index, Splats &splats) {
    const Projection p = project_batch(gather_batch(cloud, index), view);
    Floats opacity = gather(cloud.opacities, 1, 0, index);
    if (view.own != view.dilation) opacity *= root(p.own / p.determinant);
    const Floats log_opacity = log2_of(opacity);
    // alpha >= 1/255 where half the Mahalanobis distance squared is at most ln opacity + ln 255.
    const Floats reach = (2.f * LN_2) * (log_opacity - LOG_ALPHA_MIN);
    const Floats half_width = root(reach * p.xx), half_height = root(reach * p.yy);
    const Floats x = view.fx * p.u + view.cx, y = view.fy * p.v + view.cy;
    const Floats inverse = LOG2_E / p.determinant;

    store(splats.x, x);
    store(splats.y, y);
    store(splats.xx, -0.5f * p.yy * inverse);
    store(splats.xy, p.xy * inverse);
    store(splats.yy, -0.5f * p.xx * inverse);
    store(splats.log_opacity, log_opacity);
    store(splats.half_width, half_width);
    store(splats.half_height, half_height);
    store(splats.slope, p.xy / p.yy);
    store(splats.bulge, root(p.determinant) / p.yy);
    store(splats.tip, p.xy / p.xx * half_width);
    store(splats.depth, p.z);

    // Comparisons with NaN are false, so what is not finite falls out here.
    Mask drawn = both(at_least(p.z, all(NEAR_PLANE)), at_least(opacity, all(1.f / 255.f)));
    drawn = both(drawn, both(finite(inverse * p.determinant), finite(half_width + half_height)));
    drawn = both(drawn, both(finite(x + y), colors_finite(cloud, index)));
    drawn = both(drawn, both(less(Floats{}, p.inverse_norm), finite(p.inverse_norm + log_opacity)));
    drawn = both(drawn, both(at_least(x + half_width, all(0.5f)), at_least(y + half_height, all(0.5f))));
    drawn = both(drawn, at_least(all((float)view.width - 0.5f), x - half_width));
    drawn = both(drawn, at_least(all((float)view.height - 0.5f), y - half_height));
    store(splats.drawn, select(drawn, all(1.f), Floats{}));
}

// The whole number `value`, limited; `low` for NaN.
GSYN_INLINE int limited(float value, int low, int high) {
    return value >= (float)high ? high : value > (float)low ? (int)value : low;
}

// The first and last of `count` tiles along one axis that have a pixel centre in [low, high].
struct Range {
    int first, last;
};
GSYN_INLINE Range tiles_between(float low, float high, int count) {
    // The centres of a tile lie in [TILE i + 0.5, TILE i + TILE − 0.5].
    const float first = ceilf((low - SLACK - ((float)TILE - 0.5f)) / (float)TILE);
    const float last = floorf((high + SLACK - 0.5f) / (float)TILE);
    return {limited(first, 0, count), limited(last, -1, count - 1)};
}

// The x range of the ellipse between the pixel rows of one row of tiles.
GSYN_INLINE Range tiles_in_row(const Splat &s, int row, int count) {
    float low = (float)(row * TILE) + 0.5f - SLACK - s.y;
    float high = (float)(row * TILE + TILE) - 0.5f + SLACK - s.y;
    low = low > -s.half_height ? low : -s.half_height;
    high = high < s.half_height ? high : s.half_height;
    const float right = s.tip < low ? low : s.tip > high ? high : s.tip;
    const float left = -s.tip < low ? low : -s.tip > high ? high : -s.tip;
    const float height2 = s.half_height * s.half_height;
    const float right_inside = height2 - right * right, left_inside = height2 - left * left;
    const float right_bulge = right_inside > 0.f ? s.bulge * sqrtf(right_inside) : 0.f;
    const float left_bulge = left_inside > 0.f ? s.bulge * sqrtf(left_inside) : 0.f;
    return tiles_between(s.x + s.slope * left - left_bulge, s.x + s.slope * right + right_bulge, count);
}

// Appends the tiles that a splat touches; gives their number.
uint32_t list_tiles(const Splat &s, const Scene &scene, Chunk &chunk) {
    const Range rows = tiles_between(s.y - s.half_height, s.y + s.half_height, scene.tiles_y);
    const Range box = tiles_between(s.x - s.half_width, s.x + s.half_width, scene.tiles_x);
    if (rows.first > rows.last || box.first > box.last) return 0;
    TileList &list = chunk.tiles;
    const size_t most = (size_t)(rows.last - rows.first + 1) * (size_t)(box.last - box.first + 1);
    if (list.size + most > list.capacity && !grow(list, most)) return 0;
    uint32_t *next = list.items + list.size;
    for (int row = rows.first; row <= rows.last; row++) {
        const bool whole = rows.first == rows.last || box.first == box.last;
        const Range columns = whole ? box : tiles_in_row(s, row, scene.tiles_x);
        for (int column = columns.first; column <= columns.last; column++) {
            const uint32_t tile = (uint32_t)(row * scene.tiles_x + column);
            *next++ = tile;
            chunk.tile_counts[tile]++;
        }
    }
    const uint32_t touched = (uint32_t)(next - (list.items + list.size));
    list.size += touched;
    return touched;
}

Splat splat_of(const Splats &lanes, int i, const float *color) {
    return Splat{lanes.x[i],     lanes.y[i],           lanes.xx[i],   lanes.xy[i],
                 lanes.yy[i],    lanes.log_opacity[i], color[0],      color[1],
                 color[2],       lanes.half_width[i],  lanes.half_height[i],
                 lanes.slope[i], lanes.bulge[i],       lanes.tip[i],  lanes.depth[i]};
}

}  // namespace

void project(const Cloud &cloud, const Scene &scene, Chunk &chunk) {
    for (int64_t start = chunk.begin; start < chunk.end; start += LANES) {
        int64_t index[LANES];
        for (int i = 0; i < LANES; i++) {
            index[i] = start + i < chunk.end ? start + i : chunk.end - 1;
        }
        Splats lanes;
        project_splats(cloud, scene.view, index, lanes);
        const size_t before = chunk.tiles.size;
        for (int i = 0; i < LANES && start + i < chunk.end; i++) {
            const int64_t g = start + i;
            scene.touched[g] = 0;
            if (lanes.drawn[i] == 0.f) continue;
            scene.splats[g] = splat_of(lanes, i, cloud.colors + 3 * g);
            scene.touched[g] = list_tiles(scene.splats[g], scene, chunk);
        }
        // One count for a batch: too many pairs end all chunks within a batch of each.
        const int64_t added = (int64_t)(chunk.tiles.size - before);
        if (scene.listed->fetch_add(added, std::memory_order_relaxed) + added > scene.pairs_max) return;
    }
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
