// The inverse of a diagonal tile's factor: D = UᵀU, and W = U⁻¹, an upper triangle. Dividing by U is then a product
// with W. Called by one warp.

#ifndef PETMJX_DIAGONAL_CUH
#define PETMJX_DIAGONAL_CUH

#include "tiles.cuh"

namespace petmjx {

// Shared memory of the warp.
struct Diagonal {
    alignas(16) float D[B * PITCH];  // the part below its diagonal is not used
    alignas(16) float rows[2][2 * B];  // the two rows being eliminated, and the two before; some entries are never set
};

#if defined(__CUDA_ARCH__)
// Reciprocal and reciprocal root, without special treatment of numbers below 1e-38.
inline __device__ float reciprocal(float x) {
    float y;
    asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
    return y;
}

inline __device__ float inverse_root(float x) {
    float y;
    asm("rsqrt.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
    return y;
}

// Two pivot rows that are eliminated at once. Other rows are reduced by the first row, and by the second row minus b/a
// times the first. So no division waits for another. In the two columns of the pivots, the first row holds a and b, and
// the second row holds b and c. The second pivot is then (a·c − b²)/a.
struct Pivots {
    float a, b, determinant, over_a, over_determinant, factor;

    inline __device__ Pivots(float a, float b, float c) : a(a), b(b) {
        determinant = fused(a, c, -times(b, b));
        over_a = reciprocal(a), over_determinant = reciprocal(determinant);
        factor = b * over_a;
    }

    // Factors of the two rows for a column with these numbers in them.
    inline __device__ float first(float one) const { return one * over_a; }
    inline __device__ float second(float one, float two) const { return rest(one, two) * over_determinant; }

    // Stores the numbers of the two rows of W, for a column of the identity that now has these numbers.
    inline __device__ void store(float one, float two, float* to, float* own) const {
        const float x = one * inverse_root(a), y = rest(one, two) * (over_a * inverse_root(determinant * over_a));
        store_two(to, x, y);
        store_two(own, x, y);
    }

    // A number v of another row, after the elimination. `one`, `two`: the numbers of the two rows in the column of
    // that row's pivot. `x`, `y`: the results of `first` and `second`.
    inline __device__ float left(float v, float one, float two, float x, float y) const {
        return v - fused(one, x, times(fused(-factor, one, two), y));
    }

private:
    inline __device__ float rest(float one, float two) const { return fused(a, two, -times(b, one)); }
};

// Each lane eliminates a column of D, or a column of the identity, which becomes a row of W. Lanes read two rows at a
// time from shared memory. Rows move up by two each time, so that no code is repeated. The rows that move in after the
// last one are not used.
struct ByPairs {
    static inline __device__ void eliminate(Diagonal& tile, float (&v)[B], float* W, float* own, int lane) {
        #pragma unroll 1
        for (int p = 0; p < B; p += 2) {
            float* rows = tile.rows[p / 2 % 2];
            if (p <= lane && lane < B) rows[lane - p] = v[0], rows[B + lane - p] = v[1];
            wait_for_warp();
            float one[B], two[B];
            #pragma unroll
            for (int q = 0; q < B; q += 4) load_four(one + q, rows + q), load_four(two + q, rows + B + q);
            const Pivots pivots(one[0], one[1], two[1]);
            if (lane >= B) pivots.store(v[0], v[1], W + (lane - B) * PITCH + p, own + (lane - B) * B + p);
            const float x = pivots.first(v[0]), y = pivots.second(v[0], v[1]);
            #pragma unroll
            for (int q = 2; q < B; ++q) v[q - 2] = pivots.left(v[q], one[q], two[q], x, y);
        }
    }
};

// The same to the last bit, in four times as much code and two thirds of the time. Only the remaining part of a row
// is read and subtracted. Every second pair of rows is exchanged between lanes, without shared memory.
struct ByFours {
    static inline __device__ void eliminate(Diagonal& tile, float (&v)[B], float* W, float* own, int lane) {
        W += (lane - B) * PITCH, own += (lane - B) * B;
        #pragma unroll
        for (int p = 0; p < B; p += 4) {
            float* rows = tile.rows[p / 4 % 2];
            if (p <= lane && lane < B) rows[lane] = v[p], rows[B + lane] = v[p + 1];
            wait_for_warp();
            float one[B], two[B], three[B], four[B];
            #pragma unroll
            for (int q = p; q < B; q += 4) load_four(one + q, rows + q), load_four(two + q, rows + B + q);
            const Pivots upper(one[p], one[p + 1], two[p + 1]);
            const float x = upper.first(v[p]), y = upper.second(v[p], v[p + 1]);
            #pragma unroll
            for (int q = p + 2; q < B; ++q) v[q] = upper.left(v[q], one[q], two[q], x, y);
            #pragma unroll
            for (int q = p + 2; q < B; ++q) {
                three[q] = __shfl_sync(0xffffffffu, v[p + 2], q);
                four[q] = __shfl_sync(0xffffffffu, v[p + 3], q);
            }
            const Pivots lower(three[p + 2], three[p + 3], four[p + 3]);
            if (lane >= B) {
                upper.store(v[p], v[p + 1], W + p, own + p);
                lower.store(v[p + 2], v[p + 3], W + p + 2, own + p + 2);
            }
            const float z = lower.first(v[p + 2]), w = lower.second(v[p + 2], v[p + 3]);
            #pragma unroll
            for (int q = p + 4; q < B; ++q) v[q] = lower.left(v[q], three[q], four[q], z, w);
        }
    }
};
#else
struct ByPairs {};
struct ByFours {};
#endif

// Finds W of D, and stores it at `W`, with PITCH numbers per row, and at `own`, with 16 numbers per row. Called by one
// warp. WAY: ByPairs or ByFours.
template <class WAY>
inline CUDA_CALLABLE void factor_diagonal(Diagonal& tile, float* W, float* own, int lane) {
#if defined(__CUDA_ARCH__)
    float v[B];
    #pragma unroll
    for (int p = 0; p < B; ++p) v[p] = lane < B ? tile.D[p * PITCH + lane] : (lane == B + p ? 1.0f : 0.0f);
    WAY::eliminate(tile, v, W, own, lane);
#else
    float* D = tile.D;
    for (int p = 0; p < B; ++p) {
        for (int c = 0; c < B; ++c) W[p * PITCH + c] = p == c ? 1.0f : 0.0f;
    }
    for (int p = 0; p < B; ++p) {
        const float inverse = 1.0f / sqrtf(D[p * PITCH + p]);
        for (int c = p; c < B; ++c) D[p * PITCH + c] *= inverse;
        for (int c = 0; c <= p; ++c) W[c * PITCH + p] *= inverse;
        for (int q = p + 1; q < B; ++q) {
            const float factor = D[p * PITCH + q];
            for (int c = q; c < B; ++c) D[q * PITCH + c] -= factor * D[p * PITCH + c];
            for (int c = 0; c <= p; ++c) W[c * PITCH + q] -= factor * W[c * PITCH + p];
        }
    }
    for (int p = 0; p < B; ++p) {
        for (int c = 0; c < B; ++c) own[p * B + c] = W[p * PITCH + c];
    }
#endif
}

}  // namespace petmjx

#endif
