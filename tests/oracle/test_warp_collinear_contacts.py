"""Contacts between two others are removed, so that a box on a box of the same size does not tremble."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

import warp as wp

from petmjx.common.warp_cpp import with_cpp
from petmjx.common.warp_setup import set_up_warp
from petmjx.engines.warp.kernels.collision import without_collinear
from petmjx.engines.warp.solver import newton

set_up_warp()

SQUARE = [[0.0, 0.0], [0.4, 0.0], [0.4, 0.3], [0.0, 0.3]]
OCTAGON = [[0.1, 0.0], [0.3, 0.0], [0.4, 0.1], [0.4, 0.2], [0.3, 0.3], [0.1, 0.3], [0.0, 0.2], [0.0, 0.1]]


def _remaining(points: wp.array3d[wp.vec4], counts: wp.array[int]) -> None:
    i = wp.tid()
    counts[i] = without_collinear(points, 0, i, counts[i])


@pytest.mark.parametrize(
    ("contacts", "remaining"),
    [
        pytest.param([*SQUARE, [0.397, 0.0]], SQUARE, id="near a corner"),
        pytest.param([[0.2, 3e-6], *SQUARE], SQUARE, id="within an edge"),
        pytest.param([*SQUARE, *SQUARE], SQUARE, id="each corner twice"),
        pytest.param([*SQUARE, [0.2, -5e-5]], [*SQUARE, [0.2, -5e-5]], id="beside an edge"),
        pytest.param(OCTAGON, OCTAGON, id="octagon"),
        pytest.param([[0.0, 0.0], [0.1, 0.0], [0.2, 0.0], [0.3, 0.0], [0.4, 0.0]], [[0.0, 0.0], [0.4, 0.0]], id="line"),
    ],
)
def test_contacts_between_two_others_are_removed(contacts: ArrayLike, remaining: ArrayLike) -> None:
    level = np.asarray(contacts)
    places = np.zeros((1, 1, 8, 4), np.float32)
    places[0, 0, : len(level), :2] = level
    points, counts = wp.array(places, dtype=wp.vec4, device="cpu"), wp.array([len(level)], dtype=int, device="cpu")
    wp.launch(with_cpp(_remaining, newton.text_for(6)), dim=1, inputs=[points, counts], device="cpu")
    left = points.numpy()[0, 0, : counts.numpy()[0], :2].astype(float).round(6).tolist()
    assert sorted(left) == sorted(np.round(remaining, 6).tolist())
