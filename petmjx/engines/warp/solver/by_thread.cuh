// H·x = g by Cholesky within H's envelope, by one thread, for CPUs. Their vector units hold a row of a tile.
//
// Left-looking: a tile is read once, all products of the tiles above it are subtracted, and it is written once. These
// tiles are contiguous, in its own panel and in one other panel.

#ifndef PETMJX_BY_THREAD_CUH
#define PETMJX_BY_THREAD_CUH

#include "system.cuh"

#if !defined(__CUDA_ARCH__)
namespace petmjx {

// A row of a tile. Warp compiles for CPUs with Clang, which has vector types.
typedef float Row __attribute__((ext_vector_type(B)));

inline Row load_row(const float* from) {
    Row row;
    __builtin_memcpy(&row, from, sizeof row);
    return row;
}

inline void store_row(float* to, const Row& row) { __builtin_memcpy(to, &row, sizeof row); }

inline float sum(const Row& row) {
    const auto eight = row.lo + row.hi;
    const auto four = eight.lo + eight.hi;
    const auto two = four.lo + four.hi;
    return two.x + two.y;
}

// Rows of a tile that are summed at a time, limited by the registers.
#if defined(__AVX512F__)
const int ROWS = 8;
#else
const int ROWS = 4;
#endif

// The products of a tile's columns with x.
inline Row times_columns(const float* tile, const Row& x) {
    Row sums[4] = {};
    #pragma unroll
    for (int p = 0; p < B; ++p) sums[p % 4] += x[p] * load_row(tile + p * B);
    return (sums[0] + sums[1]) + (sums[2] + sums[3]);
}

// The products of a tile's rows with x.
inline Row times_rows(const float* tile, const Row& x) {
    Row out;
    #pragma unroll
    for (int p = 0; p < B; ++p) out[p] = sum(load_row(tile + p * B) * x);
    return out;
}

// A tile minus the products XᵀY of `count` contiguous tiles X and Y.
inline void subtract_products(const float* tile, const float* X, const float* Y, int count, float* out) {
    for (int first = 0; first < B; first += ROWS) {
        Row rows[ROWS];
        #pragma unroll
        for (int i = 0; i < ROWS; ++i) rows[i] = load_row(tile + (first + i) * B);
        for (int p = 0; p < count * B; ++p) {
            const Row right = load_row(Y + p * B);
            #pragma unroll
            for (int i = 0; i < ROWS; ++i) rows[i] -= X[p * B + first + i] * right;
        }
        #pragma unroll
        for (int i = 0; i < ROWS; ++i) store_row(out + (first + i) * B, rows[i]);
    }
}

// L·tile, where L is a lower triangle.
inline void times_lower(const float* L, const float* tile, float* out) {
    #pragma unroll
    for (int first = 0; first < B; first += ROWS) {
        Row rows[ROWS] = {};
        for (int p = 0; p < first + ROWS; ++p) {
            const Row right = load_row(tile + p * B);
            #pragma unroll
            for (int i = 0; i < ROWS; ++i) rows[i] += L[(first + i) * B + p] * right;
        }
        #pragma unroll
        for (int i = 0; i < ROWS; ++i) store_row(out + (first + i) * B, rows[i]);
    }
}

// The lower triangle L with L·D·Lᵀ = I: the inverse of D's factor. D is overwritten; its part below the diagonal is not
// used.
inline void invert_factor(float* D, float* L) {
    for (int p = 0; p < B; ++p) {
        Row row = 0.0f;
        row[p] = 1.0f;
        store_row(L + p * B, row);
    }
    for (int p = 0; p < B; ++p) {
        const Row row = load_row(D + p * B), inverse = load_row(L + p * B);
        const float over = 1.0f / D[p * B + p];
        for (int q = p + 1; q < B; ++q) {
            const float factor = D[p * B + q] * over;
            store_row(D + q * B, load_row(D + q * B) - factor * row);
            store_row(L + q * B, load_row(L + q * B) - factor * inverse);
        }
    }
    // Roots come last: else each pivot would wait for the one before it.
    for (int p = 0; p < B; ++p) store_row(L + p * B, load_row(L + p * B) * (1.0f / sqrtf(D[p * B + p])));
}

// Scratch memory beside the system. The system's diagonal tiles are replaced by the results of `invert_factor`.
struct ByThread {
    static const int AT_ONCE = 1;  // panels
    alignas(64) float rest[TILE];  // a tile after products were subtracted

    inline void know(const int*, int, int, int) {}
};

inline void factor_and_solve(const System& system, ByThread& own, int, int) {
    const int* top = system.top;
    for (int J = 0; J < system.panels; ++J) {
        float* panel = system.panel(J);
        float* y = system.rhs + J * B;
        Row rest = load_row(y);
        for (int K = top[J]; K <= J; ++K) {
            const int first = top[K] > top[J] ? top[K] : top[J];
            const float* other = system.panel(K);
            float* tile = panel + K * TILE;
            subtract_products(tile, other + first * TILE, panel + first * TILE, K - first, own.rest);
            if (K == J) {
                invert_factor(own.rest, tile);
            } else {
                times_lower(other + K * TILE, own.rest, tile);
                rest -= times_columns(tile, load_row(system.rhs + K * B));
            }
        }
        store_row(y, times_rows(panel + J * TILE, rest));
    }
    for (int J = system.panels - 1; J >= 0; --J) {
        const float* panel = system.panel(J);
        float* x = system.rhs + J * B;
        const Row solution = times_columns(panel + J * TILE, load_row(x));
        store_row(x, solution);
        for (int K = top[J]; K < J; ++K) {
            float* above = system.rhs + K * B;
            store_row(above, load_row(above) - times_rows(panel + K * TILE, solution));
        }
    }
}

}  // namespace petmjx
#endif

#endif
