// Substitution with the factor: x from UᵀU·x = g.

#ifndef PETMJX_SUBSTITUTION_CUH
#define PETMJX_SUBSTITUTION_CUH

#include "linear_system.cuh"

namespace petmjx {

// Sums of 16 products, four at a time.
inline CUDA_CALLABLE float dot(const float* x, int stride, const float* y) {
    float sums[4] = {0.0f, 0.0f, 0.0f, 0.0f};
    #pragma unroll
    for (int p = 0; p < B; ++p) sums[p % 4] += x[p * stride] * y[p];
    return (sums[0] + sums[1]) + (sums[2] + sums[3]);
}

// Forward substitution: panel K's part of y = U⁻ᵀ·g, also stored in `solved`. W: the inverse of the factor of the
// panel's diagonal tile. Called by one warp.
inline CUDA_CALLABLE void solve_forward(const System& system, const float* W, int K, float* solved, int lane) {
    float* rhs = system.rhs + K * B;
#if defined(__CUDA_ARCH__)
    // the order of `dot`: lanes 16 apart have two of its four sums each
    const float* column = W + lane % B + lane / B * 2 * PITCH;
    const float* g = rhs + lane / B * 2;
    float one = 0.0f, two = 0.0f;
    #pragma unroll
    for (int p = 0; p < B; p += 4) one += column[p * PITCH] * g[p], two += column[(p + 1) * PITCH] * g[p + 1];
    const float sum = one + two, y = sum + __shfl_xor_sync(0xffffffffu, sum, B);
    if (lane < B) solved[lane] = y, rhs[lane] = y;
#else
    for (int p = 0; p < B; ++p) solved[p] = dot(W + p, PITCH, rhs);
    for (int p = 0; p < B; ++p) rhs[p] = solved[p];
#endif
    wait_for_warp();
}

#if defined(__CUDA_ARCH__)
// A lane's half of a row of a tile. Lanes 16 apart have the halves of one row.
struct HalfRow {
    float v[8];

    inline __device__ HalfRow(const float* tile, int lane) {
        const float* from = tile + lane % B * B + lane / B * 8;
        load_four(v, from), load_four(v + 4, from + 4);
    }

    // The whole row times y. Both lanes get the result.
    inline __device__ float times(const float* y, int lane) const {
        float its[8], sums[4];
        load_four(its, y + lane / B * 8), load_four(its + 4, y + lane / B * 8 + 4);
        #pragma unroll
        for (int i = 0; i < 4; ++i) sums[i] = v[i] * its[i] + v[4 + i] * its[4 + i];
        const float sum = (sums[0] + sums[1]) + (sums[2] + sums[3]);
        return sum + __shfl_xor_sync(0xffffffffu, sum, B);
    }
};
#endif

// Backward: U·x = y, two panels at a time from the last one. Their solution is at once subtracted from the rows above.
// On a GPU each warp finds the solution for itself, in its part of `solved` (3·16 numbers for each warp). So no warp
// waits for another. SPREAD: copies of the code that subtracts a panel's part, one or two.
template <int SPREAD>
inline CUDA_CALLABLE void solve_backward(const System& system, float* solved, int thread, int threads) {
    float* rhs = system.rhs;
#if defined(__CUDA_ARCH__)
    const int lane = thread % WARP;
    solved += thread / WARP * 3 * B;
    float* right = solved + 2 * B;
    #pragma unroll 1
    for (int last = system.panels - 1; last >= 0; last -= 2) {
        const int first = last > 0 ? last - 1 : last;
        const bool linked = system.top[last] <= first;
        // all loads first
        const HalfRow inverse(system.tile(last, last), lane), beside(system.tile(linked ? first : last, last), lane);
        const HalfRow its_inverse(system.tile(first, first), lane);
        const float x = inverse.times(rhs + last * B, lane);
        if (lane < B) solved[lane] = x;
        wait_for_warp();
        float its = 0.0f;
        if (first < last) {
            const float change = linked ? beside.times(solved, lane) : 0.0f;
            if (lane < B) right[lane] = rhs[first * B + lane] - change;
            wait_for_warp();
            its = its_inverse.times(right, lane);
            if (lane < B) solved[B + lane] = its;
            wait_for_warp();
        }
        const int end = first * B, top = system.top[last] < system.top[first] ? system.top[last] : system.top[first];
        #pragma unroll 1
        for (int j = top * B + thread; j < end; j += threads) {
            float sums[4] = {rhs[j], 0.0f, 0.0f, 0.0f};
            #pragma unroll SPREAD
            for (int i = 0; i < 2; ++i) {
                const int K = last - i;
                if (j < system.top[K] * B) continue;
                const float* row = system.panel(K) + j * B;
                #pragma unroll
                for (int p = 0; p < B; p += 4) {
                    float u[4], x[4];
                    load_four(u, row + p), load_four(x, solved + i * B + p);
                    #pragma unroll
                    for (int e = 0; e < 4; ++e) sums[e] -= u[e] * x[e];
                }
            }
            rhs[j] = (sums[0] + sums[1]) + (sums[2] + sums[3]);
        }
        wait_for_all();
        if (thread < B) rhs[last * B + thread] = x;
        else if (thread < 2 * B && first < last) rhs[first * B + thread - B] = its;
    }
#else
    for (int K = system.panels - 1; K >= 0; --K) {
        for (int p = 0; p < B; ++p) solved[p] = dot(system.tile(K, K) + p * B, 1, rhs + K * B);
        for (int p = 0; p < B; ++p) rhs[K * B + p] = solved[p];
        for (int j = system.top[K] * B; j < K * B; ++j) rhs[j] -= dot(system.panel(K) + j * B, 1, solved);
    }
#endif
    wait_for_all();
}

}  // namespace petmjx

#endif
