"""The engine of open pallets (pallets to which boxes can be added): its choice, the check of its options, and the base
class of objects that hold an engine until they are closed (``Closable``)."""

from __future__ import annotations

from typing import Any, Final

from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.common.machine import why_no_warp
from petmjx.engines.engine_registry import ENGINES, make_engine, options_of
from petmjx.engines.protocol import Engine, MinimalEngine
from petmjx.engines.user_engine import UserEngine
from petmjx.options.carriers import extent_m
from petmjx.options.run_options import AUTO, RunOptions
from petmjx.options.simulation import Check, Schedule, Simulation

MANY_PALLETS: Final = 64
"""Smallest number of pallets for which the engine ``auto`` means ``mjx-warp``, if there is a GPU. Fewer pallets would
not keep the GPU busy."""

MOST_PALLETS: Final = 1_000_000
"""Largest allowed number of pallets. A larger number must be a mistake, because the arrays for the pallets would fill
the memory."""

OF_RUN: Final = ("threads", "lanes")
"""The fields of ``RunOptions`` that pallets accept."""


class Closable:
    """Base class of objects that hold an engine until they are closed. The use of a closed object raises an InputError
    of one line."""

    _is_closed = False

    def _check_open(self) -> None:
        """Raise InputError if the object has been closed."""
        if self._is_closed:
            raise InputError(f"petmjx.{type(self).__name__}: closed; make a new one")


def check_open(sim: Simulation) -> None:
    """Raise InputError if open pallets do not support one of the options."""
    if extent_m(sim.carrier) is None:
        raise InputError(
            f"carrier: the size of {sim.carrier} depends on the whole plan; name a carrier of a fixed size"
        )
    if sim.has_soft:
        raise InputError("soft: soft boxes are not supported on pallets to which boxes are added one by one")
    if sim.check is not Check.ONE_BY_ONE:
        raise InputError(f"check must be 'one-by-one' if boxes are added one by one, got {sim.check}")
    if sim.schedule is not Schedule.ADAPTIVE:
        raise InputError(f"schedule must be 'adaptive' if boxes are added one by one, got {sim.schedule}")


def open_engine(requested_engine: str | Engine, n: int, of_run: dict[str, Any]) -> tuple[Engine, bool]:
    """The engine for n pallets, and whether this call made it."""
    if not isinstance(requested_engine, str) and not hasattr(requested_engine, "open"):
        raise InputError(f"engine must be a name or an engine that has open worlds, {shown_value(requested_engine)}")
    return ready_engine(requested_engine, of_run, gpu=n >= MANY_PALLETS)


def chooses_gpu(requested_engine: str | Engine, n: int) -> bool:
    """Whether the requested engine is a name, and this name stands for an engine on a GPU (``mjx-warp``) for n
    pallets."""
    return isinstance(requested_engine, str) and _name_of(requested_engine, gpu=n >= MANY_PALLETS) == "mjx-warp"


def _name_of(requested_engine: str, *, gpu: bool) -> str:
    """The name of the engine that ``auto`` stands for. Any other name is returned unchanged."""
    if requested_engine != AUTO:
        return requested_engine
    return "mjx-warp" if gpu and why_no_warp() is None else "mujoco"


def ready_engine(requested_engine: str | Engine, of_run: dict[str, Any], *, gpu: bool) -> tuple[Engine, bool]:
    """The engine with the requested name, or the requested engine object, and whether this call made the engine.

    Args:
        gpu: whether ``auto`` stands for ``mjx-warp`` if this engine can run.

    Raises:
        InputError: ``requested_engine`` is neither a name nor an engine, or the engine does not have one of the
            options.
        EngineUnavailable: the engine cannot run here.
    """
    if not isinstance(requested_engine, str):
        if isinstance(requested_engine, type) or not isinstance(requested_engine, MinimalEngine):
            raise InputError(f"engine must be a name or an engine, {shown_value(requested_engine)}")
        engine = (
            requested_engine
            if Engine in type(requested_engine).__mro__
            else UserEngine(requested_engine, of_run.get("threads"))
        )
        return engine, False
    name = _name_of(requested_engine, gpu=gpu)
    if name not in ENGINES:
        raise InputError(f"engine must be one of {', '.join(ENGINES)} and {AUTO}, {shown_value(requested_engine)}")
    return make_engine(name, **options_of(name, RunOptions(engine=requested_engine, **of_run))), True
