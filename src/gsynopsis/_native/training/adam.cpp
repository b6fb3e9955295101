// A step of Adam on a stretch of a tensor, as torch's fused one computes it.
#include "simd.hpp"
#include "stages.hpp"

namespace gsyn {
namespace GSYN_VARIANT {

void adam(const Moved &t, float epsilon) {
    constexpr float FRESH = (float)(1 - BETA_MEAN), KEPT = (float)BETA_SQUARE;
    const auto of_lanes = [&](float *values, float *mean, float *square, const float *grad) {
        const Floats g = load(grad);
        const Floats m = load(mean) + FRESH * (g - load(mean));
        const Floats v = KEPT * load(square) + (float)(1 - BETA_SQUARE) * g * g;
        store(mean, m);
        store(square, v);
        store(values, load(values) - t.rate * m / (root(v) * t.root + epsilon));
    };
    int64_t i = 0;
    for (; i + LANES <= t.count; i += LANES) {
        of_lanes(t.values + i, t.mean + i, t.square + i, t.grad + i);
    }
    if (i == t.count) return;
    const size_t rest = (t.count - i) * sizeof(float);
    alignas(64) float last[4][LANES] = {};
    float *const from[3] = {t.values + i, t.mean + i, t.square + i};
    for (int k = 0; k < 3; k++) memcpy(last[k], from[k], rest);
    memcpy(last[3], t.grad + i, rest);
    of_lanes(last[0], last[1], last[2], last[3]);
    for (int k = 0; k < 3; k++) memcpy(from[k], last[k], rest);
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
