"""The results of the criteria: in memory and as files."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pandas as pd

from petmjx.basics.text import counted
from petmjx.basics.whole import writing
from petmjx.results.described import Described, check_tables_free, has_keys, write_described
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
        columns_by_table = {name: described for name, _, described in self._tables()}
        return {column: unit for column, (unit, _) in columns_by_table[table].items()}

    def write(self, folder: str | Path, overwrite: bool = False) -> None:
        """Write every table as Parquet, with units in the metadata of its columns, and as CSV; the rest as JSON.

        Raises:
            InputError: the folder holds such files already and ``overwrite`` is not set, or cannot be written.
        """
        folder = Path(folder)
        check_criteria_free(folder, overwrite, judged=self.judged is not None)
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


def check_criteria_free(folder: Path, overwrite: bool, *, judged: bool, inputs: Iterable[Path] = ()) -> None:
    """Check, before minutes of work, that the files of criteria may be written into a folder.

    Args:
        judged: whether they are compared with a run.
        inputs: files that are read.

    Raises:
        InputError: as ``petmjx.results.described.check_tables_free``.
    """
    tables = ("boxes", "plans", *(("judged", "thresholds") if judged else ()))
    others = {INFO_FILE: lambda file: has_keys(file, ("criteria", "options", "n_plans"))}
    check_tables_free(folder, tables, overwrite=overwrite, inputs=inputs, others=others)
