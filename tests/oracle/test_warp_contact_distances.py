"""Distances of contacts on mjx-warp, beside those of C MuJoCo, which computes in double precision."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from support.plans import make_scene

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

import warp as wp

from petmjx.common.warp_cpp import with_cpp
from petmjx.common.warp_setup import set_up_warp
from petmjx.engines.mjx.first_states import _put_at_rest
from petmjx.engines.mjx.world_state import State
from petmjx.engines.warp.kernels.body_dynamics import doubled, exact_rotation, rotation
from petmjx.engines.warp.kernels.contact_distances import exact_distance
from petmjx.engines.warp.kernels.mujoco_warp import box_box
from petmjx.engines.warp.solver import newton
from petmjx.world.job import Job

set_up_warp()

MARGIN_M = 1e-5
FINE_M = 1e-9
"""Error that a distance may have, m: a hundredth of the depth to which a box sinks in the stiffest contacts of
mjx-warp."""
COARSE_M = 1e-8
"""Error that the collider's own distances exceed, m. If they do not, the exact distances are not needed."""

MATCHED_SHARE = 0.9
"""Least share of the collider's contacts that C MuJoCo has, too. Contacts at the margin are on one side only."""

TWO_BOXES = f"""
<mujoco><worldbody>
  <body><freejoint/><geom type="box" size="1 1 1" margin="{MARGIN_M}"/></body>
  <body><freejoint/><geom type="box" size="1 1 1" margin="{MARGIN_M}"/></body>
</worldbody></mujoco>
"""


def _distances(
    places: wp.array2d[wp.vec3d],
    turns: wp.array2d[wp.vec4],
    halves: wp.array2d[wp.vec3],
    n_points: wp.array[int],
    points: wp.array2d[wp.vec3],
    coarse: wp.array2d[float],
    exact: wp.array2d[float],
) -> None:
    i = wp.tid()
    apart = places[i, 1] - places[i, 0]
    count, distances, touches, normal = box_box(
        wp.vec3(0.0, 0.0, 0.0),
        rotation(turns[i, 0]),
        halves[i, 0],
        wp.vec3(float(apart[0]), float(apart[1]), float(apart[2])),
        rotation(turns[i, 1]),
        halves[i, 1],
        MARGIN_M,
    )
    n_points[i] = count
    for k in range(count):
        touch = wp.vec3(touches[k, 0], touches[k, 1], touches[k, 2])
        points[i, k] = touch
        coarse[i, k] = distances[k]
        exact[i, k] = exact_distance(
            halves[i, 0],
            exact_rotation(turns[i, 0]),
            halves[i, 1],
            exact_rotation(turns[i, 1]),
            apart,
            wp.normalize(doubled(normal)),
            doubled(touch),
            distances[k],
        )


@pytest.mark.parametrize("tilt", [1e-6, 1e-4, 1e-3])
def test_distances_of_boxes_that_press_on_each_other_are_those_of_mujoco(tilt: float) -> None:
    """Boxes of 0.1 to 0.6 m, one on the other, up to 2 m from the origin; each is tilted by up to about ``tilt``."""
    rng, n = np.random.default_rng(33631), 40
    halves = rng.uniform(0.05, 0.3, (n, 2, 3)).astype(np.float32)
    halves[::2, 1] = halves[::2, 0]  # half of the boxes are on boxes of the same size
    turns = np.concatenate([np.ones((n, 2, 1)), tilt * rng.normal(size=(n, 2, 3))], axis=2).astype(np.float32)
    places = rng.uniform(-2, 2, (n, 2, 3))
    places[:, 1] = places[:, 0] + rng.uniform(-0.05, 0.05, (n, 3))
    places[:, 1, 2] = places[:, 0, 2] + halves[:, :, 2].sum(axis=1) - rng.uniform(0, 5e-6, n)

    counts = wp.zeros(n, dtype=int, device="cpu")
    points = wp.zeros((n, 8), dtype=wp.vec3, device="cpu")
    coarse, exact = (wp.zeros((n, 8), dtype=float, device="cpu") for _ in range(2))
    records = [
        wp.array(places, dtype=wp.vec3d, device="cpu"),
        wp.array(turns, dtype=wp.vec4, device="cpu"),
        wp.array(halves, dtype=wp.vec3, device="cpu"),
    ]
    kernel = with_cpp(_distances, newton.text_for(6))
    wp.launch(kernel, dim=n, inputs=[*records, counts, points, coarse, exact], device="cpu")

    model = mujoco.MjModel.from_xml_string(TWO_BOXES)
    data = mujoco.MjData(model)
    errors = []
    for i in range(n):
        model.geom_size[:] = halves[i]
        model.geom_aabb[:, 3:] = halves[i]
        model.geom_rbound[:] = np.linalg.norm(halves[i], axis=1)
        data.qpos[:] = np.concatenate([places[i], turns[i]], axis=1).ravel()
        mujoco.mj_fwdPosition(model, data)
        for k in range(counts.numpy()[i]):
            for contact in data.contact[: data.ncon]:
                if np.linalg.norm(contact.pos - places[i, 0] - points.numpy()[i, k]) < 1e-5:
                    errors.append([coarse.numpy()[i, k] - contact.dist, exact.numpy()[i, k] - contact.dist])
    of_collider, of_exact = np.abs(errors).max(axis=0)
    assert len(errors) > MATCHED_SHARE * counts.numpy().sum()
    assert of_exact < FINE_M
    assert of_collider > COARSE_M


def test_a_pallet_put_at_other_poses_loses_no_digits() -> None:
    """The next leg of a chain begins where the last leg has ended, and not with the remainders of its placement."""
    poses = np.random.default_rng(33632).uniform(0.5, 1.5, (2, 7))
    moving = {name: np.ones((1, 2, 6), np.float32) for name in ("qvel", "qacc", "qacc_warmstart")}
    empty = State._make([None] * len(State._fields))
    host = empty._replace(
        qpos=np.zeros((1, 2, 7), np.float32), qpos_remainder=np.full((1, 2, 3), 1e-8, np.float32), **moving
    )
    _put_at_rest([Job(make_scene(2), poses=poses)], host)
    places = host.qpos[0, :, :3].astype(np.float64) + host.qpos_remainder[0]
    np.testing.assert_allclose(places, poses[:, :3], atol=1e-14, rtol=0)
    assert np.abs(host.qpos[0, :, :3] - poses[:, :3]).max() > 1e-9
    assert not host.qvel.any()
