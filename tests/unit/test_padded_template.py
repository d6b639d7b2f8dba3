"""The padded MJX template with its values for each world equals the exact model that MuJoCo compiles."""

from __future__ import annotations

from typing import Any

import jax
import mujoco
import numpy as np
import pytest
from mujoco import mjx
from support.fake_stepper import fake_scene
from support.plans import on_boards

from petmjx.engines.mjx.padded_template import override_fields, padded_template, parked_positions
from petmjx.engines.mjx.world_constants import upload_worlds
from petmjx.options.physics import PHYSICS, Physics
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job
from petmjx.world.mujoco_model import HeldCarrier, build_spec
from petmjx.world.scene import Scene

CAPACITY = 4
ROUNDING = 2e-6
"""Tolerance for the rounding errors of a few float32 operations."""

PER_BODY = ("body_mass", "body_inertia", "body_subtreemass", "body_invweight0")
PER_GEOM = ("geom_pos", "geom_size", "geom_rbound", "geom_aabb", "geom_friction")


def scene_of_boxes(n: int) -> Scene:
    scene = fake_scene(*np.linspace(0.3, 14.0, n))
    scene.half_size[:] = np.random.default_rng(n).uniform(0.04, 0.3, (n, 3))
    return scene


def template(physics: Physics, *, held: bool, boards: int = 1) -> mujoco.MjModel:
    return padded_template(CAPACITY, boards, Simulation(physics=physics), held=held)


def overrides(scenes: list[Scene], base: Any, *, held: bool, physics: Physics) -> dict[str, jax.Array]:
    worlds = upload_worlds([Job(scene) for scene in scenes], len(scenes), CAPACITY, {}, Simulation())
    return override_fields(worlds, base, held=held, physics=physics)


@pytest.mark.parametrize("physics", list(PHYSICS))
@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("boards", [1, 2])
def test_overrides_are_what_mujoco_compiles(physics: str, held: bool, boards: int) -> None:
    scenes = [scene_of_boxes(n) for n in (1, 3, CAPACITY)]
    if boards > 1:
        scenes = [on_boards(scene) for scene in scenes]
    base = mjx.put_model(template(PHYSICS[physics], held=held, boards=boards), impl="jax")
    fields = overrides(scenes, base, held=held, physics=PHYSICS[physics])
    for lane, scene in enumerate(scenes):
        carrier = HeldCarrier(scene.carrier.pos, np.array([1.0, 0, 0, 0])) if held else None
        exact = build_spec(scene, PHYSICS[physics], carrier).compile()
        used = dict.fromkeys(PER_BODY, scene.n_boxes + 2) | dict.fromkeys(PER_GEOM, exact.ngeom)
        for name in (*PER_BODY, *PER_GEOM):
            if name not in fields:
                continue
            actual, expected = np.asarray(fields[name][lane])[: used[name]], getattr(exact, name)
            if name == "body_subtreemass":  # the subtree mass of the world body also counts the boxes of the padding
                actual, expected = actual[1:], expected[1:]
            if name == "body_inertia":  # MuJoCo sorts the principal axes of inertia
                actual, expected = np.sort(actual), np.sort(expected)
            if name in (
                "geom_pos",
                "geom_size",
                "geom_aabb",
                "geom_rbound",
            ):  # the floor's value is infinite or has no meaning
                actual, expected = actual[1:], expected[1:]
            np.testing.assert_allclose(actual.reshape(expected.shape), expected, rtol=ROUNDING, atol=1e-7, err_msg=name)
        pairs = same_pairs(base, exact)
        assert len(pairs) == exact.npair
        for pair, its_pair in pairs:
            friction = fields["pair_friction"][lane][pair]
            np.testing.assert_allclose(friction, exact.pair_friction[its_pair], rtol=ROUNDING)
            np.testing.assert_allclose(base.pair_margin[pair], exact.pair_margin[its_pair], rtol=ROUNDING)
        dofs = exact.nv
        np.testing.assert_allclose(fields["dof_invweight0"][lane][:dofs], exact.dof_invweight0, rtol=ROUNDING)


def same_pairs(padded: Any, exact: mujoco.MjModel) -> list[tuple[int, int]]:
    """Declared pairs of geoms that both models have: the number of each pair in the padded model and in the exact
    model."""

    def numbers(model: Any) -> dict[tuple[int, ...], int]:
        ends = np.sort(np.stack([model.pair_geom1, model.pair_geom2], axis=-1), axis=-1)
        return {tuple(int(geom) for geom in pair): number for number, pair in enumerate(ends)}

    mine, its = numbers(padded), numbers(exact)
    return [(mine[pair], its[pair]) for pair in mine.keys() & its.keys()]


def test_the_template_has_the_options_and_contact_numbers_of_the_exact_model() -> None:
    for physics in PHYSICS.values():
        padded, exact = template(physics, held=False), build_spec(scene_of_boxes(2), physics).compile()
        for name in ("timestep", "cone", "integrator", "solver", "impratio"):
            assert getattr(padded.opt, name) == getattr(exact.opt, name), name
        np.testing.assert_array_equal(padded.opt.gravity, exact.opt.gravity)
        for name in ("geom_solref", "geom_solimp", "geom_gap", "geom_margin", "geom_condim", "geom_type"):
            np.testing.assert_array_equal(getattr(padded, name)[:4], getattr(exact, name), err_msg=name)
        np.testing.assert_array_equal(padded.geom_pos[0], exact.geom_pos[0])
        for pair, its_pair in same_pairs(padded, exact):
            for name in ("pair_solref", "pair_solreffriction", "pair_solimp", "pair_dim", "pair_gap", "pair_margin"):
                np.testing.assert_array_equal(getattr(padded, name)[pair], getattr(exact, name)[its_pair], err_msg=name)


@pytest.mark.parametrize("held", [False, True])
def test_every_two_geoms_that_can_touch_are_declared_once(held: bool) -> None:
    """MuJoCo tests declared pairs for contact whatever their contype. A carrier that is held fast cannot touch the
    floor, so this pair is not declared."""
    scene = scene_of_boxes(4)
    carrier = HeldCarrier(scene.carrier.pos, np.array([1.0, 0, 0, 0])) if held else None
    model = build_spec(scene, PHYSICS["pallet"], carrier).compile()
    pairs = {frozenset((int(one), int(two))) for one, two in zip(model.pair_geom1, model.pair_geom2, strict=True)}
    geoms = range(model.ngeom)
    assert len(pairs) == model.npair
    assert pairs == {frozenset((a, b)) for a in geoms for b in geoms if a < b and not (held and b == 1)}
    assert not model.geom_contype.any()
    assert not model.geom_conaffinity.any()
    assert build_spec(scene, PHYSICS["reference"], carrier).compile().npair == 0


def test_parked_boxes_touch_nothing() -> None:
    model = template(PHYSICS["pallet"], held=False)
    model.geom_size[2:] = 0.6  # half sizes that are larger than those of any item
    model.geom_rbound[2:] = 0.6 * np.sqrt(3)
    data = mujoco.MjData(model)
    rows = data.qpos.reshape(-1, 7)
    rows[0, :3] = (0.4, 0.3, -0.072 + 1e-3)
    rows[1:, :3] = np.asarray(parked_positions(CAPACITY))
    mujoco.mj_forward(model, data)
    assert data.ncon == 0
    # Neither the bounding spheres of two waiting boxes meet, nor that of a waiting box and a pallet 3 m high.
    gaps = np.linalg.norm(rows[1:, None, :3] - rows[None, 1:, :3], axis=-1) + 1e3 * np.eye(CAPACITY)
    assert gaps.min() > 2 * 0.6 * np.sqrt(3)
    assert rows[1:, 2].min() - 0.6 * np.sqrt(3) > 3.0
