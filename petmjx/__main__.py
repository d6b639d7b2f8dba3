"""``python -m petmjx`` and the installed command ``petmjx``."""

from __future__ import annotations

import atexit
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import NoReturn


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Args:
        arguments: the arguments without the program's name; None: the arguments of the process.
    """
    try:
        from petmjx.cli import main as run
    except KeyboardInterrupt:  # Ctrl-C was pressed while modules were being imported
        return _interrupted()
    return run(arguments)


def _interrupted() -> int:
    print("petmjx: interrupted", file=sys.stderr)
    return 130


def command() -> NoReturn:
    """The command ``petmjx``: run the command line, and end the process with its exit code.

    Python's normal exit frees the memory of a run object by object. For 10,003 plans, freeing memory took 0.2 s, and
    longer when programs of a GPU were loaded. So the process exits without freeing this memory; functions registered
    with ``atexit`` are still called. While the command runs, the garbage collector searches for cycles only rarely,
    which also saves time.
    """
    try:
        from petmjx.common.garbage_collection import collect_rarely
        from petmjx.common.processes import claim_process

        claim_process()
        collect_rarely()
    except KeyboardInterrupt:
        code = _interrupted()
    else:
        code = main()
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):  # the stream is closed, missing, or without a reader
            stream.flush()
    os._exit(code)


if __name__ == "__main__":
    command()
