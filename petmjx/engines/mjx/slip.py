"""The law of sliding contacts, applied between MJX's collision and the solver (petmjx/world/contact_laws.py)."""

from __future__ import annotations

from functools import partial
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from petmjx.engines.mjx.body_dynamics import ContactRows, Rows, Velocities
from petmjx.engines.mjx.newton import BlockSolver, Iterate, Problem
from petmjx.engines.mjx.world_state import put_rows, select_rows, take_rows
from petmjx.options.physics import Physics
from petmjx.world.contact_laws import ENOUGH_M_S2, MOST_ROUNDS, RELAXATION, STICKS_M_S, kinetic_share, slack_m_s2

FEW_SHARE: Final = 4
FEW_ITERATIONS: Final = 8
"""In each pass of a batch, the solver first makes one iteration in all worlds. For worlds at rest, one iteration is
enough. Then the solver makes up to ``FEW_ITERATIONS`` further iterations, in at most one of every ``FEW_SHARE`` worlds.
The reason: boxes land or fall in only a few worlds of a batch, and a step of a world that collapses takes 12 iterations
on average."""

STEPS: Final = 16
"""In a batch: number of steps that a line search evaluates at once. With 4 steps, some line searches find no step that
is small enough, and the solver ends too early."""


class Solution(NamedTuple):
    """The solutions of a step, finished or not. A solution is found in rounds. In each round, the solver finds the
    accelerations for fixed slip excesses of the contacts; then the slip excesses are computed again.

    Attributes:
        now: state of the solver in the present round.
        excess: slip excess of each contact in the present round (petmjx/world/contact_laws.py), m/s².
        rounds: number of completed rounds.
        iterations: number of the solver's iterations in the completed rounds.
        in_round: whether the present round has begun.
        done: whether the solution is finished.
    """

    now: Iterate
    excess: Float[Array, "world contact"]
    rounds: Int[Array, " world"]
    iterations: Int[Array, " world"]
    in_round: Bool[Array, " world"]
    done: Bool[Array, " world"]

    @classmethod
    def finished(cls, qacc: Float[Array, "world velocity"], rows: Float[Array, "world contact 3"]) -> Solution:
        """Solutions that are marked as finished. Their values have no meaning."""
        none, no = jnp.zeros(len(qacc), jnp.int32), jnp.zeros(len(qacc), bool)
        return cls(jax.vmap(Iterate.unvalued)(qacc, rows), rows[..., 0], none, none, no, ~no)


class SlipLaw:
    """The law of sliding contacts, for elliptic cones. The law does not change contacts that are open (do not touch):
    their constraint rows stay zeros."""

    def __init__(self, physics: Physics, solver: BlockSolver) -> None:
        self._slack = slack_m_s2(physics)
        self._kinetic = kinetic_share(physics)
        self._solver = solver

    def begin(
        self,
        problem: Problem,
        pull: Float[Array, "world contact 3"],
        start: Float[Array, "world velocity"],
        before: Solution | None = None,
    ) -> Solution:
        """The solutions with which a step or a pass begins. A world whose solution ``before`` is not finished keeps
        this solution. All other worlds get a new solution, before its first round.

        Args:
            problem, pull, start: see ``BlockSolver.begin``, for each world.
        """
        excess = jax.vmap(self._first_excess)(problem, pull, start)
        begin = Solution.finished(start, pull)._replace(excess=excess, done=jnp.zeros(len(start), bool))
        return begin if before is None else select_rows(before.done, begin, before)

    def solve(self, problem: Problem, pull: Float[Array, "world contact 3"], solution: Solution) -> Solution:
        """The solutions, continued until all of them are finished."""
        further = partial(self._further, problem, pull)
        finished: Solution = jax.lax.while_loop(lambda solution: ~solution.done.all(), further, solution)
        return finished

    def solve_in_part(self, problem: Problem, pull: Float[Array, "world contact 3"], solution: Solution) -> Solution:
        """The solutions after one pass of a batch. Some of them may not be finished."""
        solution = self._further(problem, pull, solution, most=1, steps=STEPS)
        waits = jnp.where(solution.done, -1, solution.iterations + solution.now.iterations)
        rows = jnp.argsort(waits, descending=True)[: max(len(waits) // FEW_SHARE, 1)]
        few = take_rows((problem, pull, solution), rows)
        return put_rows(solution, rows, self._further(*few, most=FEW_ITERATIONS, steps=STEPS))

    def _further(
        self, problem: Problem, pull: Float[Array, "world contact 3"], solution: Solution, **limits: int
    ) -> Solution:
        """Solutions after a round, or after the part of a round that these limits allow (``BlockSolver.improved``). A
        finished solution stays the same, so that it does not depend on the other worlds."""

        def of_world(problem: Problem, pull: Rows, solution: Solution) -> Solution:
            return self._of_world(problem, pull, solution, **limits)

        further: Solution = jax.vmap(of_world)(problem, pull, solution)
        return further

    def with_friction(self, rows: ContactRows, velocity: Velocities) -> ContactRows:
        """The constraint rows of one world, in which the friction of sliding contacts is reduced."""
        if self._kinetic == 1:
            return rows
        slip = _tangent(self._solver.links.along(rows.jacobian, velocity))
        share = 1.0 - (1.0 - self._kinetic) * jnp.clip(slip / STICKS_M_S - 1.0, 0.0, 1.0)
        return rows._replace(sliding=rows.sliding * share[:, None])

    def _of_world(self, problem: Problem, pull: Rows, solution: Solution, **limits: int) -> Solution:
        friction, excess = problem.sliding[:, 0], solution.excess
        begin = self._solver.begin(problem, pull.at[:, 0].add(-friction * excess), solution.now.qacc)
        stays = solution.in_round | solution.done
        now = jax.tree.map(lambda kept, new: jnp.where(stays, kept, new), solution.now, begin)
        now = self._solver.improved(problem, now, **limits)
        completes = self._solver.ends(problem, now) & ~solution.done
        rounds = solution.rounds + completes
        slides = _tangent(pull) > self._slack
        resisted = _tangent(now.residual) - _tangent(now.force / problem.stiffness)
        change = jnp.where(slides, jnp.maximum(resisted - self._slack, 0.0) - excess, 0.0)
        matters = completes & ((friction * jnp.abs(change)).max() > ENOUGH_M_S2)
        return Solution(
            now=now,
            excess=jnp.where(matters, excess + RELAXATION * change, excess),
            rounds=rounds,
            iterations=solution.iterations + now.iterations * completes,
            in_round=~completes,
            done=solution.done | (completes & ~(matters & (rounds <= MOST_ROUNDS))),
        )

    def _first_excess(self, problem: Problem, pull: Rows, start: Velocities) -> Float[Array, " contact"]:
        """The slip excess of each contact of one world in the first round (petmjx/world/contact_laws.py), m/s²."""
        most = _tangent(pull) - self._slack
        beyond = _tangent(self._solver.links.along(problem.jacobian, start) - pull) - self._slack
        return jnp.clip(beyond, 0.0, jnp.maximum(most, 0.0))


def _tangent(rows: Rows) -> Float[Array, " contact"]:
    """Length of the tangential part of a vector (such as the contact force) at each contact. ``rows`` has the
    components of the vector: along the normal, then along two tangents."""
    return jnp.hypot(rows[:, 1], rows[:, 2])
