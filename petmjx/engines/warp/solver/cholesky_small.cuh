// H = UᵀU and y = U⁻ᵀ·g, one panel at a time, for worlds of few panels. The steps of such worlds wait for instructions
// more than for results, so loops are not unrolled and no code is repeated.
//
// For each panel all warps find its row of U. Then the first warp finds the next panel's diagonal tile, for which
// everything waits. Meanwhile the other warps subtract the row's products from the rows below.

#ifndef PETMJX_CHOLESKY_SMALL_CUH
#define PETMJX_CHOLESKY_SMALL_CUH

#include "panels.cuh"

namespace petmjx {

#if defined(PETMJX_WORLD_OF_A_WARP)
typedef ByPairs Elimination;
const int ONE_SPREAD = 1;
#else
typedef ByFours Elimination;
const int ONE_SPREAD = 2;
#endif

// Shared memory of the threads of a world. MOST: panels of the largest system.
template <int MOST>
struct SinglePanels {
    static const int AT_ONCE = 1;  // panels
    static const int SPREAD = ONE_SPREAD;  // copies of the code of back substitution
    Diagonal diagonal;
    alignas(16) float W[B * PITCH];  // inverse of the diagonal tile's factor
    alignas(16) float solved[B];  // the panel's part of y
    alignas(16) float solutions[MOST_WARPS * 3 * B];
    unsigned char reached[MOST][MOST];  // of each panel: the later panels whose columns reach up to it
    unsigned char reached_count[MOST];

    // All threads call this once for an envelope (`top`, as in System), and wait for one another afterwards.
    inline CUDA_CALLABLE void know(const int* top, int panels, int thread, int threads) {
        const int lane = thread % WARP;
        #pragma unroll 1
        for (int K = thread / WARP; K < panels; K += threads / WARP) {
            const int found = list_reaching(top, panels, K, reached[K], lane);
            if (lane == 0) reached_count[K] = (unsigned char)found;
        }
    }
};

// Subtracts the products of panel K's row from the rows below, for a warp's share of the pairs of reached panels.
inline CUDA_CALLABLE void update_below(const System& system, const unsigned char* reached, Share share, int lane) {
    if (share.first >= share.end) return;
    Pair pair(share.first);
    int left = pair.left;
    #pragma unroll 1
    for (int right = pair.right; share.first < share.end; left = 0, ++right) {
        float* panel = system.panel(reached[right]);
        const Operand y = load_in_order(system.strip + right * TILE, lane);
        #pragma unroll 1
        for (; left <= right && share.first < share.end; ++left, ++share.first) {
            float* target = panel + reached[left] * TILE;
            Piece entries = load_piece(target, B, lane);
            subtract(entries, product(load_in_order(system.strip + left * TILE, lane), y, lane));
            store_piece(target, B, entries, lane);
        }
    }
}

// Subtracts panel K's part of y, times its row, from the right-hand sides of the reached panels.
template <int MOST>
inline CUDA_CALLABLE void update_rhs(
    const System& system, const SinglePanels<MOST>& shared, int K, int first, int stride
) {
    const unsigned char* reached = shared.reached[K];
    #pragma unroll 1
    for (int c = first; c < shared.reached_count[K] * B; c += stride) {
        const int J = reached[c / B];
        system.rhs[J * B + c % B] -= dot(system.tile(K, J) + c % B, B, shared.solved);
    }
}

template <int MOST>
inline CUDA_CALLABLE void forward(const System& system, SinglePanels<MOST>& shared, int thread, int threads) {
    const int lane = thread % WARP, warp = thread / WARP, warps = threads / WARP;  // at most MOST_WARPS
    const int others = warps > 1 ? warps - 1 : 1, other = warps > 1 ? warp - 1 : 0;
    #pragma unroll 1
    for (int K = -1; K < system.panels; ++K) {
        const unsigned char* reached = shared.reached[K < 0 ? 0 : K];
        const int across = K < 0 ? 0 : shared.reached_count[K], next = K + 1;
        const bool finds_next = warp == 0 && next < system.panels;
        Piece diagonal;
        if (finds_next) diagonal = load_piece(system.tile(next, next), B, lane);
        if (K >= 0) {
            if (warp == warps - 1) solve_forward(system, shared.W, K, shared.solved, lane);
            factor_row(system, shared.W, K, reached, warp, across, warps, system.strip, TILE, lane);
            wait_for_all();
        }
        const int reaches_next = across > 0 && reached[0] == next ? 1 : 0;
        if (finds_next) {
            if (reaches_next) {
                const Operand row = load_in_order(system.strip, lane);
                subtract(diagonal, product(row, row, lane));
            }
            store_piece(shared.diagonal.D, PITCH, diagonal, lane);
            wait_for_warp();
            factor_diagonal<Elimination>(shared.diagonal, shared.W, system.tile(next, next), lane);
        }
        if (K >= 0 && (warp > 0 || warps == 1)) update_rhs(system, shared, K, other * WARP + lane, others * WARP);
        // the first product has already been subtracted from the next diagonal tile
        update_below(system, reached, Share(across, reaches_next, warp, warps), lane);
        wait_for_all();
    }
}

}  // namespace petmjx

#endif
