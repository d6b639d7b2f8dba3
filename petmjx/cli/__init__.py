"""The command line. It imports quickly, because commands import what they need when they run."""

from __future__ import annotations

from petmjx.cli.main import main

__all__ = ["main"]
