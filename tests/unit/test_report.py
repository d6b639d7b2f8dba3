"""The report about runs: its numbers are those of the tables, and text from plans never becomes markup."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from support.plans import make_plan
from support.report_runs import CONFIG, fallen, invalid, scored, standing, write_plans, write_run
from test_pages import opened_block

from petmjx.common.errors import InputError
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.results.run_reader import load_run
from petmjx.results.share_statistics import PairedCounts, newcombe_interval, wilson_interval
from petmjx.show.pages.page_arrays import block
from petmjx.show.report import report_plan_table
from petmjx.show.report.comparison_section import common_verdicts, comparison_section
from petmjx.show.report.report_page import report, report_page
from petmjx.show.report.report_plan_table import table_rows
from petmjx.show.report.report_runs import Kind, distinct_path_ends, open_runs
from petmjx.show.report.run_settings import _options, changed_options
from petmjx.show.report.sweep_answers import correlation_ratio, largest_survived
from petmjx.show.report.verdict_shares import verdict_table
from petmjx.show.report.world_blocks import WORLDS_PER_BLOCK, box_blocks

NASTY = "<img src=x onerror=alert(1)>\"'&</script><!-- 🧀 é"
"""A plan id that becomes markup if it is not escaped."""


class Balance(HTMLParser):
    """Checks that every HTML element that is opened is closed, in the right order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.ids += [value or "" for name, value in attrs if name == "id"]
        assert not {name for name, _ in attrs} & {"style", "onclick", "onload"}, "the policy forbids it"
        if tag not in ("meta", "link", "input", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def checked(html: str) -> str:
    """The markup of a page without its scripts, after a check that it is well-formed."""
    balance = Balance()
    balance.feed(html)
    assert balance.open == []
    assert len(balance.ids) == len(set(balance.ids))
    for drawing in re.findall(r"<svg.*?</svg>", html, flags=re.DOTALL):
        for part in ElementTree.fromstring(drawing).iter():
            assert "nan" not in " ".join(part.attrib.values()).lower(), ElementTree.tostring(part)
    return re.sub(r"<script.*?</script>", "", html, flags=re.DOTALL)


def page_of(*folders: Path, **options: Any) -> str:
    return report_page(open_runs(folders, **options))


def words_of(html: str) -> str:
    """The text of an HTML page, without its tags."""
    return " ".join(re.sub(r"<[^>]*>", " ", html).split())


def info_of(html: str) -> dict[str, Any]:
    (text,) = re.findall(r'<script type="application/json" id="info">(.*?)</script>', html, flags=re.DOTALL)
    return dict(json.loads(text))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return scored(tmp_path_factory.mktemp("report"), 30)


def test_verdicts_have_their_counts_and_wilson_intervals(run: Path) -> None:
    (opened,) = open_runs([run])
    text = words_of(verdict_table(opened))
    low, high = (100 * float(bound) for bound in wilson_interval(21, 30))
    assert f"stable 21 70.0 % {low:.1f} to {high:.1f} %" in text
    assert [int(count) for count in re.findall(r"(?:drop|tilt|failed) +(\d+)", text)] == [3, 3, 3]


def test_the_page_is_well_formed_and_says_what_was_run(run: Path) -> None:
    html = page_of(run)
    body = checked(html)
    for words in ("two threads", "all at their defaults", "30 plans", "plans.json", "Shift", "What fails first", "jam"):
        assert words in body
    assert info_of(html)["n"] == 30
    assert html.count('id="block-boxes-') == 1


def test_nothing_of_a_plan_becomes_markup(tmp_path: Path) -> None:
    plans = write_plans(tmp_path / "plans.json", [NASTY, "x" * 200, "plan\nof two lines", "🧀" * 30])
    named = [replace(plan, articles=(NASTY,) * plan.n_boxes) for plan in plans]
    folder = write_run(tmp_path / "<b>run", named, [fallen(plan) for plan in named], config=CONFIG | {"engine": NASTY})
    (tmp_path / "other").mkdir()
    other = write_run(tmp_path / "other" / "<b>run", named, [standing(plan) for plan in named])
    for html in (page_of(folder), page_of(folder, other)):
        assert not re.search(r"<(img|b>run)", html)
        assert "onerror=alert" in checked(html)
        assert html.count("<!--") == 0


def test_plans_are_found_again_only_if_they_are_what_was_simulated(tmp_path: Path) -> None:
    run = scored(tmp_path, 4)
    (opened,) = open_runs([run])
    assert (len(opened.plan_files.plans), opened.plan_files.note) == (4, "")
    assert opened.worlds["height_m"].tolist() == [0.4] * 4
    assert opened.worlds["mass_kg"][0] == sum(2.0 + box % 7 for box in range(12))
    entries = json.loads((tmp_path / "plans.json").read_text())
    entries["plan-1"][0]["item"]["weight/kg"] = 99.0
    moved = tmp_path / "moved.json"
    moved.write_text(json.dumps(entries))
    (tmp_path / "plans.json").unlink()
    (opened,) = open_runs([run])
    assert opened.plan_files.note.startswith("4 plans of 4 not found again (gone: ")
    checked(page_of(run))
    (opened,) = open_runs([run], [moved])
    assert sorted(opened.plan_files.plans) == ["plan-0", "plan-2", "plan-3"]
    assert opened.plan_files.note == "1 plan of 4 not found again (1 plan changed since)"
    with pytest.raises(InputError, match="no such file"):
        open_runs([run], [tmp_path / "nowhere.json"])


def test_the_article_that_failed_first_is_known_without_the_plan(tmp_path: Path) -> None:
    plans = write_plans(tmp_path / "plans.json", ["a", "b", "c"], n_boxes=3)
    outcomes = [fallen(plans[0], first=0), fallen(plans[1], first=1), standing(plans[2])]
    run = write_run(tmp_path / "run", plans, outcomes)
    for _ in range(2):
        (opened,) = open_runs([run])
        assert opened.worlds["first_article"].tolist() == [plans[0].articles[0], plans[1].articles[1], ""]
        (tmp_path / "plans.json").unlink(missing_ok=True)
    assert not opened.plan_files.plans


def test_boxes_come_back_as_they_ended(run: Path) -> None:
    runs = open_runs([run])
    _, table = table_rows(runs)
    packed = box_blocks(runs, table)
    assert packed.drawn.tolist() == list(range(30))
    assert len(packed.blocks) == math.ceil(30 / WORLDS_PER_BLOCK)
    columns = {name: restored_column(column) for name, column in opened_block(packed.blocks["boxes-0"]).items()}
    boxes = runs[0].results.boxes.merge(table[["plan_id"]].reset_index(), on="plan_id")
    boxes = boxes.sort_values(["index", "box"])
    pos = columns["planned"].reshape(-1, 3) / 1e4 + columns["moved"].reshape(-1, 3)
    assert np.allclose(pos, boxes[["pos_x_m", "pos_y_m", "pos_z_m"]], rtol=0, atol=1e-4, equal_nan=True)
    turn = boxes[["quat_x", "quat_y", "quat_z"]].to_numpy()
    assert np.allclose(columns["turn"].reshape(-1, 3), turn, rtol=0, atol=1e-4, equal_nan=True)
    assert np.allclose(np.expm1(columns["force"]), boxes["max_top_force_n"], rtol=1e-3, equal_nan=True)
    assert np.allclose(columns["drop"], boxes["drop_s"], atol=1e-3, equal_nan=True)
    items = json.loads(bytes(columns["items"].astype(np.uint8)))
    assert [items[int(kind)][:2] for kind in columns["kind"]] == boxes[["item_id", "article"]].to_numpy().tolist()
    assert columns["count"].tolist() == table["n_boxes"].tolist()


def restored_column(column: dict[str, Any]) -> Any:
    values = np.asarray(column["values"]).reshape(column["shape"])
    if "scale" not in column:
        return values
    return np.where(values == -32768, np.nan, values * column["scale"] + column["offset"])


def test_of_too_many_worlds_those_that_fall_are_kept(run: Path) -> None:
    runs = open_runs([run])
    page_rows, table = table_rows(runs, most=10)
    assert (len(table), page_rows.left_out) == (10, 20)
    assert (table["verdict"] != "stable").sum() == 9
    assert table["plan_id"].is_monotonic_increasing
    packed = box_blocks(runs, table, most=40)
    assert packed.without_boxes == 7
    assert set(table["verdict"][packed.drawn >= 0]) <= {"unstable", "invalid"}


def test_ten_thousand_plans_fit_into_a_mail(tmp_path: Path) -> None:
    runs = open_runs([scored(tmp_path, 100, n_boxes=44)])
    page_rows, table = table_rows(runs)
    bytes_a_box = sum(map(len, box_blocks(runs, table).blocks.values())) / table["n_boxes"].sum()
    bytes_a_row = len(block(page_rows.arrays)) / len(table)
    assert 10_003 * (43 * bytes_a_box + bytes_a_row) < 18e6, "of 20 MB"


def test_odd_runs_look_right(tmp_path: Path) -> None:
    plans = write_plans(tmp_path / "plans.json", ["a", "b", "c"], n_boxes=3)
    empty = write_run(tmp_path / "empty", [], [])
    one = write_run(tmp_path / "one", plans[:1], [standing(plans[0])])
    bad = write_run(tmp_path / "bad", plans, [invalid(plan) for plan in plans])
    unfinished = write_run(
        tmp_path / "unfinished", plans[:2], [standing(plan) for plan in plans[:2]], expected_worlds=9
    )
    assert "nothing to show" in checked(page_of(empty))
    assert "Verdicts of 1 plan<" in checked(page_of(one))
    nothing_valid = checked(page_of(bad))
    assert "100.0 %" in nothing_valid
    assert "No plan was simulated validly" in nothing_valid
    assert "<svg" not in nothing_valid, "a chart without data"
    assert "No box crossed" not in nothing_valid, "nobody knows"
    assert "7 plans not simulated" in checked(page_of(unfinished))
    for folders in ((empty, one), (one, bad, unfinished), (empty, bad)):
        checked(page_of(*folders))
    bare = write_run(tmp_path / "bare", plans, [standing(plan) for plan in plans], manifest=None, config={})
    assert "does not list its plans" in checked(page_of(bare))


def test_options_that_differ_are_told() -> None:
    defaults = Simulation().model_dump(mode="json")
    changed = Simulation.read({"check": "static", "thresholds": {"tilt_deg": 5.0}}).model_dump(mode="json")
    assert "world_timeout_s</code> 0.5 instead of none" in _options({"simulation": defaults, "world_timeout_s": 0.5})
    assert _options({"simulation": defaults, "world_timeout_s": None}) == "all at their defaults"
    assert [*changed_options(changed, defaults)] == [
        ("check", "static", "one-by-one"),
        ("thresholds.tilt_deg", 5.0, 20.0),
    ]
    told = _options({"simulation": changed})
    assert "check</code> static instead of one-by-one" in told
    assert "thresholds.tilt_deg</code> 5.0 instead of 20.0" in told


def test_plans_won_and_lost_are_counted(tmp_path: Path) -> None:
    plans = write_plans(tmp_path / "plans.json", list("abcdef"), n_boxes=3)

    def of(name: str, outcomes: str) -> Path:
        made = {"s": standing, "f": fallen, "i": invalid}
        return write_run(
            tmp_path / name, plans, [made[letter](plan) for letter, plan in zip(outcomes, plans, strict=True)]
        )

    one, two = of("one", "sssffi"), of("two", "ssffsf")
    runs = open_runs([one, two])
    assert common_verdicts(runs)[0].tolist() == ["stable"] * 3 + ["unstable"] * 2 + ["invalid"]
    text = words_of(comparison_section(runs))
    for words in ("2 stand in both", "1 stand only in one", "1 stand only in two", "1 stand in neither"):
        assert words in text
    assert "two − one +0.0" in text, "as many won as lost"
    low, high = newcombe_interval(PairedCounts(2, 1, 1, 1))
    assert f"{100 * low:+.1f} to {100 * high:+.1f}".replace("-", "−") in text
    assert "Flipped verdicts (3)" in text
    assert "3 of 6 worlds agree (50.0 %)" in text
    assert "Stable rates" in comparison_section(open_runs([one, two, of("three", "ffffff")]))


def test_a_report_of_two_packers_does_not_doubt_itself(tmp_path: Path) -> None:
    few, many = (write_plans(tmp_path / f"{n}.json", "ab", n) for n in (3, 6))

    def page_against(name: str, plans: list[Plan]) -> str:
        return comparison_section(open_runs([one, write_run(tmp_path / name, plans, [fallen(plan) for plan in plans])]))

    one = write_run(tmp_path / "one", few, [fallen(plan) for plan in few])
    for name, other, words in (
        ("packer", many, "No plan is the same in both runs: two packers are compared"),
        ("half", [few[0], many[1]], "1 of 2 plans is not the same in both runs."),
    ):
        page = page_against(name, other)
        assert words in words_of(page)
        assert "warn" not in page
        assert "the same first box" not in words_of(page), "boxes of one number are not the same"
    again = words_of(page_against("again", few))
    assert "2 the same first box to fail." in again
    assert "same in both runs" not in again


def test_runs_are_told_apart(run: Path) -> None:
    assert distinct_path_ends([Path("/x/a"), Path("/x/b")]) == ["a", "b"]
    assert distinct_path_ends([Path("/x/a/r"), Path("/x/b/r"), Path("/x/b/q")]) == ["a/r", "b/r", "b/q"]
    with pytest.raises(InputError, match="named twice"):
        open_runs([run, run / ".." / "run"])
    with pytest.raises(InputError, match="no run to report on"):
        open_runs([])


def test_a_report_is_written_once(run: Path, tmp_path: Path) -> None:
    out = report(load_run(run), tmp_path / "it.html")
    before = out.read_bytes()
    with pytest.raises(InputError, match="exists already"):
        report(run, out)
    assert report([run], out, overwrite=True).read_bytes() == before, "a page of one run is always the same"
    with pytest.raises(InputError, match="is a folder"):
        report(run, tmp_path)
    with pytest.raises(InputError, match=r"no such folder"):
        report(tmp_path / "nothing", tmp_path / "b.html")
    assert not (tmp_path / "b.html").exists()


# Sweeps.


def test_largest_levels_are_below_every_failure() -> None:
    levels = [0.1, 0.2, 0.3, 0.4]
    rows = []
    for plan, direction, stands in (("a", 0, "ssfs"), ("a", 90, "ssss"), ("b", 0, "fsss"), ("b", 90, "ssif")):
        verdicts = [{"s": "stable", "f": "unstable", "i": "invalid"}[letter] for letter in stands]
        rows += [(plan, direction, *pair) for pair in zip(levels, verdicts, strict=True)]
    worlds = pd.DataFrame(rows, columns=["plan_id", "direction_deg", "level_g", "verdict"])
    largest = largest_survived(worlds.sample(frac=1, random_state=1), "level_g")
    assert largest["largest"].tolist() == [0.2, 0.4, 0.0, 0.2]


def test_explained_variance_is_that_of_one_way_analysis() -> None:
    values = pd.Series([0.0, 0.0, 1.0, 1.0, 1.0, 0.0])
    assert correlation_ratio(values, pd.Series(list("aabbba"))) == pytest.approx(1.0)
    # the means 2/3 and 1/3 differ from the total mean 1/2
    assert correlation_ratio(values, pd.Series(list("ababab"))) == pytest.approx(1 / 9)
    assert math.isnan(correlation_ratio(pd.Series([1.0, 1.0]), pd.Series(["a", "b"])))


SHORT = '[simulation]\ncheck = "static"\nduration_s = 0.1\nrest_s = 0.05\n'


def swept(folder: Path, rest: str) -> tuple[pd.DataFrame, Path]:
    """Worlds of a short sweep of two plans, and the folder of the sweep's run."""
    import petmjx

    write_plans(folder / "two.json", ["a", "b"], n_boxes=4)
    file = folder / "sweep.toml"
    file.write_text('name = "grid"\nplans = "two.json"\n' + SHORT + rest, encoding="utf-8")
    return petmjx.sweep(file, engine="mujoco", out=folder / "swept").worlds, folder / "swept"


def test_grids_have_their_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    axes = '[axes]\nprofile = "eumos-40509"\nlevel = [0.2, 1.5]\ndirection = [0, 90, 180]\n'
    worlds, folder = swept(tmp_path, axes)
    (opened,) = open_runs([folder])
    assert (opened.kind, opened.axes) == (Kind.GRID, ["direction_deg", "level_g"])
    html = page_of(folder)
    body = checked(html)
    for words in ("Share that stands by level", "Largest level of eumos-40509 by direction", "Which axis matters most"):
        assert words in body
    assert info_of(html)["n"] == len(worlds) == 12
    assert not info_of(html)["runs"][0]["nominalSizes"]
    keys = [column["key"] for column in info_of(html)["columns"]]
    assert keys.index("x-level_g") < keys.index("verdict") < keys.index("x-mode")
    shares = worlds.assign(stands=worlds["verdict"] == "stable").groupby("level_g")["stands"].mean()
    assert f"<title>0.2: {100 * shares[0.2]:.1f} %, 95 %:" in body
    monkeypatch.setattr(report_plan_table, "MOST_OF_SWEEP", 11)
    html = page_of(folder)
    assert "has 12 worlds, too many for a row each. The table has one row per plan" in checked(html)
    page_rows, table = table_rows([opened])
    assert page_rows.summed_up == [opened]
    assert info_of(html)["n"] == len(table) == worlds["plan_id"].nunique() == 2
    of_plan = worlds.groupby("plan_id")
    assert table.set_index("plan_id")["margin"].to_dict() == of_plan["margin"].min().to_dict()
    stand = of_plan["verdict"].agg(lambda verdicts: (verdicts == "stable").mean())
    assert table.set_index("plan_id")["share"].to_dict() == stand.to_dict()


def test_searches_have_their_answers(tmp_path: Path) -> None:
    search = "[search]\nlower = 0.2\nupper = 0.6\ntolerance = 0.2\n"
    axes = '[axes]\nprofile = "eumos-40509"\ndirection = [0, 90, 180]\n'
    _, folder = swept(tmp_path, search + axes)
    body = checked(page_of(folder))
    for words in ("6 searches of placements that stand at rest", "tested up to 0.6 g", "Largest level survived, g"):
        assert words in body
    assert "Tilt: histogram" not in body, "its worlds say where it looked"


def test_confidence_has_its_answers(tmp_path: Path) -> None:
    import petmjx

    write_plans(tmp_path / "two.json", ["a", "b"], n_boxes=4)
    options: dict[str, Any] = {"engine": "mujoco", "check": "static", "duration_s": 0.1, "confidence": 4}
    petmjx.score(tmp_path / "two.json", out=tmp_path / "sure", **options)
    html = page_of(tmp_path / "sure")
    assert "How sure are the verdicts?" in checked(html)
    assert info_of(html)["n"] == 2, "a row a plan, not a row a world"
    assert info_of(html)["runs"][0]["nominalSizes"], "worlds have errors of sizes, which are not drawn"
    assert {"share", "low", "high"} <= {column["key"] for column in info_of(html)["columns"]}


def test_a_chain_has_its_answers(tmp_path: Path) -> None:
    import petmjx

    file = tmp_path / "chain.toml"
    file.write_text(
        "replicates = 2\n[axes]\nfriction_tolerance_rel = 0.05\n[[legs]]\nname = 'belt <1>'\n"
        "events = [{ profile = 'eumos-40509', level = 0.1 }]\n"
        "[[remedies]]\nname = 'slower'\nleg = 'belt <1>'\nfactor = 0.5\n"
    )
    write_plans(tmp_path / "two.json", ["a", "b"], n_boxes=2)
    petmjx.score(tmp_path / "two.json", out=tmp_path / "way", engine="mujoco", chain=file)
    html = page_of(tmp_path / "way")
    words = words_of(checked(html))
    assert "How likely do pallets arrive?" in words
    assert "belt &lt;1&gt; 100.0 % of 4 (51.0 to 100.0 %)" in words
    assert "slower 100.0 % +0.0 -49.0 to +49.0 0 0" in words
    assert info_of(html)["n"] == 4, "worlds with errors alone, without those of remedies"


def test_a_page_to_send_is_about_each_plan_of_a_chain(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    import petmjx
    from petmjx.show.figures.load_unit_page import _assumed, _facts, sentence, write_load_unit_pages

    file = tmp_path / "chain.toml"
    file.write_text(
        "replicates = 2\n[simulation]\nwalls = ['front', 'back']\n[axes]\nfriction_tolerance_rel = 0.05\n"
        "[[legs]]\nname = 'truck'\nevents = [{ profile = 'eumos-40509', level = 0.8 }]\n"
        "[[legs]]\nname = 'film'\nwrap_turns = 8\n"
    )
    plans = [make_plan("stays", 1), make_plan("slides", 2)]
    run = petmjx.score(plans, engine="mujoco", chain=file)
    out = tmp_path / "pages.pdf"
    assert write_load_unit_pages(run, {plan.plan_id: plan for plan in plans}, out) == 2
    assert out.read_bytes().startswith(b"%PDF")
    assert out.read_bytes().count(b"/Type /Page ") == 2
    assert run.summary is not None
    (row,) = run.summary.query("scope == 'plan' and plan_id == 'slides' and leg == ''").to_dict("records")
    arrives = "Arrives in 0 of 2 worlds: P = 0.0 % (95 % interval: 0.0 % to 65.8 %)"
    assert sentence(row).startswith(f"{arrives}. Weakest leg: truck")
    facts = "\n".join(_facts(run, plans[0]))
    mass_kg, height_m = plans[0].mass_kg[0], plans[0].size_mm[0, 2] / 1000
    # film presses on each of the four sides with 2·T, where T = 50 N · 8 · height / 0.5 m; it sticks with 0.3 times
    # this force
    held_n = 0.3 * 4 * 2 * 50 * 8 * height_m / 0.5
    assert "Film of 500 mm width, with a tension of 50 N in each turn: 8 turns from film on." in facts
    slides_g = 0.5 + held_n / (mass_kg * 9.81)
    assert f"Held to its carrier by 8 turns of film, the load slides from {slides_g:.2f} g on." in facts
    assert "Walls stand on the front, back; there are no straps" in _assumed(run)[-1]
    assert "more than 20 mm from its planned place, and no box is tilted by more than 20°" in _assumed(run)[-1]
    counts = {**run.info["counts"], "worlds": 1}
    partial = replace(run, info={**run.info, "status": "interrupted", "counts": counts})
    with pytest.raises(InputError, match=r"is not complete \(1 of 6 worlds\): continue with resume=True"):
        write_load_unit_pages(partial, {}, out)
    score = petmjx.score(plans, engine="mujoco")
    with pytest.raises(InputError, match="is not the run of a chain"):
        write_load_unit_pages(score, {}, out)
