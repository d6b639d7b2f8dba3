"""Tests of kernels that run side by side: for which kernels each stream waits. The device and its streams are mocks."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import jax
import pytest

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

import warp as wp

from petmjx.engines.warp import block_launch
from petmjx.engines.warp.block_launch import HEAD_START_NS, launch_device, side_by_side


class Device:
    """A mock of a Warp device. Like the original, it can be compared and has no hash."""

    is_cuda, alias = True, "cuda:7"

    def __eq__(self, other: object) -> bool:
        return self is other


class Stream:
    """A mock of a Warp stream, which adds every call to a list, with the name of the stream."""

    done: list[tuple[Any, ...]]

    def __init__(self, device: str) -> None:
        self.name = f"stream {sum(entry[0] == 'made' for entry in self.done)} of {device}"
        self.done.append(("made", self.name))

    def wait_stream(self, other: Stream) -> None:
        self.done.append((self.name, "waits for", other.name))


@pytest.fixture
def done(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[tuple[Any, ...]]]:
    calls: list[tuple[Any, ...]] = []
    monkeypatch.setattr(Stream, "done", calls, raising=False)
    main = Stream.__new__(Stream)
    main.name = "main"

    def launch(kernel: Any, inputs: list[Any], stream: Stream, **_: Any) -> None:
        calls.append((stream.name, kernel, *inputs))

    monkeypatch.setattr(wp, "get_device", Device)
    monkeypatch.setattr(wp, "get_stream", lambda _: main)
    monkeypatch.setattr(wp, "Stream", Stream)
    monkeypatch.setattr(wp, "launch", launch)
    block_launch._more_streams.cache_clear()
    yield calls
    block_launch._more_streams.cache_clear()


def test_the_second_kernel_begins_a_little_later_and_what_follows_waits_for_both(done: list[tuple[Any, ...]]) -> None:
    for again in range(2):
        with side_by_side(2) as pair:
            done.append(("kernels", *(stream.name for stream in pair if stream)))
        second = "stream 0 of cuda:7"
        assert done[again == 0 :] == [
            (second, "waits for", "main"),
            (second, block_launch.pause, HEAD_START_NS),
            ("kernels", "main", second),
            ("main", "waits for", second),
        ]
        done.clear()


def test_a_run_uses_the_device_of_jax_and_not_warps_own_default(monkeypatch: pytest.MonkeyPatch) -> None:
    """With several GPUs, JAX leaves the last one as the current one, which Warp then takes for its default."""
    monkeypatch.setattr(wp, "get_device", lambda name: SimpleNamespace(alias=name))
    monkeypatch.setattr(wp, "get_cuda_device", lambda ordinal: SimpleNamespace(alias=f"cuda:{ordinal}"))
    (device,) = jax.device_put(0.0).devices()
    assert launch_device().alias == ("cpu" if device.platform == "cpu" else f"cuda:{device.id}")
    second_gpu = SimpleNamespace(platform="gpu", id=1)
    monkeypatch.setattr(jax, "device_put", lambda values: SimpleNamespace(devices=lambda: [second_gpu]))
    assert launch_device().alias == "cuda:1"


def test_one_kernel_waits_for_nothing(done: list[tuple[Any, ...]]) -> None:
    with side_by_side(1) as (stream,):
        assert stream is not None
    assert done == []
