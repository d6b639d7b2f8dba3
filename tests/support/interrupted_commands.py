"""Commands that get signals while they run, as from Ctrl-C (``run_interrupted``)."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

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


def run_interrupted(
    *arguments: str | Path, signals: Sequence[int] = (signal.SIGINT,)
) -> subprocess.CompletedProcess[str]:
    """Run petmjx in a process that gets signals (SIGINT, as from Ctrl-C), one right after another, while the threads of
    the engine simulate further worlds."""
    numbers = ",".join(str(int(number)) for number in signals)
    with TemporaryDirectory() as folder:
        return ended_program(_INTERRUPTED, numbers, *map(str, arguments), folder=Path(folder), timeout_s=120)
