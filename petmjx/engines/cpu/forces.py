"""Forces on tops in many steps of a world on C MuJoCo: copied after each step, worked out together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from petmjx.basics.units import FloatArray
from petmjx.metrics.force_np import VERTICAL_COSINE, contact_force_z, pressed_box


class Pressed(NamedTuple):
    """What a step's forces on tops are made of, copied from MuJoCo's data.

    Attributes:
        address: (ncon,) first constraint row of each contact; negative: it has none.
        geom: (ncon, 2) partners.
        frame: (ncon, 9) normal and tangents.
        force: (nefc,) of all constraint rows, N.
        place: (ngeom, 3) centres of the geoms, m.
        bodies: (ngeom,) of the geoms, as ``petmjx.world.model.geom_bodies`` gives them.
        n_boxes: the boxes that count: the first ones.
    """

    address: NDArray[np.integer]
    geom: NDArray[np.integer]
    frame: FloatArray
    force: FloatArray
    place: FloatArray
    bodies: NDArray[np.integer]
    n_boxes: int


def pressed(data: mujoco.MjData, bodies: NDArray[np.integer], n_boxes: int) -> Pressed:
    """Of the last step. It takes a fifth of the time that ``top_forces`` takes."""
    contact = data.contact
    address, geom, frame = contact.efc_address.copy(), contact.geom.copy(), contact.frame.copy()
    return Pressed(address, geom, frame, data.efc_force.copy(), data.geom_xpos.copy(), bodies, n_boxes)


def largest_top_forces(steps: Sequence[Pressed], n_boxes: int) -> FloatArray:
    """(n_boxes,) the largest of ``top_forces`` over steps of a model with elliptic cones, N. Many steps together take
    a fraction of the time of each alone. All must have the same ``bodies``."""
    address, geoms, frame, force, place = (np.concatenate(parts) for parts in list(zip(*steps, strict=True))[:5])
    contacts = [len(step.address) for step in steps]
    number = np.repeat(np.arange(len(steps)), contacts)
    first_row = np.cumsum([0, *(len(step.force) for step in steps[:-1])])
    normal_z = frame[:, 2]
    # most contacts stand upright or are between neighbours, which do not count
    kept = np.flatnonzero((address >= 0) & (np.abs(normal_z) >= VERTICAL_COSINE))
    number, geom, frame_z = number.take(kept), geoms.take(kept, axis=0), frame.take(kept, axis=0)[:, 2::3]
    row = address.take(kept) + first_row.take(number)
    n_geoms = len(steps[0].place)
    place_z = place[:, 2].copy()
    place_z[::n_geoms] = -np.inf
    geom_z = place_z.take(geom + (n_geoms * number)[:, None])
    box, sign, counts = pressed_box(steps[0].bodies.take(geom), geom_z, frame_z[:, 0])
    counts &= box < np.array([step.n_boxes for step in steps]).take(number)
    pressure = sign * contact_force_z(force.take(row[:, None] + np.arange(3)), frame_z)
    total = np.bincount((number * n_boxes + box)[counts], pressure[counts], minlength=len(steps) * n_boxes)
    return np.asarray(total.reshape(len(steps), n_boxes).max(axis=0))
