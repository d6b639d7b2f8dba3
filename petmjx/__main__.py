"""``python -m petmjx`` and the installed command ``petmjx``."""

from __future__ import annotations

import sys
from collections.abc import Sequence


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


if __name__ == "__main__":
    sys.exit(main())
