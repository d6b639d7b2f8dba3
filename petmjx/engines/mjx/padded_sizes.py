"""Sizes of arrays on the device. Numbers of boxes, rows and steps are rounded up, so that worlds of different
sizes share compiled programs."""

from __future__ import annotations

GRANULE = 4
"""The number of box columns of a table is a multiple of this number, so that runs with different plans can share
compiled programs."""

PROFILE_GRANULE = 512
"""The number of steps of a table of profiles is a multiple of this number, so that the legs of a chain can share
compiled programs, although the legs differ in length."""


def round_up(n: int, granule: int = GRANULE) -> int:
    """The smallest multiple of ``granule`` that is at least n."""
    return -(-n // granule) * granule


def padded_rows(count: int) -> int:
    """Number of rows for ``count`` worlds: a power of two, so that few programs are compiled."""
    return 1 << (count - 1).bit_length()
