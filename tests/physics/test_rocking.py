"""Simulated blocks that rock, slide and are tilted are compared with the equations of motion of a single rigid block
(benchmarks/rocking.py)."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import pytest

import petmjx
from benchmarks.rocking import (
    BOX_FRICTION,
    EUMOS_S,
    ROUGH,
    SETTLES_S,
    SHARP,
    RockingBlock,
    block_plan,
    eumos_levels,
    largest_level_g,
    overturning_limits,
    swept,
    tilting,
    trapezoid,
    wrapped_levels,
)
from petmjx.engines.verdict import Flag

pytestmark = pytest.mark.slow
needs_warp = pytest.mark.skipif(find_spec("warp") is None, reason="warp-lang is not installed (extra: warp)")

LEVEL_G = 0.01
"""Step of the levels in searches, g. Limits cannot be known more finely."""
OVERTURNS_G = 0.004
"""Difference in g by which the smallest pulse of 0.2 s that overturns a block of 150 × 600 mm may be below the closed
form: 0.7 %."""
LATE_DEG = 0.06
"""Tolerance of the angle at which a tilt is detected. The tolerance has two causes: the time between two checks, which
is 0.05° at 5°/s, and the compression of contacts."""

TOWER = RockingBlock(0.3, 1.0)
ROCKS_G = (0.34, 0.38, 0.42)
FALLS_G = (0.44, 0.5)
"""Levels at which the block ``TOWER`` rocks, and levels at which it falls. By the equations of motion, a block of 300 ×
1000 mm rocks at 0.3 g and more, and falls at 0.43 g and more."""


def test_the_block_itself_keeps_to_what_is_known_of_it() -> None:
    """The block's characteristic numbers agree with values computed by hand, and a small free swing with Housner's
    quarter period, acosh(1 / (1 − θ₀/α)) / p."""
    assert TOWER.slenderness_rad == pytest.approx(0.29146, abs=1e-5)
    assert TOWER.rate_squared == pytest.approx(3 * 9.81 / (4 * 0.52202), rel=1e-4)
    thin = RockingBlock(0.1, 2.0)  # so slender that α − θ is practically equal to its sine
    swing = thin.rock(lambda _: 0.0, 3.0, 0.0, start=(thin.slenderness_rad / 2, 0.0))
    assert swing.impacts_s[0] == pytest.approx(1.31696 / thin.rate_squared**0.5, rel=0.002)
    assert not any(TOWER.rock(trapezoid(level), SETTLES_S, EUMOS_S).fell for level in ROCKS_G)
    assert all(TOWER.rock(trapezoid(level), SETTLES_S, EUMOS_S).fell for level in FALLS_G)
    # computed by hand: (0.53 − 0.5) g for 0.3 s, then friction brakes
    assert largest_level_g(RockingBlock(0.5, 0.2), 0.5) == 0.53
    # tilted by 50° or more, it falls by itself
    squat = RockingBlock(0.3, 0.25).rock(trapezoid(1.32), SETTLES_S, EUMOS_S)
    assert squat.lost
    assert not squat.fell


ENGINES = "mujoco", pytest.param("mjx-warp-cpu", marks=needs_warp)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_tower_that_rocks_and_comes_back_stands(engine: str) -> None:
    levels = [*ROCKS_G, *FALLS_G]
    axes = f'[axes]\nprofile = "eumos-40509"\nlevel = {levels}\nfriction_factor = {ROUGH / BOX_FRICTION}\n'
    worlds = swept([block_plan("tower", 300.0, [250.0] * 4)], engine, axes).worlds.sort_values("level_g")
    # so the verdicts change only once as the level rises
    assert worlds.verdict.tolist() == ["stable"] * len(ROCKS_G) + ["unstable"] * len(FALLS_G)
    stable_worlds = worlds[worlds.verdict == "stable"]
    assert not any(flags & Flag.MOVING for flags in stable_worlds["flags"])
    assert (
        stable_worlds.eumos_elastic_share.iloc[1:] > 0.05
    ).all()  # as a share of 1 m, so far beyond the threshold of shift, 0.02 m
    assert (stable_worlds.eumos_permanent_share < 1e-4).all()
    assert (stable_worlds.max_shift_m == 0.0).all()
    assert (stable_worlds["mode"] == "").all()


def test_the_largest_levels_of_eumos_s_test_are_those_of_a_rigid_block() -> None:
    """Three stacks: one slides at 0.34 g and more; one rocks instead and falls at 0.36 g and more; and one tilts by
    more than the threshold but would come back."""
    levels = *eumos_levels("mujoco", stacks=(3, 5), frictions=(0.3,)), *eumos_levels("mujoco", (2,), (0.9,))
    for row in levels:
        assert row.value == pytest.approx(row.expected, abs=1.001 * LEVEL_G), row


def test_a_wrapped_box_is_lost_at_coulomb_s_level_with_what_film_holds() -> None:
    rows = list(wrapped_levels("mujoco"))
    assert [row.expected for row in rows] == sorted({row.expected for row in rows})
    for row in rows:
        assert row.value == pytest.approx(row.expected, abs=1.001 * LEVEL_G), row


def test_a_pulse_overturns_a_block_at_housner_s_level_but_for_what_its_edge_sinks() -> None:
    """Contacts are compressed by up to a tenth of a millimetre, and the block must rise by 9.2 mm to fall."""
    (row,) = overturning_limits("mujoco", pulses_s=(0.2,), within=0.008)
    assert row.expected == 0.602
    assert 0 < row.expected - row.value <= OVERTURNS_G
    (sharp,) = overturning_limits("mujoco", (0.2,), SHARP, within=0.008)
    assert sharp.expected - sharp.value <= OVERTURNS_G / 3


def test_tilts_are_late_by_what_closed_forms_say() -> None:
    rows = tilting("mujoco", frictions=(0.2,), blocks=(RockingBlock(0.15, 0.9),))
    late = [row for row in rows if row.quantity.startswith("further tilt of the carrier")]
    assert len(late) == 4
    for row in late:
        assert row.value == pytest.approx(row.expected, abs=LATE_DEG), row
        assert row.value < (0.6 if "quasi-static" in row.quantity else 2.7)


SLENDER = {"alone": [900.0], "with a box on top": [900.0, 300.0]}


@pytest.mark.parametrize("heights_mm", SLENDER.values(), ids=SLENDER.keys())
def test_what_tines_let_rock_is_judged_at_rest(heights_mm: list[float]) -> None:
    """A box that rocks by more than the threshold of shift comes to rest at its place, and the next box is placed only
    then."""

    def scored(**options: Any) -> Any:
        plan, tines = block_plan("slender", 150.0, heights_mm), {"name": "tines", "tines_mm": 10}
        run = petmjx.score([plan], engine="mujoco", threads=1, carrier="euro-pallet", placing=tines, **options)
        return run.worlds.iloc[0]

    world = scored()
    assert (world.verdict, world["flags"], world.max_shift_m) == ("stable", 0, 0.0)
    impatient = scored(longest_wait_s=0.8)
    assert impatient["flags"] & Flag.MOVING  # the verdict does not matter


@pytest.mark.parametrize("engine", ENGINES)
def test_pallets_say_that_a_box_still_rocks(engine: str) -> None:
    for longest_wait_s, stands in ((0.4, False), (10.0, True)):
        tines = {"name": "tines", "tines_mm": 10}
        pallets = petmjx.Pallets(1, engine=engine, threads=1, placing=tines, longest_wait_s=longest_wait_s)
        report = pallets.place(size_mm=[[150, 300, 900]], corner_mm=[[500, 250, 0]], mass_kg=[10.0], pallet=[0])
        assert (report.stable[0], report.moving[0], report.ended[0]) == (stands, not stands, False)
        pallets.close()
