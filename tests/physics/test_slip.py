"""Contacts that slide (petmjx/world/contact_laws.py): results of all engines agree with closed forms of Coulomb's
law."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from support.plans import make_plan, stack

import petmjx
from petmjx.engines.mujoco.slip import SlipLaw
from petmjx.runs.hopeless_profiles import slide_m
from petmjx.world.contact_laws import FIRST_SHARE, MOST_ROUNDS, next_share
from petmjx.world.profiles.accelerations import HalfSine, eumos_40509

G = petmjx.Physics().gravity_m_s2
ENGINES = ("mujoco", "mjx-warp-cpu")

FRICTION = np.array([0.2, 0.2, 0.5, 0.5, 0.7, 0.7])
SPEED_M_S = np.array([0.5, 2.0] * 3)
HEIGHT_M = 0.1
TIMES_S = np.arange(0.0, 1.3, 0.01)

LIFT_M = 0.0005
"""Largest height by which a level box that slides may lift off, m. A sliding box lifts off by the depth of its
contacts, a tenth of a millimetre. Without petmjx's correction, a sliding box would lift off by up to 45 mm."""

WAY, WAY_M = 0.01, 0.001
"""Relative and absolute tolerance of the distance that a box slides, m. Below a speed of one centimetre per second, the
contact sticks."""

SHOCK_WAY_M = 0.0002
"""Absolute tolerance of the distance that a pile slides in a shock, m. If the solver stops after 7 iterations, the pile
slides by 6 mm instead of 10 mm."""


def slide(engine: str, n_boxes: int = 1, physics: dict[str, Any] | None = None) -> NDArray[np.float64]:
    """(n, t, 3) centre of the uppermost box of a stack, which slides from the beginning, m."""
    worlds = len(FRICTION)
    size_mm = np.array([(1500.0, 900.0, 100.0)] * (n_boxes - 1) + [(400.0, 300.0, 100.0)])
    pos_m, vel_m_s = np.zeros((2, worlds, n_boxes, 3))
    pos_m[..., 2] = HEIGHT_M * (0.5 + np.arange(n_boxes))
    vel_m_s[:, -1, 0] = SPEED_M_S
    if n_boxes > 1:
        pos_m[:, -1, 0] = -0.5
    with jax.numpy_rank_promotion("allow"):  # MJX broadcasts as NumPy does
        paths = petmjx.release(
            size_mm=size_mm[None],
            mass_kg=10.0 if n_boxes == 1 else np.array([[1000.0, 10.0]]),
            pos_m=pos_m,
            quat_wxyz=(1.0, 0.0, 0.0, 0.0),
            vel_m_s=vel_m_s,
            angvel_rad_s=(0.0, 0.0, 0.0),
            times_s=TIMES_S,
            friction=FRICTION[:, None],
            physics=physics or "pallet",
            engine=engine,
        ).pos_m
    return paths[:, -1]


def way_m(friction: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) distance that a box slides until the last time, m. By then, all boxes have come to rest except the fastest
    box on the smallest friction."""
    stops_s = np.minimum(SPEED_M_S / (friction * G), TIMES_S[-1])
    return SPEED_M_S * stops_s - friction * G * stops_s**2 / 2


@pytest.mark.parametrize(
    ("engine", "kinetic"),
    [("mujoco", 1.0), ("mujoco", 0.75), ("mjx-warp-cpu", 1.0), ("mjx-warp-cpu", 0.75), ("mjx-jax", 0.75)],
)
def test_a_level_box_that_slides_stays_on_the_ground_and_slides_as_far_as_coulomb_says(
    engine: str, kinetic: float
) -> None:
    # mjx-jax takes half a minute to compile, so only the harder of the two cases is tested with it
    place = slide(engine, physics={"kinetic_friction_share": kinetic})
    assert (place[..., 2] - place[:, -1:, 2]).max() < LIFT_M
    np.testing.assert_allclose(place[:, -1, 0], way_m(kinetic * FRICTION), rtol=WAY, atol=WAY_M)
    assert np.abs(place[..., 1]).max() < LIFT_M


@pytest.mark.parametrize("engine", ENGINES)
def test_one_that_slides_on_another_box_stays_on_it(engine: str) -> None:
    place = slide(engine, n_boxes=2)
    kept = way_m(FRICTION) < 0.9  # cases in which the centre stays above the lower box
    assert (place[kept, :, 2] - place[kept, -1:, 2]).max() < LIFT_M
    np.testing.assert_allclose(place[kept, -1, 0] + 0.5, way_m(FRICTION)[kept], rtol=WAY, atol=WAY_M)


@pytest.mark.parametrize("engine", ENGINES)
def test_kinetic_friction_acts_in_drives_and_only_once_a_box_slides(engine: str, tmp_path: Path) -> None:
    levels = [0.48, 0.6, 0.7]  # the coefficient of static friction is 0.5
    plan = petmjx.Plan.from_boxes("box", size_mm=[[400, 300, 100]], corner_mm=[[400, 250, 0]], mass_kg=[10.0])
    file = tmp_path / "drive.toml"
    file.write_text(f"""
        [simulation]
        carrier = "euro-pallet"
        early_stop = false
        thresholds = {{ shift_m = 1.0 }}
        physics = {{ kinetic_friction_share = 0.75 }}
        [axes]
        profile = "eumos-40509"
        level = {levels}
    """)
    boxes = petmjx.sweep(file, [plan], engine=engine, threads=1).boxes
    samples = eumos_40509().excitation(petmjx.Physics().timestep_s).samples
    ways = [slide_m(level * samples, 0.5, G, petmjx.Physics().timestep_s, kinetic=0.75) for level in levels]
    assert ways[0] == 0
    np.testing.assert_allclose(0.6 - boxes.pos_x_m, ways, rtol=WAY, atol=WAY_M)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_shock_moves_a_pile_as_far_as_coulomb_says(engine: str, tmp_path: Path) -> None:
    """In the steps of a shock, the solver needs many iterations."""
    level, n = 5.0, 3
    plan = make_plan(boxes=stack(n, size_mm=(400.0, 300.0, 100.0), kg=10.0, at_mm=(300.0, 250.0)))
    file = tmp_path / "shock.toml"
    file.write_text(f"""
        simulation = {{ carrier = "euro-pallet" }}
        axes = {{ profile = "half-sine", level = {level}, direction = "+y" }}
    """)
    boxes = petmjx.sweep(file, [plan], engine=engine, threads=1).boxes
    timestep_s = petmjx.Physics().timestep_s
    way = slide_m(level * HalfSine().excitation(timestep_s).samples, 0.5, G, timestep_s)
    np.testing.assert_allclose(-boxes.shift_y_m, [way] * n, atol=SHOCK_WAY_M)


def test_without_the_correction_it_hops() -> None:
    place = slide("mujoco", physics={"slip_correction": False})
    assert (place[..., 2] - place[:, -1:, 2]).max() > 20 * LIFT_M


def test_the_next_share_of_an_excess_leaves_no_change_where_it_is_linear() -> None:
    slope = np.array([0.5, 0.7, 1.0, 1.5])  # derivative of the change with respect to the excess
    share, change, none = np.full(4, FIRST_SHARE), np.array([3.0, -2.0, 0.5, 8.0]), np.zeros(4)
    np.testing.assert_array_equal(next_share(share, change, none), share)
    left = (1 - share * slope) * change
    np.testing.assert_allclose((1 - next_share(share, left, change) * slope) * left, none, atol=1e-12)
    # if the last share has made the change larger with the opposite sign, the share is halved
    assert next_share(share, -2 * change, change)[0] == FIRST_SHARE / 2


def test_a_heap_that_tumbles_needs_few_solutions_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    solved = []
    solve, law = mujoco.mj_fwdConstraint, SlipLaw._solve

    def counted(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        solved[-1] += 1
        solve(model, data)

    def step(self: SlipLaw, *of_step: Any) -> None:
        solved.append(0)
        law(self, *of_step)

    monkeypatch.setattr(mujoco, "mj_fwdConstraint", counted)
    monkeypatch.setattr(SlipLaw, "_solve", step)
    n = 8  # number of bricks that fall beside and onto each other
    rng = np.random.default_rng(5)
    petmjx.release(
        size_mm=np.tile((300.0, 200.0, 100.0), (1, n, 1)),
        mass_kg=np.full((1, n), 4.0),
        pos_m=np.stack([0.1 * rng.normal(size=n), 0.1 * rng.normal(size=n), 0.1 + 0.15 * np.arange(n)], axis=-1)[None],
        quat_wxyz=(1.0, 0.0, 0.0, 0.0),
        vel_m_s=rng.normal(0, 0.5, (1, n, 3)),
        angvel_rad_s=rng.normal(0, 2.0, (1, n, 3)),
        times_s=[1.0],
        friction=0.5,
        engine="mujoco",
    )
    assert len(solved) > 200
    assert np.mean(solved) < 4.1  # it would be 4.5 with a fixed share of 0.8
    assert np.mean(np.array(solved) > MOST_ROUNDS) < 0.15  # it would be 0.17
