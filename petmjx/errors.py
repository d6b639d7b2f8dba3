"""Errors that are the user's to mend: one clear line each, never a traceback on the command line."""

from __future__ import annotations


class PetmjxError(Exception):
    """Base of every error petmjx raises on purpose. Its text is one line that says what to do."""


class InputError(PetmjxError):
    """Unusable plans, sweep files or options. The command line ends with exit code 2."""


class EngineUnavailable(PetmjxError):
    """An engine that cannot run on this machine, and why."""
