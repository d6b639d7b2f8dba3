"""The law of sliding contacts, applied between MJX's collision and the solver (petmjx/world/contact_laws.py)."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from petmjx.engines.mjx.body_dynamics import ContactRows, Rows, Velocities
from petmjx.engines.mjx.newton import BlockSolver, Problem
from petmjx.options.physics import Physics
from petmjx.world.contact_laws import ENOUGH_M_S2, MOST_ROUNDS, RELAXATION, STICKS_M_S, kinetic_share, slack_m_s2


class SlipLaw:
    """The law of sliding contacts, for elliptic cones. The law does not change contacts that are open (do not touch):
    their constraint rows stay zeros."""

    def __init__(self, physics: Physics, solver: BlockSolver) -> None:
        self._slack = slack_m_s2(physics)
        self._kinetic = kinetic_share(physics)
        self._solver = solver

    def solve(
        self, problem: Problem, pull: Float[Array, "world contact 3"], start: Float[Array, "world velocity"]
    ) -> tuple[Float[Array, "world velocity"], Float[Array, "world contact 3"], Int[Array, " world"]]:
        """The accelerations, the contact forces (N), and the number of the solver's iterations. All worlds are solved
        again as long as contacts in any world need another round. A world that needs no further round keeps its
        solution, so that its solution does not depend on the other worlds.

        Args:
            problem, pull, start: see ``BlockSolver.solve``, for each world.
        """
        excess, slides = jax.vmap(self._begin)(problem, pull, start)

        def goes_on(carry: tuple[Any, ...]) -> Any:
            rounds, needs_round = carry[:2]
            return (rounds == 0) | ((rounds <= MOST_ROUNDS) & needs_round.any())

        def again(carry: tuple[Any, ...]) -> tuple[Any, ...]:
            rounds, needs_round, excess, start, force_before, iterations = carry
            qacc, force, change, matters, more = jax.vmap(self._round)(problem, pull, start, excess, slides)
            matters = matters & needs_round
            qacc = jnp.where(needs_round[:, None], qacc, start)
            force = jnp.where(needs_round[:, None, None], force, force_before)
            excess = jnp.where(matters[:, None], excess + RELAXATION * change, excess)
            return rounds + 1, matters, excess, qacc, force, iterations + needs_round * more

        n, none = len(start), jnp.zeros(len(start), jnp.int32)
        first: tuple[Any, ...] = (jnp.int32(0), jnp.ones(n, bool), excess, start, jnp.zeros_like(pull), none)
        *_, qacc, force, iterations = jax.lax.while_loop(goes_on, again, first)
        return qacc, force, iterations

    def with_friction(self, rows: ContactRows, velocity: Velocities) -> ContactRows:
        """One world's rows, with the friction of sliding contacts reduced."""
        if self._kinetic == 1:
            return rows
        slip = _tangent(self._solver.links.along(rows.jacobian, velocity))
        share = 1.0 - (1.0 - self._kinetic) * jnp.clip(slip / STICKS_M_S - 1.0, 0.0, 1.0)
        return rows._replace(sliding=rows.sliding * share[:, None])

    def _round(
        self,
        problem: Problem,
        pull: Rows,
        start: Velocities,
        excess: Float[Array, " contact"],
        slides: Bool[Array, " contact"],
    ) -> tuple[Velocities, Rows, Float[Array, " contact"], Bool[Array, ""], Int[Array, ""]]:
        """Accelerations and forces of one world for these slip excesses (petmjx/world/contact_laws.py); the resulting
        changes of the slip excesses, m/s²; whether another round is needed; and the number of iterations."""
        friction = problem.sliding[:, 0]
        qacc, force, residual, iterations = self._solver.solve(problem, pull.at[:, 0].add(-friction * excess), start)
        dragged = _tangent(force / problem.stiffness)
        change = jnp.where(slides, jnp.maximum(_tangent(residual) - dragged - self._slack, 0.0) - excess, 0.0)
        return qacc, force, change, (friction * jnp.abs(change)).max() > ENOUGH_M_S2, iterations

    def _begin(
        self, problem: Problem, pull: Rows, start: Velocities
    ) -> tuple[Float[Array, " contact"], Bool[Array, " contact"]]:
        """The initial slip excess of each contact of one world (petmjx/world/contact_laws.py), m/s², and whether the
        contact slides."""
        most = _tangent(pull) - self._slack
        beyond = _tangent(self._solver.links.along(problem.jacobian, start) - pull) - self._slack
        return jnp.clip(beyond, 0.0, jnp.maximum(most, 0.0)), most > 0


def _tangent(rows: Rows) -> Float[Array, " contact"]:
    """Length of the tangential part of a vector at each contact, such as the contact force. ``rows`` has the components
    of the vector: along the normal, then along two tangents."""
    return jnp.hypot(rows[:, 1], rows[:, 2])
