#include "raster/frame.hpp"

#include <algorithm>
#include <chrono>
#include <cstring>
#include <stdexcept>

#include "pool.hpp"

namespace gsyn {

namespace {

// Gaussians in a chunk; images and gradients do not depend on it.
constexpr int64_t CHUNK_MIN = 1024;
constexpr int CHUNKS_MAX = 64;

class Stopwatch {
public:
    // Milliseconds since the last lap.
    double lap() {
        const auto now = std::chrono::steady_clock::now();
        const double ms = std::chrono::duration<double, std::milli>(now - last_).count();
        last_ = now;
        return ms;
    }

private:
    std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

struct Variant {
    const char *name;
    const Kernels *kernels;
    bool runs_here;
};

std::vector<Variant> compiled_variants() {
    std::vector<Variant> all;
#if defined(GSYN_HAS_avx512)
    const bool has_512 = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
                         __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq") &&
                         __builtin_cpu_supports("fma");
    all.push_back({"avx512", &avx512::kernels, has_512});
#endif
#if defined(GSYN_HAS_avx2)
    const bool has_256 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
    all.push_back({"avx2", &avx2::kernels, has_256});
#endif
    all.push_back({"baseline", &baseline::kernels, true});
    return all;
}

}  // namespace

std::vector<std::string> variants() {
    std::vector<std::string> names;
    for (const Variant &variant : compiled_variants()) {
        if (variant.runs_here) names.emplace_back(variant.name);
    }
    return names;
}

const Kernels *find_kernels(const std::string &name) {
    for (const Variant &variant : compiled_variants()) {
        if (variant.runs_here && (name.empty() || name == variant.name)) return variant.kernels;
    }
    return nullptr;
}

bool grow(TileList &list, size_t extra) {
    const size_t wanted = std::max(list.size + extra, 2 * list.capacity);
    void *fresh = std::realloc(list.items, wanted * sizeof *list.items);
    if (!fresh) {
        list.failed = true;
        return false;
    }
    list.items = static_cast<uint32_t *>(fresh);
    list.capacity = wanted;
    return true;
}

Frame::~Frame() {
    for (Chunk &chunk : chunks_) std::free(chunk.tiles.items);
}

void Frame::make_chunks(int64_t count) {
    const int tiles = scene_.tiles_x * scene_.tiles_y;
    const int64_t wanted = (count + CHUNK_MIN - 1) / CHUNK_MIN;
    chunk_count_ = static_cast<int>(std::clamp<int64_t>(wanted, 1, CHUNKS_MAX));
    if (static_cast<int>(chunks_.size()) < chunk_count_) chunks_.resize(chunk_count_);
    const size_t cells = static_cast<size_t>(chunk_count_) * tiles;
    uint32_t *counts = tile_counts_.reserve(cells);
    std::memset(counts, 0, cells * sizeof *counts);
    for (int i = 0; i < chunk_count_; i++) {
        Chunk &chunk = chunks_[i];
        chunk.begin = count * i / chunk_count_;
        chunk.end = count * (i + 1) / chunk_count_;
        chunk.tiles.size = 0;
        chunk.tiles.failed = false;
        chunk.tile_counts = counts + static_cast<size_t>(i) * tiles;
    }
}

// Turns counts into places: tile by tile, and within a tile chunk by chunk, so in input order.
void Frame::assign_slots() {
    int64_t total = 0;
    for (int i = 0; i < chunk_count_; i++) {
        if (chunks_[i].tiles.failed) throw std::bad_alloc();
        total += static_cast<int64_t>(chunks_[i].tiles.size);
    }
    const int tiles = scene_.tiles_x * scene_.tiles_y;
    uint32_t *starts = tile_starts_.reserve(tiles + 1), slot = 0;
    longest_tile_ = 0;
    for (int tile = 0; tile < tiles; tile++) {
        starts[tile] = slot;
        for (int i = 0; i < chunk_count_; i++) {
            uint32_t &count = chunks_[i].tile_counts[tile];
            const uint32_t here = count;
            count = slot;
            slot += here;
        }
        longest_tile_ = std::max(longest_tile_, slot - starts[tile]);
    }
    starts[tiles] = slot;
    scene_.tile_starts = starts;
    pair_count_ = total;
    scene_.pairs = pairs_.reserve(total + 1);
    scene_.entries = entries_.reserve(total + 1);
    scene_.block_masks = block_masks_.reserve(total + 1);
}

void Frame::scatter(const Chunk &chunk) {
    uint32_t *item = chunk.tiles.items;
    for (int64_t g = chunk.begin; g < chunk.end; g++) {
        const uint32_t touched = scene_.touched[g];
        if (touched == 0) continue;
        uint32_t depth;
        std::memcpy(&depth, &scene_.splats[g].depth, sizeof depth);
        const uint64_t pair = static_cast<uint64_t>(depth) << 32 | static_cast<uint32_t>(g);
        for (uint32_t i = 0; i < touched; i++, item++) {
            const uint32_t slot = chunk.tile_counts[*item]++;
            scene_.pairs[slot] = pair;
            *item = slot;
        }
    }
}

bool Frame::render(const Cloud &cloud, const View &view, const float background[3],
                   const Images &out, uint8_t *visible, int threads, int64_t pairs_max) {
    Stopwatch watch;
    count_ = cloud.count;
    scene_.view = view;
    scene_.tiles_x = (view.width + TILE - 1) / TILE;
    scene_.tiles_y = (view.height + TILE - 1) / TILE;
    std::copy(background, background + 3, scene_.background);
    scene_.splats = splats_.reserve(cloud.count);
    scene_.touched = touched_.reserve(cloud.count);
    scene_.pairs_max = pairs_max;
    scene_.listed = &listed_;
    listed_ = 0;
    make_chunks(cloud.count);
    const int tiles = scene_.tiles_x * scene_.tiles_y;

    share(chunk_count_, threads,
          [&](int64_t i, int) { kernels_.project(cloud, scene_, chunks_[i]); });
    times.project = watch.lap();
    if (listed_ > pairs_max) {
        count_ = pair_count_ = 0;
        return false;
    }

    assign_slots();
    share(chunk_count_, threads, [&](int64_t i, int) {
        scatter(chunks_[i]);
        for (int64_t g = chunks_[i].begin; g < chunks_[i].end; g++) {
            visible[g] = scene_.touched[g] > 0;
        }
    });
    times.scatter = watch.lap();

    const size_t room = 2 * static_cast<size_t>(longest_tile_);
    uint64_t *keys = keys_.reserve(room * std::min(threads, tiles) + 1);
    share(tiles, threads, [&](int64_t tile, int worker) {
        kernels_.blend(scene_, static_cast<int>(tile), keys + room * worker, out);
    });
    times.blend = watch.lap();
    return true;
}

void Frame::backward(const Cloud &cloud, const ImageGradients &in, const CloudGradients &out,
                     int threads) {
    Stopwatch watch;
    const int tiles = scene_.tiles_x * scene_.tiles_y;
    scene_.partials = partials_.reserve(static_cast<size_t>(pair_count_) * PARTIAL_STRIDE);
    share(tiles, threads, [&](int64_t tile, int) {
        kernels_.blend_backward(scene_, static_cast<int>(tile), in);
    });
    times.blend_backward = watch.lap();

    share(chunk_count_, threads,
          [&](int64_t i, int) { kernels_.project_backward(cloud, scene_, chunks_[i], out); });
    times.project_backward = watch.lap();
}

void Frame::removal_effects(const float *image, float *effects, int threads) {
    const int tiles = scene_.tiles_x * scene_.tiles_y;
    scene_.partials = partials_.reserve(static_cast<size_t>(pair_count_));
    share(tiles, threads, [&](int64_t tile, int) {
        kernels_.blend_removal(scene_, static_cast<int>(tile), image);
    });
    share(chunk_count_, threads, [&](int64_t i, int) {
        const uint32_t *slot = chunks_[i].tiles.items;
        for (int64_t g = chunks_[i].begin; g < chunks_[i].end; g++) {
            float sum = 0.f;
            for (uint32_t k = 0; k < scene_.touched[g]; k++) sum += scene_.partials[*slot++];
            effects[g] = sum;
        }
    });
}

size_t Frame::bytes() const {
    size_t total = splats_.bytes() + touched_.bytes() + tile_counts_.bytes() + tile_starts_.bytes() +
                   pairs_.bytes() + block_masks_.bytes() + keys_.bytes() + entries_.bytes() +
                   partials_.bytes();
    for (const Chunk &chunk : chunks_) total += chunk.tiles.capacity * sizeof *chunk.tiles.items;
    return total;
}

void encode(const Kernels &kernels, const HashGrid &grid, const float *points, int64_t count,
            const float *tables, float *out, int threads) {
    constexpr int64_t PART = 512;  // points a task
    share((count + PART - 1) / PART, threads, [&](int64_t part, int) {
        kernels.hashgrid_forward(grid, points, part * PART, std::min((part + 1) * PART, count),
                                 tables, out);
    });
}

void encode_backward(const Kernels &kernels, const HashGrid &grid, const float *points,
                     int64_t count, const float *grad_out, float *grad_tables, int threads) {
    share(grid.levels, threads, [&](int64_t level, int) {
        kernels.hashgrid_backward(grid, points, count, static_cast<int>(level), grad_out,
                                  grad_tables);
    });
}

}  // namespace gsyn
