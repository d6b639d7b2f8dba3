"""Engines by name, and the one that ``auto`` stands for: the one that should finish first."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from petmjx.engines.base import Engine
from petmjx.errors import EngineUnavailable, InputError
from petmjx.machine import why_no_warp
from petmjx.run_options import AUTO, RunOptions
from petmjx.text import counted

ENGINES: dict[str, tuple[str, str]] = {
    "mujoco": ("petmjx.engines.cpu.engine", "MujocoEngine"),
    "mjx-jax": ("petmjx.engines.batch.mjx_jax", "MjxJaxEngine"),
    "mjx-warp": ("petmjx.engines.warp.engine", "MjxWarpEngine"),
}
"""Engine name → module and class. A module is imported only when its engine is used."""


OF_MUJOCO = ("threads", "world_timeout_s")
"""Options that only the engine ``mujoco`` has."""


@dataclass(frozen=True)
class Choice:
    """An engine's name, why it was chosen (one line), and the expected time in s (None: not known)."""

    name: str
    reason: str
    seconds: float | None = None


def options_of(name: str, options: RunOptions) -> dict[str, Any]:
    """The arguments of ``make_engine`` that a run has for an engine. With ``auto`` only those that the engine has."""
    limits = {option: getattr(options, option) for option in (*OF_MUJOCO, "lanes")}
    if options.engine == AUTO:
        for option in ("lanes",) if name == "mujoco" else OF_MUJOCO:
            del limits[option]
    return limits


def choose(
    seconds: dict[str, float], threads: int, gpus: int = 1, why_no_gpu: Callable[[], str | None] | None = None
) -> tuple[str, str]:
    """The engine ``auto`` stands for, and why.

    Args:
        seconds: expected time of each engine, s.
        threads: CPU threads that ``mujoco`` would use.
        gpus: that ``mjx-warp`` would use.
        why_no_gpu: tells why ``mjx-warp`` cannot run; None: whether it can run on this machine.
    """
    cpu_s, gpu_s = seconds["mujoco"], seconds["mjx-warp"]
    cpu, gpu = counted(threads, "CPU thread"), "a GPU" if gpus <= 1 else f"{gpus} GPUs"
    if cpu_s <= gpu_s:
        return "mujoco", f"about {cpu_s:.0f} s on {cpu}, {gpu} would need about {gpu_s:.0f} s"
    if problem := (why_no_gpu or why_no_warp)():
        return "mujoco", f"mjx-warp would be faster but cannot run: {problem}"
    return "mjx-warp", f"about {gpu_s:.0f} s, {cpu} would need about {cpu_s:.0f} s"


def make_engine(
    name: str, *, threads: int | None = None, lanes: int | None = None, world_timeout_s: float | None = None
) -> Engine:
    """Build an engine by name.

    Args:
        threads: CPU threads of ``mujoco``; None: all.
        lanes: worlds at once of the MJX engines; None: as many as each finds good.
        world_timeout_s: longest wall-clock time of an attempt at a world, ``mujoco``; None: no limit.

    Raises:
        InputError: no such engine, or it does not have this option.
        EngineUnavailable: it cannot run here; the line says why.
    """
    check_options(name, threads=threads, lanes=lanes, world_timeout_s=world_timeout_s)
    module_name, class_name = ENGINES[name]
    try:
        module = importlib.import_module(module_name)
    except ImportError as error:
        raise EngineUnavailable(f"engine {name} cannot run here: {error}") from error
    engine: Engine = getattr(module, class_name)(*((threads, world_timeout_s) if name == "mujoco" else (lanes,)))
    return engine


def check_options(name: str, *, threads: int | None, lanes: int | None, world_timeout_s: float | None) -> None:
    """Raises InputError if there is no such engine, or it does not have one of these options."""
    if name not in ENGINES:
        raise InputError(f"unknown engine {name!r}; there are {', '.join(ENGINES)} and {AUTO}")
    on_cpu = name == "mujoco"
    if on_cpu and lanes is not None:
        raise InputError("lanes belong to the MJX engines; the engine mujoco has threads")
    if threads is not None and not on_cpu:
        raise InputError(f"threads belong to the engine mujoco; the engine {name} has lanes")
    if world_timeout_s is not None and not on_cpu:
        raise InputError(f"a world's timeout belongs to the engine mujoco; {name} steps worlds side by side")
