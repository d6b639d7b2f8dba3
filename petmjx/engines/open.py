"""Worlds that stay open: what an engine offers to those who ask about one placement after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol

from petmjx.units import FloatArray
from petmjx.verdict import Flag, Outcome
from petmjx.world.job import Drive
from petmjx.world.scene import Scene

MOST_BOXES: Final = 96
"""Boxes for which an open world has room, unless it is told otherwise: those of the small lanes of mjx-warp."""


@dataclass(frozen=True, eq=False)
class Reading:
    """An open world as it is now.

    Attributes:
        time_s: since its soft start.
        ended: it has failed and does not go on: a box has dropped, or the simulation was given up.
        pos, quat: (k, 3) middles of the placed boxes, m, and (k, 4) orientations (w, x, y, z).
        top_force_n: (k,) force on each box's top in the last step, N.
        culprit: the first box that has crossed a threshold; -1: none has.
    """

    time_s: float
    ended: bool
    flags: Flag
    pos: FloatArray
    quat: FloatArray
    top_force_n: FloatArray
    culprit: int


class OpenWorlds(Protocol):
    """Worlds that go on independently, and keep their states between calls.

    A world goes on by the rules of the placement (docs/rules.md): each of its boxes is placed when those before it
    rest, and when the last one rests it pauses. Then more boxes can be put into it. What a world does depends on its
    scene alone: neither on other worlds, nor on how many calls its boxes came in.
    """

    def reset(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None:
        """Begin worlds anew with these scenes, which may have no boxes yet."""
        ...

    def put(self, worlds: Sequence[int], scenes: Sequence[Scene]) -> None:
        """Put boxes into worlds: their scenes, with more boxes behind those that they had.

        Raises:
            ValueError: a world has ended, or has no more boxes.
        """
        ...

    def go_on(self) -> None:
        """Let all worlds go on until they pause or end."""
        ...

    def fork(self, sources: Sequence[int], into: Sequence[int]) -> None:
        """Give worlds the states of others, from which they go on by themselves."""
        ...

    def read(self, worlds: Sequence[int]) -> list[Reading]:
        """How worlds are now."""
        ...

    def finish(self, worlds: Sequence[int], drives: Sequence[Drive | None] | None = None) -> list[Outcome]:
        """What becomes of worlds when nothing more is put into them, by all the rules, with or without a drive. The
        worlds themselves stay as they are. ``Outcome.job`` counts the worlds asked for.

        Raises:
            ValueError: a world has no boxes.
        """
        ...
