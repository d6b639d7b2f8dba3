"""Where boxes are released: as they will rest on what bears them.

Contacts are soft. Under the loads so far a pile has come down by up to some tenths of a millimetre, and a box's own
contacts are a tenth of a millimetre deep once they carry it. A box that appeared where the plan has it would fall by
both, land with centimetres a second, and might rock over an edge on which it stands. So it is released as deep in what
bears it as its weight will press it, and it follows how far that has come down since.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import FloatArray
from petmjx.history import CARRIER
from petmjx.options.config import Check, Simulation
from petmjx.plans.overlap import meets, shared
from petmjx.world.alike import stacked
from petmjx.world.bearing import TOUCH_M
from petmjx.world.contact import CONTACTS_PER_FACE, cone_factor, depth_m
from petmjx.world.give import bed_depth_m, sinks_m
from petmjx.world.next_boxes import NextBoxes, Stacks
from petmjx.world.scene import Scene

NOTHING: Final = -2
"""In place of a support: the box hangs in the air, or falls into its place."""

MOST_FOLLOWED_M: Final = 0.002
"""How far a box follows its support at most, m: a pile that has moved by more no longer bears it as planned."""


class Release(NamedTuple):
    """How n boxes are released; of many scenes that are alike, with an axis of these before the others.

    Attributes:
        support: (n,) the box that a box follows, ``CARRIER``, or ``NOTHING``: the one with which it shares most area.
        pos: (n, 3) centres of boxes whose support is where the plan has it, m.
        most_followed_m: how far a box follows its support: further where supports give.
    """

    support: NDArray[np.intp]
    pos: FloatArray
    most_followed_m: float = MOST_FOLLOWED_M

    def place_of(self, box: int, scene: Scene, boxes_z: FloatArray, carrier_z: float) -> FloatArray:
        """(3,) middle of a box that is released now, m.

        Args:
            boxes_z, carrier_z: heights of the centres of the boxes before it, and of the carrier's, m.
        """
        place: FloatArray = self.pos[box].copy()
        support = self.support[box]
        if support != NOTHING:
            on_carrier = support == CARRIER
            moved = carrier_z - scene.carrier.pos[2] if on_carrier else boxes_z[support] - scene.target[support, 2]
            place[2] += np.clip(moved, -self.most_followed_m, self.most_followed_m)
        return place


def release_of(scene: Scene, sim: Simulation) -> Release:
    """How the boxes of a scene are released, one by one. In a static check all stand at their planned places."""
    if sim.physics.falls_into_place or sim.check is Check.STATIC or not scene.n_boxes:
        return Release(np.full(scene.n_boxes, NOTHING), scene.start_pos)
    support = _supports(scene.target, scene.half_size)
    touches = (support != NOTHING) & (scene.start_pos[:, 2] <= scene.target[:, 2])
    physics, friction = sim.physics, scene.friction[:, 0]
    on_carrier, below = support == CARRIER, np.maximum(support, 0)
    share = 1.0 + scene.mass / np.where(on_carrier, scene.carrier.mass, scene.mass[below])
    soft = cone_factor(physics, friction, np.where(on_carrier, scene.carrier.friction[:, 0].max(), friction[below]))
    pos = scene.start_pos.copy()
    depth = depth_m(physics, soft * share * physics.gravity_m_s2 / CONTACTS_PER_FACE)
    sinks, most = sinks_m(scene, physics.gravity_m_s2), MOST_FOLLOWED_M
    if sinks is not None:
        depth = np.maximum(depth, bed_depth_m(scene, scene.mass * physics.gravity_m_s2))
        most += float(sinks.max())
    pos[:, 2] -= np.where(touches, depth, 0.0)
    return Release(support, pos, most)


def releases_of(scenes: Sequence[Scene], sim: Simulation) -> Release:
    """The releases of plain scenes that are alike (petmjx.world.alike), to the last bit as ``release_of`` has each."""
    start = stacked(scenes, "start_pos")
    m, n = start.shape[:2]
    if sim.physics.falls_into_place or sim.check is Check.STATIC or not n:
        return Release(np.full((m, n), NOTHING), start)
    target, half = (stacked(scenes, name) for name in ("target", "half_size"))
    mass, friction = stacked(scenes, "mass"), stacked(scenes, "friction")[..., 0]
    carrier_mass = stacked(scenes, "carrier.mass")[:, None]
    carrier_friction = stacked(scenes, "carrier.friction")[..., 0].max(axis=1)[:, None]
    support = _supports(target, half)
    touches = (support != NOTHING) & (start[..., 2] <= target[..., 2])
    on_carrier, below = support == CARRIER, np.maximum(support, 0)
    physics = sim.physics
    share = 1.0 + mass / np.where(on_carrier, carrier_mass, np.take_along_axis(mass, below, axis=1))
    soft = cone_factor(
        physics, friction, np.where(on_carrier, carrier_friction, np.take_along_axis(friction, below, axis=1))
    )
    depth = depth_m(physics, soft * share * physics.gravity_m_s2 / CONTACTS_PER_FACE)
    start[..., 2] -= np.where(touches, depth, 0.0)
    return Release(support, start)


def release_of_next(before: Stacks, boxes: NextBoxes, sim: Simulation) -> Release:
    """How one box more is released in each of m worlds: to the last bit the last rows that ``release_of`` has."""
    nothing = np.full(len(boxes), NOTHING)
    if sim.physics.falls_into_place or sim.check is Check.STATIC:
        return Release(nothing, boxes.target)
    low, high = boxes.target - boxes.half_size, boxes.target + boxes.half_size
    ends = np.minimum(before.target + before.half_size, high[:, None])
    sides = np.maximum(ends - np.maximum(before.target - before.half_size, low[:, None]), 0.0)
    top = before.target[:, :, 2] + before.half_size[:, :, 2]
    area = np.nan_to_num(sides[:, :, 0] * sides[:, :, 1]) * (np.abs(top - low[:, None, 2]) <= TOUCH_M)
    box_below = np.where(area.any(axis=1), area.argmax(axis=1), nothing) if area.shape[1] else nothing
    support = np.where(low[:, 2] <= TOUCH_M, CARRIER, box_below)
    on_carrier, rows = support == CARRIER, np.arange(len(boxes))
    # where nothing bears a box its own mass and friction stand in, and count for nothing
    masses = np.column_stack([before.mass, boxes.mass])
    below = np.where(support >= 0, support, masses.shape[1] - 1)
    share = 1.0 + boxes.mass / np.where(on_carrier, before.carrier_mass, masses[rows, below])
    friction = np.full(len(boxes), before.box_friction)
    soft = cone_factor(sim.physics, friction, np.where(on_carrier, before.carrier_friction, friction))
    depth = depth_m(sim.physics, soft * share * sim.physics.gravity_m_s2 / CONTACTS_PER_FACE)
    pos = boxes.target.copy()
    pos[:, 2] -= np.where(support != NOTHING, depth, 0.0)
    return Release(support, pos)


def _supports(target: FloatArray, half_size: FloatArray) -> NDArray[np.intp]:
    """(…, n) what each box lies on by the planned places, or most of it."""
    low, high = target - half_size, target + half_size
    length, width = (np.maximum(shared(low[..., axis], high[..., axis]), 0.0) for axis in range(2))
    area = length * width * np.triu(meets(low[..., 2], high[..., 2], TOUCH_M), k=1)
    box_below = np.where(area.any(axis=-2), area.argmax(axis=-2), NOTHING)
    return np.where(low[..., 2] <= TOUCH_M, CARRIER, box_below)
