// Pixels between pixels (scene/resample.py).
#include "resample.hpp"

#include <algorithm>

namespace gsyn {
namespace {

// Weights of the four pixels around a place `t` in [0, 1] beyond the second.
void weigh(float t, float *weights) {
    const float rest = 1 - t;
    weights[0] = -0.5f * t * rest * rest;
    weights[1] = (1.5f * t - 2.5f) * t * t + 1;
    weights[2] = (1.5f * rest - 2.5f) * rest * rest + 1;
    weights[3] = -0.5f * rest * t * t;
}

// The first of the four along an axis, from -2 to size - 1, and their weights.
int64_t weigh_axis(float place, int64_t size, float *weights) {
    // Not a number, and what is far outside, become the edge.
    const float at = place > -1 ? std::min(place, static_cast<float>(size) + 1) - 0.5f : -1.5f;
    const int32_t below = static_cast<int32_t>(at + 2) - 2;  // at or left of it, `at` is over -2
    weigh(at - static_cast<float>(below), weights);
    return below - 1;
}

}  // namespace

void sample_cubic(const Pixels &pixels, const float *places, int64_t count, uint8_t *colors) {
    const int64_t width = pixels.width, height = pixels.height;
    for (int64_t n = 0; n < count; n++) {
        float across[4], down[4];
        const int64_t left = weigh_axis(places[2 * n], width, across);
        const int64_t top = weigh_axis(places[2 * n + 1], height, down);
        const bool inside = left >= 0 && left + 3 < width;
        float columns[12] = {};  // four pixels beside each other
        for (int j = 0; j < 4; j++) {
            const int64_t row = std::clamp<int64_t>(top + j, 0, height - 1);
            const uint8_t *line = pixels.data + 3 * row * width, *four = line + 3 * left;
            uint8_t edge[12];
            if (!inside) {
                for (int i = 0; i < 4; i++) {
                    const int64_t column = std::clamp<int64_t>(left + i, 0, width - 1);
                    std::copy_n(line + 3 * column, 3, edge + 3 * i);
                }
                four = edge;
            }
            for (int k = 0; k < 12; k++) columns[k] += down[j] * four[k];
        }
        for (int c = 0; c < 3; c++) {
            float total = 0;
            for (int i = 0; i < 4; i++) total += across[i] * columns[3 * i + c];
            colors[3 * n + c] = static_cast<uint8_t>(std::clamp(total, 0.0f, 255.0f) + 0.5f);
        }
    }
}

}  // namespace gsyn
