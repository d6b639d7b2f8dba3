"""Packers, which place the boxes of an order by rules alone or with physics, and the generator of sample plans."""

from __future__ import annotations
