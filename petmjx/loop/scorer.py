"""``petmjx.Scorer``: scores plans with an engine that stays loaded, for many small scores from several threads. No
files are written."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from types import TracebackType
from typing import Any, Self

import numpy as np
import pandas as pd

from petmjx.common.argument_checks import array_of, list_of
from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError, PlanWarning
from petmjx.common.units import FloatArray
from petmjx.engines.protocol import Engine
from petmjx.engines.simulation_loop import score_worlds
from petmjx.engines.world_results import World, WorldResult
from petmjx.loop.engine_setup import OF_RUN, Closable, ready_engine
from petmjx.loop.placement_results import PlacementResults
from petmjx.options.run_options import AUTO, RunOptions
from petmjx.options.simulation import Simulation
from petmjx.options.sorted_options import sorted_options
from petmjx.plans.file_formats import SupportsArrow
from petmjx.plans.plan import Plan
from petmjx.plans.plan_set import PlanSet
from petmjx.plans.plan_sources import PlanSource, usable_plans
from petmjx.results.schema import data_frame, schemas
from petmjx.results.world_rows import Part, Row
from petmjx.runs.study import NOMINAL
from petmjx.world.job import Job
from petmjx.world.scene import build_scene
from petmjx.world.surface_pairs import check_surfaces


@dataclass(frozen=True, eq=False)
class Scored:
    """The tables of a score, as in ``petmjx.RunResults``. There is one row for each plan, box or attempt (simulation of
    a plan), in the order of the plans."""

    worlds: pd.DataFrame
    boxes: pd.DataFrame
    attempts: pd.DataFrame


class Scorer(Closable):
    """Scores plans with an engine that is already running. Results are bit-identical to the results of
    ``petmjx.score``.

    ``S = petmjx.Scorer(engine="mujoco", threads=2); S.score(plans).worlds.verdict``

    Several threads may use the same object. On the engine ``mujoco``, calls from several threads share the CPU. On
    ``mjx-warp``, calls from several threads run one after another. Nothing is written to disk. A Ray or Dask actor can
    hold a Scorer (examples/ray_scorer.py, examples/dask_scorer.py).

    Args:
        engine: ``mujoco``, ``mjx-jax``, ``mjx-warp``, or an engine of your own. ``auto`` means ``mjx-warp`` if there is
            a GPU, else ``mujoco``.
        options: fields of ``petmjx.Simulation``, and ``threads`` or ``lanes`` of ``petmjx.RunOptions``.

    Raises:
        InputError: an option is unusable.
        EngineUnavailable: the requested engine cannot run on this machine.
    """

    def __init__(self, *, engine: str | Engine = AUTO, **options: Any) -> None:
        of_simulation, of_run = sorted_options(options)
        if other := next((name for name in of_run if name not in OF_RUN), None):
            raise InputError(
                f"{other}: a Scorer has no such option; the run options that it has are {', '.join(OF_RUN)}"
            )
        self.simulation = Simulation(**of_simulation)
        self._engine, self._owns_engine = ready_engine(engine, of_run, gpu=True)

    @property
    def engine(self) -> str:
        """The name of the engine."""
        return self._engine.name

    def score(self, plans: PlanSource) -> Scored:
        """Score plans, and return the tables ``worlds``, ``boxes`` and ``attempts``.

        Args:
            plans: a plan, a list of plans, a ``PlanSet``, or a data frame with one row per box.

        Raises:
            InputError: the plans are given as files, or a plan cannot be used. (A plan is never skipped.)
        """
        self._check_open()
        results = self._results(self._usable(plans))
        schedule = self.simulation.schedule.value
        rows = [
            Row.of(result.world.plan, NOMINAL.index, rank, schedule, result.outcome, result.attempts, {})
            for rank, result in enumerate(results)
        ]
        kinds = schemas()
        tables = dict(Part(rows).tables(kinds))
        frames = {name: data_frame(tables.get(name, kinds[name].empty_table())) for name in Scored.__annotations__}
        frames["worlds"]["culprit"] = frames["worlds"]["culprit"].astype("Int32")
        return Scored(**frames)

    def tell(self, *, size_mm: Any, corner_mm: Any, mass_kg: Any) -> PlacementResults:
        """Score m plans that are given as arrays, and return the results as arrays. ``PlacementResults.pallet`` is the
        number of the plan. Forces are the forces at rest.

        Args:
            size_mm, corner_mm: (m, k, 3) extents and corners of the boxes, as in ``Plan.from_boxes``; ``mass_kg``: (m,
                k) masses of the boxes. If a plan has fewer than k boxes, its values after the last box must be NaN.

        Raises:
            InputError: a shape or number is wrong. The message names the argument, or the plan and the field.
        """
        self._check_open()
        plans = _plans_of(*_arrays(size_mm, corner_mm, mass_kg))
        outcomes = [result.outcome for result in self._results(self._usable(plans))]
        return PlacementResults.of_outcomes(np.arange(len(plans)), outcomes, self.simulation.thresholds)

    def close(self) -> None:
        """Free the engine's resources. All later calls of the object's methods raise InputError."""
        self._is_closed = True
        if self._owns_engine:
            self._engine.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _usable(self, plans: PlanSource) -> Sequence[Plan]:
        if not isinstance(plans, Plan | PlanSet | SupportsArrow):
            if plans is None or isinstance(plans, str | PathLike):
                raise InputError(f"plans must be plans or a data frame, {shown_value(plans)}; petmjx.score reads files")
            plans = list_of(plans, "plans", Plan, "plans")
            if not plans:
                raise InputError("plans must hold at least one plan")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PlanWarning)  # warnings about unusual plans would not be read by anybody
            kept_plans = usable_plans(plans, self.simulation, RunOptions(strict=True)).plans
        check_surfaces(kept_plans, self.simulation)
        return kept_plans

    def _results(self, plans: Sequence[Plan]) -> list[WorldResult[World]]:
        """Simulate the given plans, and return the results in the order of the plans."""
        worlds = [World(plan, NOMINAL.index, Job(build_scene(plan, self.simulation))) for plan in plans]
        place = {id(world): number for number, world in enumerate(worlds)}
        results = list(score_worlds(worlds, self.simulation, self._engine))
        return sorted(results, key=lambda result: place[id(result.world)])


def _arrays(size_mm: Any, corner_mm: Any, mass_kg: Any) -> tuple[FloatArray, FloatArray, FloatArray]:
    try:
        shape = np.shape(mass_kg)
    except ValueError:  # the lists in the argument differ in length
        shape = ()
    if len(shape) != 2:
        raise InputError(f"mass_kg must have the shape (m, k), got {shape}")
    _, k = shape
    arrays = (
        array_of(size_mm, "size_mm", (k, 3), may_lack=True),
        array_of(corner_mm, "corner_mm", (k, 3), may_lack=True),
        array_of(mass_kg, "mass_kg", (k,), may_lack=True),
    )
    for name, values in zip(("size_mm", "corner_mm"), arrays, strict=False):
        if len(values) != len(arrays[2]):
            raise InputError(f"{name} must have {len(arrays[2])} rows, as mass_kg has, got {len(values)}")
    return arrays


def _plans_of(size_mm: FloatArray, corner_mm: FloatArray, mass_kg: FloatArray) -> list[Plan]:
    counts = np.isfinite(mass_kg).sum(axis=1)
    plans = []
    for row, count in enumerate(counts):
        if np.isfinite(mass_kg[row, count:]).any():
            raise InputError(f"mass_kg: row {row} has NaN before its last box; NaN may only fill the end of a row")
        size, corner, mass = (values[row, :count] for values in (size_mm, corner_mm, mass_kg))
        plans.append(Plan.from_boxes(str(row), size_mm=size, corner_mm=corner, mass_kg=mass))
    return plans
