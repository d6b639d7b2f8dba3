"""The engine of a run: the one that the user gives or names, in workers if asked for, or for ``auto`` the fastest."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from petmjx.checked import got
from petmjx.engines.base import Engine
from petmjx.engines.choose import Choice, choose, make_engine, options_of
from petmjx.engines.cost import MEASURED, Costs, Work
from petmjx.errors import InputError
from petmjx.machine import cpu_threads
from petmjx.run_options import AUTO, RunOptions


@contextmanager
def engine_for(options: RunOptions, work: Work) -> Iterator[tuple[Engine, Choice]]:
    """As ``resolve_engine``; what the engine holds, such as workers, is freed at the end, unless it was given."""
    engine, choice = resolve_engine(options, work)
    try:
        yield engine, choice
    finally:
        if engine is not options.engine and hasattr(engine, "close"):
            engine.close()


def resolve_engine(options: RunOptions, work: Work, costs: Costs = MEASURED) -> tuple[Engine, Choice]:
    """The engine of a run, ready to use, and why it was chosen. ``auto`` ignores the option (threads, lanes) that its
    engine does not have.

    Raises:
        InputError, EngineUnavailable: as ``make_engine``; also workers for an engine of the user's own.
    """
    asked = options.engine
    if not isinstance(asked, str):
        if isinstance(asked, type) or not isinstance(asked, Engine):
            raise InputError(f"engine must be a name or an object with a name and a method run, {got(asked)}")
        if options.asked_workers is not None:
            raise InputError("workers need an engine by name: each of them builds its own")
        return asked, Choice(asked.name, "given")
    if options.asked_workers is not None:
        from petmjx.engines.workers.resolve import resolve_workers  # most runs have none

        return resolve_workers(options, work, costs)
    threads = options.threads or cpu_threads()
    seconds = costs.seconds(work, threads)
    name, reason = choose(seconds, threads) if asked == AUTO else (asked, "as asked for")
    return make_engine(name, **options_of(name, options)), Choice(name, reason, seconds.get(name))
