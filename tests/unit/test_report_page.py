"""The page of a report in headless Chromium: the table, its filters, the address, and a plan in 3D. The page makes no
request."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlencode, urlsplit

import numpy as np
import pytest
from support.browser import Opened, OpenPage
from support.report_runs import fallen, invalid, scored, standing, write_plans, write_run

from petmjx.show.report.report_page import report_page
from petmjx.show.report.report_runs import open_runs

MARKUP = "<img src=x onerror=alert(1)>"
READY = "document.documentElement.dataset.ready === 'true'"
N = 120


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return scored(tmp_path_factory.mktemp("report"), N)


@pytest.fixture(scope="module")
def html(run: Path) -> str:
    return report_page(open_runs([run]))


def opened_report(open_page: OpenPage, html: str, **options: Any) -> Opened:
    """The opened page, as soon as its table is complete."""
    opened = open_page(html, **options)
    opened.until(READY)
    return opened


def shown(opened: Opened) -> list[str]:
    """Plan ids of the table's rows that the page contains at present, from the first row on."""
    return [str(text) for text in opened.page.locator("table.rows tbody th").all_inner_texts()]


def count(opened: Opened) -> str:
    return str(opened.page.locator("#filters [role=status]").inner_text())


def fragment(opened: Opened) -> dict[str, list[str]]:
    return parse_qs(urlsplit(opened.page.url).fragment)


def head(opened: Opened, label: str) -> Any:
    return opened.page.locator("table.rows thead th").filter(has_text=label).first


def test_it_opens_without_an_error_or_a_request(open_page: OpenPage, html: str) -> None:
    opened = opened_report(open_page, html)
    assert count(opened) == f"{N} of {N} shown"
    assert shown(opened)[:3] == ["plan-0", "plan-1", "plan-2"], "in the order of numbers"
    assert len(shown(opened)) < 60, "only rows in sight are in the page"
    assert opened.page.locator("table.rows").get_attribute("aria-rowcount") == str(N + 1)
    assert (opened.errors, opened.requests) == ([], [])


def test_the_table_sorts(open_page: OpenPage, html: str) -> None:
    opened = opened_report(open_page, html)
    head(opened, "tilt").locator("button").click()
    head(opened, "tilt").locator("button").click()
    assert head(opened, "tilt").get_attribute("aria-sort") == "descending"
    assert fragment(opened)["sort"] == ["-tilt"]
    assert {int(plan.removeprefix("plan-")) % 10 for plan in shown(opened)[:24]} == {3, 7}
    head(opened, "plan").locator("button").click()
    assert head(opened, "tilt").get_attribute("aria-sort") is None
    assert shown(opened)[:2] == ["plan-0", "plan-1"]


def test_the_table_filters_and_the_address_keeps_it(open_page: OpenPage, html: str) -> None:
    opened = opened_report(open_page, html)
    page = opened.page
    page.get_by_label("unstable").check()
    assert count(opened) == f"24 of {N} shown"
    page.get_by_label("reason", exact=True).select_option("drop")
    assert count(opened) == f"12 of {N} shown"
    page.get_by_text("Ranges of numbers").click()
    page.get_by_label("boxes: min", exact=True).fill("12")
    opened.until(f"document.querySelector('#filters [role=status]').textContent === '4 of {N} shown'")
    assert fragment(opened) == {"verdict": ["unstable"], "reason": ["drop"], "boxes.min": ["12"]}
    page.reload()
    opened.until(READY)
    assert count(opened) == f"4 of {N} shown"
    assert page.get_by_label("boxes: min", exact=True).input_value() == "12"
    assert page.get_by_label("unstable").is_checked()
    page.get_by_role("button", name="Clear filters").click()
    assert (count(opened), fragment(opened)) == (f"{N} of {N} shown", {})
    page.get_by_label("Search").fill("PLAN-11")
    opened.until(f"document.querySelector('#filters [role=status]').textContent === '11 of {N} shown'")
    assert shown(opened) == ["plan-11", *(f"plan-11{k}" for k in range(10))]


def test_links_of_charts_filter(open_page: OpenPage, html: str) -> None:
    opened = opened_report(open_page, html)
    opened.page.locator("table.verdicts a", has_text="tilt").click()
    opened.until(f"document.querySelector('#filters [role=status]').textContent === '12 of {N} shown'")
    assert fragment(opened)["reason"] == ["tilt"]


def test_a_click_shows_the_plan_in_3d_and_its_boxes(open_page: OpenPage, html: str) -> None:
    opened = opened_report(open_page, html, fragment="verdict=unstable")
    opened.page.locator("table.rows tbody tr[data-at='0']").click()
    opened.until("document.querySelectorAll('.card3d canvas').length === 1")
    opened.settled()
    words = opened.page.locator("#plan").inner_text()
    assert "unstable, drop. Box 11 (jam) failed first at 3.20 s." in words
    assert "petmjx show plan-3" in words
    assert fragment(opened)["plan"] == ["plan-3"]
    picture = opened.pixels(".card3d canvas")
    _, counts = np.unique(picture.reshape(-1, 3) // 32, axis=0, return_counts=True)
    assert (counts > 40).sum() > 8, "boxes of several articles, lit from one side"
    opened.page.locator("table.boxes tbody tr").nth(11).click()
    status = opened.page.locator(".card3d [role=status]").inner_text()
    assert status.startswith("Box 11 – failed first: jam (item jam-11), 400 × 300 × 200 mm")
    assert "dropped at 3.60 s" in status
    opened.page.get_by_label("Colour by").select_option("moved")
    opened.settled()
    assert (np.abs(opened.pixels(".card3d canvas").astype(int) - picture).max(axis=2) > 24).mean() > 0.02
    opened.page.get_by_label("Colour by").select_option("force")
    forces = [float(text) for text in opened.page.locator("table.boxes tbody tr td:nth-child(7)").all_inner_texts()]
    scale = re.fullmatch(r"0 N\s*([\d,.]+) N", opened.page.locator(".card3d .legend").inner_text())
    assert scale is not None
    assert float(scale[1].replace(",", "")) == pytest.approx(max(forces), rel=0.005), "the largest force ends the scale"
    opened.page.reload()
    opened.until("document.querySelectorAll('.card3d canvas').length === 1")
    opened.page.get_by_role("button", name="Close").click()
    assert "plan" not in fragment(opened)
    assert (opened.errors, opened.requests) == ([], [])


def test_a_click_on_a_box_names_it(open_page: OpenPage, html: str) -> None:
    opened = opened_report(open_page, html, fragment="plan=plan-0", width=1280)
    opened.until("document.querySelectorAll('.card3d canvas').length === 1")
    opened.settled()
    opened.page.locator(".card3d canvas").click()  # a click in the middle of the picture
    assert opened.page.locator(".card3d [role=status]").inner_text().startswith("Box ")
    assert opened.page.locator("table.boxes tr[aria-current]").count() == 1


def test_keys_move_and_open(open_page: OpenPage, html: str) -> None:
    opened = opened_report(open_page, html)
    keys = opened.page.keyboard
    opened.page.locator("table.rows tbody tr[data-at='0']").focus()
    for _ in range(3):
        keys.press("ArrowDown")
    keys.press("Enter")
    assert fragment(opened)["plan"] == ["plan-3"]
    keys.press("End")
    assert opened.page.evaluate("document.activeElement.getAttribute('aria-rowindex')") == str(N + 1)
    assert shown(opened)[-1] == f"plan-{N - 1}"
    keys.press("Home")
    assert opened.page.evaluate("document.activeElement.dataset.at") == "0"


def test_markup_is_text(open_page: OpenPage, tmp_path: Path) -> None:
    plans = write_plans(tmp_path / "plans.json", [MARKUP, "🧀" * 40, "x" * 200, "two\nlines, \u202eand more", "-5"])
    named = [replace(plan, articles=(MARKUP + "y" * 150,) * plan.n_boxes) for plan in plans]
    run = write_run(tmp_path / ("z" * 120), named, [fallen(plan) for plan in named])
    opened = opened_report(open_page, report_page(open_runs([run], [tmp_path])), fragment=urlencode({"plan": MARKUP}))
    assert MARKUP in shown(opened)
    assert opened.page.locator("#plan h3").inner_text() == MARKUP
    assert opened.page.locator("img").count() == 0
    assert f"petmjx show '{MARKUP}'" in opened.page.locator("#plan").inner_text()
    assert "two\\nlines, \\u202eand more" in shown(opened)
    dashed = opened_report(open_page, report_page(open_runs([run], [tmp_path])), fragment="plan=-5")
    assert "petmjx show --html story.html -- -5 " in dashed.page.locator("#plan").inner_text()
    phone = opened_report(open_page, report_page(open_runs([run], [tmp_path])), width=400)
    assert phone.page.evaluate("document.documentElement.scrollWidth") <= 400
    assert (opened.errors, opened.requests) == ([], [])


def test_two_runs_stand_side_by_side(open_page: OpenPage, run: Path, tmp_path: Path) -> None:
    plans = list(open_runs([run])[0].plan_files.plans.values())
    other = write_run(tmp_path / "other", plans, [standing(plan) for plan in plans])
    opened = opened_report(open_page, report_page(open_runs([run, other])))
    opened.page.get_by_role("link", name="plan-3", exact=True).click()
    opened.until("document.querySelectorAll('.card3d canvas').length === 2")
    words = opened.page.locator("#plan").inner_text()
    assert "run: unstable, drop." in words
    assert "other: stable." in words
    opened.page.get_by_label("verdicts that differ").check()
    assert count(opened) == f"{2 * 36} of {2 * N} shown"
    assert (opened.errors, opened.requests) == ([], [])


def test_what_was_recorded_is_played(open_page: OpenPage, tmp_path: Path) -> None:
    import petmjx

    scored_here = petmjx.score(limit=6, engine="mujoco", record="failed", out=tmp_path / "run")
    falls = scored_here.worlds.query("verdict == 'unstable'")["plan_id"].iloc[0]
    opened = opened_report(open_page, report_page(open_runs([tmp_path / "run"])), fragment=f"plan={falls}")
    opened.until("document.querySelectorAll('.replay').length === 1")
    opened.settled()
    before = opened.pixels(".card3d canvas").astype(int)
    opened.page.get_by_label("Time").fill("300")
    opened.until("/^0\\.\\d\\d of \\d\\.\\d\\d s/.test(document.querySelector('.replay span').textContent)")
    opened.settled()
    assert (np.abs(opened.pixels(".card3d canvas").astype(int) - before).max(axis=2) > 24).mean() > 0.02
    assert (opened.errors, opened.requests) == ([], [])


@pytest.mark.parametrize("dark", [False, True])
def test_it_fits_a_phone(open_page: OpenPage, html: str, dark: bool) -> None:
    opened = opened_report(open_page, html, width=400, dark=dark, fragment="plan=plan-3")
    opened.until("document.querySelectorAll('.card3d canvas').length === 1")
    assert opened.page.evaluate("document.documentElement.scrollWidth") <= 400
    opened.page.locator("table.rows tbody tr[data-at='1']").click()
    # the plan is visible: it is near the top of the window, not below it
    opened.until("Math.abs(document.querySelector('#plan').getBoundingClientRect().top) < 40")
    background = opened.page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (background == "rgb(255, 255, 255)") is not dark


def test_without_webgl_the_numbers_are_there(open_page: OpenPage, html: str) -> None:
    opened = opened_report(open_page, html, webgl=False, fragment="plan=plan-3")
    opened.until("document.querySelectorAll('table.boxes tbody tr').length === 12")
    assert "no WebGL 2" in opened.page.locator("#plan").inner_text()
    opened.page.locator("table.boxes tbody tr").nth(0).click()
    assert opened.errors == []


def test_without_scripts_the_charts_are_there(open_page: OpenPage, html: str) -> None:
    opened = open_page(html, scripts=False)
    assert opened.page.locator("figure svg").count() > 8
    assert "need JavaScript" in opened.page.locator("noscript").inner_text()


def test_odd_runs_open(open_page: OpenPage, tmp_path: Path) -> None:
    plans = write_plans(tmp_path / "plans.json", ["a", "b"], n_boxes=3)
    empty = write_run(tmp_path / "empty", [], [])
    bad = write_run(tmp_path / "bad", plans, [invalid(plan) for plan in plans])
    opened = opened_report(open_page, report_page(open_runs([empty])))
    assert count(opened) == "0 of 0 shown"
    assert opened.errors == []
    opened = opened_report(open_page, report_page(open_runs([bad])), fragment="plan=b")
    opened.until("document.querySelectorAll('table.boxes tbody tr').length === 2")
    assert "invalid, failed." in opened.page.locator("#plan").inner_text()
    assert opened.errors == []
    (tmp_path / "plans.json").unlink()
    opened = opened_report(open_page, report_page(open_runs([bad])), fragment="plan=b")
    opened.until("document.querySelector('#plan .hint')?.textContent.includes('no 3D picture')")
    assert opened.errors == []
