// H = UᵀU and y = U⁻ᵀ·g, two panels at a time, for worlds of many panels, whose Hessian does not fit in shared memory.
// The rows below are read and written half as often as with one panel at a time.
//
// Everything waits for the diagonal tiles, one after another. So the first warp does little else than find the next
// diagonal tile. The other warps find the rows of U and subtract their products from the rows below.

#ifndef PETMJX_CHOLESKY_LARGE_CUH
#define PETMJX_CHOLESKY_LARGE_CUH

#include "panels.cuh"

namespace petmjx {

// Shared memory of the threads of a world. MOST: panels of the largest system.
template <int MOST>
struct PanelPairs {
    static const int AT_ONCE = 2;  // panels
    static const int SPREAD = 2;  // copies of the code of back substitution
    Diagonal diagonal;
    alignas(16) float W[2][B * PITCH];  // inverses of the two panels' diagonal tiles' factors
    alignas(16) float between[MOST_WARPS][TILE];  // the tile that links both panels; each warp finds it for itself
    alignas(16) float solved[2][B];  // both panels' parts of y
    alignas(16) float solutions[MOST_WARPS * 3 * B];
    int reached[2][MOST];  // panels whose columns reach up to the current two panels, and up to the next two
    int reached_count[2];

    // As in SinglePanels, but nothing is kept: lists for all panels of a large system would take much of the shared memory.
    inline CUDA_CALLABLE void know(const int*, int, int, int) {}
};

// Panels K and K + 1, as the functions below need them.
struct Two {
    int K;
    const int* reached;  // later panels whose columns reach up to one of them
    int across;          // number of these panels
    bool linked;         // whether the second panel's columns reach up to the first

    // For each reached panel, the strip has its tile of the first row of U (zero if it does not reach that row), and
    // its tile of the second row.
    inline CUDA_CALLABLE static int place(int i, int half) { return (2 * i + half) * TILE; }
};

// Subtracts the products of `count` tiles of the strip, which are TILE numbers apart, from a diagonal tile, and finds W
// of the difference. Called by one warp.
PETMJX_ONCE CUDA_CALLABLE void find_diagonal(
    Diagonal& tile, float* W, float* own, const float* strip, int count, int lane
) {
    Piece entries = load_piece(own, B, lane);
    #pragma unroll 1
    for (int i = 0; i < count; ++i) {
        const Operand x = load_in_order(strip + i * TILE, lane);
        subtract(entries, product(x, x, lane));
    }
    store_piece(tile.D, PITCH, entries, lane);
    wait_for_warp();
    factor_diagonal<ByFours>(tile, W, own, lane);
}

// Finds the first panel's row of U, in its place and in the strip. Subtracts its products with `between`, the tile that
// links both panels, from the second panel's row. Each tile has a warp.
inline CUDA_CALLABLE void factor_first_row(
    const System& system, const float* inverse, const float* between, const Two& two, int first, int stride, int lane
) {
    if (first >= two.across) return;
    const Operand W = load_whole(inverse, PITCH, lane);
    #pragma unroll 1
    for (int i = first; i < two.across; i += stride) {
        const int J = two.reached[i];
        float* strip = system.strip + Two::place(i, 0);
        if (system.top[J] > two.K) {
            const float nothing[4] = {0.0f, 0.0f, 0.0f, 0.0f};
            #pragma unroll 1
            for (int k = 4 * lane; k < TILE; k += 4 * WARP) store_four(strip + k, nothing);
            continue;
        }
        float* own = system.tile(two.K, J);
        float* below = own + TILE;
        Piece entries;
        if (two.linked) entries = load_piece(below, B, lane);
        const Piece piece = product(W, load_whole(own, B, lane), lane);
        wait_for_warp();
        store_piece(own, B, piece, lane);
        store_in_order(strip, piece, lane);
        if (two.linked) {
            wait_for_warp();
            subtract(entries, product(load_in_order(between, lane), load_in_order(strip, lane), lane));
            store_piece(below, B, entries, lane);
        }
    }
}

// Subtracts products of both rows from N tiles of a panel. In each row, the factors are the N tiles from place `left`
// on, and the tile Y.
template <int N>
inline CUDA_CALLABLE void update_tiles(
    const System& system, float* panel, const Two& two, int left, const Operand (&y)[2], int lane
) {
    float* targets[N];
    Piece entries[N], products[N];
    Operand x[N];
    #pragma unroll
    for (int n = 0; n < N; ++n) {
        targets[n] = panel + two.reached[left + n] * TILE;
        entries[n] = load_piece(targets[n], B, lane);
    }
    #pragma unroll
    for (int half = 0; half < 2; ++half) {
        #pragma unroll
        for (int n = 0; n < N; ++n) x[n] = load_in_order(system.strip + Two::place(left + n, half), lane);
        multiply(x, y[half], lane, products);
        #pragma unroll
        for (int n = 0; n < N; ++n) subtract(entries[n], products[n]);
    }
    #pragma unroll
    for (int n = 0; n < N; ++n) store_piece(targets[n], B, entries[n], lane);
}

// Subtracts the products of both panels' rows from the rows below, for a warp's share of the pairs of reached panels.
// It takes three tiles at a time, which do not wait for one another.
inline CUDA_CALLABLE void update_below(const System& system, const Two& two, Share share, int lane) {
    if (share.first >= share.end) return;
    Pair pair(share.first);
    int left = pair.left;
    #pragma unroll 1
    for (int right = pair.right; share.first < share.end; left = 0, ++right) {
        float* panel = system.panel(two.reached[right]);
        const float* strip = system.strip + Two::place(right, 0);
        const Operand y[2] = {load_in_order(strip, lane), load_in_order(strip + TILE, lane)};
        const int stop = left + share.end - share.first < right + 1 ? left + share.end - share.first : right + 1;
        share.first += stop - left;
        #pragma unroll 1
        for (; left + 3 <= stop; left += 3) update_tiles<3>(system, panel, two, left, y, lane);
        if (left + 2 == stop) update_tiles<2>(system, panel, two, left, y, lane);
        if (left + 1 == stop) update_tiles<1>(system, panel, two, left, y, lane);
    }
}

// Subtracts both panels' parts of y, times their rows, from the right-hand sides of the reached panels.
inline CUDA_CALLABLE void update_rhs(
    const System& system, const float (&solved)[2][B], const Two& two, int first, int stride
) {
    #pragma unroll 1
    for (int c = first; c < two.across * B; c += stride) {
        const int J = two.reached[c / B], p = c % B;
        const float* column = system.tile(two.K + 1, J) + p;
        float& rhs = system.rhs[J * B + p];
        if (system.top[J] <= two.K) rhs -= dot(column - TILE, B, solved[0]);
        rhs -= dot(column, B, solved[1]);
    }
}

template <int MOST>
inline CUDA_CALLABLE void list_next(const System& system, PanelPairs<MOST>& shared, int K, int lane) {
    const int found = list_reaching(system.top, system.panels, K + 1, shared.reached[K / 2 & 1], lane);
    if (lane == 0) shared.reached_count[K / 2 & 1] = found;
}

template <int MOST>
inline CUDA_CALLABLE void forward(const System& system, PanelPairs<MOST>& shared, int thread, int threads) {
    const int lane = thread % WARP, warp = thread / WARP, warps = threads / WARP;  // at most MOST_WARPS
    const int others = warps > 1 ? warps - 1 : 1, other = warps > 1 ? warp - 1 : 0;
    const bool is_first = warp == 0, is_other = warp > 0 || warps == 1, is_last = warp == warps - 1;
    if (is_first) find_diagonal(shared.diagonal, shared.W[0], system.tile(0, 0), system.strip, 0, lane);
    if (is_other && other == 0) list_next(system, shared, 0, lane);
    wait_for_all();
    int K = 0;
    #pragma unroll 1
    for (; K + 1 < system.panels; K += 2) {
        const int second = K + 1, next = K + 2;
        const Two two{K, shared.reached[K / 2 & 1], shared.reached_count[K / 2 & 1], system.top[second] <= K};

        // All warps need the tile that links both panels. It is written to its place only after the barrier, since
        // other warps read that place before.
        float* between = shared.between[warp];
        Piece its;
        if (two.linked) {
            its = product(load_whole(shared.W[0], PITCH, lane), load_whole(system.tile(K, second), B, lane), lane);
            store_in_order(between, its, lane);
            wait_for_warp();
        }
        if (is_first)
            find_diagonal(shared.diagonal, shared.W[1], system.tile(second, second), between, two.linked, lane);
        if (is_other) factor_first_row(system, shared.W[0], between, two, other, others, lane);
        if (is_last) solve_forward(system, shared.W[0], K, shared.solved[0], lane);
        wait_for_all();

        // The next diagonal tile waits for the first warp's tile of the second row.
        const int reaches_next = two.across > 0 && two.reached[0] == next ? 1 : 0;
        const int tile = is_first ? 0 : reaches_next + other, end = is_other ? two.across : reaches_next;
        float* strip = system.strip + Two::place(0, 1);
        factor_row(system, shared.W[1], second, two.reached, tile, end, others, strip, 2 * TILE, lane);
        if (is_first) {
            wait_for_warp();
            arrive(1, threads);
            if (next < system.panels)
                find_diagonal(shared.diagonal, shared.W[0], system.tile(next, next), system.strip, 2 * reaches_next, lane);
        }
        if (is_last) {
            if (two.linked) {
                float* own = system.tile(K, second);
                store_piece(own, B, its, lane);
                wait_for_warp();
                #pragma unroll 1
                for (int p = lane; p < B; p += WARP) system.rhs[second * B + p] -= dot(own + p, B, shared.solved[0]);
                wait_for_warp();
            }
            solve_forward(system, shared.W[1], second, shared.solved[1], lane);
        }
        if (is_other) {
            if (other == 0) list_next(system, shared, next, lane);
            wait_for_arrival(1, threads);
            arrive(2, threads);
            update_rhs(system, shared.solved, two, other * WARP + lane, others * WARP);
        } else {
            wait_for_arrival(2, threads);
        }
        // the first product has already been subtracted from the next diagonal tile
        update_below(system, two, Share(two.across, reaches_next, warp, warps), lane);
        wait_for_all();
    }
    if (K < system.panels) {
        if (is_last) solve_forward(system, shared.W[0], K, shared.solved[0], lane);
        wait_for_all();
    }
}

}  // namespace petmjx

#endif
