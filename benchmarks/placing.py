"""Measures the cost and the effect of placing, in worlds with errors: boxes appear at their places, or are carried by a
hand."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any

import pandas as pd

import petmjx
from petmjx.options.placing import Way
from petmjx.plans.plan import Plan

WAYS = (Way.EXACT, Way.HAND)


def placings(
    plans: Sequence[Plan], worlds: int, ways: Sequence[Way], **options: Any
) -> Iterator[tuple[str, pd.Series]]:
    """Yield, for each way of placing, its name and the result of a score with confidence.

    Args:
        worlds: number of worlds with errors of each plan, in addition to the nominal world.
        options: of ``petmjx.score``.
    """
    for way in ways:
        begin = time.perf_counter()
        results = petmjx.score(plans, confidence=worlds, placing=way, **options)
        yield way, summary(results.worlds, time.perf_counter() - begin, results.info["timings"])


def summary(worlds: pd.DataFrame, seconds: float, timings: dict[str, Any]) -> pd.Series:
    """Result of the worlds of a run.

    Args:
        seconds: duration of the run, s.
        timings: the entry ``timings`` of ``run.json``.
    """
    drawn = worlds[worlds.variant > 0]
    known = drawn[drawn.verdict != "invalid"]
    steps = drawn.n_steps / drawn.n_placed.clip(lower=1)
    reasons = drawn[drawn.verdict != "stable"].reason.value_counts(normalize=True)
    compile_s = float(timings.get("compile_s", 0.0))
    return pd.Series(
        {
            "worlds": len(worlds),
            "worlds_per_s": round(len(worlds) / max(seconds - compile_s, 1e-9), 2),
            "seconds": round(seconds, 1),
            "compile_s": round(compile_s, 1),
            "stand": round(float((known.verdict == "stable").mean()), 4),
            "nominal_stand": round(float((worlds[worlds.variant == 0].verdict == "stable").mean()), 4),
            "without_verdict": len(drawn) - len(known),
            "steps_per_box": round(float(steps.mean()), 1),
            **{f"by {reason}": round(float(share), 3) for reason, share in reasons.items()},
        }
    )
