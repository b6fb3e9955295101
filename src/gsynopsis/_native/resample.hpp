// Cubic resampling of 8-bit images.
#pragma once

#include <cstdint>

namespace gsyn {

// An RGB image, [height, width, 3].
struct Pixels {
    const uint8_t *data;
    int64_t width, height;
};

// Colours [count, 3] at places [count, 2] in pixels, the first pixel's corner at (0, 0), by Keys'
// cubic convolution with a = -1/2. Beyond its edge the image goes on as its last pixel.
void sample_cubic(const Pixels &pixels, const float *places, int64_t count, uint8_t *colors);

}  // namespace gsyn
