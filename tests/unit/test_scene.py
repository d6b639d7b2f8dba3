"""Scenes that are made together for many plans equal scenes that are made one by one, to the last bit."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from support.plans import make_plan

from petmjx.options.simulation import Simulation
from petmjx.packers.sample_plans import generate_one
from petmjx.plans.plan import Plan
from petmjx.plans.plan_decoder import DecoderOptions, parse_plan
from petmjx.world import scene as scenes
from petmjx.world.body_shapes import Body
from petmjx.world.scene import Scene, build_scene


def _plans() -> list[Plan]:
    plans = [parse_plan(name, boxes, DecoderOptions("f")) for name, boxes in (generate_one(k, 3) for k in range(5))]
    plain = plans[1]
    return [
        *plans[:2],
        replace(plain, plan_id="weighted", mass_center_mm=np.full((plain.n_boxes, 3), 1.0)),
        replace(plain, plan_id="named", materials=("cardboard",) * plain.n_boxes),
        make_plan("one", 1),
        *plans[2:],
    ]


def _same(one: Any, other: Any) -> None:
    for field in fields(one):
        value, its = getattr(one, field.name), getattr(other, field.name)
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(its, value, strict=True)
        elif isinstance(value, Body):
            _same(value, its)
        elif isinstance(value, dict):
            np.testing.assert_equal(its, value)
        else:
            assert its == value, field.name


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"physics": "reference"},
        {"carrier": "euro-pallet"},
        {"carrier": "epal-1"},
        {"placing": "hand", "size_reduction_mm": 0.7},
    ],
)
@pytest.mark.parametrize("at_a_time", [2, 512])
def test_scenes_are_the_same_to_the_last_bit(
    options: dict[str, Any], at_a_time: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scenes, "AT_A_TIME", at_a_time)
    sim, plans = Simulation(**options), _plans()
    made = list(scenes.build_scenes(iter(plans), sim))
    assert len(made) == len(plans)
    for scene, plan in zip(made, plans, strict=True):
        assert type(scene) is Scene
        _same(build_scene(plan, sim), scene)
