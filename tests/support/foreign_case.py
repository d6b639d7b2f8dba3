"""Test cases for files of other tools: a file, its right result, a comparison with the plans that a reader makes of it,
and the same file with one wrong value. ``foreign_files`` lists all cases.

A case combines packings, a writer, a convention (units, axes, anchor, origin) and a form (encoding, delimiter,
language).
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from support.foreign_documents import KINDS, Document, Place
from support.foreign_plans import CONTACT_MM, Convention, Packing, View


@dataclass(frozen=True)
class Case:
    """A file in the form of another tool, and its right result.

    Attributes:
        name: name of the main file.
        writer: function that makes the documents (files) of the case.
        picks: functions that return the packings in the file.
        convention: units, axes, anchor and origin of the file.
        form: further arguments of the writer.
        lost: names of packing fields that the file does not have: "weight", "ids".
        free: what the file does not tell, see ``difference``.
        order: "known", or "any" if rows are shuffled and no column tells the order.
        shuffled: whether rows are not in packing order.
        refused: why no plan may be read from the file without asking the user. Empty if the file must be read.
        may_ask: whether asking the user is also right, since no reading is certain.
    """

    name: str
    writer: Callable[..., list[Document]]
    picks: tuple[Callable[[], Packing], ...]
    convention: Convention = field(default_factory=Convention)
    form: Mapping[str, Any] = field(default_factory=dict)
    lost: tuple[str, ...] = ()
    free: frozenset[str] = frozenset()
    order: str = "known"
    shuffled: bool = False
    refused: str = ""
    may_ask: bool = False

    @property
    def plans(self) -> tuple[Packing, ...]:
        """The right plans, in the order of the file. Empty if the file must be refused."""
        return () if self.refused else tuple(pick().without(*self.lost) for pick in self.picks)

    def views(self) -> list[View]:
        """The packings as they are in the file, with rows in the file's order."""
        views = []
        for pick in self.picks:
            plan = pick()
            rows = np.arange(plan.n)
            if self.shuffled:
                rows = np.random.default_rng(zlib.crc32(self.name.encode())).permutation(plan.n)
            views.append(replace(self.convention.view(plan.take(rows)), step=rows + 1))
        return views

    def documents(self) -> list[Document]:
        return self.writer(self.name, self.views(), **self.form)

    def write(self, folder: Path) -> Path:
        """Write the main file and the files beside it into a folder of this case. Returns the main file."""
        main, *_ = (document.write(folder) for document in self.documents())
        return main

    def mismatch(self, plans: Sequence[ReadPlan]) -> str:
        """What is wrong with the plans that were read from the file. Empty if nothing is wrong."""
        if self.refused:
            return f"{len(plans)} plans were read, but {self.refused}" if plans else ""
        if len(plans) != len(self.picks):
            return f"{len(plans)} plans instead of {len(self.picks)}"
        for right, read in zip(self.plans, plans, strict=True):
            if wrong := difference(right, read, self.free, self.order):
                return f"plan {right.name}: {wrong}"
        return ""


@dataclass(frozen=True)
class Damaged:
    """A case with one wrong value.

    Attributes:
        kind: kind of damage, one of ``foreign_documents.KINDS``.
        place: the row and the column that an error must name.
        box: id of the box with the wrong value.
        content: content of the main file.
    """

    case: Case
    kind: str
    place: Place
    box: str
    content: bytes

    def write(self, folder: Path) -> Path:
        main, *beside = self.case.documents()
        for document in beside:
            document.write(folder)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / main.name).write_bytes(self.content)
        return folder / main.name

    def lacks(self, message: str) -> str:
        """What is missing in an error message: one line, the file, the row or the box, or the column. Empty if nothing
        is missing."""
        if "\n" in message:
            return "one line"
        if self.case.name not in message:
            return "the file"
        row, column = self.place.row, self.place.column
        if row is None:
            return ""
        numbered = re.search(rf"(row|line|box|placement|item|element|index)\D{{0,3}}{row}\b|\[{row}\]", message)
        if not numbered and not re.search(rf"\b{re.escape(self.box)}\b", message):
            return "the row"
        # a position without its axis is enough if the file has a list
        return "" if re.search(rf"(?<!\w){re.escape(column)}(?!\w)", message, re.IGNORECASE) else "the column"


def damaged(case: Case, kind: str | None = None) -> Damaged:
    """The file of a case with a damaged value, at a box in the middle of the file.

    Args:
        kind: kind of damage, one of ``KINDS``. If None, cases take turns. In a file without sizes, a negative size is
            replaced by a garbled number.
    """
    number = zlib.crc32(case.name.encode())
    kind = kind or KINDS[number % len(KINDS)]
    if kind == "negative" and not case.form.get("sizes", True):
        kind = "word"
    document = case.documents()[0]
    box = document.n // 2
    ids = [name for view in case.views() for name in view.plan.ids]
    place, content = document.damage(kind, box)
    return Damaged(case, kind, place, ids[box], content)


def case_of(
    name: str, writer: Callable[..., list[Document]], *picks: Callable[[], Packing] | Convention, **known: Any
) -> Case:
    """A case of packings, with a convention if one is given after the packings. Arguments that are not fields of
    ``Case`` are arguments of the writer."""
    of_case = {key: known.pop(key) for key in tuple(known) if key in Case.__dataclass_fields__}
    packings = tuple(pick for pick in picks if not isinstance(pick, Convention))
    conventions = [pick for pick in picks if isinstance(pick, Convention)]
    return Case(name, writer, packings, *conventions, form=known, **of_case)


class ReadPlan(Protocol):
    """The fields of a plan that are compared, as in ``petmjx.Plan``."""

    size_mm: np.ndarray
    corner_mm: np.ndarray
    mass_kg: np.ndarray
    item_ids: tuple[str, ...]


ROUNDED_KG = 0.0051
"""Largest difference of two weights that count as equal, kg. py3dbp writes two decimals."""


def difference(right: Packing, read: ReadPlan, free: frozenset[str] = frozenset(), order: str = "known") -> str:
    """How a plan that was read differs from the right plan. Empty if it does not differ.

    Args:
        free: what the file does not tell. "shift": the place of the deck under the boxes; "mirror": whether the axes
            are mirrored; "turn": which side of the deck is called x; "scale": the unit of length.
        order: "known": packing order; "any": any order in which every box has its supports before it.
    """
    size, corner = np.asarray(read.size_mm, float), np.asarray(read.corner_mm, float)
    if len(size) != right.n:
        return f"{len(size)} boxes instead of {right.n}"
    if "scale" in free:
        scale = right.size.sum() / size.sum()
        size, corner = size * scale, corner * scale
    if order == "any" and not buildable(size, corner):
        return "a box comes before what bears it"
    least = (np.inf, "")
    for right_size, right_corner in _readings(right, free):
        moved = corner
        if free & {"shift", "mirror", "turn"}:
            moved = corner + (right_corner.min(0) - corner.min(0)) * [1.0, 1.0, 0.0]
        of_right = np.arange(right.n)  # index: box that was read; value: box of the right plan
        if order == "any":
            sorted_right, sorted_read = (
                np.lexsort(np.hstack([corners, sizes]).round().T)
                for corners, sizes in ((right_corner, right_size), (moved, size))
            )
            of_right[sorted_read] = sorted_right
        wrong = np.abs(np.hstack([moved - right_corner[of_right], size - right_size[of_right]]))
        if wrong.max() > 2 * CONTACT_MM:
            box, column = np.unravel_index(int(np.argmax(wrong)), wrong.shape)
            name = ("x", "y", "z", "length", "width", "height")[column]
            least = min(least, (float(wrong.max()), f"box {box}: {name} is wrong by {wrong.max():.3f} mm"))
            continue
        if right.weight is not None:
            mass, weight = np.asarray(read.mass_kg, float), right.weight[of_right]
            excess = np.abs(mass - weight) - ROUNDED_KG - 1e-3 * weight
            box = int(np.argmax(excess))
            if excess[box] > 0:
                return f"box {box}: {mass[box]:g} kg instead of {weight[box]:g}"
        if right.ids and tuple(read.item_ids) != tuple(right.ids[k] for k in of_right):
            return f"ids {tuple(read.item_ids)[:3]} … instead of {tuple(right.ids[k] for k in of_right)[:3]} …"
        return ""
    return least[1]


def _readings(right: Packing, free: frozenset[str]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Sizes and corners of the packing; also of the mirrored and turned packing, if the file does not tell these."""
    readings = [(right.size, right.corner)]
    if "turn" in free:
        far = right.corner[:, 1] + right.size[:, 1]
        quarter = np.column_stack([right.deck[1] - far, right.corner[:, 0], right.corner[:, 2]])
        readings.append((right.size[:, [1, 0, 2]], quarter))
    if "mirror" in free:
        for size, corner in tuple(readings):
            for axis in range(2):
                flipped, far = corner.copy(), corner[:, axis] + size[:, axis]
                flipped[:, axis] = far.max() - far
                readings.append((size, flipped))
    return readings


def buildable(size: np.ndarray, corner: np.ndarray) -> bool:
    """Whether every box rests on the deck or on a box before it in the order."""
    return not floating(size, corner, in_order=True)


def floating(size: np.ndarray, corner: np.ndarray, *, in_order: bool = False) -> list[int]:
    """Boxes above the deck that rest on no box. ``in_order``: only boxes before them in the order may be supports."""
    high = corner + size
    loose = []
    for box in range(len(size)):
        below = slice(0, box) if in_order else slice(None)
        shared = np.minimum(high[box, :2], high[below, :2]) - np.maximum(corner[box, :2], corner[below, :2])
        touches = np.abs(high[below, 2] - corner[box, 2]) < 2 * CONTACT_MM
        if abs(corner[box, 2]) > CONTACT_MM and not (touches & (shared > CONTACT_MM).all(1)).any():
            loose.append(box)
    return loose


def overlaps(size: np.ndarray, corner: np.ndarray) -> int:
    """Number of pairs of boxes that overlap."""
    high = corner + size
    shared = np.minimum(high[:, None], high[None]) - np.maximum(corner[:, None], corner[None])
    return int(np.triu((shared > 2 * CONTACT_MM).all(2), 1).sum())


def plausible(size: np.ndarray, corner: np.ndarray) -> bool:
    """Whether no boxes overlap, no box is below the deck, and no box floats."""
    return not overlaps(size, corner) and corner[:, 2].min() > -CONTACT_MM and not floating(size, corner)
