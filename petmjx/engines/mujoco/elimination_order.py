"""Elimination order of the boxes of a world in the factorisation of its Hessian.

Newton's method factorises M + JᵀDJ in every iteration, and updates the factor for each sliding contact. Two boxes that
touch share an entry of the matrix. Eliminating a box joins all its neighbours (fill-in). In packing order, whole layers
become joined. The order of *minimum degree* avoids most of this (Tinney and Walker, "Direct solutions of sparse network
equations by optimally ordered triangular factorization", 1967; George and Liu, "The evolution of the minimum degree
ordering algorithm", 1989). For a full pallet of 150 boxes, the factor then has a third of the blocks, and a tenth of
the operations. The order changes only the last digits of a step.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.world.scene import Scene

NEAR_M = 0.005
"""Boxes that are nearer to one another than this at their release may come to touch, m. Neighbours in a plan are 0.1 mm
apart because of the size reduction, and a few of them stand on boxes of different heights."""


def body_order(scene: Scene, n_boxes: int, contacts: NDArray[np.integer], shaken: bool) -> NDArray[np.intp]:
    """(n_boxes,) the first boxes of the plan, in that order of their bodies for which factorisations are cheapest.

    MuJoCo eliminates the last body first. The carrier, which touches a whole layer, is always the first body.

    Args:
        contacts: (m, 2) pairs of boxes that touch now, without the carrier and the floor.
        shaken: True: boxes will touch their neighbours at the sides. False: only pairs count in which one box stands on
            the other. A standing pallet has few other contacts, and counting these would add half as many operations.
    """
    joined = _may_touch(scene.start_pos[:n_boxes], scene.half_size[:n_boxes], NEAR_M if shaken else 0.0)
    first, second = contacts.T
    joined[first, second] = joined[second, first] = True
    return np.array(minimum_degree(joined)[::-1], dtype=np.intp)


def _may_touch(centre: FloatArray, half: FloatArray, beside_m: float) -> NDArray[np.bool_]:
    """(k, k) whether boxes are near one another, as axis-aligned boxes.

    Args:
        centre, half: (k, 3) centres and half extents, m.
        beside_m: largest gap between two boxes along x and along y, m; with 0, the boxes must overlap along both axes.
    """
    gap = np.abs(centre[:, None] - centre) - (half[:, None] + half)
    return np.asarray((gap < (beside_m, beside_m, NEAR_M)).all(axis=2))


def minimum_degree(joined: NDArray[np.bool_]) -> list[int]:
    """The nodes of a graph in order of minimum degree: the next node is always the one with the fewest remaining
    neighbours. In a tie, it is the node with the lowest number.

    Args:
        joined: (k, k) whether two nodes are joined; symmetric, and the diagonal is ignored.
    """
    neighbours = {node: set(np.flatnonzero(row).tolist()) - {node} for node, row in enumerate(joined)}
    order: list[int] = []
    while neighbours:
        node = min(neighbours, key=lambda candidate: (len(neighbours[candidate]), candidate))
        order.append(node)
        clique = neighbours.pop(node)
        for member in clique:
            neighbours[member] = (neighbours[member] | clique) - {member, node}
    return order
