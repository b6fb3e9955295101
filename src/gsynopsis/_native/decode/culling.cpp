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

}  // namespace

void cull(const Anchors &in, const View &view, int64_t begin, int64_t end, uint8_t *seen) {
    const float *R = view.rotation, *t = view.translation;
    const float left = -view.cx, right = (float)view.width - view.cx;
    const float top = -view.cy, bottom = (float)view.height - view.cy;
    for (int64_t start = begin; start < end; start += LANES) {
        Candidates c;
        for (int i = 0; i < LANES; i++) {
            gather_anchor(in, start + i < end ? start + i : end - 1, i, c);
        }
        const Floats margin = 3.f * in.gain * exp_of(load(c.scale_log)) +
                              load(c.reach) * exp_of(load(c.offset_log));
        Floats at[3];
        for (int i = 0; i < 3; i++) {
            at[i] = R[3 * i] * load(c.p[0]) + R[3 * i + 1] * load(c.p[1]) +
                    R[3 * i + 2] * load(c.p[2]) + t[i];
        }
        const Floats inverse = 1.f / larger(at[2], all(5.f * NEAR_PLANE));
        const Floats x = view.fx * at[0] * inverse, wide = view.fx * margin * inverse;
        const Floats y = view.fy * at[1] * inverse, high = view.fy * margin * inverse;
        Mask inside = both(less(all(NEAR_PLANE), at[2] + margin), less(all(left), x + wide));
        inside = both(inside, both(less(x - wide, all(right)), less(all(top), y + high)));
        inside = both(inside, less(y - high, all(bottom)));
        const Floats mark = select(inside, all(1.f), Floats{});
        for (int i = 0; i < LANES && start + i < end; i++) {
            seen[start + i] = mark[i] > 0.f && c.live[i];
        }
    }
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
