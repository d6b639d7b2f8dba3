"""Access to the numbers of contacts, whose memory layout differs between GPU and CPU.

These are Warp functions for the C++ of petmjx/engines/warp/solver/efc.cuh.
"""

from __future__ import annotations

import warp as wp


@wp.func_native("return petmjx::number_of(efc, lane, contact, number);")
def number_of(efc: wp.array3d[float], lane: int, contact: int, number: int) -> float: ...


@wp.func_native("petmjx::number_of(efc, lane, contact, number) = value;")
def put_number(efc: wp.array3d[float], lane: int, contact: int, number: int, value: float) -> None: ...
