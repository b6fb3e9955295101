// The Python face of the heads.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <optional>
#include <tuple>
#include <vector>

#include "bindings.hpp"

namespace gsyn {
namespace {

constexpr int WEIGHTS = 4;  // w1, b1, w2, b2 of each head
constexpr int MOST = 1 << 14;

// Weights of opacity, cov and color; the codebook; grid and residual columns of the features.
using NetworkArrays = std::tuple<std::vector<ReadArray>, ReadArray, int, int>;
// Inputs, codebook rows if there is a codebook, hidden values, outputs of the heads.
using RowArrays = std::tuple<ReadArray, std::optional<ReadArray>, Array, std::vector<Array>>;
// Logits, rows of the anchors, gradient of the logits, whether to add to it.
using ChoiceArrays = std::tuple<ReadArray, ReadArray, Array, bool>;

Networks make_networks(const NetworkArrays &arrays) {
    const auto &[weights, codebook, grids, residual] = arrays;
    if (weights.size() != HEAD_COUNT * WEIGHTS) throw nb::value_error("weights: expected twelve");
    Networks n{};
    n.codebook = checked<const float>(codebook, "codebook", {ANY, ANY});
    n.entries = static_cast<int>(codebook.shape(0));
    n.width = static_cast<int>(codebook.shape(1));
    n.grids = grids;
    n.residual = residual;
    if (grids < 0 || residual < 0 || grids > MOST || residual > MOST || n.width > MOST) {
        throw nb::value_error("weights: expected widths of 0 to 2^14");
    }
    checked<const float>(weights[0], "w1", {ANY, ANY});
    const int64_t hidden = static_cast<int64_t>(weights[0].shape(0));
    if (hidden < 1 || hidden > MOST) throw nb::value_error("w1: expected 1 to 2^14 hidden values");
    n.hidden = static_cast<int>(hidden);
    const int64_t inputs = static_cast<int64_t>(grids) + n.width + residual + VIEW_INPUTS;
    for (int h = 0; h < HEAD_COUNT; h++) {
        const ReadArray *own = &weights[h * WEIGHTS];
        n.w1[h] = checked<const float>(own[0], "w1", {hidden, inputs});
        n.b1[h] = checked<const float>(own[1], "b1", {hidden});
        n.w2[h] = checked<const float>(own[2], "w2", {ANY, hidden});
        const int64_t outputs = static_cast<int64_t>(own[2].shape(0));
        if (outputs < 1 || outputs > MOST) throw nb::value_error("w2: expected 1 to 2^14 outputs");
        n.outputs[h] = static_cast<int>(outputs);
        n.b2[h] = checked<const float>(own[3], "b2", {outputs});
    }
    return n;
}

HeadRows make_rows(const Networks &n, const RowArrays &arrays) {
    const auto &[x, codes, hidden, outputs] = arrays;
    HeadRows rows{};
    rows.x = checked<const float>(x, "x", {ANY, inputs_stride(n)});
    rows.count = static_cast<int64_t>(x.shape(0));
    rows.hidden = checked<float>(hidden, "hidden", {rows.count, hidden_stride(n)});
    if (codes.has_value() != (n.entries > 0)) {
        throw nb::value_error("codes: expected where there is a codebook and nowhere else");
    }
    if (codes) {
        rows.codes = checked<const int64_t>(*codes, "codes", {rows.count});
        for (int64_t v = 0; v < rows.count; v++) {
            if (rows.codes[v] < 0 || rows.codes[v] >= n.entries) {
                throw nb::value_error("codes: outside of the codebook");
            }
        }
    }
    if (outputs.size() != HEAD_COUNT) throw nb::value_error("outputs: expected three");
    for (int h = 0; h < HEAD_COUNT; h++) {
        rows.outputs[h] = checked<float>(outputs[h], "outputs", {rows.count, n.outputs[h]});
    }
    return rows;
}

NetworkGradients make_gradients(const Networks &n, const std::vector<Array> &weights,
                                const Array &codebook) {
    if (weights.size() != HEAD_COUNT * WEIGHTS) throw nb::value_error("weights: expected twelve");
    NetworkGradients out{};
    const int64_t inputs = static_cast<int64_t>(n.grids) + n.width + n.residual + VIEW_INPUTS;
    for (int h = 0; h < HEAD_COUNT; h++) {
        const Array *own = &weights[h * WEIGHTS];
        out.w1[h] = checked<float>(own[0], "grad w1", {n.hidden, inputs});
        out.b1[h] = checked<float>(own[1], "grad b1", {n.hidden});
        out.w2[h] = checked<float>(own[2], "grad w2", {n.outputs[h], n.hidden});
        out.b2[h] = checked<float>(own[3], "grad b2", {n.outputs[h]});
    }
    out.codebook = checked<float>(codebook, "grad codebook", {n.entries, n.width});
    return out;
}

void fill_inputs_arrays(ReadArray rows, ReadArray positions, ReadArray residual,
                        std::tuple<float, float, float> eye,
                        std::tuple<float, float, float> distances, int grids, Array x,
                        int threads) {
    checked<const float>(positions, "positions", {ANY, 3});
    const int64_t count = static_cast<int64_t>(positions.shape(0));
    HeadInputs in{};
    in.positions = static_cast<const float *>(positions.data());
    in.residual = checked<const float>(residual, "residual", {count, ANY});
    in.residual_width = static_cast<int>(residual.shape(1));
    float *to = checked<float>(x, "x", {ANY, ANY});
    in.count = static_cast<int64_t>(x.shape(0));
    in.stride = static_cast<int>(x.shape(1));
    in.grids = grids;
    if (grids < 0 || in.stride < grids + in.residual_width + VIEW_INPUTS + 1) {
        throw nb::value_error("x: too narrow");
    }
    in.rows = checked_rows(rows, in.count, count);
    std::tie(in.eye[0], in.eye[1], in.eye[2]) = eye;
    std::tie(in.per_extent, in.low, in.high) = distances;
    in.per_extent = 1.f / in.per_extent;
    checked_threads(threads);
    nb::gil_scoped_release release;
    fill_inputs(in, to, threads);
}

void choose_arrays(ReadArray logits, ReadArray rows, Array codes, int threads,
                   const std::string &variant) {
    const float *from = checked<const float>(logits, "logits", {ANY, ANY});
    const int64_t count = static_cast<int64_t>(logits.shape(0)), entries = logits.shape(1);
    if (entries < 1 || entries > MOST) throw nb::value_error("logits: expected 1 to 2^14 columns");
    int64_t *to = checked<int64_t>(codes, "codes", {ANY});
    const int64_t visible = static_cast<int64_t>(codes.shape(0));
    const int64_t *at = checked_rows(rows, visible, count);
    const Kernels &kernels = kernels_or_throw(variant);
    checked_threads(threads);
    nb::gil_scoped_release release;
    choose_codes(kernels, from, at, visible, static_cast<int>(entries), to, threads);
}

void heads_forward_arrays(const NetworkArrays &networks, const RowArrays &arrays, int threads,
                          const std::string &variant) {
    const Networks n = make_networks(networks);
    const HeadRows rows = make_rows(n, arrays);
    const Kernels &kernels = kernels_or_throw(variant);
    checked_threads(threads);
    nb::gil_scoped_release release;
    heads_forward(kernels, n, rows, threads);
}

// The outputs' places hold their gradients.
void heads_backward_arrays(const NetworkArrays &networks, const RowArrays &arrays, Array grad_x,
                           const std::vector<Array> &grad_weights, Array grad_codebook,
                           const std::optional<ChoiceArrays> &choice, int threads,
                           const std::string &variant) {
    const Networks n = make_networks(networks);
    const HeadRows rows = make_rows(n, arrays);
    HeadGradients grad{};
    for (int h = 0; h < HEAD_COUNT; h++) grad.outputs[h] = rows.outputs[h];
    grad.x = checked<float>(grad_x, "grad x", {rows.count, learnt_stride(n)});
    if (choice) {
        const auto &[logits, at, grad_logits, add] = *choice;
        grad.logits = checked<const float>(logits, "logits", {ANY, n.entries});
        const int64_t count = static_cast<int64_t>(logits.shape(0));
        grad.add = add;
        grad.anchors = count;
        grad.rows = checked_rows(at, rows.count, count);
        grad.grad_logits = checked<float>(grad_logits, "grad logits", {count, n.entries});
    }
    const NetworkGradients out = make_gradients(n, grad_weights, grad_codebook);
    const Kernels &kernels = kernels_or_throw(variant);
    checked_threads(threads);
    nb::gil_scoped_release release;
    heads_backward(kernels, n, rows, grad, out, threads);
}

}  // namespace

void bind_heads(nb::module_ &m) {
    using namespace nb::literals;
    m.def("fill_inputs", &fill_inputs_arrays, "rows"_a, "positions"_a, "residual"_a, "eye"_a,
          "distances"_a, "grids"_a, "x"_a, "threads"_a = 1,
          "Writes residual, view and a one behind the first `grids` columns of x [V, stride]. The "
          "distances are their unit, and the smallest and largest that go in.");
    m.def("choose", &choose_arrays, "logits"_a, "rows"_a, "codes"_a, "threads"_a = 1,
          "variant"_a = "", "Writes the column of the largest logit of each of the rows.");
    m.def("heads_forward", &heads_forward_arrays, "networks"_a, "rows"_a, "threads"_a = 1,
          "variant"_a = "", "Writes hidden values and outputs of the three heads.");
    m.def("heads_backward", &heads_backward_arrays, "networks"_a, "rows"_a, "grad_x"_a,
          "grad_weights"_a, "grad_codebook"_a, "choice"_a = nb::none(), "threads"_a = 1,
          "variant"_a = "",
          "Gradients of inputs, weights, codebook, and of the logits at the rows of V.");
}

}  // namespace gsyn
