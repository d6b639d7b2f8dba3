// A diagonal tile's factor, as the inverse of it: D = UᵀU, and W = U⁻¹, an upper triangle. Dividing by U is then a
// product with W. By one warp.

#ifndef PETMJX_DIAGONAL_CUH
#define PETMJX_DIAGONAL_CUH

#include "tiles.cuh"

namespace petmjx {

// What the warp shares.
struct Diagonal {
    alignas(16) float D[B * PITCH];  // what is below its diagonal is not used
    alignas(16) float rows[2][2 * B];  // two rows that are being eliminated, and the two before; their ends are never set
};

#if defined(__CUDA_ARCH__)
// Two numbers' reciprocal and reciprocal root without the care for numbers below 1e-38.
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
#endif

// W of D, PITCH numbers a row, and at `own`, 16 numbers a row. SPREAD: how often its code stands there, up to 8.
template <int SPREAD>
inline CUDA_CALLABLE void factor_diagonal(Diagonal& tile, float* W, float* own, int lane) {
#if defined(__CUDA_ARCH__)
    // Each lane eliminates a column: one of D, or one of the identity, which becomes a row of W. Two rows at a time, by
    // the first and by the second less b/a of the first. Of the pivots a b; b c the second is (a·c − b²)/a then, so that
    // no division waits for another. (Solving with the four at once would cancel where they are stiff together.)
    // Rows move up by two each time, so that the code can stand there once: what moves in behind the last one is not used.
    float v[B];
    #pragma unroll
    for (int p = 0; p < B; ++p) v[p] = lane < B ? tile.D[p * PITCH + lane] : (lane == B + p ? 1.0f : 0.0f);
    #pragma unroll SPREAD
    for (int p = 0; p < B; p += 2) {
        float* rows = tile.rows[p / 2 % 2];
        if (p <= lane && lane < B) rows[lane - p] = v[0], rows[B + lane - p] = v[1];
        wait_for_warp();
        float one[B], two[B];
        #pragma unroll
        for (int q = 0; q < B; q += 4) load_four(one + q, rows + q), load_four(two + q, rows + B + q);
        const float a = one[0], b = one[1], c = two[1];
        const float determinant = fused(a, c, -times(b, b)), rest = fused(a, v[1], -times(b, v[0]));
        const float over_a = reciprocal(a);
        const float x = v[0] * over_a, y = rest * reciprocal(determinant), factor = b * over_a;
        if (lane >= B) {
            const float first = v[0] * inverse_root(a), second = rest * (over_a * inverse_root(determinant * over_a));
            store_two(W + (lane - B) * PITCH + p, first, second);
            store_two(own + (lane - B) * B + p, first, second);
        }
        #pragma unroll
        for (int q = 2; q < B; ++q) v[q - 2] = v[q] - (one[q] * x + (two[q] - factor * one[q]) * y);
    }
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
