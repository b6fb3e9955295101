// Adam as torch's fused one computes it: a step on a stretch, and the steps that a row has missed.
#include "simd.hpp"
#include "stages.hpp"

namespace gsyn {
namespace GSYN_VARIANT {
namespace {

// A vector of weights with its moments; the average only where weights are averaged.
struct Lanes {
    Floats values, mean, square, average;
};

GSYN_INLINE void decay(Lanes &at, Floats g) {
    constexpr float FRESH = (float)(1 - BETA_MEAN), KEPT = (float)BETA_SQUARE;
    at.mean = at.mean + FRESH * (g - at.mean);
    at.square = KEPT * at.square + (float)(1 - BETA_SQUARE) * g * g;
}

GSYN_INLINE void move(Lanes &at, Floats g, float rate, float factor, float epsilon) {
    decay(at, g);
    at.values = at.values - rate * at.mean / (root(at.square) * factor + epsilon);
}

// As torch.lerp from the average to the weights.
GSYN_INLINE void lerp(Lanes &at, float share) {
    const bool small = share < 0.5f;
    const Floats base = small ? at.average : at.values;
    at.average = (small ? share : share - 1.f) * (at.values - at.average) + base;
}

GSYN_INLINE bool same(Floats a, Floats b) { return !any(less(a, b)) && !any(less(b, a)); }

// Whether no later step without a gradient changes the weights. The mean shrinks faster than the
// root of the square, so no later change is larger than `most`, twice what the largest rate gives
// now; and rounding is monotonic. What a mean that has become denormal adds is below 1e-28.
GSYN_INLINE bool at_rest(const Lanes &at, float largest_rate, float epsilon) {
    const Floats size = larger(at.mean, -at.mean);
    const Floats most = 2.f * largest_rate * size / (root(at.square) + epsilon);
    const Floats far = larger(at.values, -at.values), zero{};
    const Floats floor = select(less(zero, size), all(1e-18f), all(-1.f));
    return same(at.values - most, at.values) && same(at.values + most, at.values) &&
           !any(less(far, floor));
}

// Steps from `from` on, one after the other as if no gradient had come. Tests are made now and then
// only: they cost as much as a step.
GSYN_INLINE void replay_lanes(Lanes &at, const Ticks &t, int64_t from, float epsilon) {
    constexpr int64_t SPAN = 16;
    const Floats zero{};
    bool resting = same(at.mean, zero) && same(at.square, zero), still = resting;
    for (int64_t begin = from; begin < t.count; begin += SPAN) {
        const int64_t end = begin + SPAN < t.count ? begin + SPAN : t.count;
        if (still && !t.averages) return;
        const Floats mean = at.mean, square = at.square;
        for (int64_t i = begin; i < end; i++) {
            if (t.factors[i] > 0 && !still) {
                if (resting) {
                    decay(at, zero);
                } else {
                    move(at, zero, t.rates[i], t.factors[i], epsilon);
                }
            }
            if (t.averages && t.shares[i] >= 0) lerp(at, t.shares[i]);
        }
        if (!resting) resting = at_rest(at, t.largest_rate, epsilon);
        // A step that changes neither moment is followed by such steps only.
        if (resting && !still && same(mean, at.mean) && same(square, at.square)) still = true;
    }
}

}  // namespace

void adam(const Moved &t, float epsilon) {
    const auto of_lanes = [&](float *values, float *mean, float *square, const float *grad) {
        Lanes at{load(values), load(mean), load(square), Floats{}};
        move(at, load(grad), t.rate, t.root, epsilon);
        store(mean, at.mean);
        store(square, at.square);
        store(values, at.values);
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

void replay(const LateRow &row, const Ticks &ticks, int64_t from, float epsilon) {
    float *const all_of[4] = {row.values, row.mean, row.square, row.average};
    const int kinds = row.average ? 4 : 3;
    for (int64_t i = 0; i < row.width; i += LANES) {
        const int64_t count = row.width - i < LANES ? row.width - i : LANES;
        alignas(64) float part[4][LANES] = {};
        for (int k = 0; k < kinds; k++) memcpy(part[k], all_of[k] + i, count * sizeof(float));
        Lanes at{load(part[0]), load(part[1]), load(part[2]), load(part[3])};
        replay_lanes(at, ticks, from, epsilon);
        store(part[0], at.values);
        store(part[1], at.mean);
        store(part[2], at.square);
        store(part[3], at.average);
        for (int k = 0; k < kinds; k++) memcpy(all_of[k] + i, part[k], count * sizeof(float));
    }
}

float farthest(const Drift &of, int64_t begin, int64_t end, bool size) {
    float most = -INFINITY;
    for (int64_t i = begin; i < end; i++) {
        const float value = size ? fabsf(of.values[i]) : of.values[i];
        float far = value;
        if (of.mean) far += of.steps * fabsf(of.mean[i]) / (sqrtf(of.square[i]) + of.least);
        most = far > most ? far : most;
    }
    return most;
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
