"""The factorisation within the solver of mjx-warp: a block's H·x = g by Cholesky within H's envelope.

CUDA C++ for the middle of ``warp_newton``'s kernel, where it finds H's upper triangle in ``A`` (leading dimension
``ld``, ``panels`` panels of ``B`` rows, whole tiles from row ``top[J]`` × ``B`` down in panel J's columns) and g in
``rhs``, in which it leaves x. It overwrites ``A``, and works in the shared arrays ``kept`` (``STRIP`` columns of one
panel), ``W``, ``solved``, ``active`` and ``active_count``. Where H is not positive definite, x is not a number.
"""

from __future__ import annotations

PANEL = 16
"""Rows of a panel. Half a warp: the code below counts on it."""

FACTOR_AND_SOLVE = """
        // Lists the panels below a panel whose columns reach up to it; by the second warp, beside the first one's work.
        auto reach = [&](int K) {
            int* list = active[K & 1];
            int found = 0;
#if defined(__CUDA_ARCH__)
            if (thread < 32 || thread >= 64) return;
            const int lane = thread - 32;
            for (int first = K + 1; first < panels; first += 32) {
                const bool inside = first + lane < panels && top[first + lane] <= K;
                const unsigned mask = __ballot_sync(0xffffffffu, inside);
                if (inside) list[found + __popc(mask & ((1u << lane) - 1u))] = first + lane;
                found += __popc(mask);
            }
            if (lane == 0) active_count[K & 1] = found;
#else
            for (int J = K + 1; J < panels; ++J)
                if (top[J] <= K) list[found++] = J;
            active_count[K & 1] = found;
#endif
        };
        reach(0);
        PETMJX_SYNC;

        // Forward: H = UᵀU in place, right-looking by panels of 16 rows, and y = U⁻ᵀ·gradient along with it. A panel's
        // diagonal tile keeps W, the inverse of its factor transposed: what solving with it takes are then products.
        for (int K = 0; K < panels; ++K) {
            const int k = K * B;
            const int* reached = active[K & 1];
            const int columns = active_count[K & 1] * B;
            float* own = A + (size_t)k * ld;
#if defined(__CUDA_ARCH__)
            if (thread < 32) {
                // A column of the tile to a lane, then the right-hand side, then the columns of the identity but the
                // last; all are eliminated alike, two rows at a time, and scaled to the factor's beside that: no root
                // and no second reciprocal of a row holds up the next.
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
            reach(K + 1);
            // The panel's row, a column to a thread, kept close by where it fits.
            const bool fits = columns <= STRIP;
            float* strip = fits ? kept : own;
            const int pitch = fits ? STRIP : ld;
            for (int base = 0; base < columns; base += threads) {
                const int column = base + thread;
                const int c = column < columns ? reached[column / B] * B + column % B : 0;
                float v[16];
                #pragma unroll
                for (int p = 0; p < 16; ++p) v[p] = column < columns ? own[(size_t)p * ld + c] : 0.0f;
                if (base == 0) PETMJX_SYNC;
                if (column >= columns) continue;
                float update = 0.0f;
                #pragma unroll
                for (int p = 15; p >= 0; --p) {
                    float value = 0.0f;
                    #pragma unroll
                    for (int q = 0; q <= p; ++q) value += W[p * B + q] * v[q];
                    v[p] = value;
                    update += value * solved[p];
                }
                #pragma unroll
                for (int p = 0; p < 16; ++p) {
                    own[(size_t)p * ld + c] = v[p];
                    if (fits) kept[p * STRIP + column] = v[p];
                }
                rhs[c] -= update;
            }
            PETMJX_SYNC;
            // What it takes from all below: 4 × 4 entries to a thread, of each pair of panels that it reaches.
            int right = 0, before = 0;
            const int tiles = columns / B * (columns / B + 1) / 2 * B;
            for (int item = thread; item < tiles; item += threads) {
                while (item / B - before > right) before += ++right;
                const int left = item / B - before, down = item % B / 4 * 4, across = item % 4 * 4;
                const float* one = strip + (fits ? left : reached[left]) * B + down;
                const float* two = strip + (fits ? right : reached[right]) * B + across;
                float* target = A + (size_t)(reached[left] * B + down) * ld + reached[right] * B + across;
                float sum[4][4];
                #pragma unroll
                for (int i = 0; i < 4; ++i) PETMJX_LOAD(sum[i], target + (size_t)i * ld);
                #pragma unroll
                for (int p = 0; p < 16; ++p) {
                    float a[4], b[4];
                    PETMJX_LOAD(a, one + (size_t)p * pitch);
                    PETMJX_LOAD(b, two + (size_t)p * pitch);
                    #pragma unroll
                    for (int i = 0; i < 4; ++i) {
                        #pragma unroll
                        for (int j = 0; j < 4; ++j) sum[i][j] -= a[i] * b[j];
                    }
                }
                #pragma unroll
                for (int i = 0; i < 4; ++i) PETMJX_STORE(target + (size_t)i * ld, sum[i]);
            }
            PETMJX_SYNC;
        }

        // Backward: U·x = y, each panel's solution taken out of the rows above at once.
        for (int K = panels - 1; K >= 0; --K) {
            const int k = K * B, from = top[K] * B;
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
                    for (int p = 0; p < 16; p += 4) PETMJX_LOAD((v + p), A + (size_t)j * ld + k + p);
                }
                if (base == from) PETMJX_SYNC;
                if (j >= k) continue;
                float value = rhs[j];
                #pragma unroll
                for (int p = 0; p < 16; ++p) value -= v[p] * solved[p];
                rhs[j] = value;
            }
            for (int p = thread; p < B; p += threads) rhs[k + p] = solved[p];
            PETMJX_SYNC;
        }
"""
