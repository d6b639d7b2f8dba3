"""Sliding blocks compared with closed forms, and the profiles that no unsecured load can survive."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from support.command_line import write
from support.plans import make_plan

import petmjx
from petmjx.runs.hopeless_profiles import hopeless_profiles, slide_m
from petmjx.runs.ready_sweeps import find_sweep
from petmjx.runs.sweep_file import load_sweep
from petmjx.world.contact_laws import STICKS_M_S
from petmjx.world.profiles.accelerations import eumos_40509

G = 9.81
DT = 0.002
FORWARD = "en-12195-1-forward reaches 0.8 g: with friction 0.5 no unsecured load stays in place"


def steady(acceleration: tuple[float, float, float], duration_s: float) -> np.ndarray:
    """(steps, 3) an acceleration, m/s², that is constant for ``duration_s``."""
    return np.tile(np.array(acceleration), (round(duration_s / DT), 1))


@pytest.mark.parametrize("direction_deg", [0.0, 90.0, 200.0])
@pytest.mark.parametrize("level_g", [0.6, 0.8, 1.5])
def test_a_block_slides_as_newton_says(level_g: float, direction_deg: float) -> None:
    # for 0.3 s the block accelerates with a − µg, then friction brakes it: distance v²/2 · (1/(a − µg) + 1/µg)
    angle = math.radians(direction_deg)
    push = steady((level_g * G * math.cos(angle), level_g * G * math.sin(angle), 0.0), 0.3)
    excess = (level_g - 0.5) * G
    speed = excess * 0.3
    expected = speed**2 / 2 * (1 / excess + 1 / (0.5 * G))
    assert slide_m(push, 0.5, G, DT) == pytest.approx(expected, rel=1e-9)
    standing_after = np.vstack([push, steady((0, 0, 0), 2.0)])
    # in the step in which the block stops, its speed is taken to be 0 only at the step's end
    assert slide_m(standing_after, 0.5, G, DT) == pytest.approx(expected, rel=5e-3)


def test_a_block_stays_up_to_its_friction() -> None:
    assert slide_m(steady((0.4999 * G, 0, 0), 10.0), 0.5, G, DT) == 0.0
    assert slide_m(steady((0.6 * G, 0, 0.3 * G), 10.0), 0.5, G, DT) == 0.0  # the load is 30 % heavier
    assert slide_m(steady((0.4 * G, 0, -0.3 * G), 1.0), 0.5, G, DT) > 0.0  # the load is lighter
    assert slide_m(steady((0.1, 0, 0), 0.1), 0.0, G, DT) == math.inf  # nothing ever stops the load
    assert slide_m(np.zeros((0, 3)), 0.5, G, DT) == 0.0


def test_a_block_and_a_single_box_agree() -> None:
    # docs/sweeps.md: a single box survives eumos-40509 at 0.53 g, and not at 0.54 g
    unit = eumos_40509().excitation(DT).samples
    assert slide_m(0.53 * unit, 0.5, G, DT) < 0.02 < slide_m(0.54 * unit, 0.5, G, DT)


def test_a_block_that_slides_has_its_kinetic_friction() -> None:
    # The load is accelerated by 0.6 g for 0.3 s. The friction coefficient is 0.5 up to 1 cm/s, and 0.4 from 2 cm/s on.
    # Between these speeds, the acceleration grows in proportion to the speed, from 0.1 g to 0.2 g.
    push_s, share = 0.3, 0.8
    unit_s = STICKS_M_S / (0.1 * G)
    begin, begin_m = unit_s * (1 + math.log(2)), unit_s * STICKS_M_S * (1 / 2 + 1)
    speed = 2 * STICKS_M_S + 0.2 * G * (push_s - begin)
    expected = begin_m + (speed + 2 * STICKS_M_S) / 2 * (push_s - begin) + speed**2 / (2 * 0.4 * G)
    push = steady((0.6 * G, 0, 0), push_s)
    assert slide_m(push, 0.5, G, DT, kinetic=share) == pytest.approx(expected, rel=0.01)
    assert slide_m(steady((0.4999 * G, 0, 0), 10.0), 0.5, G, DT, kinetic=share) == 0.0


def test_the_farthest_place_counts_not_the_last() -> None:
    push = steady((0.8 * G, 0, 0), 0.3)
    back = np.vstack([push, -2 * push, push])
    assert slide_m(back, 0.5, G, DT) >= slide_m(push, 0.5, G, DT, enough_m=0.1) > 0.1


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[axes]\nprofile = 'en-12195-1'", [FORWARD]),
        ("[axes]\nprofile = 'en-12195-1'\nscale = 0.6", []),
        ("[axes]\nprofile = 'en-12195-1'\nfriction_factor = 2.0", []),
        ("[axes]\nprofile = 'en-12195-1-forward'\nfriction_factor = [0.5, 1.0]", [FORWARD.replace("0.5", "up to 0.5")]),
        ("[simulation]\nphysics = 'reference'\n[axes]\nprofile = 'en-12195-1'", []),
        ("[axes]\nprofile = 'eumos-40509'\nlevel = [0.8, 0.5, 0.6]",
         ["eumos-40509 reaches 0.6 g from level 0.6 on: with friction 0.5 no unsecured load stays in place"]),
        ("mode = 'sample'\nsample = 2\n[axes]\nprofile = 'eumos-40509'\nlevel = {from = 0.2, to = 1.0}",
         ["eumos-40509 reaches 0.6 g from level 0.6 on: with friction 0.5 no unsecured load stays in place"]),
        ("[simulation]\nphysics = {kinetic_friction_share = 0.7}\n[axes]\nprofile = 'eumos-40509'\nlevel = [0.52, 1]",
         ["eumos-40509 reaches 0.52 g from level 0.52 on: with friction 0.5 no unsecured load stays in place"]),
        ("[axes]\nprofile = 'tilt'", ["tilt reaches 45°: with friction 0.5 no unsecured load stays in place"]),
        ("[axes]\nprofile = ['half-sine', 'eumos-40509']\nlevel = 0.5", []),
        ("[axes]\nprofile = 'radial'\nscale = 100", []),
        ("[axes]\nprofile = 'eumos-40509'\n[search]\nupper = 1.0", []),
        ("[axes]\nfriction_factor = 1.0", []),
    ],
)  # fmt: skip
def test_profiles_that_no_load_survives_are_named(text: str, expected: list[str], tmp_path: Path) -> None:
    file = write(tmp_path / "x.toml", f'plans = "samples"\n{text}')
    assert hopeless_profiles(load_sweep(file)) == expected


def test_a_run_says_so_and_is_right(tmp_path: Path) -> None:
    results = petmjx.sweep(find_sweep("en-12195-1"), [make_plan("box", 1)], engine="mujoco")
    assert results.info["warnings"] == [FORWARD]
    assert results.info["counts"]["odd_plans"] == 0
    verdicts = results.worlds.groupby("profile")["verdict"].unique()
    assert {name: values.tolist() for name, values in verdicts.items()} == {
        "en-12195-1-forward": ["unstable"],
        **{f"en-12195-1-{side}": ["stable"] for side in ("rearward", "left", "right")},
    }
