"""Lists of boxes (``BoxList``): a raw table of boxes, with information from the objects around it in the file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from petmjx.plans.column_names import ColumnMeaning, column_meanings
from petmjx.plans.raw_tables import RawTable


@dataclass(frozen=True, eq=False)
class BoxList:
    """A list of boxes as a raw table, with information from the objects around it.

    Attributes:
        table: the boxes.
        path: path of the list in the file, with [] after each list on the path: "containers[].stack.placements[]".
        parts: (n,) for each row, the name of its plan; "" if the plan has no name.
        containers: name of a plan → axis (as in ``ColumnMeaning``) → size of the plan's container, in the file's unit.
        left_out: a line about boxes that are not placed; "" if there are none.
        around: fields of the objects that contain the first box of the list.
    """

    table: RawTable
    path: str
    parts: tuple[str, ...] = ()
    containers: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    around: Mapping[str, Any] = field(default_factory=dict)

    @property
    def meanings(self) -> list[ColumnMeaning | None]:
        return column_meanings(self.table.header)

    @property
    def kinds(self) -> set[str]:
        return {meaning.kind for meaning in self.meanings if meaning is not None and not meaning.of_container}

    @property
    def has_places(self) -> bool:
        """Whether the boxes have coordinates."""
        return bool(self.kinds & {"position", "positions", "low", "matrix"})

    @property
    def has_sizes(self) -> bool:
        """Whether the boxes have sizes."""
        return bool(self.kinds & {"size", "sizes", "high"})
