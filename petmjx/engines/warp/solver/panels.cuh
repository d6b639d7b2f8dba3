// Common parts of both factorisations: lists of panels, and the order of products.

#ifndef PETMJX_PANELS_CUH
#define PETMJX_PANELS_CUH

#include "diagonal.cuh"
#include "substitution.cuh"

namespace petmjx {

// Number of products that take as long as the first warp needs for a diagonal tile. With two panels at a time, these
// are products of both.
const int DIAGONAL_PRODUCTS = 10;

// Lists the panels after panel K whose columns reach up to it, and returns their number. Called by one warp. `top`: as
// in System.
template <class Number>
inline CUDA_CALLABLE int list_reaching(const int* top, int panels, int K, Number* list, int lane) {
    int found = 0;
#if defined(__CUDA_ARCH__)
    #pragma unroll 1
    for (int first = K + 1; first < panels; first += WARP) {
        const bool inside = first + lane < panels && top[first + lane] <= K;
        const unsigned mask = __ballot_sync(0xffffffffu, inside);
        if (inside) list[found + __popc(mask & ((1u << lane) - 1u))] = (Number)(first + lane);
        found += __popc(mask);
    }
#else
    for (int J = K + 1; J < panels; ++J)
        if (top[J] <= K) list[found++] = (Number)J;
#endif
    return found;
}

// Finds a row of U for the panels `reached`, from place `first` on. Writes it to its place and to the strip, whose
// tiles are `apart` numbers apart. W: inverse of the diagonal tile's factor. Each tile has a warp.
template <class Number>
inline CUDA_CALLABLE void factor_row(
    const System& system, const float* inverse, int row, const Number* reached, int first, int end, int stride, float* strip,
    int apart, int lane
) {
    if (first >= end) return;
    const Operand W = load_whole(inverse, PITCH, lane);
    #pragma unroll 1
    for (int i = first; i < end; i += stride) {
        float* own = system.tile(row, reached[i]);
        const Piece piece = product(W, load_whole(own, B, lane), lane);
        wait_for_warp();
        store_piece(own, B, piece, lane);
        store_in_order(strip + i * apart, piece, lane);
    }
}

// A product of two tiles of a row. Products are numbered 0·0, 0·1, 1·1, 0·2, 1·2, 2·2, …
struct Pair {
    int left, right;

    explicit inline CUDA_CALLABLE Pair(int number) {
        right = (int)(0.5f * (sqrtf(8.0f * number + 1.0f) - 1.0f));  // rounding may make it one more or less
        if (right * (right + 1) / 2 > number) --right;
        if ((right + 1) * (right + 2) / 2 <= number) ++right;
        left = number - right * (right + 1) / 2;
    }
};

// A warp's products of a row's tiles: from `first` to before `end`.
struct Share {
    int first, end;

    // The share of the products of `across` tiles. The first `skipped` products are left out. The first warp takes the
    // last products, if there are many.
    inline CUDA_CALLABLE Share(int across, int skipped, int warp, int warps) {
        const int others = warps > 1 ? warps - 1 : 1, other = warps > 1 ? warp - 1 : 0;
        const int products = across * (across + 1) / 2, many = products - DIAGONAL_PRODUCTS * others;
        const int of_first = warps > 1 && many > 0 ? many / warps : 0, rest = products - of_first - skipped;
        first = other < 0 ? products - of_first : skipped + other * rest / others;
        end = other < 0 ? products : skipped + (other + 1) * rest / others;
    }
};

}  // namespace petmjx

#endif
