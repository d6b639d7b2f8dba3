"""Items in chunks, made ahead by a thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from itertools import count

import pytest

from petmjx.engines.chunks import Chunks


@pytest.mark.parametrize("n", [0, 1, 5, 6, 7])
def test_chunks_have_each_item_once_and_in_order(n: int) -> None:
    chunks, found = Chunks(iter(range(n)), 3), []
    while chunk := chunks.take():
        found.append(chunk)
    chunks.close()
    assert [item for chunk in found for item in chunk] == list(range(n))
    assert all(len(each) == 3 for each in found[:-1])


def test_an_error_comes_with_the_chunk_that_it_is_in() -> None:
    def source() -> Iterator[int]:
        yield from range(3)
        raise ValueError("the fourth")

    chunks = Chunks(source(), 2)
    assert chunks.take() == [0, 1]
    with pytest.raises(ValueError, match="the fourth"):
        chunks.take()
    chunks.close()


def test_closing_does_not_wait_for_the_rest_of_a_chunk() -> None:
    """With Ctrl-C, for example. Here the next chunk would never be full."""
    begun = threading.Event()

    def source() -> Iterator[int]:
        yield from range(10_000)
        begun.set()
        for number in count():
            time.sleep(0.01)
            yield number

    chunks = Chunks(source(), 10_000)
    chunks.take()
    assert begun.wait(30)
    closer = threading.Thread(target=chunks.close, daemon=True)
    closer.start()
    closer.join(30)
    assert not closer.is_alive()
