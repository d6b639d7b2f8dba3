"""Tests of tables of articles, from which the boxes of plans get materials and centres of mass."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.command_line import only_line, run, write

import petmjx
from petmjx.common.errors import InputError
from petmjx.options.physics import PHYSICS
from petmjx.options.simulation import Simulation
from petmjx.plans.articles import Article, read_articles, with_articles
from petmjx.plans.plan import Plan
from petmjx.results.plan_digests import plan_digest
from petmjx.world.scene import build_scene
from petmjx.world.variants import PlacementChange, Variant, apply

pytestmark = pytest.mark.usefixtures("in_tmp_path")

TABLE = """article,product_group,material,com_length_mm,com_width_mm,com_height_mm,strength_n
crate,,plastic,50,10,-20,
,bottles,film,,,,900
roll,,,0,0,30,
"""


def plan(turned: int = 0) -> Plan:
    boxes = [
        {"article": "crate", "orientation": turned},
        {"article": "water", "product_group": "bottles", "orientation": 0},
        {"article": "roll", "product_group": "bottles", "orientation": 0},
        {"article": "bread", "orientation": 0},
    ]
    size = {"length_mm": 400, "width_mm": 300, "height_mm": 200, "weight_kg": 5, "y_mm": 0, "z_mm": 0}
    return Plan.from_boxes("p", [{**size, "x_mm": 400 * k, "product_group": "", **box} for k, box in enumerate(boxes)])


def test_fields_of_an_article_come_before_those_of_its_group() -> None:
    articles = read_articles(write(Path("articles.csv"), TABLE))
    assert articles.find("crate", "") == Article(None, "plastic", (50, 10, -20))
    article = articles.find("roll", "bottles")
    assert article.material == "film"
    assert article.com_mm == (0, 0, 30)
    assert article.strength is not None
    assert article.strength.strength_n == 900


@pytest.mark.parametrize(("turned", "first"), [(0, (50, 10, -20)), (1, (-10, 50, -20))])
def test_plans_take_what_is_said(turned: int, first: tuple[float, ...]) -> None:
    before = plan(turned)
    after = with_articles(before, read_articles(write(Path("articles.csv"), TABLE)))
    assert after.materials == ("plastic", "film", "film", "")
    assert after.mass_center_mm is not None
    np.testing.assert_array_equal(after.mass_center_mm, [first, (0, 0, 0), (0, 0, 30), (0, 0, 0)])
    assert plan_digest(after) != plan_digest(before)
    others = read_articles(write(Path("others.csv"), "article,material\nship,steel\n"))
    assert with_articles(before, others) is before


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("crate,,,far,,,", 'com_length_mm must be a number ≥ -2000 and at most 2000, got "far"'),
        ("crate,,,2001,,,", 'com_length_mm must be a number ≥ -2000 and at most 2000, got "2001"'),
        (f"crate,,{'x' * 101},,,,", "material must be text of at most 100 characters, got "),
        ("crate,,,,,,", "needs strength_n, or "),
        ("crate,,wood,,,,-1", "strength_n must be a number ≥ 0.01 and at most 1e+09"),
    ],
)
def test_rows_that_are_refused(row: str, message: str) -> None:
    write(Path("articles.csv"), TABLE.partition("\n")[0] + "\n" + row + "\n")
    with pytest.raises(InputError) as caught:
        read_articles("articles.csv")
    assert str(caught.value).startswith(f"articles.csv: row 2: {message}")


def test_a_centre_of_mass_outside_its_box_costs_the_plan(capsys: pytest.CaptureFixture[str]) -> None:
    write(Path("articles.csv"), "article,com_width_mm\nbread,150\n")
    petmjx.save_plans(plan(), "plans.json")
    assert run("score", "plans.json", "--engine", "mujoco", "--articles", "articles.csv") == 2
    line = only_line(capsys.readouterr().err)
    assert "plan p, placement 3: com_width_mm of article bread is 150, not inside the box of 300 mm" in line


def test_plans_say_it_themselves() -> None:
    """Plans in all file formats can contain the properties of their boxes. Properties in plans take precedence over
    those in a table of articles."""
    stated_plan = with_articles(plan(1), read_articles(write(Path("articles.csv"), TABLE)))
    table = write(Path("others.csv"), "article,material,com_length_mm\ncrate,steel,-9\nbread,wood,7\n")
    for name in ("a.json", "a.csv", "a.parquet"):
        petmjx.save_plans(stated_plan, name)
        (loaded_plan,) = petmjx.load_plans(name).plans
        assert loaded_plan.materials == stated_plan.materials
        np.testing.assert_array_equal(loaded_plan.mass_center_mm, stated_plan.mass_center_mm)
        more = with_articles(loaded_plan, read_articles(table))
        assert more.materials == ("plastic", "film", "film", "wood")
        np.testing.assert_array_equal(more.mass_center_mm, [(-10, 50, -20), (0, 0, 0), (0, 0, 30), (7, 0, 0)])
    text = Path("a.csv").read_text().replace("-20", "-100")
    write(Path("a.csv"), text)
    fault = "com_height_mm must be inside the box, less than half of 200 from the middle, got -100"
    assert str(petmjx.load_plans("a.csv").skipped[0]) == f"a.csv: plan p, row 2: {fault}"


def test_a_run_with_articles() -> None:
    petmjx.save_plans(plan(), "plans.json")
    write(Path("articles.csv"), TABLE)
    options = {"engine": "mujoco", "threads": 1, "articles": "articles.csv"}
    with pytest.raises(InputError) as caught:
        petmjx.score("plans.json", **options, out="run")
    assert str(caught.value) == (
        "no friction is known of film on plastic: give it, as in friction_pairs = "
        '[{between = ["film", "plastic"], friction = 0.4}]'
    )
    assert not Path("run").exists()
    pairs = [{"between": ["film", "plastic"], "friction": 0.25}]
    results = petmjx.score("plans.json", **options, friction_pairs=pairs, out="run")
    config = json.loads(Path("run/run.json").read_text())["config"]
    assert config["articles"] == "articles.csv"
    assert [pair["friction"] for pair in config["simulation"]["friction_pairs"]] == [0.25]
    scene = petmjx.tell("p", results).scene
    assert scene.mass_center is not None
    assert "friction" in scene.pairs
    assert petmjx.loads("run", "articles.csv").boxes["strength_n"].tolist()[1:3] == [900, 900]
    write(Path("articles.csv"), TABLE.replace("50,10", "40,10"))
    with pytest.raises(InputError, match="plan p differs"):
        petmjx.score("plans.json", **options, friction_pairs=pairs, out="run", resume=True)
    kept = petmjx.tell("p", petmjx.load_run("run")).scene  # from the run's copy, not from the changed table of articles
    assert kept.mass_center is not None
    assert kept.mass_center.tolist() == scene.mass_center.tolist()


def test_what_does_not_count_is_told() -> None:
    write(Path("none.csv"), "article,material\nship,steel\n")
    write(Path("film.csv"), "article,material\nbread,film\n")
    options = {"engine": "mujoco", "threads": 1}
    petmjx.save_plans(plan(), "plans.json")
    warnings = petmjx.score("plans.json", articles="none.csv", **options).info["warnings"]
    assert "none.csv: has nothing about the boxes of these plans" in warnings
    warnings = petmjx.score("plans.json", articles="film.csv", physics="reference", **options).info["warnings"]
    assert (
        "materials have no effect: with pyramidal cones, physics options set the friction of all contacts" in warnings
    )
    assert build_scene(plan(), Simulation(physics=PHYSICS["reference"])).pairs == {}


def test_factors_of_sweeps_count_for_pairs_too() -> None:
    articles = read_articles(write(Path("articles.csv"), "article,material\nbread,film\ncrate,cardboard\n"))
    sim = Simulation(friction_pairs=[{"between": ["film", "cardboard"], "friction": 0.4}])
    scene = build_scene(with_articles(plan(), articles), sim)
    assert scene.surface is not None
    assert scene.carrier.surface is not None
    bread, crate, board = scene.surface[3], scene.surface[0], scene.carrier.surface[0]
    change = PlacementChange(box_friction_factor=0.5, carrier_friction_factor=0.8)
    varied = apply(scene, "p", Variant(1, change), 0).pairs["friction"]
    assert varied[bread, crate] == pytest.approx(0.4 * 0.5)
    assert varied[bread, board] == varied[board, bread] == pytest.approx(0.3 * 0.8)
    water = scene.surface[1]  # the table of articles does not contain this article
    assert varied[water, bread] == varied[water, board] == -1.0
