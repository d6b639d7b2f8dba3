// The constraint solver of mjx-warp for the world of a thread block: Newton's method, explained in newton.py.
//
// Every sum has a fixed order. Only the list of pairs has no fixed order, and no sum runs over it. Loops are not
// unrolled, since a GPU waits for instructions more than for results (benchmarks/notebook/performance.md).

#include "arrays.cuh"
#include "block.cuh"
#include "cholesky.cuh"
#include "contact.cuh"
#include "hessian.cuh"
#include "world.cuh"

namespace petmjx {

// The line search ends where the cost's derivative is at most this share of its initial value, or at Newton's step if
// the cost still decreases there. Smaller shares save no iteration.
const double ENOUGH_SLOPE = 0.1;

const double INFINITE = 1e300;  // a singular Hessian may give an infinite step instead of NaN

// One of six numbers. On a GPU they stay in registers; an array with a variable index would be in memory.
template <class Six>
inline CUDA_CALLABLE double of_six(const Six& six, int i) {
#if defined(__CUDA_ARCH__)
    double found = six[0];
    #pragma unroll
    for (int k = 1; k < 6; ++k) found = i == k ? six[k] : found;
    return found;
#else
    return six[i];
#endif
}

// Gradient g = M·(qacc − qacc_smooth) − Jᵀ·force into grad and rhs, SHARE threads per body. Returns gᵀM⁻¹g.
inline CUDA_CALLABLE double gradient(const World& world, float* rhs, double* partial, int thread) {
    double bound[1];
    sum_over_all(world.nfree * SHARE, thread, partial, bound, [&](int item, double (&sum)[1]) {
        const int b = item / SHARE, share_of = item % SHARE;
#if defined(__CUDA_ARCH__)
        double value[6] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
        if (b < world.nfree) {
            #pragma unroll 1
            for (int entry = world.body_conadr[b] + share_of; entry < world.body_conadr[b + 1]; entry += SHARE) {
                const int k = world.body_contact[entry] >> 1, side = world.body_contact[entry] & 1;
                float axes[9], arms[9];
                load_axes(world.contact(k), axes);
                load_arms(world.contact(k), side, arms);
                #pragma unroll
                for (int r = 0; r < 3; ++r) {
                    const double push = side ? -world.force[3 * k + r] : world.force[3 * k + r];
                    #pragma unroll
                    for (int i = 0; i < 3; ++i) {
                        value[i] += axes[3 * r + i] * push;
                        value[3 + i] += arms[3 * r + i] * push;
                    }
                }
            }
        }
        sum_over_share(value);
#else
        SixDoubles value = 0.0;
        for (int entry = world.body_conadr[b]; entry < world.body_conadr[b + 1]; ++entry) {
            const int k = world.body_contact[entry] >> 1, side = world.body_contact[entry] & 1;
            for (int r = 0; r < 3; ++r) {
                const double push = side ? -world.force[3 * k + r] : world.force[3 * k + r];
                value += as_doubles(load_six(world.contact(k), side, r)) * push;
            }
        }
#endif
        // On a GPU each thread has one of the six numbers. If all threads worked on one number after another, they
        // would wait for one another.
        #pragma unroll
        for (int first = 0; first < 6; first += SHARE) {
            const int i = first + share_of;
            if (b >= world.nfree || i >= 6) continue;
            const int at = 6 * b + i;
            const double whole = of_six(value, i) + world.qM[at] * (world.qacc[at] - world.qacc_smooth[at]);
            world.grad[at] = whole;
            rhs[6 * world.position[b] + i] = (float)whole;
            sum[0] += whole * whole / world.qM[at];
        }
    });
    return bound[0];
}

// Layout of a block's system, kept from call to call. It is computed again when a world's contacts or the order of its
// bodies have changed, and in a block's first step of a world.
template <int PANELS>
struct Layout {
    int top[PANELS], base[PANELS + 1];  // of the system
    int widest;  // largest number of panels that reach up to the panels of a row
    int pairs;  // pairs of free bodies that touch
    double trace;  // of M
};

// Makes the layout, and finds the first contact of each pair; the contacts of a pair are contiguous. `low`, indexed by
// a body's position: the lowest position among the body and the bodies that it touches.
template <int PANELS>
inline CUDA_CALLABLE void lay_out(
    const World& world, const int* low, Factoring<PANELS>& factoring, Layout<PANELS>& layout, double* partial, int thread,
    int threads
) {
    const int at_once = Factoring<PANELS>::AT_ONCE;
    const int panels = (world.nv + B - 1) / B;
    int* top = layout.top;
    #pragma unroll 1
    for (int K = thread; K < panels; K += threads) {
        int first = low[K * B / 6];
        const int end = (K * B + B - 1) / 6, last = end < world.nfree - 1 ? end : world.nfree - 1;
        #pragma unroll 1
        for (int b = K * B / 6 + 1; b <= last; ++b) first = low[b] < first ? low[b] : first;
        top[K] = 6 * first / B;
        layout.base[K] = (K + 1 - top[K]) * B * B;
    }
    if (thread == 0) layout.pairs = layout.widest = 0;
    wait_for_all();
    prefix_sums(layout.base, panels, thread);
    factoring.know(top, panels, thread, threads);
    #pragma unroll 1
    for (int K = at_once * thread; K < panels; K += at_once * threads) {
        int reaching = 0;
        #pragma unroll 1
        for (int J = K + at_once; J < panels; ++J) reaching += top[J] < K + at_once;
        take_larger(layout.widest, reaching);
    }
    const int* body = world.body;
    #pragma unroll 1
    for (int k = thread; k < world.ncon; k += threads) {
        const bool begins = k == 0 || body[2 * k] != body[2 * k - 2] || body[2 * k + 1] != body[2 * k - 1];
        if (begins && body[2 * k] >= 0) world.bodies_conadr[take_number(layout.pairs)] = k;
    }
    double trace[1];
    sum_over_all(world.nv, thread, partial, trace, [&](int i, double (&sum)[1]) {
        if (i < world.nv) sum[0] += world.qM[i];
    });
    if (thread == 0) layout.trace = trace[0];
    wait_for_all();
}

// Shared memory of the threads of a world.
template <int PANELS>
struct Own {
    Factoring<PANELS> factoring;
    alignas(16) float rhs[PANELS * B];
    double partial[3 * MOST_WARPS];
    Layout<PANELS> layout;
};

// Finds accelerations and contact forces of a lane's world. The solver starts from the accelerations in the workspace.
// All `threads` of a lane must call it, since they wait for one another. PANELS: largest number of panels of a system.
// PANEL, EFC_WORDS: sizes on the Python side. `changed`: whether contacts, or the order of bodies, have changed since
// the last call. `forces`: whether the forces of the final accelerations are needed, too. `shared`: shared memory of
// the block, with `shared_words` numbers for each of its worlds, for the strip and the Hessian if they fit.
//
// With PETMJX_PAUSE_AFTER the solver pauses after that number of iterations, and stores it in `solver_paused`. The next
// call continues with the same system, and takes the same iterations as without a pause.
template <int PANELS, int PANEL, int EFC_WORDS, class Model, class Workspace>
inline CUDA_CALLABLE void newton(
    const Model& model, int block, int thread, int threads, bool changed, bool forces, float* shared,
    int shared_words, const Workspace& work
) {
    static_assert(PANEL == B && EFC_WORDS == EFC, "Python and C++ differ about the sizes of arrays");
    static_assert(sizeof(Own<PANELS>) <= PETMJX_OWN_BYTES, "newton.own_bytes counts too little");
#if defined(PETMJX_WORLD_OF_A_WARP)
    // After the memory for strips and Hessians of all worlds of the block.
    const size_t place = place_in_block(block);
    Own<PANELS>& own = *(Own<PANELS>*)(shared + PETMJX_WORLDS * shared_words + place * (PETMJX_OWN_BYTES / 4));
    shared += place * shared_words;
#else
    PETMJX_SHARED Own<PANELS> own;
#endif
    Factoring<PANELS>& factoring = own.factoring;
    Layout<PANELS>& layout = own.layout;
    float* rhs = own.rhs;
    double* partial = own.partial;

    if (WARP == 1) thread = 0, threads = 1;  // constants for the compiler
    const int at_once = Factoring<PANELS>::AT_ONCE;
    const int pyramidal = model.pyramidal, limit = model.iterations;
    const double impratio_invsqrt = model.impratio_invsqrt, slack = model.slip_slack;
    const size_t at = block, nconmax = model.nconmax;
    World world;
    world.ncon = work.ncon.data[at];
    world.nfree = work.nfree.data[at];
    world.nv = 6 * world.nfree;
    world.efc = work.efc.data + at * nconmax * EFC;
    world.nconmax = model.nconmax;
    world.body = work.contact_bodies.data + at * nconmax * 2;
    world.body_conadr = work.body_conadr.data + at * work.body_conadr.shape[1];
    world.body_contact = work.body_contact.data + at * work.body_contact.shape[1];
    world.position = work.position.data + at * work.position.shape[1];
    world.qM = work.qM.data + at * work.qM.shape[1];
    world.qacc_smooth = work.qacc_smooth.data + at * work.qacc_smooth.shape[1];
    world.qacc = work.qacc.data + at * work.qacc.shape[1];
    world.search = work.search.data + at * work.search.shape[1];
    world.grad = work.grad.data + at * work.grad.shape[1];
    world.Jaref = work.Jaref.data + at * nconmax * 3;
    world.jv = work.jv.data + at * nconmax * 3;
    world.force = work.contact_force.data + at * nconmax * 3;
    world.curvature = work.curvature.data + at * nconmax * 6;
    world.drag = work.drag.data + at * nconmax * 2;
    world.excess = work.excess.data + at * nconmax;
    world.bodies_conadr = work.bodies_conadr.data + at * nconmax;
    const int* low = work.lowest.data + at * work.lowest.shape[1];
    const int ncon = world.ncon, nfree = world.nfree, nv = world.nv;
    const int* body = world.body;
    double* qacc = world.qacc;
    double* search = world.search;
    double* Jaref = world.Jaref;
    double* jv = world.jv;
    System system;
    system.panels = (nv + B - 1) / B;
    system.top = layout.top;
    system.base = layout.base;
    system.rhs = rhs;

    int begun = 0;
    if (PETMJX_PAUSE_AFTER > 0) {
        begun = work.solver_paused.data[at];
        wait_for_all();
        if (thread == 0) work.solver_paused.data[at] = 0;
    }
    if (thread == 0) work.solver_niter.data[at] = begun;
    if (nfree == 0) return;
    if (begun == 0) {
        #pragma unroll 1
        for (int i = thread; i < nv; i += threads)
            if (world.body_conadr[i / 6] == world.body_conadr[i / 6 + 1]) qacc[i] = world.qacc_smooth[i];
    }
    // On a CPU there is no shared memory, so no layout is kept.
    if ((begun == 0 && changed) || WARP == 1) lay_out(world, low, factoring, layout, partial, thread, threads);
    else wait_for_all();
    const double enough = model.tolerance * layout.trace;  // MuJoCo measures costs in units of the inertia's trace
    const int strip_words = at_once * layout.widest * TILE, pairs = layout.pairs;
    const bool strip_fits = strip_words <= shared_words, fits = layout.base[system.panels] + strip_words <= shared_words;
    system.strip = strip_fits ? shared : work.strip.data + at * work.strip.shape[1];
    system.A = fits ? shared + strip_words : work.hessian.data + at * work.hessian.shape[1];
    if (begun == 0) {
        #pragma unroll 1
        for (int k = thread; k < ncon; k += threads) {
            const Numbers contact = world.contact(k);
            relative(contact, body + 2 * k, qacc, Jaref + 3 * k);
            for (int r = 0; r < 3; ++r) Jaref[3 * k + r] -= contact[27 + r];
        }
    }
    bool last = false;
    #pragma unroll 1
    for (int iteration = begun;; ++iteration) {
        // The stored forces belong to the accelerations before the last iteration. They are computed again only if the
        // caller needs forces.
        const bool ends = last || iteration >= limit;
        if (ends && !forces) break;
        #pragma unroll 1
        for (int k = thread; k < ncon; k += threads) {
            double push[3], bend[6];
            const Numbers contact = world.contact(k);
            double* j = Jaref + 3 * k;
            const bool corrects = !ends && iteration <= PETMJX_SLIP_ROUNDS && world.excess[k] >= 0.0f;
            if (corrects && iteration == 0) correct(impratio_invsqrt, slack, true, push, contact, j, world.excess + k);
            respond(pyramidal, impratio_invsqrt, j, contact, iteration == 0, world.drag + 2 * k, push, bend);
            if (corrects && iteration > 0 && correct(impratio_invsqrt, slack, false, push, contact, j, world.excess + k))
                respond(pyramidal, impratio_invsqrt, j, contact, false, world.drag + 2 * k, push, bend);
            for (int i = 0; i < 3; ++i) world.force[3 * k + i] = push[i];
            for (int i = 0; i < 6; i += 2) store_two(world.curvature + 6 * k + i, (float)bend[i], (float)bend[i + 1]);
        }
        wait_for_all();
        if (ends) {
            // The gradient shows whether the forces of a stopped solver are in balance (box_motion.py, is_unbalanced).
            if (iteration >= limit) gradient(world, rhs, partial, thread);
            break;
        }
        const double bound = gradient(world, rhs, partial, thread);
        // Since H ≥ M, the cost can decrease by at most half of this bound.
        if (!(0.5 * bound > enough)) break;
        if (thread == 0) work.solver_niter.data[at] = iteration + 1;
        hessian(world, system, pairs, thread, threads);
        factor_and_solve(system, factoring, thread, threads);

        // A step along −x. Its length is found by Newton's method on the cost's derivative, with safeguards.
        double along[3];
        sum_over_all(nv, thread, partial, along, [&](int i, double (&sums)[3]) {
            if (i >= nv) return;
            const double s = -(double)rhs[6 * world.position[i / 6] + i % 6];
            search[i] = s;
            sums[0] += world.grad[i] * s;
            sums[1] += s * world.qM[i] * (qacc[i] - world.qacc_smooth[i]);
            sums[2] += s * world.qM[i] * s;
        });
        const double start = along[0];
        if (!(start < 0.0 && start > -INFINITE)) break;
        #pragma unroll 1
        for (int k = thread; k < ncon; k += threads) relative(world.contact(k), body + 2 * k, search, jv + 3 * k);
        double length = 1.0, shortest = 0.0, longest = 1.0, first = start;
        #pragma unroll 1
        for (int trial = 0; trial < model.ls_iterations; ++trial) {
            double cost[2];
            sum_over_all(ncon, thread, partial, cost, [&](int k, double (&sums)[2]) PETMJX_INLINED {
                if (k < ncon)
                    respond_along(pyramidal, impratio_invsqrt, Jaref + 3 * k, jv + 3 * k, length, world.contact(k), sums);
            });
            first = cost[0] + along[1] + length * along[2];
            const double second = cost[1] + along[2];
            // No step is longer than Newton's, although the cost may decrease beyond it where contacts open.
            if (first <= ENOUGH_SLOPE * -start && (length == 1.0 || first >= ENOUGH_SLOPE * start)) break;
            if (trial + 1 == model.ls_iterations) break;
            if (first < 0.0) shortest = length; else longest = length;
            length -= first / second;
            if (!(length > shortest && length < longest)) length = 0.5 * (shortest + longest);
        }
        #pragma unroll 1
        for (int i = thread; i < nv; i += threads) qacc[i] += length * search[i];
        // Drags take the whole step, even if accelerations take only a part of it. The solver then needs 20
        // iterations, otherwise 25.
        #pragma unroll 1
        for (int k = thread; k < ncon; k += threads) {
            double* j = Jaref + 3 * k;
            const double* v = jv + 3 * k;
            const double after[3] = {j[0] + length * v[0], j[1] + length * v[1], j[2] + length * v[2]};
            if (!pyramidal && may_slide(impratio_invsqrt, after, world.contact(k))) follow(j, v, world.drag + 2 * k);
            for (int i = 0; i < 3; ++i) j[i] = after[i];
        }
        wait_for_all();
        // The decrease of the cost is about the length × the mean of the two derivatives.
        last = !(-0.5 * length * (start + first) > enough);
        if (PETMJX_PAUSE_AFTER > 0 && !last && iteration + 1 < limit && iteration + 1 - begun == PETMJX_PAUSE_AFTER) {
            if (thread == 0) work.solver_paused.data[at] = iteration + 1;
            break;
        }
    }
}

}  // namespace petmjx
