"""Plans as tables: every file format holds the same plans, and damage makes only the damaged plans unusable."""

from __future__ import annotations

import gzip
import io
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.command_line import write
from support.plan_files import tower

import petmjx
from petmjx.plans.plan import Plan
from petmjx.plans.plan_reader import load_plans
from petmjx.plans.plan_set import PlanSet
from petmjx.results.plan_digests import plan_digest

pytestmark = pytest.mark.usefixtures("in_tmp_path")

HEADER = "plan_id,sequence,article,length_mm,width_mm,height_mm,weight_kg,orientation,x_mm,y_mm,z_mm"
FORMS = ("plans.json", "plans.json.gz", "plans.csv", "plans.csv.gz", "plans.parquet")


def row(plan_id: str = "A", sequence: object = 1, **changes: object) -> str:
    values = {
        "plan_id": plan_id,
        "sequence": sequence,
        "article": "carton",
        "length_mm": 400,
        "width_mm": 300,
        "height_mm": 200,
        "weight_kg": 5,
        "orientation": 0,
        "x_mm": 0,
        "y_mm": 0,
        "z_mm": 0,
    } | changes
    return ",".join(map(str, values.values()))


def read(*rows: str | bytes, name: str = "plans.csv", header: str = HEADER, **options: Any) -> PlanSet:
    lines = [line if isinstance(line, bytes) else line.encode() for line in (header, *rows)]
    Path(name).write_bytes(b"\n".join(lines) + b"\n")
    return load_plans(name, **options)


def frame_of(**changes: Any) -> pd.DataFrame:
    frame = pd.read_csv(io.StringIO("\n".join([HEADER, row("A"), row("A", 2, z_mm=200), row("B")])))
    for name, value in changes.items():
        frame[name] = value
    return frame


def messages(plan_set: PlanSet) -> list[str]:
    return [str(skipped) for skipped in plan_set.skipped]


def ids(plan_set: PlanSet) -> list[str]:
    return [plan.plan_id for plan in plan_set]


def same(a: Plan, b: Plan) -> bool:
    """Whether two plans are equal: everything that affects results to the last bit, and all other data of the file."""
    assert plan_digest(a) == plan_digest(b)
    assert (a.turned == b.turned).all()
    return (a.product_groups or ("",) * a.n_boxes) == (b.product_groups or ("",) * b.n_boxes)


names = st.text(st.characters(exclude_categories=("Cs",), exclude_characters="\0"), max_size=20)
sizes = st.one_of(st.integers(1, 4000), st.floats(1, 4000))
coordinates = st.one_of(st.integers(-20_000, 20_000), st.floats(-20_000, 20_000))


@st.composite
def plan_lists(draw: st.DrawFn) -> list[Plan]:
    plan_ids = draw(st.lists(names.filter(bool), min_size=1, max_size=4, unique=True))
    with_groups, turned, numbered, like_others = (draw(st.booleans()) for _ in range(4))
    plans = []
    for plan_id in plan_ids:
        n = draw(st.integers(1, 4))
        columns: dict[str, Any] = {
            "article": draw(st.lists(names, min_size=n, max_size=n)),
            "item_id": draw(st.lists(names, min_size=n, max_size=n)),
        }
        if with_groups:
            columns["product_group"] = draw(st.lists(names, min_size=n, max_size=n))
        if turned:
            columns["orientation"] = draw(st.lists(st.integers(0, 1), min_size=n, max_size=n))
        if numbered:
            columns["order_sequence"] = draw(st.lists(st.integers(-(2**63), 2**63 - 1), min_size=n, max_size=n))
        if like_others:
            columns["material"] = draw(st.lists(names, min_size=n, max_size=n))
            for side in ("length", "width", "height"):
                columns[f"com_{side}_mm"] = draw(st.lists(st.floats(-0.49, 0.49), min_size=n, max_size=n))
        arrays = {
            "size_mm": draw(st.lists(st.tuples(sizes, sizes, sizes), min_size=n, max_size=n)),
            "corner_mm": draw(st.lists(st.tuples(coordinates, coordinates, coordinates), min_size=n, max_size=n)),
            "mass_kg": draw(st.lists(st.floats(0.001, 10_000), min_size=n, max_size=n)),
        }
        plans.append(Plan.from_boxes(plan_id, **arrays, **columns))
    return plans


@pytest.mark.filterwarnings("ignore::petmjx.PlanWarning")  # plans of random numbers cause all kinds of notes
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(plan_lists(), st.permutations(FORMS))
def test_no_form_loses_anything(plans: list[Plan], forms: list[str]) -> None:
    """Plans are converted from each format to the next, and through a data frame."""
    plan_set = PlanSet(plans)
    for form in forms:
        petmjx.save_plans(plan_set.plans, form)
        plan_set = load_plans(form)
        assert not plan_set.skipped
        assert all(map(same, plan_set, plans))
    again = load_plans(plan_set.to_frame())
    assert ids(again) == ids(plan_set) == [plan.plan_id for plan in plans]
    assert all(map(same, again, plans))


def test_the_real_plans_go_through_all_forms(real_data: Path) -> None:
    for file in sorted(real_data.glob("*plan*.json")):
        petmjx.save_plans(load_plans(file), "a.csv")
        petmjx.save_plans(load_plans("a.csv"), "b.parquet")
        petmjx.save_plans(load_plans("b.parquet"), "c.json")
        assert json.loads(Path("c.json").read_text()) == json.loads(file.read_text())


def test_files_of_all_forms_in_a_folder() -> None:
    write(Path("a.json"), {"J": tower(2)})
    petmjx.save_plans([load_plans("a.json").plans[0]], "b.csv.gz")
    frame = load_plans("a.json")
    for name, form in (("C", "c.csv"), ("P", "p.parquet"), ("Z", "z.json.gz")):
        petmjx.save_plans([Plan.from_boxes(name, frame.to_frame())], form)
    plan_set = load_plans(".")
    assert ids(plan_set) == ["J", "C", "P", "Z"]
    assert messages(plan_set) == ["b.csv.gz: plan J: repeated plan id, first used in a.json"]


# The packing order.


def test_rows_come_in_any_order() -> None:
    plan_set = read(row("B", 2, z_mm=200), row("A", 0), row("B", 1), row("A", 1, z_mm=200, article="top"))
    assert ids(plan_set) == ["B", "A"]
    assert [plan.corner_mm[:, 2].tolist() for plan in plan_set] == [[0, 200], [0, 200]]
    assert plan_set.plans[1].articles == ("carton", "top")
    assert plan_set.notes == []


def test_a_gap_is_told_and_a_duplicate_refused() -> None:
    """Steps of 10 are no gaps."""
    plan_set = read(
        *(row("A", 1), row("A", 3), row("B", 2), row("C", 7), row("C", 8), row("C", 7), row("D", 20, z_mm=200)),
        row("D", 10),
    )
    assert ids(plan_set) == ["A", "B", "D"]
    assert plan_set.notes == ["plans.csv: sequence has gaps in 2 plans (A, B); are rows missing?"]
    assert messages(plan_set) == ["plans.csv: plan C, rows 5 and 7: sequence 7 occurs twice"]


def test_orientation_swaps_length_and_width() -> None:
    (plan,) = read(row(orientation=1))
    assert plan.size_mm.tolist() == [[300, 400, 200]]
    assert plan.item_size_mm.tolist() == [[400, 300, 200]]
    header, line = HEADER.replace(",orientation", ""), row(orientation=1).replace(",1,0,0,0", ",0,0,0")
    (plan,) = read(line, header=header)
    assert plan.size_mm.tolist() == [[400, 300, 200]]
    assert plan.orientation is None


# Tables that are refused.

FAULTS = [
    ({"weight_kg": -1}, "weight_kg must be > 0, got -1"),
    ({"weight_kg": "six"}, 'weight_kg must be a number, got "six"'),
    ({"weight_kg": "1_0"}, 'weight_kg must be a number, got "1_0"'),
    ({"length_mm": "٤"}, 'length_mm must be a number, got "\\u0664"'),
    ({"sequence": "1_0"}, 'sequence must be an integer, got "1_0"'),
    ({"length_mm": 0.6}, "length_mm must be from 1 to 4000 (millimetres), got 0.6; in metres? then give units m"),
    ({"height_mm": "nan"}, "height_mm must be finite, got NaN"),
    ({"width_mm": "inf"}, "width_mm must be finite, got Infinity"),
    ({"width_mm": "9" * 400}, "width_mm must be finite, got Infinity"),
    ({"width_mm": ""}, "width_mm is missing"),
    ({"width_mm": "", "z_mm": " "}, "width_mm and z_mm are missing"),
    ({"orientation": 2}, "orientation must be 0 or 1, got 2"),
    ({"orientation": ""}, "orientation is missing"),
    ({"z_mm": 99999}, "z_mm must be from -20000 to 20000 (millimetres), got 99999"),
    ({"sequence": 1.5}, "sequence must be an integer, got 1.5"),
    ({"sequence": "first"}, 'sequence must be an integer, got "first"'),
    ({"sequence": 2**64}, "sequence is too large, got 18446744073709551616"),
    ({"article": "x" * 1001}, "article must have at most 1,000 characters, got 1,001"),
]


@pytest.mark.parametrize(("changes", "fault"), FAULTS, ids=[fault for _, fault in FAULTS])
def test_a_bad_row_costs_its_plan_alone(changes: dict[str, Any], fault: str) -> None:
    plan_set = read(row("good"), row("A", 1), row("A", **{"sequence": 2, **changes}), row("last"))
    assert messages(plan_set) == [f"plans.csv: plan A, row 4: {fault}"]
    assert ids(plan_set) == ["good", "last"]
    with pytest.raises(petmjx.InputError, match="plan A, row 4: "):
        load_plans("plans.csv", strict=True)


def test_all_that_is_missing_in_a_plan_is_named_at_once() -> None:
    plan_set = read(row(weight_kg=""), row(sequence=2, weight_kg="", x_mm=""), row("B"))
    assert messages(plan_set) == ["plans.csv: plan A: fields are missing: weight_kg in row 2 and 1 more, x_mm in row 3"]
    plans = {"A": tower(3)}
    for placement, field in ((0, "weight/kg"), (2, "weight/kg"), (2, "sequence")):
        del plans["A"][placement]["item"][field]
    del plans["A"][2]["orientation"]
    plan_set = load_plans(write(Path("plans.json"), plans))
    assert messages(plan_set) == [
        "plans.json: plan A: fields are missing: weight/kg in placement 0 and 1 more, sequence in placement 2, "
        "orientation in placement 2"
    ]


def test_all_columns_that_are_missing_are_named_at_once() -> None:
    plan_set = read("A,1", header="plan_id,order")
    assert messages(plan_set) == [
        "plans.csv: columns sequence, article, length_mm, width_mm, height_mm, weight_kg, x_mm, y_mm and z_mm are "
        "missing; there are: plan_id, order"
    ]
    frame = load_plans(write(Path("a.json"), {"A": tower(2)})).to_frame()
    with pytest.raises(petmjx.InputError, match=r"^data frame: columns article and z_mm are missing; there are: plan_"):
        load_plans(frame.drop(columns=["z_mm", "article"]))


def test_fields_that_nobody_reads_are_named_once() -> None:
    plans = tower(3)
    plans[0]["item"] |= {"colour": "red", "friction": 0.3}
    plans[1] |= {"note": "\x1b[31m"}
    plans[1]["item"]["colour"] = "blue"
    write(Path("a.json"), {"A": plans})
    read(row("B") + ",0.4", header=f"{HEADER},fragile", name="b.csv")
    note = (
        "fields of plans that petmjx does not read: item.colour (2 placements), item.friction (1 placement), "
        "note (1 placement) and fragile (1 placement)"
    )
    assert load_plans(["a.json", "b.csv"]).notes == [note]
    results = petmjx.score(["a.json", "b.csv"], engine="mujoco", check="static", duration_s=0.01)
    assert note in results.info["warnings"]


def test_spellings_and_marks_of_other_programs() -> None:
    bedbpp = HEADER.replace("_mm,w", "/mm,w").replace("height_mm", "height/mm").replace("weight_kg", " Weight/kg ")
    assert ids(read(row(), header=bedbpp)) == ["A"]
    assert ids(read(row(), header="\ufeff" + HEADER)) == ["A"]
    decimals = row(weight_kg="5.25").replace(",", ";").replace(".", ",")
    (plan,) = read(decimals, header=HEADER.replace(",", ";"))
    assert plan.mass_kg.tolist() == [5.25]
    assert ids(read(row().replace(",", "\t"), header=HEADER.replace(",", "\t"), name="a.tsv")) == ["A"]
    for end in ("\r\n", "\r"):
        Path("plans.csv").write_bytes(end.join((HEADER, row(), row(sequence=2), "")).encode())
        assert load_plans("plans.csv").plans[0].n_boxes == 2


def test_large_numbers_beside_bad_ones() -> None:
    largest = 2**63 - 1
    plan_set = read(row("A", largest), row("B", "x"), row("C", 2**63), row("D", "3.0"), row("E", 2**60 + 1))
    assert {plan.plan_id: plan.sequence.tolist() for plan in plan_set} == {"D": [3], "E": [2**60 + 1]} | (
        {"A": [largest]} if len(plan_set) == 3 else {}
    )
    frame = frame_of(sequence=np.array([2**63 - 1, 2**63, 5], dtype="uint64"), plan_id=list("ABC"))
    plan_set = load_plans(frame)
    assert {plan.plan_id: plan.sequence.tolist() for plan in plan_set} == {"A": [largest], "C": [5]}
    assert messages(plan_set) == ["data frame: plan B, row 1: sequence is too large, got 9223372036854775808"]


def test_a_limit_keeps_the_notes_of_what_was_taken() -> None:
    plan_set = read(row("A", 5), row("B"), limit=1)
    assert ids(plan_set) == ["A"]
    assert plan_set.notes == ["plans.csv: sequence has gaps in 1 plan (A); are rows missing?"]


def test_ids_of_any_kind() -> None:
    odd = ["00100408", " a ", "<b>&amp;", "😀", 'say ""no""', "a, b", "line\nbreak", "=1+1"]
    plan_set = read(*[row(f'"{name}"') for name in odd])
    assert ids(plan_set) == [name.replace('""', '"') for name in odd]


def test_damaged_csv() -> None:
    plan_set = read(row("A"), row("B") + ",7", row("C"), "C,2", row("D"), b"E,1,\xff,1,1,1,1,0,0,0,0", b"\xff,1", "")
    assert ids(plan_set) == ["A", "D"]
    assert messages(plan_set) == [
        'plans.csv: plan E, row 7: article is not UTF-8 text ("ÿ" in Windows-1252): save the file as UTF-8',
        'plans.csv: plan \\xff, row 8: plan_id is not UTF-8 text ("ÿ" in Windows-1252): save the file as UTF-8',
        "plans.csv: plan B, row 3: has 12 fields instead of 11",
        "plans.csv: plan C, row 5: has 2 fields instead of 11",
    ]
    plan_set = read(row("A"), row("B").replace("carton", '"carton'), row("C"), row("D", weight_kg=0))
    assert ids(plan_set) == ["A", "C"]
    assert messages(plan_set) == [
        "plans.csv: plan B, row 3: has an unclosed quotation mark",
        "plans.csv: plan D, row 5: weight_kg must be > 0, got 0",
    ]
    plan_set = read(row("A"), row("", weight_kg=0), row("B"))
    assert messages(plan_set) == ["plans.csv: row 3: plan_id is missing"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("\n\n", "the file is empty"),
        (HEADER, "holds no plan"),
        ("x" * 200_000, "not CSV: field larger than field limit"),
        (f"{HEADER}\0\n{row()}", "column z_mm is missing"),
        (f"{HEADER},z_mm\n{row()},1", "column z_mm occurs twice"),
        (f"{HEADER},length/mm\n{row()},1", "column length_mm occurs twice"),
        ('{"A": []}\n1', "is JSON, but is read as JSON only if its name ends in .json"),
    ],
)
def test_files_of_which_nothing_can_be_used(text: str, message: str) -> None:
    Path("plans.csv").write_text(text)
    (line,) = messages(load_plans("plans.csv"))
    assert line.startswith(f"plans.csv: {message}")


def test_files_that_end_too_early() -> None:
    text = "\n".join([HEADER, *(row(f"P{i // 40}", i % 40 + 1, article=f"c{i}") for i in range(8000))]) + "\n"
    packed = gzip.compress(text.encode())
    Path("plans.csv.gz").write_bytes(packed[: len(packed) // 2])
    plan_set = load_plans("plans.csv.gz")
    first, last = messages(plan_set)
    assert first == "plans.csv.gz: the gzip data is cut off; the plans before the cut are read"
    assert last == f"plans.csv.gz: plan P{len(plan_set)}: the file ends inside this plan; truncated?"
    assert all(plan.n_boxes == 40 for plan in plan_set)
    for cut in (f"{row('A')}\n{row('B')}\nB,2,car", f"{row('A')}\n{row('B')}\nB"):
        Path("plans.csv").write_text(f"{HEADER}\n{cut}")
        plan_set = load_plans("plans.csv")
        assert ids(plan_set) == ["A"]
        assert messages(plan_set) == ["plans.csv: plan B: the file ends inside this plan; truncated?"]


@pytest.mark.parametrize("end", ["\n", "\nB,2,car", ""])
def test_nul_bytes_at_the_end_are_named(end: str) -> None:
    Path("plans.csv").write_text(f"{HEADER}\n{row('A')}\n{row('B')}{end}" + 5 * "\0")
    plan_set = load_plans("plans.csv")
    assert ids(plan_set) == ["A"]
    assert messages(plan_set) == ["plans.csv: plan B: the file ends in 5 NUL bytes; was this plan written whole?"]
    Path("boxes.csv").write_text(f"Lg;W;H;X;Y;Z\n400;300;200;0;0;0{end}" + 5 * "\0")
    assert messages(load_plans("boxes.csv")) == ["boxes.csv: ends in 5 NUL bytes; was the file written whole?"]


def test_damaged_parquet() -> None:
    petmjx.save_plans(
        [Plan.from_boxes("A", size_mm=[[100, 100, 100]], corner_mm=[[0, 0, 0]], mass_kg=[1])], "a.parquet"
    )
    data = Path("a.parquet").read_bytes()
    for damaged in (data[: len(data) // 2], data[:4], b"", b"PAR1" + bytes(500)):
        Path("a.parquet").write_bytes(damaged)
        assert messages(load_plans("a.parquet")) == ["a.parquet: is not a whole Parquet file"]
    Path("named.json").write_bytes(data)
    assert ids(load_plans("named.json")) == ["A"]


@pytest.mark.filterwarnings("ignore::petmjx.PlanWarning")  # damaged numbers may look like other units
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_no_damage_ends_in_a_traceback(data: st.DataObject) -> None:
    text = bytearray("\n".join([HEADER, *(row(name, number) for name in "ABC" for number in (1, 2))]).encode())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text) - 1))
        text[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=4)) + data.draw(
            st.sampled_from([b"", b'"', b",", b"\n", b"\xff", b"nan", b"1e999", b"\r"])
        )
    Path("plans.csv").write_bytes(text)
    plan_set = load_plans("plans.csv")
    assert len(plan_set) + len(plan_set.skipped) > 0
    for plan in plan_set:
        assert np.isfinite(plan.size_mm).all()
        assert (plan.mass_kg > 0).all()


# Data frames.


def test_a_run_of_json_is_resumed_with_a_table() -> None:
    write(Path("plans.json"), {name: tower(2) for name in "AB"})
    petmjx.save_plans(load_plans("plans.json"), "plans.csv")
    petmjx.score("plans.json", engine="mujoco", check="static", duration_s=0.05, out="run")
    again = petmjx.score("plans.csv", engine="mujoco", check="static", duration_s=0.05, out="run", resume=True)
    assert again.info["counts"]["worlds"] == 2
    Path("plans.csv").write_text(Path("plans.csv").read_text().replace("6.296", "6.297"))
    with pytest.raises(petmjx.InputError, match="plan A differs"):
        petmjx.score("plans.csv", engine="mujoco", check="static", duration_s=0.05, out="run", resume=True)


def test_a_large_table_is_read_quickly(tmp_path: Path) -> None:
    """43,000 rows are read. The goal for 430,000 rows is 5 s on two idle cores; this machine may be busy."""
    n = 43_000
    frame = pd.DataFrame({"plan_id": np.arange(n) // 43, "sequence": np.arange(n) % 43 + 1, "article": "carton"})
    frame = frame.assign(length_mm=400, width_mm=300, height_mm=200, weight_kg=5.5, orientation=1, x_mm=0, y_mm=0)
    frame = frame.assign(z_mm=200 * (frame["sequence"] - 1))
    frame.to_csv("plans.csv", index=False)
    begin = time.process_time()
    assert len(load_plans("plans.csv")) == 1000
    assert time.process_time() - begin < 2.5
