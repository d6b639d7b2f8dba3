"""Packers, and the sample plans that they make. A packer chooses places for the boxes of an order, by rules alone or
with the help of physics."""

from __future__ import annotations
