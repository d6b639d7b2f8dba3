"""The benchmark suite: what a result's line holds, agreement between runs, cases by name, and the tables."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import table
from benchmarks.__main__ import main as bench_main
from benchmarks.agreement import agreement, main
from benchmarks.cases import CASES, GROUPS, STACK_BOXES, STACK_PLAN, WorkloadCase, chosen_cases, oracle_case
from benchmarks.measure import Bench, Settings, spread_over_sizes
from benchmarks.record import COMMIT_VARIABLE, rounded
from petmjx.config import Schedule, Simulation, Thresholds
from petmjx.engines.base import Progress
from petmjx.engines.cpu.engine import MujocoEngine
from petmjx.errors import InputError
from petmjx.plans.read import load_plans
from petmjx.plans.samples import bundled_path, generate_one
from petmjx.results.reader import load_run
from petmjx.verdict import Outcome
from petmjx.world.job import Job

SIZE = {"length/mm": 400, "width/mm": 300, "height/mm": 200, "weight/kg": 5.0}

FIELDS = {
    "case", "commit", "date", "cpu", "engine", "device", "threads", "lanes", "versions", "plans", "boxes",
    "plans_per_s", "world_steps", "world_steps_per_s", "start_s", "compile_s", "run_s", "wall_s", "counts",
    "agreement", "stages", "peak_rss_bytes", "peak_device_bytes", "schedule", "physics", "check", "note",
}  # fmt: skip
"""What every result of the suite has."""


@pytest.fixture(scope="module")
def plans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tower that stands, a box that overhangs and falls, and a tower of three."""

    def placement(x_mm: int, z_mm: int) -> dict[str, Any]:
        item = {"article": "carton", "id": "1", "product_group": "test", "sequence": 1, **SIZE}
        return {"item": item, "orientation": 0, "flb_coordinates": [x_mm, 0, z_mm]}

    path = tmp_path_factory.mktemp("plans") / "plans.json"
    content = {
        "tower": [placement(0, 0), placement(0, 200)],
        "overhang": [placement(0, 0), placement(260, 200)],
        "higher": [placement(0, 200 * k) for k in range(3)],
    }
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def bench(*arguments: str | Path) -> None:
    assert bench_main([*map(str, arguments)]) == 0


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


@pytest.fixture(scope="module")
def measured(plans: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a workload with its oracle, run twice, and of a plain loop."""
    folder = tmp_path_factory.mktemp("bench")
    out = folder / "results.jsonl"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(COMMIT_VARIABLE, "0123abc")
        bench(
            "W-adaptive", "plain-loop", "--plans", plans, "--threads", "1", "--oracle", "mujoco-fixed", "--repeat", "2",
            "--work", folder / "work", "--out", out, "--date", "2025-01-01",
        )  # fmt: skip
    return out


def test_a_result_is_one_line_with_all_fields(measured: Path) -> None:
    results = lines(measured)
    assert [(r["case"], r["engine"]) for r in results] == [
        ("W-fixed", "mujoco"),
        ("W-adaptive", "mujoco"),
        ("W-adaptive", "mujoco"),
        ("plain-loop", "plain-loop"),
    ]
    for result in results:
        assert result.keys() >= FIELDS
        assert (result["commit"], result["date"]) == ("0123abc", "2025-01-01")
        assert (result["plans"], result["boxes"], result["threads"]) == (3, 7, 1)
        assert result["wall_s"] == pytest.approx(result["run_s"] + result["compile_s"])
        assert result["plans_per_s"] == pytest.approx(3 / result["run_s"], rel=1e-4)  # numbers have 6 digits
        assert result["versions"]["mujoco"]
        assert result["peak_rss_bytes"] > 1e7
    assert results[1]["counts"]["stable"] == 2
    assert "3 of 2000 plans" in results[1]["note"]


def test_steps_are_those_of_the_schedule(measured: Path) -> None:
    fixed, adaptive, _, loop = lines(measured)
    # fixed: (n + 1) intervals of 0.7 s at 2 ms, for 2, 2 and 3 boxes, each cut to whole steps as the reference does
    # (so one fewer); the box that tips over does not drop, so no world ends early
    assert loop["world_steps"] == 350 * (3 + 3 + 4) - 3
    assert adaptive["world_steps"] < fixed["world_steps"] == loop["world_steps"]


def test_runs_are_kept_and_compared(measured: Path) -> None:
    fixed, first, second, _ = lines(measured)
    assert load_run(Path(first["results_dir"])).info["counts"]["worlds"] == 3
    assert fixed["agreement"] == {}
    assert first["agreement"].keys() == {"mujoco-fixed"}
    assert first["agreement"]["mujoco-fixed"]["share"] == 1
    assert first["agreement"]["mujoco-fixed"]["stable_here_dropped_there"] == []
    again = second["agreement"]["first run"]
    assert (again["common"], again["same"], again["flips"]) == (3, 3, [])
    # boxes with something on them, of the two plans that stand; the engine repeats itself bit for bit
    assert again["rest_top_force"] == {"boxes": 3, "median": 0, "p95": 0}


def test_flips_are_listed_with_their_margins(plans: Path, tmp_path: Path) -> None:
    from petmjx import score

    results = [
        score(plans, engine="mujoco", threads=1, early_stop=False, out=tmp_path / name, thresholds=limits)
        for name, limits in (("a", None), ("b", Thresholds(shift_m=1e-9, shift_floor_m=0)))
    ]
    found = agreement([results[0].path], [results[1].path])
    assert (found["common"], found["same"]) == (3, 1)
    assert {flip["plan_id"] for flip in found["flips"]} == {"tower", "higher"}
    flip = found["flips"][0]
    assert flip["oracle"]["verdict"] == "stable"
    assert (flip["here"]["verdict"], flip["here"]["reason"]) == ("unstable", "shift")
    assert flip["here"]["shift_margin_m"] > 0 > flip["oracle"]["shift_margin_m"]


def test_pieces_of_a_run_count_as_one(plans: Path, tmp_path: Path) -> None:
    out = tmp_path / "results.jsonl"
    bench("W-adaptive", "--plans", plans, "--limit", "2", "--work", tmp_path / "work", "--out", out)
    bench("W-adaptive", "--plans", plans, "--skip", "2", "--work", tmp_path / "work", "--out", out)
    bench("W-adaptive", "--plans", plans, "--work", tmp_path / "work", "--out", out)
    pieces = [result["results_dir"] for result in lines(out)]
    assert [result["plans"] for result in lines(out)] == [2, 1, 3]
    joint = tmp_path / "joint.jsonl"
    main(
        ["--label", "pieces", "--oracle", *pieces[:2], "--run", pieces[2], "--case", "W-adaptive", "--out", str(joint)]
    )
    (result,) = lines(joint)
    assert result["agreement"]["pieces"]["same"] == result["agreement"]["pieces"]["common"] == 3
    assert "pieces" in table.tables([result])


def test_a_workload_that_takes_too_long_is_cut_off(plans: Path, tmp_path: Path) -> None:
    out = tmp_path / "results.jsonl"
    bench("W-adaptive", "--plans", plans, "--threads", "1", "--max-seconds", "1e-9", "--work", tmp_path, "--out", out)
    (result,) = lines(out)
    assert 1 <= result["plans"] < 3
    assert "cut off after" in result["note"]


class Compiling:
    """The engine mujoco with lanes instead of threads, which compiles when it is first run."""

    name = "mjx-jax"
    runs = 0

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        progress = progress or Progress()
        progress.compile_s = 100.0 if self.runs == 0 else 0.0
        progress.extra["place capacity 8 lanes"] = len(jobs)
        self.runs += 1
        yield from MujocoEngine(1).run(jobs, sim, progress)


def test_what_compiles_is_run_before_it_is_timed(tmp_path: Path) -> None:
    measuring = Bench(Settings(work=tmp_path, lanes=2))
    engine = Compiling()
    measuring._engines[engine.name] = engine
    (result,) = measuring.run(CASES["stacks-8"], engine.name)
    assert result.keys() >= FIELDS
    assert engine.runs == 2
    assert (result["compile_s"], result["lanes"], result["threads"]) == (100, 2, None)
    assert result["run_s"] < 100
    # the soft start and 1 s at 2 ms, two worlds
    assert result["world_steps"] == 2 * (200 + 500)
    assert result["counts"] == {"stable": 2}
    assert "2 lanes" in table.tables([result])


def test_cases_by_name_and_group() -> None:
    assert [case.name for case in chosen_cases(["W", "W-fixed", "stacks-8"])] == [*GROUPS["W"], "stacks-8"]
    assert len(GROUPS["stacks"]) == len(STACK_BOXES)
    with pytest.raises(InputError, match="unknown case 'nonsense'"):
        chosen_cases(["nonsense"])
    for case in CASES.values():
        if isinstance(case, WorkloadCase):
            assert oracle_case(case, Schedule.FIXED).physics == case.physics


def test_stacks_are_cut_from_a_plan_with_enough_boxes() -> None:
    _, placements = generate_one(STACK_PLAN, 0, loose_share=0.0)
    assert len(placements) >= max(STACK_BOXES)


def test_any_beginning_is_spread_over_the_sizes() -> None:
    plans = load_plans(bundled_path()).plans
    order = spread_over_sizes(plans)
    assert sorted(plan.plan_id for plan in order) == sorted(plan.plan_id for plan in plans)
    sizes = sorted(plan.n_boxes for plan in plans)
    rank = np.searchsorted(sizes, [plan.n_boxes for plan in order[:3]]) / len(sizes)
    assert rank[1] < rank[0] < rank[2]
    assert spread_over_sizes([]) == []


def test_tables_go_between_the_markers(measured: Path, tmp_path: Path) -> None:
    readme = tmp_path / "README.md"
    readme.write_text(f"before\n{table.BEGIN}\nold\n{table.END}\nafter\n", encoding="utf-8")
    table.main([str(measured), "--readme", str(readme)])
    text = readme.read_text(encoding="utf-8")
    assert text.startswith("before\n")
    assert text.endswith("\nafter\n")
    assert "old" not in text
    for heading in ("Workloads", "Agreement", "Plain Python loops"):
        assert f"### {heading}" in text
    assert "3 of 3 (100.00 %)" in text
    rows = [line for line in text.splitlines() if line.startswith("| W-adaptive | mujoco")]
    assert all(line.count("|") == rows[0].count("|") for line in rows[:2])
    with pytest.raises(InputError, match="lacks the markers"):
        table.write_between_markers(measured, "text")


def test_only_the_last_of_equal_measurements_is_shown() -> None:
    old = {"case": "stacks-8", "engine": "mujoco", "plans_per_s": 1.0}
    new, other = {**old, "plans_per_s": 2.0}, {**old, "engine": "mjx-warp"}
    assert table.latest([old, other, new]) == [new, other]


def test_bad_options_are_one_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert bench_main(["--list"]) == 0
    assert "stacks-64" in capsys.readouterr().out
    for options, words in (
        (["nonsense"], "unknown case"),
        (["W-fixed", "--engine", "abacus"], "unknown engine"),
        (["W-fixed", "--oracle", "delphi"], "unknown oracle"),
        (["W-fixed", "--against", "folder"], "LABEL=DIR"),
    ):
        assert bench_main([*options, "--out", str(tmp_path / "out.jsonl")]) == 2
        assert words in capsys.readouterr().err


def test_numbers_are_cut_to_six_digits() -> None:
    assert rounded({"a": [1 / 3, 2]}) == {"a": [0.333333, 2]}
