"""Tests of the benchmark suite: the lines of results, the agreement between runs, the cases, and the tables."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import petmjx
from benchmarks import million_worlds, result_tables
from benchmarks.__main__ import main
from benchmarks.agreement import agreement
from benchmarks.cases import CASES, GROUPS, STACK_PLAN, chosen_cases, oracle_case
from benchmarks.measure import Bench, bricks, spread_over_sizes
from benchmarks.result_fields import COMMIT_VARIABLE, append_line, read_lines
from petmjx.common.errors import InputError
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Progress
from petmjx.engines.remote import worker_pool
from petmjx.engines.remote.ray_actor import Worker
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Schedule, Simulation
from petmjx.packers.sample_plans import generate_one
from petmjx.plans.bundled import bundled_path
from petmjx.plans.plan_reader import load_plans
from petmjx.plans.plan_warnings import check_layout
from petmjx.results.run_reader import load_run
from petmjx.world.job import Job

SIZE = {"length/mm": 400, "width/mm": 300, "height/mm": 200, "weight/kg": 5.0}

FIELDS = {
    "case", "group", "way", "commit", "date", "cpu", "engine", "device", "threads", "lanes", "versions", "plans",
    "boxes", "plans_per_s", "world_steps", "world_steps_per_s", "start_s", "compile_s", "run_s", "wall_s", "cpu_s",
    "counts", "agreement", "stages", "peak_rss_bytes", "peak_device_bytes", "schedule", "physics", "check", "sweep",
    "note", "repetition",
}  # fmt: skip
"""Keys that every result has, however it was measured."""


@pytest.fixture(scope="module")
def plans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file with three plans: two boxes that stand, two boxes of which the upper one overhangs and falls, and a tower
    of three boxes that stands."""

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
    assert main(["run", *map(str, arguments)]) == 0


@pytest.fixture(scope="module")
def measured(plans: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file with results of a workload that was run twice, with its oracle (C MuJoCo) and with a plain loop."""
    folder = tmp_path_factory.mktemp("bench")
    out = folder / "results.jsonl"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(COMMIT_VARIABLE, "0123abc")
        bench(
            "W-adaptive", "plain-loop", "--plans", plans, "--threads", "1", "--oracle", "mujoco-fixed", "--repeat", "2",
            "--work", folder / "work", "--out", out,
        )  # fmt: skip
    return out


def test_a_result_is_one_line_with_all_fields(measured: Path) -> None:
    results = read_lines([measured])
    assert [(r["case"], r["engine"], r["repetition"]) for r in results] == [
        ("W-fixed", "mujoco", 1),
        ("W-adaptive", "mujoco", 1),
        ("plain-loop", "plain-loop", 1),
        ("W-adaptive", "mujoco", 2),
        ("plain-loop", "plain-loop", 2),
    ]
    for result in results:
        assert result.keys() >= FIELDS
        assert result["commit"] == "0123abc"
        assert (result["plans"], result["boxes"], result["threads"]) == (3, 7, 1)
        assert result["wall_s"] == pytest.approx(result["run_s"] + result["compile_s"])
        assert result["plans_per_s"] == pytest.approx(3 / result["run_s"], rel=1e-4)  # numbers are stored with 6 digits
        assert result["versions"]["mujoco"]
        assert result["peak_rss_bytes"] > 1e7
    assert results[1]["counts"] == {"worlds": 3, "stable": 2, "unstable": 1, "invalid": 0, "by_reason": {"drop": 1}}
    assert "3 of 2000 plans" in results[1]["note"]


def test_steps_are_those_of_the_schedule(measured: Path) -> None:
    fixed, adaptive, loop, *_ = read_lines([measured])
    # with the schedule fixed, n boxes take n + 1 intervals of 0.7 s at 2 ms. Times are truncated to whole steps, as in
    # the reference implementation, so each world has one step less. No box drops, so no world ends early.
    assert loop["world_steps"] == 350 * (3 + 3 + 4) - 3
    assert adaptive["world_steps"] < fixed["world_steps"] == loop["world_steps"]


def test_runs_are_kept_and_compared(measured: Path) -> None:
    fixed, first, _, second, _ = read_lines([measured])
    assert load_run(Path(first["results_dir"])).info["counts"]["worlds"] == 3
    assert fixed["agreement"] == {}
    assert first["agreement"].keys() == {"mujoco-fixed"}
    assert first["agreement"]["mujoco-fixed"]["share"] == 1
    assert first["agreement"]["mujoco-fixed"]["stable_here_dropped_there"] == []
    again = second["agreement"]["first run"]
    assert (again["common"], again["same"], again["plans_all_the_same"], again["flips"]) == (3, 3, 3, [])
    # the two plans that stand have three boxes with a box on top; the engine's results are the same, bit for bit
    assert again["rest_top_force"] == {"boxes": 3, "median": 0, "p95": 0}


def test_flips_are_listed_with_their_margins(plans: Path, tmp_path: Path) -> None:
    results = [
        petmjx.score(
            plans, engine="mujoco", threads=1, physics="reference", early_stop=False, out=tmp_path / name, **options
        )
        for name, options in (("a", {}), ("b", {"thresholds": {"shift_m": 1e-4, "shift_floor_m": 0}}))
    ]
    comparison = agreement([results[0].path], [results[1].path])
    assert (comparison["common"], comparison["same"]) == (3, 1)
    assert {flip["plan_id"] for flip in comparison["flips"]} == {"tower", "higher"}
    flip = comparison["flips"][0]
    assert flip["oracle"]["verdict"] == "stable"
    assert (flip["here"]["verdict"], flip["here"]["reason"]) == ("unstable", "shift")
    assert flip["here"]["shift_margin_m"] > 0 > flip["oracle"]["shift_margin_m"]


def test_pieces_of_a_run_count_as_one(plans: Path, tmp_path: Path) -> None:
    out, work = tmp_path / "results.jsonl", tmp_path / "work"
    bench("W-adaptive", "--plans", plans, "--limit", "2", "--work", work, "--out", out)
    bench("W-adaptive", "--plans", plans, "--skip", "2", "--work", work, "--out", out)
    pieces = [result["results_dir"] for result in read_lines([out])]
    against = f"pieces={pieces[0]},{pieces[1]}"
    bench("W-adaptive", "--plans", plans, "--work", work, "--out", out, "--against", against)
    *parts, full_run = read_lines([out])
    assert [result["plans"] for result in (*parts, full_run)] == [2, 1, 3]
    joint = tmp_path / "joint.jsonl"
    assert (
        main(["agreement", full_run["results_dir"], "--oracle", against, "--case", "W-adaptive", "--out", str(joint)])
        == 0
    )
    [result] = read_lines([joint])
    assert result["agreement"] == full_run["agreement"]
    assert result["agreement"]["pieces"]["same"] == result["agreement"]["pieces"]["common"] == 3
    assert "pieces" in result_tables.tables([result])


def test_what_takes_too_long_is_cut_off(plans: Path, tmp_path: Path) -> None:
    out = tmp_path / "results.jsonl"
    arguments = ("W-adaptive", "plain-loop", "--plans", plans, "--threads", "1", "--max-seconds", "1e-9")
    bench(*arguments, "--work", tmp_path, "--out", out)
    workload, loop = read_lines([out])
    assert 1 <= workload["plans"] < 3
    assert "cut off after" in workload["note"]
    assert loop["plans"] == 1
    assert "1 of 2000 plans" in loop["note"]


def test_sweeps_are_timed_by_placements_and_drives(plans: Path, tmp_path: Path) -> None:
    sweep = tmp_path / "short.toml"
    axes = '[axes]\nprofile = "eumos-40509"\ndirection = ["+x"]\nlevel = [0.1, 3.0]\n'
    sweep.write_text(axes + "[simulation]\nrest_s = 0.1\n", encoding="utf-8")
    case = replace(CASES["eumos-16"], count=2, sweep=str(sweep))
    bench = Bench(work=tmp_path, plans=plans, threads=1, repeat=2, max_seconds=60)
    first, second = bench.run([case], ["mujoco"])
    assert first.keys() >= FIELDS
    assert (first["plans"], first["counts"]["worlds"], first["sweep"]) == (2, 4, "short")
    timings = first["timings"]
    assert (timings["placements"], timings["drives"]) == (2, 2)  # a plan that falls when it is placed is not shaken
    assert first["world_steps"] == timings["placement_steps"] + timings["drive_steps"]
    assert 0 < timings["drive_s"] < first["run_s"]
    assert second["agreement"]["first run"]["same"] == 4
    assert "### Sweeps" in result_tables.tables([first])


def test_how_often_plans_stand_is_compared(plans: Path, tmp_path: Path) -> None:
    def placed(name: str, error_mm: float) -> Path:
        sweep = tmp_path / f"{name}.toml"
        sweep.write_text(f"replicates = 3\n[axes]\nplacement_error_mm = {error_mm}\n", encoding="utf-8")
        return petmjx.sweep(sweep, plans, engine="mujoco", threads=1, out=tmp_path / name).path

    runs = [placed("a", 1), placed("b", 1), placed("c", 400)]
    alike, apart = agreement([runs[0]], [runs[1]])["shares"], agreement([runs[0]], [runs[2]])["shares"]
    assert alike == {"plans": 3, "agree": 3, "intervals_overlap": 3, "differ": []}
    assert apart["agree"] < 3
    assert apart["differ"][0]["oracle"] > apart["differ"][0]["here"]


class Compiling:
    """The engine ``mujoco`` as if it compiled in its first run, and had lanes instead of threads."""

    name = "mjx-jax"
    runs = 0

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        progress = progress or Progress()
        progress.compile_s = 100.0 if self.runs == 0 else 0.0
        progress.extra["place capacity 8 lanes"] = len(jobs)
        self.runs += 1
        yield from MujocoEngine(1).run(jobs, sim, progress)


def test_what_compiles_is_run_before_it_is_timed(tmp_path: Path) -> None:
    engine = Compiling()
    bench = Bench(work=tmp_path, lanes=2, make=lambda name, **limits: engine)
    [result] = bench.run([CASES["stacks-8"]], [engine.name])
    assert result.keys() >= FIELDS
    assert engine.runs == 2
    assert (result["compile_s"], result["lanes"], result["threads"]) == (100, 2, None)
    assert result["run_s"] < 100
    # two worlds with 200 steps of soft start, and 1 s at 2 ms
    assert result["world_steps"] == 2 * (200 + 500)
    assert result["counts"]["stable"] == 2
    assert "2 lanes" in result_tables.tables([result])


def test_cases_by_name_and_group() -> None:
    chosen = chosen_cases(["W", "W-fixed", "stacks-8"])
    assert [case.name for case in chosen] == [*(case.name for case in GROUPS["W"]), "stacks-8"]
    with pytest.raises(InputError, match="unknown case 'nonsense'"):
        chosen_cases(["nonsense"])
    assert len(CASES) == sum(map(len, GROUPS.values()))  # no two cases have the same name
    assert GROUPS.keys() <= result_tables.SECTIONS.keys()
    for case in CASES.values():
        assert case.sim.physics.timestep_s > 0


def test_an_oracle_differs_in_its_schedule_alone() -> None:
    assert oracle_case(CASES["W-adaptive"], Schedule.FIXED) is CASES["W-fixed"]
    assert oracle_case(CASES["W-fixed"], Schedule.ADAPTIVE) is CASES["W-adaptive"]
    assert oracle_case(CASES["W-fixed"], Schedule.FIXED) is CASES["W-fixed"]
    made = oracle_case(CASES["W-adaptive-reference"], Schedule.FIXED)
    assert (made.name, made.sim.schedule, made.sim.physics.name) == (
        "W-adaptive-reference/fixed", Schedule.FIXED, "reference",
    )  # fmt: skip


@pytest.mark.parametrize("boxes", [3, 70])
def test_stacks_have_as_many_boxes_as_their_case_and_stand(boxes: int, tmp_path: Path) -> None:
    """Stacks of up to 67 boxes are parts of a sample plan. Larger stacks are made of bricks."""
    assert len(generate_one(STACK_PLAN, 0, loose_share=0.0)[1]) == 67
    case = replace(CASES["stacks-8"], boxes=boxes, count=1)
    [result] = Bench(work=tmp_path, threads=1).run([case], ["mujoco"])
    assert (result["plans"], result["boxes"], result["counts"]["stable"]) == (1, boxes, 1)


@pytest.mark.parametrize("boxes", [128, 250])
def test_bricks_are_packed_without_gaps_or_overlaps(boxes: int) -> None:
    plan = bricks(boxes)
    assert not check_layout(plan.plan_id, plan.source, plan.corner_mm, plan.size_mm).any


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
    readme.write_text(f"before\n{result_tables.BEGIN}\nold\n{result_tables.END}\nafter\n", encoding="utf-8")
    assert main(["table", str(measured), "--readme", str(readme)]) == 0
    text = readme.read_text(encoding="utf-8")
    assert text.startswith("before\n")
    assert text.endswith("\nafter\n")
    assert "old" not in text
    for heading in ("Workload W", "Agreement", "Plain Python loop"):
        assert f"### {heading}" in text
    assert "3 of 3 (100.00 %)" in text
    rows = [line for line in text.splitlines() if line.startswith("| W-adaptive | mujoco")]
    assert all(line.count("|") == rows[0].count("|") for line in rows[:2])
    with pytest.raises(InputError, match="lacks the markers"):
        result_tables.write_between_markers(measured, "text")


def test_only_the_last_of_equal_measurements_is_shown() -> None:
    old = {"case": "stacks-8", "engine": "mujoco", "plans_per_s": 1.0}
    new, other = {**old, "plans_per_s": 2.0}, {**old, "engine": "mjx-warp"}
    assert result_tables.latest([old, other, new]) == [new, other]


def test_of_runs_that_take_turns_the_quickest_counts() -> None:
    one = {"group": "threads", "way": "files", "case": "threads-1", "engine": "mujoco", "commit": "a", "physics": ""}
    two = {**one, "case": "threads-2"}
    text = result_tables.tables(
        [
            {**one, "commit": "before", "wall_s": 1.0, "repetition": 1},
            {**one, "wall_s": 10.0, "repetition": 1},
            {**two, "wall_s": 9.0, "repetition": 1},
            {**one, "wall_s": 8.0, "repetition": 2},
            {**two, "wall_s": 4.0, "repetition": 2},
        ]
    )
    assert "8.00 s | 1.00 |" in text
    assert "4.00 s | 2.00 |" in text
    assert text.count("| threads-") == 2


def test_the_readme_shows_what_the_results_say(repository: Path) -> None:
    folder = repository / "benchmarks"
    text = result_tables.tables(read_lines(sorted((folder / "results").glob("*.jsonl"))))
    assert f"{result_tables.BEGIN}\n\n{text}\n{result_tables.END}" in (folder / "README.md").read_text(encoding="utf-8")


def test_bad_options_are_one_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["list"]) == 0
    assert "stacks-64" in capsys.readouterr().out
    for options, words in (
        (["nonsense"], "unknown case"),
        (["W-fixed", "--engine", "abacus"], "unknown engine"),
        (["W-fixed", "--oracle", "delphi"], "unknown oracle"),
        (["W-fixed", "--against", "folder"], "LABEL=DIR"),
    ):
        assert main(["run", *options, "--out", str(tmp_path / "out.jsonl")]) == 2
        assert words in capsys.readouterr().err


def test_drift_of_a_pallet_that_stands(plans: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    options = ("--limit", "1", "--variant", "pallet", "--begin", "0.5", "--end", "1", "--threads", "1")
    assert main(["drift", str(plans), *options, "--out", str(tmp_path / "out")]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("pallet, one-by-one: 1 plan, 2 boxes: median ")
    assert second.startswith("pallet, static: 1 plan, 2 boxes: median ")
    assert len(list((tmp_path / "out").glob("*.parquet"))) == 2


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--end", "nan"], "got 10 s to nan s"),
        (["--end", "10"], "got 10 s to 10 s"),
        (["--begin", "-5"], "got -5 s to 60 s"),
        (["--end", "1e9"], "to 600 s at most"),
        (["--limit", "0"], "--limit must be ≥ 1"),
        (["--variant", "none"], "no variant 'none'"),
        (["--out", "/dev/null/x"], "/dev/null/x: cannot write tables there"),
        (["/dev/null"], "no usable plan"),
    ],
)
def test_drift_that_is_refused(options: list[str], words: str, plans: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [] if options == ["/dev/null"] else [str(plans)]
    assert main(["drift", *files, *options]) == 2
    assert words in capsys.readouterr().err.strip()


def test_numbers_are_cut_to_six_digits(tmp_path: Path) -> None:
    append_line(tmp_path / "out.jsonl", {"a": [1 / 3, 2], "b": 1234567.8})
    assert read_lines([tmp_path / "out.jsonl"]) == [{"a": [0.333333, 2], "b": 1234570.0}]


def _dies(case: million_worlds.Million) -> dict[str, Any]:
    os._exit(3)


def test_a_step_whose_process_dies_ends_the_benchmark(tmp_path: Path) -> None:
    with pytest.raises(BrokenProcessPool):
        million_worlds._in_process(_dies, million_worlds.Million(tmp_path))


@pytest.mark.parametrize("placing", ["exact", "hand"])
def test_a_million_worlds_are_placed_as_asked_for(
    placing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(million_worlds, "TOLD_EVERY_S", 0.0)
    case = million_worlds.Million(tmp_path, plans=1, variants=2, placing=placing)
    assert million_worlds.run(case)["steps"] > 0
    info = json.loads((case.out / "run.json").read_text())
    assert info["config"]["simulation"]["placing"]["name"] == placing
    assert "worlds/s" in capsys.readouterr().err


def test_a_million_worlds_in_small(tmp_path: Path) -> None:
    case = million_worlds.Million(tmp_path, plans=2, variants=6, options=(("keep", "worlds"),))
    first, again = million_worlds.run(case), million_worlds.run(case)
    assert (first["recorded"], first["worlds"], again["recorded"], again["worlds"]) == (0, 12, 12, 0)
    assert million_worlds.written(case.out) == million_worlds.load(case)["rows"] == 12
    assert million_worlds.report_of(case)["bytes"] == (tmp_path / "report.html").stat().st_size
    assert "boxes" not in million_worlds.tables(case.out)
    assert vars(worker_pool)["Worker"] is Worker  # later runs of this process have ordinary workers again
    boxes = [plan.n_boxes for plan in million_worlds.made(5)]
    assert boxes == sorted(boxes)
    assert (min(boxes), max(boxes)) == (million_worlds.FEWEST, million_worlds.MOST)
