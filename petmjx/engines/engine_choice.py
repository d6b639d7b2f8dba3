"""Chooses the engine for ``auto``: the one that should finish first."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from petmjx.common.machine import why_no_warp, why_no_warp_on_cpu
from petmjx.common.text import count_text


@dataclass(frozen=True)
class Choice:
    """The name of an engine, the reason for choosing it (one line), and the expected time in s (None: unknown)."""

    name: str
    reason: str
    seconds: float | None = None


GAIN: Final = 1.5
"""The kernels of ``mjx-warp-cpu`` must be faster than ``mujoco`` by this factor, compilation included, to be worth
compiling. Estimates of time may be wrong by this factor, and no plan is simulated while the kernels are compiled."""


def choose(
    seconds: dict[str, float],
    threads: int,
    gpus: int = 1,
    why_no_gpu: Callable[[], str | None] | None = None,
    why_no_kernel: Callable[[], str | None] | None = None,
    *,
    compiles: bool = False,
) -> tuple[str, str]:
    """The engine that ``auto`` chooses, and the reason.

    Args:
        seconds: engine → expected time, s.
        threads: number of CPU threads that ``mujoco`` or ``mjx-warp-cpu`` would use.
        gpus: number of GPUs that ``mjx-warp`` would use.
        why_no_gpu: function that returns the reason why ``mjx-warp`` cannot run, or None. If ``why_no_gpu`` is not
            given, this machine is checked.
        why_no_kernel: as ``why_no_gpu``, for ``mjx-warp-cpu``.
        compiles: whether ``mjx-warp-cpu`` would first have to be compiled.
    """
    cpu, gpu = count_text(threads, "CPU thread"), "a GPU" if gpus <= 1 else f"{gpus} GPUs"
    devices = {"mujoco": cpu, "mjx-warp": gpu, "mjx-warp-cpu": cpu}
    problem_of_gpu = functools.cache(why_no_gpu or why_no_warp)
    problem_of_kernel = why_no_kernel or why_no_warp_on_cpu

    def problem(name: str) -> str | None:
        if name == "mujoco":
            return None
        if name == "mjx-warp":
            return problem_of_gpu()
        return problem_of_kernel() if problem_of_gpu() else "jax uses the GPU"

    needed = {"mjx-warp-cpu": GAIN if compiles else 1.0}
    by_time = sorted(devices, key=lambda name: seconds[name] * needed.get(name, 1.0))
    engine = next(name for name in by_time if problem(name) is None)
    faster = by_time[: by_time.index(engine)]
    if engine == "mujoco" and faster:
        return engine, f"{faster[0]} would be faster but cannot run: {problem(faster[0])}"
    other = "mjx-warp" if engine == "mujoco" else "mujoco"
    on = "" if engine == "mjx-warp" else f" on {cpu}"
    its = other if engine == "mjx-warp-cpu" else devices[other]
    return engine, f"about {seconds[engine]:.0f} s{on}, {its} would need about {seconds[other]:.0f} s"
