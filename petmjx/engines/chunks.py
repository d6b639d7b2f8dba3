"""Items in chunks, of which the next one is made while the last one is worked on."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

Item = TypeVar("Item")


class Chunks(Generic[Item]):
    """The items of an iterator, by the chunk. When a full chunk has been taken, a thread makes the next one.

    Args:
        most: items of a chunk.
    """

    def __init__(self, source: Iterator[Item], most: int) -> None:
        self._source, self._most = source, most
        self._closed = False
        self._maker: ThreadPoolExecutor | None = None
        self._next: Future[list[Item]] | None = None

    def take(self) -> list[Item]:
        """The next items; an empty list at the end. What making them raises is raised here."""
        chunk = self._made() if self._next is None else self._next.result()
        self._next = None
        if len(chunk) == self._most:
            self._maker = self._maker or ThreadPoolExecutor(1, "petmjx-chunks")
            self._next = self._maker.submit(self._made)
        return chunk

    def _made(self) -> list[Item]:
        chunk: list[Item] = []
        while len(chunk) < self._most and not self._closed:
            try:
                chunk.append(next(self._source))
            except StopIteration:
                break
        return chunk

    def close(self) -> None:
        """Make no more items, and wait for the one that is being made."""
        self._closed = True
        if self._maker is not None:
            self._maker.shutdown()
