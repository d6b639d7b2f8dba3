"""Checks the entries of a leaderboard: some plans of each entry are simulated again. If these simulations (replays)
contradict the verdicts in an entry's run, the entry is refused."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np

from petmjx.common.errors import EngineUnavailable
from petmjx.common.text import count_text, first_names, printable_name
from petmjx.engines.engine_registry import ENGINES
from petmjx.engines.verdict import Flag, Verdict
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.runs.simulate import simulate
from petmjx.runs.study import Nominal
from petmjx.show.leaderboard.entries import Entry
from petmjx.version import __version__

NEAR_MARGIN: Final = 0.1
"""If the absolute value of a world's margin (distance from a threshold) is smaller than this, the verdict may differ
between engines, and between machines."""

NEAR_FLAGS: Final = Flag.SINKING | Flag.MOVING | Flag.KNIFE_EDGE | Flag.TIMESTEP
"""Flags of worlds whose verdicts may differ between engines and between machines, whatever their margins are."""

_VALID: Final = (Verdict.STABLE.value, Verdict.UNSTABLE.value)


@dataclass(frozen=True)
class Replay:
    """A plan of an entry, simulated again.

    Attributes:
        plan_id: id of the plan.
        claimed: the verdict in the entry's run.
        verdict: the verdict of the replay.
        reason: the reason of the replay's verdict.
        near: whether the two verdicts may differ by chance, because the replay is near a threshold or has no valid
            verdict.
    """

    plan_id: str
    claimed: str
    verdict: str
    reason: str
    near: bool

    @classmethod
    def judged(cls, plan_id: str, claimed: str, verdict: str, reason: str, margin: float, flags: int) -> Replay:
        """Make a replay from the values of its simulation. The values come from a row of the table ``worlds``."""
        near = verdict not in _VALID or not abs(margin) >= NEAR_MARGIN or bool(flags & NEAR_FLAGS)
        return cls(plan_id, claimed, verdict, reason, near)

    @property
    def differs(self) -> bool:
        """Whether the verdict in the entry's run is valid and differs from the replay's verdict."""
        return self.claimed in _VALID and self.verdict != self.claimed


@dataclass(frozen=True)
class Sample:
    """The replays of an entry.

    Attributes:
        packer: name of the entry.
        engine: name of the engine of the replays.
        exact: whether the entry's run and the replays have the same engine and the same version of petmjx. If ``exact``
            is True, verdicts can differ only because of rounding.
        replays: the replays.
        fault: a fault of the entry's run, apart from verdicts that differ from the verdicts of replays; "" if there is
            no such fault.
    """

    packer: str
    engine: str
    exact: bool
    replays: tuple[Replay, ...] = ()
    fault: str = ""

    def with_replays(self, more: Collection[Replay]) -> Sample:
        """The sample with additional replays. Replays of plans that are already in the sample are ignored."""
        replayed_ids = {replay.plan_id for replay in self.replays}
        return replace(
            self, replays=(*self.replays, *(replay for replay in more if replay.plan_id not in replayed_ids))
        )

    @property
    def differing(self) -> list[Replay]:
        """The replays whose verdicts differ from the verdicts in the run."""
        return [replay for replay in self.replays if replay.differs]

    @property
    def refusal(self) -> str:
        """Why the entry is not rated, in one line; "" if it is rated.

        The entry is not rated if its run has a ``fault``, or if replays refute the run. Replays refute the run in three
        cases:

        - The sample is ``exact``, and one replay that is not near a threshold has another verdict than the run.
        - Two replays that are not near a threshold have other verdicts than the run.
        - At least two replays, near a threshold or not, have other verdicts than the run, and they are more than half
          of the replays.
        """
        differing = self.differing
        firm = [replay for replay in differing if not replay.near]
        most = 2 * len(differing) > len(self.replays) and len(differing) > 1
        if not (self.fault or len(firm) > 1 or (firm and self.exact) or most):
            return ""
        if self.fault:
            return f"{printable_name(self.packer)} is not rated: {self.fault}"
        first = (firm or differing)[0]
        by = f" by {first.reason}" if first.reason else ""
        many = (
            f"{len(differing):,} of {count_text(len(self.replays), 'plan')} that the leaderboard simulated again "
            "contradict"
        )
        return (
            f"{printable_name(self.packer)} is not rated: {many} its run; the first is plan "
            f"{printable_name(first.plan_id)}, {first.claimed} in the run, but {first.verdict}{by} when simulated "
            "again"
        )

    @property
    def note(self) -> str:
        """A line about verdicts that differ without refuting the run; "" if no verdict differs."""
        differing = [replay.plan_id for replay in self.differing]
        if not differing or self.refusal:
            return ""
        verb = "has" if len(differing) == 1 else "have"
        many = f"{len(differing):,} of {count_text(len(self.replays), 'plan')} of {printable_name(self.packer)}"
        return (
            f"{many} that the leaderboard simulated again {verb} another verdict than in the run: "
            f"{first_names(differing)}"
        )

    def to_dict(self) -> dict[str, Any]:
        """The sample as values for JSON."""
        plans, differing = ([replay.plan_id for replay in some] for some in (self.replays, self.differing))
        return {"packer": self.packer, "engine": self.engine, "plans": plans, "differ": differing}


def sample_entry(
    entry: Entry, most: int, sim: Simulation, options: RunOptions, wanted: Collection[str] | None
) -> Sample:
    """Simulate some plans of an entry again.

    The plans are chosen with random numbers from the operating system, so that nobody can predict which plans are
    checked. Plans that stand according to the entry's run are chosen first, since the rating depends on them.

    Args:
        most: number of plans. If a verdict differs but does not refute the run, ``most`` further plans are simulated.
        sim: simulation options of the board.
        options: run options of the board. If the options name no engine, the engine of the entry's run is used, or
            ``mujoco`` if that engine cannot run on this machine.
        wanted: ids of the plans from which the sample is chosen. If ``wanted`` is None, all plans of the run are used.
    """
    config = entry.run.info.get("config", {})
    engine = options.engine if "engine" in options.model_fields_set else str(config.get("engine"))
    sample = Sample(entry.name, "", exact=False)
    worlds = entry.run.worlds
    worlds = worlds[worlds["variant"] == 0].set_index("plan_id")
    counted_ids = [name for name in worlds.index if wanted is None or name in wanted]
    if counted_ids and not (kept_ids := [name for name in counted_ids if name in entry.plans]):
        return replace(
            sample, fault="the files of its plans were not found, so none of its plans can be simulated again"
        )
    if not counted_ids or not most:
        return sample
    if wrong := [name for name in kept_ids if worlds.at[name, "n_boxes"] != entry.plans[name].n_boxes]:
        boxes = count_text(entry.plans[wrong[0]].n_boxes, "box", "boxes")
        run_count = f"{worlds.at[wrong[0], 'n_boxes']:,} in the run"
        return replace(sample, fault=f"plan {printable_name(wrong[0])} has {boxes}, and {run_count}")
    claimed = worlds.loc[kept_ids, "verdict"].to_dict()
    drawn = _drawn(claimed)
    for _ in range(2):
        chosen, drawn = drawn[:most], drawn[most:]
        run = _simulate([entry.plans[name] for name in chosen], sim, options, engine)
        used = run.info["config"]["engine"]
        exact = used == config.get("engine") and entry.run.info.get("versions", {}).get("petmjx") == __version__
        rows = run.worlds.set_index("plan_id")
        values = rows[["verdict", "reason", "margin", "flags"]].loc[[name for name in chosen if name in rows.index]]
        replays = [Replay.judged(name, claimed[name], *value) for name, *value in values.itertuples()]
        sample = replace(sample, engine=used, exact=exact).with_replays(replays)
        if not drawn or sample.refusal or not sample.differing:
            break
    return sample


def _drawn(claimed: Mapping[str, str]) -> list[str]:
    """Ids of all plans with a valid verdict: first plans that stand, then the others, both in random order."""
    valid = [name for name, verdict in claimed.items() if verdict in _VALID]
    shuffled = [valid[at] for at in np.random.default_rng().permutation(len(valid))]
    return sorted(shuffled, key=lambda name: claimed[name] != Verdict.STABLE.value)


def _simulate(plans: Sequence[Any], sim: Simulation, options: RunOptions, engine: Any) -> Any:
    """Simulate plans. If ``engine`` cannot run on this machine, ``mujoco`` is used, unless the user named the
    engine."""
    engine_name = engine if not isinstance(engine, str) or engine in ENGINES or engine == options.engine else "mujoco"
    for candidate in dict.fromkeys((engine_name, "mujoco")):
        try:
            return simulate(
                partial(Nominal, sim), sim, list(plans), RunOptions(engine=candidate, threads=options.threads)
            )
        except EngineUnavailable:
            if candidate == "mujoco" or "engine" in options.model_fields_set:
                raise
    raise AssertionError("mujoco runs everywhere")
