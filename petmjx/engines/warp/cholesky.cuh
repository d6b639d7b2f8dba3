// H·x = g by Cholesky within H's envelope: H = UᵀU, one world per block of threads.
//
// H's upper triangle is stored in whole tiles of 16 × 16: panel J's columns begin at row 16·top[J]. The factor is zero
// above that. Panels follow one another, each one row by row, so that an envelope takes no more room than it needs and
// fits into shared memory where it is small. A panel is half a warp wide, and the code below depends on it.

#ifndef PETMJX_CHOLESKY_CUH
#define PETMJX_CHOLESKY_CUH

#include "block.cuh"

namespace petmjx {

const int B = 16;  // rows of a panel

// The columns of a body: six neighbours, which lie in one panel or in two.
struct Columns {
    float* one;
    float* two;
    int first;  // of the panel's columns

    inline CUDA_CALLABLE float& entry(int row, int i) const {
        const int column = first + i;
        return (column < B ? one : two)[row * B + column % B];
    }
};

struct System {
    float* A;         // H, then its factor in its place
    float* strip;     // shared memory for the row of a panel, if A is not there; else null
    int strip_columns;
    int panels;
    const int* top;   // (panels,) first panel that each panel's columns reach up to
    const int* base;  // (panels + 1,) where each panel's numbers begin
    float* rhs;       // (16·panels,) g, then x in its place; NaN if H is not positive definite

    // Entry (0, 16·J), if it were stored; the entry of row r and column 16·J + c is at r·16 + c.
    inline CUDA_CALLABLE float* panel(int J) const { return A + base[J] - top[J] * B * B; }

    inline CUDA_CALLABLE float& entry(int row, int column) const {
        return panel(column / B)[row * B + column % B];
    }

    inline CUDA_CALLABLE Columns columns(int body) const {
        const int J = 6 * body / B, first = 6 * body % B;
        float* one = panel(J);
        return {one, first + 6 > B ? panel(J + 1) : one, first};
    }
};

// What the threads of a block share. MOST: panels of the largest system.
template <int MOST>
struct Factoring {
    alignas(16) float W[B * B];         // inverse of the diagonal tile's factor, transposed
    alignas(16) float solved[B];        // the panel's part of the solution
    alignas(16) float solutions[MOST_WARPS][B];  // the same on the way back, for each warp
    int active[2][MOST];                // panels whose columns reach up to a panel: this one's, and the next one's
    int active_count[2];
};

// Lists the panels below panel K whose columns reach up to it. The second warp does it while the first one works.
template <int MOST>
inline CUDA_CALLABLE void list_reaching(const System& system, Factoring<MOST>& shared, int K, int thread) {
    int* list = shared.active[K & 1];
    int found = 0;
#if defined(__CUDA_ARCH__)
    if (thread < 32 || thread >= 64) return;
    const int lane = thread - 32;
    for (int first = K + 1; first < system.panels; first += 32) {
        const bool inside = first + lane < system.panels && system.top[first + lane] <= K;
        const unsigned mask = __ballot_sync(0xffffffffu, inside);
        if (inside) list[found + __popc(mask & ((1u << lane) - 1u))] = first + lane;
        found += __popc(mask);
    }
    if (lane == 0) shared.active_count[K & 1] = found;
#else
    for (int J = K + 1; J < system.panels; ++J)
        if (system.top[J] <= K) list[found++] = J;
    shared.active_count[K & 1] = found;
#endif
}

// Factors panel K's diagonal tile and solves with it for the right-hand side. W is the inverse of the tile's factor,
// transposed: solving with the factor is then a product with W. On a GPU only the first warp does this.
template <int MOST>
inline CUDA_CALLABLE void factor_diagonal(const System& system, Factoring<MOST>& shared, int K, int thread) {
    const int k = K * B;
    float* own = system.panel(K) + k * B;
    float* W = shared.W;
    float* solved = shared.solved;
    float* rhs = system.rhs;
#if defined(__CUDA_ARCH__)
    if (thread >= 32) return;
    // One column per thread: those of the tile, the right-hand side, the columns of the identity except the last. All
    // are eliminated in the same way, two rows at a time, and scaled separately, so that no row has to wait for a root
    // or for the second reciprocal of the row before.
    float v[16], inverse = 0.0f;
    #pragma unroll
    for (int p = 0; p < 16; ++p) {
        v[p] = thread == p + 17 ? 1.0f : 0.0f;
        if (thread < 16 && p <= thread) v[p] = own[p * B + thread];
        if (thread == 16) v[p] = rhs[k + p];
    }
    #pragma unroll
    for (int p = 0; p < 16; p += 2) {
        const float pivot = __shfl_sync(0xffffffffu, v[p], p);
        const float beside = __shfl_sync(0xffffffffu, v[p], p + 1);
        const float below = __shfl_sync(0xffffffffu, v[p + 1], p + 1);
        const float reciprocal = __fdividef(1.0f, pivot), factor = beside * reciprocal;
        const float next = below - factor * beside, rest = v[p + 1] - factor * v[p];
        const float y = rest * __fdividef(1.0f, next), x = v[p] * reciprocal - factor * y;
        #pragma unroll
        for (int q = p + 2; q < 16; ++q) {
            v[q] -= __shfl_sync(0xffffffffu, v[p], q) * x;
            v[q] -= __shfl_sync(0xffffffffu, v[p + 1], q) * y;
        }
        v[p] *= rsqrtf(pivot);
        inverse = rsqrtf(next);
        v[p + 1] = rest * inverse;
    }
    if (thread == 16) {
        #pragma unroll
        for (int p = 0; p < 16; ++p) rhs[k + p] = solved[p] = v[p];
    }
    if (thread >= 16) {
        const int column = thread == 16 ? 15 : thread - 17;
        #pragma unroll
        for (int p = 0; p < 16; ++p) {
            const float value = thread == 16 ? (p == 15 ? inverse : 0.0f) : v[p];
            W[p * B + column] = value;
            own[p * B + column] = value;
        }
    }
#else
    for (int p = 0; p < B; ++p) {
        for (int q = 0; q < B; ++q) W[p * B + q] = p == q ? 1.0f : 0.0f;
        solved[p] = rhs[k + p];
    }
    for (int p = 0; p < B; ++p) {
        const float inverse = 1.0f / sqrtf(own[p * B + p]);
        for (int c = p; c < B; ++c) own[p * B + c] *= inverse;
        for (int c = 0; c <= p; ++c) W[p * B + c] *= inverse;
        solved[p] *= inverse;
        for (int q = p + 1; q < B; ++q) {
            const float factor = own[p * B + q];
            for (int c = q; c < B; ++c) own[q * B + c] -= factor * own[p * B + c];
            for (int c = 0; c <= p; ++c) W[q * B + c] -= factor * W[p * B + c];
            solved[q] -= factor * solved[p];
        }
    }
    for (int p = 0; p < B; ++p) {
        rhs[k + p] = solved[p];
        for (int c = 0; c < B; ++c) own[p * B + c] = W[p * B + c];
    }
#endif
}

// Panel K's row of the factor, two threads per column and a warp per tile; a copy of it in the strip, if it fits.
template <int MOST>
inline CUDA_CALLABLE void factor_row(
    const System& system, const Factoring<MOST>& shared, int K, int across, bool copy, int thread, int threads
) {
    const int* reached = shared.active[K & 1];
#if defined(__CUDA_ARCH__)
    const int c = thread % B, odd = thread / B % 2;
    for (int tile = thread / 32; tile < across; tile += threads / 32) {
        const int J = reached[tile];
        float* own = system.panel(J) + K * B * B + c;
        float v[16];
        #pragma unroll
        for (int p = 0; p < 16; ++p) v[p] = own[p * B];
        wait_for_warp();
        float update = 0.0f;
        #pragma unroll
        for (int i = 0; i < 8; ++i) {
            const int p = 2 * i + odd;  // W is zero behind its diagonal
            float value = 0.0f;
            #pragma unroll
            for (int q = 0; q < 2 * i + 2; ++q) value += shared.W[p * B + q] * v[q];
            update += value * shared.solved[p];
            own[p * B] = value;
            if (copy) system.strip[p * system.strip_columns + tile * B + c] = value;
        }
        update += __shfl_xor_sync(0xffffffffu, update, 16);
        if (!odd) system.rhs[J * B + c] -= update;
    }
#else
    for (int column = thread; column < across * B; column += threads) {
        const int J = reached[column / B], c = column % B;
        float* own = system.panel(J) + K * B * B + c;
        float update = 0.0f;
        for (int p = B - 1; p >= 0; --p) {
            float value = 0.0f;
            for (int q = 0; q <= p; ++q) value += shared.W[p * B + q] * own[q * B];
            own[p * B] = value;
            update += value * shared.solved[p];
            if (copy) system.strip[p * system.strip_columns + column] = value;
        }
        system.rhs[J * B + c] -= update;
    }
#endif
}

// Subtracts the product of panel K's row from rows below: 4 × 4 entries per thread, for each pair of panels. `first`,
// `items`, `stride`: which of these a thread takes. The first B of them are the tile of the first panel that K reaches.
template <int MOST>
inline CUDA_CALLABLE void update_below(
    const System& system, const Factoring<MOST>& shared, int K, bool copied, int first, int items, int stride
) {
    const int* reached = shared.active[K & 1];
    const int pitch = copied ? system.strip_columns : B;
    int right = 0, before = 0;
    for (int item = first; item < items; item += stride) {
        while (item / B - before > right) before += ++right;
        const int left = item / B - before, down = item % B / 4 * 4, across = item % 4 * 4;
        float* panel = system.panel(reached[right]);
        const float* one = (copied ? system.strip + left * B : system.panel(reached[left]) + K * B * B) + down;
        const float* two = (copied ? system.strip + right * B : panel + K * B * B) + across;
        float* target = panel + (reached[left] * B + down) * B + across;
        float sum[4][4];
        #pragma unroll
        for (int i = 0; i < 4; ++i) load_four(sum[i], target + i * B);
        #pragma unroll 4
        for (int p = 0; p < 16; ++p) {
            float a[4], b[4];
            load_four(a, one + p * pitch);
            load_four(b, two + p * pitch);
            #pragma unroll
            for (int i = 0; i < 4; ++i) {
                #pragma unroll
                for (int j = 0; j < 4; ++j) sum[i][j] -= a[i] * b[j];
            }
        }
        #pragma unroll
        for (int i = 0; i < 4; ++i) store_four(target + i * B, sum[i]);
    }
}

// Updates the rows below panel K, and factors the next diagonal tile: on a GPU the first warp updates that tile before
// all others and factors it while the other warps go on. K is -1 before the first panel. The longest parts of the code
// stand here once, since a GPU has little room for instructions.
template <int MOST>
inline CUDA_CALLABLE void update_and_go_on(
    const System& system, Factoring<MOST>& shared, int K, int across, bool copied, int thread, int threads
) {
    list_reaching(system, shared, K + 1, thread);
    int first = thread, items = across * (across + 1) / 2 * B, stride = threads;
#if defined(__CUDA_ARCH__)
    const int next = across > 0 && shared.active[K & 1][0] == K + 1 ? B : 0;
    const bool ahead = thread < 32;
    first = ahead ? thread : next + thread - 32;
    items = ahead ? next : items;
    stride = ahead ? 32 : threads - 32;
#endif
    update_below(system, shared, K, copied, first, items, stride);
#if defined(__CUDA_ARCH__)
    if (!ahead) return;
    wait_for_warp();
#endif
    if (K + 1 < system.panels) factor_diagonal(system, shared, K + 1, thread);
}

// Backward: U·x = y. The solution of each panel is subtracted from the rows above at once. On a GPU each warp finds it
// for itself, so that none waits for another one.
template <int MOST>
inline CUDA_CALLABLE void solve_backward(const System& system, Factoring<MOST>& shared, int thread, int threads) {
    float* rhs = system.rhs;
#if defined(__CUDA_ARCH__)
    float* solved = shared.solutions[thread / 32];
    const int first = thread % 32, stride = 32;
#else
    float* solved = shared.solutions[0];
    const int first = 0, stride = 1;
#endif
    for (int K = system.panels - 1; K >= 0; --K) {
        const int k = K * B;
        const float* panel = system.panel(K);
        for (int p = first; p < B; p += stride) {
            float value = 0.0f;
            #pragma unroll
            for (int q = 0; q < 16; ++q) value += panel[(k + q) * B + p] * rhs[k + q];
            solved[p] = value;
        }
        wait_for_warp();
        for (int j = system.top[K] * B + thread; j < k; j += threads) {
            float v[16], value = rhs[j];
            #pragma unroll
            for (int p = 0; p < 16; p += 4) load_four(v + p, panel + j * B + p);
            #pragma unroll
            for (int p = 0; p < 16; ++p) value -= v[p] * solved[p];
            rhs[j] = value;
        }
        wait_for_all();
        for (int p = thread; p < B; p += threads) rhs[k + p] = solved[p];
    }
    wait_for_all();
}

// Forward, right-looking by panels: H = UᵀU in place and y = U⁻ᵀ·g at the same time. Then backward.
template <int MOST>
inline CUDA_CALLABLE void factor_and_solve(const System& system, Factoring<MOST>& shared, int thread, int threads) {
    for (int K = -1; K < system.panels; ++K) {
        const int across = K < 0 ? 0 : shared.active_count[K & 1];
        const bool copy = system.strip && across * B <= system.strip_columns;
        if (K >= 0) {
            factor_row(system, shared, K, across, copy, thread, threads);
            wait_for_all();
        }
        update_and_go_on(system, shared, K, across, copy, thread, threads);
        wait_for_all();
    }
    solve_backward(system, shared, thread, threads);
}

}  // namespace petmjx

#endif
