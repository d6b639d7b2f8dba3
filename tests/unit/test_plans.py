"""Reading plans: file formats and speed."""

from __future__ import annotations

import gzip
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.command_line import write
from support.plan_files import placement, tower

from petmjx.plans.plan_reader import load_plans

pytestmark = pytest.mark.usefixtures("in_tmp_path")


def test_reads_fields_and_applies_orientation() -> None:
    plan = {"A": [placement(), placement(corner=(600, 1.5, 0), orientation=1, sequence=7)]}
    plan_set = load_plans(write(Path("plans.json"), plan))
    assert plan_set.skipped == []
    assert plan_set.warnings == []
    (read,) = plan_set.plans
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
    for plan_set in (from_folder, from_files):
        assert [(plan.plan_id, plan.n_boxes) for plan in plan_set] == [("A", 2), ("B", 3)]
        assert plan_set.skipped == []
    assert from_folder.plans[0].source == os.path.join("folder", "1.json.gz")


def test_gzip_of_two_members_with_padding() -> None:
    text = json.dumps({"A": tower(2)}).encode()
    Path("p.json.gz").write_bytes(gzip.compress(text[:100]) + gzip.compress(text[100:]) + b"\0" * 512)
    plan_set = load_plans("p.json.gz")
    assert len(plan_set) == 1
    assert plan_set.skipped == []


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
    plan_set = load_plans(["1.json", "2.json"], limit=2)
    assert [plan.plan_id for plan in plan_set] == ["A", "B"]
    assert [skipped.plan_id for skipped in plan_set.skipped] == ["bad"]


def test_extra_fields_are_ignored_also_nested_lists_of_objects() -> None:
    plans = {"A": tower(2), "B": tower(1)}
    for box in plans["A"]:
        box["item"]["tags"] = [{"x": [{"y": 1}]}]
        box["extra"] = [{"z": []}]
    assert [plan.plan_id for plan in load_plans(write(Path("p.json"), plans))] == ["A", "B"]


def test_plans_show_themselves_briefly() -> None:
    plans = {"s0-000003": tower(41), "odd": [placement(), placement(corner=(0, 0, 500))], "bad": []}
    plan_set = load_plans(write(Path("p.json"), plans))
    assert repr(plan_set) == "PlanSet(2 plans, 1 skipped, 1 odd)"
    assert [repr(plan) for plan in plan_set] == ["Plan('s0-000003', 41 boxes)", "Plan('odd', 2 boxes)"]


def test_real_plans_are_read_without_complaint(real_data: Path) -> None:
    plan_set = load_plans([real_data / "packing_plan_a.json", real_data / "packing_plan_5-bed-bpp.json"])
    assert len(plan_set) == 6
    assert plan_set.skipped == []
    orders = load_plans(real_data / "5_bed-bpp.json")
    assert len(orders) == 0
    assert "are orders" in orders.skipped[0].message


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
def test_all_of_bed_bpp_is_read_quickly_in_little_memory(repository: Path) -> None:
    """10,003 plans with 430,129 placements are read in a process of its own, so that the largest memory of this process
    is that of reading; about 100 MB."""
    box = [
        json.dumps(
            placement((i % 2 * 600, i // 2 % 2 * 400, i // 4 * 220), (600, 399 - i, 220), sequence=i + 1, id="ID")
        )
        for i in range(BOXES_PER_PLAN)
    ]
    with open("big.json", "w", encoding="utf-8") as file:
        for index in range(N_PLANS):
            boxes = [box[i].replace("ID", f"{(index * 31 + i * 7) % 20_000:08d}") for i in range(BOXES_PER_PLAN)]
            file.write(f'{"{" if index == 0 else ","} "{index:08d}": [{", ".join(boxes)}]')
        file.write("}")
    assert Path("big.json").stat().st_size > 95e6
    environment = os.environ | {"PYTHONPATH": str(repository)}
    done = subprocess.run(
        [sys.executable, "-c", MEASURE, "big.json"], capture_output=True, text=True, env=environment, check=True
    )
    n_plans, n_boxes, n_skipped, wall_s, cpu_s, peak_bytes = json.loads(done.stdout)
    print(
        f"{n_plans} plans, {n_boxes} placements: {wall_s:.2f} s wall, {cpu_s:.2f} s CPU, peak {peak_bytes / 1e6:.0f} MB"
    )
    assert (n_plans, n_boxes, n_skipped) == (N_PLANS, N_PLANS * BOXES_PER_PLAN, 0)
    # Reading uses one thread, so its CPU time equals its wall-clock time on an idle machine. CPU time is tested, so
    # that the test does not fail on a busy machine.
    assert cpu_s < TIME_LIMIT_S
    assert peak_bytes < PEAK_LIMIT_BYTES
    Path("big.json").unlink()
