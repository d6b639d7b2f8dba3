// The Hessian of a world's constraint problem, for the threads of a GPU's block and for the vector units of a CPU.

#ifndef PETMJX_HESSIAN_CUH
#define PETMJX_HESSIAN_CUH

#include "block.cuh"
#include "contact.cuh"
#include "linear_system.cuh"
#include "world.cuh"

namespace petmjx {

#if defined(__CUDA_ARCH__)
inline __device__ void load_curvature(const float* from, float (&s)[6]) {
    #pragma unroll
    for (int i = 0; i < 6; i += 2) load_two(s + i, from + i);
}

// The column of an entry of a 6 × 6 upper triangle, whose entries are numbered column by column: three bits for each.
inline __device__ int column_of(int entry) { return (int)(0x5b6db2491b6d2448ull >> 3 * entry & 7); }

// A body's own entries of the Hessian: the upper triangle of 6 × 6 numbers, which are 21 entries. SHARE threads sum
// them over the contacts of the body.
inline CUDA_CALLABLE void own_entries(const World& world, const System& system, int thread, int threads) {
    #pragma unroll 1
    for (int base = 0; base < world.nfree * SHARE; base += threads) {
        const int b = (base + thread) / SHARE, share_of = thread % SHARE;
        float own[21];
        #pragma unroll
        for (int e = 0; e < 21; ++e) own[e] = 0.0f;
        if (b < world.nfree) {
            #pragma unroll 1
            for (int entry = world.body_conadr[b] + share_of; entry < world.body_conadr[b + 1]; entry += SHARE) {
                const int k = world.body_contact[entry] >> 1, side = world.body_contact[entry] & 1;
                const Numbers contact = world.contact(k);
                float s[6], axes[9], arms[9], x[6], y[6], z[6];
                load_curvature(world.curvature + 6 * k, s);
                load_axes(contact, axes);
                load_arms(contact, side, arms);
                #pragma unroll
                for (int i = 0; i < 3; ++i) {
                    x[i] = axes[i], y[i] = axes[3 + i], z[i] = axes[6 + i];
                    x[3 + i] = arms[i], y[3 + i] = arms[3 + i], z[3 + i] = arms[6 + i];
                }
                int e = 0;
                #pragma unroll
                for (int q = 0; q < 6; ++q) {
                    const float bx = s[0] * x[q] + s[1] * y[q] + s[2] * z[q];
                    const float by = s[1] * x[q] + s[3] * y[q] + s[4] * z[q];
                    const float bz = s[2] * x[q] + s[4] * y[q] + s[5] * z[q];
                    #pragma unroll
                    for (int p = 0; p <= q; ++p) own[e++] += x[p] * bx + y[p] * by + z[p] * bz;
                }
            }
        }
        sum_over_share(own);
        if (b >= world.nfree) continue;
        const int place = world.position[b];
        const Columns columns = system.columns(place);
        // each thread has every eighth entry; if all threads worked on one entry after another, they would wait for one
        // another
        #pragma unroll
        for (int first = 0; first < 21; first += SHARE) {
            const int e = first + share_of;
            if (e >= 21) continue;
            const int q = column_of(e), p = e - q * (q + 1) / 2;
            float entry = own[first];
            #pragma unroll
            for (int i = 1; i < SHARE && first + i < 21; ++i) entry = share_of == i ? own[first + i] : entry;
            columns.entry(6 * place + p, q) = entry + (p == q ? world.qM[6 * b + p] : 0.0f);
        }
    }
}

// The 6 × 6 entries of two bodies that touch: one row per thread, summed over their contacts.
inline CUDA_CALLABLE void pair_entries(const World& world, const System& system, int pairs, int thread, int threads) {
    const int* body = world.body;
    #pragma unroll 1
    for (int item = thread; item < 6 * pairs; item += threads) {
        const int p = item % 6;
        int k = world.bodies_conadr[item / 6];
        const int one = body[2 * k], two = body[2 * k + 1];
        float shared[6] = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
        bool goes_on;
        do {
            // loaded before the contact's numbers, so that nothing waits for it later
            const int next = k + 1 < world.ncon ? k + 1 : k;
            goes_on = next != k && body[2 * next] == one && body[2 * next + 1] == two;
            const Numbers contact = world.contact(k);
            float s[6], axes[9], arms[9];
            load_curvature(world.curvature + 6 * k, s);
            load_axes(contact, axes);
            load_arms(contact, 1, arms);
            const int mine = p < 3 ? p : 6 + p;
            const float x = contact[mine], y = contact[mine + 3], z = contact[mine + 6];
            const float bx = s[0] * x + s[1] * y + s[2] * z;
            const float by = s[1] * x + s[3] * y + s[4] * z;
            const float bz = s[2] * x + s[4] * y + s[5] * z;
            #pragma unroll
            for (int i = 0; i < 3; ++i) {
                shared[i] -= axes[i] * bx + axes[3 + i] * by + axes[6 + i] * bz;
                shared[3 + i] -= arms[i] * bx + arms[3 + i] * by + arms[6 + i] * bz;
            }
            ++k;
        } while (goes_on);
        const int upper = world.position[one], lower = world.position[two];
        const bool ahead = upper < lower;
        const Columns columns = system.columns(ahead ? lower : upper);
        #pragma unroll
        for (int i = 0; i < 6; ++i) {
            if (ahead) columns.entry(6 * upper + p, i) = shared[i];
            else columns.entry(6 * lower + i, p) = shared[i];
        }
    }
}

#else
// Eight entries of a 6 × 6 matrix, the sum of the products of three pairs of rows: x at the entry's column times y at
// the entry's row.
template <int... COLUMNS>
struct Entries {
    template <int... ROWS>
    static inline Six of(const Six (&x)[3], const Six (&y)[3]) {
        Six product[3];
        #pragma unroll
        for (int r = 0; r < 3; ++r)
            product[r] = __builtin_shufflevector(x[r], x[r], COLUMNS...) * __builtin_shufflevector(y[r], y[r], ROWS...);
        return product[0] + product[1] + product[2];
    }
};

// A body's own entries: the upper triangle, column by column, in three vectors of eight numbers.
inline void own_entries(const World& world, const System& system, int, int) {
    for (int b = 0; b < world.nfree; ++b) {
        Six own[3] = {};
        for (int entry = world.body_conadr[b]; entry < world.body_conadr[b + 1]; ++entry) {
            const int k = world.body_contact[entry] >> 1, side = world.body_contact[entry] & 1;
            const Numbers c = world.contact(k);
            const Six rows[3] = {load_six(c, side, 0), load_six(c, side, 1), load_six(c, side, 2)};
            Six bent[3];
            bend_six(world.curvature + 6 * k, rows, bent);
            own[0] += Entries<0, 1, 1, 2, 2, 2, 3, 3>::of<0, 0, 1, 0, 1, 2, 0, 1>(bent, rows);
            own[1] += Entries<3, 3, 4, 4, 4, 4, 4, 5>::of<2, 3, 0, 1, 2, 3, 4, 0>(bent, rows);
            own[2] += Entries<5, 5, 5, 5, 5, 5, 5, 5>::of<1, 2, 3, 4, 5, 5, 5, 5>(bent, rows);
        }
        float entries[24];
        __builtin_memcpy(entries, own, sizeof entries);
        const int place = world.position[b];
        const Columns columns = system.columns(place);
        int e = 0;
        #pragma unroll
        for (int q = 0; q < 6; ++q) {
            float* column = &columns.entry(6 * place, q);
            #pragma unroll
            for (int p = 0; p < q; ++p) column[p * B] = entries[e++];
            column[q * B] = entries[e++] + world.qM[6 * b + q];
        }
    }
}

// The entries of two bodies that touch, also as rows of six numbers.
inline void pair_entries(const World& world, const System& system, int pairs, int, int) {
    const int* body = world.body;
    for (int pair = 0; pair < pairs; ++pair) {
        int k = world.bodies_conadr[pair];
        const int one = body[2 * k], two = body[2 * k + 1];
        Six shared[6] = {};
        do {
            const Numbers c = world.contact(k);
            const Six first[3] = {load_six(c, 0, 0), load_six(c, 0, 1), load_six(c, 0, 2)};
            const Six second[3] = {load_six(c, 1, 0), load_six(c, 1, 1), load_six(c, 1, 2)};
            Six bent[3];
            bend_six(world.curvature + 6 * k, first, bent);
            #pragma unroll
            for (int p = 0; p < 6; ++p)
                shared[p] -= bent[0][p] * second[0] + bent[1][p] * second[1] + bent[2][p] * second[2];
            ++k;
        } while (k < world.ncon && body[2 * k] == one && body[2 * k + 1] == two);
        const int upper = world.position[one], lower = world.position[two];
        const bool ahead = upper < lower;
        const Columns columns = system.columns(ahead ? lower : upper);
        #pragma unroll
        for (int p = 0; p < 6; ++p) {
            float* column = &columns.entry(6 * (ahead ? upper : lower), p);
            #pragma unroll
            for (int i = 0; i < 6; ++i) column[i * B] = ahead ? shared[i][p] : shared[p][i];
        }
    }
}
#endif

// H = M + Jᵀ·s″·J within its envelope, upper triangle, in whole tiles. Rows beyond the last body: identity.
inline CUDA_CALLABLE void hessian(const World& world, const System& system, int pairs, int thread, int threads) {
    const float nothing[4] = {0.0f, 0.0f, 0.0f, 0.0f};
    #pragma unroll 1
    for (int i = 4 * thread; i < system.base[system.panels]; i += 4 * threads) store_four(system.A + i, nothing);
    wait_for_all();
    #pragma unroll 1
    for (int c = world.nv + thread; c < system.panels * B; c += threads) {
        system.entry(c, c) = 1.0f;
        system.rhs[c] = 0.0f;
    }
    own_entries(world, system, thread, threads);
    pair_entries(world, system, pairs, thread, threads);
    wait_for_all();
}

}  // namespace petmjx

#endif
