"""Tests of leaderboards: the rating, and the site. The site requests nothing from servers, escapes all texts, and can
be made again from its files."""

from __future__ import annotations

import filecmp
import json
import re
import shlex
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest
from support.outcomes import make_outcome
from unit.test_packer_comparison import write

import petmjx
from petmjx.analysis.packer_rating import rate, rating_interval
from petmjx.cli import main
from petmjx.common.errors import InputError
from petmjx.engines.verdict import Reason, Verdict
from petmjx.results.share_statistics import wilson_interval

pytest.importorskip("scipy")

FALLS: dict[str, Any] = {"verdict": Verdict.UNSTABLE, "reason": Reason.SHIFT, "culprit": 0}
EVIL = "<script>alert(1)</script>&"


def test_the_rating_is_the_share_of_ordered_boxes_on_plans_that_stand(tmp_path: Path) -> None:
    """The rating is the share of ordered boxes that are on plans that stand. Plans have three boxes. Of four orders,
    packer a packs all, and one plan falls. Packer b has no plan for one order, and one plan is invalid."""
    invalid = {"verdict": Verdict.INVALID, "reason": Reason.NONFINITE}
    a = write(tmp_path / "a", {f"o{k}": make_outcome(**(FALLS if k == 3 else {})) for k in range(4)})
    b = write(tmp_path / "b", {f"o{k}": make_outcome(**(invalid if k == 2 else {})) for k in range(3)})
    table = rate(petmjx.compare_packers([b, a])).set_index("packer")
    assert table["rank"].to_dict() == {"a": 1, "b": 2}
    assert table["rating"].to_dict() == {"a": 0.75, "b": 0.5}
    assert table.loc["b", ["n_orders", "n_stable", "n_invalid", "n_missing"]].tolist() == [4, 2, 1, 1]
    assert table.loc["a", ["ordered_boxes", "standing_boxes"]].tolist() == [12, 9]
    low, high = wilson_interval(3, 4)  # orders have equal sizes, so the sample size is the number of orders
    assert table.loc["a", ["low", "high"]].tolist() == pytest.approx([float(low), float(high)])


def test_one_large_order_makes_a_rating_less_sure() -> None:
    share = np.array([0.5])
    even, uneven = (rating_interval(share, np.array(sizes), 0.95) for sizes in ([10.0] * 20, [10.0] * 19 + [500.0]))
    assert float(uneven[1][0] - uneven[0][0]) > 1.5 * float(even[1][0] - even[0][0])


def cartons(name: str, offset_mm: float) -> petmjx.Plan:
    """A plan with two cartons. The upper carton is offset by ``offset_mm`` from the lower carton."""
    carton = {"length_mm": 400, "width_mm": 300, "height_mm": 200, "weight_kg": 6, "y_mm": 0, "article": EVIL}
    return petmjx.Plan.from_boxes(name, [{**carton, "x_mm": x, "z_mm": z} for x, z in ((0, 0), (offset_mm, 200))])


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The board of two packers on two orders. Both plans of the packer ``careful`` stand, and one plan of ``eager``."""
    folder = tmp_path_factory.mktemp("leaderboard")
    names = ("order 1", f"order {EVIL}".replace("/", ""))
    petmjx.save_plans([cartons(name, 50) for name in names], folder / "careful.json")
    petmjx.save_plans([cartons(name, 50 + 250 * k) for k, name in enumerate(names)], folder / "eager.json")
    words = [f"careful={folder / 'careful.json'}", f"<b>eager&'={folder / 'eager.json'}"]
    assert main(["leaderboard", *words, "--engine", "mujoco", "--stories", "1", "-o", str(folder / "board")]) == 0
    return folder / "board"


class Links(HTMLParser):
    """A parser that collects the elements and links of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.elements: set[str] = set()
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.add(tag)
        self.links += [value or "" for name, value in attrs if name in ("href", "src")]


def test_the_page_is_static_and_names_are_text(board: Path) -> None:
    text = (board / "index.html").read_text(encoding="utf-8")
    parsed = Links()
    parsed.feed(text)
    assert "b" not in parsed.elements
    assert text.count("<script") == text.count("</script") == 2  # both elements are empty
    assert "alert(1)</script>" not in text.replace("&lt;script&gt;alert(1)&lt;/script&gt;", "")
    assert "&lt;b&gt;eager&amp;" in text
    links = [link for link in parsed.links if not link.startswith("data:")]
    assert len(links) == 2 + 2 + 2  # stories, the same stories in the list of orders, and files of plans
    assert all("://" not in link and (board / unquote(link)).is_file() for link in links)
    assert re.search(r"<td[^>]*>100.0 %</td>.*<td[^>]*>50.0 %</td>", text, flags=re.DOTALL)
    assert "but that may be luck" in text


def test_the_numbers_are_data_too(board: Path) -> None:
    data = json.loads((board / "leaderboard.json").read_text(encoding="utf-8"))
    assert [(row["packer"], row["rating"]) for row in data["rating"]] == [("careful", 1.0), ("<b>eager&'", 0.5)]
    assert [(story["packer"], story["verdict"]) for story in data["stories"]] == [
        ("careful", "stable"),
        ("<b>eager&'", "unstable"),
    ]


def test_the_command_of_the_page_makes_it_again(board: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command = json.loads((board / "leaderboard.json").read_text(encoding="utf-8"))["command"]
    monkeypatch.chdir(board)
    assert main(shlex.split(command)[1:]) == 0
    again = board.parent / "again"
    files = [str(path.relative_to(board)) for path in board.rglob("*") if path.is_file() and "runs" not in path.parts]
    assert len(files) == 6
    assert filecmp.cmpfiles(board, again, files, shallow=False) == (files, [], [])


def test_petmjx_own_packers_are_the_first_rows(tmp_path: Path) -> None:
    item = {"article": "a", "id": "1", "product_group": "g", "length/mm": 400, "width/mm": 300, "height/mm": 200}
    order = {"item_sequence": {"1": item | {"weight/kg": 5, "sequence": 1}}, "properties": {"target": "euro-pallet"}}
    (tmp_path / "orders.json").write_text(json.dumps({"order 1": order}), encoding="utf-8")
    plan = petmjx.Plan.from_boxes("order 1", [{**BOX, "article": "a"}])
    petmjx.save_plans(plan, tmp_path / "mine.json")
    options: dict[str, Any] = {"orders": tmp_path / "orders.json", "baselines": True, "engine": "mujoco", "stories": 0}
    page = petmjx.leaderboard([tmp_path / "mine.json"], tmp_path / "board", **options)
    text = page.read_text(encoding="utf-8")
    assert text.count("of petmjx</span>") == 3
    assert "kpi_4" in text
    assert "--baselines" in text
    data = json.loads((page.parent / "leaderboard.json").read_text(encoding="utf-8"))
    packers = ("baseline", "balanced", "learned", "mine")
    assert {row["packer"]: row["rating"] for row in data["rating"]} == dict.fromkeys(packers, 1.0)


BOX = {"length_mm": 400, "width_mm": 300, "height_mm": 200, "weight_kg": 5, "x_mm": 0, "y_mm": 0, "z_mm": 0}


def test_what_makes_no_leaderboard_is_one_line(tmp_path: Path, board: Path) -> None:
    refused: list[tuple[Any, dict[str, Any], str]] = [
        ([board / "plans" / "careful.json"], {}, "at least two packers"),
        ([tmp_path / "none.json"] * 2, {}, "no such file or folder"),
        ({"a/b": board}, {}, "usable as the name of a folder"),
        ([board, 2], {}, r"packers\[1\] must be a path, got 2"),
        ({"a": board, "b": None}, {}, r"packers\['b'\] must be a path, got None"),
        (3, {}, "packers must be a list of runs or files of plans, got 3"),
        ([board / "plans" / "careful.json"], {"baselines": True}, "needs orders"),
        (
            {"balanced": board / "plans" / "careful.json"},
            {"baselines": True, "orders": board / "plans" / "careful.json"},
            "balanced: baselines has a packer of this name",
        ),
        ([board, board], {"stories": -1}, "stories must be"),
    ]
    for packers, options, message in refused:
        with pytest.raises(InputError, match=message):
            petmjx.leaderboard(packers, tmp_path / "board", **options)
    with pytest.raises(InputError, match="overwrite"):
        petmjx.leaderboard([board], board)


def test_a_folder_that_holds_something_else_is_left_alone(tmp_path: Path, board: Path) -> None:
    (tmp_path / "stories").mkdir()
    (tmp_path / "stories" / "mine.html").write_text("mine")
    (tmp_path / "mine.txt").write_text("mine")
    packers = [board / "plans" / "careful.json", board / "plans" / "<b>eager&'.json"]
    with pytest.raises(InputError, match=r"already contains mine\.txt; name a new folder"):
        petmjx.leaderboard(packers, tmp_path)
    with pytest.raises(InputError, match=r"mine\.txt: is a file; name a folder"):
        petmjx.leaderboard(packers, tmp_path / "mine.txt")
    assert (tmp_path / "stories" / "mine.html").read_text() == "mine"


def test_repaired_plans_are_an_entry_that_says_so(tmp_path: Path) -> None:
    petmjx.save_plans([cartons("order 1", 50)], tmp_path / "careful.json")
    petmjx.save_plans([cartons("order 1", 300)], tmp_path / "eager.json")
    words = [
        str(tmp_path / "careful.json"),
        str(tmp_path / "eager.json"),
        "--repair",
        "eager",
        "-o",
        str(tmp_path / "b"),
    ]
    assert main(["leaderboard", *words, "--engine", "mujoco", "--threads", "1", "--stories", "0"]) == 0
    data = json.loads((tmp_path / "b" / "leaderboard.json").read_text(encoding="utf-8"))
    rows = {row["packer"]: row for row in data["rating"]}
    assert {name: row["rating"] for name, row in rows.items()} == {"careful": 1.0, "eager": 0.0, "eager-repaired": 1.0}
    assert "eager-repaired" in (tmp_path / "b" / "index.html").read_text(encoding="utf-8")
