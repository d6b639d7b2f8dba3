"""The command line. Importing the package is fast, because each command imports its modules only when it runs."""

from __future__ import annotations

from petmjx.cli.main import main

__all__ = ["main"]
