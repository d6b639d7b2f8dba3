"""Walls of carriers: they bear boxes that slide or tip onto them, and let boxes fall at an open door."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from operator import attrgetter
from pathlib import Path

import jax
import numpy as np
import pytest
from support.plan_edges import edges_of
from support.plans import Box, make_plan, make_scene, stack
from support.sweeps import write_sweep

import petmjx
from petmjx.common.errors import InputError
from petmjx.engines.engine_registry import make_engine
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Check, Schedule, Simulation
from petmjx.options.walls import Side
from petmjx.plans.plan_sources import usable_plans
from petmjx.repairs.draft_rules import Rules
from petmjx.repairs.drafts import Draft
from petmjx.world.approach_paths import ApproachPath, approach_path_of, approach_paths_of, reach
from petmjx.world.building_edges import building_edges
from petmjx.world.error_distributions import Distribution, DistributionShape
from petmjx.world.history import Record
from petmjx.world.job import ACCELERATION, Drive, Excitation, Job
from petmjx.world.option_lint import notes_about
from petmjx.world.profiles.accelerations import eumos_40509
from petmjx.world.scene import build_scene
from petmjx.world.supports import bearings_of
from petmjx.world.variants import PlacementChange, Variant, apply_all

G = 9.81
KG = 10.0
TOUCH_M = 1e-5
"""Tolerance of the places of boxes that are moved out of a wall, m."""

TOUCH_DEG = 0.07
"""Angle by which a box tilts until its contacts bear it. The angle corresponds to a few hundredths of a millimetre over
the height of the box."""

SAME_M = 0.0005
"""Allowed difference between engines in the place of a box that tipped onto a wall and slid, m."""

X_MM, Y_MM = 800.0, 700.0
"""Extents of a roll container's deck along x and y."""

FORCE_SHARE = 0.03
"""Relative tolerance of the force on a wall, which is the part of the load that friction does not bear."""
MARGIN = 0.03
"""Required accuracy of thresholds: at 3 % below a threshold, a load stands; at 3 % above, it falls."""

EUMOS = Drive(eumos_40509().excitation(0.002), scale=0.45, yaw_rad=-np.pi / 2)

SHAKEN = Simulation(check=Check.STATIC, schedule=Schedule.FIXED, settle_s=0.4, early_stop=False, size_reduction_mm=0.0)


def along(direction: tuple[float, float], level_g: float, ramp: int = 500, hold: int = 300) -> Drive:
    """A drive that pushes the load in a horizontal direction. The acceleration of the drive increases for ``ramp``
    steps and then stays constant for ``hold`` steps."""
    level = level_g * G * np.append(np.linspace(0.0, 1.0, ramp), np.ones(hold))
    x, y = direction
    return Drive(Excitation("throw", ACCELERATION, np.outer(level, [-x, -y, 0.0])), rest_s=0.2)


def simulate(
    boxes: Sequence[Box], sim: Simulation, drive: Drive | None = None, record: Record | None = None
) -> Outcome:
    (outcome,) = MujocoEngine(1).run([Job(make_scene(boxes, sim), drive, record=record)], sim)
    return outcome


@pytest.mark.parametrize("carrier", ["footprint", "euro-pallet", "epal-1", "rollcontainer-grid"])
def test_walls_stand_beside_the_deck_and_the_deck_is_as_without(carrier: str) -> None:
    plain, sim = Simulation(carrier=carrier), Simulation(carrier=carrier, walls={"sides": list(Side), "gap_mm": 7.0})
    boxes = stack(2, at_mm=(100.0, 50.0))
    bare, walled = make_scene(boxes, plain).carrier, make_scene(boxes, sim).carrier
    assert walled.n_boards == len(bare.half_size)
    assert walled.walls == tuple(Side)
    np.testing.assert_array_equal(walled.half_size[: walled.n_boards], bare.half_size)
    deck = (walled.pos + walled.shape_pos)[: walled.n_boards]
    np.testing.assert_allclose(deck, bare.pos + bare.shape_pos, atol=1e-12)
    room = walled.room
    np.testing.assert_allclose(room.face, [bare.low[:2] - 0.007, bare.high[:2] + 0.007], atol=1e-12)
    np.testing.assert_allclose(room.top, 1.5)
    # the mass of a wall is proportional to its area; its length is that of the room plus two thicknesses
    x, y = bare.high[:2] - bare.low[:2] + 0.014 + 2 * 0.03
    assert walled.mass == pytest.approx(bare.mass + 6.0 * 1.5 * 2 * (x + y))
    masses = np.append(bare.mass, np.repeat([y, x], 2) * 6.0 * 1.5)
    middles = np.vstack([bare.pos, (walled.pos + walled.shape_pos)[walled.n_boards :]])
    np.testing.assert_allclose(walled.pos, masses @ middles / masses.sum(), atol=1e-12)


def test_a_door_that_is_opened_leaves_its_mass_so_that_states_stay_valid() -> None:
    scene = make_scene(stack(2), Simulation(carrier="rollcontainer-4"))
    opened = scene.with_open_walls([Side.FRONT]).carrier
    for name in ("pos", "mass", "inertia_box"):
        np.testing.assert_array_equal(getattr(opened, name), getattr(scene.carrier, name))
    assert opened.walls == (Side.LEFT, Side.RIGHT, Side.BACK)
    by_option = make_scene(stack(2), Simulation(carrier="rollcontainer-4", walls={"open": ["front"]})).carrier
    for name, values in vars(opened).items():
        np.testing.assert_array_equal(getattr(by_option, name), values)
    with pytest.raises(ValueError, match="no wall on the side front"):
        opened.without_walls([Side.FRONT])


@pytest.mark.parametrize(("friction", "level_g"), [(0.0, 0.5), (0.3, 0.4), (0.3, 0.6), (0.5, 0.8)])
def test_a_wall_bears_what_friction_leaves_of_a_block(friction: float, level_g: float) -> None:
    """The force on the wall is m g (sin a − µ cos a) on a deck tilted by the angle a, or accelerated accordingly as in
    this test."""
    coefficients = [friction, 0.005, 0.0001]
    sim = SHAKEN.changed(
        carrier="euro-pallet",
        walls={"sides": ["right"], "friction": 0.0},
        physics={"box_friction": coefficients, "carrier_friction": coefficients},
    )
    block: Box = ((200.0, 200.0, 200.0), (1000.0, 300.0, 0.0), KG)
    ramp, dt = 500, sim.physics.timestep_s
    outcome = simulate([block], sim, along((1.0, 0.0), level_g, ramp, hold=20), Record(dt, details=True))
    assert outcome.verdict is Verdict.STABLE
    history = outcome.history
    assert history is not None
    assert history.contacts is not None
    end = int(np.searchsorted(history.time_s, sim.settle_s + (ramp + 5) * dt))
    of_wall = (history.contacts.frame == end) & (np.abs(history.contacts.normal[:, 0]) > 0.9)
    force = np.abs(history.contacts.force[of_wall, 0].sum())
    assert force == pytest.approx(KG * G * (level_g - friction), rel=FORCE_SHARE)


def leaning(side: Side, beyond_mm: float = 60.0, along_mm: float = 0.0) -> tuple[Box, ...]:
    """A tall box on a post at a side of the carrier, offset by ``along_mm`` from the middle of this side. The middle of
    the box is ``beyond_mm`` beyond the post's edge on this side."""
    width, post, height = 300.0, 200.0, 600.0
    extent = (X_MM, Y_MM)
    corner = [(end - width) / 2 for end in extent]
    corner[1 - side.axis] += along_mm
    corner[side.axis] = extent[side.axis] - width if side.is_far else 0.0
    below = [at + (width - post) / 2 for at in corner]
    way = -post / 2 - beyond_mm if side.is_far else post / 2 + beyond_mm  # offset of the post, away from the wall
    below[side.axis] = corner[side.axis] + (width - post) / 2 + way
    return (
        ((post, post, 150.0), (below[0], below[1], 0.0), 20.0),
        ((width, width, height), (corner[0], corner[1], 150.0), 10.0),
    )


WALLS_OF: dict[str, tuple[Side, ...]] = {
    "rollcontainer-grid": (),
    "rollcontainer-2": (Side.LEFT, Side.RIGHT),
    "rollcontainer-3": (Side.LEFT, Side.RIGHT, Side.BACK),
    "rollcontainer-4": tuple(Side),
}


@pytest.mark.parametrize(
    ("carrier", "opened"), [*((name, ()) for name in WALLS_OF), ("rollcontainer-4", (Side.FRONT,))]
)
def test_a_box_that_tips_stands_where_there_is_a_wall(carrier: str, opened: tuple[Side, ...]) -> None:
    plans = [make_plan(side, leaning(side)) for side in Side]
    worlds = petmjx.score(plans, engine="mujoco", threads=1, carrier=carrier, walls={"open": opened}).worlds
    stands = dict(zip(worlds.plan_id, worlds.verdict == Verdict.STABLE, strict=True))
    assert stands == {side: side in WALLS_OF[carrier] and side not in opened for side in Side}


@pytest.mark.parametrize("share", [1.0 + MARGIN, 0.9, 0.8])
def test_a_box_leans_on_a_smooth_wall_as_far_as_friction_holds_its_foot(share: float) -> None:
    """The middle of the box is a distance e beyond the edge on which it stands, and its top touches the wall at the
    height h. The force on the wall is W·e/h, and friction µ·W at the edge must balance it. So the foot of the box stays
    if µ ≥ e/h. If µ is smaller, the foot slides, and the box tilts by an angle a. The tilt moves the middle back by
    a·h/2, and the edge then bears W·(µ + a). The foot stops when e − a·h/2 = h·(µ + a). Since the load acts suddenly,
    the box can tilt up to twice as far."""
    beyond, height = 60.0, 600.0
    friction = [share * beyond / height, 0.005, 0.0001]
    sim = Simulation(
        carrier="rollcontainer-grid",
        walls={"sides": ["right"], "gap_mm": 0.0, "friction": 0.0},
        physics={"box_friction": friction, "carrier_friction": friction},
        size_reduction_mm=0.0,
    )
    outcome = simulate(leaning(Side.RIGHT, beyond), sim)
    assert outcome.verdict is Verdict.STABLE
    balance_deg = np.degrees(max(0.0, (1.0 - share) * beyond) / (1.5 * height))
    tilt = outcome.boxes.max_tilt_deg[1]
    assert balance_deg <= tilt <= 2.0 * balance_deg + TOUCH_DEG


WALL_OF_BOXES = tuple(
    ((200.0, 240.0, 400.0), (202.0 * k, 242.0 * row, 400.0 * layer), 6.0)
    for layer in range(2)
    for row in range(2)
    for k in range(2)
)
"""A wall of boxes: columns of two boxes each. A single column topples at g·b/h, which is 0.25 g along x and 0.3 g along
y."""


def test_a_wall_of_boxes_against_walls_stands_until_a_door_is_opened() -> None:
    """The settled state of the closed container is also used as the start for containers with an open door."""
    sim = Simulation(walls=list(Side), check=Check.STATIC)
    scene = make_scene(WALL_OF_BOXES, sim)
    (settled,) = MujocoEngine(1).run([Job(scene, keep_state=True)], sim)
    for side, way, level_g in (
        (Side.RIGHT, (1.0, 0.0), 0.35),
        (Side.BACK, (0.0, 1.0), 0.4),
        (Side.FRONT, (0.0, -1.0), 0.4),
    ):
        scenes = [scene, scene.with_open_walls([Side.LEFT]), scene.with_open_walls([side])]
        jobs = [Job(one, along(way, level_g, ramp=150, hold=250), start=settled.state) for one in scenes]
        tilt = [outcome.boxes.max_tilt_deg.max() for outcome in MujocoEngine(1).run(jobs, sim)]
        assert max(tilt[:2]) < 5.0
        assert tilt[2] > 20.0


@pytest.mark.parametrize("carrier", WALLS_OF)
def test_criteria_and_edges_know_walls(carrier: str) -> None:
    """A load that acts e = 60 mm beyond an edge is held by a wall that the box touches at the height h = 600 mm, if the
    coefficient of friction is µ > e/h."""
    for friction, holds in ((0.11, True), (0.09, False)):
        physics = {"box_friction": [friction, 0.005, 0.0001]}
        sim = Simulation(carrier=carrier, physics=physics, size_reduction_mm=0.0)
        plans = {side: make_plan(side, leaning(side)) for side in Side}
        answers = petmjx.criteria(
            [*plans.values()], carrier=carrier, only=("force_balance_leaning",), friction=friction
        )
        expected = {side: side in WALLS_OF[carrier] and holds for side in Side}
        assert dict(zip(answers.plans.plan_id, answers.plans.force_balance_leaning, strict=True)) == expected
        bearing = bearings_of([build_scene(plan, sim) for plan in plans.values()])
        for number, (side, edges) in enumerate(zip(Side, edges_of(bearing, [2] * len(Side)), strict=True)):
            held_m = 0.6 * friction if side in WALLS_OF[carrier] else 0.0
            assert edges.by_load[1] == pytest.approx(min(held_m - 0.06, 0.2 + 0.06), abs=1e-9)
            (built,) = building_edges(bearing.of_scene(number), [2])
            assert built.edge_m == pytest.approx(np.nanmin(edges.by_load), abs=1e-9)


def test_a_repair_moves_no_box_into_a_wall() -> None:
    """The walls are collars that stand on the deck, so a check of the deck's extents alone would allow the move."""
    plan = make_plan("two", [((200.0, 200.0, 150.0), (300.0 * k + 30.0, 30.0, 0.0), 5.0) for k in range(2)])
    collar = {"sides": list(Side), "gap_mm": -20.0, "thickness_mm": 20.0, "height_mm": 195.0}
    for walls, least_mm in ({}, 0.0), (collar, 20.0):
        rules = Rules(plan, Simulation(carrier="epal-1", walls=walls), 1500.0, 0)
        for beyond_mm in (-1.0, 1.0):
            draft = Draft.of(plan).with_places([0], np.array([[least_mm - beyond_mm, 30.0, 0.0]]))
            assert bool(rules.allow([draft])[0]) == (beyond_mm < 0)


@pytest.mark.parametrize("corner_mm", [-50.0, -250.0])
def test_a_box_that_a_repair_moves_ends_outside_walls(corner_mm: float) -> None:
    """The box is planned inside the wall or behind it. A box inside a wall may stay there while another box is moved,
    but may not be moved to such a place."""
    boxes = [((300.0, 300.0, 300.0), (x_mm, 0.0, 0.0), 5.0) for x_mm in (corner_mm, 600.0)]
    plan = make_plan("a", boxes)
    rules = Rules(plan, Simulation(carrier="epal-1", walls=["left"]), 1500.0, 0)
    moves = {(0, -20.0): False, (0, -0.0): True, (1, 500.0): True}
    drafts = [Draft.of(plan).with_places([box], np.array([[x_mm, 0.0, 0.0]])) for box, x_mm in moves]
    assert rules.allow([Draft.of(plan), *drafts]).tolist() == [True, *moves.values()]


@pytest.mark.parametrize(
    ("corner_x_mm", "line"),
    [
        (-12.0, "1 box reaches through a wall of the carrier (box 0 of a by 7 mm on the left)"),
        (-200.0, "1 box reaches through a wall of the carrier (box 0 of a by 195 mm on the left)"),
        (-5.0, None),
    ],
)
def test_a_box_that_is_planned_through_a_wall_gets_a_line(corner_x_mm: float, line: str | None) -> None:
    plans = [make_plan("a", [((300.0, 300.0, 300.0), (corner_x_mm, 0.0, 0.0), 5.0)])]
    notes = notes_about(Simulation(carrier="rollcontainer-4"), plans)
    assert [note for note in notes if "wall" in note] == ([line] if line else [])


@pytest.mark.parametrize(
    ("sides", "size_mm", "line"),
    [
        (["left", "right"], (300.0, 500.0), "walls.gap_mm of -200 leaves no room on a carrier of 300 mm along x"),
        (["left"], (500.0, 400.0), "walls.gap_mm of -200 leaves no room on a carrier of 400 mm along y"),
        (["left"], (300.0, 500.0), None),
    ],
)
def test_a_plan_on_which_walls_leave_no_room_is_skipped(
    sides: list[str], size_mm: tuple[float, float], line: str | None
) -> None:
    footprints_mm = {"a": size_mm, "b": (600.0, 600.0)}
    plans = [make_plan(name, [((*size, 300.0), (0.0, 0.0, 0.0), 5.0)]) for name, size in footprints_mm.items()]
    walls = {"sides": sides, "gap_mm": -200.0}
    usable = usable_plans(plans, Simulation(walls=walls), RunOptions())
    judged = petmjx.criteria(plans, walls=walls)
    lines = [] if line is None else [f"{plans[0].source}: plan a: {line}"]
    assert [str(skipped) for skipped in usable.skipped] == judged.info["skipped"] == lines
    with nullcontext() if line is None else pytest.raises(InputError, match=f"^{line}$"):
        build_scene(plans[0], Simulation(walls=walls))


def test_options_of_walls_that_mean_nothing_are_named() -> None:
    assert notes_about(Simulation(walls={"height_mm": 900.0}), []) == [
        "walls.height_mm has no effect: the carrier has no walls"
    ]
    with pytest.raises(InputError, match=r"walls\.open\[0\] is left, but the carrier has no wall on this side"):
        Simulation(walls={"open": ["left"]})
    with pytest.raises(InputError, match=r"walls\.sides\[0\] must be 'left', 'right', 'front' or 'back', got 'up'"):
        Simulation(walls=["up"])
    assert Simulation(walls="right, left").walls.sides == (Side.LEFT, Side.RIGHT)


def drawn_piles(n: int, seed: int) -> list[petmjx.Plan]:
    """Random piles at two opposite sides of a roll container. The piles do not overlap, and some of them lean on
    walls."""
    rng = np.random.default_rng(seed)
    plans = []
    for number in range(n):
        boxes: list[Box] = []
        for side in ((Side.LEFT, Side.RIGHT), (Side.FRONT, Side.BACK))[number % 2]:
            along_mm = 200.0 if side.is_far else -200.0
            post, (size, corner, _) = leaning(side, float(rng.uniform(-60.0, 80.0)), along_mm)
            height = float(rng.uniform(250.0, 600.0))
            boxes += [post, ((size[0], size[1], height), corner, float(rng.uniform(3.0, 12.0)))]
            if rng.random() < 0.7:
                x, y = (at + rng.uniform(0.0, 100.0) for at in corner[:2])
                boxes.append(((200.0, 200.0, 200.0), (x, y, corner[2] + height), 4.0))
        plans.append(make_plan(f"pile-{number}", boxes))
    return plans


def test_engines_agree_on_what_stands_in_a_roll_container() -> None:
    """mjx-jax is not compared, because it takes a minute to compile two boxes beside a wall. The shapes of mjx-jax are
    tested in tests/oracle."""
    plans, engines = drawn_piles(12, seed=7), ("mujoco", "mjx-warp-cpu")
    with jax.numpy_rank_promotion("allow"):  # MJX broadcasts as NumPy does
        twin, other = (petmjx.score(plans, engine=name, threads=1, carrier="rollcontainer-3") for name in engines)
    assert twin.worlds.verdict.tolist() == other.worlds.verdict.tolist()
    assert twin.worlds.culprit.tolist() == other.worlds.culprit.tolist()
    verdicts = dict(zip(twin.worlds.plan_id, twin.worlds.verdict, strict=True))
    assert {*verdicts.values()} == {Verdict.STABLE, Verdict.UNSTABLE}
    stands = twin.boxes.plan_id.map(verdicts) == Verdict.STABLE
    for name in ("shift_x_m", "shift_y_m"):
        np.testing.assert_allclose(twin.boxes[name][stands], other.boxes[name][stands], atol=SAME_M)


def test_engines_agree_on_what_falls_when_a_roll_container_is_shaken() -> None:
    """With too few iterations of the solver, mjx-warp let piles stand that fall on mujoco."""
    sim = Simulation(carrier="rollcontainer-4")
    piles = drawn_piles(6, seed=11)
    scenes = [build_scene(plan, sim) for plan in (*piles[:2], piles[4])]
    answers = []
    for engine in (MujocoEngine(1), make_engine("mjx-warp-cpu")):
        with jax.numpy_rank_promotion("allow"):
            settled = sorted(engine.run([Job(scene, keep_state=True) for scene in scenes], sim), key=attrgetter("job"))
            jobs = [
                Job(scene, EUMOS, start=outcome.state)
                for scene, outcome in zip(scenes, settled, strict=True)
                if outcome.verdict is Verdict.STABLE
            ]
            shaken = sorted(engine.run(jobs, sim), key=attrgetter("job"))
        answers.append([(outcome.verdict, outcome.culprit) for outcome in shaken])
    assert answers[0] == answers[1]
    assert len({verdict for verdict, _ in answers[0]}) == 2


ERRORS = PlacementChange(
    x_mm=Distribution(DistributionShape.NORMAL, 0.0, 6.0),
    y_mm=Distribution(DistributionShape.NORMAL, 0.0, 6.0),
    yaw_deg=Distribution(DistributionShape.NORMAL, 0.0, 0.5),
)


@pytest.mark.parametrize("placing", ["exact", "hand"])
def test_boxes_with_errors_begin_between_the_walls(placing: str) -> None:
    sim = Simulation(carrier="rollcontainer-4", placing=placing)
    boxes = [
        ((390.0, 345.0, 300.0), (400.0 * x, 350.0 * y, 300.0 * z), 6.0)
        for z in range(2)
        for y in range(2)
        for x in range(2)
    ]
    nominal = make_scene(boxes, sim)
    variants = [Variant(k, ERRORS, replicate=k) for k in range(1, 41)]
    scenes = [*apply_all(nominal, "plan", variants, seed=3)]
    paths = approach_paths_of(scenes, sim)
    outside = 0
    for row, scene in enumerate(scenes):
        begin, room = scene.start_pos.copy(), scene.carrier.room
        reaches = reach(scene.start_quat, scene.half_size)[:, None, :2]
        outside += int(
            ((begin[:, None, :2] - reaches < room.face[0]) | (begin[:, None, :2] + reaches > room.face[1])).any()
        )
        if paths is not None:
            path = ApproachPath(*(values[row] for values in paths))
            for one, other in zip(path, approach_path_of(scene, sim) or (), strict=True):
                np.testing.assert_array_equal(one, other)
            begin += path.offset
            # boxes must also be inside if they start aside
            begin = begin[:, None, :2] + path.aside * [[-1.0], [1.0]]
        else:
            begin = begin[:, None, :2]
        assert (begin - reaches >= room.face[0] - TOUCH_M).all()
        assert (begin + reaches <= room.face[1] + TOUCH_M).all()
    assert (outside > 10) == (placing == "hand")  # the errors move boxes through walls before they are corrected


DOORS = """
[simulation]
carrier = "rollcontainer-4"
settle_s = 0.4
rest_s = 0.5
[axes]
friction_factor = 1.0
[[legs]]
name = "yard"
open_walls = ["back"]
pause_s = 0.5
[[legs]]
name = "dock"
open_walls = ["front"]
"""


@pytest.mark.parametrize("engine", ["mujoco", "mjx-warp-cpu"])
def test_a_leg_opens_a_door_and_what_leans_on_it_falls_out(engine: str, tmp_path: Path) -> None:
    plans = [make_plan(side, leaning(side)) for side in (Side.LEFT, Side.FRONT, Side.BACK)]
    worlds = petmjx.sweep(write_sweep(tmp_path, DOORS), plans, engine=engine).worlds.set_index("plan_id")
    assert worlds["leg"].to_dict() == {"left": "", "front": "dock", "back": "yard"}
    assert worlds["verdict"].to_dict() == {"left": "stable", "front": "unstable", "back": "unstable"}


def test_a_leg_opens_only_walls_that_there_are(tmp_path: Path) -> None:
    text = DOORS.replace("rollcontainer-4", "rollcontainer-2")
    file = write_sweep(tmp_path, text)
    with pytest.raises(InputError, match=r"legs\[0\]\.open_walls: the carrier has no wall 'back'"):
        petmjx.sweep(file, [make_plan("one", stack(1))], engine="mujoco")
    run = petmjx.score([make_plan("one", stack(1))], chain=file, engine="mujoco", carrier="rollcontainer-4")
    assert run.worlds["leg"].tolist()[-1] == ""
