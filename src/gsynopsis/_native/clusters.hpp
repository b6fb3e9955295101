// Clusters of weighted points: a k-d tree that is cut where half of the weight lies.
#pragma once

#include <cstdint>
#include <vector>

namespace gsyn {

// A point, its weight, and its row in the caller's arrays.
struct Weighted {
    float place[3], weight;
    int32_t row;
};

// Label 0 to count - 1 of every point, none unused; points are put into another order. 1 <= count
// <= points. Weights are positive.
void weighted_clusters(std::vector<Weighted> &points, int64_t count, int64_t *labels);

}  // namespace gsyn
