"""Simulated pallets for JAX programs: pure functions that can be used under ``jax.jit`` and ``jax.lax.scan``. The state
of the pallets is a pytree.

    state = petmjx.jax.empty(64, engine="mujoco")
    state, results = petmjx.jax.place(state, size_mm, corner_mm, mass_kg)
    results = petmjx.jax.try_all(state, size_mm, corner_mm, mass_kg, pallet)

With the engine ``mjx-warp``, the GPU kernel runs inside the jitted program, and states never leave the device. With the
engine ``mujoco``, MuJoCo runs on the CPU, in a callback of the program. Lengths are in millimetres and masses in
kilograms, as in ``petmjx.Pallets``. ``Palletizing`` is a reinforcement learning environment made of pure functions. See
docs/loop.md.
"""

import warnings
from typing import Any

from petmjx.jax.pallet_functions import empty, place, try_all
from petmjx.jax.palletizing_environment import Observation, Palletizing
from petmjx.jax.placement_arrays import REASONS, PlacementArrays
from petmjx.jax.timestep_and_specs import Spec, StepType, TimeStep

__all__ = [
    "REASONS",
    "Observation",
    "Palletizing",
    "PlacementArrays",
    "Spec",
    "StepType",
    "TimeStep",
    "empty",
    "place",
    "try_all",
]


def __getattr__(name: str) -> Any:
    if name == "Told":  # in version 0.2, the class PlacementArrays was called Told
        warnings.warn("petmjx.jax.Told is now petmjx.jax.PlacementArrays", FutureWarning, stacklevel=2)
        return PlacementArrays
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
