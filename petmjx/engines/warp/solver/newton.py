"""The constraint solver of mjx-warp: MuJoCo's Newton method on a pallet's contacts, by one thread block.

MuJoCo finds the accelerations a (qacc) that minimise ½ (a − a₀)ᵀ M (a − a₀) + s(J·a − r). Here a₀ (qacc_smooth) are the
accelerations without contacts, r (aref) the reference accelerations of the contacts, and s the cost of their cones
(MuJoCo's documentation, "Computation", section "Constraint model"). Newton's direction (search) solves H·x = gradient
with H = M + Jᵀ·s″·J; a line search follows.

Five things make this solver fast:

- The solver starts from extrapolated accelerations: on the line through the accelerations of the last two steps. While
  boxes come to rest, accelerations change smoothly, so the error of the start comes only from the curvature of this
  change.
- A contact touches two bodies. So J is stored as 27 numbers per contact, and a product with J is cheap.
- H is sparse, and bodies are ordered by their contacts (kernels/elimination_order.py), so that H has a narrow envelope.
  Each column of H belongs to a body. Among this body and the bodies that it touches, the one that comes first in the
  order is called the first body. Above the rows of the first body, the column is zero in H and in the Cholesky factor.
  The factorisation computes only the other rows, in tiles of 16 × 16; each warp has a tile, and tensor cores multiply
  tiles.
- Each world stops as early as it can. Since H ≥ M, the cost can decrease by at most ½ gᵀM⁻¹g, where g is the gradient.
  This bound shows before each factorisation whether another iteration can help.
- The direction of friction in sliding contacts is an unknown of its own. Let j be the part of J·a − r along the
  tangents of a contact, p the normal force, and μ the coefficient of friction. While the contact slides, its cost is
  nearly μ·p·|j|. Within a tiny change of j, the curvature of this cost, μ·p/|j|·(I − j·jᵀ/|j|²), leaps from zero (along
  j) to the curvature of sticking. Line searches end at such kinks. So the plain Newton method, which MuJoCo uses, takes
  30 iterations or more while a pallet slides. Here, j/|j| in the curvature is replaced by a vector w, |w| ≤ 1, which is
  updated with the linearised equation |j|·w = j (Chan, Golub and Mulet, "A nonlinear primal-dual method for total
  variation-based image restoration", SIAM J. Sci. Comput. 20, 1999; Andersen and others, "An efficient primal-dual
  interior-point method for minimizing a sum of Euclidean norms", SIAM J. Sci. Comput. 22, 2000). The vector w does not
  change the minimum, and the cost still decreases along each of the solver's directions. With the vector w, a step of a
  sliding pallet takes little more than half as many iterations, and its line searches together take a quarter as many
  evaluations (benchmarks/notebook/performance.md, "Sliding contacts").

Accelerations, residuals, forces and gradients are double precision; H and its factor are single precision. Rounding in
the factor slows the convergence a little; rounding in the gradient would stop the convergence. Every sum has a fixed
order, so a world has the same result in every run, whatever other thread blocks there are.

The method itself is written in CUDA C++: petmjx/engines/warp/solver/newton.cu and the files that it includes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib import resources

from petmjx.engines.warp.world_arrays import PANEL
from petmjx.world.contact_laws import ENOUGH_M_S2, RELAXATION

PANELS_MACRO = "PETMJX_MOST_PANELS"
"""C++ macro for the number of panels (groups of ``PANEL`` rows) of a kernel's largest system. The kernel's shared
memory has room for this system.
"""

FEW_PANELS = 40
"""A kernel whose largest system has at most this many panels factors one panel at a time (cholesky_small.cuh); all
other kernels factor two panels at a time (cholesky_large.cuh)."""

SLIP_ROUNDS = 12
"""Number of iterations, not counting the first iteration, that may change the slip excess of contacts
(petmjx/world/contact_laws.py). The other engines change slip excesses between two calls of their solver. With 12
rounds, steps of bricks that slide and tip take 6.6 iterations (7.4 without slip excesses), and steps of a heap take
24.9 (21.8 without slip excesses). With 40 rounds, steps of a heap take 40 iterations."""

SLIP_MACROS = {
    "PETMJX_SLIP_ROUNDS": SLIP_ROUNDS,
    "PETMJX_SLIP_RELAXATION": RELAXATION,
    "PETMJX_SLIP_ENOUGH": ENOUGH_M_S2,
}
"""C++ macros for the constants of sliding contacts."""

_INCLUDE = re.compile(r'#include "([\w.]+)"')


DRIVER_BYTES = 1 << 10
"""Shared memory that the driver reserves in each block, bytes (CUDA C++ Programming Guide, "Compute capability 9.0").
"""


def own_bytes(panels: int, worlds: int = 1) -> int:
    """Shared memory, in bytes, that the threads of one world need in addition to the strip (rows of the factor) and the
    Hessian. The memory is for systems of up to ``panels`` panels, in blocks of ``worlds`` worlds. newton.cu checks that
    this memory is enough."""
    parts = 4 if worlds > 1 else 8 if panels <= FEW_PANELS else 17
    return 4 * (PANEL + 4) * panels + (parts << 10)


def text_for(panels: int, worlds: int = 1, threads: int = 32, pause_after: int = 0) -> str:
    """The solver's C++ for systems of up to ``panels`` panels.

    Args:
        worlds: number of worlds of a block; if there are several, each has a warp.
        threads: number of threads of a world.
        pause_after: number of iterations after which the solver pauses. With 0, the solver never pauses.
    """
    numbers: dict[str, float] = {
        PANELS_MACRO: panels,
        "PETMJX_FEW_PANELS": FEW_PANELS,
        "PETMJX_OWN_BYTES": own_bytes(panels, worlds),
        "PETMJX_WORLDS": worlds,
        "PETMJX_THREADS": threads,
        "PETMJX_PAUSE_AFTER": pause_after,
        **SLIP_MACROS,
    }
    return defines(numbers) + source("newton.cu")


def defines(numbers: Mapping[str, float]) -> str:
    """C++ definitions of named numbers."""
    return "".join(f"#define {name} {number}\n" for name, number in numbers.items())


def source(name: str, included: set[str] | None = None) -> str:
    """A C++ file of this package as one text, with the files that it includes.

    Warp compiles a text, and compiles again when the text has changed. Warp would not notice a change in an included
    file. ``#line`` directives let compiler errors name the right file and line.

    Args:
        included: files that the text already contains, which are not included again. This call adds the files that it
            includes.
    """
    included = included if included is not None else set()
    included.add(name)
    lines = [f'#line 1 "{name}"']
    text = resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
    for number, line in enumerate(text.splitlines(), 1):
        if match := _INCLUDE.fullmatch(line):
            if match[1] not in included:
                lines.append(source(match[1], included))
            lines.append(f'#line {number + 1} "{name}"')
        else:
            lines.append(line)
    return "\n".join(lines) + "\n"
