"""Compressible boxes act as springs: on all engines, the depth by which boxes sink agrees with closed forms."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from support.plans import Box, make_plan, make_scene
from support.tiny_worlds import shared_engine

import petmjx
from petmjx.common.units import FloatArray
from petmjx.engines.mjx.compliance import laws
from petmjx.engines.mjx.padded_template import padded_template
from petmjx.engines.mjx.world_constants import upload_worlds
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Engine
from petmjx.engines.verdict import Flag, Outcome, Verdict
from petmjx.options.simulation import Simulation
from petmjx.options.wrap import Wrap
from petmjx.plans.articles import Article, Articles, with_articles
from petmjx.world.compliance import sinks_m
from petmjx.world.job import Drive, Excitation, Job
from petmjx.world.mujoco_model import HeldCarrier, build_spec
from petmjx.world.scene import IDENTITY_QUAT, Scene, build_scene
from petmjx.world.supports import bearing_of
from petmjx.world.surface_pairs import check_surfaces

GRAVITY = 9.81
WITHIN = 0.05
"""Required relative accuracy of the depth of springs."""
AGREES_M = 2e-5
"""Tolerance of places between engines, m. Differences come from single precision, and from contacts that begin a
timestep earlier or later. The measured difference was 0.004 mm."""
LEANS_WITHIN = 0.03
"""Relative tolerance of the tilt of a bed of springs. The measured difference was 1 %."""
SIM = Simulation()
SIZE = (400.0, 300.0, 200.0)
SOFT, STIFF = 20e3, 200e3
"""Stiffnesses, N/m. Under the loads of these tests, they give depths of 0.7 to 15 mm."""


def tower(*boxes: tuple[float, float], **options: object) -> Scene:
    """A scene of boxes on top of each other, with these masses, kg, and stiffnesses, N/m."""
    rows: list[Box] = [(SIZE, (0.0, 0.0, 200.0 * level), mass) for level, (mass, _) in enumerate(boxes)]
    return replace(make_scene(rows, Simulation(**options)), stiffness=np.array([stiffness for _, stiffness in boxes]))


SCENES = {
    "soft": tower((10.0, SOFT), (20.0, np.inf)),
    "stiff": tower((10.0, STIFF), (50.0, np.inf)),
    "alone": tower((40.0, SOFT)),
    "two": tower((10.0, STIFF), (10.0, SOFT)),
    "boards": tower((10.0, STIFF), (50.0, np.inf), carrier="epal-1"),
}
TOWERS: list[Box] = [
    ((300, 400, 200), (0, 0, 0), 8),
    ((300, 400, 200), (600, 0, 0), 8),
    ((900, 400, 3), (0, 0, 200), 0.4),
]
ON_TOWERS: list[Box] = [((300, 400, 200), (0, 0, 203), 10), ((300, 400, 200), (600, 0, 203), 10)]
OVER_THE_GAP: list[Box] = [((250, 400, 200), (325, 0, 203), 3)]
SHEETS = {
    "borne": build_scene(replace(make_plan(boxes=TOWERS + ON_TOWERS), kinds=("", "", "sheet", "", "")), SIM),
    "bridge": build_scene(replace(make_plan(boxes=TOWERS + OVER_THE_GAP), kinds=("", "", "sheet", "")), SIM),
    "plate": make_scene(TOWERS + OVER_THE_GAP, SIM),
}
"""Two towers 300 mm apart, with a sheet on them; and, in "plate", with a thin board instead of the sheet."""
COLUMN_M, COLUMN_MASS = (0.3, 0.25), np.array([6.0, 6.0, 40.0])
"""A column of two compressible boxes and a rigid box: length and height of each box, m, and the masses from the bottom
up, kg."""
SERIES = np.array([2.0, 1.0, 2.0])
"""Stiffness of each bed of springs in a column, as a multiple of the stiffness of a box. At an end of the column, half
a box is compressed; between two boxes, half of each."""
BUCKLING = 1.1
"""Factor by which the stiffness of columns is below or above the stiffness at which they buckle."""


def beds_and_weights() -> tuple[FloatArray, FloatArray]:
    """(3, 3) moments of the beds per stiffness and per tilt of each box, and (3, 3) moments of the weights per tilt of
    each box."""
    length, height = COLUMN_M
    relative = np.eye(3) - np.eye(3, k=-1)
    beds = relative.T @ np.diag(SERIES * length**2 / 12) @ relative
    above = np.append(np.cumsum(COLUMN_MASS[::-1])[::-1][1:], 0.0)
    return beds, np.diag(GRAVITY * height * (COLUMN_MASS / 2 + above))


def column(share_of_critical: float, aside_mm: float) -> Scene:
    """A column whose boxes have the given share of the stiffness at which the column buckles. The load is offset by
    ``aside_mm``."""
    beds, weights = beds_and_weights()
    critical = float(np.linalg.eigvals(np.linalg.solve(beds, weights)).real.max())
    rows: list[Box] = [
        ((300.0, 300.0, 250.0), (aside_mm * (level == 2), 0.0, 250.0 * level), mass)
        for level, mass in enumerate(COLUMN_MASS.tolist())
    ]
    stiffness = share_of_critical * critical
    return replace(make_scene(rows, SIM), stiffness=np.array([stiffness, stiffness, np.inf]))


PLATE: list[Box] = [
    ((400, 400, 200), (0, 0, 0), 4),
    ((400, 400, 50), (0, 0, 200), 2),
    ((100, 400, 100), (190, 0, 250), 30),
]
"""A load, offset by 40 mm, on a plate on a compressible box."""
COLUMNS = {
    "buckles": column(1 / BUCKLING, 1.0),
    "stands": column(BUCKLING, 0.5),
    "leans": replace(make_scene(PLATE, SIM), stiffness=np.array([50e3, np.inf, np.inf])),
}
BORNE = 245.0 / 300.0
"""Share of the lowest box's base that is borne by the boards of epal-1: 145 mm and 100 mm of 300 mm."""
MEANT_M = {
    "soft": [30 * GRAVITY / (2 * SOFT), 30 * GRAVITY / (2 * SOFT) + 20 * GRAVITY / (2 * SOFT)],
    "stiff": [60 * GRAVITY / (2 * STIFF), 60 * GRAVITY / (2 * STIFF) + 50 * GRAVITY / (2 * STIFF)],
    "alone": [40 * GRAVITY / (2 * SOFT)],
    "two": [
        20 * GRAVITY / (2 * STIFF),
        20 * GRAVITY / (2 * STIFF) + 10 * GRAVITY * (1 / (2 * STIFF) + 1 / (2 * SOFT)),
    ],
    "boards": [
        60 * GRAVITY / (2 * STIFF * BORNE),
        60 * GRAVITY / (2 * STIFF * BORNE) + 50 * GRAVITY / (2 * STIFF),
    ],
}
"""Expected depths by which boxes sink, m. At each face, half of a box is compressed, in series with half of the other
box. On boards, only the borne share of a face acts as a spring."""


@functools.cache
def simulated(engine: str) -> dict[str, Outcome]:
    made: Engine = MujocoEngine(1) if engine == "mujoco" else shared_engine()
    scenes = SCENES | SHEETS | COLUMNS
    # a job with film, so that the same compiled kernel serves this file and test_wrap.py
    wrapped = Job(
        replace(SCENES["alone"], wrap=Wrap(turns=1)), Drive(Excitation("still", "acceleration", np.zeros((1, 3))))
    )
    outcomes = made.run([*(Job(scene) for scene in scenes.values()), wrapped], SIM)
    return {list(scenes)[outcome.job]: outcome for outcome in outcomes if outcome.job < len(scenes)}


def sunk_m(scene: Scene, outcome: Outcome) -> list[float]:
    """Distance by which each box has sunk relative to the carrier, m. The carrier itself sinks into the floor by 0.09
    mm."""
    carrier_m = 0.09e-3
    return (scene.target[:, 2] - outcome.boxes.pos[:, 2] - carrier_m).tolist()


@pytest.mark.parametrize("name", SCENES)
def test_boxes_sink_as_springs_do(name: str) -> None:
    outcome = simulated("mujoco")[name]
    assert outcome.verdict is Verdict.STABLE
    assert sunk_m(SCENES[name], outcome) == pytest.approx(MEANT_M[name], rel=WITHIN)
    assert sinks_m(SCENES[name], GRAVITY) == pytest.approx(MEANT_M[name], rel=0.01)


@pytest.mark.parametrize("engine", ["mujoco", "mjx-warp"])
def test_columns_buckle_where_beds_do(engine: str) -> None:
    """If springs stood only at the corners, beds would be three times as stiff, and both columns would stand."""
    outcomes = simulated(engine)
    assert outcomes["buckles"].verdict is Verdict.UNSTABLE
    assert outcomes["stands"].verdict is Verdict.STABLE
    assert not outcomes["buckles"].flags & Flag.SINKING


@pytest.mark.parametrize("engine", ["mujoco", "mjx-warp"])
def test_a_box_leans_under_a_load_aside_as_a_bed_does(engine: str) -> None:
    """The plate tilts on its bed of springs, and the box below it on its own bed. When they tilt, the weights add to
    the moment."""
    lever_m, length, bed = 0.04, 0.4, 2 * 50e3 / 12
    weights = GRAVITY * np.array([0.2 * (4 / 2 + 32), 2 * 0.025 + 30 * 0.1])
    moments = bed * length**2 * np.array([[2.0, -1.0], [-1.0, 1.0]]) - np.diag(weights)
    expected = np.linalg.solve(moments, [0.0, 30 * GRAVITY * lever_m])
    quat = simulated(engine)["leans"].boxes.quat[:2]
    assert 2 * np.arcsin(np.hypot(quat[:, 1], quat[:, 2])) == pytest.approx(expected, rel=LEANS_WITHIN)


def test_mjx_warp_lets_boxes_sink_alike() -> None:
    for name, outcome in simulated("mjx-warp").items():
        expected = simulated("mujoco")[name]
        # columns rock for seconds, so only verdicts are compared; tilts are compared with closed forms
        if name in COLUMNS:
            assert outcome.verdict is expected.verdict
            continue
        assert (outcome.verdict, outcome.reason, outcome.n_steps) == (
            expected.verdict,
            expected.reason,
            expected.n_steps,
        )
        if expected.verdict is Verdict.STABLE:
            np.testing.assert_allclose(outcome.boxes.pos, expected.boxes.pos, atol=AGREES_M)


@pytest.mark.parametrize("name", ["soft", "boards"])
@pytest.mark.parametrize("held", [False, True])
def test_the_laws_of_mjx_jax_are_those_of_mujoco(name: str, held: bool) -> None:
    """The contact laws of all pairs of bodies are compared, also with a carrier that does not move. A simulation would
    take most of a minute to compile."""
    scene = SCENES[name]
    boards, capacity = len(scene.carrier.half_size), 4
    template = padded_template(capacity, boards, SIM, held=held)
    worlds = upload_worlds([Job(scene)], 1, capacity, {}, SIM)
    inverse = 1 / worlds.mass
    inverse = inverse.at[:, 0].set(0.0) if held else inverse
    contact_laws = laws(worlds, template, inverse, SIM.physics, template.pair_solref)
    exact = build_spec(scene, SIM.physics, HeldCarrier(scene.carrier.pos, np.array(IDENTITY_QUAT)) if held else None)
    expected = exact.compile()
    row_of = {pair: row for row, pair in enumerate(zip(template.pair_geom1, template.pair_geom2, strict=True))}
    # the template also has boxes that are not used; their pairs come after those of the scene
    rows = np.array([row_of[pair] for pair in zip(expected.pair_geom1, expected.pair_geom2, strict=True)])
    assert len(rows) == expected.npair
    np.testing.assert_allclose(contact_laws["pair_solref"][0, rows], expected.pair_solref, rtol=1e-5)
    np.testing.assert_allclose(contact_laws["pair_solimp"][0, rows], expected.pair_solimp, rtol=1e-5)


def test_meant_sinking_is_no_shift_but_what_goes_beyond_it_is() -> None:
    """The boxes sink by 24.5 mm, more than the threshold of 20 mm, but as expected for their stiffness."""
    soft = tower((10.0, 10e3), (40.0, np.inf))
    (outcome,) = MujocoEngine(1).run([Job(soft)], Simulation())
    assert outcome.verdict is Verdict.STABLE
    assert (soft.target[0, 2] - outcome.boxes.pos[0, 2]) > Simulation().thresholds.shift_m
    np.testing.assert_array_equal(outcome.boxes.shift_m[:, 2], 0.0)


def test_a_box_that_does_not_give_is_as_before() -> None:
    rigid = make_scene([(SIZE, (0.0, 0.0, 0.0), 10.0), (SIZE, (0.0, 0.0, 200.0), 10.0)], Simulation())
    unyielding = replace(rigid, stiffness=np.full(2, np.inf))
    first, second = MujocoEngine(1).run([Job(rigid), Job(unyielding)], Simulation())
    np.testing.assert_array_equal(first.boxes.pos, second.boxes.pos)


def test_a_sheet_bears_where_something_bears_it_and_bridges_nothing() -> None:
    verdicts = {name: simulated("mujoco")[name].verdict for name in SHEETS}
    assert verdicts == {"borne": Verdict.STABLE, "bridge": Verdict.UNSTABLE, "plate": Verdict.STABLE}
    assert simulated("mujoco")["bridge"].culprit == 3
    bearing = bearing_of(SHEETS["borne"])
    assert bearing.lower[bearing.upper == 3].tolist() == [2]
    assert not (bearing_of(SHEETS["bridge"]).upper == 3).any()
    # in real plans, layers are not level to a millimetre
    lower = make_plan(boxes=[((300, 400, 198), (0, 0, 0), 8), *TOWERS[1:], *ON_TOWERS])
    uneven = build_scene(replace(lower, kinds=("", "", "sheet", "", "")), SIM)
    (outcome,) = MujocoEngine(1).run([Job(uneven)], SIM)
    assert outcome.verdict is Verdict.STABLE
    # boxes on the sheet press on the boxes below the sheet
    assert simulated("mujoco")["borne"].boxes.rest_top_force_n[0] == pytest.approx(10.2 * GRAVITY, rel=0.01)


def test_plans_and_tables_say_how_stiff_boxes_are() -> None:
    """The stiffness can come from three sources. The stiffness of the placement takes precedence over that of the
    article, and the stiffness of the article over that of the material."""
    plan = petmjx.Plan.from_boxes(
        "tower",
        size_mm=[SIZE] * 3,
        corner_mm=[[0, 0, 200 * level] for level in range(3)],
        mass_kg=[10, 10, 10],
        article=["milk", "milk", "jam"],
        material=["cardboard"] * 3,
        stiffness_n_mm=[150, None, None],
    )
    stiff_plan = with_articles(
        plan,
        Articles({"milk": Article(stiffness_n_mm=300.0)}, {}, {"cardboard": Article(stiffness_n_mm=80.0)}),
    )
    assert stiff_plan.stiffness_n_mm is not None
    assert stiff_plan.stiffness_n_mm.tolist() == [150.0, 300.0, 80.0]
    np.testing.assert_array_equal(build_scene(stiff_plan, SIM).stiffness, [150e3, 300e3, 80e3])
    assert check_surfaces([stiff_plan], Simulation(physics="reference"))[0].startswith("stiffness has no effect")
    assert build_scene(stiff_plan, Simulation(physics="reference")).stiffness is None
