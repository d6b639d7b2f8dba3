"""Errors that the user can correct. Each error has one clear line; the command line shows no traceback."""

from __future__ import annotations


class PetmjxError(Exception):
    """Base of all errors that petmjx raises on purpose. The text of the error is one line that says what to do."""


class InputError(PetmjxError):
    """Unusable plans, sweep files or options. The command line ends with exit code 2."""


class PlanWarning(UserWarning):
    """A plan that seems to use other units or another convention than petmjx's; or an entry that a leaderboard does not
    rate."""


class EngineUnavailable(PetmjxError):
    """An engine cannot run on this machine. The text says why."""
