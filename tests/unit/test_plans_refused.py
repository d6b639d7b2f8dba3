"""Plans that are refused: for each kind of bad input there is one line, and all other plans are read."""

from __future__ import annotations

import copy
import gzip
import json
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.command_line import write
from support.plan_files import placement, tower

from petmjx.common.errors import InputError
from petmjx.plans.plan_decoder import DecoderOptions, PlanError, parse_plan
from petmjx.plans.plan_reader import DEFAULT_MAX_BOXES, load_plans
from petmjx.plans.plan_validation import find_fault

pytestmark = pytest.mark.usefixtures("in_tmp_path")

MISSING = object()


def changed(path: list[Any], value: Any) -> list[dict[str, Any]]:
    plan = tower(9)
    target: Any = plan[7]
    for key in path[:-1]:
        target = target[key]
    if value is MISSING:
        del target[path[-1]]
    else:
        target[path[-1]] = value
    return plan


ITEM, CORNER = ["item"], ["flb_coordinates"]
FIELD_FAULTS = [
    ([*ITEM, "weight/kg"], -1, "weight/kg must be > 0, got -1"),
    ([*ITEM, "weight/kg"], 0, "weight/kg must be > 0, got 0"),
    ([*ITEM, "weight/kg"], True, "weight/kg must be a number, got true"),
    ([*ITEM, "weight/kg"], "6.2", 'weight/kg must be a number, got "6.2"'),
    ([*ITEM, "weight/kg"], None, "weight/kg must be a number, got null"),
    ([*ITEM, "weight/kg"], float("nan"), "weight/kg must be finite, got NaN"),
    ([*ITEM, "weight/kg"], 1e-9, "weight/kg must be from 0.001 to 10000 (kilograms), got 1e-09"),
    ([*ITEM, "length/mm"], float("inf"), "length/mm must be finite, got Infinity"),
    (
        [*ITEM, "length/mm"],
        0.6,
        "length/mm must be from 1 to 4000 (millimetres), got 0.6; in metres? then give units m",
    ),
    ([*ITEM, "width/mm"], 10**400, "width/mm must be finite, got an integer of more than 60 digits"),
    ([*ITEM, "width/mm"], [400], "width/mm must be a number, got a list"),
    ([*ITEM, "height/mm"], MISSING, "height/mm is missing"),
    ([*ITEM, "article"], 5, "article must be a string, got 5"),
    ([*ITEM, "article"], "\ud800", "article is not UTF-8 text"),
    ([*ITEM, "id"], MISSING, "id is missing"),
    ([*ITEM, "material"], 5, "material must be a string, got 5"),
    ([*ITEM, "material"], "x" * 1001, "material must have at most 1,000 characters, got 1,001"),
    ([*ITEM, "com_length/mm"], "5", 'com_length/mm must be a number, got "5"'),
    ([*ITEM, "com_width/mm"], float("nan"), "com_width/mm must be finite, got NaN"),
    (
        [*ITEM, "com_height/mm"],
        1e6,
        "com_height/mm must be inside the box, less than half of 220 from the middle, got 1000000.0",
    ),
    ([*ITEM, "id"], {}, "id must be a string, got an object"),
    ([*ITEM, "sequence"], 1.0, "sequence must be an integer, got 1.0"),
    ([*ITEM, "sequence"], True, "sequence must be an integer, got true"),
    ([*ITEM, "sequence"], 2**63, "sequence is too large, got 9223372036854775808"),
    (ITEM, MISSING, "item is missing"),
    (ITEM, [1], "item must be an object, got a list"),
    (["orientation"], 2, "orientation must be 0 or 1, got 2"),
    (["orientation"], True, "orientation must be 0 or 1, got true"),
    (["orientation"], 0.0, "orientation must be 0 or 1, got 0.0"),
    (["orientation"], MISSING, "orientation is missing"),
    (CORNER, MISSING, "flb_coordinates is missing"),
    (CORNER, [0, 0], "flb_coordinates must be 3 numbers, got 2"),
    (CORNER, [0, 0, 0, 0], "flb_coordinates must be 3 numbers, got 4"),
    (CORNER, {"a": 1, "b": 1, "c": 1}, "flb_coordinates must be a list of 3 numbers, got an object"),
    (CORNER, "000", 'flb_coordinates must be a list of 3 numbers, got "000"'),
    ([*CORNER, 1], float("-inf"), "flb_coordinates[1] must be finite, got -Infinity"),
    ([*ITEM, "height/mm"], 4000.5, "height/mm must be from 1 to 4000 (millimetres), got 4000.5"),
    (
        [*ITEM, "weight/kg"],
        1e5,
        "weight/kg must be from 0.001 to 10000 (kilograms), got 100000.0; in grams? then give units g",
    ),
    ([*CORNER, 2], False, "flb_coordinates[2] must be a number, got false"),
    ([*CORNER, 0], -1e300, "flb_coordinates[0] must be from -20000 to 20000 (millimetres), got -1e+300"),
]


@pytest.mark.parametrize(("path", "value", "message"), FIELD_FAULTS)
def test_a_bad_field_is_named_and_costs_only_its_plan(path: list[Any], value: Any, message: str) -> None:
    plans = {"good": tower(2), "00100408": changed(path, value), "last": tower(1)}
    file = write(Path("plans.json"), plans)
    plan_set = load_plans(file)
    line = f"plans.json: plan 00100408, placement 7: {message}"
    assert [plan.plan_id for plan in plan_set] == ["good", "last"]
    assert [(s.source, s.plan_id, s.message) for s in plan_set.skipped] == [("plans.json", "00100408", line)]
    with pytest.raises(InputError) as raised:
        load_plans(file, strict=True)
    assert str(raised.value) == line


PLAN_FAULTS: list[tuple[Any, str]] = [
    ([], "plan P: has no placement"),
    ({"a": 1}, "plan P: must be a list of placements, got an object"),
    ("x", 'plan P: must be a list of placements, got "x"'),
    (None, "plan P: must be a list of placements, got null"),
    ([[]], "plan P, placement 0: must be an object, got a list"),
    ([placement(), "x"], 'plan P, placement 1: must be an object, got "x"'),
    (
        tower(1) * (DEFAULT_MAX_BOXES + 1),
        f"plan P: has {DEFAULT_MAX_BOXES + 1} boxes, more than the largest capacity of {DEFAULT_MAX_BOXES}",
    ),
]


@pytest.mark.parametrize(("value", "message"), PLAN_FAULTS)
def test_a_bad_plan_is_named_and_costs_only_itself(value: Any, message: str) -> None:
    plan_set = load_plans(write(Path("plans.json"), {"A": tower(1), "P": value, "B": tower(1)}))
    assert [plan.plan_id for plan in plan_set] == ["A", "B"]
    assert [str(skipped) for skipped in plan_set.skipped] == [f"plans.json: {message}"]


@pytest.mark.parametrize(
    ("field", "message"),
    [('"flb_coordinates"', "flb_coordinates stands twice"), ('"weight/kg"', "item.weight/kg stands twice")],
)
def test_a_field_that_stands_twice_is_named(field: str, message: str) -> None:
    text = json.dumps({"good": tower(2), "odd": tower(2)})
    at = text.index(field, text.index('"odd"'))
    value = {'"flb_coordinates"': "[5000, 0, 500]", '"weight/kg"': "9.5"}[field]
    write(Path("plans.json"), f"{text[:at]}{field}: {value}, {text[at:]}")
    read = load_plans("plans.json")
    assert [plan.plan_id for plan in read.plans] == ["good"]
    assert [skipped.message for skipped in read.skipped] == [f"plans.json: plan odd, placement 0: {message}"]


def test_max_boxes_is_a_parameter() -> None:
    file = write(Path("plans.json"), {"A": tower(3), "B": tower(4)})
    assert [plan.plan_id for plan in load_plans(file, max_boxes=3)] == ["A"]
    assert len(load_plans(file, max_boxes=4)) == 2


def test_repeated_ids_within_and_across_files_keep_the_first_good_one() -> None:
    one, bad, two = json.dumps(tower(1)), "[]", json.dumps(tower(2))
    write(Path("a.json"), f'{{"A": {bad}, "A": {two}, "A": {one}}}')
    write(Path("b.json"), {"A": tower(1), "B": tower(1)})
    plan_set = load_plans(["a.json", "b.json"])
    assert [(plan.plan_id, plan.n_boxes) for plan in plan_set] == [("A", 2), ("B", 1)]
    assert [str(skipped) for skipped in plan_set.skipped] == [
        "a.json: plan A: has no placement",
        "a.json: plan A: repeated plan id, first used in this file",
        "b.json: plan A: repeated plan id, first used in a.json",
    ]


FILE_FAULTS = [
    (b"", "p.json: the file is empty"),
    (b" \n", "p.json: the file is empty"),
    (b"{}", "p.json: holds no plan"),
    (b"{", "p.json: not JSON at line 1, column 2 (the file ends too early; truncated?)"),
    (b"[]", "p.json: holds no box"),
    (b"[1, 2]", "p.json: has no list of boxes: petmjx looks for objects with places and sizes"),
    (b"3", "p.json: the top level must be an object of plan id → placements, got a number"),
    (b"hello", "p.json: not JSON at line 1, column 1 (expected {)"),
    (b"{\n  hello", "p.json: not JSON at line 2, column 3 (Expecting property name enclosed in double quotes)"),
    (b"\n\n{} x", "p.json: not JSON at line 3, column 4 (more text after its end)"),
    (b'{"boxes": [{"x": 0} {"x": 1}]}', "p.json: not JSON at line 1, column 21 (Expecting ',' delimiter)"),
    (b"{}\0\0", "p.json: ends in 2 NUL bytes; was the file written whole?"),
    (
        b'{"flb_coordinates": []}\0\0',
        "p.json: not JSON at line 1, column 24 (2 NUL bytes; was the file written whole?)",
    ),
    (bytes(range(256)) * 20, "p.json: not JSON at line 1, column 1 (1 NUL byte)"),
    (gzip.compress(b"{}", mtime=0)[:11], "p.json: the gzip data is cut off"),
    *(("{}".encode(encoding), "p.json: holds no plan") for encoding in ("utf-16", "utf-16-be", "utf-32", "utf-32-le")),
    ("{} \ud800".encode("utf-32-le", "surrogatepass"), "p.json: is damaged UTF-32 text (code point in surrogate"),
    (b'{"flb_coordinates": ' + b"[" * 200_000, "p.json: plan flb_coordinates: not JSON at line 1, column 21 (nested"),
    (b'{"A": ' + b"[" * 200_000, "p.json: not JSON (nested too deeply)"),
    (b"[" * 200_000, "p.json: not JSON (nested too deeply)"),
    (b'{"A": ' + b"9" * 5000 + b"}", "p.json: plan A: must be a list of placements, got Infinity"),
    (b'{"A\nB": [{}]}', "p.json: not JSON at line 1, column 4 (Invalid control character)"),
    (b'{"\\ud800": [{}]}', "p.json: plan \\ud800: the plan id is not UTF-8 text"),
    (b'{"": [{}]}', 'p.json: plan "": the plan id must be text and not empty'),
]


@pytest.mark.parametrize(("content", "message"), FILE_FAULTS)
def test_an_unusable_file_gives_one_line_and_the_others_are_read(content: bytes, message: str) -> None:
    Path("p.json").write_bytes(content)
    write(Path("q.json"), {"Q": tower(1)})
    plan_set = load_plans(["p.json", "q.json"])
    assert [plan.plan_id for plan in plan_set] == ["Q"]
    assert len(plan_set.skipped) == 1
    assert plan_set.skipped[0].message.startswith(message)
    assert "\n" not in plan_set.skipped[0].message
    json.dumps([plan_set.skipped[0].plan_id, plan_set.skipped[0].message]).encode()
    with pytest.raises(InputError, match=r"^p\.json: "):
        load_plans("p.json", strict=True)


def test_orders_are_told_from_plans() -> None:
    order = {"item_sequence": {"1": placement()["item"]}, "properties": {"target": "euro-pallet"}}
    plan_set = load_plans(write(Path("orders.json"), {"1": order, "2": order}))
    assert len(plan_set.skipped) == 1
    message = plan_set.skipped[0].message
    assert message.startswith("orders.json: 2 entries (1, …) are orders (item_sequence), not packing plans")
    assert "petmjx samples --orders orders.json" in message


@pytest.mark.parametrize(
    ("paths", "message"),
    [
        ("nowhere.json", "nowhere.json: no such file or folder"),
        (["there.json", "nowhere.json"], "nowhere.json: no such file or folder"),
        ("empty", "empty: the folder holds no .json, .csv or .parquet files"),
        ([], "no plan files were given"),
        ("nul\0byte", "nul\\u0000byte: "),
    ],
)
def test_a_wrong_path_always_raises(paths: Any, message: str) -> None:
    write(Path("there.json"), {"A": tower(1)})
    Path("empty").mkdir()
    with pytest.raises(InputError) as raised:
        load_plans(paths)
    assert str(raised.value).startswith(message)


def test_an_unreadable_file_is_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    write(Path("a.json"), {"A": tower(1)})
    write(Path("b.json"), {"B": tower(1)})
    whole_open = os.open

    def refuse(path: Path, flags: int) -> int:
        if path.name == "a.json":
            raise PermissionError(13, "Permission denied")
        return whole_open(path, flags)

    monkeypatch.setattr(os, "open", refuse)
    plan_set = load_plans(["a.json", "b.json"])
    assert [plan.plan_id for plan in plan_set] == ["B"]
    assert str(plan_set.skipped[0]) == "a.json: cannot be read (Permission denied)"


@pytest.mark.parametrize("option", [{"limit": 0}, {"max_boxes": 0}])
def test_senseless_options_raise(option: dict[str, int]) -> None:
    write(Path("a.json"), {"A": tower(1)})
    with pytest.raises(InputError):
        load_plans("a.json", **option)  # type: ignore[arg-type]  # a mapping of one keyword


JSON_VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=3),
    st.sampled_from([0, 1, 2, -1, 0.5, 1.0, 100_000, 100_001, 2**63, 10**310, "\ud800"]),
    st.lists(st.integers(0, 3), max_size=4),
    st.dictionaries(st.text(max_size=1), st.integers(), max_size=2),
)
PATHS = [
    [],
    ["item"],
    ["orientation"],
    ["flb_coordinates"],
    ["flb_coordinates", 1],
    *(["item", field] for field in placement()["item"]),
]


@settings(max_examples=400, deadline=None, derandomize=True)
@given(path=st.sampled_from(PATHS), value=JSON_VALUES)
def test_the_fast_and_the_exact_check_agree(path: list[Any], value: Any) -> None:
    """The fast check refuses a plan exactly if the check of each field finds a fault in a placement, and the message
    names this fault."""
    box: Any = placement()
    holder: Any = [box]
    for key in [0, *path][:-1]:
        holder = holder[key]
    root = holder if not path else [box]
    holder[[0, *path][-1]] = copy.deepcopy(value)
    fault = find_fault(root[0])
    if fault is None:
        assert parse_plan("P", root, DecoderOptions("f", 4)).n_boxes == 1
    else:
        with pytest.raises(PlanError) as raised:
            parse_plan("P", root, DecoderOptions("f", 4))
        assert str(raised.value) == f"f: plan P, placement 0: {fault}"
