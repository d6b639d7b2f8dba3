"""The constraint solver of mjx-jax: MuJoCo's Newton method for elliptic cones, with matrices in blocks.

MuJoCo finds the accelerations a (qacc) that minimise ½ (a − a₀)ᵀ M (a − a₀) + s(J·a − r). Here a₀ (qacc_smooth) are the
accelerations without contacts, r (aref) the reference accelerations of the contacts, and s the cost of their cones
(MuJoCo's documentation, "Computation", section "Constraint model"). Newton's direction solves H·x = −gradient with
H = M + Jᵀ·s″·J; a line search follows.

``mjx.solve`` (MuJoCo 3.17) does the same, but treats s″ and J as dense matrices. An iteration takes (3·contacts)² ·
velocities multiplications, and the program has an instruction per contact that fills in s″. Under ``vmap``, the line
search of ``mjx.solve`` always takes its largest number of iterations. But s″ consists of blocks of 3 × 3, and a contact
touches two bodies. So in this module, all products run over pairs of geoms, which have four contacts each. The line
search ends as soon as the slope is small enough.

Under ``vmap``, a loop lasts until it has ended in all worlds. Worlds at rest need one iteration and one evaluation of
the line search. Worlds that collapse need ten times as many iterations and evaluations. So in a batch, each call of the
solver makes only a few iterations, and a line search evaluates many steps at once (``BlockSolver.improved``).
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import NDArray

from petmjx.engines.mjx.body_dynamics import TINY, ContactRows, Links, Rows, Velocities

ENOUGH_SLOPE: Final = 0.1
"""The line search ends where the cost's derivative is at most this share of its initial value, as on mjx-warp
(petmjx/engines/warp/solver/newton.cu)."""

ROUNDING: Final = 8 * float(np.finfo(np.float32).eps)
"""A derivative counts as zero if it is at most this share of the sum of its terms' magnitudes."""

Scalar = Float[Array, ""]


class Problem(NamedTuple):
    """What the solver needs to know about one world. The rows of a contact are its normal and its two tangents.

    Attributes:
        mass: the diagonal of the mass matrix.
        smooth: accelerations without contacts.
        jacobian: derivatives of the rows of each pair of geoms by the velocities of its two bodies.
        stiffness: inverse regularisation of each row (MuJoCo's efc_D).
        sliding: coefficients of sliding friction.
        mu: coefficient of the regularised cone.
        least: smallest change of the cost, and smallest gradient, for which another iteration is worth while.
        iterations: largest number of iterations.
        evaluations: largest number of evaluations in a line search.
    """

    mass: Velocities
    smooth: Velocities
    jacobian: Float[Array, "pair constraint 12"]
    stiffness: Rows
    sliding: Float[Array, "contact 2"]
    mu: Float[Array, " contact"]
    least: Scalar
    iterations: Int[Array, ""]
    evaluations: Int[Array, ""]

    @classmethod
    def of(cls, model: Any, mass: Velocities, smooth: Velocities, rows: ContactRows) -> Problem:
        """The problem of a world with these contacts, and with the options of its MJX model."""
        return cls(
            mass=mass,
            smooth=smooth,
            jacobian=rows.jacobian,
            stiffness=rows.stiffness,
            sliding=rows.sliding,
            mu=rows.sliding[:, 0] / jnp.sqrt(model.opt.impratio),
            least=model.opt.tolerance * mass.sum(),
            iterations=model.opt.iterations,
            evaluations=model.opt.ls_iterations,
        )


class Cones(NamedTuple):
    """The cones of a world's contacts for some residuals J·a − r, m/s².

    Attributes:
        sticks: whether the force is within the cone, so that the contact is a spring with three components.
        slides: whether the force is on the cone's surface. Contacts that neither stick nor slide have no force.
        slip: derivative of ``speed`` by the two tangential residuals: friction × t / ``speed``, where t is the vector
            (friction × tangential residual).
        speed: length of the vector t.
        gap: mu times the normal residual minus mu times ``speed``; negative for contacts that slide.
        surface: stiffness of the cone's surface: the cost of sliding is ½ · surface · gap².
    """

    residual: Rows
    sticks: Bool[Array, " contact"]
    slides: Bool[Array, " contact"]
    slip: Float[Array, "contact 2"]
    speed: Float[Array, " contact"]
    gap: Float[Array, " contact"]
    surface: Float[Array, " contact"]

    @classmethod
    def of(cls, problem: Problem, residual: Rows) -> Cones:
        """The cones for these residuals."""
        mu = problem.mu
        normal, tangent = mu * residual[:, 0], problem.sliding * residual[:, 1:]
        speed = jnp.sqrt((tangent**2).sum(-1))
        sticks = (normal < 0) & (mu * normal + speed <= 0)
        return cls(
            residual=residual,
            sticks=sticks,
            slides=~sticks & (normal < mu * speed),
            slip=problem.sliding * tangent / jnp.maximum(speed, TINY)[:, None],
            speed=speed,
            gap=normal - mu * speed,
            surface=problem.stiffness[:, 0] / jnp.maximum(mu**2 * (1 + mu**2), TINY),
        )

    def cost(self, problem: Problem) -> Scalar:
        """The cost s of all contacts."""
        spring = (problem.stiffness * self.residual**2).sum(-1)
        return 0.5 * jnp.where(self.sticks, spring, jnp.where(self.slides, self.surface * self.gap**2, 0.0)).sum()

    def force(self, problem: Problem) -> Rows:
        """The contact forces −s′, N."""
        along = jnp.concatenate([jnp.ones_like(self.speed)[:, None], -self.slip], axis=1)
        sliding = -(self.surface * self.gap * problem.mu)[:, None] * along
        sticking = -problem.stiffness * self.residual
        return jnp.where(self.sticks[:, None], sticking, jnp.where(self.slides[:, None], sliding, 0.0))

    def curvature(self, problem: Problem) -> Float[Array, "contact 3 3"]:
        """The second derivatives s″ of the cost with respect to the three rows of each contact."""
        mu = problem.mu[:, None, None]
        along = jnp.concatenate([jnp.ones_like(self.speed)[:, None], -self.slip], axis=1)
        # second derivative of ``speed``
        turn = jnp.eye(2)[None] * (problem.sliding**2)[:, None] - self.slip[:, :, None] * self.slip[:, None]
        bent = -(self.gap / jnp.maximum(self.speed, TINY))[:, None, None] * turn
        sliding = mu**2 * along[:, :, None] * along[:, None] + mu * jnp.pad(bent, ((0, 0), (1, 0), (1, 0)))
        sliding = self.surface[:, None, None] * sliding
        sticking = jnp.eye(3)[None] * problem.stiffness[:, None]
        return jnp.where(self.sticks[:, None, None], sticking, jnp.where(self.slides[:, None, None], sliding, 0.0))

    def bend(self, problem: Problem, way: Rows) -> Scalar:
        """The second derivative of the cost, wᵀ·s″·w, along a change w of the residuals."""
        tangent = problem.sliding * way[:, 1:]
        closing = way[:, 0] - (self.slip * way[:, 1:]).sum(-1)
        across = (tangent**2).sum(-1) - (self.slip * way[:, 1:]).sum(-1) ** 2
        bent = -problem.mu * self.gap / jnp.maximum(self.speed, TINY) * across
        sliding = self.surface * ((problem.mu * closing) ** 2 + bent)
        spring = (problem.stiffness * way**2).sum(-1)
        return jnp.where(self.sticks, spring, jnp.where(self.slides, sliding, 0.0)).sum()


class Iterate(NamedTuple):
    """State of the solver: accelerations, M·(a − a₀), residuals, forces, gradient, cost now and before the last
    iteration, and number of iterations."""

    qacc: Velocities
    inertial: Velocities
    residual: Rows
    force: Rows
    gradient: Velocities
    cost: Scalar
    cost_before: Scalar
    iterations: Int[Array, ""]

    @classmethod
    def unvalued(cls, qacc: Velocities, residual: Rows) -> Iterate:
        """An iterate of which only the accelerations and the residuals are known."""
        unknown = jnp.float32(jnp.inf)
        return cls(qacc, qacc, residual, residual, qacc, unknown, unknown, jnp.int32(0))


class _Search(NamedTuple):
    """State of a line search: the next steps, the best step so far with its cost, the bracket of the minimum, and
    whether the search has ended."""

    steps: Float[Array, " step"]
    best: Scalar
    cost: Scalar
    low: Scalar
    high: Scalar
    evaluations: Int[Array, ""]
    ends: Bool[Array, ""]


class BlockSolver:
    """Finds the accelerations and contact forces of one world; for use under ``jax.vmap``.

    Args:
        links: the bodies of all contacts.
    """

    def __init__(self, links: Links) -> None:
        self.links = links
        self._sums = np.float32(links.sides.T.reshape(-1)[None] == np.arange(links.bodies)[:, None])
        """(body, side · pair) 1 if the body is this side of the pair, else 0; a product with this matrix sums over the
        pairs of each body"""
        self._couplings, self._layout = _couplings(links.sides, links.bodies)

    def begin(self, problem: Problem, pull: Rows, start: Velocities) -> Iterate:
        """The state before the first iteration.

        Args:
            pull: reference accelerations of the rows, m/s².
            start: accelerations to start from. The solver starts from ``problem.smooth`` instead if the cost is lower
                there.
        """
        begin, smooth = (self._at(problem, pull, qacc) for qacc in (start, problem.smooth))
        iterate: Iterate = jax.tree.map(lambda a, b: jnp.where(begin.cost < smooth.cost, a, b), begin, smooth)
        return iterate

    def ends(self, problem: Problem, now: Iterate) -> Bool[Array, ""]:
        """Whether no iteration follows. Like MuJoCo's solver, this solver ends if the gradient, or the change of the
        cost, is below ``problem.least``, or after ``problem.iterations`` iterations."""
        steep = jnp.sqrt(now.gradient @ now.gradient) >= problem.least
        better = now.cost_before - now.cost >= problem.least
        return ~((now.iterations < problem.iterations) & better & steep)

    def improved(self, problem: Problem, begin: Iterate, most: int | None = None, steps: int = 1) -> Iterate:
        """The state after further iterations.

        Args:
            most: largest number of iterations; None: all iterations.
            steps: number of steps that a line search evaluates at once. With ``steps`` = 1, the line search ends as
                soon as the slope is small enough. With more steps, all line searches end after two evaluations. On
                problems of worlds that collapse, the solver takes 3 % more iterations with 16 steps than with 1.
        """

        def goes_on(now: Iterate) -> Bool[Array, ""]:
            stops = False if most is None else now.iterations >= begin.iterations + most
            return ~(self.ends(problem, now) | stops)

        def improve(now: Iterate) -> Iterate:
            curvature = Cones.of(problem, now.residual).curvature(problem)
            hessian = cho_factor(self._hessian(problem, curvature), lower=True)
            direction = -cho_solve(hessian, now.gradient)
            # between stiff contacts, the Hessian may have no Cholesky factor in float32; then the iterations end
            return self._moved(problem, now, jnp.where(jnp.isfinite(direction).all(), direction, 0.0), steps)

        return jax.lax.while_loop(goes_on, improve, begin)

    def _at(self, problem: Problem, pull: Rows, qacc: Velocities) -> Iterate:
        state = Iterate.unvalued(qacc, self.links.along(problem.jacobian, qacc) - pull)
        return self._valued(problem, state._replace(inertial=problem.mass * (qacc - problem.smooth)))

    def _valued(self, problem: Problem, now: Iterate) -> Iterate:
        """The state with the same accelerations, and with the forces, gradient and cost that follow from these
        accelerations."""
        cones = Cones.of(problem, now.residual)
        force = cones.force(problem)
        push = jnp.einsum("prv,pr->pv", problem.jacobian, force.reshape(len(self.links.sides), -1))
        push = jnp.einsum("bs,sv->bv", self._sums, push.reshape(-1, 2, 6).swapaxes(0, 1).reshape(-1, 6))
        cost = cones.cost(problem) + 0.5 * now.inertial @ (now.qacc - problem.smooth)
        return now._replace(force=force, gradient=now.inertial - push.reshape(-1), cost=cost, cost_before=now.cost)

    def _moved(self, problem: Problem, now: Iterate, direction: Velocities, at_once: int) -> Iterate:
        """The next accelerations, from a line search along ``direction`` that evaluates ``at_once`` steps at once."""
        inertial, way = problem.mass * direction, self.links.along(problem.jacobian, direction)
        first = now.gradient @ direction
        square = inertial @ direction
        linear = now.inertial @ direction
        number = np.arange(at_once)

        def at(step: Scalar) -> tuple[Scalar, Scalar, Scalar, Bool[Array, ""]]:
            """For a step: the cost, except for a constant; the slope; Newton's next step; and whether the slope is only
            a rounding error."""
            cones = Cones.of(problem, now.residual + step * way)
            work = cones.force(problem) * way
            slope = linear + step * square - work.sum()
            cost = cones.cost(problem) + step * (linear + 0.5 * step * square)
            flat = jnp.abs(slope) <= ROUNDING * (jnp.abs(linear) + step * square + jnp.abs(work).sum())
            return cost, slope, step - slope / (square + cones.bend(problem, way)), flat

        def evaluated(before: _Search) -> _Search:
            """The state of the line search after an evaluation of its steps. The next steps divide the bracket evenly.
            Newton's steps from the two ends of the bracket replace the first and the last of these steps, if they lie
            within the bracket.
            """
            steps = before.steps
            cost, slope, newton, flat = jax.vmap(at)(steps)
            better = cost < before.cost
            gentle = jnp.abs(slope) <= -ENOUGH_SLOPE * first
            # where the slope is still negative, the cost has decreased, even if rounding hides the decrease
            ends = flat | (gentle & (better | (slope <= 0)))
            best = jnp.where(ends.any(), ends.argmax(), jnp.where(better, cost, jnp.inf).argmin())
            low = jnp.maximum(before.low, jnp.where(slope < 0, steps, 0.0).max())
            high = jnp.minimum(before.high, jnp.where(slope < 0, jnp.inf, steps).min())
            end = jnp.where(jnp.isinf(high), 4 * low, high)
            further = low + (end - low) * (number + 1) / (at_once + 1)
            from_low = jnp.where(steps == low, newton, low).max()
            from_high = jnp.where(steps == high, newton, high).min()
            further = jnp.where((number == 0) & (low < from_low) & (from_low < high), from_low, further)
            further = jnp.where((number == at_once - 1) & (low < from_high) & (from_high < high), from_high, further)
            return _Search(
                steps=further,
                best=jnp.where(better.any() | ends.any(), steps[best], before.best),
                cost=jnp.where(better.any(), jnp.where(better, cost, jnp.inf).min(), before.cost),
                low=low,
                high=high,
                evaluations=before.evaluations + 1,
                ends=ends.any(),
            )

        def goes_on(search: _Search) -> Bool[Array, ""]:
            return ~search.ends & (search.evaluations < problem.evaluations)

        none, steps = jnp.float32(0.0), jnp.asarray(3.0**-number, jnp.float32)
        cost = Cones.of(problem, now.residual).cost(problem)
        search = _Search(steps, none, cost, none, jnp.float32(jnp.inf), jnp.int32(0), jnp.bool_(False))
        if at_once == 1:
            step = jax.lax.while_loop(goes_on, evaluated, search).best
        else:
            search = evaluated(search)
            step = jnp.where(search.ends, search.best, evaluated(search).best)
        moved = now._replace(
            qacc=now.qacc + step * direction,
            inertial=now.inertial + step * inertial,
            residual=now.residual + step * way,
            iterations=now.iterations + 1,
        )
        return self._valued(problem, moved)

    def _hessian(self, problem: Problem, curvature: Float[Array, "contact 3 3"]) -> Float[Array, "velocity velocity"]:
        """M + Jᵀ·s″·J."""
        pairs, n = len(self.links.sides), self.links.bodies
        rows = problem.jacobian.reshape(-1, 3, 12)
        bent = jnp.einsum("crs,csv->crv", curvature, rows).reshape(problem.jacobian.shape)
        blocks = jnp.einsum("prv,prw->pvw", problem.jacobian, bent).reshape(pairs, 2, 6, 2, 6)
        of_sides = jnp.stack([blocks[:, 0, :, 0], blocks[:, 1, :, 1]]).reshape(-1, 36)
        diagonal = jnp.einsum("bs,sv->bv", self._sums, of_sides)
        coupling = jnp.pad(blocks[:, 0, :, 1], ((0, 1), (0, 0), (0, 0)))[self._couplings].sum(1)
        parts = [diagonal.reshape(n, 6, 6), coupling, coupling.swapaxes(1, 2), jnp.zeros((1, 6, 6))]
        full = jnp.concatenate(parts)[self._layout].swapaxes(1, 2).reshape(6 * n, 6 * n)
        return jnp.diag(problem.mass) + full


def _couplings(sides: NDArray[np.integer], bodies: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Two tables from which the Hessian is put together, block by block.

    Returns:
        (coupling, k): one row for each two moving bodies that may touch (a coupling), with the numbers of their pairs
            of geoms. Rows are padded with a number beyond the last pair.
        (body, body): for two bodies, the index of their block of the Hessian in a list of blocks. The list consists of
            the own blocks of all bodies, all couplings, all couplings transposed, and a block of zeros.
    """
    pairs_by_bodies: dict[tuple[int, int], list[int]] = {}
    for pair, (one, two) in enumerate(sides.tolist()):
        if one < bodies and two < bodies:
            assert one < two
            pairs_by_bodies.setdefault((one, two), []).append(pair)
    count = len(pairs_by_bodies)
    table = np.full((count, max(map(len, pairs_by_bodies.values()), default=1)), len(sides))
    layout = np.full((bodies, bodies), bodies + 2 * count)
    np.fill_diagonal(layout, np.arange(bodies))
    for row, ((one, two), some) in enumerate(pairs_by_bodies.items()):
        table[row, : len(some)] = some
        layout[one, two], layout[two, one] = bodies + row, bodies + count + row
    return table, layout
