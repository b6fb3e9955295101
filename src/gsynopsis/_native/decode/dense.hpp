// Products of small row-major matrices, kept in registers: what the heads are made of.
#pragma once

#include "simd.hpp"

namespace gsyn {
namespace GSYN_VARIANT {

// Widths are multiples of this many floats, so that no product has a column left over.
constexpr int COLUMNS = 16;

// The left matrix of a product: element (i, k) is at[i · row + k · step], so a transposed one will do.
struct Left {
    const float *at;
    int64_t row, step;
};

// As many registers as there are hold sums; the rest holds a row of the right matrix.
constexpr int MOST_VECTORS = LANES == 16 ? 6 : COLUMNS / LANES;
constexpr int rows_at_once(int vectors) {
    return LANES == 16 ? (vectors > 2 ? 4 : 8) : LANES == 8 ? 4 : 2;
}

// to[i] = Σ_k left(i, k) right[k], or added to what is there, for ROWS rows of VECTORS vectors.
template <int ROWS, int VECTORS, bool ADD>
GSYN_INLINE void product_tile(const Left &left, const float *right, int64_t right_row, float *to,
                              int64_t to_row, int depth) {
    Floats sums[ROWS][VECTORS];
    for (int i = 0; i < ROWS; i++) {
        for (int v = 0; v < VECTORS; v++) {
            sums[i][v] = ADD ? load(to + i * to_row + v * LANES) : Floats{};
        }
    }
    const float *column = left.at;
    for (int k = 0; k < depth; k++, column += left.step, right += right_row) {
        Floats row[VECTORS];
        for (int v = 0; v < VECTORS; v++) row[v] = load(right + v * LANES);
        for (int i = 0; i < ROWS; i++) {
            for (int v = 0; v < VECTORS; v++) sums[i][v] += column[i * left.row] * row[v];
        }
    }
    for (int i = 0; i < ROWS; i++) {
        for (int v = 0; v < VECTORS; v++) store(to + i * to_row + v * LANES, sums[i][v]);
    }
}

template <int VECTORS, bool ADD>
void product_panel(const Left &left, int rows, const float *right, int64_t right_row, float *to,
                   int64_t to_row, int depth) {
    constexpr int ROWS = rows_at_once(VECTORS);
    int i = 0;
    for (; i + ROWS <= rows; i += ROWS) {
        const Left part = {left.at + i * left.row, left.row, left.step};
        product_tile<ROWS, VECTORS, ADD>(part, right, right_row, to + i * to_row, to_row, depth);
    }
    for (; i < rows; i++) {
        const Left part = {left.at + i * left.row, left.row, left.step};
        product_tile<1, VECTORS, ADD>(part, right, right_row, to + i * to_row, to_row, depth);
    }
}

// The whole product: `rows` × `depth` times `depth` × `columns`. Each sum runs over k in order.
template <bool ADD>
void product(const Left &left, int rows, const float *right, int64_t right_row, float *to,
             int64_t to_row, int columns, int depth) {
    for (int at = 0; at < columns;) {
        const int vectors = (columns - at) / LANES < MOST_VECTORS ? (columns - at) / LANES : MOST_VECTORS;
        switch (vectors) {
#define GSYN_PANEL(n) \
    case n: product_panel<n, ADD>(left, rows, right + at, right_row, to + at, to_row, depth); break
#if GSYN_LANES == 16
            GSYN_PANEL(1);
            GSYN_PANEL(2);
            GSYN_PANEL(3);
            GSYN_PANEL(5);
            GSYN_PANEL(6);
#endif
#if GSYN_LANES == 8
            GSYN_PANEL(2);
#else
            GSYN_PANEL(4);
#endif
#undef GSYN_PANEL
        }
        at += vectors * LANES;
    }
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
