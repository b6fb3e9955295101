// From the partial sums of the pairs to the gradients of the Gaussians, by the chain rule.
#include <algorithm>

#include "raster/projection.hpp"
#include "stages.hpp"

namespace gsyn {
namespace GSYN_VARIANT {
namespace {

constexpr int SUM_QUADS = (PARTIAL_SUMS + 3) / 4;

// The sums of LANES Gaussians over their tiles, one array per sum.
struct Sums {
    alignas(64) float of[PARTIAL_SUMS][LANES];
};

struct BatchGradient {
    Floats mean[3], quat[4], scale[3], opacity, color[3], screen[2];
};

// Gradient of the six entries of `spread` (2 × 3), from that of the inverse covariance.
GSYN_INLINE void spread_gradient(const Projection &p, const View &view, const Floats *s,
                                 Floats *out) {
    const Floats inverse = 1.f / p.determinant;
    const Floats A = p.yy * inverse, B = -p.xy * inverse, C = p.xx * inverse;
    // ln alpha = … − ½ (A dx² + 2 B dx dy + C dy²), so the inverse covariance has the symmetric
    // gradient −½ [[Σ s dx², Σ s dx dy], [Σ s dx dy, Σ s dy²]], called G; the covariance has −I G I.
    const Floats gxx = -0.5f * s[3], gxy = -0.5f * s[4], gyy = -0.5f * s[5];
    const Floats e0 = A * gxx + B * gxy, e1 = A * gxy + B * gyy;
    const Floats e2 = B * gxx + C * gxy, e3 = B * gxy + C * gyy;
    Floats cxx = -(e0 * A + e1 * B), cxy = -(e0 * B + e1 * C), cyy = -(e2 * B + e3 * C);
    if (view.own != view.dilation) {
        // ln alpha has ½ ln (own / determinant) too; ln of a determinant has the inverse matrix.
        const Floats half = 0.5f * s[0], own = 1.f / p.own;
        const float more = view.dilation - view.own;
        cxx += half * ((p.yy - more) * own - A);
        cxy += half * (-p.xy * own - B);
        cyy += half * ((p.xx - more) * own - C);
    }
    for (int k = 0; k < 3; k++) {
        out[k] = 2.f * (cxx * p.spread[k] + cxy * p.spread[3 + k]);
        out[3 + k] = 2.f * (cxy * p.spread[k] + cyy * p.spread[3 + k]);
    }
}

GSYN_INLINE void quat_gradient(const Projection &p, const Floats *d, Floats *out) {
    const Floats w = p.quat[0], x = p.quat[1], y = p.quat[2], z = p.quat[3];
    Floats g[4];
    g[0] = 2.f * (x * (d[7] - d[5]) + y * (d[2] - d[6]) + z * (d[3] - d[1]));
    g[1] = 2.f * (w * (d[7] - d[5]) + y * (d[1] + d[3]) + z * (d[2] + d[6]) - 2.f * x * (d[4] + d[8]));
    g[2] = 2.f * (w * (d[2] - d[6]) + x * (d[1] + d[3]) + z * (d[5] + d[7]) - 2.f * y * (d[0] + d[8]));
    g[3] = 2.f * (w * (d[3] - d[1]) + x * (d[2] + d[6]) + y * (d[5] + d[7]) - 2.f * z * (d[0] + d[4]));
    const Floats along = g[0] * w + g[1] * x + g[2] * y + g[3] * z;
    for (int k = 0; k < 4; k++) out[k] = (g[k] - along * p.quat[k]) * p.inverse_norm;
}

// Gradient of the mean, from that of the projected centre and of to_screen (2 × 3).
GSYN_INLINE void mean_gradient(const Projection &p, const View &view, const Floats *screen,
                               const Floats *T, Floats *out) {
    const float *R = view.rotation;
    const Floats xx = T[0] * R[0] + T[1] * R[1] + T[2] * R[2];  // of the Jacobian's four entries
    const Floats xz = T[0] * R[6] + T[1] * R[7] + T[2] * R[8];
    const Floats yy = T[3] * R[3] + T[4] * R[4] + T[5] * R[5];
    const Floats yz = T[3] * R[6] + T[4] * R[7] + T[5] * R[8];
    const Floats by_x = view.fx * p.inverse_z, by_y = view.fy * p.inverse_z;
    const Floats du = view.fx * screen[0] - kept(equal(p.u, p.u_clamped), by_x * xz);
    const Floats dv = view.fy * screen[1] - kept(equal(p.v, p.v_clamped), by_y * yz);
    const Floats dx = du * p.inverse_z, dy = dv * p.inverse_z;
    const Floats dz = -(by_x * (xx - p.u_clamped * xz) + by_y * (yy - p.v_clamped * yz)) * p.inverse_z -
                      dx * p.u - dy * p.v;
    for (int k = 0; k < 3; k++) out[k] = R[k] * dx + R[3 + k] * dy + R[6 + k] * dz;
}

void batch_gradient(const Cloud &cloud, const View &view, const int64_t *index, const Sums &sums,
                    BatchGradient &out) {
    const Batch g = gather_batch(cloud, index);
    const Projection p = project_batch(g, view);
    Floats s[PARTIAL_SUMS];
    for (int k = 0; k < PARTIAL_SUMS; k++) s[k] = load(sums.of[k]);
    const Floats inverse = 1.f / p.determinant;
    out.opacity = s[0] / gather(cloud.opacities, 1, 0, index);
    for (int k = 0; k < 3; k++) out.color[k] = s[6 + k];
    out.screen[0] = (p.yy * s[1] - p.xy * s[2]) * inverse;
    out.screen[1] = (p.xx * s[2] - p.xy * s[1]) * inverse;

    Floats spread[6], shaped[9], rotation[9], to_screen[6];
    spread_gradient(p, view, s, spread);
    for (int row = 0; row < 3; row++) {
        for (int k = 0; k < 3; k++) {
            shaped[3 * row + k] = p.to_screen[row] * spread[k] + p.to_screen[3 + row] * spread[3 + k];
            rotation[3 * row + k] = shaped[3 * row + k] * g.scale[k];
        }
    }
    for (int k = 0; k < 3; k++) {
        out.scale[k] = shaped[k] * p.rotation[k] + shaped[3 + k] * p.rotation[3 + k] +
                       shaped[6 + k] * p.rotation[6 + k];
    }
    quat_gradient(p, rotation, out.quat);
    for (int row = 0; row < 2; row++) {
        for (int k = 0; k < 3; k++) {
            to_screen[3 * row + k] = spread[3 * row] * p.shaped[3 * k] +
                                     spread[3 * row + 1] * p.shaped[3 * k + 1] +
                                     spread[3 * row + 2] * p.shaped[3 * k + 2];
        }
    }
    mean_gradient(p, view, out.screen, to_screen, out.mean);
}

// Zero where some gradient of the same Gaussian overflowed: one freak must not spoil a model.
GSYN_INLINE void drop_infinite(BatchGradient &gradient) {
    Floats *values = (Floats *)&gradient;
    constexpr int COUNT = sizeof gradient / sizeof *values;
    Floats test{};
    for (int k = 0; k < COUNT; k++) test += values[k] * 0.f;
    const Mask good = equal(test, Floats{});
    for (int k = 0; k < COUNT; k++) values[k] = kept(good, values[k]);
}

// Into rows that somebody asked for; null: nobody did.
GSYN_INLINE void scatter(float *rows, int width, const int64_t *index, int count,
                         const Floats *values) {
    if (!rows) return;
    alignas(64) float lane[4][LANES];
    for (int k = 0; k < width; k++) store(lane[k], values[k]);
    for (int i = 0; i < count; i++) {
        for (int k = 0; k < width; k++) rows[index[i] * width + k] = lane[k][i];
    }
}

void finish_batch(const Cloud &cloud, const View &view, int64_t *index, int count, Sums &sums,
                  const CloudGradients &out) {
    for (int i = count; i < LANES; i++) {
        index[i] = index[0];
        for (int k = 0; k < PARTIAL_SUMS; k++) sums.of[k][i] = 0.f;
    }
    BatchGradient gradient;
    batch_gradient(cloud, view, index, sums, gradient);
    drop_infinite(gradient);
    scatter(out.means, 3, index, count, gradient.mean);
    scatter(out.quats, 4, index, count, gradient.quat);
    scatter(out.scales, 3, index, count, gradient.scale);
    scatter(out.opacities, 1, index, count, &gradient.opacity);
    scatter(out.colors, 3, index, count, gradient.color);
    scatter(out.screen, 2, index, count, gradient.screen);
}

void clear_gradient(const CloudGradients &out, int64_t g) {
    const auto clear = [g](float *rows, int width) {
        if (rows) std::fill_n(rows + width * g, width, 0.f);
    };
    clear(out.means, 3);
    clear(out.quats, 4);
    clear(out.scales, 3);
    clear(out.opacities, 1);
    clear(out.colors, 3);
    clear(out.screen, 2);
}

}  // namespace

void project_backward(const Cloud &cloud, const Scene &scene, const Chunk &chunk,
                      const CloudGradients &out) {
    const uint32_t *slots = chunk.tiles.items, *const last = slots + chunk.tiles.size;
    int64_t index[LANES];
    Sums sums;
    int filled = 0;
    for (int64_t g = chunk.begin; g < chunk.end; g++) {
        const uint32_t touched = scene.touched[g];
        if (touched == 0) {
            clear_gradient(out, g);
            continue;
        }
        Float4 total[SUM_QUADS] = {};
        for (uint32_t i = 0; i < touched; i++) {
            if (slots + 24 < last) {
                __builtin_prefetch(scene.partials + (int64_t)slots[24] * PARTIAL_STRIDE);
            }
            const float *row = scene.partials + (int64_t)*slots++ * PARTIAL_STRIDE;
            for (int k = 0; k < SUM_QUADS; k++) {
                Float4 part;
                memcpy(&part, row + 4 * k, sizeof part);
                total[k] += part;
            }
        }
        index[filled] = g;
        for (int k = 0; k < PARTIAL_SUMS; k++) sums.of[k][filled] = total[k / 4][k % 4];
        if (++filled == LANES) {
            finish_batch(cloud, scene.view, index, filled, sums, out);
            filled = 0;
        }
    }
    if (filled) finish_batch(cloud, scene.view, index, filled, sums, out);
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
