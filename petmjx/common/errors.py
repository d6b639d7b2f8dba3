"""Errors that users can correct. The text of each error is one clear line, and the command line shows no traceback."""

from __future__ import annotations


class PetmjxError(Exception):
    """Base class of all errors that petmjx raises on purpose. The text is one line that tells the user what to do."""


class InputError(PetmjxError):
    """Error for unusable plans, sweep files or options. The command line then ends with exit code 2."""


class PlanWarning(UserWarning):
    """Warning that a plan seems to use different units or conventions than petmjx, or that a leaderboard does not rate
    an entry."""


class EngineUnavailable(PetmjxError):
    """An engine cannot run on this machine. The error's text gives the reason."""


def is_out_of_memory(error: Exception) -> bool:
    """Whether an error reports that memory ran out: device memory in an error of JAX, XLA or Warp, host memory in an
    error of Python."""
    text = str(error).lower()
    return isinstance(error, MemoryError) or any(
        words in text for words in ("resource_exhausted", "out of memory", "failed to allocate")
    )
