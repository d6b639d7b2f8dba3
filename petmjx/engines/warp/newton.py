"""The constraint solver of mjx-warp: MuJoCo's Newton method on a pallet's contacts, a world to a thread block.

MuJoCo finds the accelerations a that minimise ½ (a − a₀)ᵀ M (a − a₀) + s(J·a − r), where a₀ is what they would be
without contacts, r is the acceleration that each contact asks for, and s the cost of its cone ("Computation:
Constraint model"). Newton's direction solves H·x = gradient with H = M + Jᵀ·s″·J; a line search follows.

Three things make it fast here, beside keeping all iterations in one kernel:

- A contact touches two bodies, so that J is kept as 27 numbers a contact, and products with it cost that much.
- H is block-sparse, and boxes are numbered bottom up, so that it has a narrow envelope: in each column nothing but
  zeros above the lowest-numbered body its box touches, and the factor fills in only below. Cholesky runs within it,
  in panels of 16 rows, a column to a thread.
- A world stops on its own, and stops early: since H ≥ M, the cost can fall by no more than ½ gᵀM⁻¹g, which tells
  before any factorisation whether one is worth it. At rest it seldom is.

Accelerations, residuals, forces and gradients are double, H and its factor single precision: the factor's rounding
slows convergence a little, while that of the gradient would end it. Every sum has a fixed order, so that a world's
result depends neither on the lanes beside it nor on the run.
"""

from __future__ import annotations

import functools

import warp as wp

from petmjx.engines.warp.cholesky import FACTOR_AND_SOLVE, PANEL

MAX_PANELS = 104
"""Panels of the largest system: its right-hand side is kept in shared memory."""

MAX_DOFS = MAX_PANELS * PANEL
"""Rows of the largest system."""

MANY = (128, 4)
"""Threads a world, and worlds that a multiprocessor works on at a time, where there are many worlds."""

FEW = (256, 2)
"""The same where there are so few that a step lasts as long as one world's."""

FEW_LANES = 4
"""Lanes for a multiprocessor up to which there are few: in a run's last stage most stand idle."""

_NEWTON = """
    const int B = @PANEL@, STRIP = 160, MOST = @MAX_PANELS@;
#if defined(__CUDA_ARCH__)
    __shared__ __align__(16) float kept[B * STRIP];
    __shared__ __align__(16) float W[B * B];
    __shared__ __align__(16) float solved[B];
    __shared__ float rhs[MOST * B];
    __shared__ int top[MOST];
    __shared__ int active[2][MOST];
    __shared__ int active_count[2];
    __shared__ int pairs;
    __shared__ double partial[2 * 32];
    const int SHARE = 8;
    #define PETMJX_SYNC __syncthreads()
    #define PETMJX_LOAD(to, from) { \\
        const float4 four = *(const float4*)(from); \\
        (to)[0] = four.x, (to)[1] = four.y, (to)[2] = four.z, (to)[3] = four.w; }
    #define PETMJX_STORE(to, from) *(float4*)(to) = make_float4((from)[0], (from)[1], (from)[2], (from)[3])
    #define PETMJX_NEXT(counter) atomicAdd(&counter, 1)
    // Sums over the block, the same to the last bit in every thread and in every run.
    auto sum = [&](double& x, double& y) {
        for (int offset = 16; offset > 0; offset >>= 1) {
            x += __shfl_xor_sync(0xffffffffu, x, offset);
            y += __shfl_xor_sync(0xffffffffu, y, offset);
        }
        PETMJX_SYNC;
        if ((thread & 31) == 0) {
            partial[thread >> 4] = x;
            partial[(thread >> 4) + 1] = y;
        }
        PETMJX_SYNC;
        x = 0.0;
        y = 0.0;
        for (int w = 0; w < threads >> 5; ++w) {
            x += partial[2 * w];
            y += partial[2 * w + 1];
        }
    };
    // Sums over SHARE neighbouring threads.
    auto share = [&](auto& x) {
        for (int offset = SHARE / 2; offset > 0; offset >>= 1) x += __shfl_xor_sync(0xffffffffu, x, offset);
    };
#else
    float kept[B * STRIP];
    float W[B * B];
    float solved[B];
    float rhs[MOST * B];
    int top[MOST];
    int active[2][MOST];
    int active_count[2];
    int pairs;
    const int SHARE = 1;
    #define PETMJX_SYNC
    #define PETMJX_LOAD(to, from) for (int e = 0; e < 4; ++e) (to)[e] = (from)[e]
    #define PETMJX_STORE(to, from) for (int e = 0; e < 4; ++e) (to)[e] = (from)[e]
    #define PETMJX_NEXT(counter) counter++
    auto sum = [&](double&, double&) {};
    auto share = [&](auto&) {};
#endif
    const int room = rows.shape[1];
    const int contacts = n_contacts.data[world] < room ? n_contacts.data[world] : room;
    const int bodies = n_blocks.data[world];
    const int n = 6 * bodies;
    const int ld = hessian.shape[2];
    const int panels = (n + B - 1) / B;
    const size_t w = world;
    const float* row = rows.data + w * room * 32;
    const int* block = blocks.data + w * room * 2;
    const int* begin_of = link_begin.data + w * link_begin.shape[1];
    const int* link = links.data + w * links.shape[1];
    const int* low = lowest.data + w * lowest.shape[1];
    const float* mass = inertia.data + w * inertia.shape[1];
    const float* idle = smooth.data + w * smooth.shape[1];
    const float* warm = warmstart.data + w * warmstart.shape[1];
    double* a = acceleration.data + w * acceleration.shape[1];
    double* step = direction.data + w * direction.shape[1];
    double* g = gradient.data + w * gradient.shape[1];
    double* jar = residual.data + w * room * 3;
    double* jv = slope.data + w * room * 3;
    double* f = force.data + w * room * 3;
    float* curve = curvature.data + w * room * 6;
    int* pair = pair_begin.data + w * room;
    float* A = hessian.data + w * hessian.shape[1] * ld;

    // Force and curvature of a contact's cost at residual j = J·a − r, in its frame (engine_core_constraint.c's
    // mj_constraintUpdate, whose formulas they are; both tangents have the same friction here).
    auto respond = [&](const double* j, const float* contact, double* push, double* bend) {
        const double D = contact[30], mu = contact[31];
        for (int i = 0; i < 3; ++i) push[i] = 0.0;
        for (int i = 0; i < 6; ++i) bend[i] = 0.0;
        if (pyramidal) {
            for (int edge = 0; edge < 4; ++edge) {
                const double t = edge & 1 ? -mu : mu;
                const int side = 1 + (edge >> 1);
                const double r = j[0] + t * j[side];
                if (r >= 0.0) continue;
                push[0] -= D * r;
                push[side] -= D * r * t;
                bend[0] += D;
                bend[side] += D * t;
                bend[side == 1 ? 3 : 5] += D * t * t;
            }
            return;
        }
        const double tangent = sqrt(j[1] * j[1] + j[2] * j[2]);
        const double N = mu * j[0], T = mu * tangent;
        if (N >= mu * T) return;
        if (mu * N + T <= 0.0) {
            for (int i = 0; i < 3; ++i) push[i] = -D * j[i];
            bend[0] = bend[3] = bend[5] = D;
            return;
        }
        const double Dm = D / (mu * mu * (1.0 + mu * mu)), gap = N - mu * T;
        const double x = j[1] / tangent, y = j[2] / tangent;
        push[0] = -Dm * gap * mu;
        push[1] = -push[0] * mu * x;
        push[2] = -push[0] * mu * y;
        const double along = Dm * mu * mu * mu * mu, across = -Dm * gap * mu * mu * mu / T * mu;
        bend[0] = Dm * mu * mu;
        bend[1] = -Dm * mu * mu * mu * x;
        bend[2] = -Dm * mu * mu * mu * y;
        bend[3] = along * x * x + across * y * y;
        bend[4] = (along - across) * x * y;
        bend[5] = along * y * y + across * x * x;
    };
    // J·x of one contact.
    auto relative = [&](int k, const double* x, double* out) {
        const float* c = row + 32 * k;
        const int one = 6 * block[2 * k], two = 6 * block[2 * k + 1];
        for (int r = 0; r < 3; ++r) {
            double value = 0.0;
            for (int i = 0; i < 3; ++i) {
                if (one >= 0) value -= c[3 * r + i] * x[one + i] + c[9 + 3 * r + i] * x[one + 3 + i];
                if (two >= 0) value += c[3 * r + i] * x[two + i] + c[18 + 3 * r + i] * x[two + 3 + i];
            }
            out[r] = value;
        }
    };

    if (thread == 0) iterations.data[world] = 0;
    if (bodies == 0) return;
    double trace = 0.0, unused = 0.0;
    for (int i = thread; i < n; i += threads) {
        trace += mass[i];
        a[i] = warm[i];
    }
    for (int K = thread; K < panels; K += threads) {
        int first = low[K * B / 6];
        const int last = (K * B + B - 1) / 6 < bodies - 1 ? (K * B + B - 1) / 6 : bodies - 1;
        for (int b = K * B / 6 + 1; b <= last; ++b) first = low[b] < first ? low[b] : first;
        top[K] = 6 * first / B;
    }
    if (thread == 0) pairs = 0;
    sum(trace, unused);
    // Contacts at which a pair of moving bodies begins: theirs lie one after the other.
    for (int k = thread; k < contacts; k += threads) {
        const bool begins = k == 0 || block[2 * k] != block[2 * k - 2] || block[2 * k + 1] != block[2 * k - 1];
        if (begins && block[2 * k] >= 0) pair[PETMJX_NEXT(pairs)] = k;
    }
    // MuJoCo measures costs in units of the inertia's trace.
    const double enough = tolerance * trace;
    for (int k = thread; k < contacts; k += threads) {
        relative(k, a, jar + 3 * k);
        for (int r = 0; r < 3; ++r) jar[3 * k + r] -= row[32 * k + 27 + r];
    }
    bool last = false;
    for (int iteration = 0;; ++iteration) {
        for (int k = thread; k < contacts; k += threads) {
            double push[3], bend[6];
            respond(jar + 3 * k, row + 32 * k, push, bend);
            for (int i = 0; i < 3; ++i) f[3 * k + i] = push[i];
            for (int i = 0; i < 6; ++i) curve[6 * k + i] = (float)bend[i];
        }
        PETMJX_SYNC;
        if (last || iteration >= limit) break;
        double bound = 0.0;
        for (int base = 0; base < bodies * SHARE; base += threads) {
            const int b = (base + thread) / SHARE, share_of = thread % SHARE;
            double value[6] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
            if (b < bodies) {
                for (int entry = begin_of[b] + share_of; entry < begin_of[b + 1]; entry += SHARE) {
                    const int k = link[entry] >> 1, side = link[entry] & 1;
                    const float* c = row + 32 * k;
                    for (int r = 0; r < 3; ++r) {
                        const double push = side ? -f[3 * k + r] : f[3 * k + r];
                        #pragma unroll
                        for (int i = 0; i < 3; ++i) {
                            value[i] += c[3 * r + i] * push;
                            value[3 + i] += c[9 + 9 * side + 3 * r + i] * push;
                        }
                    }
                }
            }
            #pragma unroll
            for (int i = 0; i < 6; ++i) {
                share(value[i]);
                if (b >= bodies || i % SHARE != share_of) continue;
                const int at = 6 * b + i;
                const double whole = value[i] + mass[at] * (a[at] - idle[at]);
                g[at] = whole;
                rhs[at] = (float)whole;
                bound += whole * whole / mass[at];
            }
        }
        sum(bound, unused);
        if (!(0.5 * bound > enough)) break;
        if (thread == 0) iterations.data[world] = iteration + 1;

        // The Hessian within its envelope, upper triangle, in whole tiles; beyond its end the identity.
        for (int J = 0; J < panels; ++J) {
            float* corner = A + (size_t)top[J] * B * ld + J * B;
            const float nothing[4] = {0.0f, 0.0f, 0.0f, 0.0f};
            for (int i = thread; i < (J + 1 - top[J]) * B * 4; i += threads)
                PETMJX_STORE(corner + (size_t)(i / 4) * ld + i % 4 * 4, nothing);
        }
        PETMJX_SYNC;
        for (int c = n + thread; c < panels * B; c += threads) {
            A[(size_t)c * ld + c] = 1.0f;
            rhs[c] = 0.0f;
        }
        // A body's own block: 21 entries, summed over its contacts by SHARE threads.
        for (int base = 0; base < bodies * SHARE; base += threads) {
            const int b = (base + thread) / SHARE, share_of = thread % SHARE;
            float own[21];
            #pragma unroll
            for (int e = 0; e < 21; ++e) own[e] = 0.0f;
            if (b < bodies) {
                for (int entry = begin_of[b] + share_of; entry < begin_of[b + 1]; entry += SHARE) {
                    const int k = link[entry] >> 1, side = link[entry] & 1;
                    const float* c = row + 32 * k;
                    const float* s = curve + 6 * k;
                    const float s0 = s[0], s1 = s[1], s2 = s[2], s3 = s[3], s4 = s[4], s5 = s[5];
                    float x[6], y[6], z[6];
                    #pragma unroll
                    for (int i = 0; i < 3; ++i) {
                        x[i] = c[i], y[i] = c[3 + i], z[i] = c[6 + i];
                        const float* arm = c + 9 + 9 * side + i;
                        x[3 + i] = arm[0], y[3 + i] = arm[3], z[3 + i] = arm[6];
                    }
                    int e = 0;
                    #pragma unroll
                    for (int q = 0; q < 6; ++q) {
                        const float bx = s0 * x[q] + s1 * y[q] + s2 * z[q];
                        const float by = s1 * x[q] + s3 * y[q] + s4 * z[q];
                        const float bz = s2 * x[q] + s4 * y[q] + s5 * z[q];
                        #pragma unroll
                        for (int p = 0; p <= q; ++p) own[e++] += x[p] * bx + y[p] * by + z[p] * bz;
                    }
                }
            }
            int e = 0;
            #pragma unroll
            for (int q = 0; q < 6; ++q) {
                #pragma unroll
                for (int p = 0; p <= q; ++p) {
                    float value = own[e];
                    share(value);
                    if (b < bodies && e % SHARE == share_of)
                        A[(size_t)(6 * b + p) * ld + 6 * b + q] = value + (p == q ? mass[6 * b + p] : 0.0f);
                    ++e;
                }
            }
        }
        // The block of two bodies that touch: a row to a thread, summed over their contacts.
        for (int item = thread; item < 6 * pairs; item += threads) {
            const int p = item % 6;
            int k = pair[item / 6];
            const int one = block[2 * k], two = block[2 * k + 1];
            float shared[6] = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
            do {
                const float* c = row + 32 * k;
                const float* s = curve + 6 * k;
                const float* mine = c + (p < 3 ? p : 6 + p);
                const float x = mine[0], y = mine[3], z = mine[6];
                const float bx = s[0] * x + s[1] * y + s[2] * z;
                const float by = s[1] * x + s[3] * y + s[4] * z;
                const float bz = s[2] * x + s[4] * y + s[5] * z;
                #pragma unroll
                for (int i = 0; i < 3; ++i) {
                    shared[i] -= c[i] * bx + c[3 + i] * by + c[6 + i] * bz;
                    shared[3 + i] -= c[18 + i] * bx + c[21 + i] * by + c[24 + i] * bz;
                }
                ++k;
            } while (k < contacts && block[2 * k] == one && block[2 * k + 1] == two);
            #pragma unroll
            for (int i = 0; i < 6; ++i) A[(size_t)(6 * one + p) * ld + 6 * two + i] = shared[i];
        }

@CHOLESKY@

        // A step along −x, its length by safeguarded Newton on the cost's derivative.
        double start = 0.0, pull = 0.0, stiff = 0.0;
        for (int i = thread; i < n; i += threads) {
            const double s = -(double)rhs[i];
            step[i] = s;
            start += g[i] * s;
            pull += s * mass[i] * (a[i] - idle[i]);
            stiff += s * mass[i] * s;
        }
        sum(start, unused);
        sum(pull, stiff);
        if (!(start < 0.0)) break;
        for (int k = thread; k < contacts; k += threads) relative(k, step, jv + 3 * k);
        double length = 1.0, shortest = 0.0, longest = -1.0, first = start, second = 0.0;
        for (int trial = 0; trial < trials; ++trial) {
            first = 0.0;
            second = 0.0;
            for (int k = thread; k < contacts; k += threads) {
                const double* v = jv + 3 * k;
                double j[3], push[3], bend[6];
                for (int r = 0; r < 3; ++r) j[r] = jar[3 * k + r] + length * v[r];
                respond(j, row + 32 * k, push, bend);
                first -= push[0] * v[0] + push[1] * v[1] + push[2] * v[2];
                second += bend[0] * v[0] * v[0] + bend[3] * v[1] * v[1] + bend[5] * v[2] * v[2]
                        + 2.0 * (bend[1] * v[0] * v[1] + bend[2] * v[0] * v[2] + bend[4] * v[1] * v[2]);
            }
            sum(first, second);
            first += pull + length * stiff;
            second += stiff;
            if (fabs(first) <= 0.01 * -start || trial + 1 == trials) break;
            if (first < 0.0) shortest = length; else longest = length;
            double next = length - first / second;
            if (!(next > shortest)) next = longest > 0.0 ? 0.5 * (shortest + longest) : 2.0 * length;
            if (longest > 0.0 && !(next < longest)) next = 0.5 * (shortest + longest);
            length = next;
        }
        for (int i = thread; i < n; i += threads) a[i] += length * step[i];
        for (int i = thread; i < 3 * contacts; i += threads) jar[i] += length * jv[i];
        PETMJX_SYNC;
        // Between the two derivatives the cost fell by about their mean times the length.
        last = !(-0.5 * length * (start + first) > enough);
    }
"""


_SNIPPET = (
    _NEWTON.replace("@PANEL@", str(PANEL))
    .replace("@MAX_PANELS@", str(MAX_PANELS))
    .replace("@CHOLESKY@", FACTOR_AND_SOLVE)
)


@wp.func_native(_SNIPPET)
def _newton(
    world: int,
    thread: int,
    threads: int,
    pyramidal: int,
    limit: int,
    trials: int,
    tolerance: wp.float64,
    rows: wp.array3d(dtype=float),
    blocks: wp.array3d(dtype=int),
    n_contacts: wp.array(dtype=int),
    n_blocks: wp.array(dtype=int),
    link_begin: wp.array2d(dtype=int),
    links: wp.array2d(dtype=int),
    lowest: wp.array2d(dtype=int),
    pair_begin: wp.array2d(dtype=int),
    inertia: wp.array2d(dtype=float),
    smooth: wp.array2d(dtype=float),
    warmstart: wp.array2d(dtype=float),
    acceleration: wp.array2d(dtype=wp.float64),
    direction: wp.array2d(dtype=wp.float64),
    gradient: wp.array2d(dtype=wp.float64),
    residual: wp.array3d(dtype=wp.float64),
    slope: wp.array3d(dtype=wp.float64),
    force: wp.array3d(dtype=wp.float64),
    curvature: wp.array3d(dtype=float),
    hessian: wp.array3d(dtype=float),
    iterations: wp.array(dtype=int),
): ...


@functools.cache
def solver(threads: int, worlds_per_processor: int) -> wp.Kernel:
    """The kernel for so many threads a world; on a CPU, where a barrier has nothing to wait for, one."""

    @wp.kernel(enable_backward=False, launch_bounds=(threads, worlds_per_processor), module="unique")
    def solve(
        threads: int,
        pyramidal: int,
        limit: int,
        trials: int,
        tolerance: wp.float64,
        rows: wp.array3d(dtype=float),
        blocks: wp.array3d(dtype=int),
        n_contacts: wp.array(dtype=int),
        n_blocks: wp.array(dtype=int),
        link_begin: wp.array2d(dtype=int),
        links: wp.array2d(dtype=int),
        lowest: wp.array2d(dtype=int),
        pair_begin: wp.array2d(dtype=int),
        inertia: wp.array2d(dtype=float),
        smooth: wp.array2d(dtype=float),
        warmstart: wp.array2d(dtype=float),
        acceleration: wp.array2d(dtype=wp.float64),
        direction: wp.array2d(dtype=wp.float64),
        gradient: wp.array2d(dtype=wp.float64),
        residual: wp.array3d(dtype=wp.float64),
        slope: wp.array3d(dtype=wp.float64),
        force: wp.array3d(dtype=wp.float64),
        curvature: wp.array3d(dtype=float),
        hessian: wp.array3d(dtype=float),
        iterations: wp.array(dtype=int),
    ):
        """Accelerations and contact forces of every world, from ``warmstart`` on; ``threads`` a world.

        ``limit`` bounds iterations, ``trials`` the line search's, ``tolerance`` is MuJoCo's. ``force`` holds each
        contact's in its frame; the arrays beside it and ``acceleration`` are scratch.
        """
        world, thread = wp.tid()
        _newton(
            world,
            thread,
            threads,
            pyramidal,
            limit,
            trials,
            tolerance,
            rows,
            blocks,
            n_contacts,
            n_blocks,
            link_begin,
            links,
            lowest,
            pair_begin,
            inertia,
            smooth,
            warmstart,
            acceleration,
            direction,
            gradient,
            residual,
            slope,
            force,
            curvature,
            hessian,
            iterations,
        )

    return solve
