"""Tests of reading in a process of its own: the same plans, records and warnings as in the process of the run."""

from __future__ import annotations

import json
import os
import threading
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support.plans import Box, make_plan, stack

import petmjx
from petmjx.common.errors import InputError, PlanWarning
from petmjx.common.safe_read import named_pipes
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.runs import reading_child, reading_processes
from petmjx.runs.reading_processes import PlanInput, read_here, read_in_processes, read_input
from petmjx.world.edge_distances import EdgeRisk
from petmjx.world.scene import Scene

SIM, OPTIONS = Simulation(), RunOptions(engine="mjx-warp")


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> list[PlanInput | None]:
    """A machine with a GPU, where files of any size are read in a process. The list gets what the process has read."""
    answers: list[PlanInput | None] = []

    def noted(*arguments: Any) -> PlanInput | None:
        answers.append(read_in_processes(*arguments))
        return answers[-1]

    monkeypatch.setattr(reading_processes, "cuda_devices", lambda: ("a GPU",))
    monkeypatch.setattr(reading_processes, "cpu_threads", lambda: 2)
    monkeypatch.setattr(reading_processes, "WORTH_A_PROCESS", 1)
    monkeypatch.setattr(reading_processes, "read_in_processes", noted)
    return answers


def plan_file(folder: Path, plans: list[Plan], name: str = "plans.json") -> Path:
    petmjx.save_plans(plans, folder / name)
    return folder / name


def facts(result: PlanInput) -> list[Any]:
    plan_set = result.plan_set
    arrays = [
        (plan.plan_id, plan.articles, *(getattr(plan, name).tobytes() for name in ("size_mm", "corner_mm", "mass_kg")))
        for plan in plan_set.plans
    ]
    return [arrays, result.records, plan_set.numbers, plan_set.notes, plan_set.skipped, plan_set.conventions]


def test_a_process_reads_the_same(tmp_path: Path, in_process: list[PlanInput | None]) -> None:
    file = plan_file(tmp_path, [make_plan(f"plan {n}", stack(n)) for n in (1, 3, 2)])
    plans = json.loads(file.read_text())
    file.write_text(json.dumps({"faulty": [{"item": 1}], **plans}))
    result = read_input(file, SIM, OPTIONS)
    assert len(in_process) == 1
    assert in_process[0] is not None
    assert facts(result) == facts(read_here(file, SIM, OPTIONS))
    assert [skipped.plan_id for skipped in result.plan_set.skipped] == ["faulty"]
    assert [record.number for record in result.records.values()] == [1, 2, 3]


def test_processes_read_segments_of_a_large_file(
    tmp_path: Path, in_process: list[PlanInput | None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading_processes, "cpu_threads", lambda: 2 * reading_processes.THREADS_EACH)
    overhanging: list[Box] = [((400, 300, 200), (0, 0, 0), 5.0), ((400, 300, 200), (300, 0, 200), 5.0)]
    plans = [make_plan(f"plan {n}", stack(1 + n % 4) if n != 5 else overhanging) for n in range(9)]
    file = plan_file(tmp_path, plans)
    entries = json.loads(file.read_text())
    file.write_text(json.dumps({**entries, "faulty": [{"item": 1}], "last": entries["plan 0"]}))
    result = read_input(file, SIM, OPTIONS)
    assert in_process[0] is not None
    assert facts(result) == facts(read_here(file, SIM, OPTIONS))
    assert result.plan_set.numbers["last"] == 10
    risks = {plan.plan_id: EdgeRisk.INSIDE for plan in result.plan_set.plans} | {"plan 5": EdgeRisk.BEYOND}
    assert result.edge_risks == risks


def test_plans_are_read_once_even_if_their_loads_cannot_be_examined(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def warns(scenes: Sequence[Scene]) -> NDArray[np.int8]:
        warnings.warn("divide by zero", RuntimeWarning, stacklevel=1)
        return np.zeros(len(scenes), np.int8)

    def fails(_: Sequence[Scene]) -> NDArray[np.int8]:
        raise MemoryError

    file = plan_file(tmp_path, [make_plan("one"), make_plan("two")])
    for examine, risks in ((warns, {"one": 0, "two": 0}), (fails, {})):
        monkeypatch.setattr(reading_child, "edge_risks", examine)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            answer = reading_child.answer_to(file, SIM, OPTIONS)
        assert answer is not None
        assert [plan.plan_id for plan in answer.content.plan_set.plans] == ["one", "two"]
        assert answer.edge_risks == risks


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("plans.json", {"up": "y"}),
        ("plans.json", {"items": Path("items.csv")}),
        ("plans.json", {"reading": Path("missing.toml")}),
        ("plans.csv", {}),
        ("plans.parquet", {}),
    ],
)
def test_segments_are_read_as_the_whole_file_is(
    name: str,
    options: dict[str, Any],
    tmp_path: Path,
    in_process: list[PlanInput | None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Options for files of other tools have a note, and the name of a file says what it is."""
    monkeypatch.setattr(reading_processes, "cpu_threads", lambda: 2 * reading_processes.THREADS_EACH)
    file = plan_file(tmp_path, [make_plan(f"plan {n}", stack(2)) for n in range(6)]).rename(tmp_path / name)
    both: list[Any] = []
    for read in (read_here, read_input):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                result: Any = facts(read(file, SIM, OPTIONS.model_copy(update=options)))
            except InputError as error:
                result = str(error)
        both.append((result, [str(warning.message) for warning in caught]))
    assert both[0] == both[1]


def test_an_id_in_two_segments_is_found(
    tmp_path: Path, in_process: list[PlanInput | None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading_processes, "cpu_threads", lambda: 2 * reading_processes.THREADS_EACH)
    file = plan_file(tmp_path, [make_plan(f"plan {n}", stack(2)) for n in range(6)])
    file.write_text(file.read_text().replace("plan 5", "plan 0"))
    result = read_input(file, SIM, OPTIONS)
    assert in_process == [None]
    assert facts(result) == facts(read_here(file, SIM, OPTIONS))
    assert "repeated plan id" in result.plan_set.skipped[0].message


def test_warnings_of_the_process_are_issued_here(tmp_path: Path, in_process: list[PlanInput | None]) -> None:
    centers = [(size, (x + size[0] / 2, y + size[1] / 2, z + size[2] / 2), kg) for size, (x, y, z), kg in stack(3)]
    file = plan_file(tmp_path, [make_plan(f"plan {n}", centers) for n in range(3)])
    with warnings.catch_warnings(record=True) as here:
        warnings.simplefilter("always")
        read_here(file, SIM, OPTIONS)
    with pytest.warns(PlanWarning) as caught:
        read_input(file, SIM, OPTIONS)
    assert in_process[0] is not None
    assert [str(warning.message) for warning in caught] == [str(warning.message) for warning in here] != []


def test_errors_appear_in_the_process_of_the_run(tmp_path: Path, in_process: list[PlanInput | None]) -> None:
    file = tmp_path / "plans.json"
    file.write_text('{"plan": [')
    with pytest.raises(InputError, match=r"plans\.json"):
        read_input(file, SIM, OPTIONS)
    with pytest.raises(InputError, match=r"not JSON at line 1"):
        read_input(file, SIM, OPTIONS.model_copy(update={"strict": True}))
    assert in_process[1:] == [None]


class OwnPath:
    """A user's class of paths that cannot be pickled."""

    def __init__(self, path: Path) -> None:
        self.path, self.lock = path, threading.Lock()

    def __fspath__(self) -> str:
        return str(self.path)


def test_what_a_process_cannot_read_is_read_here(tmp_path: Path, in_process: list[PlanInput | None]) -> None:
    """``/dev/stdin`` is a link, and means another file in another process. The process gets paths by pickle."""
    file = plan_file(tmp_path, [make_plan("plan", stack(2))])
    (tmp_path / "link").symlink_to(file)
    assert len(read_input([tmp_path / "link"], SIM, OPTIONS).plan_set.plans) == 1
    assert in_process == []
    assert len(read_input(OwnPath(file), SIM, OPTIONS).plan_set.plans) == 1
    assert in_process == [None]


def test_a_pipe_beside_a_file_is_read_here(tmp_path: Path, in_process: list[PlanInput | None]) -> None:
    file, text = plan_file(tmp_path, [make_plan("plan", stack(2))]), tmp_path / "pipe.json"
    os.mkfifo(text)
    more = plan_file(tmp_path, [make_plan("other", stack(2))], "other.json").read_bytes()
    writer = threading.Thread(target=text.write_bytes, args=(more,))
    with named_pipes([str(text)]):
        writer.start()
        result = read_input([file, text], SIM, OPTIONS)
    writer.join()
    assert [plan.plan_id for plan in result.plan_set.plans] == ["plan", "other"]
    assert in_process == []


def test_a_file_that_a_process_cannot_read_is_read_here(tmp_path: Path, in_process: list[PlanInput | None]) -> None:
    """For example, the user can be asked here how to read the file."""
    file = plan_file(tmp_path, [make_plan("plan", stack(2))])
    (tmp_path / "empty.json").write_text("")
    result = read_input([file, tmp_path / "empty.json"], SIM, OPTIONS)
    assert in_process == [None]
    assert len(result.plan_set.skipped) == 1


def test_small_files_and_plan_objects_need_no_process(
    tmp_path: Path, in_process: list[PlanInput | None], monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = make_plan("plan", stack(2))
    read_input([plan], SIM, OPTIONS)
    file = plan_file(tmp_path, [plan])
    read_input(file, SIM, RunOptions(engine="mujoco"))
    monkeypatch.setattr(reading_processes, "WORTH_A_PROCESS", file.stat().st_size + 1)
    read_input(file, SIM, OPTIONS)
    assert in_process == []
