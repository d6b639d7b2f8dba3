"""``python -m petmjx`` and the installed command ``petmjx``."""

from __future__ import annotations

import atexit
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import NoReturn

from petmjx.common.processes import collect_rarely


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Args:
        arguments: without the program's name; None: the process's own.
    """
    try:
        from petmjx.cli import main as run
    except KeyboardInterrupt:  # before there is anything that could be interrupted
        print("petmjx: interrupted", file=sys.stderr)
        return 130
    return run(arguments)


def command() -> NoReturn:
    """The command ``petmjx``: run the command line, and end the process with its exit code.

    Python's own end takes a run's memory apart object by object: of 10,003 plans that took 0.2 s, and more with a GPU's
    programs. So the process ends without this work. Functions registered with ``atexit`` are called. And cycles are
    looked for rarely.
    """
    collect_rarely()
    code = main()
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):  # the stream has no reader, is closed, or is None
            stream.flush()
    os._exit(code)


if __name__ == "__main__":
    command()
