"""``petmjx.release``: free flight agrees with closed forms on all engines, and contacts agree with a MuJoCo model
written by hand."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import jax
import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import petmjx
from petmjx.common.errors import InputError
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Engine, Progress
from petmjx.engines.verdict import Outcome
from petmjx.world.free_bodies import FreeBodies
from petmjx.world.job import Job

DT = petmjx.Physics().timestep_s
G = petmjx.Physics().gravity_m_s2
UPRIGHT = (1.0, 0.0, 0.0, 0.0)
STILL = (0.0, 0.0, 0.0)
ENGINES = ("mujoco", "mjx-warp-cpu", "mjx-jax")

ROUNDING_M = 1e-6
"""Rounding error of single precision for coordinates of up to 2 m."""
TWIN_M = 1e-5
"""Allowed difference from the model written by hand, m: a tenth of the depth of a contact at rest. petmjx's contact
laws for sliding may move a box that lands flat, but by less."""

REBOUND = 0.03
"""Tolerance of the restitution. For a restitution of 0.1, a box that falls 100 mm bounces up by one millimetre, ten
times the depth of a contact."""

SHAPE_MM = (300.0, 300.0, 100.0)
MASS_KG = 4.0
SPIN = np.array([2.0, 1.0, 3.0])
FLIGHT_S = (0.0, 0.1, 0.201, 0.3)
FLIGHT = {"vel_m_s": (0.5, -0.25, 1.0), "angvel_rad_s": SPIN, "pos_m": (0.1, -0.2, 1.0)}
"""A box that flies and turns. Two of its three moments of inertia are equal, so its axis of symmetry precesses (Landau
and Lifshitz, Mechanics, § 33)."""


def release(engine: str | Engine = "mujoco", **changes: Any) -> petmjx.Trajectories:
    """Release one box of the size ``SHAPE_MM``, at rest 2 mm above the ground. ``changes`` replace these arguments."""
    usual: dict[str, Any] = {
        "size_mm": SHAPE_MM,
        "mass_kg": MASS_KG,
        "pos_m": [(0.0, 0.0, 0.052)],
        "quat_wxyz": UPRIGHT,
        "vel_m_s": STILL,
        "angvel_rad_s": STILL,
        "times_s": (0.0, 0.5),
    }
    with jax.numpy_rank_promotion("allow"):  # MJX broadcasts as NumPy does
        return petmjx.release(**{**usual, **changes}, engine=engine)


def turn(axis: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """(4,) the quaternion of a rotation about an axis."""
    return np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis / np.linalg.norm(axis))])


def product(one: NDArray[np.float64], two: NDArray[np.float64]) -> NDArray[np.float64]:
    quat = np.zeros(4)
    mujoco.mju_mulQuat(quat, one, two)
    return quat


def symmetric_top(time_s: float) -> NDArray[np.float64]:
    """(4,) orientation of a body with two equal moments of inertia that started upright with the angular velocity
    ``SPIN``. The body turns about its angular momentum L at the rate |L|/I₁, and about its own axis at the rate ω₃·(1 −
    I₃/I₁)."""
    half = np.array(SHAPE_MM) / 2000
    moments = MASS_KG / 3 * ((half**2).sum() - half**2)
    momentum = moments * SPIN
    about_l = turn(momentum, float(np.linalg.norm(momentum)) / moments[0] * time_s)
    return product(about_l, turn(np.array([0.0, 0.0, 1.0]), SPIN[2] * (1 - moments[2] / moments[0]) * time_s))


@pytest.mark.parametrize("engine", ENGINES[:2])
def test_boxes_bounce_as_asked(engine: str) -> None:
    """The boxes fall flat from 100 mm."""
    fall_m, restitution = 0.1, np.array([0.0, 0.1, 0.3])
    answer = release(
        engine, pos_m=[(0, 0, 0.05 + fall_m)] * 3, restitution=restitution, times_s=np.arange(0.0, 1.0, DT)
    )
    height = answer.pos_m[:, :, 2] - answer.pos_m[:, -1:, 2]
    landed = (height < 0).argmax(axis=1)
    rebound = np.array([row[begin:].max() for row, begin in zip(height, landed, strict=True)])
    np.testing.assert_allclose(np.sqrt(rebound / fall_m), restitution, atol=REBOUND)
    assert height.min() > -0.005


def angle(one: NDArray[np.float64], two: NDArray[np.float64]) -> float:
    """The angle between two orientations, rad."""
    return float(2 * np.arccos(min(abs(one @ two), 1.0)))


@pytest.fixture(scope="module", params=[*ENGINES, pytest.param("mjx-warp", marks=pytest.mark.gpu)])
def two_worlds(request: pytest.FixtureRequest) -> petmjx.Trajectories:
    """The trajectories of two boxes in separate worlds, computed by one engine in one call. The first box flies and
    turns. The second box lands flat from 2 mm and rests."""
    start, flat = FLIGHT, {"vel_m_s": STILL, "angvel_rad_s": STILL, "pos_m": (0.0, 0.0, 0.052)}
    both = {name: np.array([start[name], flat[name]]) for name in start}
    return release(request.param, **both, times_s=FLIGHT_S)


def test_free_flight_is_a_parabola(two_worlds: petmjx.Trajectories) -> None:
    steps = np.round(np.array(FLIGHT_S) / DT)
    times = steps * DT
    # MuJoCo updates velocities before positions: in step n the box falls by g·dt²·n, instead of g·dt²·(n − 1/2)
    fall = G * DT**2 * steps * (steps + 1) / 2
    expected = np.array(FLIGHT["pos_m"]) + np.outer(times, FLIGHT["vel_m_s"]) - np.outer(fall, [0, 0, 1])
    exact = [0, 1, 3]
    np.testing.assert_allclose(two_worlds.pos_m[0, exact], expected[exact], atol=ROUNDING_M)
    assert abs(fall - G * times**2 / 2).max() <= G * DT * times[-1] / 2 * 1.0001


def test_free_flight_without_torque_is_that_of_a_symmetric_top(two_worlds: petmjx.Trajectories) -> None:
    # Semi-implicit Euler uses the angular velocity at the end of each step. The error is half of the change of ω in a
    # step, ω² dt / 2.
    most = 0.3 * 0.5 * DT * float(SPIN @ SPIN)
    for quat, time_s in zip(two_worlds.quat_wxyz[0], FLIGHT_S, strict=True):
        assert angle(quat, symmetric_top(time_s)) < most
    assert most < 0.01
    np.testing.assert_allclose(np.linalg.norm(two_worlds.quat_wxyz, axis=-1), 1.0, atol=1e-12)


def test_a_box_that_lands_flat_stays_where_it_is(two_worlds: petmjx.Trajectories) -> None:
    place = two_worlds.pos_m[1, -1]
    assert abs(place[:2]).max() < ROUNDING_M
    assert 0.0498 < place[2] < 0.05
    assert angle(two_worlds.quat_wxyz[1, -1], np.array(UPRIGHT)) < 1e-4


def by_hand(pos: tuple[float, ...], quat: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.float64]:
    """(t, 7) poses of a free box on a plane, simulated with a MuJoCo model that uses only the numbers of petmjx's
    physics."""
    physics = petmjx.Physics()
    half = np.array(SHAPE_MM) / 2000
    moments = MASS_KG / 3 * ((half**2).sum() - half**2)

    def text(values: Any) -> str:
        return " ".join(map(repr, map(float, values)))

    friction = physics.box_friction
    model = mujoco.MjModel.from_xml_string(f"""
        <mujoco><option timestep="{DT}" cone="elliptic" impratio="{physics.impratio}" gravity="0 0 {-G}"/>
        <worldbody><geom name="ground" type="plane" size="0 0 1" contype="0" conaffinity="0"/>
          <body pos="{text(pos)}" quat="{text(quat)}"><freejoint/>
            <inertial pos="0 0 0" mass="{MASS_KG}" diaginertia="{text(moments)}"/>
            <geom name="box" type="box" size="{text(half + physics.skin_m)}" contype="0" conaffinity="0"/>
          </body></worldbody>
        <contact><pair geom1="ground" geom2="box" condim="3" margin="{-physics.skin_m}"
          friction="{text([friction[0], friction[0], *friction[1:], friction[2]])}" solref="{text(physics.solref)}"
          solreffriction="{text(physics.solreffriction)}" solimp="{text([*physics.solimp, 0.5, 2.0])}"/></contact>
        </mujoco>""")
    data = mujoco.MjData(model)
    poses = []
    for time_s in times:
        while data.time < time_s - DT / 2:
            mujoco.mj_step(model, data)
        poses.append(data.qpos.copy())
    return np.array(poses)


@pytest.mark.parametrize(("height_m", "tilt_deg"), [(0.05, 0.0), (0.051, 0.0), (0.0505, 0.2)])
def test_a_model_written_by_hand_moves_alike(height_m: float, tilt_deg: float) -> None:
    times = np.arange(0, 0.6, 0.02)
    pos, quat = (0.1, 0.2, height_m), turn(np.array([1.0, 0.5, 0.0]), np.radians(tilt_deg))
    moved = release(pos_m=[pos], quat_wxyz=quat, times_s=times, physics={"landing_s": 0.0})
    expected = by_hand(pos, quat, times)
    np.testing.assert_allclose(moved.pos_m[0], expected[:, :3], atol=TWIN_M)
    np.testing.assert_allclose(moved.quat_wxyz[0], expected[:, 3:], atol=TWIN_M / 0.15)


def test_friction_of_each_world_says_how_far_a_box_slides() -> None:
    friction, speed = np.array([0.2, 0.3, 0.5]), 0.5
    moved = release(pos_m=[(0, 0, 0.0499)] * 3, vel_m_s=(speed, 0, 0), friction=friction, times_s=[0.0, 1.0])
    way = moved.pos_m[:, 1, 0] - moved.pos_m[:, 0, 0]
    np.testing.assert_allclose(way, speed**2 / (2 * friction * G), rtol=0.05)


@pytest.mark.parametrize("engine", ["mujoco", "mjx-warp-cpu"])
def test_boxes_of_a_world_stack_on_a_carrier(engine: str) -> None:
    places = [[(0.6, 0.4, 0.05), (0.6, 0.4, 0.1505)], [(0.6, 0.4, 0.05), (2.0, 0.4, 0.05)]]
    moved = release(engine, pos_m=places, ground="epal-1", times_s=[0.0, 0.4])
    assert moved.pos_m.shape == (2, 2, 2, 3)
    assert moved.quat_wxyz.shape == (2, 2, 2, 4)
    np.testing.assert_allclose(moved.pos_m[0, :, 1, 2], [0.05, 0.15], atol=5e-4)
    # beside the pallet, the box lands on the floor, which is 144 mm lower
    assert moved.pos_m[1, 1, 1, 2] == pytest.approx(0.05 - 0.144, abs=5e-4)


@pytest.mark.parametrize("engine", ["mujoco", "mjx-warp-cpu"])
def test_a_world_moves_the_same_in_any_company(engine: str) -> None:
    rng = np.random.default_rng(5)
    some: dict[str, Any] = {
        "pos_m": rng.uniform(0.2, 0.4, (3, 3)),
        "vel_m_s": rng.uniform(-1, 1, (3, 3)),
        "angvel_rad_s": rng.uniform(-5, 5, (3, 3)),
    }
    times = {"times_s": [0.1, 0.4]}
    together = release(engine, **some, **times)
    alone = release(engine, **{name: values[1:2] for name, values in some.items()}, **times)
    np.testing.assert_array_equal(alone.pos_m[0], together.pos_m[1])
    np.testing.assert_array_equal(alone.quat_wxyz[0], together.quat_wxyz[1])


def test_between_two_steps_places_go_straight_and_orientations_by_the_shortest_turn() -> None:
    times = np.array([0.1, 0.1005, 0.101, 0.102])
    moved = release(**{name: [values] for name, values in FLIGHT.items()}, times_s=times)
    pos, quat = moved.pos_m[0], moved.quat_wxyz[0]
    np.testing.assert_allclose(pos[1], 0.75 * pos[0] + 0.25 * pos[3], atol=1e-15)
    full_turn = angle(quat[0], quat[3])
    assert angle(quat[0], quat[1]) == pytest.approx(full_turn / 4, rel=1e-6)
    assert angle(quat[2], quat[3]) == pytest.approx(full_turn / 2, rel=1e-6)


def test_a_heavier_inertia_turns_more_slowly_when_a_box_tips() -> None:
    tipped = {"pos_m": [(0.0, 0.0, 0.15)] * 2, "quat_wxyz": turn(np.array([0.0, 1.0, 0.0]), 0.3)}
    solid = MASS_KG / 12 * np.array([0.3**2 + 0.1**2, 0.3**2 + 0.1**2, 2 * 0.3**2])
    moved = release(**tipped, inertia_kg_m2=[solid, 3 * solid], times_s=[0.0, 0.12])
    alike = release(pos_m=tipped["pos_m"][:1], quat_wxyz=tipped["quat_wxyz"], times_s=[0.0, 0.12])
    np.testing.assert_allclose(moved.pos_m[0], alike.pos_m[0], atol=1e-12)
    light, heavy = (angle(quat[0], quat[1]) for quat in moved.quat_wxyz)
    assert heavy < 0.7 * light


def test_what_ran_astray_is_no_number(monkeypatch: pytest.MonkeyPatch) -> None:
    def astray(engine: MujocoEngine, bodies: FreeBodies, sim: petmjx.Simulation) -> NDArray[np.float64]:
        poses = paths(engine, bodies, sim)
        poses[0, 1:] = np.nan
        return poses

    paths = MujocoEngine.paths
    monkeypatch.setattr(MujocoEngine, "paths", astray)
    moved = release(pos_m=[(0, 0, 0.1), (0, 0, 0.2)], times_s=[0.0, 0.01, 0.02])
    assert np.isfinite(moved.pos_m[0, 0]).all()
    assert np.isnan(moved.pos_m[0, 1:]).all()
    assert np.isfinite(moved.pos_m[1]).all()


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"size_mm": (1, 2)}, r"size_mm must have the shape \(n, 3\) or \(n, k, 3\), got \(2,\)"),
        ({"size_mm": (0.3, 0.3, 0.1)}, "size_mm must be from 1 to 4000, got 0.3"),
        ({"mass_kg": -1}, "mass_kg must be from 0.001 to 10000, got -1"),
        ({"mass_kg": "heavy"}, "mass_kg must be an array of numbers, got 'heavy'"),
        ({"pos_m": (0, 0, 1)}, r"pos_m must have the shape \(n, 3\) or \(n, k, 3\), got \(3,\)"),
        ({"pos_m": [(0, 0, np.nan)]}, "pos_m must be finite"),
        ({"quat_wxyz": (1, 1, 0, 0)}, "quat_wxyz must have the length 1, got 1.41421"),
        (
            {"vel_m_s": [STILL] * 3, "pos_m": [STILL] * 2},
            r"vel_m_s has the axes \(3,\), which do not fit the axes \(2,\)",
        ),
        ({"angvel_rad_s": (0, 0, 2000)}, "angvel_rad_s must be from -1000 to 1000, got 2000"),
        ({"times_s": (0.2, 0.1)}, "times_s must increase"),
        ({"times_s": ()}, "times_s must have at least one time"),
        ({"times_s": (-0.1,)}, "times_s must increase, and lie between 0"),
        ({"inertia_kg_m2": (1, 1, 3)}, "inertia_kg_m2 must be possible for a body"),
        ({"friction": -0.1}, "friction must be from 0 to 100, got -0.1"),
        ({"restitution": 1.5}, "restitution must be from 0 to 0.9, got 1.5"),
        ({"ground": "moon"}, "ground must be 'plane', 'euro-pallet', .* or a TOML file of boards, got 'moon'"),
        ({"ground": "footprint"}, "ground must be .* got 'footprint'"),
        ({"ground": "none.toml"}, "none.toml: "),
        ({"physics": np.zeros(3)}, "physics must be a table, a record or the name of a preset"),
        ({"physics": "lunar"}, "physics must be pallet or reference"),
        ({"engine": "abacus"}, "engine must be one of mujoco"),
    ],
)
def test_a_bad_argument_is_one_line_that_names_it(changes: dict[str, Any], line: str) -> None:
    arguments = {"engine": "mujoco", **changes}
    with pytest.raises(InputError, match=line) as caught:
        release(**arguments)
    assert "\n" not in str(caught.value)


class Judge(Engine):
    """An engine of a user that cannot simulate released boxes."""

    name = "judge"

    def run(self, jobs: Sequence[Job], sim: petmjx.Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        raise NotImplementedError


def test_an_engine_without_paths_is_told_so() -> None:
    with pytest.raises(
        InputError, match="engine judge cannot simulate released boxes; use mujoco, mjx-warp, mjx-warp-cpu or mjx-jax"
    ):
        release(Judge())


def test_an_engine_that_is_given_is_taken_and_stays_open() -> None:
    engine = MujocoEngine(1)
    first, again = release(engine), release(engine)
    assert first.engine == "mujoco"
    np.testing.assert_array_equal(first.pos_m, again.pos_m)
