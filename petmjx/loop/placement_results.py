"""``PlacementResults``: the results of placements on simulated pallets. There is one row for each placement, in the
order of the request."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.engines.margin import margin_of_excess, margins_of
from petmjx.engines.metrics import BoxMetrics
from petmjx.engines.mujoco.box_motion import farthest, has_dropped, shift, tilt_deg
from petmjx.engines.open_world_protocol import Snapshots, joined_records, widened_rows
from petmjx.engines.verdict import Flag, Outcome, Verdict, judge_all
from petmjx.options.thresholds import Thresholds, largest_excess


@dataclass(frozen=True, eq=False)
class PlacementResults:
    """The results of m placements. Arrays over k boxes have one column for each box of the fullest pallet, in packing
    order. Values after the last box of a pallet are NaN.

    Attributes:
        pallet: (m,) number of each placement's pallet.
        stable: (m,) whether all boxes on the pallet stand.
        verdict, reason: (m,) verdict on the pallet, as in the table ``worlds`` of a run: "stable", "unstable" or
            "invalid"; and the reason if the verdict is not "stable".
        culprit: (m,) index of the box that shifted, tilted or fell first, from 0; -1 if none did.
        margin: (m,) distance to the nearest threshold, as in the column ``margin`` of the table ``worlds``; NaN if the
            verdict is "invalid".
        shift_mm: (m,) largest displacement of any box along x, y or z from its planned place.
        tilt_deg: (m,) largest tilt of any box since it was placed.
        n_boxes: (m,) number of boxes on the pallet, including the new box.
        ended: (m,) whether the pallet has fallen or its simulation has failed, so that no more boxes can be placed.
        moving: (m,) whether boxes on the pallet were still moving when the longest waiting time was over.
        top_force_n: (m, k) force on the top of each box in the last step, N.
        middle_mm: (m, k, 3) centres of the boxes, mm; ``quat``: (m, k, 4) orientations of the boxes, as quaternions (w,
            x, y, z).
        share: (m,) share of the simulations with errors in which the pallet stands; NaN if no simulations with errors
            were requested.
    """

    pallet: NDArray[np.int64]
    stable: NDArray[np.bool_]
    verdict: NDArray[np.str_]
    reason: NDArray[np.str_]
    culprit: NDArray[np.int64]
    margin: FloatArray
    shift_mm: FloatArray
    tilt_deg: FloatArray
    n_boxes: NDArray[np.int64]
    ended: NDArray[np.bool_]
    moving: NDArray[np.bool_]
    top_force_n: FloatArray
    middle_mm: FloatArray
    quat: FloatArray
    share: FloatArray

    def __len__(self) -> int:
        return len(self.pallet)

    def __getitem__(self, rows: Any) -> PlacementResults:
        """The results in some rows. ``rows`` is a slice, an array of row numbers, or a boolean array."""
        which = np.atleast_1d(np.arange(len(self))[rows])
        return PlacementResults(**{field.name: getattr(self, field.name)[which] for field in fields(self)})

    def with_share(self, share: FloatArray) -> Self:
        """A copy of these results with another ``share``."""
        return replace(self, share=share)

    @classmethod
    def joined(cls, parts: Sequence[PlacementResults]) -> PlacementResults:
        """The results of all parts, one part after another."""
        return cls(**joined_records(parts, max(part.top_force_n.shape[1] for part in parts)))

    @classmethod
    def of_snapshots(cls, pallet: NDArray[np.int64], snapshots: Snapshots, thresholds: Thresholds) -> PlacementResults:
        """The results of simulated pallets that are at rest or have failed."""
        m, k = snapshots.max_tilt_deg.shape
        with np.errstate(invalid="ignore"):  # values are NaN after the last box of a pallet, and in failed simulations
            shifted = shift(snapshots.pos, snapshots.target, thresholds.shift_floor_m)
            quat, middles, halves = (
                values.reshape(-1, values.shape[2]) for values in (snapshots.quat, snapshots.pos, snapshots.half_size)
            )
            tilted = np.fmax(snapshots.max_tilt_deg, tilt_deg(quat).reshape(m, k))
            dropped = snapshots.dropped | has_dropped(middles, quat, halves, thresholds).reshape(m, k)
            boxes = BoxMetrics.measured(
                m,
                k,
                shift_m=shifted,
                max_tilt_deg=tilted,
                max_top_force_n=snapshots.max_top_force_n,
                dropped=dropped,
                **snapshots.sampled,
            )
            verdict, reason = judge_all(snapshots.flags, boxes, thresholds)
            over = np.nan_to_num(largest_excess(boxes, thresholds), nan=-np.inf)
        stable, invalid = verdict == str(Verdict.STABLE), verdict == str(Verdict.INVALID)
        worst = over.argmax(axis=1) if k else np.zeros(m, np.int64)
        culprit = np.where(snapshots.culprit >= 0, snapshots.culprit, np.where(invalid, -1, worst))
        margin = margin_of_excess(over.max(axis=1, initial=0.0), stable)
        return cls(
            pallet=np.asarray(pallet, np.int64),
            stable=stable,
            verdict=verdict,
            reason=reason,
            culprit=np.where(stable, -1, culprit),
            margin=np.where(invalid, np.nan, margin),
            shift_mm=_largest(farthest(shifted) * MM_PER_M),
            tilt_deg=_largest(tilted),
            n_boxes=snapshots.placed,
            ended=snapshots.ended,
            moving=(snapshots.flags & int(Flag.MOVING)) != 0,
            top_force_n=snapshots.top_force_n,
            middle_mm=snapshots.pos * MM_PER_M,
            quat=snapshots.quat,
            share=np.full(m, np.nan),
        )

    @classmethod
    def of_outcomes(
        cls, pallet: NDArray[np.int64], outcomes: Sequence[Outcome], thresholds: Thresholds
    ) -> PlacementResults:
        """The results of simulated pallets after they were shaken. The forces on tops are the forces at rest."""
        width = max((outcome.n_boxes for outcome in outcomes), default=0)

        def boxes(name: str) -> FloatArray:
            rows = []
            for outcome in outcomes:
                values = np.array(getattr(outcome.boxes, name), np.float64)
                values[outcome.n_placed :] = np.nan
                rows.append(widened_rows(values[None], width))
            return np.concatenate(rows)

        return cls(
            pallet=np.asarray(pallet, np.int64),
            stable=np.array([outcome.verdict is Verdict.STABLE for outcome in outcomes], bool),
            verdict=np.array([str(outcome.verdict) for outcome in outcomes]),
            reason=np.array([str(outcome.reason) for outcome in outcomes]),
            culprit=np.array([outcome.culprit for outcome in outcomes], np.int64),
            margin=np.array(margins_of(outcomes, thresholds)),
            shift_mm=_largest(farthest(boxes("shift_m")) * MM_PER_M),
            tilt_deg=_largest(boxes("max_tilt_deg")),
            n_boxes=np.array([outcome.n_boxes for outcome in outcomes], np.int64),
            ended=np.array([outcome.verdict is not Verdict.STABLE for outcome in outcomes], bool),
            moving=np.array([bool(outcome.flags & Flag.MOVING) for outcome in outcomes], bool),
            top_force_n=boxes("rest_top_force_n"),
            middle_mm=boxes("pos") * MM_PER_M,
            quat=boxes("quat"),
            share=np.full(len(outcomes), np.nan),
        )


def _largest(values: FloatArray) -> FloatArray:
    """(m,) the largest number in each row of (m, k) numbers, without NaN; 0 if all numbers of a row are NaN."""
    largest: FloatArray = np.nan_to_num(values, nan=0.0).max(axis=1, initial=0.0)
    return largest
