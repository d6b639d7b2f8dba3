"""Commands with workers that a signal ends: they print one line, leave nothing behind, and can be resumed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path

import pytest
from support.command_line import TOWER, write
from support.interrupted_commands import INTERRUPT_AFTER
from support.waiting import wait_for

import petmjx

pytestmark = pytest.mark.skipif(find_spec("ray") is None, reason="Ray is not installed (extra: ray)")


_INTERRUPTED = f"""
import sys, time
from petmjx.cli import main
from petmjx.engines.remote.worker_pool import WorkerPool

whole_run = WorkerPool.run

def interrupted_run(*arguments):
    for number, outcome in enumerate(whole_run(*arguments), 1):
        yield outcome
        if number == {INTERRUPT_AFTER}:
            print("some are done", file=sys.stderr, flush=True)
            time.sleep(60)  # the signal ends this

WorkerPool.run = interrupted_run
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_a_command_with_workers_and_it_goes_on_without(
    number: signal.Signals, code: int, tmp_path: Path
) -> None:
    """Ctrl-C in a terminal sends the signal to the whole process group, including the processes of Ray."""
    plans = write(tmp_path / "plans.json", {f"p{k:03}": TOWER for k in range(30)})
    options = ["--engine", "mujoco", "--out", str(tmp_path / "o"), "--workers", "1", "--threads", "1"]
    command = [sys.executable, "-c", _INTERRUPTED, "score", str(plans), *options]
    # SIGTERM also ends the head of the cluster, to which Ray wants to report for 5 s
    environment = {**os.environ, "RAY_task_events_shutdown_flush_timeout_ms": "200"}
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment, start_new_session=True) as child:
        assert child.stderr is not None
        heads = []
        for line in child.stderr:
            if line == "some are done\n":
                break
            heads.append(line)
        os.killpg(child.pid, number)
        stderr = child.stderr.read()
    assert child.returncode == code, stderr
    assert any(line.startswith("engine mujoco (as asked for, in 1 worker)") for line in heads)
    assert "Traceback" not in stderr
    interrupted = petmjx.load_run(tmp_path / "o")
    done = len(interrupted.worlds)
    assert f"interrupted: {done} of 30 plans are done" in stderr
    assert interrupted.info["status"] == "interrupted"
    assert INTERRUPT_AFTER <= done < 30
    results = petmjx.score(plans, out=tmp_path / "o", engine="mujoco", resume=True)
    assert len(results.worlds) == 30


def test_a_signal_while_ray_starts_leaves_nothing(tmp_path: Path) -> None:
    plans = write(tmp_path / "plans.json", {"p": TOWER})
    command = [sys.executable, "-m", "petmjx", "score", str(plans), "--engine", "mujoco", "--out", str(tmp_path / "o")]
    with tempfile.TemporaryDirectory(prefix="t", dir="/tmp") as short:
        environment = {**os.environ, "TMPDIR": short}
        with subprocess.Popen(
            [*command, "--workers", "1"], stderr=subprocess.PIPE, text=True, env=environment
        ) as child:
            wait_for(lambda: any(Path(short).iterdir()))
            time.sleep(0.5)  # Ray takes longer than this to start
            child.send_signal(signal.SIGTERM)
            _, stderr = child.communicate()
        assert child.returncode == 143
        assert stderr == "petmjx: interrupted: before the first plan was finished; nothing was written\n"
        assert not any(Path(short).iterdir())
        # processes that were just killed may take a moment to end
        wait_for(lambda: not [process for process in Path("/proc").glob("[0-9]*/cmdline") if short in _text(process)])


def _text(path: Path) -> str:
    """The text of a file; empty if the file does not exist any more."""
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""
