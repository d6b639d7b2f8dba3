"""Plans in other simulators: does any of petmjx's verdicts stand alone?

The first referee judges every plan; the other referees judge the plans in which it differs from petmjx. A referee whose
verdict differs has *converged* if its verdict is the same with finer settings, such as half the timestep and twice the
iterations. A plan counts against petmjx if two converged referees contradict petmjx's verdict: a single referee may be
wrong, and all referees may be wrong with a coarse timestep.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from itertools import chain
from typing import Any

import numpy as np

import petmjx
from benchmarks.referees.box_by_box import stand
from benchmarks.referees.referee import Referee
from petmjx.common.units import MM_PER_M
from petmjx.engines.verdict import Flag, Verdict
from petmjx.options.simulation import Check, Simulation
from petmjx.plans.plan import Plan
from petmjx.world.scene import Scene, build_scene
from petmjx.world.supports import bearing_of

ENOUGH = 2
"""Number of converged referees that overrule petmjx."""

LONGEST_WAIT_S = 3.0
"""Longest wait of a referee for boxes to rest, s, since the boxes of some simulators never stop trembling."""

Ask = Callable[[str, bool], str]
"""Function that returns a referee's verdict. The arguments are the name of the referee, and whether the settings are
fine."""


@dataclass(frozen=True)
class Trial:
    """All verdicts on one plan. ``said``: the verdict of each referee used and, if it differs from petmjx's, its
    verdict with fine settings."""

    ours: str
    said: dict[str, list[str]]

    @property
    def converged_against(self) -> list[str]:
        """The referees that contradict petmjx with both settings."""
        other = {Verdict.STABLE.value: Verdict.UNSTABLE.value, Verdict.UNSTABLE.value: Verdict.STABLE.value}
        opposite = other.get(self.ours)
        return [name for name, verdicts in self.said.items() if verdicts == [opposite, opposite]]

    @property
    def verdicts(self) -> set[str]:
        """All verdicts on the plan, of petmjx and of the referees."""
        return {self.ours, *chain.from_iterable(self.said.values())}

    @property
    def is_contradicted(self) -> bool:
        return len(self.converged_against) >= ENOUGH


def sieve(ours: str, names: Sequence[str], ask: Ask) -> Trial:
    """Run the first referee. If its verdict differs from petmjx's, run the other referees, as long as enough of them
    may still overrule petmjx. A referee that differs also runs with fine settings."""
    trial = Trial(ours, {})
    for number, name in enumerate(names, start=1):
        verdict = ask(name, False)
        trial.said[name] = [verdict] if verdict == ours else [verdict, ask(name, True)]
        agrees_first = number == 1 and verdict == ours
        if agrees_first or len(trial.converged_against) + len(names) - number < ENOUGH:
            break
    return trial


@dataclass(frozen=True)
class Judged:
    """A plan as a scene, its check, petmjx's verdict, and its trial."""

    plan_id: str
    scene: Scene
    check: Check
    reason: str
    margin: float
    moving: bool
    trial: Trial

    @property
    def edge_mm(self) -> float:
        """The distance, by statics (petmjx.world.bearings), of a load from an edge of its supports, mm: of all loads,
        the distance nearest to 0. The distance is negative beyond the edge. If boxes are placed one by one, the
        distances after each placement count. The result is NaN if no load has an edge."""
        count, bearing = self.scene.n_boxes, bearing_of(self.scene)
        states = [count] if self.check is Check.STATIC else range(1, count + 1)
        edges = np.concatenate([bearing.edges_m(bearing.loads(placed)) for placed in states])
        edges = edges[np.isfinite(edges)]
        return float(edges[np.abs(edges).argmin()]) * MM_PER_M if len(edges) else math.nan

    def record(self) -> dict[str, Any]:
        """The entry in results for a plan on which a referee and petmjx differ."""
        return {
            "plan_id": self.plan_id,
            "boxes": self.scene.n_boxes,
            "petmjx": self.trial.ours,
            "reason": self.reason,
            "margin": _or_none(self.margin),
            "moving": self.moving,
            "edge_mm": _or_none(self.edge_mm),
            **self.trial.said,
            "contradicted": self.trial.is_contradicted,
        }


class Court:
    """The engine ``mujoco`` of petmjx, and the referees, with the CPU time of each referee."""

    def __init__(self, referees: Sequence[Referee], sim: Simulation) -> None:
        self.referees = {referee.name: referee for referee in referees}
        self.cpu_s = dict.fromkeys(self.referees, 0.0)
        self._sim = sim

    def judge(self, plans: Sequence[Plan], **options: Any) -> Iterator[Judged]:
        """Yield each plan with its trial, in the order of the plans."""
        results = petmjx.score(list(plans), engine="mujoco", check=self._sim.check.value, **options)
        worlds = results.worlds.set_index("plan_id")
        for plan in plans:
            row, scene = worlds.loc[plan.plan_id], build_scene(plan, self._sim)
            yield Judged(
                plan.plan_id,
                scene,
                self._sim.check,
                str(row["reason"]),
                float(row["margin"]),
                bool(row["flags"] & int(Flag.MOVING)),
                self._try(str(row["verdict"]), scene),
            )

    def _try(self, ours: str, scene: Scene) -> Trial:
        def ask(name: str, fine: bool) -> str:
            begin = time.process_time()
            world = self.referees[name].world(scene, self._sim.physics, fine)
            try:
                return stand(world, scene, sim).verdict.value
            finally:
                world.close()
                self.cpu_s[name] += time.process_time() - begin

        sim = self._sim.changed(longest_wait_s=LONGEST_WAIT_S, duration_s=LONGEST_WAIT_S)
        able = [name for name, referee in self.referees.items() if scene.n_boxes <= referee.most_boxes]
        return sieve(ours, able, ask)


def summaries(judged: Sequence[Judged], court: Court) -> Iterator[dict[str, Any]]:
    """The fields of a result for each referee that judged plans: the numbers of judged plans and of equal verdicts, and
    the plans on which it differs from petmjx."""
    for name, referee in court.referees.items():
        answered = [case for case in judged if name in case.trial.said]
        if not answered:
            continue
        differ = [case for case in answered if case.trial.said[name][0] != case.trial.ours]
        yield {
            "engine": name,
            "settings": {**referee.settings, "version": version(referee.settings["package"])},
            "plans": len(judged),
            "asked": len(answered),
            "agree": len(answered) - len(differ),
            "converged_against": sum(name in case.trial.converged_against for case in differ),
            "contradicted": sum(case.trial.is_contradicted for case in differ),
            "cpu_s": court.cpu_s[name],
            "differ": [case.record() for case in differ],
        }


def by_softness(judged: Sequence[Judged], plans: Sequence[Plan], check: Check, **options: Any) -> dict[str, Any]:
    """The plans that are unstable only with the physics ``reference``: petmjx, and all referees that judged them, call
    these plans stable."""
    results = petmjx.score(list(plans), engine="mujoco", check=check.value, physics="reference", **options)
    fallen = set(results.worlds.loc[results.worlds["verdict"] == "unstable", "plan_id"])
    stand_all = [case for case in judged if case.trial.verdicts == {"stable"}]
    alone = [case.plan_id for case in stand_all if case.plan_id in fallen]
    return {
        "engine": "mujoco",
        "physics": "reference",
        "plans": len(judged),
        "all_stand": len(stand_all),
        "alone": alone,
    }


def _or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None
