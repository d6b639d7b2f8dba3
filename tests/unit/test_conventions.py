"""Tests of plans that follow other conventions than petmjx's (such as centres instead of corners). A message names the
mistake, for every form of input."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest
from support.fake_engine import LargestFirst
from support.plans import make_plan

import petmjx
from petmjx.cli import main
from petmjx.common.errors import InputError, PlanWarning
from petmjx.common.units import FloatArray
from petmjx.options.carriers import Carrier
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.packers.sample_plans import generate
from petmjx.plans.bundled import bundled_path
from petmjx.plans.input_conventions import ANCHORS
from petmjx.plans.plan import Plan
from petmjx.plans.plan_sources import gather_plans

pytestmark = pytest.mark.usefixtures("in_tmp_path")

SOUND = next(plan for plan in petmjx.load_plans(bundled_path()) if plan.plan_id == "s0-000003")

SIZES, CORNERS, MASS = ["length_mm", "width_mm", "height_mm"], ["x_mm", "y_mm", "z_mm"], "weight_kg"


class Boxes(NamedTuple):
    """The numbers of a plan, as a user gives them, in packing order."""

    size: FloatArray
    corner: FloatArray
    mass: FloatArray


class Mistake(NamedTuple):
    """A mistake of convention.

    Attributes:
        made: function that makes the mistake in a right plan.
        named: words in petmjx's message.
        options: options with which petmjx reads the plan rightly; None if there are none.
    """

    made: Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]]
    named: str
    options: dict[str, str] | None = None


MISTAKES = {
    "centres": Mistake(lambda s, c, m: (s, c + s / 2, m), "of centres, not of corners", {"anchor": "centre"}),
    "centres of bases": Mistake(
        lambda s, c, m: (s, c + s * [0.5, 0.5, 0], m), "x and y look like those of centres", {"anchor": "base-centre"}
    ),
    "far corners": Mistake(lambda s, c, m: (s, c + s, m), "the corners with the largest x", {"anchor": "far-corner"}),
    "metres": Mistake(lambda s, c, m: (s / 1000, c / 1000, m), "in metres", {"units": "m"}),
    "centimetres": Mistake(
        lambda s, c, m: (s / 10, c / 10, m), "lengths look as if they were in cent", {"units": "cm"}
    ),
    "inches": Mistake(lambda s, c, m: (s / 25.4, c / 25.4, m), "as if they were in inches", {"units": "in"}),
    "coordinates in centimetres": Mistake(lambda s, c, m: (s, c / 10, m), "coordinates look as if they were in cent"),
    "sizes in centimetres": Mistake(lambda s, c, m: (s / 10, c, m), "sizes look as if they were in cent"),
    "y upwards": Mistake(lambda s, c, m: (s[:, [0, 2, 1]], c[:, [0, 2, 1]], m), "y and z look swapped"),
    "y and z of coordinates": Mistake(lambda s, c, m: (s, c[:, [0, 2, 1]], m), "y and z look swapped"),
    "last box first": Mistake(lambda s, c, m: (s[::-1], c[::-1], m[::-1]), "packing order looks reversed"),
    "z from the floor": Mistake(lambda s, c, m: (s, c + np.array([0, 0, 144]), m), "z looks counted from the floor"),
    "middle of the pallet": Mistake(lambda s, c, m: (s, c - [600, 400, 0], m), "the middle of the carrier"),
    "width first": Mistake(lambda s, c, m: (s[:, [1, 0, 2]], c, m), "length and width look swapped"),
    "grams": Mistake(lambda s, c, m: (s, c, m * 1000), "grams", {"units": "g"}),
    "tonnes": Mistake(lambda s, c, m: (s, c, m / 1000), "tonnes", {"units": "t"}),
}


def boxes(mistake: Mistake) -> Boxes:
    return Boxes(*mistake.made(SOUND.size_mm, SOUND.corner_mm, SOUND.mass_kg))


def frame(given: Boxes) -> pd.DataFrame:
    n = len(given.mass)
    columns = {"plan_id": ["A"] * n, "sequence": range(n), "article": SOUND.articles}
    sizes, corners = pd.DataFrame(given.size, columns=SIZES), pd.DataFrame(given.corner, columns=CORNERS)
    return pd.concat([pd.DataFrame(columns), sizes, corners, pd.Series(given.mass, name=MASS)], axis=1)


def as_json(given: Boxes) -> str:
    placements = [
        {
            "item": {
                "article": article,
                "id": "1",
                **dict(zip(("length/mm", "width/mm", "height/mm"), size, strict=True)),
                "weight/kg": mass,
                "sequence": number,
            },
            "orientation": 0,
            "flb_coordinates": corner,
        }
        for number, (article, size, corner, mass) in enumerate(
            zip(SOUND.articles, given.size.tolist(), given.corner.tolist(), given.mass.tolist(), strict=True)
        )
    ]
    Path("a.json").write_text(json.dumps({"A": placements}), encoding="utf-8")
    return "a.json"


def as_table(given: Boxes) -> str:
    frame(given).to_csv("a.csv", index=False)
    return "a.csv"


def as_plan(given: Boxes, **options: Any) -> Plan:
    return Plan.from_boxes(
        "A", size_mm=given.size, corner_mm=given.corner, mass_kg=given.mass, article=SOUND.articles, **options
    )


FORMS: dict[str, Callable[[Boxes], Any]] = {"json": as_json, "csv": as_table, "frame": frame, "plan": as_plan}


def gathered(plans: Any, **options: Any) -> list[str]:
    """The messages of a run about these plans: lines about conventions, or the reasons why plans are skipped."""
    plan_set = gather_plans(plans, Simulation(carrier=Carrier.EURO_PALLET), RunOptions(**options))
    return [*plan_set.conventions, *(skipped.message for skipped in plan_set.skipped)]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("mistake", MISTAKES.values(), ids=MISTAKES)
def test_each_mistake_is_named_in_each_form(mistake: Mistake, form: str) -> None:
    try:
        (line,) = gathered(FORMS[form](boxes(mistake)))
    except InputError as error:  # a value that no box can have
        line = str(error)
    assert mistake.named in line
    assert "plan A" in line
    assert "box" in line or "row" in line or "placement" in line


@pytest.mark.parametrize("name", [name for name, mistake in MISTAKES.items() if mistake.options is not None])
def test_the_option_that_is_named_reads_the_plan_rightly(name: str) -> None:
    options: Any = MISTAKES[name].options
    given = boxes(MISTAKES[name])
    read = [*(petmjx.load_plans(FORMS[form](given), **options).plans[0] for form in ("json", "csv", "frame"))]
    for plan in (*read, as_plan(given, **options)):
        np.testing.assert_allclose(plan.size_mm, SOUND.size_mm, atol=1e-9)
        np.testing.assert_allclose(plan.corner_mm, SOUND.corner_mm, atol=1e-9)
        np.testing.assert_allclose(plan.mass_kg, SOUND.mass_kg, atol=1e-12)


def test_sound_plans_are_not_suspected(real_data: Path) -> None:
    files = [bundled_path(), *sorted(real_data.glob("*plan*.json")), *sorted(real_data.glob("third_party*.json.gz"))]
    read = petmjx.load_plans(files)
    generated = [Plan.from_boxes(plan_id, _columns(boxes)) for plan_id, boxes in generate(60, 7, loose_share=0.8)]
    for carrier in Carrier:
        sim = Simulation(carrier=carrier)
        assert gather_plans(read, sim, RunOptions()).conventions == []
        assert gather_plans(generated, sim, RunOptions()).conventions == []


def _columns(placements: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [
        {
            **{
                name.replace("/", "_"): box["item"][name]
                for name in ("length/mm", "width/mm", "height/mm", "weight/kg")
            },
            **dict(zip(CORNERS, box["flb_coordinates"], strict=True)),
            "orientation": box["orientation"],
        }
        for box in placements
    ]


def test_plans_are_counted_and_told_once() -> None:
    """There is one message for all plans with the same mistake, with their number. The message counts all plans with
    the mistake even if so many other odd plans come first that not all plans are checked for all conventions."""
    centres = boxes(MISTAKES["centres"])
    plans = [replace(as_plan(centres), plan_id=f"p{k}") for k in range(300)]
    floating = [((100.0, 100.0, 100.0), (300.0 * k, 0.0, 40.0 * k), 1.0) for k in range(3)]
    odd = [make_plan(f"q{k}", floating) for k in range(140)]
    plan_set = gather_plans([*odd, SOUND, *plans], Simulation(), RunOptions())
    (line,) = plan_set.conventions
    assert "(290 of 441 plans)" in line  # ten plans are not counted: they were not checked for all conventions
    lowest = int(SOUND.corner_mm[:, 2].argmin())
    assert f"box {lowest} ({SOUND.articles[lowest]}), floats by half its height" in line
    assert len(plan_set.warnings) == 440


def test_odd_plans_of_no_convention_are_not_explained() -> None:
    """Plans in which some boxes float, as in plans of real packers, are not taken for mistakes of convention."""
    rng = np.random.default_rng(0)
    odd = []
    for k, (_, placed) in enumerate(40 * list(generate(5, 3))):
        plan = Plan.from_boxes(f"p{k}", _columns(placed))
        plan.corner_mm[rng.integers(0, plan.n_boxes, 4), 2] += rng.uniform(5, 80, 4)
        odd.append(plan)
    plan_set = gather_plans(odd, Simulation(), RunOptions())
    assert len(plan_set.warnings) > 180
    assert plan_set.conventions == []


def test_python_warns_where_it_was_called_and_once_of_a_set() -> None:
    file = as_json(boxes(MISTAKES["centres"]))
    with pytest.warns(PlanWarning, match="anchor centre") as caught:
        plan_set = petmjx.load_plans(file)
    assert [warning.filename for warning in caught] == [__file__]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        results = petmjx.score(plan_set, engine=LargestFirst())  # the message was issued when the plans were read
    assert results.info["warnings"][0] == plan_set.conventions[0] == str(caught[0].message)
    with pytest.warns(PlanWarning, match="anchor centre"):
        petmjx.score(plan_set.plans, engine=LargestFirst())


def test_a_run_remembers_how_its_plans_were_read() -> None:
    file = as_json(boxes(MISTAKES["centres"]))
    run = petmjx.score(file, anchor="centre", out="run", engine="mujoco", check="static", duration_s=0.01)
    assert run.info["config"]["anchor"] == "centre"
    np.testing.assert_allclose(petmjx.tell("A", "run").plan.corner_mm, SOUND.corner_mm)


def test_units_and_anchor_are_refused_where_they_say_nothing() -> None:
    with pytest.raises(InputError, match=r"^units and anchor apply only to files and data frames"):
        petmjx.score((plan for plan in [SOUND]), units="cm")
    with pytest.raises(InputError, match=r"^units must be one of mm, .* got 'cm,m'$"):
        petmjx.load_plans(bundled_path(), units="cm,m")
    with pytest.raises(InputError, match=r"^anchor must be one of corner, .* got 'middle'$"):
        as_plan(boxes(MISTAKES["centres"]), anchor="middle")


def test_sizes_and_coordinates_may_have_units_of_their_own(tmp_path: Path) -> None:
    box = {"length_mm": 40, "width_mm": 30, "height_mm": 20, "weight_kg": 6000, "x_mm": 100, "y_mm": 0, "z_mm": 0}
    plan = petmjx.Plan.from_boxes("a", [box], units="cm/mm,g")
    assert plan.size_mm[0].tolist() == [400, 300, 200]
    assert plan.corner_mm[0].tolist() == [100, 0, 0]
    assert plan.mass_kg[0] == 6
    assert Plan.from_boxes("a", [box], units="dm/mm,g").size_mm[0].tolist() == [4000, 3000, 2000]
    row = {"plan_id": "a", "sequence": 1, "article": "b", **box}
    file = tmp_path / "plans.csv"
    file.write_text("\n".join([",".join(row), ",".join(map(str, row.values()))]))
    (same,) = petmjx.load_plans(file, units="cm/mm,g").plans
    assert same.size_mm.tolist() == plan.size_mm.tolist()
    assert same.corner_mm.tolist() == plan.corner_mm.tolist()
    file = tmp_path / "plans.json"
    petmjx.save_plans(Plan.from_boxes("a", [{**box, "weight_kg": 6}]), file)
    (same,) = petmjx.load_plans(file, units="cm/mm").plans
    assert same.size_mm.tolist() == plan.size_mm.tolist()
    assert same.corner_mm.tolist() == plan.corner_mm.tolist()
    for units in ("cm/", "cm/mm/m", "kg/g"):
        with pytest.raises(InputError, match=r"^units must be one of mm, .* got"):
            petmjx.load_plans(file, units=units)


def test_the_command_line_tells_and_takes_the_option(capsys: pytest.CaptureFixture[str]) -> None:
    file = as_table(boxes(MISTAKES["centimetres"]))
    assert main(["convert", file, "-o", "b.json"]) == 0
    assert "note: lengths look as if they were in centimetres: in plan A box" in capsys.readouterr().err
    assert main(["convert", file, "-o", "c.json", "--units", "cm"]) == 0
    assert capsys.readouterr().err == ""
    np.testing.assert_allclose(petmjx.load_plans("c.json").plans[0].size_mm, SOUND.size_mm)


@pytest.mark.parametrize("anchor", ["centre", "far-corner", "top-centre", "corner-z", "corner-xz", "corner-yz"])
def test_the_anchor_is_named_with_which_the_load_begins_at_the_corner(
    anchor: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """In a block of equal boxes, no box floats or overlaps with any anchor that moves all boxes down to the deck."""
    size = np.tile([400.0, 300.0, 200.0], (12, 1))
    places = np.array(list(np.ndindex(3, 2, 2)))[:, ::-1] * size
    rows = {"plan_id": "A", "sequence": range(12), "article": "box", MASS: 5.0}
    table = pd.DataFrame(rows).assign(**dict(zip(SIZES, size.T, strict=True)))
    for point, is_named in (("corner", False), (anchor, True)):
        given = places + np.array(ANCHORS[point]) * size
        table.assign(**dict(zip(CORNERS, given.T, strict=True))).to_csv("a.csv", index=False)
        lines = gathered("a.csv")
        assert [line.partition("give ")[2] for line in lines] == [f"anchor {anchor}"] * is_named
    assert main(["info", "a.csv"]) == 0
    assert f"give anchor {anchor}\n" in capsys.readouterr().out


def brickwork(rng: np.random.Generator, layers: int) -> list[dict[str, Any]]:
    """The boxes of a pallet that stands: one article, in rows of boxes along x and rows along y. Sizes are those of the
    article, and each box has an orientation."""
    long, wide, high = (float(rng.choice(sides)) for sides in ((400, 450, 600), (200, 300), (150, 220)))
    count = int(rng.integers(2, 4))
    boxes = []
    for layer in range(layers):
        for k in range(count):
            boxes.append(((k * long, 0.0, layer * high), 0))
        for k in range(int(count * long // wide)):
            boxes.append(((k * wide, wide, layer * high), 1))
    item = {"length_mm": long, "width_mm": wide, "height_mm": high, "weight_kg": 6.0}
    return [{**item, **dict(zip(CORNERS, corner, strict=True)), "orientation": turned} for corner, turned in boxes]


def as_they_stand(boxes: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The given boxes, but with length and width swapped if the box is rotated, so that sizes are those
    along x and y."""
    sides = ("length_mm", "width_mm")
    return [{**box, sides[0]: box[sides[1]], sides[1]: box[sides[0]]} if box["orientation"] else box for box in boxes]


@pytest.mark.parametrize("seed", range(6))
def test_sizes_as_boxes_stand_beside_an_orientation_are_named(seed: int) -> None:
    """Sizes along x and y in spite of orientations are named in a plan, even if many other plans are right."""
    right = brickwork(np.random.default_rng(seed), 1 + seed % 3)
    sound = Plan.from_boxes("right", right)
    mistaken = Plan.from_boxes("A", as_they_stand(right))
    (line,) = gathered([SOUND, sound, mistaken])
    assert "that are turned by their orientation look swapped: in plan A " in line
    table = pd.DataFrame(as_they_stand(right)).assign(plan_id="A", article="d", sequence=range(len(right)))
    (line,) = gathered(table)
    assert "that are turned by their orientation look swapped" in line
    assert gathered(sound) == []
    assert gathered(pd.DataFrame(right).assign(plan_id="A", article="d", sequence=range(len(right)))) == []


@pytest.mark.parametrize("seed", range(4))
def test_sizes_as_boxes_stand_in_some_of_the_turned_boxes_are_named(seed: int) -> None:
    """Sizes along x and y are named if only some of the rotated boxes have them: those of the upper layers, or every
    second box."""
    rng = np.random.default_rng(seed)
    right = brickwork(rng, 3)
    height = right[0]["height_mm"]
    mistaken = [
        wrong if (box["z_mm"] >= height if seed % 2 else k % 2) else box
        for k, (box, wrong) in enumerate(zip(right, as_they_stand(right), strict=True))
    ]
    (line,) = gathered(Plan.from_boxes("A", mistaken))
    assert "that are turned by their orientation look swapped: in plan A " in line


@pytest.mark.parametrize("seed", range(8))
def test_right_plans_whose_rows_are_flush_in_y_are_not_suspected(seed: int) -> None:
    """Right plans in which boxes form rows along y without gaps, beginning at the edge. Upper layers have gaps for
    sheets, or a few boxes float or overlap others."""
    rng = np.random.default_rng(seed)
    size = np.array([float(rng.choice([200, 300, 400])), float(rng.choice([200, 300])), 150.0])
    places = np.array([(x, y, z) for z in range(3) for y in range(3) for x in range(3)], float)
    corner = places * size
    if seed % 2:
        corner[:, 2] += places[:, 2] * rng.integers(1, 6)  # space for a sheet under each upper layer
    else:
        upper = rng.choice(np.arange(18, 27), 3, replace=False)
        corner[upper, 2] += rng.choice([-12.0, 8.0, 60.0], 3)
    plan = Plan.from_boxes("A", size_mm=np.tile(size, (27, 1)), corner_mm=corner, mass_kg=np.full(27, 5.0))
    plan_set = gather_plans([plan], Simulation(carrier=Carrier.EURO_PALLET), RunOptions())
    assert plan_set.warnings
    assert plan_set.conventions == []


def _columns_of(size: tuple[float, float, float], step: tuple[float, float, float], numbers: tuple[int, int]) -> Plan:
    """A plan with boxes of one size in a grid. ``numbers`` has the numbers of boxes along x and in the direction of
    ``step``."""
    corner = np.array([(x * size[0], 0, 0) + k * np.array(step) for k in range(numbers[1]) for x in range(numbers[0])])
    return Plan.from_boxes("A", size_mm=np.tile(size, (len(corner), 1)), corner_mm=corner, mass_kg=[8.0] * len(corner))


def test_heights_in_y_are_named_if_all_boxes_stand_on_the_carrier() -> None:
    """Swapped y and z are named for columns, which become boxes that overlap, and for a wall, which becomes a row of
    boxes that is longer than the carrier."""
    sim = Simulation(carrier=Carrier.EURO_PALLET)
    for plan in (_columns_of((400, 300, 200), (0, 200, 0), (2, 5)), _columns_of((400, 200, 300), (0, 200, 0), (3, 7))):
        (line,) = gather_plans([plan], sim, RunOptions()).conventions
        assert line.startswith("y and z look swapped: in plan A ")
    right = (
        _columns_of((400, 200, 300), (0, 200, 0), (3, 4)),  # fits on the carrier
        _columns_of((400, 200, 300), (0, 200, 0), (2, 6)),  # fits on a carrier with swapped length and width
        _columns_of((300, 270, 200), (0, 270, 0), (4, 3)),  # hangs over by 10 mm
        _columns_of((400, 300, 200), (0, 290, 0), (2, 2)),  # has small overlaps
    )
    for plan in right:
        assert gather_plans([plan], sim, RunOptions()).conventions == []
