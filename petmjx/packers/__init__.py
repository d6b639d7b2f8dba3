"""Packers, which choose places for the boxes of an order, by rules alone or with the help of physics; and sample
plans."""

from __future__ import annotations
