"""The command line. The package imports quickly: each command imports its modules when it runs."""

from __future__ import annotations

from petmjx.cli.main import main

__all__ = ["main"]
