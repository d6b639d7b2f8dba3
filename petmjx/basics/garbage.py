"""How often Python looks for objects that refer to each other and that nobody else refers to."""

from __future__ import annotations

import gc
from typing import Final

EVERY: Final = (50_000, 20, 100)
"""Objects more than before after which Python looks among the youngest, and looks after which it does so among older
ones. With its own 700, 10 and 10 it looks through all that JAX and Warp consist of again and again while they start."""


def collect_rarely() -> None:
    """In a process of petmjx's own, not in a user's."""
    gc.set_threshold(*EVERY)
