"""How much of a sweep is simulated at the same time, and what it has cost."""

from __future__ import annotations

from dataclasses import dataclass

from petmjx.engines.retry import DEFAULT_CHUNK_WORLDS


@dataclass(frozen=True)
class Batching:
    """How much of a sweep is in memory and in the engine at the same time. None of it changes a result.

    Attributes:
        undriven: most worlds without a drive in one call of the engine; their states are not kept.
        placements: most settled states that are kept; one with 43 boxes takes 10 to 20 KB.
        worlds: most variants into which these states are forked (a single placement may have more).
        drives: most forked worlds in one call of the engine; in a search the first tests of all its items.
        histories: most settled states whose histories are kept with them; one with 43 boxes takes 1 MB.
    """

    undriven: int = DEFAULT_CHUNK_WORLDS
    placements: int = 4096
    worlds: int = 65_536
    drives: int = 16_384
    histories: int = 256


@dataclass
class Tally:
    """What a sweep has cost so far. Steps are world-steps after the soft start, of each world's last attempt."""

    placements: int = 0
    placement_steps: int = 0
    placement_s: float = 0.0
    drives: int = 0
    drive_steps: int = 0
    drive_s: float = 0.0
