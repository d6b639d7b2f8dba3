"""Kernels are compiled before they are needed, in processes, and runs find them in the cache."""

from __future__ import annotations

import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from support.command_line import only_line, run

from petmjx.common.errors import InputError
from petmjx.engines import gpu_start
from petmjx.engines.kernel_notes import CPU_KERNEL, are_noted
from petmjx.engines.subprocess import kernel_builds
from petmjx.engines.subprocess.kernel_build_child import BuildAnswer, KernelBuild, compile_kernel
from petmjx.engines.subprocess.kernel_builds import KernelBuilds, all_builds, gpu_of, usual_builds
from petmjx.engines.warp.block_sizes import FEW_BOXES, SIZES, USUAL_SIZES
from petmjx.options.simulation import Simulation

H100 = gpu_of(90)


@pytest.fixture
def aot(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, dict[str, Any]]]:
    """A list of the modules that Warp is told to compile, and of the arguments. Nothing is compiled."""
    warp = pytest.importorskip("warp")
    calls: list[tuple[str, dict[str, Any]]] = []
    monkeypatch.setattr(warp, "compile_aot_module", lambda module, **options: calls.append((module.name, options)))
    return calls


def test_a_build_compiles_the_kernel_that_a_run_would_launch(
    aot: list[tuple[str, dict[str, Any]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run chooses its kernel by JAX's device. A build, which has no device, chooses the same kernel by the limits of
    a GPU."""
    from petmjx.engines.warp import block_launch

    device = SimpleNamespace(is_cuda=True, sm_count=132, max_shared_memory_per_block=227 << 10)
    monkeypatch.setattr(block_launch, "launch_device", lambda: device)
    of_run = [block_launch.Launch.of(size, block_launch.Features(lands=True)) for size in USUAL_SIZES]
    monkeypatch.undo()
    monkeypatch.setattr("warp.compile_aot_module", lambda module, **options: aot.append((module.name, options)))
    builds = usual_builds(Simulation(), H100)
    for build in builds:
        compile_kernel(build)
    kernels = {name: options for name, options in aot if "pause" not in name}
    assert {block_launch.kernel(launch).module.name for launch in of_run} == set(kernels)
    assert all(options == {"arch": 90} for options in kernels.values())
    assert sum("pause" in name for name, _ in aot) == len(builds)


def test_other_gpus_and_placing_by_hand_need_other_kernels(aot: list[tuple[str, dict[str, Any]]]) -> None:
    builds = all_builds([H100, gpu_of(89)])
    assert len(set(builds)) == len(builds) == 1 + 2 * 2 * 4
    for build in builds:
        if build.size == SIZES[0]:
            compile_kernel(build)
    names = [name for name, _ in aot if "pause" not in name]
    assert len(set(names)) == len(names) == 4  # an L4 has less shared memory than an H100


def test_a_process_compiles_for_the_cpu(aot: None) -> None:
    """This test starts a real process. Other tests need the compiled kernel, too."""
    (answer,) = KernelBuilds([KernelBuild(None, SIZES[-1], False, True)]).answers()
    assert answer.fault == ""
    (again,) = KernelBuilds([answer.build]).answers()
    assert again.seconds < 10
    assert are_noted(CPU_KERNEL), "auto knows it"


class _Child:
    """A fake process that answers at once. A build of the size ``FEW_BOXES`` kills it."""

    made: list[_Child]

    def __init__(self, module: str) -> None:
        self.answers, self.ended = kernel_builds.queue.SimpleQueue[Any](), False
        self.tasks = SimpleNamespace(put=self._put)
        self.made.append(self)

    def _put(self, data: bytes) -> None:
        build = kernel_builds.pickle.loads(data)
        self.answers.put(None if build.size == FEW_BOXES else BuildAnswer(build, 1.0))

    def end(self) -> None:
        self.ended = True


@pytest.fixture
def children(monkeypatch: pytest.MonkeyPatch) -> list[_Child]:
    _Child.made = []
    monkeypatch.setattr(kernel_builds, "Child", _Child)
    return _Child.made


def test_each_kernel_gets_an_answer_and_no_process_is_left(children: list[_Child]) -> None:
    builds = all_builds([H100, gpu_of(80)])
    answers = list(KernelBuilds(builds).answers())
    assert {answer.build for answer in answers} == set(builds)
    assert len(answers) == len(builds)
    died = "the process that compiled the kernel died"
    assert all(answer.fault == (died if answer.build.size == FEW_BOXES else "") for answer in answers)
    assert all(child.ended for child in children)


def test_a_closed_iterator_ends_the_processes(children: list[_Child]) -> None:
    answers = KernelBuilds(usual_builds(Simulation(), H100)).answers()
    next(answers)
    answers.close()  # type: ignore[attr-defined]
    assert all(child.ended for child in children)


def test_a_note_saves_the_processes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, children: list[_Child]) -> None:
    monkeypatch.setenv("PETMJX_CACHE_DIR", str(tmp_path))
    monkeypatch.delenv("WARP_CACHE_PATH", raising=False)
    monkeypatch.setattr(kernel_builds, "cuda_limits", lambda: (90, 227 << 10))
    assert kernel_builds.builds_if_missing(Simulation()) is not None
    assert len(children) == 3
    kernel_builds.note_kept(Simulation())
    assert kernel_builds.builds_if_missing(Simulation()) is None
    assert kernel_builds.builds_if_missing(Simulation(placing="hand")) is not None  # other kernels
    monkeypatch.setattr(kernel_builds, "cuda_limits", lambda: (89, 99 << 10))
    assert kernel_builds.builds_if_missing(Simulation()) is not None
    monkeypatch.setattr(kernel_builds, "cuda_limits", lambda: None)
    assert kernel_builds.builds_if_missing(Simulation()) is None


def test_what_fails_ahead_is_left_to_the_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu_start, "builds_if_missing", lambda sim: 1 / 0)
    assert gpu_start.begin_builds(Simulation()) is None


def test_unknown_gpus_are_refused() -> None:
    with pytest.raises(InputError, match="got 91"):
        gpu_of(91)


def test_the_command_says_what_it_compiles(
    children: list[_Child], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PETMJX_CACHE_DIR", str(tmp_path))
    monkeypatch.delenv("WARP_CACHE_PATH", raising=False)
    monkeypatch.setattr(kernel_builds, "cuda_limits", lambda: None)
    assert run("warm-up") == 0
    out = capsys.readouterr().out
    assert "no GPU here" in out
    assert "1 of 1  CPU:" in out
    assert "1 kernel in " in out
    assert run("warm-up", "--arch", "90") == 2
    assert "could not be compiled: the process that compiled the kernel died" in only_line(capsys.readouterr().err)
    assert run("warm-up", "--arch", "90,x") == 2
    assert "--arch must be numbers" in only_line(capsys.readouterr().err)


def test_a_program_that_ends_waits_for_no_kernel(children: list[_Child], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_Child, "_put", lambda self, data: None)
    monkeypatch.setattr(threading.main_thread(), "is_alive", lambda: False)
    assert list(KernelBuilds(usual_builds(Simulation(), H100)).answers()) == []
    assert all(child.ended for child in children)
