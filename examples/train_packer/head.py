"""The stability head, fitted to the labels of physics, and its calibration."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from labels import ORDERS, Array, Labels
from numpy.typing import NDArray
from optimiser import Adam

from petmjx.packers.placement_stability import NAMES, likely
from petmjx.packers.policy_network import Network
from petmjx.plans.order_generator import stream

STREAM = 102
HIDDEN = 16
ASIDE = 4
"""One in this many orders is kept for tests."""

DECAY = 1e-4
"""Of weights, against fitting noise."""

EDGES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.998, 1.0)
"""Bins of the reliability table."""


def believing() -> Network:
    """A head that believes that all placements stand, before there are labels."""
    f = len(NAMES)
    fresh = Network.fresh(np.zeros(f), np.ones(f), HIDDEN, stream(0, STREAM))
    return replace(fresh, constant=np.array(8.0))


def kept_aside(order: Array) -> NDArray[np.bool_]:
    """(m,) whether placements are kept for tests, by the numbers of their orders: of the first orders of pallets
    equally many as of later ones, since most placements are in the first."""
    pallet, later = np.divmod(order, ORDERS)
    return np.asarray((pallet + later) % ASIDE == 0)


def fit(labels: Labels, seed: int, steps: int) -> tuple[Network, dict[str, Any]]:
    """The head, and its calibration on test orders."""
    aside = kept_aside(labels.order)
    mean, scale = labels.features.mean(axis=0), labels.features.std(axis=0)
    fresh = Network.fresh(mean, np.where(scale > 1e-6, scale, 1.0), HIDDEN, stream(seed, STREAM))
    head = _descended(fresh, labels.features[~aside], labels.stands[~aside], seed, steps)
    said = {}
    for name, where in (("all", aside | True), ("usual", labels.usual > 0)):
        base = float(labels.stands[~aside & where].mean()) if (~aside & where).any() else 1.0
        here = aside & where
        said[name] = calibration(likely(head, labels.features[here]), labels.stands[here], base)
    return head, said


def _descended(head: Network, features: Array, stands: Array, seed: int, steps: int) -> Network:
    """The maximum of the likelihood, by Adam over all placements at a time."""
    values = head.learned
    values[-1] = np.log((stands.sum() + 1) / (len(stands) - stands.sum() + 1))
    # hidden units with zero weights would learn nothing; so a little of each
    values[-1 - HIDDEN : -1] = 0.1 * stream(seed, STREAM, 1).standard_normal(HIDDEN)
    adam = Adam.fresh(values.size)
    for step in range(steps):
        network = head.with_learned(values)
        error = (likely(network, features) - stands) / len(stands)
        slope = network.slope(features, error) + DECAY * values * (np.arange(values.size) < values.size - 1)
        values, adam = adam.stepped(values, -slope, 0.02 / (1 + 4 * step / steps))
    return head.with_learned(values)


def calibration(chances: Array, stands: Array, base: float) -> dict[str, Any]:
    """How far chances can be trusted: reliability by bins, Brier's score, expected calibration error.

    Args:
        chances, stands: (m,) of test placements.
        base: the share of the training placements that stand: the prediction of a constant.
    """
    table = []
    bins = np.clip(np.searchsorted(EDGES, chances, side="right") - 1, 0, len(EDGES) - 2)
    for number, (low, high) in enumerate(pairwise(EDGES)):
        here = bins == number
        if count := int(here.sum()):
            said, stood = float(chances[here].mean()), float(stands[here].mean())
            table.append({"from": low, "to": high, "placements": count, "said": said, "stand": stood})
    return {
        "placements": len(stands),
        "stand": float(stands.mean()),
        "brier": float(((chances - stands) ** 2).mean()),
        "brier_of_a_constant": float(((base - stands) ** 2).mean()),
        "ece": sum(row["placements"] * abs(row["said"] - row["stand"]) for row in table) / max(len(stands), 1),
        "auc": _auc(chances, stands),
        "reliability": table,
    }


def _auc(chances: Array, stands: Array) -> float | None:
    """Probability that a standing placement has a larger chance than a falling one; ties count half."""
    good, bad = np.sort(chances[stands > 0]), chances[stands == 0]
    if not len(good) or not len(bad):
        return None
    below, not_above = np.searchsorted(good, bad, side="left"), np.searchsorted(good, bad, side="right")
    return float(1 - (below + not_above).mean() / 2 / len(good))
