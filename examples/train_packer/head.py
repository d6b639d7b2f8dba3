"""Fits the stability head to the labels from simulations, and measures its calibration. The stability head is a network
that estimates the chance that a placed box stands."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from labels import ORDERS, Array, Labels
from numpy.typing import NDArray
from optimiser import Adam

from petmjx.packers.policy_network import Network, likely
from petmjx.packers.stability_features import NAMES
from petmjx.plans.order_generator import stream

STREAM = 102
HIDDEN = 16
ASIDE = 4
"""One order in this number is kept for tests."""

DECAY = 1e-4
"""Weight decay, which keeps the network from fitting noise."""

EDGES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.998, 1.0)
"""Edges of the bins of estimated chances in the reliability table."""


def fresh_network(mean: Array, scale: Array, n_hidden: int, rng: np.random.Generator) -> Network:
    """A network before training. All scores of this network are 0."""
    f = len(mean)
    hidden = rng.standard_normal((f, n_hidden)) / np.sqrt(f)
    return Network(mean, scale, np.zeros(f), hidden, np.zeros(n_hidden), np.zeros(n_hidden), np.zeros(()))


def parameters_of(network: Network) -> Array:
    """All trained parameters of a network as one vector."""
    parts = (network.linear, network.hidden, network.bias, network.out, network.constant)
    return np.concatenate([np.ravel(part) for part in parts])


def with_parameters(network: Network, values: Array) -> Network:
    """The network with other trained parameters, given in the order of ``parameters_of``."""
    f, h = network.hidden.shape
    linear, hidden, bias, out, constant = np.split(values, np.cumsum([f, f * h, h, h]))
    return replace(
        network, linear=linear, hidden=hidden.reshape(f, h), bias=bias, out=out, constant=constant.reshape(())
    )


def gradient(network: Network, features: Array, weights: Array) -> Array:
    """The gradient of the sum of weights × scores with respect to the trained parameters, in the order of
    ``parameters_of``.

    Args:
        features: (m, f) features.
        weights: (m,) weights of the m scores.
    """
    x = (features - network.mean) / network.scale
    active = np.tanh(x @ network.hidden + network.bias)
    back = weights[:, None] * (1 - active**2) * network.out
    parts = (weights @ x, x.T @ back, back.sum(axis=0), weights @ active, weights.sum())
    return np.concatenate([np.ravel(part) for part in parts])


def believing() -> Network:
    """A head that estimates that all placements stand, for use before there are labels."""
    f = len(NAMES)
    fresh = fresh_network(np.zeros(f), np.ones(f), HIDDEN, stream(0, STREAM))
    return replace(fresh, constant=np.array(8.0))


def kept_aside(order: Array) -> NDArray[np.bool_]:
    """(m,) whether a placement is kept for tests, which depends on the number of its order. Most placements are in the
    first order of a pallet, so first orders and later orders are divided separately, in the same ratio."""
    pallet, later = np.divmod(order, ORDERS)
    return np.asarray((pallet + later) % ASIDE == 0)


def fit(labels: Labels, seed: int, steps: int) -> tuple[Network, dict[str, Any]]:
    """The fitted head, and its calibration on the orders kept for tests."""
    aside = kept_aside(labels.order)
    mean, scale = labels.features.mean(axis=0), labels.features.std(axis=0)
    fresh = fresh_network(mean, np.where(scale > 1e-6, scale, 1.0), HIDDEN, stream(seed, STREAM))
    head = _descended(fresh, labels.features[~aside], labels.stands[~aside], seed, steps)
    said = {}
    for name, where in (("all", aside | True), ("usual", labels.usual > 0)):
        base = float(labels.stands[~aside & where].mean()) if (~aside & where).any() else 1.0
        here = aside & where
        said[name] = calibration(likely(head, labels.features[here]), labels.stands[here], base)
    return head, said


def _descended(head: Network, features: Array, stands: Array, seed: int, steps: int) -> Network:
    """The head with the largest likelihood, found by Adam. Each step uses all placements."""
    values = parameters_of(head)
    values[-1] = np.log((stands.sum() + 1) / (len(stands) - stands.sum() + 1))
    # hidden units with zero weights would learn nothing, so their weights begin as small random numbers
    values[-1 - HIDDEN : -1] = 0.1 * stream(seed, STREAM, 1).standard_normal(HIDDEN)
    adam = Adam.fresh(values.size)
    for step in range(steps):
        network = with_parameters(head, values)
        error = (likely(network, features) - stands) / len(stands)
        slope = gradient(network, features, error) + DECAY * values * (np.arange(values.size) < values.size - 1)
        values, adam = adam.stepped(values, -slope, 0.02 / (1 + 4 * step / steps))
    return with_parameters(head, values)


def calibration(chances: Array, stands: Array, base: float) -> dict[str, Any]:
    """How far estimated chances can be trusted: reliability by bins, Brier score, expected calibration error.

    Args:
        chances, stands: (m,) estimates and results of the test placements.
        base: share of the training placements that stand. A constant prediction of this share is the reference.
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
    """Area under the ROC curve: the probability that a standing placement has a larger estimated chance than a falling
    one. A tie counts as one half."""
    good, bad = np.sort(chances[stands > 0]), chances[stands == 0]
    if not len(good) or not len(bad):
        return None
    below, not_above = np.searchsorted(good, bad, side="left"), np.searchsorted(good, bad, side="right")
    return float(1 - (below + not_above).mean() / 2 / len(good))
