"""Packers, which place the boxes of an order by rules alone or with the help of physics. Also generates sample
plans."""

from __future__ import annotations
