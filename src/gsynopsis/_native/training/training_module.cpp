// The Python face of the training kernels.
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <cmath>
#include <optional>
#include <tuple>
#include <vector>

#include "bindings.hpp"
#include "limits.gen.hpp"

namespace gsyn {

const int64_t *checked_rows(const ReadArray &rows, int64_t visible, int64_t count) {
    const int64_t *at = checked<const int64_t>(rows, "rows", {visible});
    for (int64_t v = 0; v < visible; v++) {
        if (at[v] < 0 || at[v] >= count || (v && at[v] <= at[v - 1])) {
            throw nb::value_error("rows: expected ascending rows of the tables");
        }
    }
    return at;
}

namespace {

// Arrays in the order of `Slots`.
using SlotArrays = std::tuple<ReadArray, ReadArray, ReadArray, ReadArray, ReadArray, ReadArray,
                              ReadArray, ReadArray, ReadArray>;
using DrawnArrays = std::tuple<ReadArray, ReadArray>;
template <class A>
using Five = std::tuple<A, A, A, A, A>;

Slots make_slots(const SlotArrays &arrays) {
    const auto &[rows, live, opacity, cov, color, positions, log_scales, offsets, gain] = arrays;
    Slots in{};
    in.rows = checked<const int64_t>(rows, "rows", {ANY});
    in.visible = static_cast<int64_t>(rows.shape(0));
    in.live = checked<const uint8_t>(live, "live", {ANY, ANY});
    const int64_t count = static_cast<int64_t>(live.shape(0)), slots = live.shape(1);
    if (slots < 1 || slots > SLOTS_MAX) {
        throw nb::value_error(("live: expected 1 to " + std::to_string(SLOTS_MAX) + " slots").c_str());
    }
    in.slots = static_cast<int>(slots);
    in.opacity = checked<const float>(opacity, "opacity", {in.visible, slots});
    in.cov = checked<const float>(cov, "cov", {in.visible, 7 * slots});
    in.color = checked<const float>(color, "color", {in.visible, 3 * slots});
    in.positions = checked<const float>(positions, "positions", {count, 3});
    in.log_scales = checked<const float>(log_scales, "log_scales", {count, 6});
    in.offsets = checked<const float>(offsets, "offsets", {count, slots, 3});
    in.log_gain = checked<const float>(gain, "log_gain", {3});
    for (int64_t v = 0; v < in.visible; v++) {
        if (in.rows[v] < 0 || in.rows[v] >= count || (v && in.rows[v] <= in.rows[v - 1])) {
            throw nb::value_error("rows: expected ascending rows of the tables");
        }
    }
    return in;
}

Drawn make_drawn(const Slots &in, const DrawnArrays &arrays, int64_t count) {
    const auto &[activated, starts] = arrays;
    Drawn which{};
    which.activated = checked<const float>(activated, "activated", {in.visible, in.slots});
    which.starts = checked<const int64_t>(starts, "starts", {in.visible + 1});
    which.count = count;
    if (which.starts[0] != 0 || which.starts[in.visible] != count) {
        throw nb::value_error("starts: do not end at the number of Gaussians");
    }
    return which;
}

void throw_if_foreign(int foreign) {
    if (foreign) throw nb::value_error("starts: not those of count_drawn");
}

// Positions, log_scales, offsets, live and the largest gain.
using AnchorArrays = std::tuple<ReadArray, ReadArray, ReadArray, ReadArray, float>;

int64_t visible_rows_arrays(const AnchorArrays &arrays, ReadArray w2c, Intrinsics intrinsics,
                            std::tuple<int, int> size, Array rows, int threads,
                            const std::string &variant) {
    const auto &[positions, log_scales, offsets, live, gain] = arrays;
    Anchors in{};
    in.positions = checked<const float>(positions, "positions", {ANY, 3});
    in.count = static_cast<int64_t>(positions.shape(0));
    in.offsets = checked<const float>(offsets, "offsets", {in.count, ANY, 3});
    in.slots = static_cast<int>(offsets.shape(1));
    in.log_scales = checked<const float>(log_scales, "log_scales", {in.count, 6});
    in.live = checked<const uint8_t>(live, "live", {in.count, in.slots});
    in.gain = gain;
    const View view = make_view(w2c, intrinsics, std::get<0>(size), std::get<1>(size));
    int64_t *to = checked<int64_t>(rows, "rows", {in.count + 1});
    const Kernels &kernels = kernels_or_throw(variant);
    checked_threads(threads);
    nb::gil_scoped_release release;
    std::vector<uint8_t> seen(in.count);
    return visible_rows(kernels, in, view, seen.data(), to, threads);
}

int64_t count_drawn_arrays(const SlotArrays &slots, Array activated, Array starts, int threads,
                           const std::string &variant) {
    const Slots in = make_slots(slots);
    float *to = checked<float>(activated, "activated", {in.visible, in.slots});
    int64_t *at = checked<int64_t>(starts, "starts", {in.visible + 1});
    const Kernels &kernels = kernels_or_throw(variant);
    checked_threads(threads);
    nb::gil_scoped_release release;
    return count_drawn(kernels, in, to, at, threads);
}

void assemble_arrays(const SlotArrays &slots, const DrawnArrays &drawn, const Five<Array> &arrays,
                     Array drawn_slots, int threads, const std::string &variant) {
    const auto &[means, quats, scales, opacities, colors] = arrays;
    const Slots in = make_slots(slots);
    const int64_t count = static_cast<int64_t>(means.shape(0));
    int foreign = 0;
    Drawn which = make_drawn(in, drawn, count);
    which.foreign = &foreign;
    DrawnOut out{};
    out.means = checked<float>(means, "means", {count, 3});
    out.quats = checked<float>(quats, "quats", {count, 4});
    out.scales = checked<float>(scales, "scales", {count, 3});
    out.opacities = checked<float>(opacities, "opacities", {count});
    out.colors = checked<float>(colors, "colors", {count, 3});
    out.slots = checked<int64_t>(drawn_slots, "slots", {count});
    const Kernels &kernels = kernels_or_throw(variant);
    checked_threads(threads);
    {
        nb::gil_scoped_release release;
        assemble(kernels, in, which, out, threads);
    }
    throw_if_foreign(foreign);
}

void assemble_backward_arrays(const SlotArrays &slots, const DrawnArrays &drawn,
                              const Five<ReadArray> &arrays, const Five<Array> &grads,
                              Array gain_shares, Array log_gain, int threads,
                              const std::string &variant, bool add) {
    const auto &[means, quats, scales, opacities, colors] = arrays;
    const auto &[g_opacity, g_cov, g_color, g_log_scales, g_offsets] = grads;
    const Slots in = make_slots(slots);
    const int64_t count = static_cast<int64_t>(means.shape(0)), K = in.slots;
    int foreign = 0;
    Drawn which = make_drawn(in, drawn, count);
    which.foreign = &foreign;
    DrawnGradients grad{};
    grad.means = checked<const float>(means, "grad means", {count, 3});
    grad.quats = checked<const float>(quats, "grad quats", {count, 4});
    grad.scales = checked<const float>(scales, "grad scales", {count, 3});
    grad.opacities = checked<const float>(opacities, "grad opacities", {count});
    grad.colors = checked<const float>(colors, "grad colors", {count, 3});
    const int64_t anchors = static_cast<int64_t>(std::get<1>(slots).shape(0));
    SlotGradients out{};
    out.anchors = anchors;
    out.add = add;
    out.opacity = checked<float>(g_opacity, "grad opacity", {in.visible, K});
    out.cov = checked<float>(g_cov, "grad cov", {in.visible, 7 * K});
    out.color = checked<float>(g_color, "grad color", {in.visible, 3 * K});
    out.log_scales = checked<float>(g_log_scales, "grad log_scales", {anchors, 6});
    out.offsets = checked<float>(g_offsets, "grad offsets", {anchors, K, 3});
    out.log_gain = checked<float>(gain_shares, "gain shares", {in.visible, 3});
    float *total = checked<float>(log_gain, "grad log_gain", {3});
    const Kernels &kernels = kernels_or_throw(variant);
    checked_threads(threads);
    {
        nb::gil_scoped_release release;
        assemble_backward(kernels, in, which, grad, out, total, threads);
    }
    throw_if_foreign(foreign);
}

void scatter_rows_arrays(ReadArray rows, ReadArray from, int first, Array to, bool add,
                         int threads) {
    ScatteredRows in{};
    in.to = checked<float>(to, "to", {ANY, ANY});
    in.anchors = static_cast<int64_t>(to.shape(0));
    in.width = static_cast<int64_t>(to.shape(1));
    in.from = checked<const float>(from, "source", {ANY, ANY});
    in.count = static_cast<int64_t>(from.shape(0));
    in.stride = static_cast<int64_t>(from.shape(1));
    in.rows = checked_rows(rows, in.count, in.anchors);
    if (first < 0 || first + in.width > in.stride) throw nb::value_error("source: too narrow");
    in.from += first;
    in.add = add;
    checked_threads(threads);
    nb::gil_scoped_release release;
    scatter_rows(in, threads);
}

// Flat slots, rows, gradients on screen, what passed culling, opacities of all slots.
using CountedArrays = std::tuple<ReadArray, ReadArray, ReadArray, ReadArray, ReadArray>;

void count_view_arrays(const CountedArrays &arrays, std::tuple<int, int> size,
                       const std::tuple<Array, Array, Array, Array> &counters, int threads) {
    const auto &[at, rows, screen_grad, shown, opacity] = arrays;
    const auto &[gradient, drawn, opacities, visits] = counters;
    Counted in{};
    in.rows = checked<const int64_t>(rows, "rows", {ANY});
    in.visible = static_cast<int64_t>(rows.shape(0));
    in.opacities = checked<float>(opacities, "opacities", {ANY});
    const int64_t anchors = static_cast<int64_t>(opacities.shape(0));
    checked_rows(rows, in.visible, anchors);
    in.opacity = checked<const float>(opacity, "opacity", {in.visible, ANY});
    in.slots = static_cast<int>(opacity.shape(1));
    in.at = checked<const int64_t>(at, "slots", {ANY});
    in.count = static_cast<int64_t>(at.shape(0));
    checked_rows(at, in.count, anchors * in.slots);
    in.screen_grad = checked<const float>(screen_grad, "screen_grad", {in.count, 2});
    in.shown = checked<const uint8_t>(shown, "shown", {in.count});
    in.gradient = checked<float>(gradient, "gradient", {anchors * in.slots});
    in.drawn = checked<float>(drawn, "drawn", {anchors * in.slots});
    in.visits = checked<float>(visits, "visits", {anchors});
    in.half_width = static_cast<float>(std::get<0>(size)) / 2;
    in.half_height = static_cast<float>(std::get<1>(size)) / 2;
    checked_threads(threads);
    nb::gil_scoped_release release;
    count_view(in, threads);
}

double mean_volume_arrays(ReadArray scales, std::optional<Array> grad) {
    const float *from = checked<const float>(scales, "scales", {ANY, 3});
    const int64_t count = static_cast<int64_t>(scales.shape(0));
    if (count < 1) throw nb::value_error("scales: expected at least one Gaussian");
    float *to = grad ? checked<float>(*grad, "grad", {count, 3}) : nullptr;
    nb::gil_scoped_release release;
    return mean_volume(from, count, to);
}

double mean_squared_arrays(ReadArray one, ReadArray other, int threads) {
    const float *from = checked<const float>(one, "one", {ANY});
    const int64_t count = static_cast<int64_t>(one.shape(0));
    if (count < 1) throw nb::value_error("one: expected at least one value");
    const float *to = checked<const float>(other, "other", {count});
    checked_threads(threads);
    nb::gil_scoped_release release;
    return mean_squared(from, to, count, threads);
}

void in_unit_arrays(ReadArray bytes, Array to, int threads) {
    const uint8_t *from = checked<const uint8_t>(bytes, "bytes", {ANY});
    const int64_t count = static_cast<int64_t>(bytes.shape(0));
    float *values = checked<float>(to, "to", {count});
    checked_threads(threads);
    nb::gil_scoped_release release;
    in_unit(from, count, values, threads);
}

// Values, gradient, both moments as flat arrays; learning rate, number of this step from 1.
using MovedArrays = std::tuple<Array, ReadArray, Array, Array, double, double>;

void adam_arrays(const std::vector<MovedArrays> &arrays, float epsilon, int threads,
                 const std::string &variant) {
    std::vector<Moved> tensors;
    for (const auto &[values, grad, mean, square, rate, step] : arrays) {
        Moved moved{};
        moved.values = checked<float>(values, "values", {ANY});
        moved.count = static_cast<int64_t>(values.shape(0));
        moved.grad = checked<const float>(grad, "grad", {moved.count});
        moved.mean = checked<float>(mean, "mean", {moved.count});
        moved.square = checked<float>(square, "square", {moved.count});
        if (!(step >= 1)) throw nb::value_error("step: expected at least 1");
        moved.rate = static_cast<float>(rate / (1 - std::pow(BETA_MEAN, step)));
        moved.root = static_cast<float>(1 / std::sqrt(1 - std::pow(BETA_SQUARE, step)));
        tensors.push_back(moved);
    }
    const Kernels &kernels = kernels_or_throw(variant);
    checked_threads(threads);
    nb::gil_scoped_release release;
    adam(kernels, tensors, epsilon, threads);
}

double photometric_arrays(ReadArray image, ReadArray target, float ssim_weight,
                          std::optional<Array> grad, int threads, const std::string &variant) {
    const float *from = checked<const float>(image, "image", {ANY, ANY, 3});
    const int64_t height = static_cast<int64_t>(image.shape(0));
    const int64_t width = static_cast<int64_t>(image.shape(1));
    if (height < 1 || width < 1 || height > 65536 || width > 65536) {
        throw nb::value_error("image: expected 1 to 65536 pixels a side");
    }
    const float *goal = checked<const float>(target, "target", {height, width, 3});
    float *to = grad ? checked<float>(*grad, "grad", {height, width, 3}) : nullptr;
    const Kernels &kernels = kernels_or_throw(variant);
    checked_threads(threads);
    nb::gil_scoped_release release;
    const LossImages in = {static_cast<int>(height), static_cast<int>(3 * width), from, goal, to,
                           ssim_weight};
    return photometric(kernels, in, threads);
}

}  // namespace

void bind_training(nb::module_ &m) {
    using namespace nb::literals;
    m.def("visible_rows", &visible_rows_arrays, "anchors"_a, "w2c"_a, "intrinsics"_a, "size"_a,
          "rows"_a, "threads"_a = 1, "variant"_a = "",
          "Writes the rows of anchors that could touch the image into rows [N + 1]; returns V.");
    m.def("count_drawn", &count_drawn_arrays, "slots"_a, "activated"_a, "starts"_a,
          "threads"_a = 1, "variant"_a = "",
          "Writes tanh of the opacities and where each anchor's Gaussians start; returns G.");
    m.def("assemble", &assemble_arrays, "slots"_a, "drawn"_a, "gaussians"_a, "drawn_slots"_a,
          "threads"_a = 1, "variant"_a = "",
          "Writes means, quats, scales, opacities, colors and flat slots of the drawn slots.");
    m.def("assemble_backward", &assemble_backward_arrays, "slots"_a, "drawn"_a,
          "grad_gaussians"_a, "grads"_a, "gain_shares"_a, "grad_log_gain"_a, "threads"_a = 1,
          "variant"_a = "", "add"_a = false,
          "Writes gradients of opacity, cov, color, log_scales and offsets; or adds to the last two.");
    m.def("scatter_rows", &scatter_rows_arrays, "rows"_a, "source"_a, "first"_a, "to"_a,
          "add"_a = false, "threads"_a = 1,
          "Writes columns of [V, stride], the first of them `first`, into rows of [N, width], and "
          "zeros into all others; or adds to them.");
    m.def("count_view", &count_view_arrays, "view"_a, "size"_a, "counters"_a, "threads"_a = 1,
          "Adds what growth counts of one view to gradient, drawn, opacities and visits.");
    m.def("mean_volume", &mean_volume_arrays, "scales"_a, "grad"_a = nb::none(),
          "Mean product of three scales [G, 3], and its gradient.");
    m.def("mean_squared", &mean_squared_arrays, "one"_a, "other"_a, "threads"_a = 1,
          "Mean squared difference of two flat arrays.");
    m.def("in_unit", &in_unit_arrays, "bytes"_a, "to"_a, "threads"_a = 1,
          "Writes flat bytes divided by 255.");
    m.def("adam", &adam_arrays, "tensors"_a, "epsilon"_a, "threads"_a = 1, "variant"_a = "",
          "One step on flat tensors: values, gradient, both moments, learning rate, step.");
    m.def("photometric", &photometric_arrays, "image"_a, "target"_a, "ssim_weight"_a,
          "grad"_a = nb::none(), "threads"_a = 1, "variant"_a = "",
          "(1 - w) L1 + w (1 - SSIM), and its gradient with respect to the image.");
}

}  // namespace gsyn
