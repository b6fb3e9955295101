// L1 and SSIM with an 11-tap Gaussian window, separable, and their gradient, row by row.
//
// Three passes, each over all rows: sums along rows; sums along columns, SSIM and its slopes, those
// summed along rows; the slopes' sums along columns. A row holds three interleaved channels, so a
// tap is three floats on.
#include "simd.hpp"
#include "stages.hpp"

namespace gsyn {
namespace GSYN_VARIANT {
namespace {

constexpr int TAPS = 2 * SSIM_RADIUS + 1;
constexpr float C1 = 0.01f * 0.01f, C2 = 0.03f * 0.03f;

// σ = 1.5, sum 1.
constexpr float WINDOW[TAPS] = {0.00102838008f, 0.00759875814f, 0.0360007721f, 0.10936069f,
                                0.213005538f,   0.266011725f,   0.213005538f,  0.10936069f,
                                0.0360007721f,  0.00759875814f, 0.00102838008f};

GSYN_INLINE Floats along_row(const float *padded, int at) {
    Floats sum{};
    for (int k = 0; k < TAPS; k++) {
        sum += WINDOW[k] * load(padded + MARGIN + at + 3 * (k - SSIM_RADIUS));
    }
    return sum;
}

GSYN_INLINE Floats along_column(const LossRows &in, const float *plane, int y, int at) {
    Floats sum{};
    for (int k = 0; k < TAPS; k++) {
        const int row = y + k - SSIM_RADIUS;
        if (row >= 0 && row < in.height) {
            sum += WINDOW[k] * load(plane + (int64_t)row * in.stride + at);
        }
    }
    return sum;
}

GSYN_INLINE void clear_margins(float *padded, int length, int stride) {
    memset(padded, 0, MARGIN * sizeof(float));
    memset(padded + MARGIN + length, 0, (stride - length + MARGIN) * sizeof(float));
}

}  // namespace

double loss_rows(const LossRows &in, int y) {
    const int room = in.stride + 2 * MARGIN;
    const float *a = in.image + (int64_t)y * in.length, *b = in.target + (int64_t)y * in.length;
    float *p[5];
    for (int q = 0; q < 5; q++) {
        p[q] = in.padded + q * room;
        clear_margins(p[q], in.length, in.stride);
    }
    double difference = 0;
    for (int i = 0; i < in.length; i++) {
        difference += fabsf(a[i] - b[i]);
        p[0][MARGIN + i] = a[i];
        p[1][MARGIN + i] = b[i];
        p[2][MARGIN + i] = a[i] * a[i];
        p[3][MARGIN + i] = b[i] * b[i];
        p[4][MARGIN + i] = a[i] * b[i];
    }
    const int64_t plane = (int64_t)in.height * in.stride;
    for (int q = 0; q < 5; q++) {
        float *to = in.sums + q * plane + (int64_t)y * in.stride;
        for (int i = 0; i < in.stride; i += LANES) store(to + i, along_row(p[q], i));
    }
    return difference;
}

double loss_columns(const LossRows &in, int y) {
    const int64_t plane = (int64_t)in.height * in.stride;
    const int room = in.stride + 2 * MARGIN;
    float *p[3], *value = in.padded + 3 * room;
    for (int q = 0; q < 3; q++) p[q] = in.padded + q * room + MARGIN;
    for (int i = 0; i < in.stride; i += LANES) {
        Floats m[5];
        for (int q = 0; q < 5; q++) m[q] = along_column(in, in.sums + q * plane, y, i);
        const Floats a = m[0], b = m[1];
        const Floats t1 = 2.f * a * b + C1, t2 = 2.f * (m[4] - a * b) + C2;
        const Floats b1 = a * a + b * b + C1, b2 = m[2] - a * a + (m[3] - b * b) + C2;
        const Floats r1 = 1.f / b1, r2 = 1.f / b2;
        const Floats s = t1 * t2 * r1 * r2;
        const Floats cross = 2.f * t1 * r1 * r2;
        store(value + i, s);
        store(p[0] + i, 2.f * b * t2 * r1 * r2 - b * cross + 2.f * a * s * (r2 - r1));
        store(p[1] + i, -s * r2);
        store(p[2] + i, cross);
    }
    double sum = 0;
    for (int i = 0; i < in.length; i++) sum += value[i];
    if (!in.slopes) return sum;
    for (int q = 0; q < 3; q++) {
        clear_margins(p[q] - MARGIN, in.length, in.stride);
        float *to = in.slopes + q * plane + (int64_t)y * in.stride;
        for (int i = 0; i < in.stride; i += LANES) store(to + i, along_row(p[q] - MARGIN, i));
    }
    return sum;
}

void loss_gradient(const LossRows &in, int y, float *grad) {
    const int64_t plane = (int64_t)in.height * in.stride;
    const float *a = in.image + (int64_t)y * in.length, *b = in.target + (int64_t)y * in.length;
    float *to = grad + (int64_t)y * in.length, *slope = in.padded;
    const int room = in.stride + 2 * MARGIN;
    for (int q = 0; q < 3; q++) {
        for (int i = 0; i < in.stride; i += LANES) {
            store(slope + q * room + i, along_column(in, in.slopes + q * plane, y, i));
        }
    }
    const float count = (float)in.height * in.length;
    const float l1 = (1.f - in.ssim_weight) / count, similar = in.ssim_weight / count;
    for (int i = 0; i < in.length; i++) {
        const float side = (float)(a[i] > b[i]) - (float)(a[i] < b[i]);
        const float rise = slope[i] + 2.f * a[i] * slope[room + i] + b[i] * slope[2 * room + i];
        to[i] = l1 * side - similar * rise;
    }
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
