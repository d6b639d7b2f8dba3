"""Tests of loads: the table of articles, McKee's formula, and the loads of a run's boxes as shares of their
strength."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.parquet as pq
import pytest
from support.command_line import only_line, run, write
from support.plan_files import placement, tower
from support.runs import keep_nothing, leave_unfinished

import petmjx
from petmjx.common.units import STANDARD_GRAVITY
from petmjx.plans.articles import Article, CartonStrength, read_articles
from petmjx.show.load_tables import load_tables

pytestmark = pytest.mark.usefixtures("in_tmp_path")

HEADER = "article,product_group,strength_n,ect_kn_m,thickness_mm,safety_factor"


def table(*rows: str, header: str = HEADER, name: str = "articles.csv") -> Path:
    return write(Path(name), "\n".join([header, *rows]) + "\n")


# the table of articles


def test_mckee_by_hand() -> None:
    """McKee's formula, computed by hand. A box of 400 × 300 mm, made of board with 5 kN/m and 4 mm, has a strength of
    5.87 · 5 · √(4 · 1400) N. The formula holds in imperial units as well."""
    strength = CartonStrength(ect_kn_m=5.0, thickness_mm=4.0, safety_factor=4.0).of_box(400, 300)
    assert strength == pytest.approx(5.87 * 5 * math.sqrt(5600) / 4)
    inch_mm, pound_n = 25.4, 4.4482216
    pounds = 5.87 * (5 * inch_mm / pound_n) * math.sqrt(4 / inch_mm * 1400 / inch_mm)
    assert strength == pytest.approx(pounds * pound_n / 4)


def test_all_forms_say_the_same() -> None:
    rows = ("milk,,900,,,", ",dairy products,,5,4,3", "jam,,1200,,,2")
    expected = read_articles(table(*rows))
    assert expected.by_article == {
        "milk": Article(CartonStrength(900)),
        "jam": Article(CartonStrength(1200, safety_factor=2)),
    }
    assert expected.by_group == {"dairy products": Article(CartonStrength(None, 5, 4, 3))}
    write(
        Path("articles.toml"),
        "[articles.milk]\nstrength_n = 900\n[articles.jam]\nstrength_n = 1200\nsafety_factor = 2\n"
        '[product_groups."dairy products"]\nect_kn_m = 5\nthickness_mm = 4.0\nsafety_factor = 3\n',
    )
    pd.read_csv("articles.csv").to_parquet("articles.parquet")
    semicolons = tuple(row.replace(",", ";").replace("900", "900,0") for row in rows)
    table(*semicolons, header="\ufeff" + HEADER.replace(",", ";"), name="german.csv")
    for name in ("articles.toml", "articles.parquet", "german.csv"):
        assert read_articles(name) == expected


def test_the_article_counts_before_its_group() -> None:
    articles = read_articles(table("milk,,900,,,", ",dairy,500,,,"))
    assert articles.find("milk", "dairy").strength == CartonStrength(900)
    assert articles.find("cheese", "dairy").strength == CartonStrength(500)
    assert articles.find("bread", "").strength is None


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("milk,,-1,,,", 'strength_n must be a number ≥ 0.01 and at most 1e+09, got "-1"'),
        ("milk,,nan,,,", 'strength_n must be a number ≥ 0.01 and at most 1e+09, got "nan"'),
        ("milk,,many,,,", 'strength_n must be a number ≥ 0.01 and at most 1e+09, got "many"'),
        ("milk,,1_0,,,", 'strength_n must be a number ≥ 0.01 and at most 1e+09, got "1_0"'),
        ('"milk,,5,,,\njam,,5,,,', "has an unclosed quotation mark"),
        ("milk,,900,,,0.5", 'safety_factor must be a number ≥ 1 and at most 1000, got "0.5"'),
        ("milk,dairy,900,,,", "must name an article or a product_group (not both), or only a material"),
        (",,900,,,", "must name an article or a product_group (not both), or only a material"),
        ("milk,,,5,,", "needs strength_n, or ect_kn_m, thickness_mm and safety_factor; of these thickness_mm and "),
        (
            "milk,,,,,",
            "needs strength_n, or ect_kn_m, thickness_mm and safety_factor; of these ect_kn_m, thickness_mm ",
        ),
        ("milk,,900,5,4,3", "give either strength_n, or ect_kn_m, thickness_mm and safety_factor"),
        ("milk,,900", "has 3 fields instead of 6"),
    ],
)
def test_rows_that_are_refused(row: str, message: str) -> None:
    with pytest.raises(petmjx.InputError) as raised:
        read_articles(table("jam,,5,,,", row))
    assert str(raised.value).startswith(f"articles.csv: row 3: {message}")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", HEADER, "holds no article"),
        ("a.csv", "", "holds no article"),
        (
            "a.csv",
            "article,strenght_n\nmilk,5\n",
            "row 2: unknown field strenght_n; there are article, product_group, ",
        ),
        ("a.csv", "article,strength_n\nmilk,5\nmilk,6\n", "row 3: article milk occurs twice"),
        (
            "a.toml",
            "[milk]\nstrength_n = 5\n",
            "must have the tables [articles.NAME], [product_groups.NAME] and [materials.NAME], got ",
        ),
        ("a.toml", "[articles]\nmilk = 5\n", "articles.milk must be a table with strength_n, or with ect_kn_m, "),
        (
            "a.toml",
            "[articles.milk]\nstrength_n = true\n",
            "articles.milk: strength_n must be a number ≥ 0.01 and at most",
        ),
        ("a.toml", "x = ", "not valid TOML"),
        ("a.json", "{}", "the name must end in one of .toml, .parquet, .csv, .csv.gz, .tsv, .tsv.gz"),
        ("a.parquet", "PAR1", "is not a whole Parquet file"),
        ("a.csv", b"article,strength_n\n\xff,5\n", "row 2 is not UTF-8 text"),
    ],
)
def test_tables_that_are_refused(name: str, content: str | bytes, message: str) -> None:
    Path(name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(petmjx.InputError) as raised:
        read_articles(name)
    assert str(raised.value).startswith(f"{name}: {message}")
    with pytest.raises(petmjx.InputError, match="nowhere"):
        read_articles(f"nowhere-{name}")


# loads of a run

KG = 6.296
WEIGHT_N = KG * STANDARD_GRAVITY


@pytest.fixture
def results() -> petmjx.RunResults:
    """A run with a tower of three boxes, a single box, and a plan in which a box falls."""
    falls = [
        placement((0, 0, 0), (300, 300, 200)),
        placement((290, 0, 200), (300, 300, 200), article="jam", product_group="jam"),
    ]
    plans = {"three": tower(3), "one": tower(1), "falls": falls}
    plans["three"][1]["item"] |= {"article": "milk", "product_group": "dairy"}
    write(Path("plans.json"), plans)
    return petmjx.score("plans.json", engine="mujoco", out="run")


def test_shares_of_a_tower(results: petmjx.RunResults) -> None:
    """In a tower, the lowest box carries the weight of two boxes, and the middle box that of one box. From these follow
    the loads as shares of the strength."""
    loads = petmjx.loads(results, table("donut-00101843,,200,,,", ",dairy,100,,,2"))
    boxes = loads.boxes[loads.boxes["plan_id"] == "three"].sort_values("box")
    assert boxes["strength_n"].tolist() == [200, 50, 200]
    assert boxes["load_share"].tolist() == pytest.approx([2 * WEIGHT_N / 200, WEIGHT_N / 50, 0], rel=0.01, abs=1e-6)
    plans = loads.plans.set_index("plan_id")
    assert plans["overloaded"].dropna().to_dict() == {"three": True, "one": False}
    assert plans.loc["three", ["n_overloaded", "n_unknown", "box", "article"]].tolist() == [1, 0, 1, "milk"]
    assert plans.loc["three", "max_load_share"] == pytest.approx(WEIGHT_N / 50, rel=0.01)
    assert plans["verdict"].to_dict() == {"three": "stable", "one": "stable", "falls": "unstable"}
    assert loads.notes == ("1 article of 1 box has no strength: jam",)
    assert repr(loads) == "Loads(3 worlds, 1 overloaded)"


def test_a_run_that_is_not_finished_is_told(results: petmjx.RunResults) -> None:
    leave_unfinished(results.path)
    loads = petmjx.loads(results.path, table("donut-00101843,,200,,,", "jam,,200,,,", "milk,,200,,,"))
    assert loads.notes == ("the run is not finished (interrupted)",)


def test_what_statics_leaves_open_is_overloaded_possibly(capsys: pytest.CaptureFixture[str]) -> None:
    """If statics leaves a force open, a box is possibly overloaded. A plank lies on three supports: the middle support
    carries between nothing and the whole plank."""
    pytest.importorskip("scipy")
    bridge = [placement((x, 0, 0), (100, 300, 200), article="post") for x in (0, 450, 900)]
    bridge.append(placement((0, 0, 200), (1000, 300, 100), article="plank"))
    write(Path("plans.json"), {"bridge": bridge, "tower": tower(3)})
    results = petmjx.score("plans.json", engine="mujoco", out="run", force_intervals=True)
    strength = f"{0.9 * WEIGHT_N}"
    articles = table(f"post,,{strength},,,", f"plank,,{strength},,,", f"donut-00101843,,{strength},,,")
    plans = petmjx.loads(results, articles).plans.set_index("plan_id")
    assert plans["surely_overloaded"].to_dict() == {"bridge": False, "tower": True}
    assert plans["possibly_overloaded"].to_dict() == {"bridge": True, "tower": True}
    assert plans.loc["bridge", ["n_surely_overloaded", "n_possibly_overloaded"]].tolist() == [0, 1]
    assert plans.loc["tower", ["n_surely_overloaded", "n_possibly_overloaded"]].tolist() == [2, 2]
    assert run("loads", "run", "--articles", str(articles)) == 0
    assert "1 surely overloaded (by the smallest force that statics allows), 2 possibly" in capsys.readouterr().out
    # if some articles have no strength, it is unknown whether boxes are possibly overloaded, but not whether surely
    plans = petmjx.loads(results, table(f"donut-00101843,,{strength},,,", "plank,,9,,,")).plans.set_index("plan_id")
    assert plans["possibly_overloaded"].isna().to_dict() == {"bridge": True, "tower": False}


def test_mckee_takes_the_sizes_of_the_plan(results: petmjx.RunResults) -> None:
    loads = petmjx.loads("run", table(",confectionery,,5,4,5"), plans="plans.json")
    boxes = loads.boxes.set_index(["plan_id", "box"])
    assert boxes.loc[("one", 0), "strength_n"] == pytest.approx(5.87 * 5 * math.sqrt(4 * 2000) / 5)
    assert boxes.loc[("falls", 0), "press_strength_n"] == pytest.approx(5.87 * 5 * math.sqrt(4 * 1200) / 5)
    assert boxes["strength_n"].isna().sum() == 2  # the articles milk and jam have no strength


def test_verdicts_stay(results: petmjx.RunResults) -> None:
    before = {path: path.read_bytes() for path in Path("run").rglob("*") if path.is_file()}
    petmjx.loads("run", table("milk,,1,,,")).write("loads")
    assert {path: path.read_bytes() for path in Path("run").rglob("*") if path.is_file()} == before


def test_files(results: petmjx.RunResults) -> None:
    loads = petmjx.loads("run", table("milk,,1,,,"))
    loads.write("loads")
    for name, frame in (("box_loads", loads.boxes), ("plan_loads", loads.plans)):
        read = pq.read_table(f"loads/{name}.parquet")
        assert read.column_names == list(frame.columns)
        assert all(b"unit" in field.metadata and field.metadata[b"description"] for field in read.schema)
        assert pd.read_csv(f"loads/{name}.csv")["plan_id"].tolist() == frame["plan_id"].tolist()
    assert pq.read_table("loads/box_loads.parquet").schema.field("strength_n").metadata[b"unit"] == b"N"


def test_plans_that_are_not_those_of_the_run(results: petmjx.RunResults) -> None:
    articles = table("milk,,1,,,")
    Path("plans.json").rename("moved.json")
    assert len(petmjx.loads("run", articles).plans) == 3, "the run has kept them"
    keep_nothing(Path("run"))
    with pytest.raises(
        petmjx.InputError, match=r"run: needs the plans of the run, but their file plans\.json does not exist"
    ):
        petmjx.loads("run", articles)
    assert len(petmjx.loads("run", articles, "moved.json").plans) == 3
    with pytest.raises(petmjx.InputError, match="run: plan falls is not among the plans that were read"):
        petmjx.loads("run", articles, write(Path("other.json"), {"one": tower(1), "three": tower(3)}))
    changed: dict[str, Any] = json.loads(Path("moved.json").read_text())
    changed["one"][0]["item"]["weight/kg"] = 7
    with pytest.raises(petmjx.InputError, match="run: plan one differs from the simulated one"):
        petmjx.loads("run", articles, write(Path("other.json"), changed))


@pytest.mark.parametrize("columns", ["80", "120"])
def test_the_command(
    results: petmjx.RunResults, columns: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    table("milk,,10,,,", ",confectionery,500,,,")
    assert run("loads", "run", "--articles", "articles.csv", "-o", "loads") == 0
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= int(columns)
    assert "1 of 3 plans overloaded (1 box), 1 not known" in printed
    assert run("loads", "run", "--articles", "articles.csv", "--json") == 0
    plans = {row["plan_id"]: row for row in json.loads(capsys.readouterr().out)["plans"]}
    assert plans["three"]["overloaded"] is True
    assert plans["falls"]["overloaded"] is None


def test_worlds_with_errors_are_not_called_plans(results: petmjx.RunResults) -> None:
    table("milk,,10,,,")
    loads = petmjx.loads(results, "articles.csv")
    again = replace(loads, plans=pd.concat([loads.plans, loads.plans.assign(variant=1)], ignore_index=True))
    again = replace(again, boxes=pd.concat([loads.boxes, loads.boxes.assign(variant=1)], ignore_index=True))
    assert "2 of 6 worlds overloaded (2 boxes), 4 not known" in [str(load_table) for load_table in load_tables(again)]


def test_the_command_refuses(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("loads", "nowhere", "--articles", "articles.csv") == 2
    assert only_line(capsys.readouterr().err) == "petmjx: nowhere: no such folder"
