"""Reading and validating plans: file formats, every kind of bad input, warnings, speed."""

from __future__ import annotations

import copy
import gzip
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from petmjx.errors import InputError
from petmjx.plan_checks import DEFAULT_TOLERANCE_MM, check_layout
from petmjx.plan_records import PlanError, _find_fault, parse_plan
from petmjx.plans import DEFAULT_MAX_BOXES, load_plans

MISSING = object()


def placement(
    corner: tuple[float, float, float] = (0, 0, 0),
    size: tuple[float, float, float] = (600, 400, 220),
    orientation: int = 0,
    sequence: int = 1,
) -> dict[str, Any]:
    return {
        "item": {
            "article": "donut-00101843",
            "id": "00101843",
            "product_group": "confectionery",
            "length/mm": size[0],
            "width/mm": size[1],
            "height/mm": size[2],
            "weight/kg": 6.296,
            "sequence": sequence,
        },
        "orientation": orientation,
        "flb_coordinates": list(corner),
    }


def tower(n: int) -> list[dict[str, Any]]:
    return [placement(corner=(0, 0, 220 * level), sequence=level + 1) for level in range(n)]


def write(path: Path, content: object) -> Path:
    path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return path


@pytest.fixture(autouse=True)
def in_tmp_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Messages name files as given; tests give short relative names."""
    monkeypatch.chdir(tmp_path)


# --- what is read ---------------------------------------------------------------------------------------


def test_reads_fields_and_applies_orientation() -> None:
    plan = {"A": [placement(), placement(corner=(600, 1.5, 0), orientation=1, sequence=7)]}
    found = load_plans(write(Path("plans.json"), plan))
    assert found.skipped == []
    assert found.warnings == []
    (read,) = found.plans
    assert (read.plan_id, read.source, read.n_boxes) == ("A", "plans.json", 2)
    np.testing.assert_array_equal(read.size_mm, [[600, 400, 220], [400, 600, 220]])
    np.testing.assert_array_equal(read.corner_mm, [[0, 0, 0], [600, 1.5, 0]])
    np.testing.assert_array_equal(read.mass_kg, [6.296, 6.296])
    np.testing.assert_array_equal(read.sequence, [1, 7])
    assert read.item_ids == ("00101843",) * 2
    assert read.articles == ("donut-00101843",) * 2
    assert read.size_mm.dtype == read.corner_mm.dtype == read.mass_kg.dtype == np.float64
    assert read.sequence.dtype == np.int64


def test_plain_gzipped_folder_and_many_files_read_the_same() -> None:
    text = json.dumps({"A": tower(2)}, indent=4)
    second = json.dumps({"B": tower(3)})
    folder = Path("folder")
    folder.mkdir()
    write(folder / "2.json", second)
    (folder / "1.json.gz").write_bytes(gzip.compress(text.encode()))
    write(folder / "notes.txt", "no plan")
    write(folder / ".hidden.json", "no plan")
    write(Path("a.json"), text)
    Path("named_without_gz.json").write_bytes(gzip.compress(second.encode()))
    from_folder = load_plans("folder")
    from_files = load_plans([Path("a.json"), "named_without_gz.json"])
    for found in (from_folder, from_files):
        assert [(plan.plan_id, plan.n_boxes) for plan in found] == [("A", 2), ("B", 3)]
        assert found.skipped == []
    assert from_folder.plans[0].source == os.path.join("folder", "1.json.gz")


def test_gzip_of_two_members_with_padding() -> None:
    text = json.dumps({"A": tower(2)}).encode()
    Path("p.json.gz").write_bytes(gzip.compress(text[:100]) + gzip.compress(text[100:]) + b"\0" * 512)
    found = load_plans("p.json.gz")
    assert len(found) == 1
    assert found.skipped == []


def test_byte_order_mark_and_names_outside_ascii() -> None:
    plan = {"plän €": [placement()]}
    plan["plän €"][0]["item"]["article"] = "Knäckebröd 🍞"
    Path("p.json").write_bytes(b"\xef\xbb\xbf" + json.dumps(plan, ensure_ascii=False).encode())
    (read,) = load_plans("p.json").plans
    assert (read.plan_id, read.articles) == ("plän €", ("Knäckebröd 🍞",))


def test_limit_counts_good_plans_and_stops_reading() -> None:
    plans = {"bad": [], "A": tower(1), "B": tower(1), "C": tower(1)}
    write(Path("1.json"), plans)
    write(Path("2.json"), "not read any more")
    found = load_plans(["1.json", "2.json"], limit=2)
    assert [plan.plan_id for plan in found] == ["A", "B"]
    assert [skipped.plan_id for skipped in found.skipped] == ["bad"]


def test_extra_fields_are_ignored_also_nested_lists_of_objects() -> None:
    plans = {"A": tower(2), "B": tower(1)}
    for box in plans["A"]:
        box["item"]["tags"] = [{"x": [{"y": 1}]}]
        box["extra"] = [{"z": []}]
    assert [plan.plan_id for plan in load_plans(write(Path("p.json"), plans))] == ["A", "B"]


def test_real_plans_are_read_without_complaint() -> None:
    data = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not data.is_dir():
        pytest.skip("the real plans are not part of the repository")
    found = load_plans([data / "packing_plan_a.json", data / "packing_plan_5-bed-bpp.json"])
    assert len(found) == 6
    assert found.skipped == []
    orders = load_plans(data / "5_bed-bpp.json")
    assert len(orders) == 0
    assert "are orders" in orders.skipped[0].message


# --- what is refused --------------------------------------------------------------------------------------


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
    ([*ITEM, "weight/kg"], 1e-9, "weight/kg must be from 1e-06 to 100000 (kilograms), got 1e-09"),
    ([*ITEM, "length/mm"], float("inf"), "length/mm must be finite, got Infinity"),
    ([*ITEM, "length/mm"], 0.6, "length/mm must be from 1 to 100000 (millimetres), got 0.6"),
    ([*ITEM, "width/mm"], 10**400, "width/mm must be finite, got an integer of more than 60 digits"),
    ([*ITEM, "width/mm"], [400], "width/mm must be a number, got a list"),
    ([*ITEM, "height/mm"], MISSING, "height/mm is missing"),
    ([*ITEM, "article"], 5, "article must be a string, got 5"),
    ([*ITEM, "article"], "\ud800", "article is not UTF-8 text"),
    ([*ITEM, "id"], MISSING, "id is missing"),
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
    ([*CORNER, 2], False, "flb_coordinates[2] must be a number, got false"),
    ([*CORNER, 0], -1e300, "flb_coordinates[0] must be from -100000 to 100000 (millimetres), got -1e+300"),
]


@pytest.mark.parametrize(("path", "value", "message"), FIELD_FAULTS)
def test_a_bad_field_is_named_and_costs_only_its_plan(path: list[Any], value: Any, message: str) -> None:
    plans = {"good": tower(2), "00100408": changed(path, value), "last": tower(1)}
    file = write(Path("plans.json"), plans)
    found = load_plans(file)
    line = f"plans.json: plan 00100408, placement 7: {message}"
    assert [plan.plan_id for plan in found] == ["good", "last"]
    assert [(s.source, s.plan_id, s.message) for s in found.skipped] == [("plans.json", "00100408", line)]
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
    found = load_plans(write(Path("plans.json"), {"A": tower(1), "P": value, "B": tower(1)}))
    assert [plan.plan_id for plan in found] == ["A", "B"]
    assert [str(skipped) for skipped in found.skipped] == [f"plans.json: {message}"]


def test_max_boxes_is_a_parameter() -> None:
    file = write(Path("plans.json"), {"A": tower(3), "B": tower(4)})
    assert [plan.plan_id for plan in load_plans(file, max_boxes=3)] == ["A"]
    assert len(load_plans(file, max_boxes=4)) == 2


def test_repeated_ids_within_and_across_files_keep_the_first_good_one() -> None:
    one, bad, two = json.dumps(tower(1)), "[]", json.dumps(tower(2))
    write(Path("a.json"), f'{{"A": {bad}, "A": {two}, "A": {one}}}')
    write(Path("b.json"), {"A": tower(1), "B": tower(1)})
    found = load_plans(["a.json", "b.json"])
    assert [(plan.plan_id, plan.n_boxes) for plan in found] == [("A", 2), ("B", 1)]
    assert [str(skipped) for skipped in found.skipped] == [
        "a.json: plan A: has no placement",
        "a.json: plan A: repeated plan id, first used in this file",
        "b.json: plan A: repeated plan id, first used in a.json",
    ]


FILE_FAULTS = [
    (b"", "p.json: the file is empty"),
    (b" \n", "p.json: the file is empty"),
    (b"{}", "p.json: holds no plan"),
    (b"{", "p.json: not JSON at line 1, column 2 (the file ends before a plan id; truncated?)"),
    (b"[1, 2]", "p.json: the top level must be an object of plan id → placements, got a list"),
    (b"3", "p.json: the top level must be an object of plan id → placements, got a number"),
    (b"hello", "p.json: not JSON at line 1, column 1 (expected {)"),
    (b"{\n  hello", "p.json: not JSON at line 2, column 3 (expected a plan id)"),
    (b"{} x", "p.json: not JSON at line 1, column 4 (more text after the closing })"),
    (bytes(range(256)) * 20, "p.json: not JSON at line 1, column 1 (expected {)"),
    (gzip.compress(b"{}")[:11], "p.json: the gzip data is cut off"),
    ("{}".encode("utf-16"), "p.json: is UTF-16 text; plans must be UTF-8"),
    (b'{"A": ' + b"[" * 200_000, "p.json: plan A: not JSON at line 1, column 7 (nested too deeply)"),
    (b"[" * 200_000, "p.json: not JSON at line 1, column 1 (expected {)"),
    (b'{"A": ' + b"9" * 5000 + b"}", "p.json: plan A: must be a list of placements, got Infinity"),
    (b'{"A\nB": [{}]}', "p.json: plan A\\nB: not JSON at line 1, column 4 (Invalid control character"),
    (b'{"\\ud800": [{}]}', "p.json: plan \\ud800: the plan id must be text and not empty"),
    (b'{"": [{}]}', "p.json: plan : the plan id must be text and not empty"),
]


@pytest.mark.parametrize(("content", "message"), FILE_FAULTS)
def test_an_unusable_file_gives_one_line_and_the_others_are_read(content: bytes, message: str) -> None:
    Path("p.json").write_bytes(content)
    write(Path("q.json"), {"Q": tower(1)})
    found = load_plans(["p.json", "q.json"])
    assert [plan.plan_id for plan in found] == ["Q"]
    assert len(found.skipped) == 1
    assert found.skipped[0].message.startswith(message)
    assert "\n" not in found.skipped[0].message
    json.dumps([found.skipped[0].plan_id, found.skipped[0].message]).encode()
    with pytest.raises(InputError, match=r"^p\.json: "):
        load_plans("p.json", strict=True)


def test_orders_are_told_from_plans() -> None:
    order = {"item_sequence": {"1": placement()["item"]}, "properties": {"target": "euro-pallet"}}
    found = load_plans(write(Path("orders.json"), {"1": order, "2": order}))
    assert len(found.skipped) == 1
    message = found.skipped[0].message
    assert message.startswith("orders.json: 2 entries (1, …) are orders (item_sequence), not packing plans")
    assert "petmjx samples --orders orders.json" in message


@pytest.mark.parametrize(
    ("paths", "message"),
    [
        ("nowhere.json", "nowhere.json: no such file or folder"),
        (["there.json", "nowhere.json"], "nowhere.json: no such file or folder"),
        ("empty", "empty: the folder holds no .json or .json.gz files"),
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
    read_bytes = Path.read_bytes

    def refuse(path: Path) -> bytes:
        if path.name == "a.json":
            raise PermissionError(13, "Permission denied")
        return read_bytes(path)

    monkeypatch.setattr(Path, "read_bytes", refuse)
    found = load_plans(["a.json", "b.json"])
    assert [plan.plan_id for plan in found] == ["B"]
    assert str(found.skipped[0]) == "a.json: cannot be read (Permission denied)"


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
    """A plan is refused exactly if a fault is found in one of its placements, and then for that fault."""
    box: Any = placement()
    holder: Any = [box]
    for key in [0, *path][:-1]:
        holder = holder[key]
    root = holder if not path else [box]
    holder[[0, *path][-1]] = copy.deepcopy(value)
    fault = _find_fault(root[0])
    if fault is None:
        assert parse_plan("P", "f", root, 4, {}).n_boxes == 1
    else:
        with pytest.raises(PlanError) as raised:
            parse_plan("P", "f", root, 4, {})
        assert str(raised.value) == f"f: plan P, placement 0: {fault}"


# --- warnings ---------------------------------------------------------------------------------------------

Box = tuple[tuple[float, float, float], tuple[float, float, float]]
CUBE = (100.0, 100.0, 100.0)
T = DEFAULT_TOLERANCE_MM


@pytest.mark.parametrize(
    ("boxes", "extent", "counts"),
    [
        ([((0, 0, 0), CUBE), ((100, 0, 0), CUBE), ((50, 0, 100), CUBE)], (200, 100), (0, 0, 0)),
        ([((0, 0, 0), CUBE), ((100 - T, 0, 0), CUBE), ((0, 0, 100 - T), CUBE)], None, (0, 0, 0)),
        ([((0, 0, 0), CUBE), ((99, 0, 0), CUBE)], None, (1, 0, 0)),
        ([((0, 0, 0), CUBE), ((0, 0, 0), CUBE), ((0, 0, 0), CUBE)], None, (3, 0, 0)),
        ([((0, 0, 0), CUBE), ((0, 0, 50), CUBE)], None, (1, 0, 0)),
        ([((-1, 0, 0), CUBE), ((100, -T, 0), CUBE), ((300, 0, -2), CUBE)], None, (0, 2, 0)),
        ([((0, 0, 0), CUBE), ((150, 0, 0), CUBE), ((250, 20, 0), CUBE)], (249, 115), (0, 2, 0)),
        ([((0, 0, 0), CUBE), ((0, 0, 101), CUBE), ((200, 0, 1), CUBE)], None, (0, 0, 2)),
        ([((0, 0, 0), CUBE), ((100, 0, 100), CUBE)], None, (0, 0, 1)),
        ([((0, 0, 100), CUBE), ((0, 0, 0), CUBE)], None, (0, 0, 1)),
    ],
)
def test_warnings_count_what_is_odd(
    boxes: list[Box], extent: tuple[float, float] | None, counts: tuple[int, int, int]
) -> None:
    corner, size = (np.array(column, dtype=float) for column in zip(*boxes, strict=True))
    found = check_layout("A", "f.json", corner, size, extent)
    assert (found.n_overlapping_pairs, found.n_outside, found.n_floating) == counts
    assert found.any == any(counts)


def test_overlaps_agree_with_a_plain_loop() -> None:
    rng = np.random.default_rng(5)
    corner, size = rng.uniform(0, 600, (40, 3)), rng.uniform(0.2, 300, (40, 3))
    expected = 0
    for i in range(40):
        for j in range(i):
            depth = np.minimum(corner[i] + size[i], corner[j] + size[j]) - np.maximum(corner[i], corner[j])
            expected += bool((depth > T).all())
    assert expected > 20
    assert check_layout("A", "f", corner, size).n_overlapping_pairs == expected


def test_odd_plans_are_kept_and_reported_with_counts() -> None:
    plans = {"fine": tower(2), "odd": [placement(corner=(700, 0, 0)), placement(corner=(0, 0, 50))]}
    found = load_plans(write(Path("p.json"), plans), carrier_extent_mm=(1200, 800))
    assert len(found) == 2
    assert found.skipped == []
    assert [str(w) for w in found.warnings] == ["p.json: plan odd: 1 boxes outside the carrier, 1 floating boxes"]


# --- speed ------------------------------------------------------------------------------------------------

N_PLANS, BOXES_PER_PLAN = 10_003, 43
TIME_LIMIT_S = 10.0
PEAK_LIMIT_BYTES = 1.5e9

MEASURE = """
import json, pathlib, re, sys, time
from petmjx.plans import load_plans
begin_wall, begin_cpu = time.perf_counter(), time.process_time()
found = load_plans(sys.argv[1])
wall_s, cpu_s = time.perf_counter() - begin_wall, time.process_time() - begin_cpu
# not ru_maxrss: it survives exec, so that a child begins with what the test session has used at its peak
status = pathlib.Path("/proc/self/status").read_text()
peak_bytes = int(re.search(r"VmHWM:\\s+(\\d+) kB", status)[1]) * 1024
n_boxes = sum(plan.n_boxes for plan in found)
print(json.dumps([len(found), n_boxes, len(found.skipped), wall_s, cpu_s, peak_bytes]))
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads its peak from Linux's /proc")
def test_all_of_bed_bpp_is_read_quickly_in_little_memory() -> None:
    """10,003 plans with 430,129 placements in about 100 MB, in a process of its own for an honest peak."""
    with open("big.json", "w", encoding="utf-8") as file:
        for index in range(N_PLANS):
            boxes = [
                placement((i % 2 * 600, i // 2 % 2 * 400, i // 4 * 220), (600, 399 - i, 220), 0, i + 1)
                for i in range(BOXES_PER_PLAN)
            ]
            for i, box in enumerate(boxes):
                box["item"]["id"] = f"{(index * 31 + i * 7) % 20_000:08d}"
            file.write(f'{"{" if index == 0 else ","} "{index:08d}": {json.dumps(boxes)}')
        file.write("}")
    assert Path("big.json").stat().st_size > 95e6
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[1])}
    done = subprocess.run(
        [sys.executable, "-c", MEASURE, "big.json"], capture_output=True, text=True, env=environment, check=True
    )
    n_plans, n_boxes, n_skipped, wall_s, cpu_s, peak_bytes = json.loads(done.stdout)
    print(
        f"{n_plans} plans, {n_boxes} placements: {wall_s:.2f} s wall, {cpu_s:.2f} s CPU, peak {peak_bytes / 1e6:.0f} MB"
    )
    assert (n_plans, n_boxes, n_skipped) == (N_PLANS, N_PLANS * BOXES_PER_PLAN, 0)
    # Reading is one thread: its CPU time is its wall time on an idle machine, and a busy one does not fail this.
    assert cpu_s < TIME_LIMIT_S
    assert peak_bytes < PEAK_LIMIT_BYTES
    Path("big.json").unlink()
