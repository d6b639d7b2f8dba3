"""Compares two runs that simulated the same plans: how often their verdicts agree, and by how much their metrics
differ.

The runs are called a and b, and differences are b - a. Forces also have relative differences: |b - a| / max(a, 10 N).
The divisor is at least 10 N, about the weight of a box of 1 kg, because ratios of smaller forces do not matter for a
pallet.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.text import count_text
from petmjx.engines.metrics import DIMENSIONLESS, Column, box_columns, box_metrics, world_columns
from petmjx.engines.verdict import Verdict
from petmjx.options.thresholds import Thresholds
from petmjx.results.notebook_tables import ShownColumn, block_as_html, table_as_html
from petmjx.results.run_reader import RunResults, opened_run
from petmjx.results.to_json import to_json

FORCE_FLOOR_N: Final = 10.0
"""Smallest divisor in a relative difference of forces, N."""

KEY: Final = ["plan_id", "variant"]
BOX_KEY: Final = ["plan_id", "variant", "box"]

POSE: Final = (
    Column("position_m", "m", np.float64, "distance between the box's final centres in the two runs", compared=True),
    Column(
        "orientation_deg",
        "deg",
        np.float64,
        "angle between the box's final orientations in the two runs",
        compared=True,
    ),
)
"""The two metrics by which the poses of a box in two runs are compared. Single components of a pose are not
compared."""

SIGNLESS: Final = frozenset(
    {column.name for column in POSE} | {name for m in box_metrics() if len(m.columns) > 1 for name in m.columns}
)
"""Names of the metrics for which the sign of b - a has no meaning: distances between two poses, and components of
vectors."""

FLIPS: Final = tuple(
    ShownColumn(name, head, 2)
    for name, head in (
        ("plan_id", "plan"),
        ("verdict_a", "verdict in a"),
        ("verdict_b", "verdict in b"),
        ("margin_a", "margin in a"),
        ("margin_b", "margin in b"),
    )
)
"""Columns of the table ``flips`` that a notebook shows."""

GROUPS: Final = ("same verdict", "both stable")
"""The groups of worlds (simulations of one plan each) in which metrics are compared. Worlds that are stable in both
runs are a separate group, because metrics are chaotic in worlds in which boxes fall."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """The result of :func:`compare_runs`.

    Attributes:
        a, b: names of the two runs, which are the names of their folders.
        n_common: number of worlds that are in both runs.
        confusion: (3, 3) numbers of worlds, by their verdict in run a (rows) and in run b (columns).
        flips: one row for each world with different verdicts in the two runs. For each run, a row has the verdict, its
            reason, the first box that failed (``culprit``), and the amounts by which the world exceeds the thresholds
            of shift, tilt and acceleration. An amount is negative if the world is below the threshold; the column
            ``margin`` of the table ``worlds`` has the opposite sign.
        worlds, boxes: differences of the metrics of worlds and of boxes, one row for each metric and group of worlds.
            Columns: ``metric``, ``unit``, ``group``, ``n``; ``mean`` of b - a (null for ``SIGNLESS`` metrics);
            ``median``, ``p95`` and ``largest`` of |b - a|. The columns ``plan_id``, ``variant`` (and ``box``) tell
            where the difference is largest, and ``a`` and ``b`` are the two values there. If a group has no value of
            the metric, the columns are null. Differences are computed only for plans that are equal in both runs.
        other_plans: ids of plans that are in both runs but have different contents.
        only_a, only_b: ``plan_id`` and ``variant`` of each world that is only in run a, or only in run b.
        n_not_stable: number of worlds that are stable in neither run.
        same_reason: number of worlds that are stable in neither run and have the same reason in both runs.
        same_culprit: number of worlds that are stable in neither run and in which the same box failed first in both
            runs.
        notes: reasons to doubt the comparison, one line each.
    """

    a: str
    b: str
    n_common: int
    confusion: pd.DataFrame
    flips: pd.DataFrame
    worlds: pd.DataFrame
    boxes: pd.DataFrame
    only_a: pd.DataFrame
    only_b: pd.DataFrame
    other_plans: tuple[str, ...]
    same_reason: int
    same_culprit: int
    n_not_stable: int
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        return f"Comparison({self.a} and {self.b}: {self.n_agree:,} of {count_text(self.n_common, 'world')} agree)"

    def _repr_html_(self) -> str:
        """HTML for notebooks: the numbers of worlds by their verdict in run a (rows) and in run b (columns), and the
        worlds with different verdicts."""
        counts = self.confusion.rename_axis("a").reset_index()
        columns = [ShownColumn("a", "a \\ b"), *(ShownColumn(name, name) for name in self.confusion.columns)]
        tables = [table_as_html(counts, columns, "confusion")]
        if len(self.flips):
            tables.append(table_as_html(self.flips, FLIPS, "flips"))
        return block_as_html([repr(self), *self.notes], tables)

    @property
    def n_agree(self) -> int:
        """Number of worlds with the same verdict in both runs."""
        return self.n_common - len(self.flips)

    @property
    def flips_within(self) -> float | None:
        """The smallest x such that each world with different verdicts has a ``margin`` between -x and x in at least one
        of the two runs. It shows how near to a threshold these worlds are. The result is None if none of these worlds
        has a margin.
        """
        nearer = self.flips[["margin_a", "margin_b"]].abs().min(axis=1).max()
        return None if pd.isna(nearer) else float(nearer)

    @property
    def agreement(self) -> float | None:
        """Share of the worlds in both runs that have the same verdict; None if no world is in both runs."""
        return self.n_agree / self.n_common if self.n_common else None

    def to_dict(self) -> dict[str, Any]:
        """The whole comparison as plain JSON values. Missing numbers are None."""
        confusion = {row: dict(counts) for row, counts in self.confusion.iterrows()}
        shares = {"n_agree": self.n_agree, "agreement": self.agreement, "flips_within": self.flips_within}
        return dict(to_json(shares | vars(self) | {"confusion": confusion}))


def compare_runs(a: RunResults | str | Path, b: RunResults | str | Path, *, packers: bool = False) -> Comparison:
    """Compare two runs, world by world. A world of run a is compared with the world of run b that has the same plan and
    the same variant.

    Args:
        packers: whether the plans of the runs come from two packers. If the plans come from two packers, they are
            expected to differ, so there is no note about different plans.

    Raises:
        InputError: a folder has no run, is damaged, or has the same world twice.
    """
    run_a, run_b = opened_run(a), opened_run(b)
    for run in (run_a, run_b):
        if run.worlds.duplicated(KEY).any():
            raise InputError(
                f"{run.path}: the run has the same plan and variant more than once, so it cannot be compared"
            )
    keys = run_a.worlds[KEY].merge(run_b.worlds[KEY], on=KEY, how="outer", indicator="side")
    common_worlds = run_a.worlds.merge(run_b.worlds, on=KEY, suffixes=("_a", "_b"))
    verdicts_agree = common_worlds["verdict_a"] == common_worlds["verdict_b"]
    common_worlds[GROUPS[0]] = verdicts_agree
    common_worlds[GROUPS[1]] = verdicts_agree & (common_worlds["verdict_a"] == Verdict.STABLE.value)
    boxes = run_a.boxes_if_kept.merge(run_b.boxes_if_kept, on=BOX_KEY, suffixes=("_a", "_b"))
    boxes = boxes.merge(common_worlds[[*KEY, *GROUPS]], on=KEY)
    other = _other_plans(run_a, run_b, common_worlds, boxes)
    same_worlds, same_boxes = (table[~table["plan_id"].isin(other)] for table in (common_worlds, boxes))
    verdicts = [verdict.value for verdict in Verdict]
    confusion = pd.crosstab(common_worlds["verdict_a"], common_worlds["verdict_b"]).reindex(
        index=verdicts, columns=verdicts
    )
    not_stable = common_worlds[
        (common_worlds["verdict_a"] != Verdict.STABLE.value) & (common_worlds["verdict_b"] != Verdict.STABLE.value)
    ]
    same_culprit = (not_stable["culprit_a"] == not_stable["culprit_b"]).fillna(False)
    return Comparison(
        a=str(run_a.path),
        b=str(run_b.path),
        n_common=len(common_worlds),
        confusion=confusion.fillna(0).astype(int),
        flips=_flips(common_worlds[~verdicts_agree], thresholds_of(run_a.info), thresholds_of(run_b.info)),
        worlds=_differences(same_worlds, world_columns(), KEY),
        boxes=_differences(_with_pose_differences(same_boxes), [*POSE, *box_columns()], BOX_KEY),
        only_a=keys.loc[keys["side"] == "left_only", KEY].reset_index(drop=True),
        only_b=keys.loc[keys["side"] == "right_only", KEY].reset_index(drop=True),
        other_plans=tuple(other),
        same_reason=int((not_stable["reason_a"] == not_stable["reason_b"]).sum()),
        same_culprit=int(same_culprit.sum()),
        n_not_stable=len(not_stable),
        notes=tuple(_notes(run_a, run_b, common_worlds, [] if packers else other)),
    )


def thresholds_of(info: Mapping[str, Any]) -> Thresholds:
    """The thresholds of a run. If ``run.json`` has none, these are the default thresholds. All options in ``run.json``
    are searched, because older runs store the thresholds in another place."""
    waiting: list[Any] = [info.get("config", {})]
    while waiting:
        entry = waiting.pop(0)
        if isinstance(entry, Mapping):
            if isinstance(entry.get("thresholds"), Mapping):
                values = {name: value for name, value in entry["thresholds"].items() if name in Thresholds.model_fields}
                return Thresholds(**values)
            waiting.extend(entry.values())
    return Thresholds()


def _flips(flipped: pd.DataFrame, of_a: Thresholds, of_b: Thresholds) -> pd.DataFrame:
    columns = [*KEY]
    flips = flipped.copy()
    for side, limits in (("a", of_a), ("b", of_b)):
        flips[f"shift_margin_m_{side}"] = flips[f"max_shift_m_{side}"] - limits.shift_m
        flips[f"tilt_margin_deg_{side}"] = flips[f"max_tilt_deg_{side}"] - limits.tilt_deg
        flips[f"lin_acc_margin_m_s2_{side}"] = flips[f"max_lin_acc_{side}"] - limits.lin_acc_m_s2
        flips[f"ang_acc_margin_rad_s2_{side}"] = flips[f"max_ang_acc_{side}"] - limits.ang_acc_rad_s2
        names = ("verdict", "reason", "margin", "culprit", "first_sign_s", "n_dropped", "flags")
        margins = ("shift_margin_m", "tilt_margin_deg", "lin_acc_margin_m_s2", "ang_acc_margin_rad_s2")
        columns += [f"{name}_{side}" for name in (*names, *margins)]
    return flips[columns].reset_index(drop=True)


def _with_pose_differences(boxes: pd.DataFrame) -> pd.DataFrame:
    """Add two columns to the table of boxes: the distance (m) and the angle (deg) between the final poses of a box in
    the two runs."""

    def rows(side: str, *names: str) -> NDArray[np.float64]:
        values: NDArray[np.float64] = boxes[[f"{name}_{side}" for name in names]].to_numpy(dtype=np.float64)
        return values

    position, quaternion = ("pos_x_m", "pos_y_m", "pos_z_m"), ("quat_w", "quat_x", "quat_y", "quat_z")
    distance = np.linalg.norm(rows("b", *position) - rows("a", *position), axis=1)
    q_a, q_b = rows("a", *quaternion), rows("b", *quaternion)
    # The angle is 4·asin(chord / 2). The chord is |q_a - q_b| or |q_a + q_b|, whichever is smaller, because q and -q
    # are the same orientation. Unlike a formula with acos, this formula is exact for small angles.
    chord = np.minimum(np.linalg.norm(q_a - q_b, axis=1), np.linalg.norm(q_a + q_b, axis=1))
    angle = np.degrees(4 * np.arcsin(np.clip(chord / 2, 0, 1)))
    return boxes.assign(position_m_a=0.0, position_m_b=distance, orientation_deg_a=0.0, orientation_deg_b=angle)


def _differences(joined: pd.DataFrame, columns: Sequence[Column], key: Sequence[str]) -> pd.DataFrame:
    """One row for each compared metric and group of worlds, computed from the columns ``<metric>_a`` and
    ``<metric>_b``."""
    listed = [(column.name, column.name, column.unit) for column in columns if column.compared]
    listed += [(f"{column.name} relative", column.name, DIMENSIONLESS) for column in columns if column.relative]
    rows = []
    for metric, name, unit in listed:
        if f"{name}_a" not in joined or f"{name}_b" not in joined:
            continue
        values_a, values_b = (joined[f"{name}_{side}"].to_numpy(dtype=np.float64) for side in "ab")
        with np.errstate(invalid="ignore"):  # NumPy would warn about the difference of two infinite values
            signed = values_b - values_a
        if metric != name:
            signed = signed / np.maximum(np.abs(values_a), FORCE_FLOOR_N)
        difference = np.abs(signed)
        for group in GROUPS:
            chosen = np.flatnonzero(joined[group].to_numpy(dtype=bool) & np.isfinite(difference))
            row: dict[str, Any] = {"metric": metric, "unit": unit, "group": group, "n": len(chosen)}
            row.update(dict.fromkeys(("mean", "median", "p95", "largest", *key, "a", "b")))
            if len(chosen):
                differences = difference[chosen]
                worst = int(chosen[int(differences.argmax())])
                row["mean"] = None if name in SIGNLESS else float(signed[chosen].mean())
                row["median"], row["p95"] = (float(value) for value in np.percentile(differences, [50, 95]))
                row["largest"] = float(difference[worst])
                row.update({column: joined[column].iloc[worst] for column in key})
                row["a"], row["b"] = float(values_a[worst]), float(values_b[worst])
            rows.append(row)
    integers = {column: "Int64" for column in ("variant", "box") if column in key}
    numbers = dict.fromkeys(("mean", "median", "p95", "largest", "a", "b"), "float64")
    return pd.DataFrame(rows).astype({**integers, **numbers})


def _other_plans(run_a: RunResults, run_b: RunResults, common_worlds: pd.DataFrame, boxes: pd.DataFrame) -> list[str]:
    """Ids of plans that are in both runs but have different contents, sorted.

    Plans are compared by digest. If a run was written without digests, the numbers of boxes and the ids of items are
    compared instead.
    """
    digests = [run.plans.set_index("plan_id")["digest"] for run in (run_a, run_b)]
    plans = pd.DataFrame(index=pd.Index(common_worlds["plan_id"].unique(), dtype=object))
    first, second = (digest.reindex(plans.index) for digest in digests)
    have_digests = first.notna() & second.notna()
    unlike = {*common_worlds.loc[common_worlds["n_boxes_a"] != common_worlds["n_boxes_b"], "plan_id"]}
    unlike |= {*boxes.loc[boxes["item_id_a"] != boxes["item_id_b"], "plan_id"]}
    other = {*plans.index[have_digests & (first != second)], *(unlike & {*plans.index[~have_digests]})}
    return sorted(other)


def _notes(run_a: RunResults, run_b: RunResults, common_worlds: pd.DataFrame, other: Sequence[str]) -> list[str]:
    """Reasons to doubt the comparison, as lines for the user."""
    notes = run_a.doubts("a") + run_b.doubts("b")
    without = [name for name, run in (("a", run_a), ("b", run_b)) if not run.keeps_boxes]
    if without:
        notes.append(f"{' and '.join(without)} kept no table `boxes`: only worlds are compared")
    if common_worlds.empty:
        notes.append("no world is in both runs")
    if thresholds_of(run_a.info) != thresholds_of(run_b.info):
        notes.append("a and b have different thresholds; the margins of each run refer to the thresholds of that run")
    if other:
        of, verb = count_text(common_worlds["plan_id"].nunique(), "plan"), "is" if len(other) == 1 else "are"
        notes.append(
            f"{len(other):,} of {of} {verb} not the same in a and b, so only verdicts are compared (to compare "
            "packers: petmjx compare --packers)"
        )
    names = {run: {str(param.get("name")) for param in run.info.get("params", [])} for run in (run_a, run_b)}
    if names[run_a] != names[run_b]:
        notes.append("the variants of a and b have different parameters")
    for name in sorted(names[run_a] & names[run_b]):
        left, right = common_worlds.get(f"{name}_a"), common_worlds.get(f"{name}_b")
        if left is not None and right is not None and not ((left == right) | (left.isna() & right.isna())).all():
            notes.append(f"variants with the same number have different values of {name} in a and b")
    return notes
