"""Packers: rules that place boxes, alone and with physics, and the generator of sample plans."""

from __future__ import annotations
