// H·x = g by Cholesky within H's envelope: H = UᵀU, one world per block of threads.
//
// Right-looking by panels of 16 rows. For each panel all warps find its row of U (`factor_row`). Then the first warp
// finds the next panel's diagonal tile, on which everything waits, while the others subtract the row's products from the
// rows below (`update_below`). Every number has one warp that finds it, so results do not depend on how warps share.

#ifndef PETMJX_CHOLESKY_CUH
#define PETMJX_CHOLESKY_CUH

#include "diagonal.cuh"
#include "substitution.cuh"

namespace petmjx {

// What the threads of a block share. MOST: panels of the largest system.
template <int MOST>
struct Factoring {
    Diagonal diagonal;
    alignas(16) float solved[B];  // the panel's part of y
    alignas(16) float solutions[MOST_WARPS * 3 * B];
    int reached[2][MOST];  // panels whose columns reach up to a panel: of this one, and of the next one
    int reached_count[2];
};

// A diagonal tile takes the first warp as long as this many products.
const int DIAGONAL_PRODUCTS = 10;

// In a step with systems of up to so many panels a GPU waits for instructions more than for results, so the code stands
// there once. For larger ones it is unrolled.
const int FEW_PANELS = 40;

// Lists the panels below panel K whose columns reach up to it. By one warp.
template <int MOST>
inline CUDA_CALLABLE void list_reaching(const System& system, Factoring<MOST>& shared, int K, int lane) {
    int* list = shared.reached[K & 1];
    int found = 0;
#if defined(__CUDA_ARCH__)
    #pragma unroll 1
    for (int first = K + 1; first < system.panels; first += WARP) {
        const bool inside = first + lane < system.panels && system.top[first + lane] <= K;
        const unsigned mask = __ballot_sync(0xffffffffu, inside);
        if (inside) list[found + __popc(mask & ((1u << lane) - 1u))] = first + lane;
        found += __popc(mask);
    }
#else
    for (int J = K + 1; J < system.panels; ++J)
        if (system.top[J] <= K) list[found++] = J;
#endif
    if (lane == 0) shared.reached_count[K & 1] = found;
}

// Panel K's row of U, in its place and in the strip; a warp for each tile.
template <int MOST>
inline CUDA_CALLABLE void factor_row(
    const System& system, const Factoring<MOST>& shared, int K, int warp, int warps, int lane
) {
    const int* reached = shared.reached[K & 1];
    const int across = shared.reached_count[K & 1];
    if (warp >= across) return;
    const Operand W = load_whole(shared.diagonal.W, PITCH, lane);
    #pragma unroll 1
    for (int i = warp; i < across; i += warps) {
        float* own = system.tile(K, reached[i]);
        const Piece piece = product(W, load_whole(own, B, lane), lane);
        wait_for_warp();
        store_piece(own, B, piece, lane);
        store_parts(system.strip + i * PARTS, piece, lane);
    }
}

// Subtracts products of N tiles of the strip, from `left` on, with Y from a panel's tiles.
template <int N>
inline CUDA_CALLABLE void update_tiles(
    const System& system, float* panel, const int* reached, int left, const Operand& y, int lane
) {
    float* targets[N];
    Piece entries[N], products[N];
    Operand x[N];
    #pragma unroll
    for (int n = 0; n < N; ++n) {
        targets[n] = panel + reached[left + n] * B * B;
        entries[n] = load_piece(targets[n], B, lane);
    }
    #pragma unroll
    for (int n = 0; n < N; ++n) x[n] = load_parts(system.strip + (left + n) * PARTS, lane);
    multiply(x, y, lane, products);
    #pragma unroll
    for (int n = 0; n < N; ++n) {
        subtract(entries[n], products[n]);
        store_piece(targets[n], B, entries[n], lane);
    }
}

// Subtracts the product of panel K's row from rows below, for pairs of the panels that it reaches: from `first` to before
// `end` of 0·0, 0·1, 1·1, 0·2, 1·2, 2·2, … By one warp, TOGETHER tiles at a time, which do not wait for one another.
template <int TOGETHER, int MOST>
inline CUDA_CALLABLE void update_below(
    const System& system, const Factoring<MOST>& shared, int K, int first, int end, int lane
) {
    if (first >= end) return;
    const int* reached = shared.reached[K & 1];
    int right = (int)(0.5f * (sqrtf(8.0f * first + 1.0f) - 1.0f));  // rounding may make it one more or less
    if (right * (right + 1) / 2 > first) --right;
    if ((right + 1) * (right + 2) / 2 <= first) ++right;
    int left = first - right * (right + 1) / 2;
    #pragma unroll 1
    for (; first < end; left = 0, ++right) {
        float* panel = system.panel(reached[right]);
        const Operand y = load_parts(system.strip + right * PARTS, lane);
        const int stop = left + end - first < right + 1 ? left + end - first : right + 1;
        first += stop - left;
        #pragma unroll 1
        for (; left + TOGETHER <= stop; left += TOGETHER) update_tiles<TOGETHER>(system, panel, reached, left, y, lane);
        if (TOGETHER > 2 && left + 2 == stop) update_tiles<2>(system, panel, reached, left, y, lane);
        if (TOGETHER > 1 && left + 1 == stop) update_tiles<1>(system, panel, reached, left, y, lane);
    }
}

// Subtracts panel K's part of y, times its row, from the right-hand sides of the panels that it reaches.
template <int MOST>
inline CUDA_CALLABLE void update_rhs(
    const System& system, const Factoring<MOST>& shared, int K, int first, int stride
) {
    const int* reached = shared.reached[K & 1];
    #pragma unroll 1
    for (int c = first; c < shared.reached_count[K & 1] * B; c += stride) {
        const int J = reached[c / B];
        system.rhs[J * B + c % B] -= dot(system.tile(K, J) + c % B, B, shared.solved);
    }
}

// Forward: H = UᵀU in place and y = U⁻ᵀ·g at the same time. Then backward.
template <int MOST>
inline CUDA_CALLABLE void factor_and_solve(const System& system, Factoring<MOST>& shared, int thread, int threads) {
    const int lane = thread % WARP, warp = thread / WARP, warps = threads / WARP;  // at most MOST_WARPS
    const int others = warps > 1 ? warps - 1 : 1, other = warps > 1 ? warp - 1 : 0;
    const bool few = MOST <= FEW_PANELS;
    #pragma unroll 1
    for (int K = -1; K < system.panels; ++K) {
        const int across = K < 0 ? 0 : shared.reached_count[K & 1], next = K + 1;
        const bool finds_next = warp == 0 && next < system.panels;
        Piece diagonal;
        if (finds_next) diagonal = load_piece(system.tile(next, next), B, lane);
        if (K >= 0) {
            if (warp == warps - 1) solve_forward(system, shared.diagonal.W, K, shared.solved, lane);
            factor_row(system, shared, K, warp, warps, lane);
            wait_for_all();
        }
        const int reaches_next = across > 0 && shared.reached[K & 1][0] == next ? 1 : 0;
        if (finds_next) {
            if (reaches_next) {
                const Operand row = load_parts(system.strip, lane);
                subtract(diagonal, product(row, row, lane));
            }
            store_piece(shared.diagonal.D, PITCH, diagonal, lane);
            wait_for_warp();
            factor_diagonal<few ? 1 : 8>(shared.diagonal, system.tile(next, next), lane);
        }
        // The first of the products was for the diagonal tile. The first warp takes the last ones, if there are many.
        const int products = across * (across + 1) / 2, many = products - DIAGONAL_PRODUCTS * others;
        const int of_first = warps > 1 && many > 0 ? many / warps : 0, rest = products - of_first - reaches_next;
        int first = products - of_first, end = products;
        if (warp > 0 || warps == 1) {
            if (other == 0) list_reaching(system, shared, next, lane);
            if (K >= 0) update_rhs(system, shared, K, other * WARP + lane, others * WARP);
            first = reaches_next + other * rest / others, end = reaches_next + (other + 1) * rest / others;
        }
        update_below<few ? 1 : 3>(system, shared, K, first, end, lane);
        wait_for_all();
    }
    solve_backward<few ? 1 : 2>(system, shared.solutions, thread, threads);
}

}  // namespace petmjx

#endif
