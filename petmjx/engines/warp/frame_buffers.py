"""Buffers on the device for the recorded frames of a time slice (one call of the kernels), and their transfer."""

from __future__ import annotations

import math
from functools import partial
from typing import Final

import jax
import numpy as np
import warp as wp
from numpy.typing import NDArray

from petmjx.engines.mjx.frame_recorder import Frames, Recorder
from petmjx.engines.warp import world_arrays
from petmjx.engines.warp.world_arrays import FrameBuffer
from petmjx.engines.warp.world_table import WorldTable

MOST_BYTES: Final = 64 << 20
"""Size of the largest frame buffer, bytes. If the largest plan of a run has 45 boxes, a buffer of this size has room
for 40,000 frames. For worlds of 45 boxes, an H200 has 264 thread blocks. If all worlds are recorded, these blocks write
about 10,000 frames in 250 ms, which is longer than a time slice on a GPU. A lane (place for a running world) that finds
no room in the buffer waits for the next slice."""

FRAMES_PER_WORLD: Final = 512
"""Number of frames for which the buffer has room, per recorded world. Even the fastest worlds write fewer frames in a
slice."""

FRAMES_PER_LANE: Final = 4
"""Smallest number of frames for which the buffer has room, per lane (place for a running world). When a lane checks for
room, all other lanes may be about to write a frame. So a recorded world takes a step only if there is room for a frame
of each lane."""

FEWEST: Final = 1024
"""Smallest number of frames that are transferred together. If a time slice (one call of the kernels) has more frames,
eight times this number is transferred. If that is not enough, 64 times this number is transferred, and so on. No other
numbers of frames are transferred, since each number needs its own compiled program."""

_KINDS: Final = {name: wp.dtype_to_numpy(kind.dtype) for name, kind in world_arrays.array_types(FrameBuffer).items()}


PickedFrames = tuple[dict[str, jax.Array], int]
"""Frames of a slice on the device, and the number of frames that are valid."""


def room_for(table: WorldTable, lanes: int) -> dict[str, jax.Array]:
    """Empty frame buffers for a table of worlds."""
    n_worlds, n_boxes = table.table.qpos.shape[:2]
    every = np.zeros(n_worlds, np.int32)
    every[: len(table.jobs)] = table.recorder.every
    return room_for_frames(every, n_boxes, lanes, FRAMES_PER_WORLD * int(np.count_nonzero(every)))


def room_for_frames(
    every: NDArray[np.int32], n_boxes: int, lanes: int, wanted: int | None = None
) -> dict[str, jax.Array]:
    """Empty frame buffers. If no world is recorded, the buffers have room for a single frame.

    Args:
        every: (world,) number of steps between two frames of a world; 0: the world is not recorded.
        wanted: number of frames for which there should be room; None: the largest number. Buffers have at most
            ``MOST_BYTES``, but room for at least ``FRAMES_PER_LANE`` frames per lane (place for a running world).
    """
    most = MOST_BYTES // (4 * sum(math.prod(shape) for shape in _shapes(1, n_boxes, 0).values()))
    n_frames = max(most if wanted is None else min(wanted, most), FRAMES_PER_LANE * lanes) if every.any() else 1
    room = {name: np.zeros(shape, _KINDS[name]) for name, shape in _shapes(n_frames, n_boxes, len(every)).items()}
    room["every"][:] = every
    placed: dict[str, jax.Array] = jax.device_put(room)
    return placed


def pick_frames(frames: dict[str, jax.Array]) -> PickedFrames:
    """The frames of an ended time slice (one call of the kernels), still on the device, and their number. Call this
    function before the next slice begins: otherwise, the device would compute the whole next slice before it picks the
    frames."""
    used, room = int(np.asarray(frames["used"])[0]), len(frames["of"])
    some = FEWEST
    while some < used:
        some *= 8
    return _first({name: frames[name] for name in ("of", *Frames._fields)}, min(some, room)), used


def hand_over(picked: PickedFrames, recorder: Recorder) -> None:
    """Pass the frames of a slice to a recorder, world by world, in the order of steps."""
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
