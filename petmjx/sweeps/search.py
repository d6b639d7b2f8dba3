"""The search for the largest level survived, and how a plan failed above it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from petmjx.config import Thresholds
from petmjx.units import FloatArray
from petmjx.verdict import Outcome, Reason, Verdict

DEFAULT_TILT_DEG = float(Thresholds().tilt_deg)


MODES: Mapping[Reason, str] = {Reason.SHIFT: "slide", Reason.TILT: "tilt", Reason.DROP: "drop"}
"""Reason of an unstable world → how it failed, as in the column ``mode``."""


def failure_mode(outcome: Outcome, tilt_deg: float = DEFAULT_TILT_DEG) -> str:
    """How the first box failed: "slide", "tilt" or "drop".

    "drop" if it dropped, else "tilt" if it tilted by more than ``tilt_deg``, else "slide". A search reads this at the
    lowest level that fails. There it usually says how the failure began; far above that level, a box that slides also
    falls. For invalid worlds: the reason; for stable worlds: "".
    """
    if outcome.verdict is not Verdict.UNSTABLE or outcome.culprit < 0:
        return MODES.get(outcome.reason, str(outcome.reason))
    boxes, box = outcome.boxes, outcome.culprit
    if boxes.dropped[box]:
        return MODES[Reason.DROP]
    return MODES[Reason.TILT if boxes.max_tilt_deg[box] > tilt_deg else Reason.SHIFT]


class Bisection:
    """Search for the largest level survived, for many items (placement × profile × direction) at once.

    Levels are on a common grid, so an answer is exact to the grid's step, and the same levels are tested in any order
    of answers. Each round tests up to ``sections`` levels per item, evenly spread between the largest survived and the
    smallest failed: a device is faster with fewer, larger rounds.

    It assumes that a pallet that survives a level survives all lower ones. This can be wrong: a stronger push may press
    a box against its neighbour, where it jams. If a tested level above a failed one was survived, the answer is the
    largest level below every failure, and ``monotone`` is False for that item.

    Args:
        levels: (n_levels,) rising; g, or scale.
        n_items: number of searches.
        stands_at_rest: (n_items,) which items stand before any profile. The others are finished at once, with no level
            survived. If ``levels[0]`` is 0, an item that stands at rest has survived it.
        sections: levels tested per item and round, ≥ 1; 1 is plain bisection.
        tilt_deg: a box that failed with a larger tilt has the mode "tilt".
    """

    def __init__(
        self,
        levels: ArrayLike,
        n_items: int,
        stands_at_rest: ArrayLike | None = None,
        sections: int = 3,
        tilt_deg: float = DEFAULT_TILT_DEG,
    ) -> None:
        self._tilt_deg = tilt_deg
        self.levels: FloatArray = np.asarray(levels, dtype=np.float64)
        if self.levels.ndim != 1 or len(self.levels) < 1 or np.any(np.diff(self.levels) <= 0):
            raise ValueError("levels must be a rising list of at least one level")
        if sections < 1:
            raise ValueError(f"sections must be ≥ 1, got {sections}")
        stands = np.ones(n_items, dtype=bool) if stands_at_rest is None else np.asarray(stands_at_rest, dtype=bool)
        if stands.shape != (n_items,):
            raise ValueError(f"stands_at_rest must have one entry for each of {n_items} items")
        self.sections = sections
        known_survived = 0 if self.levels[0] == 0 else -1
        self._stands = stands
        self._survived: NDArray[np.int64] = np.where(stands, known_survived, -1).astype(np.int64)
        self._failed: NDArray[np.int64] = np.where(stands, len(self.levels), 0).astype(np.int64)
        self._best_seen = self._survived.copy()
        self._mode = np.full(n_items, "", dtype=object)
        self._box = np.full(n_items, -1, dtype=np.int64)
        self._invalid = np.zeros(n_items, dtype=np.int64)
        self._tests = np.zeros(n_items, dtype=np.int64)
        self.rounds = 0

    @property
    def converged(self) -> NDArray[np.bool_]:
        """(n_items,) whether the largest level survived is known to the grid's step."""
        done: NDArray[np.bool_] = self._failed - self._survived <= 1
        return done

    @property
    def done(self) -> bool:
        return bool(self.converged.all())

    def bounds(self) -> list[tuple[int, int]]:
        """For each item: indices of the largest level survived (−1: none) and of the smallest level that failed."""
        return list(zip(self._survived.tolist(), self._failed.tolist(), strict=True))

    def mode_of(self, outcome: Outcome) -> str:
        """`failure_mode` with this search's tilt threshold."""
        return failure_mode(outcome, self._tilt_deg)

    def next_tests(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(items, level indices) of the next round; both are empty when all items have converged."""
        items, indices = [], []
        for item in np.flatnonzero(~self.converged):
            low, high = int(self._survived[item]), int(self._failed[item])
            open_levels = high - low - 1
            count = min(self.sections, open_levels)
            inner = low + np.round(np.arange(1, count + 1) * (open_levels + 1) / (count + 1)).astype(np.int64)
            items.append(np.full(count, item))
            indices.append(inner)
        if not items:
            return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
        return np.concatenate(items).astype(np.int64), np.concatenate(indices)

    def record(
        self,
        items: ArrayLike,
        level_indices: ArrayLike,
        outcomes: Sequence[Outcome] | None = None,
        *,
        survived: ArrayLike | None = None,
        modes: Sequence[str] | None = None,
        boxes: ArrayLike | None = None,
    ) -> None:
        """Take the results of a round's tests, as outcomes or as plain arrays (survived, failure modes, boxes).

        An invalid world has not survived; its mode is the reason why it is invalid.
        """
        item_list = np.asarray(items, dtype=np.int64)
        index_list = np.asarray(level_indices, dtype=np.int64)
        if outcomes is not None:
            survived = [outcome.verdict is Verdict.STABLE for outcome in outcomes]
            modes = [self.mode_of(outcome) for outcome in outcomes]
            boxes = [outcome.culprit for outcome in outcomes]
            np.add.at(self._invalid, item_list, [outcome.verdict is Verdict.INVALID for outcome in outcomes])
        if survived is None:
            raise ValueError("record needs outcomes or survived")
        lived = np.asarray(survived, dtype=bool)
        mode_list = list(modes) if modes is not None else [""] * len(item_list)
        box_list = np.asarray(boxes if boxes is not None else np.full(len(item_list), -1), dtype=np.int64)
        if not len(item_list) == len(index_list) == len(lived) == len(mode_list) == len(box_list):
            raise ValueError("record needs one answer for each test")
        np.add.at(self._tests, item_list, 1)
        # Failures first: a level survived above a failed one must not raise the answer.
        for test in np.flatnonzero(~lived):
            item = item_list[test]
            if index_list[test] < self._failed[item]:
                self._failed[item] = index_list[test]
                self._mode[item], self._box[item] = mode_list[test], box_list[test]
        np.maximum.at(self._best_seen, item_list[lived], index_list[lived])
        below = lived & (index_list < self._failed[item_list])
        np.maximum.at(self._survived, item_list[below], index_list[below])
        self.rounds += 1

    def result(self) -> pd.DataFrame:
        """One row per item: stands_at_rest, largest_survived (NaN: none), first_failed (NaN: none up to the highest
        level), box and mode of that failure, monotone, n_tests, n_invalid, converged."""
        survived, failed = self._survived, self._failed
        top = len(self.levels) - 1
        has_failed = self._stands & (failed <= top)
        return pd.DataFrame(
            {
                "stands_at_rest": self._stands,
                "largest_survived": np.where(survived >= 0, self.levels[np.maximum(survived, 0)], np.nan),
                "first_failed": np.where(has_failed, self.levels[np.minimum(failed, top)], np.nan),
                "box": self._box,
                "mode": self._mode.astype(str),
                "monotone": self._best_seen <= failed,
                "n_tests": self._tests,
                "n_invalid": self._invalid,
                "converged": self.converged,
            }
        )
