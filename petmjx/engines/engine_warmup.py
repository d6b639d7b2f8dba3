"""Prepares the engine of a run while its plans are read. If a GPU simulates, a thread starts JAX and Warp; if workers
(processes) simulate, the workers are started."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Final

from petmjx.common.machine import cuda_devices
from petmjx.engines.gpu_start import begin_builds, compile_ahead, start_gpu
from petmjx.options.run_options import AUTO, RunOptions
from petmjx.options.simulation import Simulation

if TYPE_CHECKING:
    from petmjx.engines.remote.worker_startup import WorkerStartup

WORTH_A_GPU: Final = 4 << 20
"""If plan files have at least this size, in bytes (about 400 plans), ``auto`` will use a GPU if there is one."""


@contextmanager
def engine_warmup(options: RunOptions, plans: object, sim: Simulation) -> Iterator[WorkerStartup | None]:
    """Prepares the engine while plans are read. If ``mjx-warp`` will be the engine of this process, the context starts
    JAX and Warp on the GPU and compiles kernels. If workers are requested, the context starts them, and yields the
    started workers for ``resolve_engine``. Starting libraries and workers is mostly waiting, so plans are read
    meanwhile."""
    if options.asked_workers is not None and isinstance(options.engine, str):
        from petmjx.engines.remote.worker_startup import WorkerStartup  # imported only for runs with workers

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
    # If the caller raises an error here, such as an error about plans, the code below is skipped. So the error is
    # reported without a wait for the thread.
    yield None
    if thread is not None:
        thread.join()


def may_use_gpu(options: RunOptions, plans: object) -> bool:
    """Whether the engine of this process will be ``mjx-warp`` if there is a GPU."""
    if not isinstance(options.engine, str) or options.engine not in (AUTO, "mjx-warp"):
        return False
    return options.engine != AUTO or bytes_of_plans(plans) >= WORTH_A_GPU


def _start_if_gpu(sim: Simulation) -> None:
    if cuda_devices():  # to ask the GPU's driver takes time, so this start-up thread does it, not the caller
        builds = begin_builds(sim)
        start_gpu()
        # Another thread waits for the kernels and loads them, while worlds are made.
        threading.Thread(target=compile_ahead, args=(sim, builds), name="petmjx-kernels").start()


def bytes_of_plans(plans: object) -> int:
    """Total size in bytes of the plan files that ``plans`` names, and of the files in the folders that it names.
    Objects that are not paths count as 0 bytes."""
    several = plans if isinstance(plans, list | tuple) else [plans]
    paths = [Path(source) for source in several if isinstance(source, str | PathLike)]
    with suppress(OSError, ValueError):
        return sum(file.stat().st_size for path in paths for file in (path.iterdir() if path.is_dir() else [path]))
    return 0
