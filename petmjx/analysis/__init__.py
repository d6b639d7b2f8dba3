"""Analyses of plans and results: criteria, KPIs, loads, comparisons of runs and of packers, and texts that tell how a
simulated stack failed."""

from __future__ import annotations
