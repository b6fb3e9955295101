// The heads, a block of anchors at a time: every product of a block stays in the caches.
#include "decode/dense.hpp"
#include "stages.hpp"

namespace gsyn {
namespace GSYN_VARIANT {
namespace {

// What a block needs beside the arrays of `HeadRows`; row after row without a gap.
struct Block {
    float *x, *hidden, *slopes, *outputs, *narrow, *scores;
    int rows;
    int64_t at[HEAD_BLOCK];  // anchors of the block
};

Block block_of(const PackedHeads &heads, float *scratch) {
    const int width = HEAD_COUNT * heads.hidden;
    int most = 0;
    for (int h = 0; h < HEAD_COUNT; h++) most = heads.padded[h] > most ? heads.padded[h] : most;
    Block block;
    block.x = scratch;
    block.hidden = block.x + HEAD_BLOCK * heads.stride;
    block.slopes = block.hidden + HEAD_BLOCK * width;
    block.outputs = block.slopes + HEAD_BLOCK * width;
    block.narrow = block.outputs + HEAD_BLOCK * most;
    block.scores = block.narrow + HEAD_BLOCK * heads.width_padded;
    block.rows = 0;
    return block;
}

GSYN_INLINE void copy_row(float *to, const float *from, int floats) {
    for (int i = 0; i < floats; i += LANES) store(to + i, load(from + i));
}

// to += from, over whole columns.
GSYN_INLINE void add_row(float *to, const float *from, int floats) {
    for (int i = 0; i < floats; i += LANES) store(to + i, load(to + i) + load(from + i));
}

void first_layer(const PackedHeads &heads, const HeadRows &in, int64_t begin, int rows) {
    const int width = HEAD_COUNT * heads.hidden;
    float *hidden = in.hidden + begin * width;
    const Left x = {in.x + begin * heads.stride, heads.stride, 1};
    if (in.codes) {
        for (int i = 0; i < rows; i++) {
            copy_row(hidden + i * width, heads.by_code + in.codes[begin + i] * width, width);
        }
        product<true>(x, rows, heads.first, width, hidden, width, width, heads.inputs);
    } else {
        product<false>(x, rows, heads.first, width, hidden, width, width, heads.inputs);
    }
    for (int i = 0; i < rows * width; i += LANES) {
        const Floats value = load(hidden + i);
        // Not a maximum, so that NaN stays NaN.
        store(hidden + i, select(less(value, Floats{}), Floats{}, value));
    }
}

void second_layer(const PackedHeads &heads, const HeadRows &in, int head, int64_t begin, int rows,
                  float *scratch) {
    const int width = HEAD_COUNT * heads.hidden, padded = heads.padded[head];
    const Left hidden = {in.hidden + begin * width + head * heads.hidden, width, 1};
    for (int i = 0; i < rows; i++) copy_row(scratch + i * padded, heads.bias[head], padded);
    product<true>(hidden, rows, heads.second[head], padded, scratch, padded, padded, heads.hidden);
    const int outputs = heads.outputs[head];
    for (int i = 0; i < rows; i++) {
        memcpy(in.outputs[head] + (begin + i) * outputs, scratch + i * padded,
               outputs * sizeof(float));
    }
}

// Whether any value of the row is not zero; NaN is not.
GSYN_INLINE bool has_gradient(const float *row, int count) {
    for (int i = 0; i < count; i++) {
        if (!(row[i] == 0.f)) return true;
    }
    return false;
}

// Collects up to HEAD_BLOCK anchors that have a gradient, their inputs and what the first layer
// made of them; clears the gradient of the others. Returns where to go on.
int64_t fill_block(const PackedHeads &heads, const HeadRows &in, const HeadGradients &grad,
                   int64_t from, int64_t end, Block &block) {
    const int width = HEAD_COUNT * heads.hidden;
    block.rows = 0;
    int64_t v = from;
    for (; v < end && block.rows < HEAD_BLOCK; v++) {
        bool wanted = false;
        for (int h = 0; h < HEAD_COUNT && !wanted; h++) {
            wanted = has_gradient(grad.outputs[h] + v * heads.outputs[h], heads.outputs[h]);
        }
        if (!wanted) {
            memset(grad.x + v * heads.learnt, 0, heads.learnt * sizeof(float));
            if (grad.logits && !grad.add) {
                float *logits = grad.grad_logits + grad.rows[v] * heads.entries;
                memset(logits, 0, heads.entries * sizeof(float));
            }
            continue;
        }
        copy_row(block.x + block.rows * heads.stride, in.x + v * heads.stride, heads.stride);
        copy_row(block.hidden + block.rows * width, in.hidden + v * width, width);
        block.at[block.rows++] = v;
    }
    return v;
}

void second_layer_backward(const PackedHeads &heads, const HeadGradients &grad, int head,
                           const HeadShare &share, Block &block) {
    const int width = HEAD_COUNT * heads.hidden, padded = heads.padded[head];
    const int outputs = heads.outputs[head], rows = block.rows;
    for (int i = 0; i < rows; i++) {
        float *to = block.outputs + i * padded;
        memcpy(to, grad.outputs[head] + block.at[i] * outputs, outputs * sizeof(float));
        memset(to + outputs, 0, (padded - outputs) * sizeof(float));
        add_row(share.bias[head], to, padded);
    }
    const Left given = {block.outputs, padded, 1};
    product<false>(given, rows, heads.second_back[head], heads.hidden,
                   block.slopes + head * heads.hidden, width, heads.hidden, outputs);
    const Left hidden = {block.hidden + head * heads.hidden, 1, width};
    product<true>(hidden, heads.hidden, block.outputs, padded, share.second[head], padded, padded,
                  rows);
}

void first_layer_backward(const PackedHeads &heads, const HeadGradients &grad,
                          const HeadShare &share, Block &block) {
    const int width = HEAD_COUNT * heads.hidden, rows = block.rows;
    for (int i = 0; i < rows * width; i += LANES) {
        const Floats open = load(block.hidden + i);
        store(block.slopes + i, kept(less(Floats{}, open), load(block.slopes + i)));
    }
    const Left inputs = {block.x, 1, heads.stride};
    product<true>(inputs, heads.inputs, block.slopes, width, share.first, width, width, rows);
    if (heads.learnt == 0) return;
    const Left slopes = {block.slopes, width, 1};
    // The inputs have done their service, and their rows are at least as long.
    product<false>(slopes, rows, heads.first_back, heads.learnt, block.x, heads.learnt,
                   heads.learnt, width);
    for (int i = 0; i < rows; i++) {
        copy_row(grad.x + block.at[i] * heads.learnt, block.x + i * heads.learnt, heads.learnt);
    }
}

// One row of the soft choice: with w = softmax(logits) and u the scores, w (u − ⟨w, u⟩), into
// `weights`.
void soften(const float *logits, const float *scores, int entries, int padded, float *weights) {
    float most = logits[0];
    for (int i = 1; i < entries; i++) most = logits[i] > most ? logits[i] : most;
    memcpy(weights, logits, entries * sizeof(float));
    for (int i = entries; i < padded; i++) weights[i] = -INFINITY;
    Floats total{}, inner{};
    for (int i = 0; i < padded; i += LANES) {
        const Floats weight = exp_of(load(weights + i) - most);
        total += weight;
        inner += weight * load(scores + i);
        store(weights + i, weight);
    }
    const float scale = 1.f / sum_of(total), mean = sum_of(inner) * scale;
    for (int i = 0; i < padded; i += LANES) {
        store(weights + i, load(weights + i) * scale * (load(scores + i) - mean));
    }
}

void codes_backward(const PackedHeads &heads, const HeadRows &in, const HeadGradients &grad,
                    const HeadShare &share, Block &block) {
    const int width = HEAD_COUNT * heads.hidden, rows = block.rows;
    for (int i = 0; i < rows; i++) {
        add_row(share.by_code + in.codes[block.at[i]] * width, block.slopes + i * width, width);
    }
    if (!grad.logits) return;
    const int narrow = heads.width_padded, entries = heads.entry_stride;
    const Left slopes = {block.slopes, width, 1}, row = {block.narrow, narrow, 1};
    product<false>(slopes, rows, heads.code_back, narrow, block.narrow, narrow, narrow, width);
    product<false>(row, rows, heads.codes_across, entries, block.scores, entries, entries,
                   heads.width);
    float *weights = block.scores + HEAD_BLOCK * entries;
    for (int i = 0; i < rows; i++) {
        const int64_t at = grad.rows[block.at[i]] * heads.entries;
        soften(grad.logits + at, block.scores + i * entries, heads.entries, entries, weights);
        float *to = grad.grad_logits + at;
        if (grad.add) {
            for (int k = 0; k < heads.entries; k++) to[k] += weights[k];
        } else {
            memcpy(to, weights, heads.entries * sizeof(float));
        }
    }
}

int best_of(const float *row, int entries) {
    float most = row[0];
    int i = 0;
    if (entries >= LANES) {
        Floats top = load(row);
        for (i = LANES; i + LANES <= entries; i += LANES) top = larger(load(row + i), top);
        for (int lane = 0; lane < LANES; lane++) most = top[lane] > most ? top[lane] : most;
    }
    for (; i < entries; i++) most = row[i] > most ? row[i] : most;
    int at = 0;
    while (at + LANES <= entries && !any(equal(load(row + at), all(most)))) at += LANES;
    while (at < entries - 1 && !(row[at] == most)) at++;
    return at;
}

}  // namespace

void choose(const float *logits, const int64_t *rows, int64_t begin, int64_t end, int entries,
            int64_t *codes) {
    for (int64_t v = begin; v < end; v++) codes[v] = best_of(logits + rows[v] * entries, entries);
}

void heads_forward(const PackedHeads &heads, const HeadRows &in, int64_t begin, int64_t end,
                   float *scratch) {
    for (int64_t at = begin; at < end; at += HEAD_BLOCK) {
        const int rows = end - at < HEAD_BLOCK ? (int)(end - at) : HEAD_BLOCK;
        first_layer(heads, in, at, rows);
        for (int h = 0; h < HEAD_COUNT; h++) second_layer(heads, in, h, at, rows, scratch);
    }
}

void heads_backward(const PackedHeads &heads, const HeadRows &in, const HeadGradients &grad,
                    int64_t begin, int64_t end, const HeadShare &share, float *scratch) {
    Block block = block_of(heads, scratch);
    for (int64_t at = begin; at < end;) {
        at = fill_block(heads, in, grad, at, end, block);
        if (block.rows == 0) continue;
        for (int h = 0; h < HEAD_COUNT; h++) second_layer_backward(heads, grad, h, share, block);
        first_layer_backward(heads, grad, share, block);
        if (in.codes) codes_backward(heads, in, grad, share, block);
    }
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
