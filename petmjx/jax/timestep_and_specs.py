"""Timesteps and specifications of the environment for jitted programs. The classes have the same names as in dm_env and
jumanji."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Generic, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

ObservationT = TypeVar("ObservationT")


class StepType:
    """The position of a step in its episode."""

    FIRST: Final = 0
    MID: Final = 1
    LAST: Final = 2


class TimeStep(NamedTuple, Generic[ObservationT]):
    """The result of a step of an episode.

    Attributes:
        step_type: a value of ``StepType``.
        reward: reward of this step; 0 for the first step.
        discount: 0 if the episode has been terminated; 1 if it continues or was truncated.
        observation: the observation after the step.
        extras: further values, by name.
    """

    step_type: Int[Array, ""]
    reward: Float[Array, ""]
    discount: Float[Array, ""]
    observation: ObservationT
    extras: dict[str, jax.Array]

    def first(self) -> Bool[Array, ""]:
        """Whether this is the first step of an episode."""
        return self.step_type == StepType.FIRST

    def mid(self) -> Bool[Array, ""]:
        """Whether this is neither the first nor the last step of an episode."""
        return self.step_type == StepType.MID

    def last(self) -> Bool[Array, ""]:
        """Whether this is the last step of an episode."""
        return self.step_type == StepType.LAST


@dataclass(frozen=True)
class Spec:
    """The shape, the type and the range of an array. ``num_values`` is the number of possible values of an action; for
    other arrays, ``num_values`` is None."""

    name: str
    shape: tuple[int, ...]
    dtype: Any
    minimum: float
    maximum: float
    num_values: int | None = None

    def generate_value(self) -> jax.Array:
        """An array that satisfies the specification."""
        return jnp.full(self.shape, self.minimum, self.dtype)
