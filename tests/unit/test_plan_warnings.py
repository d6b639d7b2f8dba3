"""Warnings about plans that can be simulated: overlapping boxes, boxes outside the carrier, floating boxes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.command_line import write
from support.plan_files import placement, tower

from petmjx.plans.plan_reader import load_plans
from petmjx.plans.plan_warnings import DEFAULT_TOLERANCE_MM, check_layout, overlap, shared_length

pytestmark = pytest.mark.usefixtures("in_tmp_path")

Box = tuple[tuple[float, float, float], tuple[float, float, float]]
CUBE = (100.0, 100.0, 100.0)
T = DEFAULT_TOLERANCE_MM


@pytest.mark.parametrize(
    ("boxes", "extent", "counts"),
    [
        ([((0, 0, 0), CUBE), ((100, 0, 0), CUBE), ((50, 0, 100), CUBE)], (200, 100), (0, 0, 0)),
        ([((0, 0, 0), CUBE), ((100 - T, 0, 0), CUBE), ((0, 0, 100 - T), CUBE)], None, (0, 0, 0)),
        ([((0, 0, 0), CUBE), ((99, 0, 0), CUBE)], None, (1, 0, 0)),
        ([((0, 0, 0), CUBE), ((0, 0, 0), CUBE), ((0, 0, 0), CUBE)], None, (3, 0, 0)),
        ([((0, 0, 0), CUBE), ((0, 0, 50), CUBE)], None, (1, 0, 0)),
        ([((-101, 0, 0), CUBE), ((0, -900, -T), CUBE), ((300, 0, -2), CUBE)], None, (0, 1, 0)),
        ([((-1, 0, 0), CUBE), ((100, -T, 0), CUBE), ((300, 0, -2), CUBE)], (1200, 800), (0, 2, 0)),
        ([((0, 0, 0), CUBE), ((150, 0, 0), CUBE), ((250, 20, 0), CUBE)], (249, 115), (0, 2, 0)),
        ([((0, 0, 0), CUBE), ((0, 0, 101), CUBE), ((200, 0, 1), CUBE)], None, (0, 0, 2)),
        ([((0, 0, 0), CUBE), ((100, 0, 100), CUBE)], None, (0, 0, 1)),
        ([((0, 0, 100), CUBE), ((0, 0, 0), CUBE)], None, (0, 0, 1)),
    ],
)
def test_warnings_count_what_is_odd(
    boxes: list[Box], extent: tuple[float, float] | None, counts: tuple[int, int, int]
) -> None:
    corner, size = (np.array(column, dtype=float) for column in zip(*boxes, strict=True))
    layout_warning = check_layout("A", "f.json", corner, size, extent)
    assert (layout_warning.n_overlapping_pairs, layout_warning.n_outside, layout_warning.n_floating) == counts
    assert layout_warning.any == any(counts)


def test_overlaps_agree_with_a_plain_loop() -> None:
    rng = np.random.default_rng(5)
    corner, size = rng.uniform(0, 600, (40, 3)), rng.uniform(0.2, 300, (40, 3))
    expected = 0
    for i in range(40):
        for j in range(i):
            depth = np.minimum(corner[i] + size[i], corner[j] + size[j]) - np.maximum(corner[i], corner[j])
            expected += bool((depth > T).all())
    assert expected > 20
    assert check_layout("A", "f", corner, size).n_overlapping_pairs == expected


@pytest.mark.parametrize("tolerance", [0.0, DEFAULT_TOLERANCE_MM])
def test_overlap_is_a_shared_length_beyond_the_tolerance(tolerance: float) -> None:
    rng = np.random.default_rng(58)
    low = rng.integers(0, 12, (40, 9)) / 4 + rng.choice([0.0, 1e-13, 0.1], (40, 9))
    high = low + rng.choice([0.0, 0.25, 0.5, 0.1, 3.0], (40, 9))  # some boxes are no thicker than the tolerance
    np.testing.assert_array_equal(overlap(low, high, tolerance), shared_length(low, high) > tolerance)


def test_odd_plans_are_kept_and_reported_with_counts() -> None:
    plans = {
        "fine": tower(2),
        "odd": [placement(corner=(700, 0, 0)), placement(corner=(0, 0, 50))],
        "more": [placement(corner=(x, 0, 0)) for x in (-200, 0, 300, 701)],
    }
    plan_set = load_plans(write(Path("p.json"), plans), carrier_extent_mm=(1200, 800))
    assert len(plan_set) == 3
    assert plan_set.skipped == []
    assert [str(w) for w in plan_set.warnings] == [
        "p.json: plan odd: 1 box outside the carrier (0), 1 floating box (1 by 50 mm)",
        "p.json: plan more: 4 overlapping pairs (0 and 1, 0 and 2, 1 and 2, …), 2 boxes outside the carrier (0, 3)",
    ]
