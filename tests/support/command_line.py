"""Helpers for tests of the command line: plans, files, runs, and the single line of an error."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from petmjx.cli import main
from support.programs import ended_program

INTERRUPT_AFTER = 10
"""Number of worlds that end before :func:`run_interrupted` interrupts the run."""

_INTERRUPTED = f"""
import os, signal, sys, threading, time
from petmjx.cli import main
from petmjx.engines.mujoco.engine import MujocoEngine

whole_run = MujocoEngine.run

def interrupted_run(*arguments):
    for number, outcome in enumerate(whole_run(*arguments), 1):
        yield outcome
        if number == {INTERRUPT_AFTER}:
            threading.Thread(target=send).start()
            time.sleep(10)  # the first signal ends this

def send():
    for number in sys.argv[1].split(","):
        os.kill(os.getpid(), int(number))
        time.sleep(0.02)

MujocoEngine.run = interrupted_run
# what started the tests may have had signals ignored (nohup), and a process hands that on
signal.signal(signal.SIGINT, signal.default_int_handler)
for number in (signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_DFL)
sys.exit(main(sys.argv[2:]))
"""


def placement(corner: Sequence[float], **item: Any) -> dict[str, Any]:
    """A box of 400 × 300 × 200 mm and 5 kg as in plan files. ``item``: other fields of the box's item."""
    size = {"length/mm": 400, "width/mm": 300, "height/mm": 200}
    fields = {"article": "carton", "id": "1", "product_group": "test", **size, "weight/kg": 5.0, "sequence": 1, **item}
    return {"item": fields, "orientation": 0, "flb_coordinates": list(corner)}


TOWER = [placement((0, 0, 0)), placement((0, 0, 200))]
OVERHANG = [placement((0, 0, 0)), placement((260, 0, 200))]
"""A tower that stands, and a plan with a box that falls, since more than half of this box overhangs."""


def write(path: Path, content: object) -> Path:
    path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return path


def run(*arguments: str | Path) -> int:
    return main([str(argument) for argument in arguments])


def run_process(*arguments: str | Path, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run petmjx in a process of its own. ``options`` are those of ``subprocess.run``."""
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}
    return subprocess.run([sys.executable, "-m", "petmjx", *map(str, arguments)], text=True, check=False, **streams)


def run_with_closed(descriptor: int, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run petmjx in a process whose stdout (1) or stderr (2) is closed. A shell closes it: Python would fork this
    process to do so, which JAX's threads do not survive."""
    command = ["sh", "-c", f'exec "$@" {descriptor}>&-', "sh", sys.executable, "-m", "petmjx", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def run_interrupted(
    *arguments: str | Path, signals: Sequence[int] = (signal.SIGINT,)
) -> subprocess.CompletedProcess[str]:
    """Run petmjx in a process that gets signals (SIGINT, as from Ctrl-C), one right after another, while the threads of
    the engine simulate further worlds."""
    numbers = ",".join(str(int(number)) for number in signals)
    with TemporaryDirectory() as folder:
        return ended_program(_INTERRUPTED, numbers, *map(str, arguments), folder=Path(folder), timeout_s=120)


def only_line(stderr: str) -> str:
    """The error message, which must be a single line."""
    lines = stderr.strip().splitlines()
    assert len(lines) == 1, stderr
    assert lines[0].startswith("petmjx: ")
    return lines[0]
