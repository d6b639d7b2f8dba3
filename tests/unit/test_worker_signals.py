"""Commands with workers that a signal ends: one line, nothing left behind, and a run that goes on."""

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
from support.waiting import wait_for

import petmjx

pytestmark = pytest.mark.skipif(find_spec("ray") is None, reason="Ray is not installed (extra: ray)")


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_a_command_with_workers_and_it_goes_on_without(
    number: signal.Signals, code: int, tmp_path: Path
) -> None:
    """Ctrl-C in a terminal reaches the whole process group, Ray's processes too."""
    plans = write(tmp_path / "plans.json", {f"p{k:03}": TOWER for k in range(150)})
    command = [sys.executable, "-m", "petmjx", "score", str(plans), "--engine", "mujoco", "--out", str(tmp_path / "o")]
    two = [*command, "--workers", "1", "--threads", "1"]
    with subprocess.Popen(two, stderr=subprocess.PIPE, text=True, start_new_session=True) as child:
        assert child.stderr is not None
        for line in child.stderr:
            if line.startswith("engine mujoco (as asked for, in 1 worker)"):
                break
        time.sleep(1)
        os.killpg(child.pid, number)
        stderr = child.stderr.read()
    assert child.returncode == code, stderr
    assert "Traceback" not in stderr
    interrupted = petmjx.load_run(tmp_path / "o")
    done = len(interrupted.worlds)
    are = "is" if done == 1 else "are"
    assert f"interrupted: {done} of 150 plans {are} done" in stderr
    assert interrupted.info["status"] == "interrupted"
    assert 0 < done < 150
    results = petmjx.score(plans, out=tmp_path / "o", engine="mujoco", resume=True)
    assert len(results.worlds) == 150


def test_a_signal_while_ray_starts_leaves_nothing(tmp_path: Path) -> None:
    plans = write(tmp_path / "plans.json", {"p": TOWER})
    command = [sys.executable, "-m", "petmjx", "score", str(plans), "--engine", "mujoco", "--out", str(tmp_path / "o")]
    with tempfile.TemporaryDirectory(prefix="t", dir="/tmp") as short:
        environment = {**os.environ, "TMPDIR": short}
        with subprocess.Popen(
            [*command, "--workers", "1"], stderr=subprocess.PIPE, text=True, env=environment
        ) as child:
            wait_for(lambda: any(Path(short).iterdir()))
            time.sleep(0.5)
            child.send_signal(signal.SIGTERM)
            _, stderr = child.communicate()
        assert child.returncode == 143
        assert stderr == "petmjx: interrupted: before the first plan was finished; nothing was written\n"
        assert not any(Path(short).iterdir())
        assert not [process for process in Path("/proc").glob("[0-9]*/cmdline") if short in _text(process)]


def _text(path: Path) -> str:
    """A file's text; empty if it is gone."""
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""
