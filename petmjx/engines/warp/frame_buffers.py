"""Room on the device for the frames of a time slice, and how they come to the host."""

from __future__ import annotations

import math
from functools import partial
from typing import Final

import jax
import numpy as np
import warp as wp

from petmjx.engines.mjx.frame_recorder import Frames, Recorder
from petmjx.engines.warp import world_arrays
from petmjx.engines.warp.world_arrays import FrameBuffer
from petmjx.engines.warp.world_groups import Group

MOST_BYTES: Final = 64 << 20
"""Most room for frames: 40,000 of them if the run's largest plan has 45 boxes. In a slice of 250 ms the 264 blocks that
an H200 has for worlds of that size take some 10,000 if all are recorded. Blocks that find no room wait for the next
slice."""

FRAMES_PER_WORLD: Final = 512
"""Room for each recorded world: more than the quickest ones take in a slice."""

FRAMES_PER_BLOCK: Final = 4
"""Least room: each block may be about to write a frame when it is looked whether there is room."""

FEWEST: Final = 1024
"""Frames that come to the host together, at least; else eight times as many, …: each number is compiled once."""

_KINDS: Final = {name: wp.dtype_to_numpy(kind.dtype) for name, kind in world_arrays.array_types(FrameBuffer).items()}


def room_for(group: Group, blocks: int) -> dict[str, jax.Array]:
    """Empty room for frames; next to none where no world of the group is recorded."""
    n_worlds, n_boxes = group.table.qpos.shape[:2]
    words = sum(math.prod(shape) for shape in _shapes(1, n_boxes, 0).values())
    n_recorded = int(np.count_nonzero(group.recorder.every))
    needed = min(FRAMES_PER_WORLD * n_recorded, MOST_BYTES // (4 * words))
    n_frames = 1 if group.recorder.idle else max(needed, FRAMES_PER_BLOCK * blocks)
    room = {name: np.zeros(shape, _KINDS[name]) for name, shape in _shapes(n_frames, n_boxes, n_worlds).items()}
    room["every"][: len(group.jobs)] = group.recorder.every
    placed: dict[str, jax.Array] = jax.device_put(room)
    return placed


def pick_frames(frames: dict[str, jax.Array]) -> tuple[dict[str, jax.Array], int]:
    """The frames of a slice that has ended, and how many they are, still on the device. It must be done before the next
    slice begins, which the device would finish first."""
    used, room = int(np.asarray(frames["used"])[0]), len(frames["of"])
    some = FEWEST
    while some < used:
        some *= 8
    return _first({name: frames[name] for name in ("of", *Frames._fields)}, min(some, room)), used


def hand_over(picked: tuple[dict[str, jax.Array], int], recorder: Recorder) -> None:
    """Give the frames of a slice to a recorder, world by world, in the order of their steps."""
    firsts, used = picked
    if used == 0:
        return
    host = {name: values[:used] for name, values in jax.device_get(firsts).items()}
    order = np.lexsort((host["step"], host["of"]))
    begins = np.flatnonzero(np.diff(host["of"][order], prepend=-1))
    for rows in np.split(order, begins[1:]):
        parts = {name: host[name][rows] for name in Frames._fields}
        recorder.add(int(host["of"][rows[0]]), Frames(**parts))


@partial(jax.jit, static_argnames="count")
def _first(frames: dict[str, jax.Array], count: int) -> dict[str, jax.Array]:
    return {name: values[:count] for name, values in frames.items()}


def _shapes(n_frames: int, n_boxes: int, n_worlds: int) -> dict[str, tuple[int, ...]]:
    return world_arrays.array_shapes(FrameBuffer, {"frame": n_frames, "box": n_boxes, "world": n_worlds})
