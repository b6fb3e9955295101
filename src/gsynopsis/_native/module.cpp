// The Python face of the native kernels.
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <memory>
#include <tuple>

#include "arrays.hpp"
#include "bindings.hpp"
#include "clusters.hpp"
#include "raster/frame.hpp"
#include "limits.gen.hpp"
#include "resample.hpp"

namespace gsyn {

const Kernels &kernels_or_throw(const std::string &variant) {
    const Kernels *kernels = find_kernels(variant);
    if (!kernels) throw nb::value_error(("variant: '" + variant + "' cannot run here").c_str());
    return *kernels;
}

View make_view(const ReadArray &w2c, const Intrinsics &intrinsics, int64_t width, int64_t height) {
    if (width < 1 || height < 1 || width > 65536 || height > 65536) {
        throw nb::value_error("image: expected 1 to 65536 pixels a side");
    }
    const float *matrix = checked<const float>(w2c, "w2c", {4, 4});
    View view{};
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) view.rotation[3 * i + k] = matrix[4 * i + k];
        view.translation[i] = matrix[4 * i + 3];
    }
    std::tie(view.fx, view.fy, view.cx, view.cy) = intrinsics;
    view.width = static_cast<int>(width);
    view.height = static_cast<int>(height);
    return view;
}

namespace {

Cloud make_cloud(const ReadArray &means, const ReadArray &quats, const ReadArray &scales,
                 const ReadArray &opacities) {
    Cloud cloud{};
    cloud.means = checked<const float>(means, "means", {ANY, 3});
    cloud.count = static_cast<int64_t>(means.shape(0));
    if (cloud.count > INT32_MAX) throw nb::value_error("means: over 2^31 Gaussians");
    cloud.quats = checked<const float>(quats, "quats", {cloud.count, 4});
    cloud.scales = checked<const float>(scales, "scales", {cloud.count, 3});
    cloud.opacities = checked<const float>(opacities, "opacities", {cloud.count});
    return cloud;
}

bool render(Frame &frame, ReadArray means, ReadArray quats, ReadArray scales, ReadArray opacities,
            ReadArray colors, ReadArray w2c, Intrinsics intrinsics, Dilations dilations,
            ReadArray background, Array image, Array alpha, Array visible, int threads,
            int64_t pairs_max) {
    Cloud cloud = make_cloud(means, quats, scales, opacities);
    cloud.colors = checked<const float>(colors, "colors", {cloud.count, 3});
    Images out{};
    out.image = checked<float>(image, "image", {ANY, ANY, 3});
    const int64_t height = static_cast<int64_t>(image.shape(0));
    const int64_t width = static_cast<int64_t>(image.shape(1));
    out.alpha = checked<float>(alpha, "alpha", {height, width});
    View view = make_view(w2c, intrinsics, width, height);
    std::tie(view.own, view.dilation) = dilations;
    const float *behind = checked<const float>(background, "background", {3});
    uint8_t *seen = checked<uint8_t>(visible, "visible", {cloud.count});
    checked_threads(threads);
    nb::gil_scoped_release release;
    return frame.render(cloud, view, behind, out, seen, threads, pairs_max);
}

// Rows of gradients; null for an array of nothing, which is not asked for.
float *asked_rows(const Array &rows, const char *name, std::initializer_list<int64_t> shape) {
    return rows.size() ? checked<float>(rows, name, shape) : nullptr;
}

void backward(Frame &frame, ReadArray means, ReadArray quats, ReadArray scales,
              ReadArray opacities, ReadArray image, ReadArray grad_image, Array grad_means,
              Array grad_quats, Array grad_scales, Array grad_opacities, Array grad_colors,
              Array grad_screen, int threads) {
    const Cloud cloud = make_cloud(means, quats, scales, opacities);
    const int64_t count = cloud.count, height = frame.view().height, width = frame.view().width;
    if (count != frame.count()) throw nb::value_error("means: not those that were rendered");
    ImageGradients in{};
    in.image = checked<const float>(image, "image", {height, width, 3});
    in.grad_image = checked<const float>(grad_image, "grad_image", {height, width, 3});
    CloudGradients out{};
    out.means = asked_rows(grad_means, "grad_means", {count, 3});
    out.quats = asked_rows(grad_quats, "grad_quats", {count, 4});
    out.scales = asked_rows(grad_scales, "grad_scales", {count, 3});
    out.opacities = asked_rows(grad_opacities, "grad_opacities", {count});
    out.colors = asked_rows(grad_colors, "grad_colors", {count, 3});
    out.screen = asked_rows(grad_screen, "grad_screen", {count, 2});
    checked_threads(threads);
    nb::gil_scoped_release release;
    frame.backward(cloud, in, out, threads);
}

void removal_effects(Frame &frame, ReadArray image, Array effects, int threads) {
    const int64_t height = frame.view().height, width = frame.view().width;
    const float *blended = checked<const float>(image, "image", {height, width, 3});
    float *to = checked<float>(effects, "effects", {frame.count()});
    checked_threads(threads);
    nb::gil_scoped_release release;
    frame.removal_effects(blended, to, threads);
}

nb::dict stage_ms(const Frame &frame) {
    nb::dict ms;
    ms["project"] = frame.times.project;
    ms["scatter"] = frame.times.scatter;
    ms["blend"] = frame.times.blend;
    ms["blend_backward"] = frame.times.blend_backward;
    ms["project_backward"] = frame.times.project_backward;
    return ms;
}

HashGrid make_grid(const ReadArray &tables, const ReadArray &resolutions, const ReadArray &offsets,
                   const ReadArray &sizes) {
    checked<const float>(tables, "tables", {ANY, ANY});
    HashGrid grid{};
    grid.resolutions = checked<const int64_t>(resolutions, "resolutions", {ANY});
    grid.levels = static_cast<int>(resolutions.shape(0));
    grid.offsets = checked<const int64_t>(offsets, "offsets", {grid.levels});
    grid.sizes = checked<const int64_t>(sizes, "sizes", {grid.levels});
    grid.features = static_cast<int>(tables.shape(1));
    const int64_t rows = static_cast<int64_t>(tables.shape(0));
    for (int l = 0; l < grid.levels; l++) {
        const int64_t resolution = grid.resolutions[l], size = grid.sizes[l], at = grid.offsets[l];
        if (resolution < RESOLUTION_MIN || resolution > RESOLUTION_MAX) {
            const std::string limits =
                std::to_string(RESOLUTION_MIN) + " to " + std::to_string(RESOLUTION_MAX);
            throw nb::value_error(("resolutions: expected " + limits).c_str());
        }
        if (size < 1 || size > INT32_MAX || at < 0 || at > rows - size) {
            throw nb::value_error("offsets and sizes: a level reaches outside of tables");
        }
    }
    return grid;
}

// Rows of features may be the first columns of longer rows.
template <class AnyArray>
int64_t checked_stride(const AnyArray &rows, const HashGrid &grid, const char *name) {
    const int64_t stride = static_cast<int64_t>(rows.shape(1));
    const int64_t width = static_cast<int64_t>(grid.levels) * grid.features;
    if (stride < width) {
        const std::string found = std::to_string(stride) + " columns, expected at least ";
        const std::string text = std::string(name) + ": found " + found + std::to_string(width);
        throw nb::value_error(text.c_str());
    }
    return stride;
}

void hashgrid_forward(ReadArray points, ReadArray tables, ReadArray resolutions, ReadArray offsets,
                      ReadArray sizes, Array out, int threads, const std::string &variant) {
    const Kernels &kernels = kernels_or_throw(variant);
    HashGrid grid = make_grid(tables, resolutions, offsets, sizes);
    const float *u = checked<const float>(points, "points", {ANY, 3});
    const int64_t count = static_cast<int64_t>(points.shape(0));
    const float *rows = static_cast<const float *>(tables.data());
    float *to = checked<float>(out, "out", {count, ANY});
    grid.stride = checked_stride(out, grid, "out");
    checked_threads(threads);
    nb::gil_scoped_release release;
    encode(kernels, grid, u, count, rows, to, threads);
}

void hashgrid_backward(ReadArray points, ReadArray grad_out, ReadArray resolutions,
                       ReadArray offsets, ReadArray sizes, Array grad_tables, int threads,
                       const std::string &variant) {
    const Kernels &kernels = kernels_or_throw(variant);
    float *to = checked<float>(grad_tables, "grad_tables", {ANY, ANY});
    HashGrid grid = make_grid(ReadArray(grad_tables), resolutions, offsets, sizes);
    const float *u = checked<const float>(points, "points", {ANY, 3});
    const int64_t count = static_cast<int64_t>(points.shape(0));
    const float *from = checked<const float>(grad_out, "grad_out", {count, ANY});
    grid.stride = checked_stride(grad_out, grid, "grad_out");
    checked_threads(threads);
    nb::gil_scoped_release release;
    encode_backward(kernels, grid, u, count, from, to, threads);
}

void cluster(ReadArray points, ReadArray weights, int64_t count, Array labels) {
    const float *places = checked<const float>(points, "points", {ANY, 3});
    const int64_t size = static_cast<int64_t>(points.shape(0));
    const float *heavy = checked<const float>(weights, "weights", {size});
    int64_t *to = checked<int64_t>(labels, "labels", {size});
    if (size > INT32_MAX) throw nb::value_error("points: over 2^31");
    if (count < 1 || count > size) throw nb::value_error("count: expected 1 to as many as points");
    nb::gil_scoped_release release;
    std::vector<Weighted> own(size);
    for (int64_t n = 0; n < size; n++) {
        const float *at = places + 3 * n;
        own[n] = {{at[0], at[1], at[2]}, heavy[n], static_cast<int32_t>(n)};
    }
    weighted_clusters(own, count, to);
}

void sample(ReadArray pixels, ReadArray places, Array colors) {
    Pixels from{};
    from.data = checked<const uint8_t>(pixels, "pixels", {ANY, ANY, 3});
    from.height = static_cast<int64_t>(pixels.shape(0));
    from.width = static_cast<int64_t>(pixels.shape(1));
    if (!pixels.size()) throw nb::value_error("pixels: none");
    const float *at = checked<const float>(places, "places", {ANY, 2});
    const int64_t count = static_cast<int64_t>(places.shape(0));
    uint8_t *to = checked<uint8_t>(colors, "colors", {count, 3});
    nb::gil_scoped_release release;
    sample_cubic(from, at, count, to);
}

}  // namespace
}  // namespace gsyn

NB_MODULE(_core, m) {
    using namespace gsyn;
    using namespace nb::literals;
    nb::set_leak_warnings(false);  // a renderer may live until the interpreter ends
    m.doc() = "Native kernels of gsynopsis.";
    m.def("variants", &variants, "Instruction sets that this CPU can run, fastest first.");

    nb::class_<Frame>(m, "Frame", "One image from forward to backward; its memory is reused.")
        .def("__init__",
             [](Frame *self, const std::string &variant) {
                 new (self) Frame(kernels_or_throw(variant));
             }, "variant"_a = "")
        .def("render", &render, "means"_a, "quats"_a, "scales"_a, "opacities"_a, "colors"_a,
             "w2c"_a, "intrinsics"_a, "dilations"_a, "background"_a, "image"_a, "alpha"_a,
             "visible"_a, "threads"_a, "pairs_max"_a = INT32_MAX)
        .def("backward", &backward, "means"_a, "quats"_a, "scales"_a, "opacities"_a, "image"_a,
             "grad_image"_a, "grad_means"_a, "grad_quats"_a, "grad_scales"_a, "grad_opacities"_a,
             "grad_colors"_a, "grad_screen"_a, "threads"_a)
        .def("removal_effects", &removal_effects, "image"_a, "effects"_a, "threads"_a)
        .def_prop_ro("pairs", &Frame::pairs, "Pairs of Gaussian and tile in the last image.")
        .def_prop_ro("bytes", &Frame::bytes, "Memory held.")
        .def_prop_ro("stage_ms", &stage_ms, "Milliseconds of each stage of the last calls.");

    m.def("hashgrid_forward", &hashgrid_forward, "points"_a, "tables"_a, "resolutions"_a,
          "offsets"_a, "sizes"_a, "out"_a, "threads"_a = 1, "variant"_a = "",
          "Interpolates every level at points [V, 3] in [0, 1] into the first L F columns of out.");
    m.def("hashgrid_backward", &hashgrid_backward, "points"_a, "grad_out"_a, "resolutions"_a,
          "offsets"_a, "sizes"_a, "grad_tables"_a, "threads"_a = 1, "variant"_a = "",
          "Adds the gradient of the tables [rows, F] to grad_tables.");

    m.def("weighted_clusters", &cluster, "points"_a, "weights"_a, "count"_a, "labels"_a,
          "Cuts points [G, 3] of weights > 0 into clusters and writes the label of each [G].");

    m.def("sample_cubic", &sample, "pixels"_a, "places"_a, "colors"_a,
          "Writes the colours [n, 3] of an image [H, W, 3] at places [n, 2], by cubic convolution.");

    bind_training(m);
    bind_heads(m);
}
