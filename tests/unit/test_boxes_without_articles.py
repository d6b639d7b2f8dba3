"""If boxes have no article, texts, tables, legends and pages show another name instead of an empty place."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from dataclasses import replace
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console
from support.stories import falling_story

import petmjx
from petmjx.analysis.story import Story
from petmjx.analysis.story_in_words import box_name, events, first_box_in_words, headline
from petmjx.common.text import box_in_words, box_label
from petmjx.show.pages.still_svg import still_svg
from petmjx.show.pictures.box_colours import colouring
from petmjx.show.pictures.picture_options import Colour
from petmjx.show.run_tables import worlds_table
from petmjx.show.story_tables import story_tables

HOLE = re.compile(r"\(\s*[,)]|\s\(\d+\)$|:\s*[,;)]|\bof article (?!\w)")
STATIC = Path(__file__).resolve().parents[2] / "petmjx" / "show" / "pages" / "static"


def bare(articles: tuple[str, ...], ids: tuple[str, ...] = ("", "", "")) -> Story:
    story = falling_story(articles=articles)
    return replace(story, plan=replace(story.plan, item_ids=ids))


@pytest.mark.parametrize("articles", [("", "", ""), ("tea", "", "")])
def test_texts_and_tables_of_a_story(articles: tuple[str, ...]) -> None:
    story = bare(articles)
    culprit = story.outcome.culprit
    assert culprit > 0
    out = StringIO()
    for table in story_tables(story):
        Console(file=out, width=120, color_system=None).print(table)
    texts = [headline(story), first_box_in_words(story), *(event.what for event in events(story))]
    texts += [line.rstrip() for line in out.getvalue().splitlines()]
    texts += re.findall(r"<title>([^<]*)</title>", still_svg(story))
    assert not [text for text in texts if HOLE.search(text)]
    assert first_box_in_words(story).startswith(f"Box {culprit} failed first:")
    assert f"first box {culprit}, at" in headline(story)
    assert f"<title>{culprit}</title>" in still_svg(story)


def test_an_id_is_a_name_too() -> None:
    story = bare(("", "", ""), ("7", "8", "9"))
    assert box_name(story, 2) == "box 2 (9)"
    assert box_name(bare(("", "", "milk"), ("7", "8", "9")), 2) == "box 2 (milk)"
    assert (box_in_words(9, ""), box_in_words(9, "tea"), box_label(9, ""), box_label(9, "tea")) == (
        "box 9",
        "box 9 (tea)",
        "9",
        "9 tea",
    )


def test_legends_of_pictures() -> None:
    names = [name for name, _ in colouring(bare(("tea", "", "")), Colour.ARTICLE).names]
    assert sorted(names) == ["no article", "tea"]


def test_the_tables_of_a_run() -> None:
    corners = [[0, 0, 0], [350, 0, 200]]
    plan = petmjx.Plan.from_boxes("p", size_mm=[[400, 300, 200]] * 2, corner_mm=corners, mass_kg=[6, 6])
    results = petmjx.score(plan, engine="mujoco", threads=1)
    out = StringIO()
    Console(file=out, width=140, color_system=None).print(worlds_table(results.worlds, results.boxes))
    (row,) = [line for line in out.getvalue().splitlines() if line.split()[:1] == ["p"]]
    assert row.split()[2:6:3] == ["unstable", "1"]


def test_names_in_scripts_of_pages(tmp_path: Path) -> None:
    """If boxes have no article, the legend of a page shows "no article (17)", and the card of a box shows
    "Box 9: 400 × 300 × 200 mm"."""
    if (node := shutil.which("node")) is None:
        pytest.skip("node is not installed")
    (tmp_path / "names.mjs").write_bytes((STATIC / "texts.js").read_bytes())
    goods = ("'', ''", "'tea', ''", "'', '7'", "'tea', '7'")
    calls = f"[labelOf(9, ''), labelOf(9, 'tea'), {', '.join(f'goodsOf({good})' for good in goods)}]"
    script = f"import {{ labelOf, goodsOf }} from './names.mjs'; console.log(JSON.stringify({calls}))"
    (tmp_path / "run.mjs").write_text(script, encoding="utf-8")
    done = subprocess.run([node, "run.mjs"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == ["9", "9 tea", "", "tea", "item 7", "tea (item 7)"]
    for name, used in (("colours.js", "NO_ARTICLE"), ("world_card.js", "goodsOf"), ("story.js", "labelOf")):
        assert f"{used}" in (STATIC / name).read_text(encoding="utf-8")
    assert "(${this.rows.text" not in (STATIC / "plan_view.js").read_text(encoding="utf-8")
