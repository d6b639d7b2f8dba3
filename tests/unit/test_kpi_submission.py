"""Tests of submissions to BED-BPP's leaderboard: their names, their files, and refused input."""

from __future__ import annotations

import datetime
import json
from pathlib import Path
from typing import Any

import pytest
from support.command_line import run, write
from support.plan_files import order_for, placement, tower

import petmjx
from petmjx.analysis.kpi_submission import parse_name
from petmjx.plans.order_reader import read_orders

pytestmark = pytest.mark.usefixtures("in_tmp_path")


def test_names_of_submissions() -> None:
    day = datetime.date(2026, 2, 3)
    for text, name, choice in (
        ("doe_layers_offline3dbp", "2026-02-03_doe_layers_offline3dbp.json", None),
        ("2022-11-25_kagerer_o3dbpp-pct_O3dbp.json", "2022-11-25_kagerer_o3dbpp-pct_O3dbp.json", 1),
        ("Núñez_v2.1_O3DBP-3-2", "2026-02-03_Núñez_v2.1_O3DBP-3-2.json", 2),
    ):
        submission = parse_name(text, lambda: day)
        assert submission.file_name == name
        assert submission.choice == choice


@pytest.mark.parametrize(
    "text",
    [
        *("", "doe", "a_b_c_d_e", "2026-13-01_doe_x_o3dbp", "doe__o3dbp", "../doe_x_o3dbp", "d/e_x_o3dbp"),
        *("doe_x_3dbp", "doe_x_o3dbp-2-3", "doe_x_o3dbp-0-0", "doe_x y_o3dbp", "-doe_x_o3dbp", "26-1-1_doe_x_o3dbp"),
    ],
)
def test_names_that_are_none(text: str) -> None:
    with pytest.raises(petmjx.InputError, match=r"^leaderboard name"):
        parse_name(text)


def submit(plans: dict[str, Any], orders: dict[str, Any], task: str = "offline3dbp") -> int:
    write(Path("plans.json"), plans)
    write(Path("orders.json"), orders)
    name = f"2026-02-03_doe_x_{task}"
    command = ("kpis", "plans.json", "--orders", "orders.json", "--leaderboard", name, "-o", "s")
    if (Path("s") / f"{name}.json").exists():
        assert run(*command) == 2  # an existing file is replaced only on request
    return run(*command, "--overwrite")


def test_a_submission_is_written_as_the_orders_have_it(real_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plans = json.loads((real_data / "packing_plan_5-bed-bpp.json").read_text())
    stripped = json.loads(json.dumps(plans))
    for entry in (item for plan in stripped.values() for item in plan):
        del entry["item"]["product_group"]
    orders = json.loads((real_data / "5_bed-bpp.json").read_text())
    assert submit(dict(reversed(stripped.items())), orders) == 0
    file = Path("s/2026-02-03_doe_x_offline3dbp.json")
    assert capsys.readouterr().out.endswith(f"submission in {file}\n")
    written = json.loads(file.read_text())
    assert list(written) == list(orders)
    assert written == plans


A_OTHER = [placement(id="7", article="jam")]


FAULTY = {
    "order B has no plan": ({"A": tower(2)}, {"A": order_for(tower(2)), "B": order_for(tower(1))}),
    "plan B has no order": ({"A": tower(2), "B": tower(1)}, {"A": order_for(tower(2))}),
    "plan A, box 1: item donut-00101843 (00101843) occurs more often than it was ordered": (
        {"A": tower(2)},
        {"A": order_for(tower(1))},
    ),
    "plan A, box 0: item jam (7) was not ordered": ({"A": A_OTHER}, {"A": order_for(tower(1))}),
    "plan A, box 0: size or weight differs from those of donut-00101843 in the order": (
        {"A": [placement(size=(600, 400, 221))]},
        {"A": order_for(tower(1))},
    ),
    "plan A, box 0: coordinates must be whole millimetres, got [0.5, 0, 0]": (
        {"A": [placement((0.5, 0, 0))]},
        {"A": order_for(tower(1))},
    ),
    "plan A, box 0: begins outside the euro-pallet, at [0, -1, 0]": (
        {"A": [placement((0, -1, 0))]},
        {"A": order_for(tower(1))},
    ),
    "1 plan or order cannot be used": ({"A": tower(1), "B": []}, {"A": order_for(tower(1))}),
}


@pytest.mark.parametrize("fault", FAULTY)
def test_what_is_no_submission(fault: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert submit(*FAULTY[fault]) == 2
    assert f"petmjx: no submission, 1 fault: {fault}\n" in capsys.readouterr().err
    assert not list(Path("s").glob("2026*"))


def test_the_sequence_of_online_tasks(capsys: pytest.CaptureFixture[str]) -> None:
    items = [placement((0, 0, 220 * n), id=name, article=name, sequence=n + 1) for n, name in enumerate("abcd")]
    orders = {"A": order_for(items)}

    def packed(names: str) -> dict[str, Any]:
        by_name = {entry["item"]["id"]: entry for entry in items}
        return {"A": [{**by_name[name], "flb_coordinates": [0, 0, 220 * n]} for n, name in enumerate(names)]}

    for names, task, code in (
        ("abcd", "o3dbp", 0),
        ("acd", "o3dbp", 0),  # box b was left out
        ("acbd", "o3dbp", 2),
        ("acbd", "o3dbp-3-2", 0),
        ("cabd", "o3dbp-3-2", 2),
        ("dcba", "offline3dbp", 0),
    ):
        assert submit(packed(names), orders, task) == code, (names, task)
    assert "box 1: is number 2 of the waiting items, but the task lets the packer take the next item" in (
        capsys.readouterr().err
    )


def test_orders_are_numbered_as_they_were(real_data: Path) -> None:
    """The items of an order keep their numbers. The check of submissions compares these numbers with the sequence of
    items."""
    for _, order in read_orders(real_data / "5_bed-bpp.json"):
        assert order.numbers == tuple(range(1, len(order.items) + 1))


def test_boxes_without_names_are_submitted_as_the_items_that_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    other = placement((0, 0, 440), (300, 200, 100), sequence=3, article="jam", id="7")
    plan = [*tower(2), other]
    bare = [json.loads(json.dumps(entry)) for entry in plan]
    for entry in bare:
        entry["item"] |= {"article": "", "id": ""}
    assert submit({"A": bare}, {"A": order_for(plan)}) == 0
    (file,) = Path("s").glob("*_doe_x_offline3dbp.json")
    items = [entry["item"] for entry in json.loads(file.read_text())["A"]]
    assert [(item["article"], item["id"]) for item in items] == [("donut-00101843", "00101843")] * 2 + [("jam", "7")]
    capsys.readouterr()
    bare[2]["item"]["weight/kg"] = 9
    assert submit({"A": bare}, {"A": order_for(plan)}) == 2
    assert "box 2: item was not ordered" in capsys.readouterr().err
