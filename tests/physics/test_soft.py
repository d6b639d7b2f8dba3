"""Soft boxes, which are simulated as flex bodies (MuJoCo's deformable bodies): they agree with closed forms, and their
verdicts with those of the contact law."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from support.plans import Box, make_plan

import petmjx
from petmjx.common.errors import InputError
from petmjx.engines.attempt_settings import ATTEMPTS
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.mujoco.soft_boxes import SoftWorld
from petmjx.engines.protocol import Progress
from petmjx.engines.simulation_loop import score_worlds
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.engines.world_results import World
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.world.history import CARRIER, Record
from petmjx.world.job import Drive, Excitation, Job
from petmjx.world.mujoco_model import to_mjcf
from petmjx.world.rotation import rotations
from petmjx.world.scene import build_scene
from petmjx.world.soft_boxes import points_of, shares, soft_friction, tetrahedra

GRAVITY = 9.81
WITHIN = 0.03
"""Relative tolerance of the depth of a spring. Contacts and carrier are compressed by a tenth of a millimetre, and
strains are large. The measured difference was 2 %."""
LEANS_WITHIN = 0.1
"""Relative tolerance of the tilt of a bed of springs. The measured difference was 7 %."""
FORCE_WITHIN = 0.005
STIFF_WITHIN_M = 2e-4
"""Tolerance of the height of boxes without a stiffness, m. The carrier sinks by 0.09 mm, and contacts and edges by
about as much."""
SIDEWAYS_WITHIN_M = 5e-4
"""Distance by which boxes may creep sideways while they rest, m. The measured distance was 0.1 mm."""
SIZE = (400.0, 300.0, 200.0)
SOFT = Simulation(soft=True)
RIGID = np.nan


def stack(*boxes: tuple[float, float, float]) -> Plan:
    """A plan of boxes on top of each other. Each box has a mass in kg, a stiffness in N/mm (NaN means rigid) and an
    offset along x in mm."""
    rows: list[Box] = [(SIZE, (aside, 0.0, 200.0 * level), mass) for level, (mass, _, aside) in enumerate(boxes)]
    return replace(make_plan(boxes=rows), stiffness_n_mm=np.array([stiffness for _, stiffness, _ in boxes]))


def simulated(plan: Plan, sim: Simulation = SOFT, **job: object) -> Outcome:
    (outcome,) = MujocoEngine(1).run([Job(build_scene(plan, sim), **job)], sim)
    assert not outcome.message
    return outcome


@pytest.mark.parametrize(("stiffness", "mass", "load"), [(20.0, 10.0, 20.0), (100.0, 2.0, 50.0)])
def test_a_load_sinks_as_on_a_spring(stiffness: float, mass: float, load: float) -> None:
    outcome = simulated(stack((mass, stiffness, 0.0), (load, RIGID, 0.0)))
    depth_m = 0.3 - outcome.boxes.pos[1, 2]
    assert outcome.verdict is Verdict.STABLE
    assert depth_m == pytest.approx(GRAVITY * (load + mass / 2) / (1e3 * stiffness), rel=WITHIN)
    assert outcome.boxes.rest_top_force_n == pytest.approx([load * GRAVITY, 0.0], rel=FORCE_WITHIN)
    assert outcome.boxes.max_tilt_deg.max() < 0.1, "mirrored elements do not lean"


def test_a_soft_box_leans_under_a_load_aside_as_a_bed_does() -> None:
    """The bed resists a tilt with k·L²/12. When the boxes tilt, their weights add to the tilt. The edges of the soft
    box also bend a little."""
    length, stiffness, lever = 0.4, 50e3, 0.04
    rows: list[Box] = [
        ((400, 400, 200), (0, 0, 0), 4),
        ((400, 400, 50), (0, 0, 200), 2),
        ((100, 400, 100), (190, 0, 250), 30),
    ]
    plan = replace(make_plan(boxes=rows), stiffness_n_mm=np.array([stiffness / 1e3, RIGID, RIGID]))
    weights = GRAVITY * (4 * 0.05 + 32 * 0.1 + 2 * 0.025 + 30 * 0.1)
    expected = 30 * GRAVITY * lever / (stiffness * length**2 / 12 - weights)
    quat = simulated(plan).boxes.quat[1]
    assert 2 * np.arcsin(np.hypot(quat[1], quat[2])) == pytest.approx(expected, rel=LEANS_WITHIN)


@pytest.mark.parametrize(
    ("plan", "verdict"),
    [
        (stack((10, 200, 0), (10, 200, 180)), Verdict.STABLE),
        (stack((10, 200, 0), (10, 200, 210)), Verdict.UNSTABLE),
        (stack((20, 100, 0), (5, RIGID, 0), (10, 100, 0)), Verdict.STABLE),
        (stack((5, 100, 0), (5, 100, 140), (10, 100, 280)), Verdict.UNSTABLE),
    ],
    ids=["aside", "over the edge", "mixed", "stairs"],
)
def test_the_contact_law_has_the_same_verdicts(plan: Plan, verdict: Verdict) -> None:
    assert [simulated(plan, sim).verdict for sim in (SOFT, Simulation())] == [verdict] * 2


def test_poses_and_speeds_are_those_of_the_rigid_box_that_fits_best() -> None:
    scene = build_scene(stack((10, 100, 0)), SOFT)
    world = SoftWorld(scene, SOFT)
    world.place_next()
    quat, middle = np.array([0.8, 0.2, -0.3, 0.4]), np.array([1.0, 2.0, 3.0])
    quat /= np.linalg.norm(quat)
    arm = points_of(scene.half_size[0]) @ rotations(quat[None])[0].T
    spin, speed = np.array([0.3, -0.2, 0.5]), np.array([0.1, 0.2, 0.3])
    home = scene.start_pos[0] + points_of(scene.half_size[0])
    world.data.qpos[7:] = (middle + arm - home).ravel()
    world.data.qvel[6:] = (speed + np.cross(spin, arm)).ravel()
    assert world.pose[0, :3] == pytest.approx(middle)
    assert abs(world.pose[0, 3:] @ quat) == pytest.approx(1.0)
    assert world.velocity[0] == pytest.approx([*speed, *spin])
    # accelerations are in the axes of the box, as those of rigid boxes, or in world axes
    world.data.qacc[6:] = world.data.qvel[6:]
    mujoco.mj_kinematics(world.model, world.data)
    assert world.qacc[0] == pytest.approx([*speed, *rotations(quat[None])[0].T @ spin])
    assert np.hstack(world.accelerations())[0] == pytest.approx([*speed, *spin])
    world.data.qpos[7:] += 0.001 * np.tile([1.0, 0.0, 0.0], 27) * (points_of(scene.half_size[0])[:, 2] > 0).repeat(3)
    assert world.pose[0, 0] == pytest.approx(middle[0] + 0.001 / 6), "a sixth of the mass has moved by 1 mm"


def test_points_have_the_mass_and_elements_the_volume() -> None:
    points = points_of(np.array([0.2, 0.1, 0.3]))
    sides = points[tetrahedra()[:, 1:]] - points[tetrahedra()[:, :1]]
    assert shares().sum() == pytest.approx(1.0)
    assert (np.linalg.det(sides) > 0).all()
    assert np.linalg.det(sides).sum() / 6 == pytest.approx(np.ptp(points, axis=0).prod())


def test_a_state_is_kept_and_a_push_begins_from_it() -> None:
    rows = np.zeros((200, 3))
    rows[20:80, 0] = 2.0
    job = {"drive": Drive(Excitation("push", "acceleration", rows), rest_s=0.2)}
    plan = stack((10, 100, 0), (10, 100, 0))
    once = simulated(plan, keep_state=True, **job)
    again = simulated(plan, start=once.state, **job)
    assert np.array_equal(once.boxes.pos, again.boxes.pos)
    assert np.nanmax(once.boxes.max_sway_m) > 2 * np.nanmax(
        simulated(stack((10, 1e4, 0), (10, 1e4, 0)), **job).boxes.max_sway_m
    )


def test_contacts_of_frames_bear_the_weight() -> None:
    outcome = simulated(stack((10, 100, 0), (20, 100, 0)), record=Record(0.05, details=True))
    history = outcome.history
    assert history is not None
    assert history.contacts is not None
    last = history.contacts.frame == len(history.time_s) - 1
    body, force = history.contacts.body[last], history.contacts.force[last]
    on_carrier = (body == CARRIER).any(axis=1) & (body >= 0).any(axis=1)
    assert abs(force[on_carrier, 2].sum()) == pytest.approx(30 * GRAVITY, rel=FORCE_WITHIN)
    between = (body >= 0).all(axis=1)
    upwards = np.where(body[between, 1] == 1, 1.0, -1.0)  # forces are those that the first body exerts on the second
    assert upwards @ force[between, 2] == pytest.approx(20 * GRAVITY, rel=FORCE_WITHIN)


def test_an_export_has_the_soft_boxes() -> None:
    scene = build_scene(stack((10, 100, 0), (20, RIGID, 0)), SOFT)
    model = mujoco.MjModel.from_xml_string(to_mjcf(scene, SOFT.physics))
    assert (model.nflex, model.neq, model.nv) == (1, 1, 6 + 81 + 6)
    assert model.body_mass.sum() == pytest.approx(30 + scene.carrier.mass)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=500)
    assert data.body("box_1").xpos[2] == pytest.approx(0.3 - GRAVITY * 25 / 100e3, rel=WITHIN)


class Exploding(MujocoEngine):
    """An engine on which simulations without soft boxes explode."""

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        for outcome in super().run(jobs, sim, progress):
            rigid = jobs[outcome.job].scene.soft is None
            yield replace(outcome, verdict=Verdict.INVALID, reason=Reason.EXPLOSION) if rigid else outcome


def test_the_last_attempt_has_soft_boxes() -> None:
    plan = make_plan(boxes=2)
    world = World(plan, 0, Job(build_scene(plan, Simulation())))
    for sim, numbers, verdict in (
        (Simulation(attempts="soft"), [1, 2, 3, 4, 5, 9], Verdict.STABLE),
        (Simulation(), [1, 2, 3, 4, 5], Verdict.INVALID),
    ):
        (result,) = score_worlds([world], sim, Exploding(1))
        assert [attempt.attempt for attempt in result.attempts] == numbers
        assert result.outcome.verdict is verdict
    sinks = replace(result.outcome, verdict=Verdict.UNSTABLE, reason=Reason.SHIFT, flags=Flag.SINKING)
    assert ATTEMPTS[-1].is_for(sinks, Simulation(attempts="soft"))
    assert not ATTEMPTS[-1].is_for(sinks, Simulation(attempts="soft", physics="reference"))


def test_boxes_without_a_stiffness_are_stiff() -> None:
    scene = build_scene(make_plan(boxes=2), SOFT).all_soft
    (outcome,) = MujocoEngine(1).run([Job(scene)], SOFT)
    assert outcome.verdict is Verdict.STABLE
    assert not outcome.flags
    assert scene.target[:, 2] - outcome.boxes.pos[:, 2] == pytest.approx(0.0, abs=STIFF_WITHIN_M)


def test_soft_attempts_stand_in_the_physics_of_the_reference() -> None:
    sim = Simulation(physics="reference")
    scene = build_scene(make_plan(boxes=3), sim).all_soft
    (outcome,) = MujocoEngine(1).run([Job(scene)], sim)
    assert outcome.verdict is Verdict.STABLE
    assert outcome.boxes.rest_top_force_n == pytest.approx(np.array([10, 5, 0]) * GRAVITY, rel=FORCE_WITHIN, abs=1e-6)
    assert np.abs(outcome.boxes.pos - scene.target)[:, :2].max() < SIDEWAYS_WITHIN_M


def test_other_engines_hand_soft_boxes_over() -> None:
    results = petmjx.score(stack((10, 100, 0)), engine="mjx-jax", soft=True)
    assert results.worlds.engine.tolist() == ["mujoco"]
    assert "worlds with soft boxes were simulated on mujoco" in results.info["warnings"]


PLAN = stack((10, 100, 0), (10, 100, 0))
OFF_CENTRE = replace(PLAN, mass_center_mm=np.array([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0]]))
SLIPPERY = [{"between": ["film", "film"], "friction": 0.6}, {"between": ["film", "cardboard"], "friction": 0.2}]
PAIRED = replace(PLAN, materials=("film", "cardboard"))


@pytest.mark.parametrize(
    ("plan", "options", "words"),
    [
        (PLAN, {"placing": {"name": "hand"}}, "soft needs placing='exact'"),
        (PLAN, {"soft": False, "attempts": "soft", "placing": {"name": "drop"}}, "attempts needs placing='exact'"),
        (PLAN, {"confidence": 4}, "soft boxes appear at their places"),
        (OFF_CENTRE, {}, "that of box 1 is not"),
        (
            PAIRED,
            {"friction_pairs": [*SLIPPERY, {"between": ["film", "wood"], "friction": 0.4}]},
            "the larger of their coefficients",
        ),
    ],
)
def test_what_soft_boxes_cannot_have_is_refused(plan: Plan, options: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        petmjx.score(plan, engine="mujoco", **{"soft": True, **options})


def test_friction_is_that_of_the_materials() -> None:
    frictions = {"film film": 0.2, "film wood": 0.5, "board board": 0.4, "board film": 0.4, "board wood": 0.5}
    sim = Simulation(
        soft=True,
        friction_pairs=[{"between": pair.split(), "friction": friction} for pair, friction in frictions.items()],
    )
    scene = build_scene(replace(PLAN, materials=("film", "board")), sim)
    friction = soft_friction(scene)
    assert friction.of_boxes.tolist() == [0.2, 0.4]
    assert friction.of_carrier == 0.5
    model = mujoco.MjModel.from_xml_string(to_mjcf(scene, sim.physics))
    assert model.flex_friction[:, 0].tolist() == [0.2, 0.4]
    assert model.geom("carrier").friction[0] == 0.5


def test_pallets_have_no_soft_boxes() -> None:
    with pytest.raises(InputError, match="soft: soft boxes are not supported"):
        petmjx.Pallets(1, engine="mujoco", carrier="euro-pallet", soft=True)


def test_a_stiffness_that_lets_boxes_through_is_named() -> None:
    results = petmjx.score(stack((10, 0.5, 0), (10, 100, 0)), engine="mujoco")
    assert any("1 box is compressed by more than half of the height" in warning for warning in results.info["warnings"])
    assert petmjx.score(stack((10, 100, 0)), engine="mujoco", soft=True).info["warnings"] == []


def test_sheets_stay_rigid() -> None:
    plan = replace(PLAN, kinds=("", "sheet"))
    scene = build_scene(plan, SOFT)
    assert scene.soft is not None
    assert scene.soft.tolist() == [True, False]
    assert scene.all_soft.soft is not None
    assert scene.all_soft.soft.tolist() == [True, False]
