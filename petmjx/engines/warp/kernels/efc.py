"""Access to the numbers of contacts, whose memory layout differs between GPU and CPU.

These are Warp functions for the C++ of petmjx/engines/warp/solver/efc.cuh.
"""

from __future__ import annotations

import warp as wp


@wp.func_native("return petmjx::number_of(efc, lane, contact, number);")
def number_of(efc: wp.array3d[float], lane: int, contact: int, number: int) -> float: ...


@wp.func_native("petmjx::number_of(efc, lane, contact, number) = value;")
def put_number(efc: wp.array3d[float], lane: int, contact: int, number: int, value: float) -> None: ...


@wp.func_native("return petmjx::is_new(pair, last_pair);")
def is_new(pair: int, last_pair: int) -> bool:
    """Whether the data of a contact's pair must be computed. On a CPU, the data must be computed if the thread's
    previous contact belongs to another pair. On a GPU, neighbouring threads have neighbouring contacts, so the data
    must always be computed, and the result is a constant for the compiler."""
