"""The report of ``petmjx doctor``: versions, devices, engines that work here (or why not), folders of caches."""

from __future__ import annotations

import platform
import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from petmjx.basics.caches import Kind, cache_folder, why_no_folder, why_not_written
from petmjx.basics.errors import EngineUnavailable
from petmjx.basics.machine import cpu_name, cpu_threads, cuda_devices, package_versions, why_no_warp
from petmjx.basics.text import counted
from petmjx.engines.choose import ENGINES, make_engine
from petmjx.options.config import Simulation
from petmjx.plans.plan import Plan
from petmjx.verdict import Verdict
from petmjx.world.job import Job
from petmjx.world.scene import build_scene


@dataclass(frozen=True)
class EngineReport:
    """Whether an engine works here, and one line: what it runs on, or why it does not work."""

    name: str
    works: bool
    detail: str


@dataclass(frozen=True)
class Report:
    """Everything the doctor found.

    Attributes:
        versions: package → version, of Python, petmjx and its dependencies.
        devices: CPU and GPUs, one line each.
        engines: one report per engine.
        caches: content of a cache → its folder, and why it is not the one that was asked for.
    """

    versions: dict[str, str]
    devices: tuple[str, ...]
    engines: tuple[EngineReport, ...]
    caches: dict[str, str]


def examine() -> Report:
    """Examine this machine. The engine ``mujoco`` scores a plan of one box, which takes milliseconds."""
    return Report(
        versions={"python": f"{platform.python_version()} ({sys.platform}, {platform.machine()})"} | package_versions(),
        devices=(f"CPU: {cpu_name()}, {counted(cpu_threads(), 'thread')}", *(f"GPU: {n}" for n in cuda_devices())),
        engines=tuple(_examine_engine(name) for name in ENGINES),
        caches=_caches(),
    )


def _examine_engine(name: str) -> EngineReport:
    try:
        return EngineReport(name, True, _CHECKS[name]() if name in _CHECKS else _built(name))
    except (EngineUnavailable, ImportError, RuntimeError, OSError) as error:
        return EngineReport(name, False, " ".join(str(error).split()))


def _built(name: str) -> str:
    make_engine(name)
    return "can be built"


def _check_mujoco() -> str:
    sim = Simulation()
    engine = make_engine("mujoco", threads=1)
    [outcome] = engine.run([Job(build_scene(_one_box(), sim))], sim)
    if outcome.verdict is not Verdict.STABLE:
        raise RuntimeError(f"a single box came out {outcome.verdict.value} {outcome.reason.value}")
    return f"{counted(cpu_threads(), 'CPU thread')}; a single box stands after {counted(outcome.n_steps, 'step')}"


def _check_mjx_jax() -> str:
    import jax

    make_engine("mjx-jax")
    devices = jax.devices()
    return f"jax on {devices[0].platform}: {', '.join(sorted({d.device_kind for d in devices}))}"


def _check_mjx_warp() -> str:
    if problem := why_no_warp():
        raise EngineUnavailable(problem)
    make_engine("mjx-warp")
    return f"Warp on {', '.join(cuda_devices())}"


def _check_mjx_warp_cpu() -> str:
    engine = make_engine("mjx-warp-cpu")
    return f"Warp's kernels on {engine.device}"


_CHECKS: dict[str, Callable[[], str]] = {
    "mujoco": _check_mujoco,
    "mjx-jax": _check_mjx_jax,
    "mjx-warp": _check_mjx_warp,
    "mjx-warp-cpu": _check_mjx_warp_cpu,
}
"""Of other engines it is only known whether they can be built."""


def _one_box() -> Plan:
    return Plan(
        plan_id="doctor",
        source="doctor",
        size_mm=np.array([[300.0, 200.0, 150.0]]),
        corner_mm=np.zeros((1, 3)),
        mass_kg=np.array([5.0]),
        item_ids=("box",),
        articles=("box",),
        sequence=np.array([1], dtype=np.int64),
    )


def _caches() -> dict[str, str]:
    kinds: dict[str, Kind] = {"JAX programs": "jax", "Warp kernels": "warp"}
    return {name: _cache(kind) for name, kind in kinds.items()}


def _cache(kind: Kind) -> str:
    """Where programs are kept, and why not where it was asked for."""
    if why := why_no_folder(kind):
        return why
    why = why_not_written(kind)
    return f"{cache_folder(kind)} (since {why})" if why else str(cache_folder(kind))
