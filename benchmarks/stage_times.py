"""Where the time of ``petmjx score`` goes from shell to shell: when each stage of a run in a process of its own ended.

``python -m benchmarks.stage_times plans.json --engine mjx-warp``. With ``--engine instant`` worlds take no time, and
the remaining time is the host's. ``--workers N`` uses workers; then ``instant`` answers in them. Stages are observed
from outside, so the command itself is the one that users run.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.result_fields import append_line, environment

_CHILD = "import time; at = time.time(); from benchmarks.stage_times import score; score(at)"


class Stages:
    """The times at which stages ended, s since the shell's start, and the CPU time of this process until then."""

    def __init__(self, begin: float) -> None:
        self._begin = begin
        self.ended: dict[str, tuple[float, float]] = {}

    def end(self, name: str, at: float | None = None) -> None:
        """Record that a stage ends now, unless it has ended before."""
        self.ended.setdefault(name, ((at or time.time()) - self._begin, time.process_time()))

    def around(self, home: Any, name: str, before: str = "", after: str = "") -> None:
        """Record when a function begins or ends for the first time."""
        inner: Callable[..., Any] = getattr(home, name)

        @functools.wraps(inner)
        def noted(*some: Any, **more: Any) -> Any:
            if before:
                self.end(before)
            answer = inner(*some, **more)
            if after:
                self.end(after)
            return answer

        setattr(home, name, noted)


def score(at: float) -> None:
    """Run the command in this process, and record its stages.

    The arguments of the program: begin, log, plans, engine, workers (may be empty), folder.
    """
    begin, log, plans, engine, workers, folder = sys.argv[1:]
    stages = Stages(float(begin))
    stages.end("interpreter", at)
    from petmjx.cli.main import main

    stages.end("command line")
    from petmjx import api
    from petmjx.engines import engine_of_run
    from petmjx.results.run_writer import RunWriter
    from petmjx.runs import simulate

    stages.end("modules")
    if workers:
        _note_workers(stages, engine)
    elif engine == "instant":
        from benchmarks.instant_engine import Instant
        from petmjx.engines.user_engine import UserEngine

        vars(engine_of_run)["make_engine"] = lambda *some, **more: UserEngine(Instant(), None)
    else:
        _note_slices(stages)
    stages.around(simulate, "read_input", after="plans read")
    stages.around(engine_of_run, "resolve_engine", before="GPU started", after="engine there")
    stages.around(RunWriter, "__enter__", after="folder open")
    stages.around(RunWriter, "add", before="first world final")
    stages.around(RunWriter, "flush", before="last world final", after="worlds on disk")
    stages.around(RunWriter, "__exit__", after="written")
    stages.around(api, "simulate", after="read again")
    name = engine
    if engine == "instant":
        from benchmarks.instant_engine import IN_WORKERS

        name = IN_WORKERS if workers else "mjx-warp"
    of_workers = ["--workers", workers] if workers else []
    sys.argv[1:] = ["score", plans, "--engine", name, *of_workers, "--out", folder]
    import petmjx.__main__ as command

    def shown() -> int:
        code = main()
        stages.end("shown")
        Path(log).write_text(json.dumps(stages.ended))
        return code

    vars(command)["main"] = shown
    command.command()


def _note_workers(stages: Stages, engine: str) -> None:
    """Record the start and the end of workers, and the times of their first jobs."""
    from petmjx.engines.remote import ray_cluster, worker_pool

    if engine == "instant":
        from benchmarks.instant_engine import instant_workers

        vars(worker_pool).update(instant_workers())
    stages.around(ray_cluster, "import_ray", before="Ray asked for")
    stages.around(ray_cluster._LocalRay, "wait_until_started", after="Ray there")
    stages.around(worker_pool.WorkerPool, "_greet", after="first worker ready")
    stages.around(worker_pool.WorkerPool, "_send", before="first jobs made", after="first jobs sent")
    stages.around(worker_pool.WorkerPool, "_take_report", before="first outcome")
    stages.around(worker_pool.WorkerPool, "retire", before="workers not needed")
    stages.around(worker_pool.WorkerPool, "close", before="end of workers waited for", after="workers ended")


def _note_slices(stages: Stages) -> None:
    """Record when the device begins its first slice, and when it has ended its last slice."""
    if not _has_gpu():
        return
    import threading

    def note() -> None:  # the module loads JAX, which must not come before plans are read
        while (module := sys.modules.get("petmjx.engines.warp.time_slices")) is None or not hasattr(module, "Rollout"):
            time.sleep(0.01)
        stages.around(module.Rollout, "start", before="worlds made", after="first slice begun")
        inner = module.Rollout.wait

        def wait(*some: Any) -> Any:
            answer = inner(*some)
            stages.end("first slice ended")
            stages.ended.pop("last slice ended", None)
            stages.end("last slice ended")
            return answer

        module.Rollout.wait = wait

    threading.Thread(target=note, daemon=True).start()


def _has_gpu() -> bool:
    from petmjx.common.machine import cuda_devices

    return bool(cuda_devices())


def measured(plans: str, engine: str, workers: str = "") -> dict[str, Any]:
    """Run the command from a shell. Returns stage → time since the start of the run, s, and the CPU time of the process
    until then. If the run fails, this process ends with the error line and the exit code of the run.
    """
    with tempfile.TemporaryDirectory() as made:
        log = Path(made) / "stages.json"
        begin = time.time()
        given = [repr(begin), str(log), plans, engine, workers, str(Path(made) / "out")]
        done = subprocess.run([sys.executable, "-c", _CHILD, *given], capture_output=True, text=True)
        shell_s = time.time() - begin
        if done.returncode:
            sys.stderr.write(done.stderr)  # the error line of the command
            sys.exit(done.returncode)
        ended = json.loads(log.read_text())
        info = json.loads((Path(made) / "out" / "run.json").read_text())
    sys.stderr.write(done.stderr)
    in_order = dict(sorted(ended.items(), key=lambda entry: float(entry[1][0])))
    return {
        "case": "shell",
        "group": "shell",
        "engine": engine,
        **({"workers": workers} if workers else {}),
        "plans": info["counts"]["worlds"],
        "shell_s": shell_s,
        "engine_wall_s": info["timings"]["wall_s"],
        "ended_s": {name: at for name, (at, _) in in_order.items()},
        "cpu_s": {name: cpu for name, (_, cpu) in in_order.items()},
        "device": info["device"],
        "load": os.getloadavg()[0],
    }


def main() -> None:
    """A line of stages for each run, and a line of results at the end of the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("plans")
    parser.add_argument("--engine", default="instant")
    parser.add_argument("--workers", default="")
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--note", default="")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    for _ in range(arguments.repeats):
        line = measured(arguments.plans, arguments.engine, arguments.workers)
        for name, at in line["ended_s"].items():
            print(f"{at:8.2f} s  {name:20} {line['cpu_s'][name]:8.2f} s of CPU time")
        print(f"{line['shell_s']:8.2f} s  shell; the engine's wall {line['engine_wall_s']:.2f} s", flush=True)
        if arguments.out is not None:
            append_line(
                arguments.out, {**line, **({"note": arguments.note} if arguments.note else {}), **environment()}
            )


if __name__ == "__main__":
    main()
