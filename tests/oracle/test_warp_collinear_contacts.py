"""Contacts between two others are removed, so that a box on a box of the same size does not tremble."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.typing import ArrayLike

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

import warp as wp
from support.one_step import OneStep
from support.plans import make_scene

from petmjx.common.warp_cpp import with_cpp
from petmjx.common.warp_setup import set_up_warp
from petmjx.engines.warp.kernels.collision import without_collinear
from petmjx.engines.warp.solver import newton
from petmjx.options.physics import PHYSICS
from petmjx.options.simulation import Simulation
from petmjx.world.mujoco_model import build_spec

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


@pytest.mark.usefixtures("ranks_may_differ")
@pytest.mark.parametrize(("preset", "remaining"), [("pallet", 4), ("reference", 8)])
def test_only_boxes_with_a_skin_lose_contacts(preset: str, remaining: int) -> None:
    """Of two equal boxes, the upper one is turned by 1e-7 rad about the vertical, so that all edges of the two faces
    cross. The other pairs, floor and carrier, and carrier and box, have four contacts each."""
    boxes = [((400, 300, 200), (0, 0, 200 * level), 5.0) for level in range(2)]
    scene = make_scene(boxes, Simulation(physics=preset, size_reduction_mm=0))
    spec = build_spec(scene, PHYSICS[preset])
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_NATIVECCD
    model = spec.compile()
    data = mujoco.MjData(model)
    poses = data.qpos.reshape(-1, 7)
    poses[1:, :3], poses[1:, 3:] = scene.frames(scene.start_pos, scene.start_quat), scene.start_quat
    poses[:, 2] -= [1e-5, 2e-5, 3e-5]
    poses[2, 3:] = 1.0, 0.0, 0.0, 0.5e-7
    mujoco.mj_forward(model, data)
    assert data.ncon == 4 + 4 + 8
    assert OneStep(scene, preset)(data).contacts == 4 + 4 + remaining
