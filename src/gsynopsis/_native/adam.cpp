// One step of Adam, as torch's fused one computes it.
#include "simd.hpp"
#include "stages.hpp"

namespace gsyn {
namespace GSYN_VARIANT {
namespace {

GSYN_INLINE void move(const Moved &t, float epsilon, float *values, float *mean, float *square,
                      const float *grad) {
    constexpr float FRESH = (float)(1 - BETA_MEAN), KEPT = (float)BETA_SQUARE;
    const Floats g = load(grad), before = load(mean);
    const Floats m = before + FRESH * (g - before);
    const Floats s = KEPT * load(square) + (float)(1 - BETA_SQUARE) * g * g;
    store(mean, m);
    store(square, s);
    store(values, load(values) - t.rate * m / (root(s) * t.root + epsilon));
}

}  // namespace

void adam(const Moved &t, float epsilon) {
    int64_t i = 0;
    for (; i + LANES <= t.count; i += LANES) {
        move(t, epsilon, t.values + i, t.mean + i, t.square + i, t.grad + i);
    }
    if (i == t.count) return;
    const size_t rest = (t.count - i) * sizeof(float);
    alignas(64) float last[4][LANES] = {};
    float *const from[3] = {t.values + i, t.mean + i, t.square + i};
    for (int k = 0; k < 3; k++) memcpy(last[k], from[k], rest);
    memcpy(last[3], t.grad + i, rest);
    move(t, epsilon, last[0], last[1], last[2], last[3]);
    for (int k = 0; k < 3; k++) memcpy(from[k], last[k], rest);
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
