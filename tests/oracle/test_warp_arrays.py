"""How kernels of mjx-warp index arrays (arrays.cuh): elements of a row are adjacent, and no index counts from the
end."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")

import warp as wp

from petmjx.common.warp_cpp import with_cpp
from petmjx.common.warp_setup import set_up_warp
from petmjx.engines.warp.solver import newton
from petmjx.engines.warp.world_arrays import FrameBuffer, filled_record

set_up_warp()


def _read(row: wp.array[float], rows: wp.array2d[float], blocks: wp.array3d[float], elements: wp.array[float]) -> None:
    elements[0] = row[2]
    elements[1] = rows[1, 2]
    elements[2] = blocks[1, 2, 3]
    rows[0, 1] = 7.0
    blocks[0, 1, 2] = 8.0


def test_numbers_are_found_by_rows() -> None:
    """The kernel must use the index functions of arrays.cuh, and not Warp's.

    A row with gaps shows the difference: these functions ignore the stride of an array.
    """
    kernel = with_cpp(_read, newton.source("arrays.cuh"))
    numbers = np.arange(60, dtype=np.float32)
    row = wp.array(numbers, dtype=float)
    rows, blocks = (wp.array(numbers.reshape(shape), dtype=float) for shape in ((12, 5), (3, 4, 5)))
    elements = wp.zeros(3, dtype=float)
    wp.launch(kernel, dim=1, inputs=[row, rows, blocks, elements])
    assert elements.numpy().tolist() == [2, 7, 33]
    assert (rows.numpy()[0, 1], blocks.numpy()[0, 1, 2]) == (7, 8)
    wp.launch(kernel, dim=1, inputs=[row[4:12:2], rows, blocks, elements])
    assert elements.numpy()[0] == 6, "Warp's own functions would find 8"


def test_arrays_with_gaps_are_refused() -> None:
    values = dict.fromkeys(FrameBuffer.vars, wp.zeros(8, dtype=int)[::2])
    with pytest.raises(AssertionError):
        filled_record(FrameBuffer, values)
