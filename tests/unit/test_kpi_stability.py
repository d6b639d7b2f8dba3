"""Tests of runs without the table ``boxes``. Functions that read this table work without it, or give a message of one
line."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from rich.console import Console
from support.fake_engine import LargestFirst
from support.plans import make_plan, stack

import petmjx
from petmjx.analysis.kpi_stability import read_stability
from petmjx.show.run_tables import run_tables

PLANS = [make_plan(f"p{k}", stack(1 + k % 3)) for k in range(6)]
NOT_KEPT = 'the run was made with keep="worlds", so it has no table `boxes`'


def score(out: Path | None, keep: Any = "worlds", **options: Any) -> petmjx.RunResults:
    return petmjx.score(PLANS, engine=LargestFirst(), out=out, keep=keep, **options)


@pytest.fixture
def runs(tmp_path: Path) -> tuple[petmjx.RunResults, petmjx.RunResults]:
    """A run with all tables, and a run with only the table ``worlds``."""
    return score(tmp_path / "all", "all"), score(tmp_path / "worlds")


def test_all_else_is_the_same(runs: tuple[petmjx.RunResults, petmjx.RunResults]) -> None:
    full, slim = runs
    pd.testing.assert_frame_equal(full.worlds, slim.worlds)
    assert {path.name for path in slim.path.iterdir()} == {"worlds", "plans", "placements", "run.json"}
    assert slim.boxes_if_kept.empty
    with pytest.raises(petmjx.InputError, match=f"{re.escape(str(slim.path))}: {NOT_KEPT}"):
        _ = slim.boxes
    in_memory = score(None)
    pd.testing.assert_frame_equal(in_memory.worlds, slim.worlds)
    with pytest.raises(petmjx.InputError, match=f"in memory: {NOT_KEPT}"):
        _ = in_memory.boxes
    assert "p1" in in_memory._repr_html_()


def test_a_run_goes_on_as_it_began(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        petmjx.score(PLANS, engine=LargestFirst(interrupt_after=2), out=tmp_path / "run", keep="worlds")
    with pytest.raises(petmjx.InputError, match=r"another run \(keep is all, was worlds\)"):
        score(tmp_path / "run", "all", resume=True)
    assert len(score(tmp_path / "run", resume=True).worlds) == 6
    score(tmp_path / "whole", "all")
    with pytest.raises(petmjx.InputError, match=r"another run \(keep is worlds, was all\)"):
        score(tmp_path / "whole", resume=True)


def test_shards_that_keep_the_same_are_joined(tmp_path: Path) -> None:
    shards = [score(tmp_path / f"{k}", shard=f"{k}/2").path for k in (1, 2)]
    merged = petmjx.merge_runs(shards, tmp_path / "merged")
    pd.testing.assert_frame_equal(merged.worlds, score(None).worlds)
    assert not merged.keeps_boxes
    other = score(tmp_path / "other", "all", shard="2/2").path
    with pytest.raises(petmjx.InputError, match=r"not of the same run as .* \(keep is all, was worlds\)"):
        petmjx.merge_runs([shards[0], other], tmp_path / "mixed")


def test_worlds_are_compared_without_boxes(runs: tuple[petmjx.RunResults, petmjx.RunResults]) -> None:
    comparison = petmjx.compare_runs(*runs)
    assert comparison.n_agree == 6
    assert "b kept no table `boxes`: only worlds are compared" in comparison.notes
    assert (comparison.boxes["n"] == 0).all()
    assert (comparison.worlds["n"] > 0).any()


def test_a_report_has_articles_and_no_pictures(runs: tuple[petmjx.RunResults, petmjx.RunResults]) -> None:
    full_page, slim = (petmjx.report(run, run.path / "report.html").read_text() for run in runs)
    assert "worlds kept no boxes: its worlds have no 3D picture." in slim
    assert "boxes-0" in full_page
    assert "boxes-0" not in slim
    articles = re.findall(r"article-\d", full_page[full_page.index("Articles that fail first") :])
    assert articles
    assert articles == re.findall(r"article-\d", slim[slim.index("Articles that fail first") :])


def test_what_is_about_boxes_says_so(
    runs: tuple[petmjx.RunResults, petmjx.RunResults], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "articles.csv"
    table.write_text("article,strength_n\narticle-0,100\narticle-1,100\narticle-2,100\n")
    with pytest.raises(petmjx.InputError, match=NOT_KEPT):
        petmjx.loads(runs[1], table)
    static = score(tmp_path / "static", check="static")
    stability = read_stability([static.path], PLANS)
    assert stability.stable
    assert not stability.their_rule
    assert f"{static.path}: has no table of boxes, which BED-BPP's rule needs" in stability.notes
    console = Console(width=100)
    for part in run_tables(runs[1]):
        console.print(part)
    assert re.search(r"p1 +2 unstable drop .* 1 ", capsys.readouterr().out)
    with pytest.raises(
        petmjx.InputError,
        match="force_intervals adds columns to the table 'boxes', but the option keep leaves this table out",
    ):
        score(None, force_intervals=True)
