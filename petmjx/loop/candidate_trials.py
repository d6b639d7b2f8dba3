"""Trials of candidates (boxes at places) under harder conditions: a robot places the box with errors, or a drive (a
motion of the carrier) shakes the pallet afterwards."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.argument_checks import number_of, text_of
from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.common.units import FloatArray, deg_to_rad
from petmjx.engines.open_world_protocol import OpenWorlds
from petmjx.engines.verdict import Verdict
from petmjx.loop.placement_results import PlacementResults
from petmjx.options.simulation import Simulation
from petmjx.options.thresholds import Thresholds
from petmjx.runs.confidence import confidence_sweep
from petmjx.runs.sweep_design import Design
from petmjx.world.error_distributions import Distribution
from petmjx.world.growing_scenes import NextBoxes
from petmjx.world.job import Drive
from petmjx.world.profiles.profile import Strength, allowed_sway_m
from petmjx.world.profiles.profile_registry import resolve
from petmjx.world.scene import Scene
from petmjx.world.variants import ZERO, Variant, apply

_AT_ONCE: Final = 1024
"""Largest number of worlds (simulated pallets) with errors or drives that are simulated at a time."""

_NAME = "candidate"
"""Name that replaces the id of a plan when random numbers are drawn. With the same name, all candidates get the same
errors, so they can be compared."""


MOST_ERRORS_DRAWN: Final = 2**31
"""Upper limit of the numbers that select the random errors of a single box: each number is smaller than this value."""


class Errors:
    """Random errors, as in ``petmjx score --confidence``, for a box that is put onto a standing pallet.

    The new box has errors of place, rotation, size and mass; the boxes on the pallet have no such errors. The
    coefficient of friction has the same error for all boxes, because all cartons are made of the same board and have
    the same humidity. A simulated hand carries the box to its place (docs/placing.md).
    """

    def __init__(self, count: int, sim: Simulation) -> None:
        self._sweep = confidence_sweep(count, None, dict(sim))
        placements = list(Design(self._sweep).placements())
        self._variants: list[Variant] = [variant for variant, _ in placements if variant.placement.random]

    def __len__(self) -> int:
        return len(self._variants)

    def scenes(self, scene: Scene) -> list[Scene]:
        """Variants of a scene, each changed by other random errors. The last box of the scene is the candidate."""
        standing = scene.n_boxes - 1
        return [apply(scene, _NAME, variant, self._sweep.seed, standing=standing) for variant in self._variants]


class PlacingErrors:
    """Random errors, as in ``petmjx score --confidence``, for boxes that are put onto pallets and stay there. These are
    errors of place, rotation, size and mass. The friction on a pallet is not changed."""

    def __init__(self, sim: Simulation) -> None:
        self._sweep = confidence_sweep(1, None, dict(sim))
        (variant,) = (variant for variant, _ in Design(self._sweep).placements() if variant.placement.random)
        self._change = replace(variant.placement, friction_rel=ZERO)

    def scene(self, scene: Scene, number: int, strength: float) -> Scene:
        """The scene, changed by random errors in the place, rotation, size and mass of its last box. ``number`` selects
        the random errors, which are multiplied by ``strength``. If the strength is 0, the scene is unchanged."""
        if strength == 0:
            return scene
        errors: dict[str, Any] = {
            entry.name: replace(error, centre=strength * error.centre, spread=strength * error.spread)
            for entry in fields(self._change)
            if isinstance(error := getattr(self._change, entry.name), Distribution)
        }
        variant = Variant(1, replace(self._change, **errors), replicate=number)
        return apply(scene, _NAME, variant, self._sweep.seed, standing=scene.n_boxes - 1)


@functools.lru_cache(maxsize=4)
def placing_errors_of(sim: Simulation) -> PlacingErrors:
    """The random errors of single boxes. The file that defines the errors is read only once."""
    return PlacingErrors(sim)


@functools.lru_cache(maxsize=4)
def errors_of(count: int, sim: Simulation) -> Errors:
    """The random errors of ``count`` worlds. The file that defines the errors is read only once, because candidates are
    tried in every step of a packer."""
    return Errors(count, sim)


def errors_asked(error: Any, strength: Any, m: int) -> tuple[NDArray[np.int64], FloatArray]:
    """Check the arguments ``error`` and ``error_strength`` of ``petmjx.Pallets.place``. Returns (m,) the numbers of the
    errors, and (m,) their strengths.

    Raises:
        InputError: the numbers are not m whole numbers from 0 to ``MOST_ERRORS_DRAWN`` − 1, or a strength is negative
            or not a number.
    """
    numbers = np.asarray(error)
    if (
        numbers.shape != (m,)
        or numbers.dtype.kind not in "iu"
        or ((numbers < 0) | (numbers >= MOST_ERRORS_DRAWN)).any()
    ):
        raise InputError(
            f"'error' must be {m} whole numbers of at least 0 and below {MOST_ERRORS_DRAWN}, {shown_value(error)}"
        )
    strengths = np.broadcast_to(np.asarray(strength, object), (m,)).tolist()
    return numbers.astype(np.int64), np.array([number_of(value, "error_strength", 0.0) for value in strengths])


def drive_of(drive: Any, level: Any, direction_deg: Any, sim: Simulation) -> Drive | None:
    """The drive (the motion or force that shakes the carrier) for trials of candidates; None if ``drive`` is None.

    Args:
        drive: the name of a built-in profile (the time course of a drive), a ``Drive``, or None.
        level: strength of the drive, in the profile's unit (docs/profiles.md), such as g for ``eumos-40509``.

    Raises:
        InputError: the profile is unknown, the name stands for several profiles, or a value is not a number.
    """
    if drive is None:
        for value, name, usual in ((level, "level", 1.0), (direction_deg, "direction_deg", 0.0)):
            if value != usual:
                raise InputError(f"{name} needs a drive")
        return None
    if isinstance(drive, Drive):
        return drive
    if not isinstance(drive, str):
        raise InputError(f"drive must be the name of a profile, {shown_value(drive)}")
    profiles = resolve(text_of(drive, "drive"))
    if len(profiles) > 1:
        raise InputError(
            f"drive: {drive} stands for several profiles; name one of {', '.join(p.name for p in profiles)}"
        )
    (profile,) = profiles
    strength = number_of(level, "level", 0.0)
    if profile.strength is Strength.ANGLE and strength != 1.0:
        raise InputError(f"level: the profile {drive} has no level; leave level out")
    excitation = profile.excitation(sim.physics.timestep_s)
    yaw_rad = deg_to_rad(number_of(direction_deg, "direction_deg"))
    return Drive(excitation, strength, yaw_rad, sim.rest_s, allowed_sway_m(profile))


def driven_results(
    open_worlds: OpenWorlds, pallets: NDArray[np.int64], boxes: NextBoxes, drive: Drive, thresholds: Thresholds
) -> PlacementResults:
    """The results of m pallets, each of which gets one more box and is then shaken."""
    parts = []
    for rows in _chunks(len(pallets), _AT_ONCE):
        row_pallets = pallets[rows].tolist()
        outcomes = open_worlds.try_scenes(
            row_pallets, open_worlds.with_next(row_pallets, boxes.take(rows)), [drive] * len(row_pallets)
        )
        parts.append(PlacementResults.of_outcomes(pallets[rows], outcomes, thresholds))
    return PlacementResults.joined(parts)


def shares(
    open_worlds: OpenWorlds, worlds: Sequence[int], boxes: NextBoxes, errors: Errors, drive: Drive | None
) -> FloatArray:
    """(m,) for each candidate, the share of its worlds with errors that are stable. Invalid worlds are not counted."""
    parts = []
    for rows in _chunks(len(worlds), max(_AT_ONCE // len(errors), 1)):
        row_worlds = [worlds[row] for row in rows]
        scenes = [
            changed for scene in open_worlds.with_next(row_worlds, boxes.take(rows)) for changed in errors.scenes(scene)
        ]
        error_worlds = [world for world in row_worlds for _ in range(len(errors))]
        outcomes = open_worlds.try_scenes(error_worlds, scenes, [drive] * len(error_worlds))
        verdicts = np.array([str(outcome.verdict) for outcome in outcomes]).reshape(len(row_worlds), -1)
        n_judged = (verdicts != str(Verdict.INVALID)).sum(axis=1)
        stable = (verdicts == str(Verdict.STABLE)).sum(axis=1)
        parts.append(np.where(n_judged > 0, stable / np.maximum(n_judged, 1), np.nan))
    return np.concatenate(parts)


def _chunks(count: int, most: int) -> list[NDArray[np.intp]]:
    return [np.arange(first, min(first + most, count)) for first in range(0, count, most)]
