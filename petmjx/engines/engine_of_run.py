"""The engine of a run: the user's own engine, an engine with a given name (in workers if requested), or the fastest
engine for ``auto``.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from petmjx.common.deferred_signals import defer_signals
from petmjx.common.machine import cpu_threads
from petmjx.engines.cost_model import MEASURED, Costs
from petmjx.engines.engine_choice import Choice, choose
from petmjx.engines.engine_registry import ENGINES, make_engine, options_of
from petmjx.engines.expected_work import Work
from petmjx.engines.machine_speed import costs_here, with_kept_kernels
from petmjx.engines.protocol import Engine
from petmjx.engines.user_engine import user_engine
from petmjx.options.run_options import AUTO, RunOptions

if TYPE_CHECKING:
    from petmjx.engines.remote.worker_startup import WorkerStartup


@contextmanager
def engine_for(
    options: RunOptions,
    work: Work,
    startup: WorkerStartup | None = None,
    *,
    hands_over: bool = False,
    earlier: str | None = None,
) -> Iterator[tuple[Engine, Choice]]:
    """``resolve_engine`` as a context. The context closes the engine at its end, unless the engine is the user's
    own."""
    engine, choice = resolve_engine(options, work, startup=startup, hands_over=hands_over, earlier=earlier)
    try:
        yield engine, choice
    finally:
        with defer_signals(afterwards=True):  # a second Ctrl-C must not leave a process behind
            engine.close()


def resolve_engine(
    options: RunOptions,
    work: Work,
    costs: Costs | None = None,
    startup: WorkerStartup | None = None,
    *,
    hands_over: bool = False,
    earlier: str | None = None,
) -> tuple[Engine, Choice]:
    """The engine of a run, ready to use, and the reason for choosing it. ``auto`` ignores an option (``threads`` or
    ``lanes``) that the chosen engine does not have.

    Args:
        costs: costs of the engines; None: the measured costs, scaled to the speed of this machine.
        startup: the workers that ``engine_warmup`` has already started for these options.
        hands_over: whether an engine that ``auto`` chooses may hand worlds over to another engine (``HandoverEngine``).
        earlier: if the run is resumed, the engine with which it began. ``auto`` keeps this engine, although the machine
            may be busier now.

    Raises:
        InputError, EngineUnavailable: see ``make_engine``. InputError is also raised if workers are requested and the
            engine is an engine object of the user.
    """
    requested_engine = options.engine
    if not isinstance(requested_engine, str):
        of_user = user_engine(requested_engine, options)
        return of_user, Choice(of_user.name, "given")
    if options.asked_workers is not None:
        from petmjx.engines.remote.worker_startup import resolve_workers  # imported only for runs with workers

        return resolve_workers(options, work, costs or MEASURED, startup)
    threads = options.threads or cpu_threads()
    # For ``mjx-warp``, the speed of CPU threads is irrelevant, so it is not measured: measuring it takes 0.3 s.
    costs = costs or (with_kept_kernels(work) if requested_engine == "mjx-warp" else costs_here(work, threads))
    seconds = costs.seconds(work, threads)
    if requested_engine != AUTO:
        name, reason = requested_engine, "as asked for"
    elif earlier in ENGINES:
        name, reason = earlier, "as before"
    else:
        name, reason = choose(seconds, threads, compiles=costs.kernel_start_s > costs.kernel_load_s)
    engine, choice = make_engine(name, **options_of(name, options)), Choice(name, reason, seconds.get(name))
    if hands_over and requested_engine == AUTO and name == "mujoco" and options.world_timeout_s is None:
        from petmjx.engines.mujoco.engine import MujocoEngine  # imported here, since it loads MuJoCo
        from petmjx.engines.mujoco_to_warp_handover import HandoverEngine

        kernels = "mjx-warp-cpu"
        assert isinstance(engine, MujocoEngine)
        return HandoverEngine(engine, lambda: make_engine(kernels, **options_of(kernels, options)), costs), choice
    return engine, choice
