// Threads and memory of the training kernels; the hot loops are compiled once per instruction set.
#include "training/training.hpp"

#include <cmath>
#include <cstring>
#include <vector>

#include "raster/frame.hpp"
#include "pool.hpp"

namespace gsyn {
namespace {

constexpr int64_t PART = 256;  // anchors a task

int64_t parts_of(int64_t count) { return (count + PART - 1) / PART; }
int64_t end_of(int64_t part, int64_t count) {
    return (part + 1) * PART < count ? (part + 1) * PART : count;
}

}  // namespace

int64_t visible_rows(const Kernels &kernels, const Anchors &in, const View &view, uint8_t *seen,
                     int64_t *rows, int threads) {
    const int64_t parts = parts_of(in.count);
    share(parts, threads, [&](int64_t p, int) {
        kernels.cull(in, view, p * PART, end_of(p, in.count), seen);
    });
    int64_t found = 0;
    for (int64_t n = 0; n < in.count; n++) {
        rows[found] = n;
        found += seen[n];
    }
    return found;
}

int64_t count_drawn(const Kernels &kernels, const Slots &in, float *activated, int64_t *starts,
                    int threads) {
    const int64_t parts = parts_of(in.visible);
    share(parts, threads, [&](int64_t p, int) {
        kernels.activate(in, p * PART, end_of(p, in.visible), activated, starts + 1);
    });
    starts[0] = 0;
    for (int64_t v = 0; v < in.visible; v++) starts[v + 1] += starts[v];
    return starts[in.visible];
}

void assemble(const Kernels &kernels, const Slots &in, const Drawn &which, const DrawnOut &out,
              int threads) {
    const int64_t parts = parts_of(in.visible);
    share(parts, threads, [&](int64_t p, int) {
        kernels.assemble(in, which, p * PART, end_of(p, in.visible), out);
    });
}

void assemble_backward(const Kernels &kernels, const Slots &in, const Drawn &which,
                       const DrawnGradients &grad, const SlotGradients &out, float *log_gain,
                       int threads) {
    const int64_t parts = parts_of(in.visible) + (in.visible == 0);
    const auto clear = [&](int64_t begin, int64_t end, int64_t width, float *to) {
        clear_others(in.rows, begin, end, in.visible, out.anchors, width, to);
    };
    share(parts, threads, [&](int64_t p, int) {
        const int64_t begin = p * PART, end = end_of(p, in.visible);
        if (!out.add) {
            clear(begin, end, 6, out.log_scales);
            clear(begin, end, 3 * in.slots, out.offsets);
        }
        kernels.assemble_backward(in, which, begin, end, grad, out);
    });
    double sums[3] = {};
    for (int64_t v = 0; v < in.visible; v++) {
        for (int i = 0; i < 3; i++) sums[i] += out.log_gain[3 * v + i];
    }
    for (int i = 0; i < 3; i++) log_gain[i] = static_cast<float>(sums[i]);
}

void clear_others(const int64_t *rows, int64_t begin, int64_t end, int64_t count, int64_t anchors,
                  int64_t width, float *to) {
    for (int64_t v = begin; v <= (end == count ? count : end - 1); v++) {
        const int64_t from = v ? rows[v - 1] + 1 : 0, until = v < count ? rows[v] : anchors;
        if (from < until) std::memset(to + from * width, 0, (until - from) * width * sizeof *to);
    }
}

void scatter_rows(const ScatteredRows &in, int threads) {
    const int64_t parts = parts_of(in.count) + (in.count == 0);
    share(parts, threads, [&](int64_t p, int) {
        const int64_t begin = p * PART, end = end_of(p, in.count);
        if (!in.add) clear_others(in.rows, begin, end, in.count, in.anchors, in.width, in.to);
        for (int64_t v = begin; v < end; v++) {
            const float *from = in.from + v * in.stride;
            float *to = in.to + in.rows[v] * in.width;
            if (in.add) {
                for (int64_t i = 0; i < in.width; i++) to[i] += from[i];
            } else {
                std::memcpy(to, from, in.width * sizeof *to);
            }
        }
    });
}

void count_view(const Counted &in, int threads) {
    share(parts_of(in.count), threads, [&](int64_t p, int) {
        for (int64_t g = p * PART; g < end_of(p, in.count); g++) {
            if (!in.shown[g]) continue;
            const float x = in.screen_grad[2 * g] * in.half_width;
            const float y = in.screen_grad[2 * g + 1] * in.half_height;
            in.gradient[in.at[g]] += std::sqrt(x * x + y * y);
            in.drawn[in.at[g]] += 1;
        }
    });
    share(parts_of(in.visible), threads, [&](int64_t p, int) {
        for (int64_t v = p * PART; v < end_of(p, in.visible); v++) {
            const float *opacity = in.opacity + v * in.slots;
            float sum = 0;
            for (int k = 0; k < in.slots; k++) sum += opacity[k] > 0 ? opacity[k] : 0;
            in.opacities[in.rows[v]] += sum;
            in.visits[in.rows[v]] += 1;
        }
    });
}

double mean_volume(const float *scales, int64_t count, float *grad) {
    const float share = 1.f / static_cast<float>(count);
    double sum = 0;
    for (int64_t g = 0; g < count; g++) {
        const float a = scales[3 * g], b = scales[3 * g + 1], c = scales[3 * g + 2];
        sum += a * b * c;
        if (!grad) continue;
        grad[3 * g] = share * (b * c);
        grad[3 * g + 1] = share * (a * c);
        grad[3 * g + 2] = share * (a * b);
    }
    return sum / static_cast<double>(count);
}

double mean_squared(const float *one, const float *other, int64_t count, int threads) {
    constexpr int64_t SPAN = 1 << 14;
    constexpr int SIDE_BY_SIDE = 16;
    const int64_t parts = (count + SPAN - 1) / SPAN;
    std::vector<double> sums(parts);
    share(parts, threads, [&](int64_t part, int) {
        const int64_t begin = part * SPAN, end = begin + SPAN < count ? begin + SPAN : count;
        double lanes[SIDE_BY_SIDE] = {};
        int64_t i = begin;
        for (; i + SIDE_BY_SIDE <= end; i += SIDE_BY_SIDE) {
            for (int k = 0; k < SIDE_BY_SIDE; k++) {
                const float d = one[i + k] - other[i + k];
                lanes[k] += static_cast<double>(d) * d;
            }
        }
        for (; i < end; i++) {
            const float d = one[i] - other[i];
            lanes[0] += static_cast<double>(d) * d;
        }
        for (const double lane : lanes) sums[part] += lane;
    });
    double sum = 0;
    for (const double part : sums) sum += part;
    return sum / static_cast<double>(count);
}

void in_unit(const uint8_t *bytes, int64_t count, float *to, int threads) {
    constexpr int64_t SPAN = 1 << 15;
    float units[256];
    for (int i = 0; i < 256; i++) units[i] = static_cast<float>(i) / 255.f;
    share((count + SPAN - 1) / SPAN, threads, [&](int64_t part, int) {
        const int64_t begin = part * SPAN, end = begin + SPAN < count ? begin + SPAN : count;
        for (int64_t i = begin; i < end; i++) to[i] = units[bytes[i]];
    });
}

void adam(const Kernels &kernels, const std::vector<Moved> &tensors, float epsilon, int threads) {
    constexpr int64_t SPAN = 1 << 14;
    std::vector<Moved> spans;
    for (const Moved &whole : tensors) {
        for (int64_t at = 0; at < whole.count; at += SPAN) {
            Moved span = whole;
            span.count = whole.count - at < SPAN ? whole.count - at : SPAN;
            span.values += at;
            span.mean += at;
            span.square += at;
            span.grad += at;
            spans.push_back(span);
        }
    }
    const int64_t count = static_cast<int64_t>(spans.size());
    share(count, threads, [&](int64_t i, int) { kernels.adam(spans[i], epsilon); });
}

double photometric(const Kernels &kernels, const LossImages &in, int threads) {
    static thread_local Buffer<float> scratch;
    float *memory = scratch.reserve(static_cast<size_t>(LOSS_ROOM) * threads);
    const int across = (in.length + LOSS_WIDTH - 1) / LOSS_WIDTH;
    const int down = (in.height + LOSS_HEIGHT - 1) / LOSS_HEIGHT;
    const auto cut = [](int size, int i, int parts) {
        return static_cast<int>(static_cast<int64_t>(size) * i / parts);
    };
    std::vector<LossSums> sums(static_cast<size_t>(across) * down);
    share(across * down, threads, [&](int64_t p, int worker) {
        const int x = static_cast<int>(p) % across, y = static_cast<int>(p) / across;
        const LossPatch patch = {cut(in.length, x, across), cut(in.length, x + 1, across),
                                 cut(in.height, y, down), cut(in.height, y + 1, down)};
        sums[p] = kernels.loss_patch(in, patch, memory + static_cast<size_t>(LOSS_ROOM) * worker);
    });
    LossSums all{};
    for (const LossSums &sum : sums) {
        all.difference += sum.difference;
        all.similarity += sum.similarity;
    }
    const double count = static_cast<double>(in.height) * in.length;
    return (1 - in.ssim_weight) * all.difference / count +
           in.ssim_weight * (1 - all.similarity / count);
}

}  // namespace gsyn
