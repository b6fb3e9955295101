// L1 and SSIM with an 11-tap Gaussian window, separable, and their gradient, patch by patch.
//
// Down a patch, each row of the photos that enters brings: its sums along the row; five rows above
// it, the sums along columns, SSIM, its slopes and their sums along the row; five rows above that,
// the slopes' sums along columns and so the gradient. Only eleven rows of sums are kept, in the
// cache. A row holds three interleaved channels, so a tap is three floats on.
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

static_assert(LOSS_REACH >= 3 * SSIM_RADIUS && LOSS_REACH % LANES == 0 && LOSS_WIDTH % LANES == 0,
              "whole vectors reach as far as the window");

// A patch's own memory: rows of photos begin 2 · LOSS_REACH floats left of the patch, rows of sums
// LOSS_REACH, the slopes' sums with it.
struct Rows {
    Rows(const LossPatch &patch, float *at)
        : width((patch.right - patch.left + LANES - 1) / LANES * LANES),
          wide(width + 2 * LOSS_REACH), photos(at), slopes(photos + 5 * (wide + 2 * LOSS_REACH)),
          sums(slopes + 3 * wide), sloped(sums + TAPS * 5 * wide) {}
    float *sums_of(int y) const { return sums + y % TAPS * (5 * wide); }
    float *sloped_of(int y) const { return sloped + y % TAPS * (3 * width); }
    const int width, wide;
    float *const photos, *const slopes;  // one row of a, b, a², b², ab; one row of slopes by them
    float *const sums, *const sloped;    // the last rows of the sums of either along rows
};

GSYN_INLINE Floats along_row(const float *from) {
    Floats sum{};
    for (int k = 0; k < TAPS; k++) sum += WINDOW[k] * load(from + 3 * (k - SSIM_RADIUS));
    return sum;
}

// The rows that a window about row y has in the image.
struct Column {
    const float *rows[TAPS];
    float weights[TAPS];
    int count = 0;
    template <class F>
    Column(int y, int height, const F &row_of) {
        for (int k = 0; k < TAPS; k++) {
            const int row = y + k - SSIM_RADIUS;
            if (row < 0 || row >= height) continue;
            rows[count] = row_of(row);
            weights[count++] = WINDOW[k];
        }
    }
};

template <int COUNT>
GSYN_INLINE Floats along_column(const Column &column, int at) {
    Floats sum{};
    const int count = COUNT ? COUNT : column.count;
    for (int k = 0; k < count; k++) {
        sum += (COUNT ? WINDOW[k] : column.weights[k]) * load(column.rows[k] + at);
    }
    return sum;
}

// The sum of row[begin, end).
GSYN_INLINE double sum_of(const float *row, int begin, int end) {
    Floats sums{};
    int i = begin;
    for (; i + LANES <= end; i += LANES) sums += load(row + i);
    double sum = 0;
    for (int k = 0; k < LANES; k++) sum += sums[k];
    for (; i < end; i++) sum += row[i];
    return sum;
}

// Zeros where a row that begins at the image's column `first` is beyond its `length`.
GSYN_INLINE void clear_beyond(float *row, int count, int first, int length) {
    for (int i = 0; i < count && first + i < 0; i++) row[i] = 0;
    for (int i = count - 1; i >= 0 && first + i >= length; i--) row[i] = 0;
}

// One row of the photos and its sums along the row; returns the sum of differences.
double enter(const LossImages &in, const LossPatch &patch, const Rows &rows, int y) {
    const int first = patch.left - 2 * LOSS_REACH, room = rows.wide + 2 * LOSS_REACH;
    const int begin = first < 0 ? -first : 0;
    const int end = in.length - first < room ? in.length - first : room;
    const float *a = in.image + (int64_t)y * in.length + first;
    const float *b = in.target + (int64_t)y * in.length + first;
    float *p[5];
    for (int q = 0; q < 5; q++) {
        p[q] = rows.photos + q * room;
        clear_beyond(p[q], room, first, in.length);
    }
    for (int i = begin; i < end; i++) {
        p[0][i] = a[i];
        p[1][i] = b[i];
        p[2][i] = a[i] * a[i];
        p[3][i] = b[i] * b[i];
        p[4][i] = a[i] * b[i];
    }
    float *to = rows.sums_of(y);
    for (int q = 0; q < 5; q++) {
        for (int i = 0; i < rows.wide; i += LANES) {
            store(to + q * rows.wide + i, along_row(p[q] + LOSS_REACH + i));
        }
    }
    float *apart = p[2];  // whose sums are taken
    const int left = 2 * LOSS_REACH, right = left + patch.right - patch.left;
    for (int i = left; i < right; i++) apart[i] = fabsf(p[0][i] - p[1][i]);
    return sum_of(apart, left, right);
}

// SSIM of one row, its slopes and their sums along the row; returns the sum of SSIM.
template <int COUNT>
double compare(const LossImages &in, const LossPatch &patch, const Rows &rows, int y) {
    const Column column(y, in.height, [&](int row) { return rows.sums_of(row); });
    const int wide = rows.wide;
    float *p[3], *value = rows.photos;
    for (int q = 0; q < 3; q++) p[q] = rows.slopes + q * wide;
    for (int i = 0; i < wide; i += LANES) {
        Floats m[5];
        for (int q = 0; q < 5; q++) m[q] = along_column<COUNT>(column, q * wide + i);
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
    float *to = rows.sloped_of(y);
    for (int q = 0; in.grad && q < 3; q++) {
        clear_beyond(p[q], wide, patch.left - LOSS_REACH, in.length);
        for (int i = 0; i < rows.width; i += LANES) {
            store(to + q * rows.width + i, along_row(p[q] + LOSS_REACH + i));
        }
    }
    return sum_of(value, LOSS_REACH, LOSS_REACH + patch.right - patch.left);
}

template <int COUNT>
void descend(const LossImages &in, const LossPatch &patch, const Rows &rows, int y) {
    const Column column(y, in.height, [&](int row) { return rows.sloped_of(row); });
    const int64_t from = (int64_t)y * in.length + patch.left;
    const float *a = in.image + from, *b = in.target + from;
    float *to = in.grad + from, *slope = rows.slopes;
    for (int q = 0; q < 3; q++) {
        for (int i = 0; i < rows.width; i += LANES) {
            store(slope + q * rows.wide + i, along_column<COUNT>(column, q * rows.width + i));
        }
    }
    const float count = (float)in.height * in.length;
    const float l1 = (1.f - in.ssim_weight) / count, similar = in.ssim_weight / count;
    const float *second = slope + rows.wide, *third = second + rows.wide;
    for (int i = 0; i < patch.right - patch.left; i++) {
        const float side = (float)(a[i] > b[i]) - (float)(a[i] < b[i]);
        const float rise = slope[i] + 2.f * a[i] * second[i] + b[i] * third[i];
        to[i] = l1 * side - similar * rise;
    }
}

}  // namespace

LossSums loss_patch(const LossImages &in, const LossPatch &patch, float *memory) {
    const Rows rows(patch, memory);
    const auto within = [](int y, int begin, int end) { return y >= begin && y < end; };
    const auto whole = [&](int y) { return within(y, SSIM_RADIUS, in.height - SSIM_RADIUS); };
    const int around = in.grad ? SSIM_RADIUS : 0;  // rows whose slopes reach the patch
    const int above = patch.top > around ? patch.top - around : 0;
    const int below = patch.bottom + around < in.height ? patch.bottom + around : in.height;
    LossSums sums{};
    for (int y = above - SSIM_RADIUS; y < patch.bottom + around + SSIM_RADIUS; y++) {
        if (within(y, 0, in.height)) {
            const double difference = enter(in, patch, rows, y);
            if (within(y, patch.top, patch.bottom)) sums.difference += difference;
        }
        const int middle = y - SSIM_RADIUS, last = middle - SSIM_RADIUS;
        if (within(middle, above, below)) {
            const double similarity = whole(middle) ? compare<TAPS>(in, patch, rows, middle)
                                                    : compare<0>(in, patch, rows, middle);
            if (within(middle, patch.top, patch.bottom)) sums.similarity += similarity;
        }
        if (!in.grad || !within(last, patch.top, patch.bottom)) continue;
        if (whole(last)) {
            descend<TAPS>(in, patch, rows, last);
        } else {
            descend<0>(in, patch, rows, last);
        }
    }
    return sums;
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
