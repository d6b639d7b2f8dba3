"""Small runs, and whether the tables of two runs are equal to the last bit."""

from __future__ import annotations

import pandas as pd

import petmjx
from support.plans import make_plan, stack

KEYS = {
    "worlds": ["plan_id", "variant"],
    "boxes": ["plan_id", "variant", "box"],
    "attempts": ["plan_id", "variant", "attempt"],
    "summary": [],
}

GRID = """
nominal = true
[axes]
profile = ["eumos-40509"]
level = [0.3, 0.6]
direction = [0, 90]
mass_factor = [0.8, 1.0]
"""
SEARCH = """
[simulation]
rest_s = 0.2
[search]
upper = 1.0
tolerance = 0.1
[axes]
profile = ["eumos-40509"]
direction = [0, 90]
"""
PLANS = [make_plan(f"plan-{k:02}", stack(1 + k % 4, overhang_mm=k % 5 * 60.0)) for k in range(80)]


def tables(results: petmjx.RunResults) -> dict[str, pd.DataFrame]:
    """Name → table, for all tables of a run, sorted by their keys."""
    table_by_name = {}
    for name, keys in KEYS.items():
        frame = getattr(results, name)
        if frame is not None:
            by = keys or [column for column in ("plan_id", "axis", "value", "direction_deg") if column in frame]
            table_by_name[name] = frame.sort_values(by, ignore_index=True)
    return table_by_name


def assert_same(results: petmjx.RunResults, expected: dict[str, pd.DataFrame]) -> None:
    """Check that all tables are equal to the last bit."""
    ours = tables(results)
    assert ours.keys() == expected.keys()
    for name, frame in ours.items():
        pd.testing.assert_frame_equal(frame, expected[name], check_exact=True, obj=name)
    assert results.info["status"] == "finished"
    assert results.info["counts"]["worlds"] == len(expected["worlds"])
