"""Compares packers on the same orders: how dense their plans are, how often they stand with errors, and how much
shaking they survive. The density is measured on all orders, the results of simulations on the first orders. The errors
have another seed than the errors with which ``physical`` chooses packings and ``learned`` was trained. So a packing
that was chosen because it stands in 16 worlds must stand in other worlds, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

import petmjx
from benchmarks.packers_of_study import (
    PHYSICAL,
    RULES_ONLINE,
    Numbered,
    Packings,
    Placements,
    packed,
    packed_already,
    packed_physically,
    packers,
)
from benchmarks.result_fields import environment
from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.loop.episode_orders import Orders
from petmjx.packers.learned_packer import Policy
from petmjx.packers.packer_registry import BALANCED
from petmjx.packers.sample_plans import as_placements
from petmjx.plans.order import TARGET_EXTENT_MM, Item, Order
from petmjx.plans.plan import Plan
from petmjx.plans.plan_decoder import DecoderOptions, parse_plan
from petmjx.results.share_statistics import PairedCounts, mcnemar_p
from petmjx.runs.ready_sweeps import find_sweep

LEVELS_G: Final = (0.3, 0.5)
DIRECTIONS: Final = ("+x", "+y")
ERROR_SEED: Final = 20261124
BOOTSTRAPS: Final = 4000

PACKED: Final = ("placed", "whole", "utilisation")
JUDGED: Final = ("stands", "share", *(f"at_{level:g}_g" for level in LEVELS_G), "most_load_n")
"""Names of the measures of packing (``PACKED``), and of the measures by physics (``JUDGED``)."""


class StudySettings(NamedTuple):
    """The scope of a study.

    Attributes:
        judged: number of first orders of each set whose plans are simulated.
        physical: number of first orders of each set that ``physical`` packs.
        worlds: number of worlds with errors of each plan.
        shaken: number of first orders of each set whose plans are shaken.
        only: names of packers; None: all.
        others: name → file with plans of another packer, for orders of any set.
        policy: policy of the packer ``learned``; None for the published policy.
        workers: number of processes that pack.
        engine, threads: engine and threads of the simulations.
    """

    judged: int
    physical: int
    worlds: int
    shaken: int
    only: Sequence[str] | None
    others: Mapping[str, Path]
    policy: Policy | None
    workers: int
    engine: str
    threads: int | None

    @property
    def how(self) -> dict[str, Any]:
        """Options of ``petmjx.score``."""
        return {"engine": self.engine, "threads": self.threads}


def study(sets: Mapping[str, Sequence[Numbered]], settings: StudySettings) -> list[dict[str, Any]]:
    """One line of results for each set of orders: values for the plans of each packer, and differences between packers
    on the same orders. All plans are scored in one run and shaken in another run, because a run of many worlds costs
    little more than a run of one world.
    """
    packings_by_set = {name: _packed(name, orders, settings) for name, orders in sets.items()}
    judged = _judged(_plans(sets, packings_by_set, settings.judged), settings)
    shaken = _shaken(_plans(sets, packings_by_set, settings.shaken), settings)
    lines = []
    for name, orders in sets.items():
        tables = {}
        for packer, packings in packings_by_set[name].items():
            rows = [{"plan_id": id_, **_measures(order, packings[id_])} for id_, order in orders if id_ in packings]
            table = pd.DataFrame(rows).set_index("plan_id").assign(pack_cpu_s=packings.cpu_s)
            for more in (judged, shaken):
                table = table.join(more.xs((name, packer), level=("set", "packer"))) if len(more) else table
            tables[packer] = table
        lines.append(_line(name, tables, settings))
    return lines


def _line(name: str, tables: Mapping[str, pd.DataFrame], settings: StudySettings) -> dict[str, Any]:
    against = [other for other in (BALANCED, *RULES_ONLINE) if other in tables]
    return {
        "case": "packer-study",
        "source": name,
        "worlds": settings.worlds,
        "engine": settings.engine,
        "packers": {packer: _summary(table) for packer, table in tables.items()},
        "differences": {
            f"{packer} - {other}": _differences(tables[packer], tables[other])
            for other in against
            for packer in tables
            if packer != other and (other == BALANCED or packer.startswith("learned") or packer in settings.others)
        },
        "from_best_to_worst": _ranks(tables),
        "as_many_boxes_as_balanced": _as_many(tables),
        **environment(),
    }


def _packed(name: str, orders: Sequence[Numbered], settings: StudySettings) -> dict[str, Packings]:
    by = {
        packer: packs
        for packer, packs in packers(settings.policy).items()
        if settings.only is None or packer in settings.only
    }
    packings = packed(orders, by, settings.workers)
    print(f"{name}: {', '.join(f'{packer} {packing.cpu_s:.4f} s' for packer, packing in packings.items())}", flush=True)
    for packer, path in settings.others.items():
        earlier_packings = packed_already(path)
        if theirs := {order_id: earlier_packings[order_id] for order_id, _ in orders if order_id in earlier_packings}:
            packings[packer] = Packings(theirs)
    if settings.physical and (settings.only is None or PHYSICAL in settings.only):
        packings[PHYSICAL] = packed_physically(orders[: settings.physical], settings.workers, settings.how)
    return packings


_Key = tuple[str, str, str]
"""Name of the set, name of the packer, id of the order."""


def _plans(
    sets: Mapping[str, Sequence[Numbered]], packings_by_set: Mapping[str, Mapping[str, Packings]], most: int
) -> dict[_Key, Plan | None]:
    """The plans for the first orders of each set. If no box of an order is placed, its plan is None."""
    plans: dict[_Key, Plan | None] = {}
    for name, orders in sets.items():
        for packer, packings in packings_by_set[name].items():
            for order_id, _ in orders[:most]:
                if order_id in packings:
                    key = (name, packer, order_id)
                    placements = as_placements(packings[order_id])
                    plans[key] = (
                        parse_plan(f"{len(plans)}", placements, DecoderOptions("study")) if placements else None
                    )
    return plans


def _judged(plans: Mapping[_Key, Plan | None], settings: StudySettings) -> pd.DataFrame:
    """Whether plans stand when placed exactly, and the share of worlds with errors in which they stand. An order
    without a plan counts as one whose plan falls."""
    some = [plan for plan in plans.values() if plan is not None]
    if not some:
        return pd.DataFrame()
    with TemporaryDirectory() as folder:
        errors = Path(folder, "errors.toml")
        text = find_sweep("confidence").read_text(encoding="utf-8")
        assert "\nseed = 1\n" in text
        errors.write_text(text.replace("\nseed = 1\n", f"\nseed = {ERROR_SEED}\n"), encoding="utf-8")
        scored = petmjx.score(some, confidence=settings.worlds, errors=errors, **settings.how)
    exact = scored.worlds[scored.worlds.variant == 0].set_index("plan_id")
    assert scored.summary is not None
    share = scored.summary.set_index("plan_id").share
    columns = {
        "stands": (exact.verdict == "stable").astype(float),
        "share": share,
        "most_load_n": exact.rest_top_force_n,
    }
    return _by_key(plans, columns)


def _shaken(plans: Mapping[_Key, Plan | None], settings: StudySettings) -> pd.DataFrame:
    """For each plan and level, the share of directions in which the plan survives the level."""
    some = [plan for plan in plans.values() if plan is not None]
    if not some:
        return pd.DataFrame()
    with TemporaryDirectory() as folder:
        shaking = Path(folder, "shaking.toml")
        shaking.write_text(
            f'name = "shaking"\n[axes]\nprofile = "eumos-40509"\ndirection = {[*DIRECTIONS]}\nlevel = {[*LEVELS_G]}\n',
            encoding="utf-8",
        )
        worlds = petmjx.sweep(shaking, some, **settings.how).worlds
    columns = {}
    for level in LEVELS_G:
        here = worlds[worlds.level_g == level]
        columns[f"at_{level:g}_g"] = (here.verdict == "stable").groupby(here.plan_id).mean()
    return _by_key(plans, columns)


def _by_key(plans: Mapping[_Key, Plan | None], columns: Mapping[str, Any]) -> pd.DataFrame:
    """Columns by plan id, with the keys of plans; without a plan, loads are unknown and all other columns are 0."""
    index = pd.MultiIndex.from_tuples(plans, names=("set", "packer", "plan_id"))
    names = ["" if plan is None else plan.plan_id for plan in plans.values()]
    table = pd.DataFrame({name: values.reindex(names).to_numpy(float) for name, values in columns.items()}, index=index)
    return table.fillna({name: 0.0 for name in table if name != "most_load_n"})


def _measures(order: Order, placed: Placements) -> dict[str, float]:
    length, width = TARGET_EXTENT_MM[order.target]
    height_m = max((box.corner_mm[2] + box.item.height_mm for box in placed), default=0.0) / MM_PER_M
    volume_m3 = sum(box.item.volume_m3 for box in placed)
    space_m3 = length * width * height_m / MM_PER_M**2
    return {
        "placed": len(placed) / len(order.items),
        "whole": float(len(placed) == len(order.items)),
        "utilisation": volume_m3 / space_m3 if placed else 0.0,
    }


def _summary(table: pd.DataFrame) -> dict[str, Any]:
    """Mean of each column, with its 95 % interval."""
    summary: dict[str, Any] = {"orders": len(table)}
    for name in (*PACKED, *JUDGED):
        if name in table and (values := table[name].dropna().to_numpy()).size:
            summary[name] = _interval(values)
    seconds = float(table.pack_cpu_s.iloc[0])
    return summary if np.isnan(seconds) else {**summary, "pack_cpu_s": round(seconds, 4)}


def _interval(values: FloatArray) -> list[float]:
    """Mean and 95 % interval: percentiles of orders drawn with replacement (Efron 1979)."""
    rng = np.random.default_rng(0)
    drawn = rng.integers(len(values), size=(BOOTSTRAPS, len(values)))
    low, high = np.percentile(values[drawn].mean(axis=1), [2.5, 97.5])
    return [round(float(value), 4) for value in (values.mean(), low, high)]


def _differences(table: pd.DataFrame, other: pd.DataFrame) -> dict[str, list[float]]:
    """Column → mean difference between two packers on the same orders, with its interval. For shares of standing plans,
    also the p of McNemar's test."""
    differences = {}
    for name in ("utilisation", "placed", *JUDGED[:-1]):
        if name not in table or name not in other:
            continue
        deltas = (table[name] - other[name]).dropna().to_numpy()
        if deltas.size:
            differences[name] = _interval(deltas)
    if "stands" in differences:
        both = table[["stands"]].join(other[["stands"]], rsuffix="_other").dropna().to_numpy() > 0
        counts = PairedCounts.of(*both.T)
        if find_spec("scipy") is not None:
            differences["stands_mcnemar_p"] = [mcnemar_p(counts)]
    return differences


def _ranks(tables: Mapping[str, pd.DataFrame]) -> dict[str, list[str]]:
    """For each of two measures, the packers from the best to the worst."""
    ranks = {}
    for name in ("utilisation", "share"):
        means = {packer: table[name].mean() for packer, table in tables.items() if name in table}
        ranks[name] = sorted(means, key=lambda packer: -means[packer])
    return ranks


def _as_many(tables: Mapping[str, pd.DataFrame]) -> dict[str, float]:
    """For each packer, the share of orders of which it places at least as many boxes as ``balanced``."""
    if BALANCED not in tables:
        return {}
    reference = tables[BALANCED].placed
    return {
        packer: round(float((table.placed >= reference.reindex(table.index) - 1e-9).mean()), 4)
        for packer, table in tables.items()
    }


ROBOBPP_BOXES: Final = range(12, 161)
"""Numbers of boxes of RoboBPP's orders that are read. In ``pg.xlsx``, these are 765 pallets of a real warehouse."""


def read_set(path: Path) -> Iterator[tuple[str, Order]]:
    """The orders of one of RoboBPP's sets that have 12 to 160 boxes, for a euro-pallet. Equal boxes are one article."""
    for number, boxes in enumerate(Orders(path).some(0)):
        if len(boxes) not in ROBOBPP_BOXES:
            continue
        rows = np.column_stack([boxes.size_mm, boxes.mass_kg]).tolist()
        articles: dict[tuple[float, ...], str] = {}
        items = []
        for row in rows:
            name = articles.setdefault(tuple(row), f"{len(articles):08d}")
            items.append(Item(name, name, "", *row))
        yield f"{path.stem}-{number:05d}", Order("euro-pallet", tuple(items))
