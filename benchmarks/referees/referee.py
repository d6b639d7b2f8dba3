"""A referee: another simulator that can build the world of a scene, box by box."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any, Final, Protocol

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.units import FloatArray
from petmjx.engines.mujoco.top_forces import pressed_box
from petmjx.options.physics import Physics
from petmjx.world.scene import Scene


class RefereeWorld(Protocol):
    """One world of a referee: the floor, the carrier, which stands freely on the floor, and the boxes that are
    placed."""

    timestep_s: float

    def place(self, box: int) -> None:
        """Put the next box of the scene at its place of release, at rest. Boxes come in packing order."""

    def step(self, count: int) -> None:
        """Take this many steps."""

    def pose(self) -> FloatArray:
        """(k, 7) centres, m, and orientations (w, x, y, z) of the boxes placed so far."""

    def top_forces(self) -> FloatArray:
        """(k,) the force on top of each box, N, from the contacts of the last step (docs/metrics.md)."""

    def close(self) -> None:
        """Free the memory of the simulator."""


class Referee(Protocol):
    """A simulator with its settings.

    Attributes:
        name: name of the referee in results.
        settings: the numbers with which it runs, for the results.
        most_boxes: largest number of boxes of a world; larger worlds would take too long.
    """

    name: str
    settings: dict[str, Any]
    most_boxes: int

    def world(self, scene: Scene, physics: Physics, fine: bool) -> RefereeWorld:
        """The world of a scene before any box is placed. ``fine``: whether the settings are finer than usual; a
        converged referee then gives the same verdict."""


REFEREES: Final = {"physx": "sapien", "bullet": "pybullet", "drake": "drake"}
"""Module of a referee → package that it needs, in the order in which referees are used."""


def referee(name: str) -> Referee:
    """The referee with this name.

    Raises:
        InputError: no referee has this name, or its simulator is not installed.
    """
    if name not in REFEREES:
        raise InputError(f"no referee {name!r}; there are: {', '.join(REFEREES)}")
    try:
        module = importlib.import_module(f"benchmarks.referees.{name}")
    except ImportError as error:
        raise InputError(
            f"referee {name} cannot run: {error}; pip install '.[referees]' installs {REFEREES[name]}"
        ) from error
    instance: Referee = module.REFEREE
    return instance


FLOOR, CARRIER, FIRST_BOX = range(3)
"""Numbers of bodies in contacts. Further boxes follow in packing order."""


def top_forces(
    bodies: Sequence[tuple[int, int]], normal_z: Sequence[float], force_z: Sequence[float], pose: FloatArray
) -> FloatArray:
    """(k,) the force on top of each box, N, computed from contacts by petmjx's own rule.

    Args:
        bodies: the two bodies of each contact; ``normal_z``: z of its unit normal; ``force_z``: of the force on the
            second body, N.
        pose: (k, 7) of the boxes.
    """
    total = np.zeros(len(pose))
    if bodies:
        geom, normal = np.array(bodies), np.array(normal_z)
        centre_z = np.concatenate(([-np.inf, -1e-3], pose[:, 2]))  # floor and carrier are below all boxes
        upwards = np.where(centre_z[geom[:, 0]] < centre_z[geom[:, 1]], np.abs(normal), -np.abs(normal))
        box, sign, counts = pressed_box(geom - FIRST_BOX, upwards)
        np.add.at(total, box[counts], (sign * np.array(force_z))[counts])
    return total


def slab(scene: Scene) -> tuple[FloatArray, float, float]:
    """Half extents (m), mass (kg) and friction of a carrier.

    Raises:
        InputError: the carrier has several boards.
    """
    carrier = scene.carrier
    if len(carrier.half_size) > 1:
        raise InputError("the referees know carriers of one slab")
    return carrier.half_size[0], carrier.mass, float(carrier.friction[0, 0])


def box_inertia(mass: float, half_size: FloatArray) -> FloatArray:
    """(3,) moments of inertia of a box about its axes, kg·m²."""
    square = np.square(half_size)
    inertia: FloatArray = mass / 3 * (square.sum() - square)
    return inertia
