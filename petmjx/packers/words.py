"""What a comparison of packers says, in sentences: who stands more often, and how sure that is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from petmjx.basics.text import counted, shown

LEAST_P: Final = 1e-4
"""Smaller p-values are shown as smaller than this."""


def p_in_words(p: float) -> str:
    """ "p = 0.0020" or "p < 0.0001"."""
    return f"p < {LEAST_P:.4f}" if p < LEAST_P else f"p = {p:.4f}"


def pair_in_words(row: Mapping[str, Any], confidence: float, pairs: int) -> str:
    """One sentence about two packers on the same orders.

    Args:
        row: of ``PackerComparison.pairs``, size ``all``, with at least one compared order.
        confidence: of its interval. The test is significant where its p-value is at most 1 − confidence.
        pairs: how many tests the p-value is corrected for.
    """
    better, worse = (row["b"], row["a"]) if row["difference"] > 0 else (row["a"], row["b"])
    bounds = (row["low"], row["high"]) if row["difference"] > 0 else (-row["high"], -row["low"])
    low, high = (f"{100 * bound + 0.0:+.2f}" for bound in bounds)
    orders = counted(int(row["n"]), "order")
    level = f"{100 * confidence:g} % interval"
    test = f"McNemar's exact test, {p_in_words(row['p_holm'])}" + (
        f", corrected for {pairs} pairs" if pairs > 1 else ""
    )
    if row["difference"] == 0:
        equal = f"Plans of {shown(row['a'])} and {shown(row['b'])} stand equally often on {orders}"
        return f"{equal}; a difference of {low} to {high} percentage points is possible ({level}; {test})."
    more = f"lans of {shown(better)} stand more often than plans of {shown(worse)}"
    points = f"{100 * abs(row['difference']):.2f} percentage points"
    sure = f"({level} {low} to {high}; {test})"
    if row["p_holm"] <= 1 - confidence:
        return f"P{more}: by {points} on {orders} {sure}."
    return f"On these {orders} p{more}, by {points}, but that may be luck {sure}."
