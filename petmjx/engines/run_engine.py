"""The engine of a run: the user's own engine, an engine with a given name (in workers if requested), or the fastest
engine for ``auto``.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Final

from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.common.machine import cpu_threads, cuda_devices
from petmjx.common.processes import defer_signals
from petmjx.engines.cost_model import MEASURED, Costs, Work
from petmjx.engines.engine_choice import ENGINES, Choice, choose, make_engine, options_of
from petmjx.engines.gpu_start import begin_builds, compile_ahead, start_gpu
from petmjx.engines.machine_speed import costs_here
from petmjx.engines.protocol import Engine, MinimalEngine
from petmjx.engines.user_engine import UserEngine
from petmjx.options.run_options import AUTO, RunOptions
from petmjx.options.simulation import Simulation

if TYPE_CHECKING:
    from petmjx.engines.remote.worker_choice import WorkerStartup

WORTH_A_GPU: Final = 4 << 20
"""If plan files have at least this size, in bytes (about 400 plans), ``auto`` will use a GPU if there is one."""


@contextmanager
def engine_warmup(options: RunOptions, plans: object, sim: Simulation) -> Iterator[WorkerStartup | None]:
    """Prepares the engine while plans are read. If ``mjx-warp`` will be the engine of this process, the context starts
    JAX and Warp on the GPU and compiles kernels. If workers are requested, the context starts them, and yields the
    started workers for ``resolve_engine``. Starting libraries and workers is mostly waiting, so plans are read
    meanwhile."""
    if options.asked_workers is not None and isinstance(options.engine, str):
        from petmjx.engines.remote.worker_choice import WorkerStartup  # for runs with workers only

        startup = WorkerStartup(options, worth_gpus=bytes_of_plans(plans) >= WORTH_A_GPU)
        try:
            yield startup
        except BaseException:
            startup.give_up()
            raise
        return
    thread = None
    if may_use_gpu(options, plans):
        thread = threading.Thread(target=_start_if_gpu, args=(sim,), name="petmjx-start")
        thread.start()
    # if the caller raises an error here, such as one about plans, it is reported at once: the thread is not joined
    yield None
    if thread is not None:
        thread.join()


def may_use_gpu(options: RunOptions, plans: object) -> bool:
    """Whether the engine of this process will be ``mjx-warp`` if there is a GPU."""
    if not isinstance(options.engine, str) or options.engine not in (AUTO, "mjx-warp"):
        return False
    return options.engine != AUTO or bytes_of_plans(plans) >= WORTH_A_GPU


def _start_if_gpu(sim: Simulation) -> None:
    if cuda_devices():  # asking the GPU's driver takes time, too, so this thread does it
        builds = begin_builds(sim)
        start_gpu()
        # Another thread waits for the kernels and loads them, while worlds are made.
        threading.Thread(target=compile_ahead, args=(sim, builds), name="petmjx-kernels").start()


def bytes_of_plans(plans: object) -> int:
    """Total size of plan files, and of the files in folders, in bytes; 0 for anything else than paths."""
    several = plans if isinstance(plans, list | tuple) else [plans]
    paths = [Path(source) for source in several if isinstance(source, str | PathLike)]
    with suppress(OSError, ValueError):
        return sum(file.stat().st_size for path in paths for file in (path.iterdir() if path.is_dir() else [path]))
    return 0


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
    """The engine of a run, ready to use, and the reason for choosing it. ``auto`` ignores an option (threads or lanes)
    that its engine does not have.

    Args:
        costs: costs of the engines; None: the measured ones, scaled to the speed of this machine.
        startup: the workers that ``engine_warmup`` has already started for these options.
        hands_over: whether an engine that ``auto`` chooses may hand worlds over to another one (``HandoverEngine``).
        earlier: the engine of the run before it was resumed. ``auto`` keeps this engine, although the machine may be
            busier now.

    Raises:
        InputError, EngineUnavailable: see ``make_engine``. InputError is also raised for workers with a user's own
            engine.
    """
    requested_engine = options.engine
    if not isinstance(requested_engine, str):
        if isinstance(requested_engine, type) or not isinstance(requested_engine, MinimalEngine):
            raise InputError(
                f"engine must be a name or an object with a name and a method run, {shown_value(requested_engine)}"
            )
        if options.asked_workers is not None:
            raise InputError(
                "workers need the name of an engine, not an engine object: each worker builds its own engine"
            )
        return UserEngine(requested_engine, options.threads), Choice(requested_engine.name, "given")
    if options.asked_workers is not None:
        from petmjx.engines.remote.worker_choice import resolve_workers  # for runs with workers only

        return resolve_workers(options, work, costs or MEASURED, startup)
    threads = options.threads or cpu_threads()
    # Measuring the speed of CPU threads takes 0.3 s. If a GPU simulates, this speed is irrelevant.
    costs = costs or (MEASURED if requested_engine == "mjx-warp" else costs_here(work, threads))
    seconds = costs.seconds(work, threads)
    if requested_engine != AUTO:
        name, reason = requested_engine, "as asked for"
    elif earlier in ENGINES:
        name, reason = earlier, "as before"
    else:
        name, reason = choose(seconds, threads, compiles=costs.kernel_start_s > costs.kernel_load_s)
    engine, choice = make_engine(name, **options_of(name, options)), Choice(name, reason, seconds.get(name))
    if hands_over and requested_engine == AUTO and name == "mujoco" and options.world_timeout_s is None:
        from petmjx.engines.mujoco_to_warp_handover import HandoverEngine
        from petmjx.engines.mujoco.engine import MujocoEngine  # imported here, since it loads MuJoCo

        kernels = "mjx-warp-cpu"
        assert isinstance(engine, MujocoEngine)
        return HandoverEngine(engine, lambda: make_engine(kernels, **options_of(kernels, options)), costs), choice
    return engine, choice
