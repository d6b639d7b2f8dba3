"""Tests of the strength of boxes in a stack. The strength depends on which walls stand on walls, on edges, gaps and
sheets. Loads are forces at rest and at the peak."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.command_line import only_line, run

import petmjx
from petmjx.analysis.carton_walls import walls_of
from petmjx.common.units import STANDARD_GRAVITY
from petmjx.options.carriers import Carrier
from petmjx.options.strength_losses import Stacking
from petmjx.plans.plan import Plan
from petmjx.world.carrier_boards import pallet

SIZE = (400.0, 300.0, 200.0)
KG = 8.0


def stacked(*places: tuple[float, float, float] | tuple[float, float, float, tuple[float, float, float]]) -> Plan:
    """A plan with boxes at the given corners. A place may have a size of its own. Boxes of 2 mm height are sheets."""
    sizes = [place[3] if len(place) > 3 else SIZE for place in places]
    kinds = ["sheet" if size[2] == 2 else "box" for size in sizes]
    return Plan.from_boxes(
        "p",
        size_mm=sizes,
        corner_mm=[place[:3] for place in places],
        mass_kg=[0.4 if kind == "sheet" else KG for kind in kinds],
        article=["tie" if kind == "sheet" else "carton" for kind in kinds],
        kind=kinds,
        strength_n=[np.nan if kind == "sheet" else 1000.0 for kind in kinds],
    )


def met(*places: Any, tolerance_mm: float = 10.0) -> list[float]:
    return [round(float(share), 9) for share in walls_of(stacked(*places), None, None, tolerance_mm).met]


def hanging(*places: Any, extent: tuple[float, float] | None = None) -> list[float]:
    return [round(float(share), 9) for share in walls_of(stacked(*places), extent, None, 0.0).hanging]


TURNED = (300.0, 400.0, 200.0)
BASE = 1400.0
"""Perimeter of a box, mm."""


def test_walls_that_walls_stand_on() -> None:
    """The share of a box's walls on which walls of the box above stand: 1 in a column, also with offsets within the
    tolerance; parts of two walls if the upper box is offset; 0 if it is offset along both axes."""
    assert met((0, 0, 0), (0, 0, 200)) == [1.0, 1.0]
    assert met((0, 0, 0), (8, -9, 200)) == pytest.approx([(4 * BASE / 4 - 2 * 8 - 2 * 9) / BASE, 1.0])
    assert met((0, 0, 0), (100, 0, 200)) == pytest.approx([2 * 300 / BASE, 1.0])
    assert met((0, 0, 0), (100, 100, 200)) == [0.0, 1.0]
    assert met((0, 0, 0), (50, -50, 200, TURNED)) == [0.0, 1.0]
    assert met((0, 0, 0), (100, 0, 200, (200.0, 150.0, 200.0))) == pytest.approx([200 / BASE, 1.0])
    # four boxes on one: only their outer walls stand on walls, and two walls that touch count once
    small = (200.0, 150.0, 100.0)
    four = [(x, y, 200.0, small) for x in (0.0, 200.0) for y in (0.0, 150.0)]
    assert met((0, 0, 0), *four)[0] == pytest.approx(1.0)
    assert met((0, 0, 0), (0, 0, 200), (0, 0, 200.0, small))[0] == pytest.approx(1.0)


def test_sheets_are_passed_through() -> None:
    """Walls stand on walls also through sheets, however many sheets there are, and in whichever order boxes are
    given."""
    sheet = (800.0, 600.0, 2.0)
    assert met((0, 0, 0), (0, 0, 200, sheet), (0, 0, 202))[0] == 1.0
    assert met((0, 0, 204), (0, 0, 0), (0, 0, 200, sheet), (0, 0, 202, sheet))[1] == 1.0
    assert met((0, 0, 0), (0, 0, 200, sheet), (100, 0, 202))[0] == pytest.approx(600 / BASE)
    # a sheet extends beyond the lower box; a box on this part of the sheet does not stand on the lower box
    assert met((0, 0, 0), (0, 0, 200, sheet), (400, 0, 202))[0] == 1.0
    assert walls_of(stacked((0, 0, 0, sheet), (0, 0, 2)), None, None, 0.0).on_deck.tolist() == [True, True]


def test_walls_over_nothing() -> None:
    assert hanging((0, 0, 0), (0, 0, 200)) == [0.0, 0.0]
    # 100 mm of each of two walls, and all of a third wall, hang over
    assert hanging((0, 0, 0), (100, 0, 200))[1] == pytest.approx((2 * 100 + 300) / BASE)
    assert hanging((0, 0, 0), (400, 0, 0), (200, 0, 200))[2] == 0.0
    # on two boxes with a gap between them: 100 mm of each of two walls hang over
    assert hanging((0, 0, 0), (500, 0, 0), (250, 0, 200))[2] == pytest.approx(2 * 100 / BASE)
    assert hanging((-50, 0, 0), extent=(1200.0, 800.0))[0] == pytest.approx((2 * 50 + 300) / BASE)
    assert hanging((0, 0, 500)) == [0.0]  # the box floats, so its support is unknown


def test_gaps_of_a_deck() -> None:
    """The deck boards of the Euro pallet are 145 and 100 mm wide and run along x. So a wall along y crosses gaps, and a
    wall along x may stand on a single board."""
    deck = pallet(Carrier.EPAL_1)
    assert deck is not None
    boards = deck.deck_mm
    y = np.sort(boards[:, :, 1], axis=0)
    gap = float(y[1, 0] - y[0, 1])
    plan = stacked((0, 0, 0, (200.0, 145.0, 100.0)), (0, 0, 100), (300, 0, 0, (200.0, 145 + gap + 20, 100.0)))
    walls = walls_of(plan, (1200.0, 800.0), boards, 0.0)
    assert walls.over_gaps[:2].tolist() == [0.0, 0.0]
    assert walls.over_gaps[2] == pytest.approx(2 * gap / (2 * (345 + gap + 20)))
    assert walls.on_deck.tolist() == [True, False, True]


# strengths of the boxes of a run


def loads_of(plan: Plan, carrier: str = "footprint", **stacking: Any) -> Any:
    results = petmjx.score(plan, engine="mujoco", threads=1, carrier=carrier)
    return petmjx.loads(results, stacking=stacking or None)


def test_strength_is_that_of_the_press_times_the_factors() -> None:
    plan = stacked((0, 0, 0), (100, 0, 200))
    boxes = loads_of(plan, "epal-1").boxes
    assert boxes["press_strength_n"].tolist() == [1000, 1000]
    assert boxes["wall_factor"].tolist() == pytest.approx([1 - 0.5 * (1 - 600 / BASE), 1.0])
    assert boxes["overhang_factor"].tolist() == pytest.approx([1.0, 1 - (2 * 90 + 300) / BASE])
    assert boxes["deck_factor"].tolist() == pytest.approx([1 - 0.26, 1.0])
    factors = boxes[["wall_factor", "overhang_factor", "deck_factor"]].prod(axis=1)
    assert boxes["strength_n"].tolist() == pytest.approx((1000 * factors).tolist())
    assert boxes["load_share"][0] == pytest.approx(KG * STANDARD_GRAVITY / boxes["strength_n"][0], rel=0.01)
    assert boxes["peak_share"].tolist() == pytest.approx((boxes["max_top_force_n"] / boxes["strength_n"]).tolist())
    none = dict.fromkeys(("interlocked_loss", "overhang_loss", "gap_loss"), 0.0)
    assert loads_of(plan, "epal-1", **none).boxes["strength_n"].tolist() == [1000, 1000]
    soft = loads_of(plan, "euro-pallet", **none, soft_deck_loss=0.25).boxes["strength_n"]
    assert soft.tolist() == [750, 1000]


def test_nobody_loses_more_than_the_sources_say() -> None:
    """Interlocking reduces the strength by at most a half. The loss grows gradually with the offset of the upper box,
    and rotating this box does not increase it."""
    shares = [loads_of(stacked((0, 0, 0), (offset, 0, 200))).boxes["wall_factor"][0] for offset in (0, 20, 100, 180)]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] == 1.0
    assert loads_of(stacked((0, 0, 0), (50, -50, 200, TURNED))).boxes["wall_factor"][0] == 0.5


@pytest.fixture
def cases(repository: Path) -> Path:
    folder = repository.parent / "shared" / "cases"
    if not folder.is_dir():
        pytest.skip("the cases do not lie beside this checkout")
    return folder


def test_the_patterns_of_a_pallet(cases: Path) -> None:
    """A column keeps its strength, also with tie sheets between the boxes. An interlocked stack is overloaded."""
    plans = petmjx.load_plans(cases / "strength_patterns.csv")
    loads = petmjx.loads(petmjx.score(plans, engine="mujoco", threads=2), cases / "strength_articles.csv")
    assert loads.notes == ()
    worlds = loads.plans.set_index("plan_id")
    assert worlds["n_unknown"].tolist() == [0, 0, 0]
    assert worlds["n_boxes"].to_dict() == {"column": 40, "interlocked": 38, "column-tie-sheets": 40}
    assert worlds["overloaded"].to_dict() == {"column": False, "interlocked": True, "column-tie-sheets": False}
    factors = loads.boxes.groupby("plan_id")["wall_factor"].min()
    assert factors[["column", "column-tie-sheets"]].tolist() == [1.0, 1.0]
    assert 0.5 <= factors["interlocked"] < 0.7
    assert "tie" not in set(loads.boxes["article"])
    column = worlds.loc["column", "max_load_share"]
    assert worlds.loc["column-tie-sheets", "max_load_share"] == pytest.approx(column, rel=0.3)


def test_a_sheet_is_no_box_of_unknown_strength() -> None:
    loads = loads_of(stacked((0, 0, 0), (0, 0, 200, (400.0, 300.0, 2.0)), (0, 0, 202)))
    assert loads.boxes["box"].tolist() == [0, 2]
    (world,) = loads.plans.to_dict("records")
    assert (world["n_boxes"], world["n_unknown"], world["overloaded"]) == (2, 0, False)
    assert loads.notes == ()


def test_forces_of_a_drive_are_set_against_strength(tmp_path: Path) -> None:
    """A box on two boxes is accelerated. The rear box then carries more, by m · a · (half of the upper box's height) /
    (distance of the two boxes)."""
    half = (200.0, 300.0, 200.0)
    plan = stacked((0, 0, 0, half), (200, 0, 0, half), (0, 0, 200))
    sweep = tmp_path / "sweep.toml"
    sweep.write_text('[axes]\nprofile = "eumos-40509"\nlevel = [0.4]\ndirection = ["+x"]\n', encoding="utf-8")
    results = petmjx.sweep(sweep, [plan], engine="mujoco", threads=1, carrier="euro-pallet")
    boxes = petmjx.loads(results).boxes
    weight_n = KG * STANDARD_GRAVITY
    behind = int(boxes["max_top_force_n"][:2].argmax())
    assert boxes["rest_top_force_n"][behind] == pytest.approx(weight_n / 2, rel=0.05)
    peak_n = float(boxes["max_top_force_n"][behind])
    assert peak_n == pytest.approx(weight_n * (0.5 + 0.4 * 100 / 200), rel=0.1)
    # a strength between the force at rest and the peak is enough at rest, but not at the peak
    strength_n = 0.6 * weight_n / float(boxes["wall_factor"][behind])
    table = tmp_path / "articles.toml"
    table.write_text(f"[articles.carton]\nstrength_n = {strength_n}\n", encoding="utf-8")
    loads = petmjx.loads(results, table)
    (world,) = loads.plans.to_dict("records")
    assert (world["overloaded"], world["overloaded_at_peak"], world["n_overloaded_at_peak"]) == (False, True, 1)
    assert (world["peak_box"], world["peak_article"]) == (behind, "carton")
    assert world["max_peak_share"] == pytest.approx(peak_n / (0.6 * weight_n), rel=1e-5)


def test_what_film_does_to_forces_at_rest_is_said(tmp_path: Path) -> None:
    """A note states that film changes forces at rest, if the run has film and the pallet was shaken. The command prints
    this note."""
    sweep, out = tmp_path / "sweep.toml", tmp_path / "run"
    sweep.write_text('[axes]\nprofile = "eumos-40509"\nlevel = [0.2]\ndirection = ["+x"]\nwrap_turns = [0, 2]\n')
    results = petmjx.sweep(sweep, [stacked((0, 0, 0))], engine="mujoco", threads=1, carrier="euro-pallet", out=out)
    notes = [note for note in petmjx.loads(results).notes if "film" in note]
    assert notes == [
        "film presses the boxes together, so after the pallet is shaken, forces at rest also depend on friction "
        "between the layers"
    ]
    bare = petmjx.score([stacked((0, 0, 0))], engine="mujoco", threads=1, wrap={"turns": 2})
    assert not [note for note in petmjx.loads(bare).notes if "film" in note]


def test_boxes_without_strength_and_article() -> None:
    plan = Plan.from_boxes(
        "p", size_mm=[SIZE] * 2, corner_mm=[[0, 0, 0], [0, 0, 200]], mass_kg=[5, 5], strength_n=[900, np.nan]
    )
    assert loads_of(plan).notes == ("1 box without article has no strength",)


def test_options_of_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    petmjx.save_plans(stacked((0, 0, 0), (50, -50, 200, TURNED)), tmp_path / "plans.json")
    petmjx.score(tmp_path / "plans.json", engine="mujoco", threads=1, out=tmp_path / "run")
    shares = []
    for loss in ("0.5", "0.25", "0"):
        assert run("loads", tmp_path / "run", "--interlocked-loss", loss, "--overhang-loss", "0", "--json") == 0
        (world,) = json.loads(capsys.readouterr().out)["plans"]
        shares.append(world["max_load_share"])
    assert shares == pytest.approx([shares[2] / 0.5, shares[2] / 0.75, shares[2]])
    assert run("loads", tmp_path / "run", "--gap-loss", "2") == 2
    assert "--gap-loss must be from 0 to 1, got 2" in only_line(capsys.readouterr().err)
    with pytest.raises(petmjx.InputError, match="interlock_loss: unknown field; did you mean interlocked_loss"):
        petmjx.loads(tmp_path / "run", stacking={"interlock_loss": 0.1})
    assert petmjx.loads(tmp_path / "run", stacking=Stacking(gap_loss=0.1)).stacking.gap_loss == 0.1


def test_moisture_and_time_take_what_their_tables_say() -> None:
    """The losses are those in the tables of the sources. Between the rows of a table, losses are interpolated linearly:
    over humidity, or over the logarithm of time, which begins at one minute."""
    losses = [Stacking(humidity_percent=percent).humidity_loss for percent in (0, 50, 65, 80, 100)]
    assert losses == pytest.approx([0, 0, 0.15, 0.32, 0.85])
    losses = [Stacking(storage_days=days).time_loss for days in (0, 10, np.sqrt(300), 180)]
    assert losses == pytest.approx([0, 0.37, 0.385, 0.50])
    plan = stacked((0, 0, 0), (0, 0, 200))
    dry, moist = loads_of(plan).boxes, loads_of(plan, humidity_percent=80, storage_days=30).boxes
    assert moist["strength_n"].tolist() == pytest.approx((0.68 * dry["strength_n"]).tolist())
    assert moist["load_share"][0] == pytest.approx(dry["load_share"][0] / (0.68 * 0.6), rel=1e-6)
    assert moist["peak_share"][0] == pytest.approx(dry["peak_share"][0] / 0.68, rel=1e-6)


def test_boxes_are_crushed_surely_possibly_or_not() -> None:
    """The lower box carries a box that lies across it. So the strength of the lower box is reduced by a half, with an
    uncertainty of a fifth: it is 0.4 to 0.6 of the strength in a press."""
    weight_n = KG * STANDARD_GRAVITY
    crushed = []
    for strength_n in (1.5 * weight_n, 1.8 * weight_n, 3.0 * weight_n, np.nan):
        plan = stacked((0, 0, 0), (50, -50, 200, TURNED))
        plan = replace(plan, strength_n=np.array([strength_n, 1000.0]))
        boxes = loads_of(plan).boxes
        assert boxes["strength_low_n"][0] == pytest.approx(0.4 * strength_n, nan_ok=True)
        assert boxes["strength_high_n"][0] == pytest.approx(0.6 * strength_n, nan_ok=True)
        (world,) = loads_of(plan).plans.to_dict("records")
        crushed.append((world["crushed"], world["crush_box"]))
    assert [answer for answer, _ in crushed[:3]] == ["surely", "possibly", "not"]
    assert crushed[3][0] is None
    assert [box for _, box in crushed] == [0, 0, 0, 1]
    exact = loads_of(replace(plan, strength_n=np.array([1.8 * weight_n, 1000.0])), loss_spread=0.0)
    assert exact.plans["crushed"].tolist() == ["surely"]


def test_pallets_of_a_chain_arrive_whole_or_not(tmp_path: Path) -> None:
    chain = tmp_path / "chain.toml"
    chain.write_text(
        "replicates = 2\n[axes]\nfriction_tolerance_rel = 0.01\n[[legs]]\nname = 'belt'\n"
        "events = [{ profile = 'eumos-40509', level = 0.1 }]\n"
        "[[remedies]]\nname = 'slower'\nleg = 'belt'\nfactor = 0.5\n"
    )
    weight_n = KG * STANDARD_GRAVITY
    plan = replace(stacked((0, 0, 0), (0, 0, 200)), strength_n=np.array([1.02 * weight_n, 1000.0]))
    run = petmjx.score([plan], chain=chain, engine="mujoco", threads=1)
    loads = petmjx.loads(run)
    assert loads.ways is not None
    ways = loads.ways.set_index("remedy")
    assert ways["n_worlds"].to_dict() == {"": 2, "slower": 2}
    peaks = run.boxes.query("box == 0 and variant > 0")["max_top_force_n"]
    # in a column, the strength is not reduced
    over = peaks.gt(1.02 * weight_n).groupby(run.boxes["variant"].sub(1).mod(2)).sum()
    assert ways["n_whole"].tolist() == [2 - over[0], 2 - over[1]]
    assert ways["n_possibly_whole"].tolist() == ways["n_whole"].tolist()
    loads.write(tmp_path / "loads")
    assert (tmp_path / "loads" / "way_loads.parquet").is_file()
