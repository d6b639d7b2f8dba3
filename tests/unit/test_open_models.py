"""Models of open worlds (to which boxes are added): a model filled in from a template equals the model that MuJoCo
compiles, and a box that is added to the arrays of a scene becomes the scene's last box."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from support.plans import heap, make_plan

from petmjx.engines.metrics import BoxMetrics
from petmjx.engines.mujoco.open_models import MOST_SPARE, Templates, set_options
from petmjx.engines.verdict import Flag, judge, judge_all
from petmjx.options.simulation import Simulation
from petmjx.options.thresholds import Thresholds
from petmjx.world.growing_scenes import EmptyCarrier, NextBoxes, OpenScenes
from petmjx.world.mujoco_model import add_boxes, build_spec
from petmjx.world.release_places import release_of, release_of_next
from petmjx.world.scene import OF_BOXES, Scene, build_scene

UNUSED = {"qpos_spring", "geom_rgba", "names_map"}
"""Fields of a model that petmjx does not fill in, since it never reads them: they are for springs, for pictures, and
for names."""


def numbers_of(record: Any) -> dict[str, Any]:
    attributes = {name: getattr(record, name) for name in dir(record) if not name.startswith("_")}
    return {name: value for name, value in attributes.items() if isinstance(value, np.ndarray | int | float)}


@pytest.mark.parametrize("carrier", ["euro-pallet", "epal-1"])
def test_a_filled_model_is_the_compiled_one(carrier: str) -> None:
    sim = Simulation(carrier=carrier, solver_iterations=7)
    scene = build_scene(make_plan("heap", heap(9)), sim)
    scene = Scene(**{**vars(scene), "friction": scene.friction * np.linspace(0.5, 2.0, 9)[:, None]})
    other = build_scene(make_plan("other", [((200, 200, 200), (k * 10, 0, 200 * k), 3 + k) for k in range(9)]), sim)
    templates = Templates.of(sim)
    assert templates is not None
    # the model that is given back is filled in again for the next scene
    templates.give_back(templates.filled(other, np.arange(9)), other, 9)
    order = np.array([3, 0, 8, 1, 7, 2, 4, 6, 5])
    model, _ = templates.filled(scene, order)
    spec = build_spec(scene, sim.physics, n_boxes=0)
    add_boxes(spec, scene, sim.physics, order.tolist())
    compiled = spec.compile()
    set_options(compiled, sim)
    for name, value in numbers_of(compiled).items():
        if name not in UNUSED:
            np.testing.assert_array_equal(getattr(model, name), value, name)
    for name, value in numbers_of(compiled.opt).items():
        np.testing.assert_array_equal(getattr(model.opt, name), value, name)
    assert model.stat.meaninertia == compiled.stat.meaninertia


def test_what_is_lent_is_bounded() -> None:
    sim = Simulation(carrier="euro-pallet")
    scene, templates = build_scene(make_plan("p", 1), sim), Templates.of(sim)
    assert templates is not None
    models = [templates.filled(scene, np.arange(1)) for _ in range(MOST_SPARE + 3)]
    for model in models:
        templates.give_back(model, scene, 1)
    (template,) = templates._by_key.values()
    assert len(template._spare) == MOST_SPARE
    assert isinstance(models[0].data, mujoco.MjData)


@pytest.mark.parametrize("physics", ["pallet", "reference"])
def test_one_box_more_in_arrays_is_the_last_of_a_scene(physics: str) -> None:
    sim = Simulation(carrier="euro-pallet", physics=physics)
    plan = make_plan("heap", heap(30))
    full_scene, blank = build_scene(plan, sim), EmptyCarrier(sim)
    boxes = NextBoxes.of(plan.size_mm, plan.corner_mm, plan.mass_kg, sim)
    scene, grown = blank.scene, []
    for row in range(30):
        scene = blank.with_box(scene, boxes, row)
        grown.append(scene)
    for name in OF_BOXES:
        if getattr(full_scene, name) is not None:
            np.testing.assert_array_equal(getattr(scene, name), getattr(full_scene, name))
    growing = OpenScenes([blank.scene, *grown[:-1]], blank)
    stacks = growing.stacks(range(30))
    growing.add(range(30), boxes)
    growing.copy([29, 3], [0, 1])
    assert [growing[world].n_boxes for world in (0, 1, 2, 29)] == [30, 4, 3, 30]
    for name in OF_BOXES:
        if getattr(full_scene, name) is not None:
            np.testing.assert_array_equal(getattr(growing[0], name), getattr(full_scene, name))
    release = release_of_next(stacks, boxes, sim)
    expected = release_of(full_scene, sim)
    np.testing.assert_array_equal(release.support, expected.support)
    np.testing.assert_array_equal(release.pos, expected.pos)
    half, target = stacks.with_next(boxes)
    np.testing.assert_array_equal(half[-1], full_scene.half_size)
    np.testing.assert_array_equal(target[4, :5], full_scene.target[:5])
    assert np.isnan(target[4, 5:]).all()


def test_many_worlds_are_judged_as_one() -> None:
    rng, limits = np.random.default_rng(1), Thresholds()
    m, k = 300, 3
    flags = np.where(rng.random(m) < 0.3, 2 ** rng.integers(0, 14, m), 0)
    dropped, tilt = rng.random((m, k)) < 0.05, rng.uniform(0, 23, (m, k))
    shift, placed = rng.uniform(-0.022, 0.022, (m, k, 3)), rng.integers(0, k + 1, m)
    beyond = np.arange(k) >= placed[:, None]
    dropped[beyond], tilt[beyond], shift[beyond] = False, np.nan, np.nan
    all_boxes = BoxMetrics.measured(m, k, shift_m=shift, max_tilt_deg=tilt, dropped=dropped)
    verdict, reason = judge_all(flags, all_boxes, limits)
    for row in range(m):
        boxes = BoxMetrics.measured(k, shift_m=shift[row], max_tilt_deg=tilt[row], dropped=dropped[row])
        assert (verdict[row], reason[row]) == judge(Flag(int(flags[row])), boxes, int(placed[row]), limits)
    assert len(set(reason)) > 8
