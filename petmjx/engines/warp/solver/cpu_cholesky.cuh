// Solves H·x = g by a Cholesky factorisation within H's envelope, with one thread, for CPUs. A vector register of a CPU
// holds a row of a tile, or a part of it.
//
// Left-looking: a tile is read once, all products of the tiles above it are subtracted, and it is written once. The
// factors of these products are contiguous tiles, in the tile's own panel and in one other panel.

#ifndef PETMJX_CPU_CHOLESKY_CUH
#define PETMJX_CPU_CHOLESKY_CUH

#include "linear_system.cuh"

#if !defined(__CUDA_ARCH__)
namespace petmjx {

// A row of a tile. Warp compiles for CPUs with Clang, which has vector types.
typedef float Row __attribute__((ext_vector_type(B)));
typedef float Half __attribute__((ext_vector_type(B / 2)));
const int MIDDLE = B / 2;  // where the second half of a row begins

inline Row load_row(const float* from) {
    Row row;
    __builtin_memcpy(&row, from, sizeof row);
    return row;
}

inline void store_row(float* to, const Row& row) { __builtin_memcpy(to, &row, sizeof row); }

// Rows of a tile that are summed at a time, limited by the registers.
#if defined(__AVX512F__)
const int ROWS = 16;
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

// The products of a tile's rows with x. Each row's products are summed as halves, quarters, eighths, and sixteenths of
// the row. Rows share the vectors of these sums: two rows of halves, four of quarters, and so on.
inline Row times_rows(const float* tile, const Row& x) {
    Row r[B];
    #pragma unroll
    for (int p = 0; p < B; ++p) r[p] = load_row(tile + p * B) * x;
    Row two[8];
    #pragma unroll
    for (int p = 0; p < 8; ++p) {
        const Row a = r[p], b = r[p + 8];
        two[p] = __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23)
            + __builtin_shufflevector(a, b, 8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30, 31);
    }
    Row four[4];
    #pragma unroll
    for (int p = 0; p < 4; ++p) {
        const Row a = two[p], b = two[p + 4];
        four[p] = __builtin_shufflevector(a, b, 0, 1, 2, 3, 16, 17, 18, 19, 8, 9, 10, 11, 24, 25, 26, 27)
            + __builtin_shufflevector(a, b, 4, 5, 6, 7, 20, 21, 22, 23, 12, 13, 14, 15, 28, 29, 30, 31);
    }
    Row eight[2];
    #pragma unroll
    for (int p = 0; p < 2; ++p) {
        const Row a = four[p], b = four[p + 2];
        eight[p] = __builtin_shufflevector(a, b, 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29)
            + __builtin_shufflevector(a, b, 2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31);
    }
    const Row a = eight[0], b = eight[1];
    return __builtin_shufflevector(a, b, 0, 16, 2, 18, 4, 20, 6, 22, 8, 24, 10, 26, 12, 28, 14, 30)
        + __builtin_shufflevector(a, b, 1, 17, 3, 19, 5, 21, 7, 23, 9, 25, 11, 27, 13, 29, 15, 31);
}

// A tile minus the products XᵀY of X's and Y's rows from `begin` to `end`. Rows of contiguous tiles are contiguous.
inline void subtract_products(const float* tile, const float* X, const float* Y, int begin, int end, float* out) {
    for (int first = 0; first < B; first += ROWS) {
        Row rows[ROWS];
        #pragma unroll
        for (int i = 0; i < ROWS; ++i) rows[i] = load_row(tile + (first + i) * B);
        for (int p = begin; p < end; ++p) {
            const Row right = load_row(Y + p * B);
            #pragma unroll
            for (int i = 0; i < ROWS; ++i) rows[i] -= X[p * B + first + i] * right;
        }
        #pragma unroll
        for (int i = 0; i < ROWS; ++i) store_row(out + (first + i) * B, rows[i]);
    }
}

// The upper triangle of a tile minus the products XᵀX of X's rows from `begin` to `end`.
inline void subtract_squares(const float* tile, const float* X, int begin, int end, float* out) {
    const int COUNT = ROWS < MIDDLE ? ROWS : MIDDLE;
    for (int first = 0; first < MIDDLE; first += COUNT) {
        Row rows[COUNT];
        Half ends[COUNT];  // second halves of later rows, whose first halves are below the diagonal
        #pragma unroll
        for (int i = 0; i < COUNT; ++i) {
            rows[i] = load_row(tile + (first + i) * B);
            ends[i] = load_row(tile + (MIDDLE + first + i) * B).hi;
        }
        for (int p = begin; p < end; ++p) {
            const Row right = load_row(X + p * B);
            #pragma unroll
            for (int i = 0; i < COUNT; ++i) {
                rows[i] -= X[p * B + first + i] * right;
                ends[i] -= X[p * B + MIDDLE + first + i] * right.hi;
            }
        }
        #pragma unroll
        for (int i = 0; i < COUNT; ++i) {
            store_row(out + (first + i) * B, rows[i]);
            __builtin_memcpy(out + (MIDDLE + first + i) * B + MIDDLE, &ends[i], sizeof ends[i]);
        }
    }
}

// L·tile, where L is a lower triangle.
inline void times_lower(const float* L, const float* tile, float* out) {
    #pragma unroll
    for (int first = 0; first < B; first += ROWS) {
        Row rows[ROWS] = {};
        for (int p = 0; p < first; ++p) {
            const Row right = load_row(tile + p * B);
            #pragma unroll
            for (int i = 0; i < ROWS; ++i) rows[i] += L[(first + i) * B + p] * right;
        }
        #pragma unroll
        for (int p = 0; p < ROWS; ++p) {
            const Row right = load_row(tile + (first + p) * B);
            #pragma unroll
            for (int i = p; i < ROWS; ++i) rows[i] += L[(first + i) * B + first + p] * right;
        }
        #pragma unroll
        for (int i = 0; i < ROWS; ++i) store_row(out + (first + i) * B, rows[i]);
    }
}

// The lower triangle L with L·D·Lᵀ = I: the inverse of D's factor. D's part below the diagonal is not used.
//
// Each pivot waits for the previous one. So the next pivot is computed as a single number, before the rest of its row.
// The compiler is told that `shares` may change in memory, so that it loads them. From memory, a number multiplies a
// vector without a shuffle.
inline void invert_factor(const float* D, float* L) {
    Row rows[MIDDLE], pivots;
    Half ends[MIDDLE];  // second halves of the later rows
    alignas(64) float shares[B][B];  // shares of each pivot's row that are subtracted from later rows
    #pragma unroll
    for (int p = 0; p < MIDDLE; ++p) {
        rows[p] = load_row(D + p * B);
        ends[p] = load_row(D + (MIDDLE + p) * B).hi;
    }
    float pivot = rows[0][0];
    #pragma unroll
    for (int p = 0; p < MIDDLE; ++p) {
        const Row& row = rows[p];
        pivots[p] = pivot;
        const float over = 1.0f / pivot;
        pivot = (p + 1 < MIDDLE ? rows[p + 1][p + 1] : ends[0][0]) - row[p + 1] * over * row[p + 1];
        const Row share = row * over;
        store_row(shares[p], share);
        asm volatile("" : "+m"(shares));
        #pragma unroll
        for (int q = p + 1; q < MIDDLE; ++q) rows[q] -= (q == p + 1 ? share[q] : shares[p][q]) * row;
        #pragma unroll
        for (int q = 0; q < MIDDLE; ++q) ends[q] -= shares[p][MIDDLE + q] * row.hi;
    }
    #pragma unroll
    for (int p = 0; p < MIDDLE; ++p) {
        const Half& row = ends[p];
        pivots[MIDDLE + p] = pivot;
        const float over = 1.0f / pivot;
        if (p + 1 < MIDDLE) pivot = ends[p + 1][p + 1] - row[p + 1] * over * row[p + 1];
        const Half share = row * over;
        __builtin_memcpy(shares[MIDDLE + p] + MIDDLE, &share, sizeof share);
        asm volatile("" : "+m"(shares));
        #pragma unroll
        for (int q = p + 1; q < MIDDLE; ++q) ends[q] -= (q == p + 1 ? share[q] : shares[MIDDLE + p][MIDDLE + q]) * row;
    }
    alignas(64) float roots[B];
    store_row(roots, 1.0f / __builtin_elementwise_sqrt(pivots));
    Half low[B] = {}, high[MIDDLE] = {};  // first halves of L's rows; second halves of its later rows
    #pragma unroll
    for (int p = 0; p < MIDDLE; ++p) low[p][p] = high[p][p] = 1.0f;
    #pragma unroll
    for (int p = 0; p < B; ++p) {
        #pragma unroll
        for (int q = p + 1; q < B; ++q) {
            low[q] -= shares[p][q] * low[p];
            if (p >= MIDDLE) high[q - MIDDLE] -= shares[p][q] * high[p - MIDDLE];
        }
        Row row;
        row.lo = low[p] * roots[p];
        if (p < MIDDLE) row.hi = 0.0f;
        else row.hi = high[p - MIDDLE] * roots[p];
        store_row(L + p * B, row);
    }
}

// Scratch memory beside the system. The system's diagonal tiles are replaced by the results of `invert_factor`.
struct ByThread {
    static const int AT_ONCE = 1;  // panels
    alignas(64) float rest[TILE];  // a tile after products were subtracted
    int begin[PETMJX_MOST_PANELS];  // first row of each panel that is not zero

    inline void know(const int*, int, int, int) {}
};

// The first row of a panel that is not zero; `row` is the first row of the panel's first tile. The factor is zero above
// this row, too.
inline int first_row(const float* panel, int row) {
    for (const int end = row + B - 1; row < end; ++row) {
        const Row numbers = load_row(panel + row * B);
        if (__builtin_reduce_or(numbers != 0.0f)) break;
    }
    return row;
}

inline void factor_and_solve(const System& system, ByThread& own, int, int) {
    const int* top = system.top;
    for (int J = 0; J < system.panels; ++J) {
        float* panel = system.panel(J);
        float* y = system.rhs + J * B;
        Row rest = load_row(y);
        own.begin[J] = first_row(panel, top[J] * B);
        for (int K = top[J]; K <= J; ++K) {
            const float* other = system.panel(K);
            float* tile = panel + K * TILE;
            const int begin = own.begin[K] > own.begin[J] ? own.begin[K] : own.begin[J];
            if (K == J) {
                subtract_squares(tile, panel, begin, K * B, own.rest);
                invert_factor(own.rest, tile);
            } else {
                subtract_products(tile, other, panel, begin, K * B, own.rest);
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
