// Which anchors could touch the image: a frustum test with a margin, LANES anchors at once.
#include "simd.hpp"
#include "stages.hpp"

namespace gsyn {
namespace GSYN_VARIANT {
namespace {

// What the test needs of LANES anchors.
struct Candidates {
    alignas(64) float p[3][LANES], offset_log[LANES], scale_log[LANES], reach[LANES];
    uint8_t live[LANES];
};

GSYN_INLINE float largest(float a, float b) { return a > b ? a : b; }

GSYN_INLINE void gather_anchor(const Anchors &in, int64_t row, int lane, Candidates &to) {
    const float *logs = in.log_scales + 6 * row, *offset = in.offsets + row * in.slots * 3;
    const uint8_t *live = in.live + row * in.slots;
    float reach = 0.f;
    uint8_t any_live = 0;
    for (int k = 0; k < in.slots; k++, offset += 3) {
        const float far = largest(fabsf(offset[0]), largest(fabsf(offset[1]), fabsf(offset[2])));
        any_live |= live[k];
        reach = live[k] && far > reach ? far : reach;
    }
    for (int i = 0; i < 3; i++) to.p[i][lane] = in.positions[3 * row + i];
    to.offset_log[lane] = largest(logs[0], largest(logs[1], logs[2]));
    to.scale_log[lane] = largest(logs[3], largest(logs[4], logs[5]));
    to.reach[lane] = reach;
    to.live[lane] = any_live;
}

// Which of LANES positions, by their margins, could touch the image: 1 or 0.
GSYN_INLINE Floats touching(const View &view, const float (*p)[LANES], Floats margin, float slack) {
    const float *R = view.rotation, *t = view.translation;
    const float left = -view.cx, right = (float)view.width - view.cx;
    const float top = -view.cy, bottom = (float)view.height - view.cy;
    Floats at[3], far{};
    for (int i = 0; i < 3; i++) {
        at[i] = R[3 * i] * load(p[0]) + R[3 * i + 1] * load(p[1]) + R[3 * i + 2] * load(p[2]) +
                t[i];
        far = far + larger(load(p[i]), -load(p[i])) + fabsf(t[i]);
    }
    if (slack > 0.f) margin = margin + slack * (margin + far);
    const Floats inverse = 1.f / larger(at[2], all(5.f * NEAR_PLANE));
    const Floats x = view.fx * at[0] * inverse, wide = view.fx * margin * inverse;
    const Floats y = view.fy * at[1] * inverse, high = view.fy * margin * inverse;
    Mask inside = both(less(all(NEAR_PLANE), at[2] + margin), less(all(left), x + wide));
    inside = both(inside, both(less(x - wide, all(right)), less(all(top), y + high)));
    inside = both(inside, less(y - high, all(bottom)));
    return select(inside, all(1.f), Floats{});
}

}  // namespace

void cull(const Anchors &in, const View &view, int64_t begin, int64_t end, uint8_t *seen) {
    for (int64_t start = begin; start < end; start += LANES) {
        Candidates c;
        for (int i = 0; i < LANES; i++) {
            gather_anchor(in, start + i < end ? start + i : end - 1, i, c);
        }
        const Floats margin = 3.f * in.gain * exp_of(load(c.scale_log)) +
                              load(c.reach) * exp_of(load(c.offset_log));
        const Floats mark = touching(view, c.p, margin, 0.f);
        for (int i = 0; i < LANES && start + i < end; i++) {
            seen[start + i] = mark[i] > 0.f && c.live[i];
        }
    }
}

void cull_wide(const Wide &in, const View &view, int64_t begin, int64_t end, uint8_t *seen) {
    constexpr float SLACK = 1e-4f;  // far more than rounding anywhere in the two tests
    for (int64_t start = begin; start < end; start += LANES) {
        alignas(64) float p[3][LANES], size[LANES], reach[LANES];
        for (int i = 0; i < LANES; i++) {
            const int64_t row = start + i < end ? start + i : end - 1;
            for (int k = 0; k < 3; k++) p[k][i] = in.positions[3 * row + k];
            size[i] = in.size[row];
            reach[i] = in.reach[row];
        }
        const Floats margin = 3.f * in.gain * load(size) + load(reach);
        const Floats mark = touching(view, p, margin, SLACK);
        for (int i = 0; i < LANES && start + i < end; i++) seen[start + i] = mark[i] > 0.f;
    }
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
