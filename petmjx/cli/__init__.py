"""The command line: thin, and quick to import. Commands import what they need when they run."""

from __future__ import annotations

from petmjx.cli.main import main

__all__ = ["main"]
