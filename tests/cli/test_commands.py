"""The output of the commands compare, samples, export and doctor, and the help of all commands."""

from __future__ import annotations

import functools
import json
import re
import subprocess
import sys
from pathlib import Path

import mujoco
import pytest
from support.command_line import (
    only_line,
    run,
    run_process,
)

from petmjx.common.checked_records import CheckedRecord, CliFlag
from petmjx.options.confidence import Confidence
from petmjx.options.simulation import Simulation
from petmjx.options.thresholds import Thresholds
from petmjx.plans.plan_reader import load_plans
from petmjx.show.doctor_report import examine


def test_compare(plans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, physics in (("a", "pallet"), ("b", "reference")):
        assert run("score", plans, "--engine", "mujoco", "--physics", physics, "--out", tmp_path / name) == 0
    capsys.readouterr()
    assert run("compare", tmp_path / "a", tmp_path / "b") == 0
    assert "2 of 2 worlds agree" in capsys.readouterr().out
    assert run("compare", tmp_path / "a", tmp_path / "b", "--json") == 0
    assert json.loads(capsys.readouterr().out)["agreement"] == 1.0
    assert run("compare", tmp_path / "a", tmp_path / "none") == 2
    assert "none: no such folder" in only_line(capsys.readouterr().err)


def test_samples(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("one.json", "two.json.gz"):
        assert run("samples", "-n", "2", "--seed", "3", "-o", tmp_path / name) == 0
    one, two = (load_plans(tmp_path / name) for name in ("one.json", "two.json.gz"))
    assert [plan.plan_id for plan in one] == [plan.plan_id for plan in two]
    assert len(one) == 2
    assert not one.skipped
    capsys.readouterr()
    assert run("samples", "-n", "0", "-o", tmp_path / "none.json") == 2
    assert "at least 1" in capsys.readouterr().err


def test_samples_pack_orders(tmp_path: Path, repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    orders = repository.parent / "shared" / "data" / "5_bed-bpp.json"
    if not orders.exists():
        pytest.skip("BED-BPP's orders are not beside this checkout (../shared/data)")
    assert run("samples", "--orders", orders, "-o", tmp_path / "packed.json") == 0
    *lines, total = capsys.readouterr().out.splitlines()
    assert lines[1] == "order 00100002: 8 of 38 boxes are left out: items 3, 4, 6, 9, 14, 15, 16, 22"
    assert total == f"5 plans in {tmp_path / 'packed.json'}; 37 boxes of 4 orders left out"
    assert len(load_plans(tmp_path / "packed.json")) == 5


def test_export_writes_the_model_of_a_plan(plans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("export", "tower", plans) == 0
    model = mujoco.MjModel.from_xml_string(capsys.readouterr().out)
    assert model.nbody == 4  # world, carrier, two boxes
    assert run("export", "tower", plans, "--out", tmp_path / "tower.xml") == 0
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "tower.xml")).opt.timestep == 0.002
    capsys.readouterr()
    assert run("score", plans, "--engine", "mujoco", "--carrier", "euro-pallet", "--out", tmp_path / "run") == 0
    assert run("export", "tower", tmp_path / "run", "--out", tmp_path / "of-run.xml") == 0
    assert run("export", "tower", plans, "--carrier", "euro-pallet", "--out", tmp_path / "again.xml") == 0
    assert (tmp_path / "of-run.xml").read_text() == (tmp_path / "again.xml").read_text()
    assert (tmp_path / "of-run.xml").read_text() != (tmp_path / "tower.xml").read_text()
    capsys.readouterr()
    assert run("export", "tower", tmp_path / "run", "--carrier", "euro-pallet") == 2
    assert "a world of a run has the run's options; drop this option" in only_line(capsys.readouterr().err)
    assert run("export", "castle", plans) == 2
    assert "plan castle is not among the 2 plans read" in only_line(capsys.readouterr().err)


def test_doctor_knows_what_works_here(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    # examine is called only once, because it takes some seconds
    monkeypatch.setattr("petmjx.show.doctor_report.examine", functools.cache(examine))
    assert run("doctor", "--json") == 0
    report = json.loads(capsys.readouterr().out)
    engines = {engine["name"]: engine for engine in report["engines"]}
    assert engines["mujoco"]["works"] is True
    assert all(engine["detail"] for engine in engines.values())
    assert run("doctor") == 0
    printed = capsys.readouterr().out
    assert "engine mjx-warp" in printed
    assert ("drawn without a display" in printed) is report["pictures"]["works"]


def test_without_a_command_the_help_is_printed() -> None:
    alone, help_run = run_process(), run_process("--help")
    assert (alone.returncode, alone.stdout, alone.stderr) == (0, help_run.stdout, "")
    assert "score " in alone.stdout


@pytest.mark.parametrize("columns", [80, 120])
@pytest.mark.parametrize("command", ["score", "sweep", "compare", "samples", "show", "export", "doctor"])
def test_every_command_explains_itself(
    command: str, columns: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    assert run(command, "--help") == 0
    printed = capsys.readouterr().out
    assert printed.startswith("Usage:")
    assert max(map(len, printed.splitlines())) <= columns
    assert "<" not in printed  # the help shows no Python types
    if command in ("score", "sweep"):
        more = (Confidence,) if command == "score" else ()
        for flag in (entry for record in (Simulation, Thresholds, *more) for entry in flags_of(record)):
            assert re.search(rf"^  {flag}\b", printed, flags=re.MULTILINE), flag
        text = " ".join(printed.split())
        assert "s; with schedule=adaptive: longest wait for the next placement once a box has failed" in text
        assert "[default: 0.7]" in text
        assert "petmjx-results/DATE-TIME" in text.replace("- ", "-").replace("/ ", "/")  # lines may end at a hyphen


def flags_of(record: type[CheckedRecord]) -> list[str]:
    flags = [entry for info in record.model_fields.values() for entry in info.metadata if isinstance(entry, CliFlag)]
    return [flag.name.partition("/")[0] for flag in flags]


def test_export_takes_what_a_model_depends_on(plans: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("export", "tower", plans, "--physics", "reference", "--set", "physics.timestep_s=0.001") == 0
    assert 'timestep="0.001"' in capsys.readouterr().out
    assert run("export", "tower", plans, "--set", "quiet.steps=3") == 2
    assert (
        "--set quiet: unknown field; there are physics, carrier, friction_pairs, size_reduction_mm"
        in capsys.readouterr().err
    )


def test_help_loads_no_simulator() -> None:
    heavy = ["jax", "mujoco", "pandas", "pyarrow", "warp"]
    code = (
        "import sys; from petmjx.cli import main; main(['--help']); main(['score', '--help'])\n"
        f"sys.exit([name for name in {heavy} if name in sys.modules] or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_command_loads_no_other_one() -> None:
    code = (
        "import sys; from petmjx.cli import main; assert main(['--debug', 'merge', '--help']) == 0\n"
        "sys.exit([name for name in sys.modules if name in ('petmjx.cli.sweep', 'petmjx.cli.score')] or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_every_command_says_that_it_was_interrupted(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("petmjx.show.doctor_report.examine", interrupted)
    assert run("doctor") == 130
    assert only_line(capsys.readouterr().err) == "petmjx: interrupted"


@pytest.mark.parametrize(
    ("option", "value", "complaint"),
    [
        ("--explore", "2", "must be at most 1"),
        ("--worlds-with-errors", "0", "must be at least 1"),
        ("--max-height-mm", "0", "must be at least 1"),
        ("--carrier", "footprint", ": the size of footprint depends on the whole plan"),
        ("--units", "foot", "must be one of mm"),
        ("-n", "0", "must be at least 1"),
    ],
)
def test_a_line_on_an_option_names_it_as_it_was_typed(
    option: str, value: str, complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("label", option, value, "--engine", "mujoco", "--out", tmp_path / "labels") == 2
    assert only_line(capsys.readouterr().err).startswith(f"petmjx: {option}{' ' * (complaint[0] != ':')}{complaint}")
