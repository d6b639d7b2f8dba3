"""For collision detection, boxes are enlarged by a thin layer, the skin. The skin must affect only which contacts are
found."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from support.plans import make_scene

from petmjx.common.units import FloatArray
from petmjx.options.physics import PHYSICS, Physics
from petmjx.world.mujoco_model import build_spec, to_mjcf

LOWER, UPPER = ((400, 300, 200), (0, 0, 0), 8.0), ((300, 200, 150), (0, 0, 200), 5.0)
SKIN_M = 2e-4
WITH_SKIN = {
    "declared pairs": PHYSICS["pallet"].changed(skin_m=SKIN_M),
    "friction as pressure": PHYSICS["pallet"].changed(skin_m=SKIN_M, solreffriction=(0.0, 0.0)),
    "reference": PHYSICS["reference"].changed(skin_m=SKIN_M),
}
WITHOUT = PHYSICS["pallet"].changed(skin_m=0.0)


def contacts(physics: Physics, depth_m: float, tilt_rad: tuple[float, float] = (0.0, 0.0)) -> mujoco.MjData:
    """Two boxes high above the carrier. The upper box penetrates the lower box by ``depth_m``, and is turned about x
    and y. The centre of the turn is a point of its lower face above an edge of the lower box."""
    scene = make_scene([LOWER, UPPER])
    model = build_spec(scene, physics).compile()
    data = mujoco.MjData(model)
    pose = data.qpos[7:].reshape(-1, 7)
    pose[:, :3] = scene.start_pos + np.array([0.0, 0.0, 1.0])
    pose[:, 3] = 1.0
    edge = pose[0, :3] + scene.half_size[0] * np.array([1.0, 0.0, 1.0])
    turn = np.zeros(4)
    mujoco.mju_euler2Quat(turn, np.array([*tilt_rad, 0.0]), "xyz")
    lever, arm = np.array([0.0, 0.0, scene.half_size[1, 2]]), np.zeros(3)
    mujoco.mju_rotVecQuat(arm, lever, turn)
    pose[1, :3], pose[1, 3:] = edge + arm - np.array([0.0, 0.0, depth_m]), turn
    mujoco.mj_forward(model, data)
    return data


def depths(data: mujoco.MjData, geoms: tuple[int, int] = (2, 3)) -> FloatArray:
    """(c,) depth of each contact between two geoms as MuJoCo's solver uses it, m. The geoms of the boxes are 2 and
    3."""
    between = (np.asarray(data.contact.geom).reshape(-1, 2) == geoms).all(axis=1)
    return np.asarray(data.contact.includemargin - data.contact.dist)[between]


@pytest.mark.parametrize("physics", WITH_SKIN.values(), ids=list(WITH_SKIN))
@pytest.mark.parametrize("depth_m", [-2e-5, 5e-5, 3e-4])
def test_contacts_begin_where_the_boxes_touch(physics: Physics, depth_m: float) -> None:
    depths_m = depths(contacts(physics, depth_m))
    np.testing.assert_allclose(depths_m, [depth_m] * 4 if depth_m > 0 else [], atol=1e-9)


@pytest.mark.parametrize("physics", WITH_SKIN.values(), ids=list(WITH_SKIN))
def test_so_they_do_on_the_floor(physics: Physics) -> None:
    model = build_spec(make_scene([LOWER]), physics).compile()
    data = mujoco.MjData(model)
    data.qpos[7:10] = (3.0, 3.0, physics.floor_z_m + 0.1 - 5e-5)  # beside the carrier
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(depths(data, (0, 2)), [5e-5] * 4, atol=1e-9)


def test_masses_and_inertias_are_those_of_the_boxes() -> None:
    """Inertias are compared in sorted order, because MuJoCo sorts the axes if it computes the inertia itself."""
    scene = make_scene([LOWER, UPPER])
    bare, skinned = (build_spec(scene, physics).compile() for physics in (WITHOUT, WITH_SKIN["declared pairs"]))
    np.testing.assert_allclose(skinned.body_mass, bare.body_mass)
    np.testing.assert_allclose(np.sort(skinned.body_inertia), np.sort(bare.body_inertia), rtol=1e-12)
    np.testing.assert_allclose(skinned.body_ipos, bare.body_ipos, atol=1e-12)
    skins = [[2 * SKIN_M]] + [[SKIN_M]] * 2  # carrier, boxes
    np.testing.assert_allclose(skinned.geom_size[1:] - bare.geom_size[1:], skins * np.ones((1, 3)), rtol=1e-9)


def test_a_box_that_leans_on_an_edge_rests_on_two_points_at_any_depth() -> None:
    """The upper box leans on an edge of the lower box, which is longer than the upper box. Without a skin, the
    collision detection finds either the point at which two edges cross, or two points of a face, for which the depth is
    5 % smaller. With a skin, it always finds two points."""
    within = 1e-6 * np.arange(60, 200, 5)
    points = {
        name: {len(depths(contacts(physics, depth, tilt_rad=(1e-4, 3e-3)))) for depth in within}
        for name, physics in (("bare", WITHOUT), ("skin", PHYSICS["pallet"]))
    }
    assert points == {"bare": {1, 2}, "skin": {2}}


def test_a_box_flush_with_the_carriers_edge_stands_on_its_four_corners() -> None:
    """The carrier is as large as the box, so the box is flush with the carrier's edges. The box is moved by less than
    the depth of a contact. Without a skin, the collision detection also finds the points at which the box's edges cross
    those of the carrier."""
    random = np.random.default_rng(1)
    places = [(random.uniform(-5e-5, 5e-5, 2), random.uniform(-1e-4, 1e-4, 3)) for _ in range(200)]

    def numbers(physics: Physics) -> set[int]:
        scene = make_scene([LOWER])
        model = build_spec(scene, physics).compile()
        data = mujoco.MjData(model)
        carrier, box = data.qpos.reshape(-1, 7)
        counts = set()
        for shift, turn in places:
            carrier[:] = [*scene.carrier.pos, 1.0, 0.0, 0.0, 0.0]
            box[:3] = scene.carrier.pos
            box[:2] += shift
            box[2] += scene.carrier.half_size[0][2] + scene.half_size[0, 2] - 5e-5
            mujoco.mju_euler2Quat(box[3:], turn, "xyz")
            mujoco.mj_forward(model, data)
            counts.add(len(depths(data, (1, 2))))
        return counts

    assert numbers(PHYSICS["pallet"]) == {4}
    assert numbers(WITHOUT) > {4}


def test_an_exported_model_has_the_skin() -> None:
    scene, physics = make_scene([LOWER, UPPER]), WITH_SKIN["declared pairs"]
    built, exported = build_spec(scene, physics).compile(), mujoco.MjModel.from_xml_string(to_mjcf(scene, physics))
    for name in ("geom_size", "geom_margin", "pair_margin", "body_mass", "body_inertia", "body_iquat"):
        np.testing.assert_allclose(getattr(exported, name), getattr(built, name), rtol=1e-5, err_msg=name)
