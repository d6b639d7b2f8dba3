"""A Cholesky solve for pallets, in place of mujoco_warp's dense one, inside its Newton solver.

Newton's direction solves H·x = gradient, H symmetric positive definite with six rows a body. mujoco_warp factors
it as a dense matrix in 16 × 16 tiles, one warp a world: at 60 boxes 3,000 tile products one after the other.
But a box touches only its neighbours, and boxes are placed bottom up, so that H has a narrow envelope: in each
column nothing but zeros above the lowest-numbered body its box touches, and the factor fills in only below.
This kernel factors within the envelope, a world to a thread block, a column to a thread. The direction is the
same to rounding; what is skipped is multiplication by zeros.

It also leaves out the factorisation of worlds whose last line search has already met the solver's stopping rule,
which the stock solver makes and throws away.

Two private functions of mujoco_warp are replaced, as of mujoco-mjx 3.17; ``install`` refuses other versions.
"""

from __future__ import annotations

import importlib
import importlib.metadata
from typing import Any

import warp as wp

PANEL = 16
"""Rows and columns of a panel; mujoco_warp pads its matrices to multiples of this."""

MAX_DOFS = 1024
"""Largest system: its right-hand side is kept in shared memory. More go to the stock solver."""

MIN_DOFS = 33
"""Up to 32 degrees of freedom the stock solver has a one-tile kernel of its own."""

CUDA_THREADS = 128

BLOCKS_PER_PROCESSOR = 8
"""Worlds that a multiprocessor works on at a time; keeps the compiler at 64 registers a thread, without spilling."""

SUPPORTED = "3.17."
"""Version prefix of mujoco-mjx whose solver this fits."""

_SNIPPET = """
    const int B = 16, TILE = 64;
#if defined(__CUDA_ARCH__)
    __shared__ __align__(16) float tile[TILE * B];
    __shared__ float diag[B * 17];
    __shared__ float tri[B * 17];
    __shared__ float rhs[1024];
    __shared__ float sums[2 * 128];
    #define PETMJX_SYNC __syncthreads()
#else
    float tile[TILE * B];
    float diag[B * 17];
    float tri[B * 17];
    float rhs[1024];
    float sums[2 * 128];
    #define PETMJX_SYNC
#endif
    const int ld = h.shape[2];
    const int panels = (n + B - 1) / B;
    const float* A = h.data + (size_t)world * h.shape[1] * ld;
    float* U = u.data + (size_t)world * u.shape[1] * ld;
    const int* first = top.data + (size_t)world * top.shape[1];
    const float* g = grad.data + (size_t)world * grad.shape[1];
    float* out = search.data + (size_t)world * search.shape[1];

    PETMJX_SYNC;
    for (int c = thread; c < n; c += threads) rhs[c] = g[c];

    // Forward: H = U^T U by panels of 16 rows, and U^T y = gradient along with it.
    for (int K = 0; K < panels; ++K) {
        const int k = K * B;
        const int width = n - k < B ? n - k : B;
        const int top_row = first[K] * B;
        PETMJX_SYNC;
        for (int entry = thread; entry < B * B; entry += threads) {
            const int p = entry / B, q = entry % B;
            diag[p * 17 + q] = q >= p && q < width ? A[(size_t)(k + p) * ld + k + q] : (p == q ? 1.0f : 0.0f);
        }
        for (int above = top_row; above < k; above += TILE) {
            const int rows = k - above < TILE ? k - above : TILE;
            PETMJX_SYNC;
            for (int i = thread; i < rows * B; i += threads)
                tile[i] = U[(size_t)(above + i / B) * ld + k + i % B];
            PETMJX_SYNC;
            for (int entry = thread; entry < B * B; entry += threads) {
                const int p = entry / B, q = entry % B;
                if (q < p || q >= width) continue;
                float sum = 0.0f;
                #pragma unroll 8
                for (int j = 0; j < rows; ++j) sum += tile[j * B + p] * tile[j * B + q];
                diag[p * 17 + q] -= sum;
            }
        }
        for (int p = 0; p < B - 1; ++p) {
            PETMJX_SYNC;
            const float pivot = 1.0f / diag[p * 17 + p];
            for (int entry = thread; entry < B * B; entry += threads) {
                const int q = entry / B, c = entry % B;
                if (q > p && c >= q) diag[q * 17 + c] -= diag[p * 17 + q] * diag[p * 17 + c] * pivot;
            }
        }
        PETMJX_SYNC;
        for (int entry = thread; entry < B * B; entry += threads) {
            const int p = entry / B, q = entry % B;
            const float value = q >= p ? diag[p * 17 + q] / sqrtf(diag[p * 17 + p]) : 0.0f;
            tri[p * 17 + q] = value;
            if (q >= p) U[(size_t)(k + p) * ld + k + q] = value;
        }
        PETMJX_SYNC;
        float y[16];
        #pragma unroll
        for (int p = 0; p < 16; ++p) {
            float value = p < width ? rhs[k + p] : 0.0f;
            #pragma unroll
            for (int q = 0; q < p; ++q) value -= tri[q * 17 + p] * y[q];
            y[p] = value / tri[p * 17 + p];
        }
        PETMJX_SYNC;
        if (thread == 0) {
            #pragma unroll
            for (int p = 0; p < 16; ++p) if (p < width) rhs[k + p] = y[p];
        }
        // The panel's row, a column to a thread; columns whose envelope begins below stay untouched.
        for (int base = k + B; base < n; base += threads) {
            const int c = base + thread;
            const int begin = c < n ? first[c / B] : panels;
            const bool inside = begin <= K;
            float sum[16];
            #pragma unroll
            for (int p = 0; p < 16; ++p) sum[p] = inside ? A[(size_t)(k + p) * ld + c] : 0.0f;
            for (int above = top_row; above < k; above += TILE) {
                const int rows = k - above < TILE ? k - above : TILE;
                PETMJX_SYNC;
                for (int i = thread; i < rows * B; i += threads)
                    tile[i] = U[(size_t)(above + i / B) * ld + k + i % B];
                PETMJX_SYNC;
                if (!inside) continue;
                // Envelopes begin at multiples of 16 rows, so that rows come in whole groups of 8.
                for (int j = begin * B > above ? begin * B - above : 0; j < rows; j += 8) {
                    float value[8];
                    #pragma unroll
                    for (int i = 0; i < 8; ++i) value[i] = U[(size_t)(above + j + i) * ld + c];
                    #pragma unroll
                    for (int i = 0; i < 8; ++i) {
                        #pragma unroll
                        for (int p = 0; p < 16; ++p) sum[p] -= tile[(j + i) * B + p] * value[i];
                    }
                }
            }
            PETMJX_SYNC;
            if (!inside) continue;
            float update = 0.0f;
            #pragma unroll
            for (int p = 0; p < 16; ++p) {
                #pragma unroll
                for (int q = 0; q < p; ++q) sum[p] -= tri[q * 17 + p] * sum[q];
                sum[p] /= tri[p * 17 + p];
                update += sum[p] * rhs[k + p];
                U[(size_t)(k + p) * ld + c] = sum[p];
            }
            rhs[c] -= update;
        }
    }

    // Backward: U x = y, each panel's solution taken out of the rows above at once.
    for (int K = panels - 1; K >= 0; --K) {
        const int k = K * B;
        const int width = n - k < B ? n - k : B;
        PETMJX_SYNC;
        for (int entry = thread; entry < 256; entry += threads) {
            const int p = entry / 16, q = entry % 16;
            diag[p * 17 + q] = q >= p ? U[(size_t)(k + p) * ld + k + q] : 0.0f;
        }
        PETMJX_SYNC;
        float x[16];
        #pragma unroll
        for (int p = 15; p >= 0; --p) {
            float value = p < width ? rhs[k + p] : 0.0f;
            #pragma unroll
            for (int q = p + 1; q < 16; ++q) value -= diag[p * 17 + q] * x[q];
            x[p] = p < width ? value / diag[p * 17 + p] : 0.0f;
        }
        PETMJX_SYNC;
        if (thread == 0) {
            #pragma unroll
            for (int p = 0; p < 16; ++p) if (p < width) rhs[k + p] = x[p];
        }
        for (int j = first[K] * B + thread; j < k; j += threads) {
            const float* row = U + (size_t)j * ld + k;
            float value = rhs[j];
            #pragma unroll
            for (int p = 0; p < 16; ++p) if (p < width) value -= row[p] * x[p];
            rhs[j] = value;
        }
    }
    PETMJX_SYNC;
    float square = 0.0f, decrement = 0.0f;
    for (int c = thread; c < n; c += threads) {
        const float value = rhs[c];
        out[c] = -value;
        square += value * value;
        decrement += g[c] * value;
    }
    sums[thread] = square;
    sums[threads + thread] = decrement;
    PETMJX_SYNC;
    if (thread == 0) {
        square = 0.0f;
        decrement = 0.0f;
        for (int t = 0; t < threads; ++t) {
            square += sums[t];
            decrement += sums[threads + t];
        }
        search_dot.data[world] = square;
        newton_decrement.data[world] = decrement;
    }
"""


@wp.func_native(_SNIPPET)
def _factor_and_solve(
    world: int,
    thread: int,
    threads: int,
    n: int,
    h: wp.array3d(dtype=float),
    grad: wp.array2d(dtype=float),
    top: wp.array2d(dtype=int),
    u: wp.array3d(dtype=float),
    search: wp.array2d(dtype=float),
    search_dot: wp.array(dtype=float),
    newton_decrement: wp.array(dtype=float),
): ...


@wp.kernel(enable_backward=False)
def _empty_envelope(n: int, top: wp.array2d(dtype=int)):
    """Each column reaches up to the first row of its own body: MuJoCo's inertia is block-diagonal."""
    world, panel = wp.tid()
    column = wp.min(panel * 16, n - 1)
    top[world, panel] = ((column // 6) * 6) // 16


@wp.kernel(enable_backward=False)
def _widen_envelope(
    nacon: wp.array(dtype=int),
    geom: wp.array(dtype=wp.vec2i),
    worldid: wp.array(dtype=int),
    geom_bodyid: wp.array(dtype=int),
    body_dofadr: wp.array(dtype=int),
    body_dofnum: wp.array(dtype=int),
    top: wp.array2d(dtype=int),
):
    """A contact couples its two bodies: the later one's columns reach up to the earlier one's rows."""
    contact = wp.tid()
    if contact >= nacon[0]:
        return
    pair = geom[contact]
    one = geom_bodyid[pair[0]]
    other = geom_bodyid[pair[1]]
    if body_dofnum[one] == 0 or body_dofnum[other] == 0:
        return
    upper = wp.min(body_dofadr[one], body_dofadr[other])
    lower = wp.max(body_dofadr[one], body_dofadr[other])
    world = worldid[contact]
    wp.atomic_min(top, world, lower // 16, upper // 16)
    wp.atomic_min(top, world, (lower + 5) // 16, upper // 16)


@wp.kernel(enable_backward=False, launch_bounds=(CUDA_THREADS, BLOCKS_PER_PROCESSOR))
def _direction(
    n: int,
    threads: int,
    first_of_step: int,
    tolerance: wp.array(dtype=float),
    inertia_scale: wp.array(dtype=float),
    improvement: wp.array(dtype=float),
    alpha: wp.array(dtype=float),
    grad_dot: wp.array(dtype=float),
    done: wp.array(dtype=bool),
    state_changes: wp.array(dtype=int),
    h: wp.array3d(dtype=float),
    grad: wp.array2d(dtype=float),
    top: wp.array2d(dtype=int),
    u: wp.array3d(dtype=float),
    search: wp.array2d(dtype=float),
    search_dot: wp.array(dtype=float),
    newton_decrement: wp.array(dtype=float),
):
    world, thread = wp.tid()
    if done[world]:
        return
    if first_of_step == 0:
        # The solver's own stopping rule (mujoco_warp, _solve_done), before the direction that it would not use.
        limit = tolerance[world % tolerance.shape[0]]
        scale = inertia_scale[world]
        gain = scale * improvement[world]
        if alpha[world] == 0.0 or (gain > 0.0 and gain < limit) or scale * wp.sqrt(grad_dot[world]) < limit:
            return
        # Pyramidal cones: where no constraint changed its state the search goes on along the same ray.
        if state_changes.shape[0] > 0 and state_changes[world] == 0:
            return
    _factor_and_solve(world, thread, threads, n, h, grad, top, u, search, search_dot, newton_decrement)


def factorize_solve(m: Any, d: Any, ctx: Any, *, skip_unchanged: bool) -> None:
    """Newton's direction of every world that still needs one, into the solver's context.

    ``skip_unchanged``: leave worlds alone in which no constraint changed its state (incremental updates).
    """
    first_of_step = not hasattr(ctx, "envelope")
    if first_of_step:
        # Once a step, outside the captured loop of iterations: buffers can't be allocated inside it.
        panels = -(-m.nv // PANEL)
        ctx.envelope = wp.empty((d.nworld, panels), dtype=int)
        ctx.unused = wp.empty((0,), dtype=int)
        wp.launch(_empty_envelope, dim=(d.nworld, panels), inputs=[m.nv], outputs=[ctx.envelope])
        wp.launch(
            _widen_envelope,
            dim=d.naconmax,
            inputs=[d.nacon, d.contact.geom, d.contact.worldid, m.geom_bodyid, m.body_dofadr, m.body_dofnum],
            outputs=[ctx.envelope],
        )
    # On a CPU Warp runs a block's threads one after the other, which a barrier does not survive.
    threads = CUDA_THREADS if wp.get_device().is_cuda else 1
    wp.launch(
        _direction,
        dim=(d.nworld, threads),
        inputs=[
            m.nv,
            threads,
            int(first_of_step),
            m.opt.tolerance,
            ctx.inertia_scale,
            ctx.improvement,
            ctx.alpha,
            ctx.grad_dot,
            ctx.done,
            ctx.state_changed_count if skip_unchanged else ctx.unused,
            ctx.h,
            ctx.grad,
            ctx.envelope,
        ],
        outputs=[ctx.hfactor, ctx.search, ctx.search_dot, ctx.newton_decrement],
        block_dim=threads,
    )


def install() -> bool:
    """Put the solve into mujoco_warp's Newton solver. Returns whether this version of it is one it fits."""
    if not importlib.metadata.version("mujoco-mjx").startswith(SUPPORTED):
        return False
    solver: Any = importlib.import_module("mujoco.mjx.third_party.mujoco_warp._src.solver")
    if getattr(solver, "_petmjx_stock", None) is not None:
        return True
    stock = solver._cholesky_factorize_solve

    def solve(m: Any, d: Any, ctx: Any, skip_unchanged: bool = False, skip_noflip: bool = False) -> None:
        compact = getattr(ctx, "compact_m_full", None) is not None
        if compact or not MIN_DOFS <= m.nv <= MAX_DOFS:
            stock(m, d, ctx, skip_unchanged, skip_noflip)
        else:
            factorize_solve(m, d, ctx, skip_unchanged=skip_noflip)

    solver._petmjx_stock = stock
    solver._cholesky_factorize_solve = solve
    return True
