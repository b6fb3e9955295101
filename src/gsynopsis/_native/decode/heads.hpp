// The three heads of visible anchors: features to outputs before their activations, and back.
//
// An anchor's inputs stand in a row of x: grid features, residual, view direction and distance, and
// a one that carries the bias. Its codebook row is not among them: what the first layers make of
// each of the few rows is computed once (`by_code`) and added. Plain twin: model/heads.py.
#pragma once

#include <cstdint>

namespace gsyn {

struct Kernels;

constexpr int HEAD_COUNT = 3;   // opacity, cov, color
constexpr int VIEW_INPUTS = 4;  // unit direction, normalised distance

// The weights as arrays from Python, [out, in] like torch's Linear.
struct Networks {
    const float *w1[HEAD_COUNT], *b1[HEAD_COUNT];  // [H, grids + width + residual + 4], [H]
    const float *w2[HEAD_COUNT], *b2[HEAD_COUNT];  // [outputs, H], [outputs]
    const float *codebook;                         // [entries, width]
    int grids, width, residual, hidden, entries;   // columns of each kind; H; codebook rows
    int outputs[HEAD_COUNT];
};

struct NetworkGradients {
    float *w1[HEAD_COUNT], *b1[HEAD_COUNT], *w2[HEAD_COUNT], *b2[HEAD_COUNT];
    float *codebook;
};

// The weights as the hot loops want them: widths padded with zeros to whole columns.
struct PackedHeads {
    int inputs, stride;  // columns of x in use, floats from row to row
    int learnt;          // leading columns of x that have a gradient, padded: the stride of it
    int hidden;          // of one head, padded
    int outputs[HEAD_COUNT], padded[HEAD_COUNT];
    int entries, entry_stride, width, width_padded;
    const float *first;                     // [inputs, 3 hidden]
    const float *first_back;                // [3 hidden, learnt]
    const float *code_back;                 // [3 hidden, width_padded]
    const float *by_code;                   // [entries, 3 hidden]
    const float *codes_across;              // [width, entry_stride], the codebook transposed
    const float *second[HEAD_COUNT];        // [hidden, padded]
    const float *second_back[HEAD_COUNT];   // [outputs, hidden]
    const float *bias[HEAD_COUNT];          // [padded]
};

// V rows from forward to backward.
struct HeadRows {
    int64_t count;
    const float *x;         // [V, stride]
    const int64_t *codes;   // [V] codebook rows; null if there is no codebook
    float *hidden;          // [V, 3 hidden] after ReLU
    float *outputs[HEAD_COUNT];
};

// What one part of the rows adds to the gradients of the weights.
struct HeadShare {
    float *first;                // [inputs, 3 hidden]
    float *second[HEAD_COUNT];   // [hidden, padded]
    float *bias[HEAD_COUNT];     // [padded]
    float *by_code;              // [entries, 3 hidden]
};

struct HeadGradients {
    const float *outputs[HEAD_COUNT];  // [V, outputs]
    float *x;                          // [V, learnt], written
    const int64_t *rows;               // [V] where the soft choice of an anchor stands
    const float *logits;               // [N, entries]; null: the choice is frozen
    float *grad_logits;                // [N, entries]
    int64_t anchors;                   // N
    bool add;  // to what is in grad_logits; else all of it is written, zero where nothing is seen
};

constexpr int HEAD_BLOCK = 32;  // anchors that go through a product together

// Where anchors stand and the eye that sees them.
struct HeadInputs {
    int64_t count;
    const int64_t *rows;      // [V]
    const float *positions;   // [N, 3]
    const float *residual;    // [N, residual]
    float eye[3], per_extent; // 1 / the unit of distance
    float low, high;          // no distance outside of these goes in, in that unit
    int grids, residual_width, stride;
};

// Floats of scratch memory that a call of the two hot functions needs.
inline int64_t heads_scratch(const PackedHeads &heads) {
    int most = 0;
    for (int h = 0; h < HEAD_COUNT; h++) most = heads.padded[h] > most ? heads.padded[h] : most;
    const int64_t row = heads.stride + 2 * HEAD_COUNT * heads.hidden + most + heads.width_padded;
    return HEAD_BLOCK * (row + heads.entry_stride) + heads.entry_stride;
}

// Fills all of x but the grid features, which are the first columns.
void fill_inputs(const HeadInputs &in, float *x, int threads);
// The column of the largest value of each of the rows, the first of equal ones.
void choose_codes(const Kernels &, const float *logits, const int64_t *rows, int64_t count,
                  int entries, int64_t *codes, int threads);
int inputs_stride(const Networks &);
int learnt_stride(const Networks &);
int hidden_stride(const Networks &);
void heads_forward(const Kernels &, const Networks &, const HeadRows &, int threads);
void heads_backward(const Kernels &, const Networks &, const HeadRows &, const HeadGradients &,
                    const NetworkGradients &, int threads);

}  // namespace gsyn
