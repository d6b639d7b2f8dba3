"""The results of the criteria: in memory and as files."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pandas as pd

from petmjx.basics.errors import InputError
from petmjx.basics.text import counted
from petmjx.basics.whole import writing
from petmjx.results.described import Described, write_described
from petmjx.results.files import text
from petmjx.results.plain import plain
from petmjx.statics.named import Criterion, chosen_criteria
from petmjx.statics.tables import (
    described_boxes,
    described_judged,
    described_plans,
    described_thresholds,
)

INFO_FILE: Final = "criteria.json"


@dataclass(frozen=True, eq=False)
class CriteriaResults:
    """Answers of closed-form criteria, and how they compare with a run.

    Attributes:
        boxes: a row a box: for each criterion its answer and its slack (``<criterion>_slack``).
        plans: a row a plan: for each criterion whether all boxes are stable, the first that is not (``_first``), and
            the least slack.
        judged: a row for each criterion, compared with the verdicts of a run; None without one.
        thresholds: a row for each criterion with a number: the threshold that agrees best with the simulation; None
        without a run.
        info: options, counts, skipped plans and times.
    """

    boxes: pd.DataFrame
    plans: pd.DataFrame
    judged: pd.DataFrame | None
    thresholds: pd.DataFrame | None
    info: dict[str, Any]

    def __repr__(self) -> str:
        criteria = counted(len(self.criteria), "criterion", "criteria")
        return f"CriteriaResults({counted(len(self.plans), 'plan')}, {criteria})"

    @property
    def criteria(self) -> tuple[Criterion, ...]:
        """The criteria that were evaluated."""
        return chosen_criteria(self.info["criteria"])

    def units(self, table: str) -> dict[str, str]:
        """Column → unit of a table: ``""`` for text, ``"1"`` for counts and shares.

        Raises:
            KeyError: there is no such table.
        """
        found = {name: described for name, _, described in self._tables()}
        return {column: unit for column, (unit, _) in found[table].items()}

    def write(self, folder: str | Path, overwrite: bool = False) -> None:
        """Write every table as Parquet, with units in the metadata of its columns, and as CSV; the rest as JSON.

        Raises:
            InputError: the folder holds such files already and ``overwrite`` is not set, or cannot be written.
        """
        folder = Path(folder)
        check_folder_free(folder, overwrite)
        with writing(folder):
            info = text(json.dumps(plain(self.info), indent=2, allow_nan=False))
            write_described(folder, self._tables(), {INFO_FILE: info})

    def _tables(self) -> Iterator[tuple[str, pd.DataFrame, Described]]:
        yield "boxes", self.boxes, described_boxes(self.criteria)
        yield "plans", self.plans, described_plans(self.criteria)
        if self.judged is not None:
            yield "judged", self.judged, described_judged()
        if self.thresholds is not None:
            yield "thresholds", self.thresholds, described_thresholds()


def check_folder_free(folder: Path, overwrite: bool) -> None:
    """Refuse, before minutes of work, a folder that holds criteria already and may not be replaced, or a file.

    Raises:
        InputError: it is one of these.
    """
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    if not existing.is_dir():
        raise InputError(f"{folder}: cannot be written: {existing} is not a folder")
    if (folder / INFO_FILE).exists() and not overwrite:
        raise InputError(f"{folder}: holds criteria already; name another folder with --out, or pass --overwrite")
