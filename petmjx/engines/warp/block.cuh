// Differences between GPU and CPU. On a GPU the threads of a block share one world. On a CPU one thread has a world, so
// barriers and sums over threads do nothing.
//
// Warp's headers come first: they define CUDA_CALLABLE. NVRTC and Warp's own Clang compile the same source.

#ifndef PETMJX_BLOCK_CUH
#define PETMJX_BLOCK_CUH

#if defined(__CUDA_ARCH__)
#define PETMJX_SHARED __shared__
#else
#define PETMJX_SHARED
#endif

namespace petmjx {

// Neighbouring threads that together sum over one body's contacts.
#if defined(__CUDA_ARCH__)
const int SHARE = 8;
#else
const int SHARE = 1;
#endif

inline CUDA_CALLABLE void wait_for_all() {
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
}

// Four consecutive numbers, at an address that is a multiple of 16 bytes.
inline CUDA_CALLABLE void load_four(float* to, const float* from) {
#if defined(__CUDA_ARCH__)
    const float4 four = *(const float4*)(from);
    to[0] = four.x, to[1] = four.y, to[2] = four.z, to[3] = four.w;
#else
    for (int e = 0; e < 4; ++e) to[e] = from[e];
#endif
}

inline CUDA_CALLABLE void store_four(float* to, const float* from) {
#if defined(__CUDA_ARCH__)
    *(float4*)(to) = make_float4(from[0], from[1], from[2], from[3]);
#else
    for (int e = 0; e < 4; ++e) to[e] = from[e];
#endif
}

// Increases a counter by one and returns its value before. Threads come in no fixed order.
inline CUDA_CALLABLE int take_number(int& counter) {
#if defined(__CUDA_ARCH__)
    return atomicAdd(&counter, 1);
#else
    return counter++;
#endif
}

// Sums of x and of y over all threads, the same to the last bit in every thread and in every run.
// `partial` is shared memory for two numbers of each of at most 32 warps.
inline CUDA_CALLABLE void sum_over_block(int thread, int threads, double* partial, double& x, double& y) {
#if defined(__CUDA_ARCH__)
    for (int offset = 16; offset > 0; offset >>= 1) {
        x += __shfl_xor_sync(0xffffffffu, x, offset);
        y += __shfl_xor_sync(0xffffffffu, y, offset);
    }
    wait_for_all();
    if ((thread & 31) == 0) {
        partial[thread >> 4] = x;
        partial[(thread >> 4) + 1] = y;
    }
    wait_for_all();
    x = 0.0;
    y = 0.0;
    for (int w = 0; w < threads >> 5; ++w) {
        x += partial[2 * w];
        y += partial[2 * w + 1];
    }
#endif
}

// Sum over SHARE neighbouring threads.
template <class Number>
inline CUDA_CALLABLE void sum_over_share(Number& x) {
#if defined(__CUDA_ARCH__)
    for (int offset = SHARE / 2; offset > 0; offset >>= 1) x += __shfl_xor_sync(0xffffffffu, x, offset);
#endif
}

}  // namespace petmjx

#endif
