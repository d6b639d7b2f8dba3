"""The worlds of a run by the chunk: the next one is made while an engine has this one, since a device would wait."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Final, Generic

from petmjx.engines.base import GROUP_WORLDS
from petmjx.engines.worlds import AnyWorld

DEFAULT_CHUNK_WORLDS: Final = 2 * GROUP_WORLDS["mjx-warp"]
"""Most worlds that are made at once."""

CHUNK_BOXES: Final = 1 << 20
"""Boxes of a chunk to which no more worlds are added: 130 MB of scenes, and as much for the next chunk."""


@dataclass(eq=False)
class Chunks(Generic[AnyWorld]):
    """Worlds by the chunk. A thread makes the next one.

    Args:
        most: worlds of a chunk.

    Attributes:
        ended: whether the chunk that was taken last is the last one.
    """

    source: Iterator[AnyWorld]
    most: int = DEFAULT_CHUNK_WORLDS
    ended: bool = False
    _maker: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "petmjx-worlds"))
    _next: Future[list[AnyWorld]] | None = None

    def take(self) -> list[AnyWorld]:
        """The next worlds; an empty list at the end."""
        chunk = self._made() if self._next is None else self._next.result()
        self._next = None if self.ended else self._maker.submit(self._made)
        return chunk

    def take_made(self) -> list[AnyWorld] | None:
        """The same, but None while they are being made. An error of the source is left to ``take``: until then there
        are no more."""
        if self._next is not None and not self._next.done():
            return None
        return self.take() if self._next is not None and self._next.exception() is None else []

    def _made(self) -> list[AnyWorld]:
        chunk, boxes = list[AnyWorld](), 0
        for world in self.source:
            chunk.append(world)
            boxes += world.job.scene.n_boxes
            if self.ended or len(chunk) == self.most or boxes >= CHUNK_BOXES:
                return chunk
        self.ended = True
        return chunk

    def close(self) -> None:
        """Make no more worlds; one that is being made is waited for."""
        self.ended = True
        self._maker.shutdown()
