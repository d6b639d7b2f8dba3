// H·x = g by Cholesky within H's envelope: H = UᵀU, one world per block of threads.
//
// H's upper triangle is stored in whole tiles of 16 × 16: panel J's columns begin at row 16·top[J]. The factor is zero
// above that. A panel is half a warp wide, and the code below depends on it.

#ifndef PETMJX_CHOLESKY_CUH
#define PETMJX_CHOLESKY_CUH

#include "block.cuh"

namespace petmjx {

const int B = 16;        // rows of a panel
const int STRIP = 160;   // columns of one panel that are kept in shared memory

struct System {
    float* A;        // (rows, ld): H, then its factor in its place
    int ld;
    int panels;
    const int* top;  // (panels,) first panel that each panel's columns reach up to
    float* rhs;      // (16·panels,) g, then x in its place; NaN if H is not positive definite
};

// What the threads of a block share. MOST: panels of the largest system.
template <int MOST>
struct Factoring {
    alignas(16) float kept[B * STRIP];  // a panel's row, where it fits
    alignas(16) float W[B * B];         // inverse of the diagonal tile's factor, transposed
    alignas(16) float solved[B];        // the panel's part of the solution
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
    const int k = K * B, ld = system.ld;
    float* own = system.A + (size_t)k * ld;
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
        if (thread < 16 && p <= thread) v[p] = own[(size_t)p * ld + k + thread];
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
            own[(size_t)p * ld + k + column] = value;
        }
    }
#else
    for (int p = 0; p < B; ++p) {
        for (int q = 0; q < B; ++q) W[p * B + q] = p == q ? 1.0f : 0.0f;
        solved[p] = rhs[k + p];
    }
    for (int p = 0; p < B; ++p) {
        const float inverse = 1.0f / sqrtf(own[(size_t)p * ld + k + p]);
        for (int c = p; c < B; ++c) own[(size_t)p * ld + k + c] *= inverse;
        for (int c = 0; c <= p; ++c) W[p * B + c] *= inverse;
        solved[p] *= inverse;
        for (int q = p + 1; q < B; ++q) {
            const float factor = own[(size_t)p * ld + k + q];
            for (int c = q; c < B; ++c) own[(size_t)q * ld + k + c] -= factor * own[(size_t)p * ld + k + c];
            for (int c = 0; c <= p; ++c) W[q * B + c] -= factor * W[p * B + c];
            solved[q] -= factor * solved[p];
        }
    }
    for (int p = 0; p < B; ++p) {
        rhs[k + p] = solved[p];
        for (int c = 0; c < B; ++c) own[(size_t)p * ld + k + c] = W[p * B + c];
    }
#endif
}

// Panel K's row of the factor, one column per thread, kept in shared memory if it fits. Waits for the diagonal tile.
template <int MOST>
inline CUDA_CALLABLE void factor_row(
    const System& system, Factoring<MOST>& shared, int K, int columns, bool fits, int thread, int threads
) {
    const int ld = system.ld;
    const int* reached = shared.active[K & 1];
    float* own = system.A + (size_t)(K * B) * ld;
    for (int base = 0; base < columns; base += threads) {
        const int column = base + thread;
        const int c = column < columns ? reached[column / B] * B + column % B : 0;
        float v[16];
        #pragma unroll
        for (int p = 0; p < 16; ++p) v[p] = column < columns ? own[(size_t)p * ld + c] : 0.0f;
        if (base == 0) wait_for_all();
        if (column >= columns) continue;
        float update = 0.0f;
        #pragma unroll
        for (int p = 15; p >= 0; --p) {
            float value = 0.0f;
            #pragma unroll
            for (int q = 0; q <= p; ++q) value += shared.W[p * B + q] * v[q];
            v[p] = value;
            update += value * shared.solved[p];
        }
        #pragma unroll
        for (int p = 0; p < 16; ++p) {
            own[(size_t)p * ld + c] = v[p];
            if (fits) shared.kept[p * STRIP + column] = v[p];
        }
        system.rhs[c] -= update;
    }
}

// Subtracts the product of panel K's row from all rows below: 4 × 4 entries per thread, for each pair of panels.
template <int MOST>
inline CUDA_CALLABLE void update_below(
    const System& system, Factoring<MOST>& shared, int K, int columns, bool fits, int thread, int threads
) {
    const int ld = system.ld;
    const int* reached = shared.active[K & 1];
    float* own = system.A + (size_t)(K * B) * ld;
    float* strip = fits ? shared.kept : own;
    const int pitch = fits ? STRIP : ld;
    int right = 0, before = 0;
    const int tiles = columns / B * (columns / B + 1) / 2 * B;
    for (int item = thread; item < tiles; item += threads) {
        while (item / B - before > right) before += ++right;
        const int left = item / B - before, down = item % B / 4 * 4, across = item % 4 * 4;
        const float* one = strip + (fits ? left : reached[left]) * B + down;
        const float* two = strip + (fits ? right : reached[right]) * B + across;
        float* target = system.A + (size_t)(reached[left] * B + down) * ld + reached[right] * B + across;
        float sum[4][4];
        #pragma unroll
        for (int i = 0; i < 4; ++i) load_four(sum[i], target + (size_t)i * ld);
        #pragma unroll
        for (int p = 0; p < 16; ++p) {
            float a[4], b[4];
            load_four(a, one + (size_t)p * pitch);
            load_four(b, two + (size_t)p * pitch);
            #pragma unroll
            for (int i = 0; i < 4; ++i) {
                #pragma unroll
                for (int j = 0; j < 4; ++j) sum[i][j] -= a[i] * b[j];
            }
        }
        #pragma unroll
        for (int i = 0; i < 4; ++i) store_four(target + (size_t)i * ld, sum[i]);
    }
}

// Backward: U·x = y. The solution of each panel is subtracted from the rows above at once.
inline CUDA_CALLABLE void solve_backward(const System& system, float* solved, int thread, int threads) {
    const float* A = system.A;
    const int ld = system.ld;
    float* rhs = system.rhs;
    for (int K = system.panels - 1; K >= 0; --K) {
        const int k = K * B, from = system.top[K] * B;
        for (int p = thread; p < B; p += threads) {
            float value = 0.0f;
            #pragma unroll
            for (int q = 0; q < 16; ++q) value += A[(size_t)(k + q) * ld + k + p] * rhs[k + q];
            solved[p] = value;
        }
        for (int base = from; base < k || base == from; base += threads) {
            const int j = base + thread;
            float v[16];
            #pragma unroll
            for (int p = 0; p < 16; ++p) v[p] = 0.0f;
            if (j < k) {
                #pragma unroll
                for (int p = 0; p < 16; p += 4) load_four(v + p, A + (size_t)j * ld + k + p);
            }
            if (base == from) wait_for_all();
            if (j >= k) continue;
            float value = rhs[j];
            #pragma unroll
            for (int p = 0; p < 16; ++p) value -= v[p] * solved[p];
            rhs[j] = value;
        }
        for (int p = thread; p < B; p += threads) rhs[k + p] = solved[p];
        wait_for_all();
    }
}

// Forward, right-looking by panels: H = UᵀU in place and y = U⁻ᵀ·g at the same time. Then backward.
template <int MOST>
inline CUDA_CALLABLE void factor_and_solve(const System& system, Factoring<MOST>& shared, int thread, int threads) {
    list_reaching(system, shared, 0, thread);
    wait_for_all();
    for (int K = 0; K < system.panels; ++K) {
        const int columns = shared.active_count[K & 1] * B;
        const bool fits = columns <= STRIP;
        factor_diagonal(system, shared, K, thread);
        list_reaching(system, shared, K + 1, thread);
        factor_row(system, shared, K, columns, fits, thread, threads);
        wait_for_all();
        update_below(system, shared, K, columns, fits, thread, threads);
        wait_for_all();
    }
    solve_backward(system, shared.solved, thread, threads);
}

}  // namespace petmjx

#endif
