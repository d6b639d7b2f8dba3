"""Analyses of plans and results: criteria, KPIs, loads, comparisons of runs and of packers, and the story of a
world."""

from __future__ import annotations
