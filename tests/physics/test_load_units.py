"""Plans whose boxes include loaded pallets: the pallets slide on a floor at their own friction, tip as a whole, and can
stand on each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from support.plans import Triple, make_plan

import petmjx
from petmjx.common.errors import InputError
from petmjx.engines.protocol import Engine
from petmjx.engines.verdict import Outcome
from petmjx.options.carriers import Carrier
from petmjx.options.materials import friction_between, kinetic_share_between
from petmjx.options.simulation import Check, Schedule, Simulation
from petmjx.plans.plan import Plan
from petmjx.plans.plan_fields import PALLET_KINDS
from petmjx.runs.hopeless_profiles import slide_m
from petmjx.show.file_info import file_infos
from petmjx.world.carrier_boards import pallet
from petmjx.world.job import ACCELERATION, Drive, Excitation, Job
from petmjx.world.option_lint import notes_about
from petmjx.world.scene import build_scene
from petmjx.world.supports import bearing_of

G = 9.81
EPAL_MM = PALLET_KINDS["epal-1"].size_mm
MARGIN = 0.03
"""Required accuracy of thresholds: at 3 % below a threshold, a load stays; at 3 % above, it slides or topples."""
WAY = 0.03
"""Required relative accuracy of the distance that a load slides."""

SHAKEN = Simulation(check=Check.STATIC, schedule=Schedule.FIXED, settle_s=0.4, early_stop=False)


def unit(corner_mm: Triple, height_mm: float, kg: float, material: str = "wood") -> Plan:
    """A plan with a pallet and a block on it that is as large as the pallet's deck."""
    return units([corner_mm], height_mm, kg, material)


def units(corners_mm: Sequence[Triple], height_mm: float, kg: float, material: str = "wood") -> Plan:
    block = make_plan("block", [((1200.0, 800.0, height_mm), (0.0, 0.0, 0.0), kg)])
    load = replace(block, materials=("cardboard",))
    return Plan.of_units("units", [load] * len(corners_mm), corners_mm, material=material)


def shaken(engine: Engine, plan: Plan, sim: Simulation, acceleration: np.ndarray) -> Outcome:
    drive = Drive(Excitation("throw", ACCELERATION, acceleration), rest_s=1.0)
    with jax.numpy_rank_promotion("allow"):  # MJX broadcasts arrays of different ranks, as NumPy does
        (outcome,) = engine.run([Job(build_scene(plan, sim), drive)], sim)
    return outcome


def level(level_g: float, axis: int, ramp: int = 150, hold: int = 150) -> np.ndarray:
    """An acceleration that increases for ``ramp`` steps and then stays constant for ``hold`` steps."""
    rows = np.zeros((ramp + hold, 3))
    rows[:, axis] = -level_g * G * np.append(np.linspace(0.0, 1.0, ramp), np.ones(hold))
    return rows


def engine_of(name: str) -> Engine:
    from petmjx.engines.engine_registry import make_engine

    return make_engine(name)


@pytest.mark.parametrize("kind", PALLET_KINDS)
def test_pallets_have_the_extents_and_masses_of_carriers(kind: str) -> None:
    boards = pallet(Carrier(kind))
    assert boards is not None
    ends = [np.add(corner, size) for corner, size in boards.boards]
    np.testing.assert_allclose(np.max(ends, axis=0), PALLET_KINDS[kind].size_mm)
    assert sum(boards.masses_kg) == pytest.approx(PALLET_KINDS[kind].mass_kg)


def test_units_are_joined_pallet_after_pallet() -> None:
    loads = [replace(make_plan("a", 2), stiffness_n_mm=np.array([5.0, 6.0])), make_plan("b", 1)]
    plan = Plan.of_units("two", loads, [(0, 0, 0), (1300, 100, 0)], pallet="gma-48x40", material="wood")
    assert plan.kinds == ("gma-48x40", "", "", "gma-48x40", "")
    assert plan.materials == ("wood", "", "", "wood", "")
    np.testing.assert_array_equal(plan.stiffness_n_mm, [np.nan, 5.0, 6.0, np.nan, np.nan])
    np.testing.assert_array_equal(plan.corner_mm[:, 2], [0, 121, 321, 0, 121])
    np.testing.assert_array_equal(plan.corner_mm[4, :2], [1300, 100])
    np.testing.assert_array_equal(plan.mass_kg, [20, 5, 5, 20, 5])
    assert Plan.of_units("heavy", loads[1:], [(0, 0, 0)], pallet_kg=30.0).mass_kg[0] == 30
    with pytest.raises(InputError, match="corner_mm must have a corner for each of 2 loads, got 1"):
        Plan.of_units("two", loads, [(0, 0, 0)])
    for not_plans, why in (["load"], r"loads\[0\] must be"), (loads[0], "loads must be a list of"):
        with pytest.raises(InputError, match=why):
            Plan.of_units("two", not_plans, [(0, 0, 0)])
    with pytest.raises(InputError, match="the plan id must be text and not empty"):
        Plan.of_units("", loads, [(0, 0, 0)] * 2)
    with pytest.raises(InputError, match=r"pallet must be epal-1.*, got 'skid'"):
        Plan.of_units("two", loads, [(0, 0, 0)] * 2, pallet="skid")


def test_a_pallet_is_a_body_of_boards_that_bears_on_its_deck() -> None:
    plan = unit((0.0, 0.0, 0.0), 300.0, 200.0)
    scene = build_scene(plan, Simulation(carrier="trailer"))
    carrier = build_scene(
        make_plan(boxes=[((1200.0, 800.0, 100.0), (0.0, 0.0, 0.0), 1.0)]), Simulation(carrier="epal-1")
    ).carrier
    rows = scene.shapes.of(0)
    assert len(rows) == len(carrier.half_size)
    np.testing.assert_allclose(scene.shapes.half_size[rows], carrier.half_size, atol=1e-4)
    np.testing.assert_allclose(scene.shapes.pos[rows], carrier.shape_pos, atol=1e-4)
    np.testing.assert_allclose(scene.inertia_boxes[1], carrier.inertia_box, atol=1e-4)
    bearing = bearing_of(scene)
    on_deck = bearing.upper == 1
    assert on_deck.sum() == 5  # number of boards of the deck
    width = (bearing.high - bearing.low)[on_deck, 1].sum()
    assert width == pytest.approx(2 * 0.1 + 3 * 0.145, abs=1e-3)
    turned = replace(plan, size_mm=plan.size_mm[:, [1, 0, 2]])
    across = build_scene(turned, Simulation(carrier="trailer"))
    np.testing.assert_allclose(across.shapes.half_size[rows], carrier.half_size[:, [1, 0, 2]], atol=1e-4)


@pytest.mark.parametrize("material", ["wood", "hdpe"])
@pytest.mark.parametrize("name", ["mujoco", "mjx-warp-cpu"])
def test_a_loaded_pallet_slides_on_a_trailers_floor_at_its_friction(name: str, material: str) -> None:
    """The pallet begins to slide at the static friction, and slides as far as Newton's law predicts with the kinetic
    friction."""
    static = friction_between(material, "trailer floor", ())
    share = kinetic_share_between(material, "trailer floor", ())
    assert static is not None
    assert share is not None
    plan = unit((2000.0, 800.0, 0.0), 400.0, 200.0, material)
    sim = SHAKEN.changed(
        carrier="trailer", walls=[], friction_pairs=[{"between": ["cardboard", material], "friction": 0.6}]
    )
    engine = engine_of(name)
    stays = shaken(engine, plan, sim, level((1.0 - MARGIN) * static, axis=0))
    assert stays.boxes.max_sway_m.max() < 0.002
    push = np.vstack([level(1.5 * static, axis=0), np.zeros((250, 3))])
    slides = shaken(engine, plan, sim, push)
    expected = slide_m(-push, static, G, sim.physics.timestep_s, kinetic=share)
    assert expected > 0.1
    np.testing.assert_allclose(slides.boxes.shift_m[:, 0], expected, rtol=WAY)
    assert np.abs(slides.boxes.shift_m[0] - slides.boxes.shift_m[1]).max() < 0.002  # the load moves with the pallet
    whole = slide_m(-push, static, G, sim.physics.timestep_s)
    assert abs(whole / expected - 1.0) > 5 * WAY  # with static friction alone, the distance would be different


@pytest.mark.parametrize("name", ["mujoco", "mjx-warp-cpu"])
def test_two_loaded_pallets_on_each_other_topple_as_one(name: str) -> None:
    """Two loaded pallets topple at the acceleration g·b/h, for the common centre of mass of the pile."""
    height, kg = 1000.0, 200.0
    plan = units([(3000.0, 800.0, z) for z in (0.0, EPAL_MM[2] + height)], height, kg)
    sim = SHAKEN.changed(
        carrier="trailer", walls=[], friction_pairs=[{"between": ["wood", "trailer floor"], "friction": 0.6}]
    )
    scene = build_scene(plan, sim)
    places = scene.frames(scene.target, scene.start_quat)
    centre_m = scene.mass @ places[:, 2] / scene.mass.sum()
    threshold_g = scene.half_size[0, 1] / centre_m
    assert threshold_g < 0.4
    engine = engine_of(name)
    below = shaken(engine, plan, sim, level((1.0 - MARGIN) * threshold_g, axis=1, ramp=250, hold=1250))
    above = shaken(engine, plan, sim, level((1.0 + MARGIN) * threshold_g, axis=1, ramp=250, hold=1250))
    assert below.boxes.max_tilt_deg.max() < 1.0
    assert above.boxes.max_tilt_deg[0] > 20.0
    assert above.boxes.max_tilt_deg[2] > 20.0


def test_film_around_pallets_is_refused() -> None:
    with pytest.raises(InputError, match=r"^plan units: wrap\.turns: this plan has pallets among its boxes, and film"):
        notes_about(Simulation(carrier="trailer", wrap={"turns": 3}), [unit((0.0, 0.0, 0.0), 400.0, 200.0)])


@pytest.mark.parametrize("name", ["plans.json", "plans.csv", "plans.parquet"])
def test_a_plan_with_a_pallet_of_another_size_is_skipped(name: str, tmp_path: Path) -> None:
    line = "kind epal-1 must be 1200 × 800 × 144 mm, or turned by 90°, got 1100 × 800 × 144"
    plan = unit((0.0, 0.0, 0.0), 400.0, 200.0)
    size_mm = plan.size_mm - [[100.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    with pytest.raises(InputError, match=f"^box 0: {line}$"):
        replace(plan, size_mm=size_mm)
    columns = {"size_mm": size_mm, "corner_mm": plan.corner_mm, "mass_kg": plan.mass_kg}
    with pytest.raises(InputError, match=f"^plan wrong, box 0: {line}$"):
        Plan.from_boxes("wrong", **columns, kind=list(plan.kinds))
    wrong = replace(plan, plan_id="wrong")
    object.__setattr__(wrong, "size_mm", size_mm)  # as a file by another program might have it
    petmjx.save_plans([wrong, plan], tmp_path / name)
    (info,), _ = file_infos([tmp_path / name], {})
    (skipped,) = info["skipped"]
    assert (info["plan_ids"], skipped.endswith(line)) == (["units"], True)
    assert f"{tmp_path / name}: plan wrong, " in skipped


def test_a_pair_that_slides_better_at_rest_is_refused() -> None:
    with pytest.raises(InputError, match=r"friction_pairs\[0\]\.kinetic must be ≤ friction, 0.3, got 0.4"):
        Simulation(friction_pairs=[{"between": ["a", "b"], "friction": 0.3, "kinetic": 0.4}])


def test_plans_with_pallets_are_written_and_read(tmp_path: Path) -> None:
    plan = unit((0.0, 0.0, 0.0), 400.0, 200.0)
    for name in ("plans.json", "plans.csv"):
        petmjx.save_plans([plan], tmp_path / name)
        (read,) = petmjx.load_plans(tmp_path / name).plans
        assert read.kinds == plan.kinds
