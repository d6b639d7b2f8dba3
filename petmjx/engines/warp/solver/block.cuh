// Differences between GPU and CPU. On a GPU the threads of a block share one world, or each warp of a block has one. On
// a CPU one thread has a world, so barriers and sums over threads do nothing. "All threads" are the threads that share
// a world.
//
// PETMJX_ONCE: a function that is called at several places, but is in a GPU's program only once.
// PETMJX_INLINED: a function that a CPU's compiler must inline, so that its results stay in registers.
// PETMJX_WORLDS: worlds of a block.
// PETMJX_THREADS: threads of a world.
//
// Warp's headers come first: they define CUDA_CALLABLE. NVRTC and Warp's own Clang compile the same source.

#ifndef PETMJX_BLOCK_CUH
#define PETMJX_BLOCK_CUH

#if defined(__CUDA_ARCH__)
#define PETMJX_SHARED __shared__
#define PETMJX_ONCE static __noinline__
#define PETMJX_INLINED
#else
#define PETMJX_SHARED
#define PETMJX_ONCE inline
#define PETMJX_INLINED __attribute__((always_inline))
#endif

#if !defined(PETMJX_WORLDS)
#define PETMJX_WORLDS 1
#endif

#if defined(__CUDA_ARCH__) && PETMJX_WORLDS > 1
#define PETMJX_WORLD_OF_A_WARP
#endif

namespace petmjx {

// WARP: threads of a warp. SHARE: neighbouring threads that together sum over one body's contacts.
#if defined(__CUDA_ARCH__)
const int WARP = 32, SHARE = 8;
#else
const int WARP = 1, SHARE = 1;
#endif

inline CUDA_CALLABLE void wait_for_all() {
#if defined(PETMJX_WORLD_OF_A_WARP)
    __syncwarp();
#elif defined(__CUDA_ARCH__)
    __syncthreads();
#endif
}

// Index of a lane's world within its block.
inline CUDA_CALLABLE int place_in_block(int lane) { return lane % PETMJX_WORLDS; }

// Lets the warps of a block wait for one another if each has a world. Then the warps execute the same instructions at
// the same time, and the multiprocessor fetches each instruction only once.
inline CUDA_CALLABLE void go_together() {
#if defined(PETMJX_WORLD_OF_A_WARP)
    __syncwarp();
    __syncthreads();
#endif
}

// Whether any world of a block still runs. The block's warps wait for one another.
inline CUDA_CALLABLE bool any_of_block(bool mine) {
#if defined(PETMJX_WORLD_OF_A_WARP)
    __syncwarp();
    return __syncthreads_or(mine);
#else
    return mine;
#endif
}

// The threads of a warp wait for one another, and see each other's writes.
inline CUDA_CALLABLE void wait_for_warp() {
#if defined(__CUDA_ARCH__)
    __syncwarp();
#endif
}

// A barrier (1 or 2): arriving threads continue at once, and waiting threads wait for them. `threads` counts both. The
// waiting threads see the writes of the arriving threads.
inline CUDA_CALLABLE void arrive(int barrier, int threads) {
#if defined(__CUDA_ARCH__)
    __syncwarp();
    asm volatile("bar.arrive %0, %1;" ::"r"(barrier), "r"(threads) : "memory");
#endif
}

inline CUDA_CALLABLE void wait_for_arrival(int barrier, int threads) {
#if defined(__CUDA_ARCH__)
    __syncwarp();
    asm volatile("bar.sync %0, %1;" ::"r"(barrier), "r"(threads) : "memory");
#endif
}

// Whether `mine` is true in any thread. All threads wait for one another.
inline CUDA_CALLABLE bool any_of_all(bool mine) {
#if defined(PETMJX_WORLD_OF_A_WARP)
    __syncwarp();
    return __any_sync(0xffffffffu, mine);
#elif defined(__CUDA_ARCH__)
    return __syncthreads_or(mine);
#else
    return mine;
#endif
}

// The numbers of a tile in shared memory, or of an array.
template <class Tile>
inline CUDA_CALLABLE float* begin_of(const Tile& tile) {
    return tile.data.ptr;
}

inline CUDA_CALLABLE float* begin_of(const wp::array_t<float>& array) { return array.data; }

// Products and sums of products with fixed rounding. In a·b − c·d, a GPU's compiler would round only one
// of the two products, and not the same one in each kernel. Then a world's result would depend on its kernel.
#if defined(__CUDA_ARCH__)
inline __device__ float times(float a, float b) { return __fmul_rn(a, b); }
inline __device__ double times(double a, double b) { return __dmul_rn(a, b); }
inline __device__ float fused(float a, float b, float c) { return __fmaf_rn(a, b, c); }
inline __device__ double fused(double a, double b, double c) { return __fma_rn(a, b, c); }
#else
template <class Number>
inline Number times(Number a, Number b) {
    return a * b;
}
template <class Number>
inline Number fused(Number a, Number b, Number c) {
    return a * b + c;
}
#endif

// Adds to a number that all blocks share, and returns the number's earlier value. Blocks come in any order.
inline CUDA_CALLABLE int add_to(int* number, int amount) {
#if defined(__CUDA_ARCH__)
    return atomicAdd(number, amount);
#else
    return __atomic_fetch_add(number, amount, __ATOMIC_RELAXED);
#endif
}

// Raises a number that all blocks share to `value` if `value` is larger.
inline CUDA_CALLABLE void raise_to(int* number, int value) {
#if defined(__CUDA_ARCH__)
    atomicMax(number, value);
#else
    int found = __atomic_load_n(number, __ATOMIC_RELAXED);
    while (found < value && !__atomic_compare_exchange_n(number, &found, value, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {
    }
#endif
}

// Time since the clock was first read in this call of the kernels, ns. Before the first reading, `clock` is 0. On a
// GPU, `clock` then stores the time of the first reading, in units of 1,024 ns, modulo half an hour. (If several lanes
// read the clock first, the stored time may be a little later than the earliest reading.) On a CPU, code without
// libraries cannot read a clock, so the host sets `clock` when the slice is over. One thread of a lane calls this.
inline CUDA_CALLABLE long long elapsed(int* clock) {
#if defined(__CUDA_ARCH__)
    long long now;
    asm volatile("mov.u64 %0, %globaltimer;" : "=l"(now));
    const int mask = 0x7fffffff, at = max((int)(now >> 10) & mask, 1), first = atomicCAS(clock, 0, at);
    const int passed = (at - first) & mask;
    return first && passed <= mask / 2 ? (long long)passed << 10 : 0;
#else
    return __atomic_load_n(clock, __ATOMIC_RELAXED) ? 0x7fffffffffffffffLL : 0;
#endif
}

// Replaces each value by the sum of the values before it; values[count] becomes the sum of all. On a GPU the first warp
// does this. The caller must let all threads wait before and after.
PETMJX_ONCE CUDA_CALLABLE void prefix_sums(int* values, int count, int thread) {
#if defined(__CUDA_ARCH__)
    if (thread >= 32) return;
    const int EACH = 4;  // values of a thread at a time
    int before = 0;
    #pragma unroll 1
    for (int first = 0; first < count; first += 32 * EACH) {
        int begins[EACH + 1] = {0};
        #pragma unroll
        for (int i = 0; i < EACH; ++i) {
            const int at = first + EACH * thread + i;
            begins[i + 1] = begins[i] + (at < count ? values[at] : 0);
        }
        int sum = begins[EACH];
        #pragma unroll
        for (int offset = 1; offset < 32; offset <<= 1) {
            const int other = __shfl_up_sync(0xffffffffu, sum, offset);
            if (thread >= offset) sum += other;
        }
        #pragma unroll
        for (int i = 0; i < EACH; ++i) {
            const int at = first + EACH * thread + i;
            if (at < count) values[at] = before + sum - begins[EACH] + begins[i];
        }
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

inline CUDA_CALLABLE void load_two(float* to, const float* from) {
#if defined(__CUDA_ARCH__)
    const float2 two = *(const float2*)(from);
    to[0] = two.x, to[1] = two.y;
#else
    to[0] = from[0], to[1] = from[1];
#endif
}

inline CUDA_CALLABLE void store_four(float* to, const float* from) {
#if defined(__CUDA_ARCH__)
    *(float4*)(to) = make_float4(from[0], from[1], from[2], from[3]);
#else
    for (int e = 0; e < 4; ++e) to[e] = from[e];
#endif
}

inline CUDA_CALLABLE void store_two(float* to, float one, float two) {
#if defined(__CUDA_ARCH__)
    *(float2*)(to) = make_float2(one, two);
#else
    to[0] = one, to[1] = two;
#endif
}

// Increases a counter by one and returns its earlier value. The order of threads is not fixed.
inline CUDA_CALLABLE int take_number(int& counter) {
#if defined(__CUDA_ARCH__)
    return atomicAdd(&counter, 1);
#else
    return counter++;
#endif
}

inline CUDA_CALLABLE void take_larger(int& value, int other) {
#if defined(__CUDA_ARCH__)
    atomicMax(&value, other);
#else
    value = other > value ? other : value;
#endif
}

// Sums are added in the order in which ORDER threads would add them. The number of threads that share a world is a
// divisor of ORDER.
const int ORDER = 256;

// Largest number of warps that share a world.
#if defined(PETMJX_WORLD_OF_A_WARP)
const int MOST_WARPS = 1;
#else
const int MOST_WARPS = ORDER / 32;
#endif

#if defined(__CUDA_ARCH__)
// Sums of COUNT numbers over the threads of a warp.
template <int COUNT>
inline __device__ void sum_over_warp(double (&x)[COUNT]) {
    #pragma unroll
    for (int offset = 16; offset > 0; offset >>= 1) {
        #pragma unroll
        for (int i = 0; i < COUNT; ++i) x[i] += __shfl_xor_sync(0xffffffffu, x[i], offset);
    }
}
#endif

// Sums over i from 0 to `count` − 1: `add(i, x)` adds the terms of i to the COUNT numbers x. The sums are the same to
// the last bit in every thread and in every run. `add` is also called for i ≥ `count`, and must add nothing then;
// because of these calls, neighbouring threads can work together in `add`. `partial` is shared memory for COUNT numbers
// of each of MOST_WARPS warps.
//
// The terms are added as if ORDER threads shared the world. Thread i of these ORDER threads adds the terms i, i +
// ORDER, …. Then the sums of the threads of each warp are added, and last the sums of the warps, in order. If fewer
// threads share the world, each of them does the work of several of the ORDER threads. A world's only warp does this
// work one after another; the threads of a block do it at the same time. So the result is the same in warps and in
// blocks of any size, and a world may move between them.
template <int COUNT, class Add>
inline CUDA_CALLABLE void sum_over_all(int count, int thread, double* partial, double (&x)[COUNT], const Add& add) {
    #pragma unroll
    for (int i = 0; i < COUNT; ++i) x[i] = 0.0;
#if defined(PETMJX_WORLD_OF_A_WARP)
    #pragma unroll 1
    for (int begin = 0; begin < ORDER && begin < count; begin += WARP) {
        double part[COUNT];
        #pragma unroll
        for (int i = 0; i < COUNT; ++i) part[i] = 0.0;
        #pragma unroll 1
        for (int first = begin; first < count; first += ORDER) add(first + thread, part);
        sum_over_warp(part);
        #pragma unroll
        for (int i = 0; i < COUNT; ++i) x[i] += part[i];
    }
    __syncwarp();
#elif defined(__CUDA_ARCH__)
    const int PLACES = ORDER / PETMJX_THREADS;  // places of a thread
    static_assert(PLACES * PETMJX_THREADS == ORDER && PETMJX_THREADS % 32 == 0, "threads of a world must divide ORDER");
    double part[PLACES][COUNT];
    #pragma unroll
    for (int p = 0; p < PLACES; ++p) {
        #pragma unroll
        for (int i = 0; i < COUNT; ++i) part[p][i] = 0.0;
    }
    #pragma unroll 1
    for (int first = 0; first < count; first += ORDER) {
        #pragma unroll
        for (int p = 0; p < PLACES; ++p) add(first + p * PETMJX_THREADS + thread, part[p]);
    }
    #pragma unroll
    for (int p = 0; p < PLACES; ++p) sum_over_warp(part[p]);
    wait_for_all();  // until then some threads may still read the last sum
    if ((thread & 31) == 0) {
        #pragma unroll
        for (int p = 0; p < PLACES; ++p) {
            #pragma unroll
            for (int i = 0; i < COUNT; ++i) partial[COUNT * ((p * PETMJX_THREADS + thread) >> 5) + i] = part[p][i];
        }
    }
    wait_for_all();
    #pragma unroll
    for (int w = 0; w < MOST_WARPS; ++w) {
        #pragma unroll
        for (int i = 0; i < COUNT; ++i) x[i] += partial[COUNT * w + i];
    }
#else
    #pragma unroll 1
    for (int i = 0; i < count; ++i) add(i, x);
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
