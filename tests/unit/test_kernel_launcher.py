"""Tests of the loading of a run's kernels."""

from __future__ import annotations

from pathlib import Path
from threading import Barrier
from typing import Any

import pytest

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

import warp as wp

from petmjx.common.warp_cpp import CPU_FLAGS, with_cpp
from petmjx.engines.warp import block_launch
from petmjx.engines.warp.block_launch import Launch, own_kernels
from petmjx.engines.warp.block_pool import BlockPool
from petmjx.engines.warp.kernel_launcher import KernelLauncher

LONG_S = 60
"""Time limit for all threads to begin, s."""


def _tiny(number: int, threads: int, **options: Any) -> Any:
    def fill(values: wp.array[int]) -> None:
        values[wp.tid()] = number  # type: ignore[call-overload]  # one number in a kernel of one dimension

    return with_cpp(fill, f"// {number}\n", threads=threads, **options)


@pytest.mark.parametrize(
    ("flags", "level", "used"), [(None, None, ("-march=native", 3)), ("", 0, ("", 0)), ("-march=native -g", 1, None)]
)
def test_a_kernel_for_cpus_adds_flags_to_those_of_warps_configuration(
    flags: str | None, level: int | None, used: tuple[str, int] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(wp.config, "cpu_compiler_flags", flags)
    monkeypatch.setattr(wp.config, "optimization_level", level)
    options = _tiny(1, 1, optimized_for_cpu=True).module.options
    first, best = used or (flags, level)
    assert (options["cpu_compiler_flags"], options["optimization_level"]) == (f"{first} {CPU_FLAGS}", best)


@pytest.mark.filterwarnings("ignore:.*-march=native")
def test_the_flags_for_cpus_are_known_to_warps_clang(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    kernel = _tiny(2, 1, optimized_for_cpu=True)
    wp.compile_aot_module(kernel.module, device="cpu", module_dir=tmp_path)
    assert list(tmp_path.rglob("*.o"))
    printed = capfd.readouterr()
    assert "unknown" not in printed.out + printed.err


def test_kernels_of_all_sizes_are_compiled_at_the_same_time_and_each_once(monkeypatch: pytest.MonkeyPatch) -> None:
    kernels = {threads: _tiny(threads, threads) for threads in (128, 256)}
    launches = [Launch(1, threads, 1, 256, 2) for threads in (256, 128, 128)]
    modules = {kernel.module for kernel in own_kernels(len(launches))}
    begun, loaded, load = Barrier(2 + len(modules), timeout=LONG_S), [], wp.Module.load

    def watched(module: Any, *args: Any, **options: Any) -> Any:
        begun.wait()  # fails if one thread begins only after another thread has ended
        loaded.append(module)
        return load(module, *args, **options)

    launcher = KernelLauncher.__new__(KernelLauncher)
    launcher.pools = tuple(BlockPool(launch, 1, 8, 1, 80, 64) for launch in launches)
    with monkeypatch.context() as patched:
        patched.setattr(wp.Module, "load", watched)
        patched.setattr(block_launch, "kernel", lambda launch: kernels[launch.threads])
        launcher.load()
    assert len(loaded) == 2 + len(modules)
    assert set(loaded) == {kernels[128].module, kernels[256].module} | modules
    for number, kernel in kernels.items():
        assert kernel.module.execs
        values = wp.zeros(2, int)
        wp.launch(kernel, dim=2, inputs=[values], block_dim=number)
        assert values.numpy().tolist() == [number] * 2
