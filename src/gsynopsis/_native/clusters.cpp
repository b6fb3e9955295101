// The clusters of stand-ins (model/stand_ins.py, which has the rule).
#include "clusters.hpp"

#include <algorithm>
#include <cmath>

namespace gsyn {
namespace {

// Points begin to end, which become `wanted` clusters from `label` on.
struct Part {
    int64_t begin, end, wanted, label;
};

int longest_axis(const Weighted *points, int64_t count) {
    float low[3], high[3];
    for (int i = 0; i < 3; i++) low[i] = high[i] = points[0].place[i];
    for (int64_t n = 1; n < count; n++) {
        for (int i = 0; i < 3; i++) {
            low[i] = std::min(low[i], points[n].place[i]);
            high[i] = std::max(high[i], points[n].place[i]);
        }
    }
    int axis = 0;
    for (int i = 1; i < 3; i++) {
        if (high[i] - low[i] > high[axis] - low[axis]) axis = i;
    }
    return axis;
}

double weight_of(const Weighted *points, int64_t begin, int64_t end) {
    double sum = 0;
    for (int64_t n = begin; n < end; n++) sum += points[n].weight;
    return sum;
}

// How many points along the axis, equal ones by their rows, have at least this weight together.
// These come first afterwards. Halving with nth_element takes linear time in all.
int64_t cut_at(Weighted *points, int64_t count, int axis, double weight) {
    const auto before = [axis](const Weighted &a, const Weighted &b) {
        return a.place[axis] != b.place[axis] ? a.place[axis] < b.place[axis] : a.row < b.row;
    };
    int64_t low = 0, high = count;
    while (high - low > 1) {
        const int64_t middle = low + (high - low) / 2;
        std::nth_element(points + low, points + middle, points + high, before);
        const double lower = weight_of(points, low, middle);
        if (lower >= weight) {
            high = middle;
        } else {
            weight -= lower;
            low = middle;
        }
    }
    return high;
}

}  // namespace

void weighted_clusters(std::vector<Weighted> &points, int64_t count, int64_t *labels) {
    std::vector<Part> parts{{0, static_cast<int64_t>(points.size()), count, 0}};
    while (!parts.empty()) {
        const Part part = parts.back();
        parts.pop_back();
        Weighted *own = points.data() + part.begin;
        const int64_t size = part.end - part.begin;
        if (part.wanted == 1) {
            for (int64_t n = 0; n < size; n++) labels[own[n].row] = part.label;
            continue;
        }
        const double whole = weight_of(own, 0, size);
        int64_t cut = cut_at(own, size, longest_axis(own, size), whole / 2);
        cut = std::clamp<int64_t>(cut, 1, size - 1);
        const double share = weight_of(own, 0, cut) / whole;
        int64_t left = std::llrint(static_cast<double>(part.wanted) * share);
        left = std::clamp<int64_t>(left, 1, part.wanted - 1);
        // No side has more clusters than points.
        left = std::clamp<int64_t>(left, part.wanted - (size - cut), cut);
        const int64_t middle = part.begin + cut;
        parts.push_back({middle, part.end, part.wanted - left, part.label + left});
        parts.push_back({part.begin, middle, left, part.label});
    }
}

}  // namespace gsyn
