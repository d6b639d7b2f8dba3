"""A case: a file in the convention of another tool, its right result, how that is compared with what a reader makes of
it, and the same file with one value that is wrong. ``foreign_files`` has all cases.

A case is packings × a writer × a convention (units, axes, anchor, origin) × a form (encoding, delimiter, language).
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
    """A file, and the right result.

    Attributes:
        name: of the main file.
        writer: gives its documents.
        picks: the packings in the file.
        convention: units, axes, anchor and origin.
        form: further arguments of the writer.
        lost: fields of packings that the file does not have: "weight", "ids".
        free: what the file does not tell, as in ``difference``.
        order: "known", or "any": rows are shuffled, and nothing says what comes first.
        shuffled: rows are not in packing order.
        refused: why no plan may be read from it without a question; "": it must be read.
        may_ask: no reading is sure, so a question is right, too.
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
        """The right plans, in the order of the file; empty: it is refused."""
        return () if self.refused else tuple(pick().without(*self.lost) for pick in self.picks)

    def views(self) -> list[View]:
        """The packings as the file has them, rows in its order."""
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
        """Write the file, and those beside it, in a folder of this case alone; gives the main one."""
        main, *_ = (document.write(folder) for document in self.documents())
        return main

    def mismatch(self, plans: Sequence[ReadPlan]) -> str:
        """What is wrong with plans that were read from the file; "": nothing."""
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
    """A case with one value that is wrong.

    Attributes:
        kind: one of ``foreign_documents.KINDS``.
        place: the row and the column that an error has to name.
        box: the id of the box with that value.
        content: what the main file holds.
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
        """What an error's message lacks: one line, the file, the row or the box, the column; "": nothing."""
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
        # a position without its axis is enough where the file has a list
        return "" if re.search(rf"(?<!\w){re.escape(column)}(?!\w)", message, re.IGNORECASE) else "the column"


def damaged(case: Case, kind: str | None = None) -> Damaged:
    """The file of a case, damaged at a box in its middle.

    Args:
        kind: one of ``KINDS``; None: cases take turns. Files without sizes have a garbled number instead of a negative
            size.
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
    """A case of packings, and of a convention if there is one behind them. Arguments that are no fields of ``Case`` are
    the writer's."""
    of_case = {key: known.pop(key) for key in tuple(known) if key in Case.__dataclass_fields__}
    packings = tuple(pick for pick in picks if not isinstance(pick, Convention))
    conventions = [pick for pick in picks if isinstance(pick, Convention)]
    return Case(name, writer, packings, *conventions, form=known, **of_case)


class ReadPlan(Protocol):
    """What is compared of a plan that a reader has made, as in ``petmjx.Plan``."""

    size_mm: np.ndarray
    corner_mm: np.ndarray
    mass_kg: np.ndarray
    item_ids: tuple[str, ...]


ROUNDED_KG = 0.0051
"""By how much a weight may differ: py3dbp writes two digits, which round it by half of the last one."""


def difference(right: Packing, read: ReadPlan, free: frozenset[str] = frozenset(), order: str = "known") -> str:
    """How a plan that was read differs from the right one; "": not at all.

    Args:
        free: what the file does not tell. "shift": the deck's place under the boxes; "mirror": the hand of the axes;
            "turn": which of the deck's sides is called x; "scale": the unit of length.
        order: "known": packing order; "any": any order in which each box finds its supports.
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
        of_right = np.arange(right.n)  # of each box that was read
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
    """Sizes and corners of the packing, and of the same packing mirrored and turned, where a file does not tell."""
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
    """Whether each box finds something under it when it comes: the deck, or a box before it that touches from below."""
    return not floating(size, corner, in_order=True)


def floating(size: np.ndarray, corner: np.ndarray, *, in_order: bool = False) -> list[int]:
    """Boxes above the deck that nothing touches from below. ``in_order``: only boxes before them count."""
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
    """Number of pairs of boxes that share space."""
    high = corner + size
    shared = np.minimum(high[:, None], high[None]) - np.maximum(corner[:, None], corner[None])
    return int(np.triu((shared > 2 * CONTACT_MM).all(2), 1).sum())


def plausible(size: np.ndarray, corner: np.ndarray) -> bool:
    """No two boxes in one place, none below the deck, none in the air."""
    return not overlaps(size, corner) and corner[:, 2].min() > -CONTACT_MM and not floating(size, corner)
