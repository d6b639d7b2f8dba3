"""Kernels that run at the same time on one device."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager

import warp as wp

from petmjx.engines.warp.kernel.pause import pause

HEAD_START_NS = 50_000
"""How much later each kernel begins than the one before. A GPU gives thread blocks to its multiprocessors in the order
in which they come, and lets them run to their end: so blocks of the first kernel have what room they need."""


@functools.cache
def _more_streams(device: str, count: int) -> list[wp.Stream]:
    return [wp.Stream(device) for _ in range(count)]


def own_kernels(count: int) -> list[wp.Kernel]:
    """What ``side_by_side`` launches itself."""
    return [pause] if count > 1 and wp.get_device().is_cuda else []


@contextmanager
def side_by_side(count: int) -> Iterator[list[wp.Stream]]:
    """Streams for kernels that run at the same time, between what is on the current stream before and after.

    Kernels are to be launched in the order of the streams.
    """
    device = wp.get_device()
    current = wp.get_stream(device)
    more = _more_streams(device.alias, count - 1)
    for number, stream in enumerate(more, start=1):
        stream.wait_stream(current)
        wp.launch(pause, dim=1, inputs=[number * HEAD_START_NS], block_dim=1, stream=stream)
    try:
        yield [current, *more]
    finally:
        for stream in more:
            current.wait_stream(stream)
