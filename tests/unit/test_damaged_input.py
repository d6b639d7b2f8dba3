"""Tests of damaged and huge input. Whatever a path leads to, and whatever a file contains, petmjx prints one line, and
takes neither much time nor much memory."""

from __future__ import annotations

import gzip
import json
import math
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from support.command_line import write
from support.damaged_files import try_one
from support.plan_files import order, placement, tower
from support.sound_files import KINDS

from petmjx.common.errors import InputError
from petmjx.common.safe_read import read_regular
from petmjx.options.physics import Physics
from petmjx.options.simulation import Simulation
from petmjx.packers.sample_plans import generate_one, pack_orders
from petmjx.plans import json_reader
from petmjx.plans import plan_reader as reading
from petmjx.plans.json_reader import MalformedPlans, scan_plans
from petmjx.plans.plan_reader import load_plans
from petmjx.runs.sweep_file import load_sweep
from petmjx.world.profiles.accelerations import HalfSine
from petmjx.world.profiles.measured_profiles import read_psd, read_windows

pytestmark = pytest.mark.usefixtures("in_tmp_path")

N_EACH = 190
QUICK_S = 2.0
"""Longest CPU time of this process for a quick refusal, s."""


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_sample_of_damaged_files_costs_at_most_a_line_each(kind: str, tmp_path: Path) -> None:
    """A sample of damaged files. ``PYTHONPATH=.:tests python -m support.damaged_files`` tries 50,000 damaged files."""
    messages = [(seed, try_one(kind, seed, tmp_path)[1]) for seed in range(N_EACH)]
    assert [(seed, message) for seed, message in messages if message is not None] == []


READERS = {
    "plans": lambda path: load_plans(path, strict=True),
    "orders": lambda path: list(pack_orders(path)),
    "sweep": load_sweep,
    "windows.toml": read_windows,
    "windows.parquet": read_windows,
    "psd": read_psd,
}


@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_file_is_refused_at_once(reader: str) -> None:
    suffix = Path(reader).suffix or ".json"
    os.mkfifo(f"fifo{suffix}")
    Path(f"zero{suffix}").symlink_to("/dev/zero")
    begin = time.process_time()
    for name, kind in (("fifo", "FIFO"), ("zero", "device")):
        with pytest.raises(InputError, match=f"{name}.*it is a {kind}, not a file") as caught:
            READERS[reader](Path(name + suffix))
        assert "\n" not in str(caught.value)
    assert time.process_time() - begin < QUICK_S


def test_folders_and_fifos_among_plan_files_do_not_stop_the_others() -> None:
    folder = Path("plans")
    folder.mkdir()
    (folder / "a.json").mkdir()
    os.mkfifo(folder / "b.json")
    (folder / "c.json").symlink_to("gone.json")
    write(folder / "d.json", {"A": tower(1)})
    plan_set = load_plans(folder)
    assert [plan.plan_id for plan in plan_set] == ["A"]
    assert [str(skipped).partition("(")[2] for skipped in plan_set.skipped] == [
        "it is a FIFO, not a file)",
        "No such file or directory)",
    ]


def test_a_file_that_is_too_large_is_refused_before_it_is_read() -> None:
    with open("huge.json", "wb") as stream:
        stream.truncate(json_reader.MOST_BYTES + 1)  # a sparse file, which takes no space on the disk
    begin = time.process_time()
    (skipped,) = load_plans("huge.json").skipped
    assert str(skipped) == "huge.json: cannot be read (it is larger than 4 GiB)"
    assert time.process_time() - begin < QUICK_S


def test_a_file_that_grows_while_it_is_read_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    Path("growing").write_bytes(b"x")
    monkeypatch.setattr(os, "read", lambda descriptor, count: b"x" * 1024)
    with pytest.raises(OSError, match="larger than 1 MiB"):
        read_regular(Path("growing"), 1 << 20)


def test_a_gzip_bomb_costs_a_line() -> None:
    bomb = gzip.compress(bytes(1 << 27), 6)
    Path("bomb.json.gz").write_bytes(bomb)
    begin = time.process_time()
    (skipped,) = load_plans("bomb.json.gz").skipped
    assert str(skipped) == "bomb.json.gz: the gzip data unpacks to more than 64 MiB, too much for a plan file"
    with pytest.raises(InputError, match="unpacks to more than 64 MiB"):
        list(pack_orders("bomb.json.gz"))
    assert time.process_time() - begin < QUICK_S


def test_gzip_of_well_packed_plans_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(json_reader, "FREE_BYTES", 1 << 16)
    plans = dict(generate_one(number, 0) for number in range(8))
    Path("p.json.gz").write_bytes(gzip.compress(json.dumps(plans, indent=4).encode(), 9))
    assert Path("p.json.gz").stat().st_size < 20_000
    assert len(load_plans("p.json.gz")) == 8


MEMORY = """
import resource, sys
from petmjx.plans.plan_reader import load_plans
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
found = load_plans(sys.argv[1])
print(len(found.plans), len(found.skipped), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""

MB = 1_000_000


@pytest.mark.parametrize(
    ("begin", "unit", "n_bytes"),
    [
        (
            '{"€🍞": [], "x": ',
            '"xxxxxxxx", ',
            60 * MB,
        ),  # because of one letter beyond ASCII, Python would store the text with four bytes per letter
        ('{"a": [', "[],", 60 * MB),
        ("{", '"a":1,', 3 * MB),
        ('{"a": "', "a", 60 * MB),
    ],
)
def test_memory_is_bounded_by_twice_the_size_and_500_mb(begin: str, unit: str, n_bytes: int) -> None:
    Path("p.json").write_text(begin + unit * (n_bytes // len(unit)), encoding="utf-8")
    root = str(Path(reading.__file__).parents[2])
    command = [sys.executable, "-c", MEMORY, "p.json"]
    done = subprocess.run(command, capture_output=True, check=True, env={**os.environ, "PYTHONPATH": root})
    n_plans, n_skipped, kilobytes = map(int, done.stdout.split())
    assert n_plans == 0
    assert n_skipped > 0
    assert kilobytes * 1024 < 2 * Path("p.json").stat().st_size + 500 * MB


K = 1024
SLOW = {
    "escaped quotes": '{"a":x ' + '\\"' * (80 * K),
    "escaped quotes in a string": '{"a": "' + '\\"' * (80 * K),
    "starts in starts": '{"a":' + '[{"b":' * (25 * K),
    "keys in lists": "{" + '"a":[' * (30 * K),
    "starts in open lists": "{" + '"a":[{' * 480 + '"a":[{}],' * 120_000 + "x",
    "backslashes": '{"a":x"' + "\\" * 1_000_000 + '":[{',
    "quotes": '{"a":x' + '"' * 1_000_000 + ":[{",
    "braces": "{" * 1_000_000,
}


@pytest.mark.parametrize("case", SLOW)
def test_damage_is_found_in_linear_time(case: str) -> None:
    data = SLOW[case].encode()
    begin = time.process_time()
    with pytest.raises(MalformedPlans, match="not JSON at line 1, column "):
        list(scan_plans(data))
    assert time.process_time() - begin < QUICK_S


def test_values_of_very_different_lengths_are_read_in_linear_time() -> None:
    """Values of very different lengths are read in linear time: for each value, the reader first decodes twice the
    length of the previous value."""
    long = json.dumps([placement()] * 4_000)
    text = "{" + ", ".join(f'"{k}": {long if k % 100 == 0 else 0}' for k in range(2_000)) + "}"
    begin = time.process_time()
    assert sum(1 for _ in scan_plans(text.encode())) == 2_000
    assert time.process_time() - begin < 2 * QUICK_S


def test_long_names_are_refused_in_a_short_line() -> None:
    long = "n" * 3_000_000
    plans = {long: tower(1), "item": [placement(id=long)], "article": [placement(article=long)], "good": tower(1)}
    plan_set = load_plans(write(Path("p.json"), plans))
    assert [plan.plan_id for plan in plan_set] == ["good"]
    assert [str(skipped).rpartition(": ")[2] for skipped in plan_set.skipped] == [
        "the plan id must have at most 1,000 characters, got 3,000,000",
        "id must have at most 1,000 characters, got 3,000,000",
        "article must have at most 1,000 characters, got 3,000,000",
    ]
    assert max(len(str(skipped)) + len(skipped.plan_id or "") for skipped in plan_set.skipped) < 400
    with pytest.raises(InputError, match="the order id must have at most 1,000 characters"):
        list(pack_orders(write(Path("o.json"), {long: order()})))


def test_a_plan_whose_text_is_endless_is_refused() -> None:
    (skipped,) = load_plans(write(Path("p.json"), {"A": [[0] * 1_400_000], "B": 1})).skipped
    assert str(skipped) == "p.json: plan A: longer than 4 MiB; nothing of this file is read"


def test_of_very_many_unusable_entries_the_rest_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "MOST_LINES", 10)
    write(Path("a.json"), {str(number): 1 for number in range(25)})
    write(Path("b.json"), {"x": 1, "y": tower(1)})
    plan_set = load_plans(["a.json", "b.json", "b.json"])
    lines = [str(skipped) for skipped in plan_set.skipped]
    assert len(lines) == 14
    assert lines[10] == "a.json: 15 more entries are unusable"
    assert lines[11].startswith("b.json: plan x: ")


BEYOND: list[tuple[type[Any], dict[str, Any], str]] = [
    (Simulation, {"settle_s": 1e308}, "settle_s must be from 0 to 600, got 1e+308"),
    (Simulation, {"interval_s": 61}, "interval_s must be from 0 to 40, got 61.0"),
    (Simulation, {"duration_s": 1e9}, "duration_s must be from 0 to 600, got 1000000000.0"),
    (
        Simulation,
        {"total_time_factor": 1e308, "schedule": "fixed"},
        "total_time_factor must be from 1 to 10, got 1e+308",
    ),
    (Simulation, {"solver_iterations": 10**30}, "solver_iterations must be from 1 to 100000, got 1000"),
    (Simulation, {"quiet": {"steps": 10**12}}, "quiet.steps must be from 1 to 100000, got 1000000000000"),
    (Physics, {"timestep_s": 1e-300}, "timestep_s must be from 0.0001 to 0.02, got 1e-300"),
    (Physics, {"box_friction": (1e300, 0, 0)}, "box_friction must be from 0 to 100, got (1e+300, 0.0, 0.0)"),
    (Physics, {"carrier_mass_kg": 1e300}, "carrier_mass_kg must be from 0.001 to 100000, got 1e+300"),
]


@pytest.mark.parametrize(("record", "values", "line"), BEYOND)
def test_options_beyond_a_physical_range_are_refused_with_the_range(
    record: type[Any], values: dict[str, Any], line: str
) -> None:
    with pytest.raises(InputError) as caught:
        record(**values)
    assert str(caught.value).startswith(line)


def test_a_half_timestep_of_the_retry_may_be_below_the_range() -> None:
    from petmjx.engines.attempt_settings import ATTEMPTS

    sim = Simulation(physics={"timestep_s": 0.0001}, quiet={"steps": 100_000})
    (half,) = (recipe.apply_to_sim(sim) for recipe in ATTEMPTS if recipe.number == 5)
    assert (half.physics.timestep_s, half.quiet.steps) == (0.00005, 200_000)


SWEEPS = {
    "level": ("profile = 'eumos-40509'\nlevel = 1e4", "axes.level must be from 0 to 1000, got 10000.0"),
    "friction": ("friction_factor = [1, 101]", "axes.friction_factor must be from 0 to 100, got 101"),
    "size": ("size_tolerance_mm = 1001", "axes.size_tolerance_mm must be from -1000 to 1000, got normal(0, 1001)"),
    "share": (
        "size_tolerance_rel = {distribution = 'fixed', value = -1.5}",
        "axes.size_tolerance_rel must be from -1 to 1, got fixed(-1.5)",
    ),
    "yaw": ("yaw_error_deg = [1, 361]", "axes.yaw_error_deg must be from -360 to 360, got normal(0, 361)"),
    "steps": (
        "profile = 't'\n[profiles.t]\nkind = 'tilt'\nhold_s = 3600\n[simulation.physics]\ntimestep_s = 0.0001",
        "axes.profile: profile 't' takes 36,100,000 steps of 0.0001 s, more than 4,000,000",
    ),
    "windows": (
        "profile = 't'\n[profiles.t]\nkind = 'windows'\nwindows = [" + "[0, 3600, 1, 0, 0]," * 101 + "]",
        "profiles.t.windows must last at most 360000 s in all, got 363600 s",
    ),
    "axis": (
        "profile = 't'\n[profiles.t]\nkind = 'half-sine'\naxis = [1e300, 1e300, 0]",
        "profiles.t.axis[0] must be from -10000 to 10000, got 1e+300",
    ),
}


@pytest.mark.parametrize("case", SWEEPS)
def test_sweeps_beyond_a_physical_range_are_refused_with_the_range(case: str) -> None:
    text, message = SWEEPS[case]
    with pytest.raises(InputError) as caught:
        load_sweep(write(Path("x.toml"), f"[axes]\n{text}\n"), plans_given=True)
    assert message in str(caught.value)


@pytest.mark.parametrize("axis", [(1e300, 1e300, 0.0), (1e-300, 1e-300, 0.0), (5e-324, 5e-324, 0.0)])
def test_an_axis_of_any_length_has_its_direction(axis: tuple[float, float, float]) -> None:
    """An axis of any length has its direction. Earlier, an axis whose square exceeds float64 shook nothing, so every
    plan was stable."""
    of_length_one = HalfSine(axis=(1.0, 1.0, 0.0)).excitation(0.002).samples
    np.testing.assert_allclose(HalfSine(axis=axis).excitation(0.002).samples, of_length_one, rtol=1e-12)


@pytest.mark.parametrize("axis", [(0.0, 0.0, 0.0), (math.inf, 0.0, 0.0), (math.nan, 0.0, 0.0)])
def test_an_axis_without_a_direction_is_refused(axis: tuple[float, float, float]) -> None:
    with pytest.raises(InputError, match="axis must be finite and not zero"):
        HalfSine(axis=axis).excitation(0.002)


@pytest.mark.parametrize(
    ("column", "message"),
    [
        (["a"], "column x must hold numbers, got 'string'"),
        ([[1.0]], "column x must hold numbers, got 'list<"),
        ([True], "column x must hold numbers, got 'bool'"),
        ([None], "column x must hold numbers, got 'null'"),
        ([1e308], "window[0].x must be from -10000 to 10000, got 1e+308"),
        ([math.nan], "window[0].x must be a finite number, got nan"),
    ],
)
def test_parquet_windows_of_wrong_types_are_refused(column: list[Any], message: str) -> None:
    columns = {"start_s": [0.0], "duration_s": [1.0], "x": column, "y": [0.0], "z": [0.0]}
    pyarrow.parquet.write_table(pyarrow.table(columns), "w.parquet")
    with pytest.raises(InputError) as caught:
        read_windows(Path("w.parquet"))
    assert message in str(caught.value)


def test_parquet_of_too_many_rows_is_refused_before_they_are_read() -> None:
    pyarrow.parquet.write_table(pyarrow.table({"x": np.zeros(1_000_000)}), "w.parquet")
    with pytest.raises(InputError, match=r"w\.parquet: must have at most 100,000 rows, got 1,000,000"):
        read_windows(Path("w.parquet"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,1e308\n2,1e308\n", "row[0][1] must be from 0 to 1e+06, got 1e+308"),
        ("5e-324,1\n2,1\n", "row[0][0] must be from 0.0001 to 1e+06, got 5e-324"),
        ("1," + "9" * 5000 + "\n2,1\n", "row[0][1] must be a finite number, got inf"),
        ("1,0\n2,0\n", "row[0][1] must be > 0, got 0.0"),
        ("1," + "x" * 200_000, "cannot be read as a PSD table: field larger than field limit"),
        ("\n".join(f"{hz},1e-9" for hz in range(1, 1003)), "row must have at most 1,000 entries"),
        ("1,1\n" * 300_000, "it is larger than 1 MiB"),
        ("1,1\0\n2,1", "row[0][1] must be a finite number"),
    ],
)
def test_psd_tables_beyond_any_range_are_one_line(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        read_psd(write(Path("p.csv"), text))
    assert message in str(caught.value)
    assert len(str(caught.value)) < 300


def test_what_costs_more_than_a_line_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The check of damaged files finds tracebacks, too much time, too much memory, and messages that are not one
    line."""

    def crash(path: Path) -> list[str]:
        raise KeyError("x")

    def linger(path: Path) -> list[str]:
        begin = time.process_time()
        while time.process_time() - begin < 0.05:
            pass
        return []

    monkeypatch.setattr("support.damaged_files.SLOW_S", 0.01)
    for load, line in ((crash, "traceback: KeyError"), (linger, "slow: "), (lambda path: ["a\x1b[2J"], "line with")):
        monkeypatch.setitem(KINDS, "psd", replace(KINDS["psd"], load=load))
        assert (try_one("psd", 0, tmp_path)[1] or "").startswith(line)
