"""Contact forces for pages and pictures, added up to one force for each pair of bodies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.world.history import FLOOR, Contacts


class Pushes(NamedTuple):
    """k pushes, sorted by pair of bodies, then by frame. A push is the total force between two bodies in one frame.

    Attributes:
        frame: (k,) number of the frame of each push.
        point: (k, 3) point at which each push acts, m: the mean position of the contacts, weighted by their forces.
        force: (k, 3) force, N, on that body of the pair that is pushed down. So z is never positive.
    """

    frame: NDArray[np.int32]
    point: FloatArray
    force: FloatArray


def pushes(contacts: Contacts) -> Pushes:
    """The total force between each pair of bodies that press on each other, in each frame."""
    strength = np.linalg.norm(contacts.force, axis=1)
    body = contacts.body.astype(np.int64) - FLOOR  # FLOOR is the lowest number of a body; now, numbers begin at 0
    on_later = np.where(body[:, 0] > body[:, 1], -1.0, 1.0)[:, None] * contacts.force
    pair = body.min(axis=1) * (body.max(initial=0) + 1) + body.max(axis=1)
    ranks = pair * (contacts.frame.max(initial=0) + 1) + contacts.frame
    _, sample, row_of = np.unique(ranks, return_index=True, return_inverse=True)

    def summed(values: FloatArray) -> FloatArray:
        return np.column_stack([np.bincount(row_of, values[:, axis], len(sample)) for axis in range(3)])

    weight = np.bincount(row_of, strength, len(sample))
    felt = weight > 0
    force, point = summed(on_later)[felt], summed(contacts.point * strength[:, None])[felt] / weight[felt, None]
    return Pushes(contacts.frame[sample[felt]], point, np.where(force[:, [2]] > 0, -force, force))
