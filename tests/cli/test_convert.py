"""``petmjx convert``, pipes, names of files that ``petmjx samples`` refuses, and options and paths that do not say what
the user means."""

from __future__ import annotations

import gzip
import json
import os
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.command_line import only_line, run, run_process, write
from support.fake_engine import LargestFirst
from support.plan_files import tower

import petmjx
from petmjx.common import safe_read

pytestmark = pytest.mark.usefixtures("in_tmp_path")


def test_convert(capsys: pytest.CaptureFixture[str]) -> None:
    plans = {"A": tower(2), "B": tower(1), "bad": []}
    write(Path("plans.json"), plans)
    assert run("convert", "plans.json", "-o", "plans.csv") == 0
    out, err = capsys.readouterr()
    assert out == "2 plans (3 boxes) in plans.csv\n"
    assert err == "skipped: plans.json: plan bad: has no placement\n"
    assert run("convert", "plans.csv", "-o", "again.json.gz", "--limit", "1") == 0
    assert json.loads(gzip.decompress(Path("again.json.gz").read_bytes())) == {"A": plans["A"]}
    assert sorted(path.name for path in Path().iterdir()) == ["again.json.gz", "plans.csv", "plans.json"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-o", "plans.txt"], "plans.txt: the name must end in one of .json, .json.gz, .csv, .csv.gz, .parquet"),
        (["-o", "no/such/plans.csv"], "no/such/plans.csv: cannot be written: No such file or directory"),
        (["-o", "p.csv", "--strict"], "plans.json: plan bad: has no placement"),
    ],
)
def test_convert_refuses(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    write(Path("plans.json"), {"A": tower(1), "bad": []})
    assert run("convert", "plans.json", *arguments) == 2
    *_, line = capsys.readouterr().err.splitlines()
    assert line == f"petmjx: {message}"


def test_samples_are_not_written_under_the_name_of_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("samples", "-n", "1", "-o", "plans.csv") == 2
    line = only_line(capsys.readouterr().err)
    assert line == "petmjx: plans.csv: samples are written as JSON; use 'petmjx convert' to make a table"
    assert not Path("plans.csv").exists()


def test_convert_without_a_usable_plan(capsys: pytest.CaptureFixture[str]) -> None:
    write(Path("plans.json"), {"bad": []})
    assert run("convert", "plans.json", "-o", "p.csv") == 2
    assert only_line(capsys.readouterr().err.split("\n", 1)[1]) == "petmjx: no usable plan (1 skipped)"


@pytest.fixture
def pipe() -> Iterator[Callable[[bytes], str]]:
    """Function that returns the name of a pipe, as ``<(…)`` of a shell does, to which a thread writes some bytes."""
    descriptors: list[int] = []
    threads: list[threading.Thread] = []

    def write_to_pipe(content: bytes) -> str:
        reader, writer = os.pipe()
        descriptors.append(reader)
        threads.append(threading.Thread(target=write_all, args=(writer, content)))
        threads[-1].start()
        return f"/dev/fd/{reader}"

    def write_all(writer: int, content: bytes) -> None:
        with os.fdopen(writer, "wb") as stream:
            time.sleep(0.05)  # the reader finds the pipe empty at first
            stream.write(content)

    yield write_to_pipe
    for thread in threads:
        thread.join()
    for descriptor in descriptors:
        os.close(descriptor)


@pytest.mark.parametrize("form", [".json", ".json.gz", ".csv", ".csv.gz", ".parquet"])
def test_pipes_that_the_command_line_names_are_read(form: str, pipe: Callable[[bytes], str]) -> None:
    plans = {f"P{number}": tower(2) for number in range(300)}  # the text is larger than a pipe
    write(Path("plans.json"), plans)
    if form != ".json":
        assert run("convert", "plans.json", "-o", f"plans{form}") == 0
    assert run("convert", pipe(Path(f"plans{form}").read_bytes()), "-o", "again.json") == 0
    assert json.loads(Path("again.json").read_text()) == plans


def test_orders_and_items_are_read_from_pipes(pipe: Callable[[bytes], str]) -> None:
    orders = pipe(b"article,quantity\na,2\nb,1\n")
    items = pipe(b"article,length_mm,width_mm,height_mm,weight_kg\na,400,300,200,5\nb,600,400,200,8\n")
    assert run("convert", orders, "--orders", "--items", items, "-o", "orders.json") == 0
    (order,) = json.loads(Path("orders.json").read_text()).values()
    assert [item["length/mm"] for item in order["item_sequence"].values()] == [400, 400, 600]


def test_a_fifo_without_a_writer_is_refused(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(safe_read, "_WRITER_S", 0.1)
    os.mkfifo("plans.json")
    assert run("convert", "plans.json", "-o", "again.json") == 2
    skipped, _ = capsys.readouterr().err.splitlines()
    assert skipped == "skipped: plans.json: cannot be read (it is a FIFO to which no program writes)"
    with pytest.raises(petmjx.InputError, match="it is a FIFO, not a file"):
        petmjx.score("plans.json")


@pytest.mark.parametrize("is_fifo", [False, True])
def test_an_empty_pipe_is_an_empty_file(
    is_fifo: bool, pipe: Callable[[bytes], str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(safe_read, "_WRITER_S", 60.0)
    name = "plans.json"
    if is_fifo:
        os.mkfifo(name)
        writer = threading.Thread(target=Path(name).write_bytes, args=(b"",))
        writer.start()
    else:
        reader, writing_end = os.pipe()
        os.close(writing_end)
        name = f"/dev/fd/{reader}"
    start_s = time.monotonic()
    assert run("convert", name, "-o", "again.json") == 2
    assert time.monotonic() - start_s < 30
    if is_fifo:
        writer.join()
    else:
        os.close(reader)
    skipped, _ = capsys.readouterr().err.splitlines()
    assert skipped == f"skipped: {name}: the file is empty"


def test_a_dash_is_no_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("convert", "-", "-o", "again.json") == 2
    line = only_line(capsys.readouterr().err)
    assert line == 'petmjx: argument 2 is "-", which is not supported: name a file, or /dev/stdin or /dev/stdout'


@pytest.mark.parametrize("command", [("convert", "plans.json"), ("samples", "-n", "1", "--packer", "baseline")])
def test_standard_output_has_nothing_but_the_plans(command: tuple[str, ...]) -> None:
    write(Path("plans.json"), {"A": tower(2)})
    for out in ("/dev/stdout", "--out=/dev/fd/1") if command[0] == "convert" else ("--out=/dev/fd/1",):
        process = run_process(*command, *(("-o", out) if out.startswith("/") else (out,)))
        assert process.returncode == 0
        assert len(json.loads(process.stdout)) == 1
        assert "1 plan" in process.stderr


# Options and paths that do not say what the user means.


@pytest.mark.parametrize(
    ("option", "line"),
    [
        ("--limit=1e3", "--limit must be a whole number, got '1e3'"),
        ("--density=much", "--density must be a finite number, got 'much'"),
    ],
)
def test_a_value_of_a_wrong_type_is_named(option: str, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    write(Path("plans.json"), {"A": tower(1)})
    assert run("convert", "plans.json", option, "-o", "again.json") == 2
    assert only_line(capsys.readouterr().err).startswith(f"petmjx: {line} (see ")


@pytest.mark.parametrize("form", [".json", ".csv", ".parquet"])
def test_options_for_files_of_other_tools_are_named_where_they_have_no_effect(
    form: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write(Path("plans.json"), {"A": tower(1)})
    if form != ".json":
        assert run("convert", "plans.json", "-o", f"plans{form}") == 0
    write(Path("other.json"), [{"size": [400, 300, 200], "position": [0, 0, 0]}])
    capsys.readouterr()
    assert run("convert", f"plans{form}", "other.json", "--up", "z", "--density", "200", "-o", "both.json") == 0
    (note,) = [line for line in capsys.readouterr().err.splitlines() if "no effect" in line]
    assert note == (
        f"note: --up and --density have no effect on plans{form}, since it is in petmjx's own form, with z upwards"
    )
    assert run("info", f"plans{form}", "other.json", "--up", "z", "--density", "200") == 0
    assert capsys.readouterr().out.count(note.removeprefix("note: ")) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        petmjx.load_plans(f"plans{form}", units="mm", anchor="corner")
    with pytest.warns(petmjx.PlanWarning, match="^sizes has no effect on plans"):
        petmjx.load_plans(f"plans{form}", sizes="placed")


def test_info_tells_repeated_plans_from_orders(capsys: pytest.CaptureFixture[str]) -> None:
    write(Path("plans.json"), {"A": tower(1)})
    assert run("convert", "plans.json", "-o", "plans.parquet") == 0
    capsys.readouterr()
    assert run("info", "plans.json", "plans.parquet") == 0
    *_, form, skipped = capsys.readouterr().out.splitlines()
    assert form == "plans.parquet: petmjx's own form; 0 plans, 0 boxes"
    assert skipped.split(maxsplit=1) == ["skipped", "plan A: repeated plan id, first used in plans.json"]


def test_a_file_of_a_run_is_no_file_of_plans(capsys: pytest.CaptureFixture[str]) -> None:
    plan = petmjx.Plan.from_boxes("A", size_mm=[[400, 300, 200]], corner_mm=[[0, 0, 0]], mass_kg=[5])
    petmjx.score(plan, engine=LargestFirst(), out="run")
    for name in ("run/run.json", "run/worlds/part-00000.parquet"):
        assert run("convert", name, "-o", "again.json") == 2
        assert only_line(capsys.readouterr().err) == f"petmjx: {name}: belongs to a run: name the run's folder, run"


@pytest.mark.parametrize("columns", ["0", "7", "40"])
def test_a_narrow_terminal_hides_no_verdict(
    columns: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    write(Path("plans.json"), {"A": tower(1)})
    assert run("score", "plans.json", "--engine", "mujoco", "--out", "run") == 0
    assert "stable" in capsys.readouterr().out
