// One image from forward to backward: the stages in order, threads, and the memory they share.
#pragma once

#include <atomic>
#include <cstdlib>
#include <new>
#include <string>
#include <vector>

#include "raster/raster.hpp"

namespace gsyn {

// The instruction sets that were compiled and that this CPU has, fastest first.
std::vector<std::string> variants();

// The kernels of a variant, or of the fastest if the name is empty; null if it cannot run here.
const Kernels *find_kernels(const std::string &variant);

// Memory that only grows, aligned to cache lines and not initialised.
template <class T>
class Buffer {
public:
    Buffer() = default;
    Buffer(const Buffer &) = delete;
    Buffer &operator=(const Buffer &) = delete;
    ~Buffer() { std::free(items_); }

    T *reserve(size_t count) {
        if (count <= capacity_) return items_;
        // A quarter more where it has grown before: the first size may well be the last.
        const size_t wanted = capacity_ ? count + count / 4 : count;
        const size_t bytes = (wanted * sizeof(T) + 63) / 64 * 64;
        T *fresh = static_cast<T *>(std::aligned_alloc(64, bytes));
        if (!fresh) throw std::bad_alloc();
        std::free(items_);
        items_ = fresh;
        capacity_ = wanted;
        return items_;
    }
    size_t bytes() const { return capacity_ * sizeof(T); }

private:
    T *items_ = nullptr;
    size_t capacity_ = 0;
};

// Milliseconds of the last calls.
struct StageTimes {
    double project = 0, scatter = 0, blend = 0, blend_backward = 0, project_backward = 0;
};

class Frame {
public:
    explicit Frame(const Kernels &kernels) : kernels_(kernels) {}
    Frame(const Frame &) = delete;
    Frame &operator=(const Frame &) = delete;
    ~Frame();

    // `visible` is [G], 1 where a Gaussian touches the image. False, and nothing is drawn, if there
    // are more than `pairs_max` pairs of Gaussian and tile; memory is for no more of them.
    bool render(const Cloud &cloud, const View &view, const float background[3], const Images &out,
                uint8_t *visible, int threads, int64_t pairs_max);

    // Of the last render, which must have been of the same `cloud`; gradients that are null are left.
    void backward(const Cloud &cloud, const ImageGradients &in, const CloudGradients &out,
                  int threads);

    // The squared change of the last `image`, summed over pixels and channels, if a Gaussian were
    // left out, [G]; see blend_removal.cpp.
    void removal_effects(const float *image, float *effects, int threads);

    const View &view() const { return scene_.view; }
    int64_t count() const { return count_; }
    int64_t pairs() const { return pair_count_; }
    size_t bytes() const;
    StageTimes times;

private:
    void make_chunks(int64_t count);
    void assign_slots();
    void scatter(const Chunk &chunk);

    const Kernels &kernels_;
    Scene scene_{};
    int64_t count_ = 0, pair_count_ = 0;
    std::atomic<int64_t> listed_{0};
    uint32_t longest_tile_ = 0;
    std::vector<Chunk> chunks_;  // the first chunk_count_ are in use
    int chunk_count_ = 0;
    Buffer<Splat> splats_;
    Buffer<uint32_t> touched_, tile_counts_, tile_starts_;
    Buffer<uint64_t> pairs_, block_masks_, keys_;
    Buffer<Entry> entries_;
    Buffer<float> partials_;
};

// The hash grid over all points: forward by ranges of points, backward level by level.
void encode(const Kernels &, const HashGrid &, const float *points, int64_t count,
            const float *tables, float *out, int threads);
void encode_backward(const Kernels &, const HashGrid &, const float *points, int64_t count,
                     const float *grad_out, float *grad_tables, int threads);

}  // namespace gsyn
