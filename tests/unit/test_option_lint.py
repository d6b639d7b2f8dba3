"""One line names each option and each table that has no effect. Numbers that are given as text are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support.plans import make_plan

import petmjx
from petmjx.options.simulation import Simulation
from petmjx.world.option_lint import notes_about

ONE = make_plan(boxes=[((400.0, 300.0, 200.0), (0.0, 0.0, 0.0), 5.0)])


@pytest.mark.parametrize(
    ("options", "about", "lines"),
    [
        (
            {"placing": {"name": "exact", "force_n": 50}},
            {},
            ["placing.force_n has no effect: boxes are placed by exact"],
        ),
        (
            {"placing": {"name": "auto", "force_n": 50}},
            {},
            ["placing.force_n has no effect: boxes are placed by exact"],
        ),
        ({"placing": {"name": "auto", "force_n": 50}}, {"errors": True}, []),
        (
            {"placing": {"name": "drop", "side_mm": 9, "tines_mm": 3, "height_mm": 9}},
            {"axes": ("placing_force_n",)},
            ["placing.side_mm and placing.tines_mm and placing_force_n have no effect: boxes are placed by drop"],
        ),
        (
            {"placing": "hand"},
            {"axes": ("tines_height_mm",)},
            ["tines_height_mm has no effect: boxes are placed by hand"],
        ),
        ({"placing": {"name": "tines", "tines_mm": 3}}, {}, []),
        (
            {"wrap": {"turns": 2}},
            {},
            ["wrap has no effect: there is no profile, and film acts only while a pallet is shaken"],
        ),
        ({"wrap": {"turns": 2}}, {"driven": True}, []),
        ({"wrap": {"hat_n": 20}}, {"driven": True}, ["wrap.hat_n has no effect: there are no turns of film"]),
        ({}, {}, []),
    ],
)
def test_options_that_cannot_count_are_told(options: dict[str, Any], about: dict[str, Any], lines: list[str]) -> None:
    assert notes_about(Simulation(**options), [ONE], **about) == lines


def test_a_box_over_a_gap_of_the_carrier_is_told() -> None:
    """A deck board of epal-1 ends at y = 145 mm, and the next one begins at 185.5 mm."""
    over, inside = (((400.0, 60.0, 200.0), (0.0, y, 0.0), 5.0) for y in (120.0, 90.0))
    (line,) = notes_about(Simulation(carrier="epal-1"), [make_plan("a", boxes=[inside]), make_plan("b", boxes=[over])])
    assert line == "1 box on the carrier stands with the middle over a gap between boards (box 0 of b)"
    assert not notes_about(Simulation(carrier="euro-pallet"), [make_plan(boxes=[over])])


def test_articles_that_match_no_box_are_told(tmp_path: Path) -> None:
    table = tmp_path / "articles.csv"
    table.write_text(
        "article,product_group,material,strength_n\nmilk,,film,\njam,,film,\n,dairy,film,\n,,film,9\n,,steel,9\n"
    )
    plan = petmjx.Plan.from_boxes("a", size_mm=[[400, 300, 200]], corner_mm=[[0, 0, 0]], mass_kg=[5], article=["milk"])
    results = petmjx.score([plan], articles=table, engine="mujoco", threads=1)
    warning = next(line for line in results.info["warnings"] if "match" in line)
    assert warning.endswith("articles.csv: 3 of 5 rows match no box: article jam, product group dairy, material steel")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"interval_s": "2"}, "interval_s must be a finite number, got '2'"),
        ({"interval_s": True}, "interval_s must be a finite number, got True"),
        ({"early_stop": "yes"}, "early_stop must be true or false, got 'yes'"),
        ({"early_stop": 1}, "early_stop must be true or false, got 1"),
        ({"solver_iterations": "7"}, "solver_iterations must be a whole number, got '7'"),
        ({"physics": {"solref": ["0.02", 1.0]}}, "physics.solref must be a list of numbers, got ['0.02', 1.0]"),
        ({"carrier": "epal1"}, "did you mean epal-1?"),
    ],
)
def test_values_that_are_nearly_right_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(petmjx.InputError) as raised:
        Simulation(**options)
    assert message in str(raised.value)
