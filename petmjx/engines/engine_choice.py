"""Builds an engine from its name, and chooses the engine for ``auto``: the one that should finish first."""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from petmjx.common.errors import EngineUnavailable, InputError
from petmjx.common.machine import why_no_warp, why_no_warp_on_cpu
from petmjx.common.processes import no_collection
from petmjx.common.text import count_text, one_line
from petmjx.engines.protocol import Engine
from petmjx.options.run_options import AUTO, RunOptions

ENGINES: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "mujoco": ("petmjx.engines.mujoco.engine", "MujocoEngine", ("threads", "world_timeout_s")),
    "mjx-jax": ("petmjx.engines.mjx.engine", "MjxJaxEngine", ("lanes",)),
    "mjx-warp": ("petmjx.engines.warp.gpu_engine", "MjxWarpGpuEngine", ("lanes",)),
    "mjx-warp-cpu": ("petmjx.engines.warp.cpu_engine", "MjxWarpCpuEngine", ("threads",)),
}
"""Engine name → module, class, and the names of its arguments among the options of a run, in order. A module is
imported only when its engine is used."""


def has_option(engine: str, option: str) -> bool:
    """Whether an engine of petmjx has an option of a run."""
    return option in ENGINES[engine][2]


@dataclass(frozen=True)
class Choice:
    """The name of an engine, the reason for choosing it (one line), and the expected time in s (None: unknown)."""

    name: str
    reason: str
    seconds: float | None = None


def options_of(name: str, options: RunOptions) -> dict[str, Any]:
    """The arguments of ``make_engine`` from the options of a run. With ``auto``, only options that the engine has are
    included."""
    of_engine = ENGINES[name][2] if options.engine == AUTO else ("threads", "world_timeout_s", "lanes")
    return {option: getattr(options, option) for option in of_engine}


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


def make_engine(
    name: str, *, threads: int | None = None, lanes: int | None = None, world_timeout_s: float | None = None
) -> Engine:
    """Build the engine with this name.

    Args:
        threads: number of CPU threads of ``mujoco`` or ``mjx-warp-cpu``; None: all threads.
        lanes: number of worlds that ``mjx-jax`` or ``mjx-warp`` simulates at once; None: the engine's own choice.
        world_timeout_s: longest wall-clock time of an attempt at a world, ``mujoco`` only, s; None: the limit follows
            from the expected time of the world.

    Raises:
        InputError: no engine has this name, or the engine does not have one of these options.
        EngineUnavailable: the engine cannot run here; the message gives the reason.
    """
    options = {"threads": threads, "lanes": lanes, "world_timeout_s": world_timeout_s}
    check_options(name, **options)
    module_name, class_name, its_options = ENGINES[name]
    with no_collection(lasting=True):
        try:
            module = importlib.import_module(module_name)
        except ImportError as error:
            raise EngineUnavailable(f"engine {name} cannot run here: {error}") from error
        try:
            engine: Engine = getattr(module, class_name)(*(options[option] for option in its_options))
        except OSError as error:
            raise EngineUnavailable(f"engine {name} cannot run here: {one_line(error)}") from error
    return engine


def check_options(name: str, **options: Any) -> None:
    """Raise InputError if no engine has this name, or if the engine lacks one of these options."""
    if name not in ENGINES:
        raise InputError(f"unknown engine {name!r}; there are {', '.join(ENGINES)} and {AUTO}")
    for option, value in options.items():
        if value is None or has_option(name, option):
            continue
        if option == "world_timeout_s":
            raise InputError(f"only the engine mujoco can limit the time of a world; {name} steps many worlds together")
        owners = " and ".join(engine for engine in ENGINES if has_option(engine, option))
        other = {"threads": "lanes", "lanes": "threads"}[option]
        its_own = f"; the engine {name} has the option {other}" if has_option(name, other) else ""
        raise InputError(f"{option} are an option of the engines {owners}{its_own}")
