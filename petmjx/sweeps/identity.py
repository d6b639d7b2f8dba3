"""What of a sweep its results depend on: two sweeps of one identity have the same worlds."""

from __future__ import annotations

import hashlib
from typing import Any

from petmjx.sweeps.axes import Axis
from petmjx.sweeps.file import Sweep
from petmjx.world.random import WorldKey

_BESIDE = {"name", "description", "plans", "simulation", "axes", "own_profiles"}
"""Fields of a sweep file that change no world, or are compared separately."""


def sweep_identity(sweep: Sweep) -> dict[str, Any]:
    """The settings of a sweep as plain JSON values, without its simulation; profiles by a digest of their samples."""
    settings = sweep.model_dump(mode="json", exclude=_BESIDE)
    if sweep.search is not None:
        settings["search"]["levels"] = len(sweep.search_levels)
    settings["axes"] = {name: _values(axis) for name, axis in sweep.axes.items()}
    settings["profiles"] = {name: _digest(sweep, name) for name in sweep.profiles}
    return settings


def _values(axis: Axis) -> object:
    if axis.continuous:
        return {"from": axis.low, "to": axis.high}
    return [value if isinstance(value, float | int | str) else repr(value) for value in axis.values]


def _digest(sweep: Sweep, name: str) -> str:
    """Digest of what a profile's first realisation does. Realisations differ by random numbers alone."""
    profile = sweep.profiles[name]
    excitation = profile.excitation(sweep.simulation.physics.timestep_s, 0.0, WorldKey(sweep.seed, "", 0))
    digest = hashlib.blake2b(f"{excitation.kind} {excitation.samples.shape}".encode(), digest_size=8)
    digest.update(excitation.samples.tobytes())
    return digest.hexdigest()
