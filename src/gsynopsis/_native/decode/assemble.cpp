// Head outputs of visible anchors to Gaussians and back, anchor by anchor.
#include "limits.gen.hpp"
#include "simd.hpp"
#include "stages.hpp"

namespace gsyn {
namespace GSYN_VARIANT {
namespace {

constexpr int ROOM = 6 * SLOTS_MAX + LANES;

// σ(values) in place; the array has room for a whole vector more.
GSYN_INLINE void sigmoid_all(float *values, int count) {
    for (int i = 0; i < count; i += LANES) {
        store(values + i, 1.f / (1.f + exp_of(-load(values + i))));
    }
}

struct Anchor {
    int64_t row;
    float base[6], gain[3];
};

GSYN_INLINE Anchor anchor_of(const Slots &in, int64_t v) {
    Anchor a;
    a.row = in.rows[v];
    alignas(64) float logs[LANES < 16 ? 16 : LANES] = {};
    for (int i = 0; i < 6; i++) logs[i] = in.log_scales[6 * a.row + i];
    for (int i = 0; i < 3; i++) logs[6 + i] = in.log_gain[i];
    for (int i = 0; i < 9; i += LANES) store(logs + i, exp_of(load(logs + i)));
    for (int i = 0; i < 6; i++) a.base[i] = logs[i];
    for (int i = 0; i < 3; i++) a.gain[i] = logs[6 + i];
    return a;
}

GSYN_INLINE bool drawn(const Slots &in, const float *activated, int64_t v, int64_t row, int k) {
    return activated[v * in.slots + k] > 0.f && in.live[row * in.slots + k];
}

// σ of the three scales and the three colours of each drawn slot, six after six; their slots too.
GSYN_INLINE int gather(const Slots &in, const float *activated, int64_t v, int64_t row, int *slot,
                       float *six) {
    int count = 0;
    for (int k = 0; k < in.slots; k++) {
        if (!drawn(in, activated, v, row, k)) continue;
        const float *cov = in.cov + (v * in.slots + k) * 7;
        const float *color = in.color + (v * in.slots + k) * 3;
        for (int i = 0; i < 3; i++) six[6 * count + i] = cov[i];
        for (int i = 0; i < 3; i++) six[6 * count + 3 + i] = color[i];
        slot[count++] = k;
    }
    sigmoid_all(six, 6 * count);
    return count;
}

// Whether the Gaussians that are said to be this anchor's can be: as many as it draws, and in reach.
// A caller that changed these arrays must not make a kernel write outside of others.
GSYN_INLINE bool owned(const Drawn &which, int64_t v, int count) {
    const int64_t from = which.starts[v], to = which.starts[v + 1];
    if (from >= 0 && to <= which.count && to - from == count) return true;
    __atomic_store_n(which.foreign, 1, __ATOMIC_RELAXED);
    return false;
}

GSYN_INLINE float length_of(const float *q) {
    const float norm = sqrtf(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    return norm < 1e-12f ? 1e-12f : norm;
}

}  // namespace

void activate(const Slots &in, int64_t begin, int64_t end, float *activated, int64_t *counts) {
    const int64_t first = begin * in.slots, last = end * in.slots;
    int64_t i = first;
    for (; i + LANES <= last; i += LANES) {
        store(activated + i, 1.f - 2.f / (1.f + exp_of(2.f * load(in.opacity + i))));
    }
    for (; i < last; i++) {
        activated[i] = (1.f - 2.f / (1.f + exp_of(2.f * all(in.opacity[i]))))[0];
    }
    for (int64_t v = begin; v < end; v++) {
        counts[v] = 0;
        for (int k = 0; k < in.slots; k++) counts[v] += drawn(in, activated, v, in.rows[v], k);
    }
}

void assemble(const Slots &in, const Drawn &which, int64_t begin, int64_t end,
              const DrawnOut &out) {
    alignas(64) float six[ROOM] = {};
    int slot[SLOTS_MAX];
    for (int64_t v = begin; v < end; v++) {
        const Anchor a = anchor_of(in, v);
        const int count = gather(in, which.activated, v, a.row, slot, six);
        if (!owned(which, v, count)) continue;
        for (int j = 0; j < count; j++) {
            const int64_t g = which.starts[v] + j, from = v * in.slots + slot[j];
            const float *offset = in.offsets + (a.row * in.slots + slot[j]) * 3;
            const float *q = in.cov + from * 7 + 3;
            const float norm = length_of(q);
            for (int i = 0; i < 3; i++) {
                out.means[3 * g + i] = in.positions[3 * a.row + i] + offset[i] * a.base[i];
                out.scales[3 * g + i] = a.base[3 + i] * six[6 * j + i] * a.gain[i];
                out.colors[3 * g + i] = six[6 * j + 3 + i];
            }
            for (int i = 0; i < 4; i++) out.quats[4 * g + i] = q[i] / norm;
            out.opacities[g] = which.activated[from];
            out.slots[g] = a.row * in.slots + slot[j];
        }
    }
}

void assemble_backward(const Slots &in, const Drawn &which, int64_t begin, int64_t end,
                       const DrawnGradients &grad, const SlotGradients &out) {
    alignas(64) float six[ROOM] = {};
    int slot[SLOTS_MAX];
    const int K = in.slots;
    memset(out.opacity + begin * K, 0, (end - begin) * K * sizeof(float));
    memset(out.cov + begin * 7 * K, 0, (end - begin) * 7 * K * sizeof(float));
    memset(out.color + begin * 3 * K, 0, (end - begin) * 3 * K * sizeof(float));
    for (int64_t v = begin; v < end; v++) {
        const Anchor a = anchor_of(in, v);
        const int count = gather(in, which.activated, v, a.row, slot, six);
        float logs[6] = {}, gain[3] = {};
        float *const table = out.offsets + a.row * K * 3, *const sizes = out.log_scales + 6 * a.row;
        if (!out.add) memset(table, 0, 3 * K * sizeof *table);
        if (!owned(which, v, count)) continue;
        for (int j = 0; j < count; j++) {
            const int64_t g = which.starts[v] + j, to = v * K + slot[j];
            const float *offset = in.offsets + (a.row * K + slot[j]) * 3;
            float *along_offset = table + 3 * slot[j];
            for (int i = 0; i < 3; i++) {
                const float along = grad.means[3 * g + i] * a.base[i];
                along_offset[i] = out.add ? along_offset[i] + along : along;
                logs[i] += along * offset[i];
                const float s = six[6 * j + i], c = six[6 * j + 3 + i];
                const float size = grad.scales[3 * g + i] * a.base[3 + i] * s * a.gain[i];
                logs[3 + i] += size;
                gain[i] += size;
                out.cov[7 * to + i] = size * (1.f - s);
                out.color[3 * to + i] = grad.colors[3 * g + i] * c * (1.f - c);
            }
            const float *q = in.cov + to * 7 + 3, *gq = grad.quats + 4 * g;
            const float norm = length_of(q);
            const float inner =
                (q[0] * gq[0] + q[1] * gq[1] + q[2] * gq[2] + q[3] * gq[3]) / (norm * norm);
            // Where the norm is limited it is a constant, as in the twin.
            const float along = norm > 1e-12f ? inner : 0.f;
            for (int i = 0; i < 4; i++) out.cov[7 * to + 3 + i] = (gq[i] - q[i] * along) / norm;
            const float t = which.activated[to];
            out.opacity[to] = grad.opacities[g] * (1.f - t * t);
        }
        for (int i = 0; i < 6; i++) sizes[i] = out.add ? sizes[i] + logs[i] : logs[i];
        for (int i = 0; i < 3; i++) out.log_gain[3 * v + i] = gain[i];
    }
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
