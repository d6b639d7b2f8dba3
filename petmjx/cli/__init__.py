"""The command line. It is quick to import: commands import what they need when they run."""

from __future__ import annotations

from petmjx.cli.main import main

__all__ = ["main"]
