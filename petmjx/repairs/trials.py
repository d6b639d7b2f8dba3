"""Trials of changed plans by simulation: at rest or after a drive, exactly placed and with errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import pandas as pd

from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.engines.verdict import Verdict
from petmjx.options.run_options import Confidence, RunOptions, sorted_options
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.repairs.drafts import Draft
from petmjx.repairs.repair_options import RepairOptions
from petmjx.results.run_reader import RunResults
from petmjx.runs.confidence import confidence_sweep
from petmjx.runs.simulate import simulate
from petmjx.runs.study import Nominal
from petmjx.runs.sweep_file import Sweep, sweep_of_tables
from petmjx.runs.sweep_study import SweepStudy
from petmjx.world.profiles.profile import Strength
from petmjx.world.profiles.profile_registry import resolve

OF_RUN: Final = ("engine", "threads", "lanes", "world_timeout_s")
"""Fields of ``RunOptions`` that a repair accepts."""


class Trial(NamedTuple):
    """The simulation of one draft.

    Attributes:
        verdict, reason: as in the table ``worlds``.
        culprit: number of the box that first crossed a limit; None: none did.
        fallen: numbers of all boxes that crossed one.
        n_placed: boxes that were placed before the world ended.
        margin: as in the table ``worlds``; NaN: there is none.
    """

    verdict: str
    reason: str
    culprit: int | None
    fallen: tuple[int, ...]
    n_placed: int
    margin: float

    @property
    def stands(self) -> bool:
        """Whether the plan stands."""
        return self.verdict == Verdict.STABLE.value

    @property
    def n_standing(self) -> int:
        """Placed boxes that crossed no limit."""
        return self.n_placed - len(self.fallen)


class Share(NamedTuple):
    """Worlds with errors: those that have a verdict, and those in which the plan stands."""

    n_worlds: int
    n_standing: int

    @property
    def value(self) -> float:
        """The share that stands; NaN: no world has a verdict."""
        return self.n_standing / self.n_worlds if self.n_worlds else float("nan")


class Question:
    """What is asked of plans: whether they stand at rest, or after a drive.

    Attributes:
        sim: options of the simulation.
        n_simulated: worlds that were simulated so far.

    Args:
        how: fields of ``petmjx.Simulation``, ``errors``, and the run's options of ``OF_RUN``.
        options: the profile, and the number of worlds with errors.

    Raises:
        InputError: options are unusable.
    """

    def __init__(self, how: Mapping[str, Any], options: RepairOptions) -> None:
        of_simulation, of_run, sure = sorted_options(how, Confidence)
        if other := next((name for name in of_run if name not in OF_RUN), None):
            raise InputError(f"{other}: a repair has no such option; of run options it has {', '.join(OF_RUN)}")
        if other := next((name for name in sure if name != "errors"), None):
            raise InputError(f"{other}: a repair has worlds, the number of worlds with errors")
        if "errors" in sure and not options.worlds:
            raise InputError("errors needs worlds > 0")
        self.sim, self._run = Simulation(**of_simulation), RunOptions(**of_run)
        self._of_simulation, self._errors, self._options = of_simulation, sure.get("errors"), options
        self.n_simulated = 0
        self._drive_sweep(self.sim.wrap.turns)  # an unusable profile is refused before anything is simulated
        if options.worlds:
            confidence_sweep(options.worlds, self._errors, of_simulation)

    @property
    def film_turns(self) -> float:
        """Turns of film around plans as they are."""
        return self.sim.wrap.turns

    def trials(self, drafts: Sequence[Draft]) -> list[Trial]:
        """The trial of each draft. All are simulated at once, but for those with other turns of film."""
        results: dict[int, Trial] = {}
        turns = dict.fromkeys(draft.film_turns for draft in drafts)
        for film_turns in turns:
            numbers = [number for number, draft in enumerate(drafts) if draft.film_turns == film_turns]
            plans = [drafts[number].as_plan(str(number)) for number in numbers]
            run = self._simulate(plans, film_turns)
            worlds = run.worlds.set_index("plan_id")
            fallen = _fallen(run, self.sim)
            for number in numbers:
                order = drafts[number].order
                results[number] = _trial(worlds.loc[str(number)], fallen.get(str(number), ()), order)
        self.n_simulated += len(drafts)
        return [results[number] for number in range(len(drafts))]

    def shares(self, plans: Sequence[Plan]) -> list[Share]:
        """The share of worlds with errors in which each plan stands at rest, as ``petmjx.score`` with ``confidence``
        reports it."""
        sweep = confidence_sweep(self._options.worlds, self._errors, self._of_simulation)
        study = partial(SweepStudy, sweep, confidence=self._options.worlds)
        run = simulate(study, sweep.simulation, list(plans), self._run)
        self.n_simulated += len(plans) * (1 + self._options.worlds)
        assert run.summary is not None
        rows = run.summary.set_index("plan_id")
        return [
            Share(int(row["n_worlds"] - row["n_invalid"]), int(row["n_standing"]))
            for row in (rows.loc[plan.plan_id] for plan in plans)
        ]

    def _simulate(self, plans: list[Plan], film_turns: float) -> RunResults:
        sweep = self._drive_sweep(film_turns)
        if sweep is None:
            return simulate(partial(Nominal, self.sim), self.sim, plans, self._run)
        return simulate(partial(SweepStudy, sweep), sweep.simulation, plans, self._run)

    def _drive_sweep(self, film_turns: float) -> Sweep | None:
        """The sweep with the one drive that is asked about; None: the question is about pallets at rest."""
        options = self._options
        if options.profile is None:
            return None
        profiles = resolve(options.profile)
        if len(profiles) != 1:
            names = ", ".join(profile.name for profile in profiles)
            raise InputError(f"profile {printable_name(options.profile)} is a family: name one of {names}")
        axes: dict[str, Any] = {"profile": options.profile, "direction": options.direction_deg}
        if profiles[0].strength is not Strength.ANGLE:
            axes[str(profiles[0].strength)] = options.level
        simulation = {**self._of_simulation, "wrap": self.sim.wrap.changed(turns=film_turns)}
        return sweep_of_tables({"name": "repair", "axes": axes}, Path("repair"), True, simulation)


def _trial(world: Any, fallen: Sequence[int], order: tuple[int, ...]) -> Trial:
    """A trial from a row of ``worlds``. Rows of boxes become numbers of the plan."""
    culprit = world["culprit"]
    known = not pd.isna(culprit)
    return Trial(
        str(world["verdict"]),
        str(world["reason"] or ""),
        order[int(culprit)] if known else None,
        tuple(order[row] for row in fallen),
        int(world["n_placed"]),
        float(world["margin"]),
    )


def _fallen(run: RunResults, sim: Simulation) -> dict[str, list[int]]:
    """Plan id → rows of the boxes that crossed a limit."""
    boxes, limits = run.boxes, sim.thresholds
    shift = boxes[["shift_x_m", "shift_y_m", "shift_z_m"]].abs().max(axis=1)
    over = (shift > limits.shift_m) | (boxes["max_tilt_deg"] > limits.tilt_deg) | boxes["dropped"]
    rows = boxes.loc[over, ["plan_id", "box"]]
    return {str(plan_id): numbers.tolist() for plan_id, numbers in rows.groupby("plan_id", observed=True)["box"]}
