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

// Whether any thread says so. All threads wait for one another.
inline CUDA_CALLABLE bool any_of_all(bool mine) {
#if defined(__CUDA_ARCH__)
    return __syncthreads_or(mine);
#else
    return mine;
#endif
}

// Time in ns since some moment. On a CPU, where there is no clock without a library, each look takes a millisecond.
inline CUDA_CALLABLE long long clock() {
#if defined(__CUDA_ARCH__)
    long long now;
    asm volatile("mov.u64 %0, %globaltimer;" : "=l"(now));
    return now;
#else
    static long long now = 0;
    return now += 1000000;
#endif
}

// Replaces each value by the sum of those before it; values[count] becomes the sum of all. On a GPU the first warp
// does it; the caller lets all threads wait before and after.
inline CUDA_CALLABLE void prefix_sums(int* values, int count, int thread) {
#if defined(__CUDA_ARCH__)
    if (thread >= 32) return;
    int before = 0;
    for (int first = 0; first < count; first += 32) {
        const int mine = first + thread < count ? values[first + thread] : 0;
        int sum = mine;
        for (int offset = 1; offset < 32; offset <<= 1) {
            const int other = __shfl_up_sync(0xffffffffu, sum, offset);
            if (thread >= offset) sum += other;
        }
        if (first + thread < count) values[first + thread] = before + sum - mine;
        before += __shfl_sync(0xffffffffu, sum, 31);
    }
    if (thread == 0) values[count] = before;
#else
    int before = 0;
    for (int i = 0; i < count; ++i) {
        const int mine = values[i];
        values[i] = before;
        before += mine;
    }
    values[count] = before;
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

// A sum's items belong to this many virtual threads, however many threads a block has. If there are half as many, each
// stands for two of them. So a sum has the same order with either number of threads.
const int VIRTUAL = 256;

// What a thread has added up so far, for each virtual thread that it stands for.
struct Part {
    double one = 0.0, two = 0.0;

    // A thread adds the items whose numbers are its own modulo `threads`, in order.
    inline CUDA_CALLABLE void add(double value, int item, int threads) {
#if defined(__CUDA_ARCH__)
        if (item & (VIRTUAL - 1) & threads) two += value; else one += value;
#else
        one += value;
#endif
    }
};

struct Sums {
    double x, y;
};

// Sums of x and of y over all threads, the same to the last bit in every thread, in every run, and with VIRTUAL or
// VIRTUAL / 2 threads. `partial` is shared memory for two numbers of each virtual warp.
inline CUDA_CALLABLE Sums sum_over_block(int thread, int threads, double* partial, Part x, Part y) {
#if defined(__CUDA_ARCH__)
    const bool halved = threads < VIRTUAL;
    for (int offset = 16; offset > 0; offset >>= 1) {
        x.one += __shfl_xor_sync(0xffffffffu, x.one, offset);
        y.one += __shfl_xor_sync(0xffffffffu, y.one, offset);
        if (halved) {
            x.two += __shfl_xor_sync(0xffffffffu, x.two, offset);
            y.two += __shfl_xor_sync(0xffffffffu, y.two, offset);
        }
    }
    wait_for_all();
    if ((thread & 31) == 0) {
        const int warp = thread >> 5, other = (thread + threads) >> 5;
        partial[2 * warp] = x.one;
        partial[2 * warp + 1] = y.one;
        if (halved) {
            partial[2 * other] = x.two;
            partial[2 * other + 1] = y.two;
        }
    }
    wait_for_all();
    Sums sums = {0.0, 0.0};
    for (int w = 0; w < VIRTUAL >> 5; ++w) {
        sums.x += partial[2 * w];
        sums.y += partial[2 * w + 1];
    }
    return sums;
#else
    return {x.one, y.one};
#endif
}

// Sums over SHARE neighbouring threads. No sum waits for another one.
template <class Number, int COUNT>
inline CUDA_CALLABLE void sum_over_share(Number (&x)[COUNT]) {
#if defined(__CUDA_ARCH__)
    #pragma unroll
    for (int offset = SHARE / 2; offset > 0; offset >>= 1) {
        #pragma unroll
        for (int i = 0; i < COUNT; ++i) x[i] += __shfl_xor_sync(0xffffffffu, x[i], offset);
    }
#endif
}

}  // namespace petmjx

#endif
