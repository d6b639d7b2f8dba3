"""petmjx: the stability of pallet packing plans, scored by physics, many thousands at a time."""

from __future__ import annotations

__version__ = "0.1.0"
