"""How many verdicts change when something changes that should not matter, or matters little."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

import petmjx
from petmjx.plans.plan import Plan

SEED = 1
"""Seed of the random changes of plans. Each plan has its own stream of random numbers."""


def _same(plan: Plan, rng: np.random.Generator) -> Plan:
    return plan


def _other_masses(plan: Plan, rng: np.random.Generator) -> Plan:
    """The plan with masses that are up to 2 % larger or smaller."""
    return replace(plan, mass_kg=plan.mass_kg * rng.uniform(0.98, 1.02, plan.n_boxes))


def _shuffled(plan: Plan, rng: np.random.Generator) -> Plan:
    """The plan with its boxes in another order in memory. So every sum has another order."""
    order = rng.permutation(plan.n_boxes)
    return replace(
        plan,
        size_mm=plan.size_mm[order],
        corner_mm=plan.corner_mm[order],
        mass_kg=plan.mass_kg[order],
        item_ids=tuple(plan.item_ids[k] for k in order),
        articles=tuple(plan.articles[k] for k in order),
        sequence=plan.sequence[order],
    )


@dataclass(frozen=True)
class Change:
    """One change of plans or options.

    Attributes:
        options: fields of ``petmjx.Simulation``.
        against: options of the run with which the changed run is compared.
        plans: function that changes a plan.
    """

    options: Mapping[str, Any] = field(default_factory=dict)
    against: Mapping[str, Any] = field(default_factory=dict)
    plans: Callable[[Plan, np.random.Generator], Plan] = _same


STATIC = {"check": "static"}
LOOKED_AT_LONG = {"check": "static", "schedule": "fixed"}


def _pallet(**values: Any) -> dict[str, Any]:
    return {"physics": {"name": "pallet", **values}}


def _friction(sliding: float) -> dict[str, Any]:
    return _pallet(box_friction=(sliding, 0.005, 0.0001), carrier_friction=(sliding, 0.005, 0.0001))


CHANGES: dict[str, Change] = {
    "timestep 1 ms": Change(_pallet(timestep_s=0.001)),
    "timestep 4 ms": Change(_pallet(timestep_s=0.004)),
    "solver tolerance 1e-6": Change({"solver_tolerance": 1e-6}),
    "solver tolerance 1e-12": Change({"solver_tolerance": 1e-12}),
    "contacts half as stiff": Change(_pallet(solref=(0.02 * 2**0.5, 1.25))),
    "contacts twice as stiff": Change(_pallet(solref=(0.02 / 2**0.5, 1.25))),
    "friction 0.45": Change(_friction(0.45)),
    "friction 0.55": Change(_friction(0.55)),
    "sizes 0.1 mm larger": Change({"size_reduction_mm": 0.0}),
    "sizes 0.1 mm smaller": Change({"size_reduction_mm": 0.2}),
    "masses ± 2 %": Change(plans=_other_masses),
    "order of the boxes in memory (static)": Change(STATIC, STATIC, _shuffled),
    "static check of 120 s instead of 10 s": Change(LOOKED_AT_LONG | {"duration_s": 120.0}, LOOKED_AT_LONG),
    "schedule fixed": Change({"schedule": "fixed"}),
}


def sensitivity(
    plans: Sequence[Plan], names: Sequence[str], **run_options: Any
) -> Iterator[tuple[str, pd.DataFrame, pd.DataFrame]]:
    """Yield, for each change, its name and the tables ``worlds`` before and after the change, with plan ids as index.
    Runs before a change are simulated only once.

    Args:
        run_options: fields of ``petmjx.RunOptions``.
    """
    known: dict[str, pd.DataFrame] = {}

    def worlds(changed: Sequence[Plan], options: Mapping[str, Any]) -> pd.DataFrame:
        return petmjx.score(list(changed), **options, **run_options).worlds.set_index("plan_id")

    for name in names:
        change = CHANGES[name]
        key = repr(change.against)
        if key not in known:
            known[key] = worlds(plans, change.against)
        streams = np.random.default_rng(SEED).spawn(len(plans))
        changed = [change.plans(plan, rng) for plan, rng in zip(plans, streams, strict=True)]
        after = worlds(changed, change.options)
        yield name, known[key], after.loc[known[key].index]


def describe(before: pd.DataFrame, after: pd.DataFrame) -> str:
    """A text with the number of changed verdicts, the number of verdicts that change to stable, and the number of
    changed verdicts whose margins are beyond a tenth in both runs."""
    changed = before.verdict != after.verdict
    to_stable = int((changed & (after.verdict == "stable")).sum())
    far = changed & (before.margin.abs() > 0.1) & (after.margin.abs() > 0.1)
    return (
        f"{int(changed.sum())} of {len(before)} verdicts change ({100 * changed.mean():.2f} %), {to_stable} to stable, "
        f"{int(far.sum())} with margins beyond 0.1 in both"
    )
