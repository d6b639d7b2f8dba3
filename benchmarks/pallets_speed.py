"""Measures physics in the loop: how many candidates per second are simulated on standing pallets, and whether
placements have the same results as scores."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import jax
import numpy as np

import petmjx
from benchmarks.result_fields import Result, peak_device_bytes, timed
from petmjx.common.units import FloatArray
from petmjx.engines.protocol import Engine
from petmjx.packers.sample_plans import generate
from petmjx.plans.bedbpp_writer import Placement
from petmjx.plans.plan import Plan

BOXES: Final = 30
"""Number of boxes of a pallet on which candidates are tried."""

LEAST_SUPPORT: Final = 0.5
"""Smallest supported share of a candidate's base. No packer would try candidates with a smaller share."""

DISTINCT: Final = 64
"""Number of pallets that are built. Further pallets are copies of these."""

REPEATS: Final = 20

_WARM: Final = 100
"""Number of placements after which nothing should be compiled any more."""

_MOST_PLACED: Final = 8
"""Largest number of boxes of a pallet in the case ``memory``."""

_RESET_SHARE: Final = 0.05
"""Share of pallets that the case ``memory`` resets before each call."""

_TABLES: Final = ("worlds", "boxes")


@dataclass(frozen=True, eq=False)
class Loop:
    """Settings and methods that the cases share.

    Attributes:
        plans: plans whose first boxes are placed; None for generated plans of the packer ``balanced``.
        pallets, candidates: numbers of pallets and of candidates in the case ``candidates``; ``count``: number of plans
            in ``placed``, of placements in ``memory``, or of episodes.
        options: fields of ``petmjx.Simulation``.
    """

    engine: Engine
    plans: Sequence[Plan] | None = None
    pallets: int = 1024
    candidates: int = 16
    count: int = 2000
    seed: int = 0
    boxes: int = BOXES

    def usual(self, n: int, least: int) -> list[Plan]:
        """n plans for the euro-pallet with at least this many boxes."""
        if self.plans is not None:
            plans = [plan for plan in self.plans if plan.n_boxes >= least][:n]
        else:
            drawn, plans = generate(200_000, self.seed, packer="balanced"), []
            while len(plans) < n:
                plan_id, placements = next(drawn)
                plan = _plan(plan_id, placements)
                if plan.n_boxes >= least and (_far(plan) <= (1200, 800)).all():
                    plans.append(plan)
        if not plans:
            raise petmjx.InputError(f"no plan has {least} boxes")
        return plans

    def built(self, n: int) -> tuple[petmjx.Pallets, list[Plan]]:
        """n standing pallets of ``boxes`` boxes, and the plan of each pallet. Copies of other pallets take the place of
        pallets that have fallen."""
        distinct = self.usual(min(n, DISTINCT), self.boxes + 1)
        pallets = petmjx.Pallets(n, engine=self.engine)
        rows = np.arange(len(distinct))
        for number in range(self.boxes):
            _place(pallets, rows[~pallets.ended[rows]], distinct, number)
        standing = rows[pallets.results(rows).stable]
        from_ = standing[np.arange(n) % len(standing)]
        others = np.arange(n)[from_ != np.arange(n)]
        plans = [distinct[row] for row in from_]
        pallets.fork(from_[others], others)
        return pallets, plans

    def asked(self, pallets: petmjx.Pallets, plans: Sequence[Plan], per_pallet: int) -> dict[str, Any]:
        """Arguments for trials of candidates on each pallet: the lowest supported places for later boxes of the
        pallet's plan."""
        rng = np.random.default_rng(self.seed)
        columns: dict[str, list[Any]] = {"size_mm": [], "corner_mm": [], "mass_kg": [], "pallet": []}
        per_plan: dict[str, list[tuple[Any, Any, Any]]] = {}
        for pallet, plan in enumerate(plans):
            if plan.plan_id not in per_plan:
                later = np.arange(self.boxes, plan.n_boxes)
                sizes = plan.size_mm[later]
                places = pallets.places(size_mm=sizes, pallet=pallet)
                good = np.flatnonzero(places.support >= LEAST_SUPPORT)
                chosen = rng.choice(good, per_pallet, replace=len(good) < per_pallet)
                boxes = later[places.row[chosen]]
                rows = zip(plan.size_mm[boxes], places.corner_mm[chosen], plan.mass_kg[boxes], strict=True)
                per_plan[plan.plan_id] = list(rows)
            for size, corner, mass in per_plan[plan.plan_id]:
                for name, value in zip(columns, (size, corner, mass, pallet), strict=True):
                    columns[name].append(value)
        return {name: np.array(values) for name, values in columns.items()}


def candidates(loop: Loop) -> Result:
    """Measure calls that try several candidates on each of many pallets."""
    return _many(loop, loop.pallets, loop.candidates)


def one_pallet(loop: Loop) -> Result:
    """Measure calls that try ``pallets`` candidates on a single pallet."""
    return _many(loop, 1, loop.pallets)


def one_candidate(loop: Loop) -> Result:
    """Measure calls that try one candidate on one pallet."""
    pallets, plans = loop.built(1)
    batch = loop.asked(pallets, plans, REPEATS)
    calls = [{name: values[row : row + 1] for name, values in batch.items()} for row in range(REPEATS)]
    pallets.try_all(**calls[0])
    seconds = []
    for call in calls:
        begin = time.perf_counter()
        pallets.try_all(**call)
        seconds.append(time.perf_counter() - begin)
    return {"median_ms": 1e3 * float(np.median(seconds)), "max_ms": 1e3 * max(seconds), "calls": REPEATS}


def placed(loop: Loop) -> Result:
    """Place plans box by box, and count the columns in which the results differ, in any bit, from a score of the
    plans."""
    plans = loop.usual(loop.count, 1)
    pallets = petmjx.Pallets(len(plans), engine=loop.engine)
    placements, most = 0, max(plan.n_boxes for plan in plans)
    stable = np.zeros(len(plans), bool)
    with timed() as clock:
        for number in range(most):
            rows = np.flatnonzero([plan.n_boxes > number for plan in plans] & ~pallets.ended)
            answer = _place(pallets, rows, plans, number)
            stable[rows] = answer.stable
            placements += len(rows)
    placed_plans = [pallets.plan(row, plan.plan_id) for row, plan in enumerate(plans)]
    complete_rows = [row for row, plan in enumerate(plans) if placed_plans[row].n_boxes == plan.n_boxes]
    scored, expected = pallets.score(), petmjx.score([pallets.plan(k) for k in range(len(plans))], **_same(loop))
    differ = {}
    for table in _TABLES:
        ours, theirs = getattr(scored, table), getattr(expected, table)
        for name in theirs.columns:
            same = (ours[name] == theirs[name]) | (ours[name].isna() & theirs[name].isna())
            if not same.all():
                differ[f"{table}.{name}"] = int((~same).sum())
    verdicts = scored.worlds.verdict.to_numpy()
    return {
        "plans": len(plans),
        "whole": len(complete_rows),
        "placements": placements,
        "placements_per_s": placements / clock.wall_s,
        "columns": sum(len(getattr(expected, table).columns) for table in _TABLES),
        "columns_that_differ": differ,
        "stable": int((verdicts == "stable").sum()),
        "told_otherwise": int(((verdicts == "stable") != stable).sum()),
        **_clock(clock),
    }


def memory(loop: Loop) -> Result:
    """Place boxes and reset pallets many times, and measure whether memory grows, and whether anything is compiled.

    Pallets are reset when they are full or have fallen, and some at random: the number of pallets changes from call to
    call.
    """
    plans = loop.usual(min(loop.pallets, max(loop.count // 1000, 64)), _MOST_PLACED)
    pallets = petmjx.Pallets(len(plans), engine=loop.engine)
    rng, programs = np.random.default_rng(loop.seed), _Programs()
    done, marks, compiled = 0, [], []
    with timed() as clock:
        while done < loop.count:
            over = pallets.ended | (pallets.n_boxes >= _MOST_PLACED) | (rng.random(len(plans)) < _RESET_SHARE)
            pallets.reset(np.flatnonzero(over))
            done += len(_place(pallets, np.arange(len(plans)), plans, pallets.n_boxes))
            marks.append((done, _resident_bytes()))
            compiled.append(programs.count)
    begin = next(used for placements, used in marks if placements >= loop.count // 4)
    warm = next(number for number, (placements, _) in enumerate(marks) if placements >= _WARM)
    return {
        "placements": done,
        "placements_per_s": done / clock.wall_s,
        "grown_bytes": marks[-1][1] - begin,
        "rss_bytes": marks[-1][1],
        "device_bytes": peak_device_bytes(),
        "programs": {f"in the first {marks[warm][0]} placements": compiled[warm], "in all": compiled[-1]},
        **_clock(clock),
    }


def environment(loop: Loop) -> Result:
    """Measure the vector environment, with random legal actions on many pallets. The time includes observations and
    masks."""
    from petmjx.gym.vector_env import PalletizingVectorEnv

    env = PalletizingVectorEnv(loop.pallets, engine=loop.engine, autoreset_mode="SameStep")
    rng = np.random.default_rng(loop.seed)
    observed, _ = env.reset(seed=loop.seed)
    warm, steps = 40, max(loop.count // loop.pallets, 1)
    placements = ended = fallen = 0
    wall = cpu = 0.0
    for step in range(warm + steps):
        mask = observed["action_mask"]
        actions = np.argmax(rng.random(mask.shape) * (mask + 1e-9), axis=1)
        with timed() as clock:
            observed, _, terminated, _, info = env.step(actions)
        if step >= warm:
            wall, cpu, placements = wall + clock.wall_s, cpu + clock.cpu_s, placements + loop.pallets
            ended += int(terminated.sum())
            if terminated.any():
                fallen += int((info["final_info"]["verdict"][terminated] != "stable").sum())
    boxes = float(env.episodes.pallets.n_boxes.mean())
    return {
        "pallets": loop.pallets,
        "placements": placements,
        "placements_per_s": placements / wall,
        "mean_boxes": boxes,
        "episodes": ended,
        "fallen": fallen,
        "wall_s": wall,
        "cpu_s": cpu,
        "peak_rss_bytes": clock.peak_rss_bytes,
    }


def bounds(loop: Loop) -> Result:
    """Compare ``count`` decisions of bounds with simulations."""
    from benchmarks.placement_bounds_check import bounds as compare

    return compare(loop.engine, loop.count, loop.seed)


def episodes(loop: Loop) -> Result:
    """Play ``count`` random episodes of small orders, with all kinds of settings."""
    from benchmarks.episodes import episodes as play  # imported here, since it needs the extra gym

    return play(loop.engine, loop.count, loop.seed)


CASES: Final[dict[str, Callable[[Loop], Result]]] = {
    "candidates": candidates,
    "one-pallet": one_pallet,
    "one-candidate": one_candidate,
    "placed": placed,
    "memory": memory,
    "environment": environment,
    "episodes": episodes,
    "bounds": bounds,
}


def measured(loop: Loop, names: Sequence[str]) -> Iterator[Result]:
    """One result per case. It includes the load of the machine, because other work makes wall times longer, but not CPU
    times."""
    for name in names:
        head = {"case": f"loop-{name}", "group": "loop", "engine": loop.engine.name, "device": loop.engine.device}
        figures = CASES[name](loop)
        yield {**head, **figures, "load_average": os.getloadavg()[0]}


def _many(loop: Loop, n: int, per_pallet: int) -> Result:
    pallets, plans = loop.built(n)
    batch = loop.asked(pallets, plans, per_pallet)
    m = len(batch["pallet"])
    pallets.try_all(**batch)
    with timed() as clock:
        answers = pallets.try_all(**batch)
    return {
        "pallets": n,
        "boxes": loop.boxes,
        "candidates": m,
        "candidates_per_s": m / clock.wall_s,
        "standing": int(answers.stable.sum()),
        "invalid": int((answers.verdict == "invalid").sum()),
        **_clock(clock),
    }


def _place(pallets: petmjx.Pallets, rows: Any, plans: Sequence[Plan], number: Any) -> petmjx.PlacementResults:
    """Place the next box of some pallets: box ``number`` of each pallet's plan. ``number``: one number for all pallets,
    or one for each."""
    which = list(zip(np.asarray(rows).tolist(), np.broadcast_to(number, len(rows)).tolist(), strict=True))
    return pallets.place(
        size_mm=np.array([plans[row].size_mm[box] for row, box in which]).reshape(-1, 3),
        corner_mm=np.array([plans[row].corner_mm[box] for row, box in which]).reshape(-1, 3),
        mass_kg=np.array([plans[row].mass_kg[box] for row, box in which]),
        pallet=np.asarray(rows, np.int64),
    )


def _same(loop: Loop) -> dict[str, Any]:
    return {"engine": loop.engine, "carrier": "euro-pallet"}


def _clock(clock: Any) -> Result:
    return {"wall_s": clock.wall_s, "cpu_s": clock.cpu_s, "peak_rss_bytes": clock.peak_rss_bytes}


def _resident_bytes() -> int:
    """The present memory of this process, bytes."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * resource.getpagesize()


class _Programs:
    """Counts the programs that JAX compiles, or takes from its cache on disk, from now on."""

    def __init__(self) -> None:
        self.count = 0
        jax.monitoring.register_event_duration_secs_listener(self._note)

    def _note(self, event: str, duration_secs: float, **_: Any) -> None:
        self.count += event == "/jax/core/compile/backend_compile_duration"


def _far(plan: Plan) -> FloatArray:
    far: FloatArray = (plan.corner_mm + plan.size_mm)[:, :2].max(axis=0)
    return far


def _plan(plan_id: str, placements: Sequence[Placement]) -> Plan:
    items = [placement["item"] for placement in placements]
    return Plan.from_boxes(
        plan_id,
        size_mm=[[item[f"{side}/mm"] for side in ("length", "width", "height")] for item in items],
        corner_mm=[placement["flb_coordinates"] for placement in placements],
        mass_kg=[item["weight/kg"] for item in items],
        orientation=[placement["orientation"] for placement in placements],
    )
