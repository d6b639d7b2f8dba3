"""The law of sliding contacts, applied between MJX's collision and its solver (petmjx/world/contact_laws.py)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy.typing import NDArray

from petmjx.engines.mjx.line_search import solve
from petmjx.options.physics import Physics
from petmjx.world.contact_laws import ENOUGH_M_S2, MOST_ROUNDS, RELAXATION, STICKS_M_S, kinetic_share, slack_m_s2


class SlipLaw:
    """The law of sliding contacts, for elliptic cones. Rows of open contacts are zeros and stay zeros.

    Args:
        model_of: function that returns a world's model, given its fields.
    """

    def __init__(self, physics: Physics, model_of: Callable[[Any], Any]) -> None:
        self._slack = slack_m_s2(physics)
        self._kinetic = kinetic_share(physics)
        self._model_of = model_of

    def solve(self, fields: Any, data: Any) -> Any:
        """The data of all worlds, with the solver's accelerations and forces. All worlds are solved again as long as
        contacts in any world need another round.

        Args:
            fields: fields of the model, for each world.
            data: MJX's data, for each world, ready for the solver.
        """
        data = jax.vmap(self._with_friction)(data)
        excess, slides = jax.vmap(self._begin)(data)

        def goes_on(carry: tuple[Any, ...]) -> Any:
            rounds, needs_round = carry[:2]
            return (rounds == 0) | ((rounds <= MOST_ROUNDS) & needs_round)

        def again(carry: tuple[Any, ...]) -> tuple[Any, ...]:
            rounds, _, excess, start, _, _ = carry
            qacc, force, change, matters = jax.vmap(self._round)(fields, data, start, excess, slides)
            excess = jnp.where(matters[:, None], excess + RELAXATION * change, excess)
            return rounds + 1, matters.any(), excess, qacc, qacc, force

        first: tuple[Any, ...] = (jnp.int32(0), jnp.bool_(False), excess, data.qacc_warmstart)
        *_, qacc, force = jax.lax.while_loop(goes_on, again, (*first, data.qacc, data._impl.efc_force))
        return data.replace(qacc=qacc).tree_replace({"_impl.efc_force": force})

    def _round(
        self,
        fields: Any,
        data: Any,
        start: Float[Array, " velocity"],
        excess: Float[Array, " contact"],
        slides: Bool[Array, " contact"],
    ) -> tuple[Float[Array, " velocity"], Float[Array, " constraint"], Float[Array, " contact"], Bool[Array, ""]]:
        """Accelerations and forces of one world for this excess; the resulting change of the excess, m/s²; and whether
        another round is needed."""
        normal, friction, aref = self._normal(data), data._impl.contact.friction[:, 0], data._impl.efc_aref
        lowered = {"_impl.efc_aref": aref.at[normal].add(-friction * excess)}
        solved = solve(self._model_of(fields), data.replace(qacc_warmstart=start).tree_replace(lowered))
        force = solved._impl.efc_force
        dragged = _tangent(force / data._impl.efc_D, normal)
        beyond = _tangent(data._impl.efc_J @ solved.qacc - aref, normal)
        change = jnp.where(slides, jnp.maximum(beyond - dragged - self._slack, 0.0) - excess, 0.0)
        return solved.qacc, force, change, (friction * jnp.abs(change)).max() > ENOUGH_M_S2

    def _begin(self, data: Any) -> tuple[Float[Array, " contact"], Bool[Array, " contact"]]:
        """The initial excess of one world's contacts, m/s², and whether each of them slides."""
        normal, aref = self._normal(data), data._impl.efc_aref
        most = _tangent(aref, normal) - self._slack
        beyond = _tangent(data._impl.efc_J @ data.qacc_warmstart - aref, normal) - self._slack
        return jnp.clip(beyond, 0.0, jnp.maximum(most, 0.0)), most > 0

    def _with_friction(self, data: Any) -> Any:
        """One world's data, with the friction of sliding contacts reduced."""
        if self._kinetic == 1:
            return data
        slip = _tangent(data._impl.efc_J @ data.qvel, self._normal(data))
        share = 1.0 - (1.0 - self._kinetic) * jnp.clip(slip / STICKS_M_S - 1.0, 0.0, 1.0)
        friction = data._impl.contact.friction.at[:, :2].multiply(share[:, None])
        return data.tree_replace({"_impl.contact.friction": friction})

    @staticmethod
    def _normal(data: Any) -> NDArray[np.integer]:
        """(contact,) rows of the normals; the rows of the tangents follow them."""
        return np.asarray(data._impl.contact.efc_address)


def _tangent(rows: Float[Array, " constraint"], normal: NDArray[np.integer]) -> Float[Array, " contact"]:
    """(contact,) lengths of the tangential parts of values per constraint row, such as forces. ``normal``: rows of the
    contacts' normals."""
    return jnp.hypot(rows[normal + 1], rows[normal + 2])
