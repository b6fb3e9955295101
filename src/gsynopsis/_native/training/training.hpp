// What training computes beside drawing: the slots of visible anchors as Gaussians, and the loss.
//
// Each has a plain PyTorch twin (model/assemble.py, training/losses.py). Sums run in a fixed order, so
// the bits do not depend on the number of threads.
#pragma once

#include <cstdint>
#include <vector>

namespace gsyn {

struct Kernels;

struct View;

// All N anchors, as far as culling looks at them.
struct Anchors {
    int64_t count;
    int slots;
    float gain;  // largest factor on the scales of Gaussians
    const float *positions, *log_scales, *offsets;  // as in Slots
    const uint8_t *live;
};

// V visible anchors of N, K slots each; the three heads' outputs before their activations.
struct Slots {
    int64_t visible;
    int slots;
    const int64_t *rows;      // [V] rows of the tables below
    const uint8_t *live;      // [N, K]
    const float *opacity;     // [V, K]
    const float *cov;         // [V, 7K]: three scales, a quaternion
    const float *color;       // [V, 3K]
    const float *positions;   // [N, 3]
    const float *log_scales;  // [N, 6]: of offsets, of Gaussians
    const float *offsets;     // [N, K, 3]
    const float *log_gain;    // [3]
};

// The drawn slots of anchor v are Gaussians starts[v] up to starts[v + 1].
struct Drawn {
    const float *activated;  // [V, K] tanh of opacity
    const int64_t *starts;   // [V + 1]
    int64_t count;           // G
    int *foreign;            // set, and the anchor left out, where these are not of its slots
};

struct DrawnOut {
    float *means, *quats, *scales, *opacities, *colors;  // [G, 3 4 3 1 3]
    int64_t *slots;                                      // [G] row · K + slot
};

struct DrawnGradients {
    const float *means, *quats, *scales, *opacities, *colors;  // as in DrawnOut
};

struct SlotGradients {
    float *opacity, *cov, *color;  // as in Slots, all written
    float *log_scales, *offsets;   // as in Slots
    float *log_gain;               // [V, 3] each anchor's share
    int64_t anchors;               // N
    bool add;  // to what is in log_scales and offsets; else all is written, zero where nothing is seen
};

// Images as rows of W · 3 floats.
struct LossImages {
    int height, length;
    const float *image, *target;  // [H, length]
    float *grad;                  // [H, length], or null
    float ssim_weight;
};

// What one thread compares at once: columns of floats and rows, the latter ends excluded.
struct LossPatch {
    int left, right, top, bottom;
};

struct LossSums {
    double difference, similarity;  // of |a - b| and of SSIM
};

constexpr int SSIM_RADIUS = 5;
constexpr int LOSS_WIDTH = 480, LOSS_HEIGHT = 128;  // of a patch at most: its sums stay in a cache
constexpr int LOSS_REACH = 16;  // at least 3 · SSIM_RADIUS, whole vectors
// Floats that a patch needs: rows of photos, of slopes, and eleven each of the sums of both.
constexpr int LOSS_ROOM = 5 * (LOSS_WIDTH + 4 * LOSS_REACH) + 3 * (LOSS_WIDTH + 2 * LOSS_REACH) +
                          (2 * SSIM_RADIUS + 1) * (8 * LOSS_WIDTH + 10 * LOSS_REACH);

// Writes the rows of anchors that could touch the image, ascending; returns their number. `seen`
// has room for all anchors.
int64_t visible_rows(const Kernels &, const Anchors &, const View &, uint8_t *seen, int64_t *rows,
                     int threads);
// tanh of all opacities into `activated`, and starts; returns G.
int64_t count_drawn(const Kernels &, const Slots &, float *activated, int64_t *starts, int threads);
void assemble(const Kernels &, const Slots &, const Drawn &, const DrawnOut &, int threads);
// Rows of `width` floats, from `stride` floats on to the next, into those rows of [N, width]: added,
// or else written, and zeros into all others.
struct ScatteredRows {
    int64_t count, anchors;  // V, N
    const int64_t *rows;     // [V] ascending
    const float *from;       // [V, stride]
    int64_t stride, width;
    float *to;               // [N, width]
    bool add;
};
void scatter_rows(const ScatteredRows &, int threads);
// Where rows of [N, width] are not among `rows`, before each of the rows begin to end and behind the
// last of all `count`: zeros.
void clear_others(const int64_t *rows, int64_t begin, int64_t end, int64_t count, int64_t anchors,
                  int64_t width, float *to);
// `log_gain` is the sum over all anchors, [3].
void assemble_backward(const Kernels &, const Slots &, const Drawn &, const DrawnGradients &,
                       const SlotGradients &, float *log_gain, int threads);

// What growth counts of one view: of each Gaussian its slot, of each visible anchor its row.
struct Counted {
    int64_t count, visible;
    int slots;
    const int64_t *at, *rows;    // [G] flat slots, [V] rows, each at most once
    const float *screen_grad;    // [G, 2] 1/pixels
    const uint8_t *shown;        // [G] passed culling
    const float *opacity;        // [V, K]
    float half_width, half_height;
    float *gradient, *drawn;     // [N K] added to
    float *opacities, *visits;   // [N] added to
};
void count_view(const Counted &, int threads);

// The mean product of three scales, and its gradient [G, 3] if `grad` is not null.
double mean_volume(const float *scales, int64_t count, float *grad);

// The mean squared difference of two arrays: sums of parts, added in their order.
double mean_squared(const float *one, const float *other, int64_t count, int threads);

// Bytes divided by 255.
void in_unit(const uint8_t *bytes, int64_t count, float *to, int threads);

// A tensor that Adam moves, with its moments.
struct Moved {
    int64_t count;
    float *values, *mean, *square;
    const float *grad;
    float rate;  // learning rate / (1 − β₁ᵗ)
    float root;  // 1 / √(1 − β₂ᵗ)
};
constexpr double BETA_MEAN = 0.9, BETA_SQUARE = 0.999;
void adam(const Kernels &, const std::vector<Moved> &, float epsilon, int threads);

// (1 − λ) · L1 + λ · (1 − SSIM) and its gradient with respect to the image, if `grad` is not null.
double photometric(const Kernels &, const LossImages &, int threads);

}  // namespace gsyn
