"""The report of ``petmjx doctor``: versions, devices, whether each engine works on this machine, and folders of
caches."""

from __future__ import annotations

import platform
import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from rich.table import Table
from rich.text import Text

from petmjx.common.compile_caches import Kind, cache_folder, why_no_folder, why_not_written
from petmjx.common.errors import EngineUnavailable
from petmjx.common.machine import cpu_name, cpu_threads, cuda_devices, package_versions, why_no_warp
from petmjx.common.text import count_text
from petmjx.engines.engine_registry import ENGINES, make_engine
from petmjx.engines.verdict import Verdict
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.show.table_layout import line
from petmjx.world.job import Job
from petmjx.world.scene import build_scene


@dataclass(frozen=True)
class EngineReport:
    """Whether an engine works on this machine. ``detail`` is the engine's device, or the reason why the engine does not
    work."""

    name: str
    works: bool
    detail: str


@dataclass(frozen=True)
class Report:
    """The findings of ``petmjx doctor``.

    Attributes:
        versions: name of a package → its version. The packages are Python, petmjx and petmjx's dependencies.
        devices: one line about the CPU, and one about each GPU.
        engines: one report per engine.
        caches: content of a cache → folder of the cache, and a reason if the cache is not in the requested folder.
    """

    versions: dict[str, str]
    devices: tuple[str, ...]
    engines: tuple[EngineReport, ...]
    caches: dict[str, str]


def examine() -> Report:
    """Examine this machine. To check the engine ``mujoco``, a plan with one box is simulated, which takes
    milliseconds."""
    return Report(
        versions={"python": f"{platform.python_version()} ({sys.platform}, {platform.machine()})"} | package_versions(),
        devices=(f"CPU: {cpu_name()}, {count_text(cpu_threads(), 'thread')}", *(f"GPU: {n}" for n in cuda_devices())),
        engines=tuple(_examine_engine(name) for name in ENGINES),
        caches={"JAX programs": _cache("jax"), "Warp kernels": _cache("warp")},
    )


def _examine_engine(name: str) -> EngineReport:
    try:
        return EngineReport(name, True, _CHECKS[name]() if name in _CHECKS else _check_build(name))
    except (EngineUnavailable, ImportError, RuntimeError, OSError) as error:
        return EngineReport(name, False, " ".join(str(error).split()))


def _check_build(name: str) -> str:
    make_engine(name)
    return "can be built"


def _check_mujoco() -> str:
    sim = Simulation()
    engine = make_engine("mujoco", threads=1)
    [outcome] = engine.run([Job(build_scene(_one_box(), sim))], sim)
    if outcome.verdict is not Verdict.STABLE:
        raise RuntimeError(f"a single box got the verdict {outcome.verdict.value} ({outcome.reason.value})")
    return f"{count_text(cpu_threads(), 'CPU thread')}; a single box stands after {count_text(outcome.n_steps, 'step')}"


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
"""Name of an engine → function that checks the engine. For other engines, the doctor only checks whether they can be
built."""


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


def _cache(kind: Kind) -> str:
    """The folder of a cache, and a reason if the cache is not in the requested folder."""
    if fault := why_no_folder(kind):
        return fault
    fault = why_not_written(kind)
    return f"{cache_folder(kind)} (since {fault})" if fault else str(cache_folder(kind))


def doctor_table(report: Report, why_no_pictures: str) -> Table:
    """The report as a table with two columns. Long lines in the second column are wrapped.

    Args:
        why_no_pictures: why nothing can be drawn on this machine; "" if pictures and films can be drawn.
    """
    table = Table(show_header=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, version in report.versions.items():
        table.add_row(name, line(version))
    table.add_section()
    for device in report.devices:
        kind, _, text = device.partition(": ")
        table.add_row(kind, line(text))
    table.add_section()
    for engine in report.engines:
        table.add_row(f"engine {engine.name}", _state(engine.works, engine.detail))
    table.add_row("pictures", _state(not why_no_pictures, why_no_pictures or "drawn without a display"))
    table.add_section()
    for name, folder in report.caches.items():
        table.add_row(f"cache: {name}", line(folder))
    return table


def _state(works: bool, detail: str) -> Text:
    state = Text("works", style="green") if works else Text("not here", style="yellow")
    return Text.assemble(state, ": ", line(detail))
