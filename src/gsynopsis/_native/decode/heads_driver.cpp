// Threads and memory of the heads: weights are packed once per call, gradients summed in a fixed
// order of parts that does not depend on the number of threads.
#include <cmath>
#include <algorithm>
#include <cstring>

#include "raster/frame.hpp"
#include "pool.hpp"

namespace gsyn {
namespace {

constexpr int64_t PART = 512;  // rows a task, at least
constexpr int PARTS_MAX = 24;

int padded(int width) { return (width + 15) / 16 * 16; }

int parts_of(int64_t count) {
    const int64_t wanted = (count + PART - 1) / PART;
    return static_cast<int>(wanted < 1 ? 1 : wanted > PARTS_MAX ? PARTS_MAX : wanted);
}

// Hands out pieces of one block of memory; with null it only counts.
class Pieces {
public:
    explicit Pieces(float *at) : at_(at) {}
    float *take(int64_t count) {
        float *piece = at_ ? at_ + used_ : nullptr;
        used_ += count;
        return piece;
    }
    int64_t used() const { return used_; }

private:
    float *at_;
    int64_t used_ = 0;
};

// Where the columns of a first layer's weights stand: grids, codebook row, residual, view.
struct Columns {
    int grids, code, residual, view, all;
    explicit Columns(const Networks &n)
        : grids(0), code(n.grids), residual(code + n.width), view(residual + n.residual),
          all(view + VIEW_INPUTS) {}
    // The column of the weights for a column of x, which has no codebook row.
    int of_input(int i) const { return i < code ? i : i + residual - code; }
};

struct Packed {
    PackedHeads heads{};
    float *first, *first_back, *code_first, *code_back, *by_code, *codes_across;
    float *second[HEAD_COUNT], *second_back[HEAD_COUNT], *bias[HEAD_COUNT];
};

Packed lay_out(const Networks &n, Pieces &memory) {
    Packed p;
    PackedHeads &h = p.heads;
    h.inputs = n.grids + n.residual + VIEW_INPUTS + 1;
    h.stride = inputs_stride(n);
    h.learnt = learnt_stride(n);
    h.hidden = padded(n.hidden);
    h.entries = n.entries;
    h.entry_stride = padded(n.entries);
    h.width = n.entries ? n.width : 0;
    h.width_padded = padded(h.width);
    const int64_t all = hidden_stride(n);
    h.first = p.first = memory.take(h.inputs * all);
    h.first_back = p.first_back = memory.take(all * h.learnt);
    p.code_first = memory.take(h.width * all);
    h.code_back = p.code_back = memory.take(all * h.width_padded);
    h.by_code = p.by_code = memory.take(h.entries * all);
    h.codes_across = p.codes_across = memory.take(h.width * h.entry_stride);
    for (int k = 0; k < HEAD_COUNT; k++) {
        h.outputs[k] = n.outputs[k];
        h.padded[k] = padded(n.outputs[k]);
        h.second[k] = p.second[k] = memory.take(h.hidden * h.padded[k]);
        h.second_back[k] = p.second_back[k] = memory.take(h.outputs[k] * h.hidden);
        h.bias[k] = p.bias[k] = memory.take(h.padded[k]);
    }
    return p;
}

void pack_first(const Networks &n, const Packed &p, int head) {
    const PackedHeads &h = p.heads;
    const Columns columns(n);
    const int all = HEAD_COUNT * h.hidden, bias = h.inputs - 1, learnt = n.grids + n.residual;
    for (int j = 0; j < n.hidden; j++) {
        const float *weights = n.w1[head] + static_cast<int64_t>(j) * columns.all;
        const int to = head * h.hidden + j;
        for (int i = 0; i < bias; i++) p.first[i * all + to] = weights[columns.of_input(i)];
        p.first[bias * all + to] = n.b1[head][j];
        for (int i = 0; i < learnt; i++) {
            p.first_back[to * h.learnt + i] = weights[columns.of_input(i)];
        }
        for (int i = 0; i < h.width; i++) {
            p.code_first[i * all + to] = weights[columns.code + i];
            p.code_back[to * h.width_padded + i] = weights[columns.code + i];
        }
    }
}

void pack_second(const Networks &n, const Packed &p, int head) {
    const PackedHeads &h = p.heads;
    for (int o = 0; o < n.outputs[head]; o++) {
        const float *weights = n.w2[head] + static_cast<int64_t>(o) * n.hidden;
        for (int j = 0; j < n.hidden; j++) {
            p.second[head][j * h.padded[head] + o] = weights[j];
            p.second_back[head][o * h.hidden + j] = weights[j];
        }
        p.bias[head][o] = n.b2[head][o];
    }
}

void pack_codebook(const Networks &n, const Packed &p) {
    const PackedHeads &h = p.heads;
    const int all = HEAD_COUNT * h.hidden;
    for (int c = 0; c < h.entries; c++) {
        float *to = p.by_code + static_cast<int64_t>(c) * all;
        for (int i = 0; i < h.width; i++) {
            const float value = n.codebook[c * h.width + i], *weights = p.code_first + i * all;
            p.codes_across[i * h.entry_stride + c] = value;
            for (int j = 0; j < all; j++) to[j] += value * weights[j];
        }
    }
}

Packed pack(const Networks &n, Buffer<float> &memory) {
    Pieces counting(nullptr);
    lay_out(n, counting);
    const int64_t total = counting.used();
    float *at = memory.reserve(total + 1);
    std::memset(at, 0, total * sizeof(float));
    Pieces pieces(at);
    const Packed p = lay_out(n, pieces);
    for (int head = 0; head < HEAD_COUNT; head++) {
        pack_first(n, p, head);
        pack_second(n, p, head);
    }
    pack_codebook(n, p);
    return p;
}

HeadShare take_share(const PackedHeads &h, Pieces &memory) {
    const int64_t all = HEAD_COUNT * h.hidden;
    HeadShare share{};
    share.first = memory.take(h.inputs * all);
    share.by_code = memory.take(h.entries * all);
    for (int k = 0; k < HEAD_COUNT; k++) {
        share.second[k] = memory.take(static_cast<int64_t>(h.hidden) * h.padded[k]);
        share.bias[k] = memory.take(h.padded[k]);
    }
    return share;
}

// From the sum of all shares to the arrays of the weights.
void unpack(const Networks &n, const Packed &p, const HeadShare &sum, const NetworkGradients &out) {
    const PackedHeads &h = p.heads;
    const Columns columns(n);
    const int all = HEAD_COUNT * h.hidden, bias = h.inputs - 1;
    for (int head = 0; head < HEAD_COUNT; head++) {
        for (int j = 0; j < n.hidden; j++) {
            float *to = out.w1[head] + static_cast<int64_t>(j) * columns.all;
            const int from = head * h.hidden + j;
            for (int i = 0; i < bias; i++) to[columns.of_input(i)] = sum.first[i * all + from];
            for (int i = 0; i < h.width; i++) to[columns.code + i] = 0.f;
            for (int c = 0; c < h.entries; c++) {
                const float along = sum.by_code[static_cast<int64_t>(c) * all + from];
                for (int i = 0; i < h.width; i++) {
                    to[columns.code + i] += along * n.codebook[c * h.width + i];
                }
            }
            out.b1[head][j] = sum.first[bias * all + from];
        }
        for (int o = 0; o < n.outputs[head]; o++) {
            for (int j = 0; j < n.hidden; j++) {
                out.w2[head][o * n.hidden + j] = sum.second[head][j * h.padded[head] + o];
            }
            out.b2[head][o] = sum.bias[head][o];
        }
    }
    for (int c = 0; c < h.entries; c++) {
        float *to = out.codebook + c * h.width;
        for (int i = 0; i < h.width; i++) to[i] = 0.f;
        for (int j = 0; j < all; j++) {
            const float along = sum.by_code[static_cast<int64_t>(c) * all + j];
            for (int i = 0; i < h.width; i++) to[i] += along * p.code_back[j * h.width_padded + i];
        }
    }
}

// Adds all shares to the first, each number in the order of the parts.
void sum_shares(float *shares, int64_t size, int parts, int threads) {
    constexpr int64_t SLICE = 1024;
    const int64_t slices = (size + SLICE - 1) / SLICE;
    share(slices, threads, [&](int64_t s, int) {
        const int64_t end = (s + 1) * SLICE < size ? (s + 1) * SLICE : size;
        for (int part = 1; part < parts; part++) {
            const float *from = shares + part * size;
            for (int64_t i = s * SLICE; i < end; i++) shares[i] += from[i];
        }
    });
}

}  // namespace

int inputs_stride(const Networks &n) { return padded(n.grids + n.residual + VIEW_INPUTS + 1); }
int learnt_stride(const Networks &n) { return padded(n.grids + n.residual); }
int hidden_stride(const Networks &n) { return HEAD_COUNT * padded(n.hidden); }

void fill_inputs(const HeadInputs &in, float *x, int threads) {
    const int view = in.grids + in.residual_width, one = view + VIEW_INPUTS;
    const auto fill = [&](int64_t v) {
        float *to = x + v * in.stride, away[3];
        const float *from = in.residual + in.rows[v] * in.residual_width;
        for (int i = 0; i < in.residual_width; i++) to[in.grids + i] = from[i];
        for (int i = 0; i < 3; i++) away[i] = in.positions[3 * in.rows[v] + i] - in.eye[i];
        const float far = std::sqrt(away[0] * away[0] + away[1] * away[1] + away[2] * away[2]);
        const float distance = far < 1e-8f ? 1e-8f : far;
        for (int i = 0; i < 3; i++) to[view + i] = away[i] / distance;
        const float known = distance * in.per_extent;
        to[view + 3] = known < in.low ? in.low : known > in.high ? in.high : known;
        to[one] = 1.f;
        for (int i = one + 1; i < in.stride; i++) to[i] = 0.f;
    };
    share((in.count + PART - 1) / PART, threads, [&](int64_t part, int) {
        const int64_t end = std::min((part + 1) * PART, in.count);
        for (int64_t v = part * PART; v < end; v++) fill(v);
    });
}

void choose_codes(const Kernels &kernels, const float *logits, const int64_t *rows, int64_t count,
                  int entries, int64_t *codes, int threads) {
    share((count + PART - 1) / PART, threads, [&](int64_t part, int) {
        kernels.choose(logits, rows, part * PART, std::min((part + 1) * PART, count), entries,
                       codes);
    });
}

void heads_forward(const Kernels &kernels, const Networks &networks, const HeadRows &rows,
                   int threads) {
    static thread_local Buffer<float> weights, scratch;
    const Packed packed = pack(networks, weights);
    const int64_t room = heads_scratch(packed.heads);
    float *const own = scratch.reserve(room * threads);
    const int parts = parts_of(rows.count);
    share(parts, threads, [&](int64_t part, int worker) {
        kernels.heads_forward(packed.heads, rows, rows.count * part / parts,
                              rows.count * (part + 1) / parts, own + room * worker);
    });
}

void heads_backward(const Kernels &kernels, const Networks &networks, const HeadRows &rows,
                    const HeadGradients &grad, const NetworkGradients &out, int threads) {
    static thread_local Buffer<float> weights, scratch, shares;
    const Packed packed = pack(networks, weights);
    Pieces counting(nullptr);
    take_share(packed.heads, counting);
    const int64_t room = heads_scratch(packed.heads), size = counting.used();
    const int parts = parts_of(rows.count);
    float *const own = scratch.reserve(room * threads), *const all = shares.reserve(size * parts);
    share(parts, threads, [&](int64_t part, int worker) {
        std::memset(all + size * part, 0, size * sizeof(float));
        Pieces pieces(all + size * part);
        const HeadShare share = take_share(packed.heads, pieces);
        const int64_t begin = rows.count * part / parts, end = rows.count * (part + 1) / parts;
        if (grad.logits && !grad.add) {
            clear_others(grad.rows, begin, end, rows.count, grad.anchors, networks.entries,
                         grad.grad_logits);
        }
        kernels.heads_backward(packed.heads, rows, grad, begin, end, share,
                               own + room * worker);
    });
    sum_shares(all, size, parts, threads);
    Pieces pieces(all);
    unpack(networks, packed, take_share(packed.heads, pieces), out);
}

}  // namespace gsyn
