"""Which engine pallets have, and which options they cannot have.

Objects that hold an engine until they are closed.
"""

from __future__ import annotations

from typing import Any, Final

from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.common.machine import why_no_warp
from petmjx.engines.engine_choice import ENGINES, make_engine, options_of
from petmjx.engines.protocol import Engine, MinimalEngine
from petmjx.engines.run_engine import UserEngine
from petmjx.options.carriers import extent_m
from petmjx.options.run_options import AUTO, RunOptions
from petmjx.options.simulation import Check, Schedule, Simulation

MANY_PALLETS: Final = 64
"""From so many on ``auto`` takes a GPU where there is one: with fewer it is not busy."""

MOST_PALLETS: Final = 1_000_000
"""More are a mistake: their arrays alone would fill the memory."""

OF_RUN: Final = ("threads", "lanes")
"""Of ``RunOptions``, those that pallets have."""


def check_open(sim: Simulation) -> None:
    """Raises InputError for options that open pallets cannot have."""
    if extent_m(sim.carrier) is None:
        raise InputError(f"carrier: {sim.carrier} depends on the whole plan; name one of a fixed size")
    if sim.has_soft:
        raise InputError("soft: pallets that stay open have no soft boxes")
    if sim.check is not Check.ONE_BY_ONE:
        raise InputError(f"check: pallets are built one-by-one, got {sim.check}")
    if sim.schedule is not Schedule.ADAPTIVE:
        raise InputError(f"schedule: pallets that stay open need adaptive, got {sim.schedule}")


def open_engine(asked: str | Engine, n: int, of_run: dict[str, Any]) -> tuple[Engine, bool]:
    """The engine of n pallets, and whether it was made here."""
    if not isinstance(asked, str) and not hasattr(asked, "open"):
        raise InputError(f"engine must be a name or an engine that has open worlds, {shown_value(asked)}")
    return ready_engine(asked, of_run, gpu=n >= MANY_PALLETS)


def ready_engine(asked: str | Engine, of_run: dict[str, Any], *, gpu: bool) -> tuple[Engine, bool]:
    """An engine by name, or one that was given, and whether it was made here.

    Args:
        gpu: whether ``auto`` takes ``mjx-warp`` where it runs.

    Raises:
        InputError: neither a name nor an engine, or an option that it does not have.
        EngineUnavailable: it cannot run here.
    """
    if not isinstance(asked, str):
        if isinstance(asked, type) or not isinstance(asked, MinimalEngine):
            raise InputError(f"engine must be a name or an engine, {shown_value(asked)}")
        engine = asked if Engine in type(asked).__mro__ else UserEngine(asked, of_run.get("threads"))
        return engine, False
    name = asked
    if name == AUTO:
        name = "mjx-warp" if gpu and why_no_warp() is None else "mujoco"
    elif name not in ENGINES:
        raise InputError(f"engine: there are {', '.join(ENGINES)} and {AUTO}, {shown_value(asked)}")
    return make_engine(name, **options_of(name, RunOptions(engine=asked, **of_run))), True


class Closable:
    """Says so in one line when it is used after it has been closed."""

    _is_closed = False

    def _check_open(self) -> None:
        """Raises InputError: it has been closed."""
        if self._is_closed:
            raise InputError(f"petmjx.{type(self).__name__}: closed; make a new one")
