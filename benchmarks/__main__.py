"""The command line of the benchmarks: ``python -m benchmarks list``, and the other commands in
``benchmarks/commands``."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from benchmarks.commands import referees, runs, speed, studies
from benchmarks.commands.app import app
from petmjx.cli.main import run_app

COMMANDS = (runs, studies, speed, referees)
"""The import of these modules adds their commands to ``app``."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    return run_app(lambda _: app, arguments)


if __name__ == "__main__":
    sys.exit(main())
