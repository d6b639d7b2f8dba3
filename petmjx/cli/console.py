"""The console that results are printed on."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

PIPED_WIDTH = 120
"""Columns where standard output is a file or a pipe: wide enough that no table breaks its lines."""


def results_console() -> Console:
    """Standard output; as wide as the terminal, or ``PIPED_WIDTH`` where there is none."""
    from rich.console import Console

    piped = not sys.stdout.isatty() and "COLUMNS" not in os.environ
    return Console(width=PIPED_WIDTH if piped else None)
