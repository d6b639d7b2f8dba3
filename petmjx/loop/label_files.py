"""Files of labels: a Parquet table for each split, and a card with their content, and the accuracy of rules."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from petmjx.analysis.criteria_run import criteria
from petmjx.common.atomic_write import atomic_write, write_errors
from petmjx.common.checked_records import option
from petmjx.common.errors import InputError
from petmjx.common.overwrite_guard import check_outputs
from petmjx.common.text import count_text, printable
from petmjx.loop.placement_labels import COLUMNS, SCHEMA, SPLITS, Label, Labeller, plans_of_labels
from petmjx.packers.robot_placement import placement_stability
from petmjx.results.folder_lock import held_folder_lock
from petmjx.version import __version__

CARD: Final = "card.json"
README: Final = "README.md"

_ROWS: Final = 10_000
"""Labels of a row group."""

_REPORTED: Final = 50
"""Labels between two reports of progress."""

MOST_JUDGED: Final = 1_000
"""Largest number of labels of the last split for judging baselines."""

RULES: Final = ("support_50", "support_75", "support_100", "centre", "equilibrium")
"""Criteria (docs/criteria.md) that are baselines. ``equilibrium`` is evaluated for all boxes, all other criteria for
the new box."""


def label_files(folder: Path) -> dict[str, Path]:
    """The files of labels in a folder, by split."""
    return {split: folder / f"{split}.parquet" for split in SPLITS}


def write_labels(
    labeller: Labeller,
    count: int,
    folder: Path,
    *,
    source: str | Path,
    overwrite: bool = False,
    progress: Callable[[int], object] = lambda n_written: None,
) -> dict[str, Any]:
    """Make labels, and write them with their card. Files appear when all are complete.

    Args:
        source: the file of the orders, or ``endless``, for the card.
        progress: called with the number of labels that are made.

    Returns:
        The card.

    Raises:
        InputError: the files may not be written, another run writes into the folder, or no box of the orders has a
            place.
    """
    files = label_files(folder)
    outputs = [*files.values(), folder / CARD, folder / README]
    inputs = [source] if isinstance(source, Path) else []
    check = partial(check_outputs, outputs, overwrite=overwrite, inputs=inputs, folder=folder)
    check()
    with ExitStack() as stack:
        if not folder.exists():
            stack.callback(_remove_if_empty, folder)
        with write_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(held_folder_lock(folder))
        check()  # another process may have written since
        return _write(labeller, count, files, source, progress)


def _write(
    labeller: Labeller, count: int, files: Mapping[str, Path], source: str | Path, progress: Callable[[int], object]
) -> dict[str, Any]:
    """Write the tables and the card. Arguments, result and errors are those of :func:`write_labels`."""
    tally = {split: _Tally() for split in SPLITS}
    judged: list[Label] = []
    last = list(SPLITS)[-1]
    with ExitStack() as stack:
        writers = {
            split: stack.enter_context(pq.ParquetWriter(stack.enter_context(atomic_write(file)), SCHEMA))
            for split, file in files.items()
        }
        n_written = 0
        for group_labels in _groups(_watched(labeller.labels(count), progress), _ROWS):
            for split in SPLITS:
                rows = [label for label in group_labels if label["split"] == split]
                if rows:
                    writers[split].write_table(_table(rows))
                tally[split].add(rows)
            judged += [label for label in group_labels if label["split"] == last][: MOST_JUDGED - len(judged)]
            n_written += len(group_labels)
        if not n_written:
            name = printable(str(source)) if isinstance(source, Path) else "orders"
            raise InputError(
                f"{name}: no box has a place on the empty carrier "
                f"({option('--max-height-mm')} {labeller.options['max_height_mm']:g}, {option('--carrier')})"
            )
    card = _card(labeller, source, tally, judged)
    folder = files[last].parent
    for name, text in ((CARD, json.dumps(card, indent=2) + "\n"), (README, _page(card))):
        with atomic_write(folder / name) as path:
            path.write_text(text, encoding="utf-8")
    return card


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):  # the folder has files
        folder.rmdir()


def _watched(labels: Iterator[Label], progress: Callable[[int], object]) -> Iterator[Label]:
    for number, label in enumerate(labels, 1):
        if number % _REPORTED == 0:
            progress(number)
        yield label


def _groups(labels: Iterator[Label], most: int) -> Iterator[list[Label]]:
    while group := list(islice(labels, most)):
        yield group


def _table(labels: Sequence[Label]) -> pa.Table:
    """A table of ``COLUMNS``."""
    columns = []
    for name, kind in zip(SCHEMA.names, SCHEMA.types, strict=True):
        values = [label[name] for label in labels]
        columns.append(_lists(values, kind) if pa.types.is_list(kind) else pa.array(values, kind))
    return pa.Table.from_arrays(columns, schema=SCHEMA)


def _lists(values: Sequence[NDArray[Any] | None], kind: pa.DataType) -> pa.Array:
    """An array of lists of numbers, or of lists of threes."""
    rows = [np.zeros(0) if row is None else np.asarray(row, np.float32) for row in values]
    ends = np.cumsum([0, *(len(row) for row in rows)])
    flat = pa.array(np.concatenate([row.ravel() for row in rows]).astype(np.float32))
    items = pa.FixedSizeListArray.from_arrays(flat, 3) if pa.types.is_fixed_size_list(kind.value_type) else flat
    missing = np.array([row is None for row in values])
    offsets = pa.array(ends, pa.int32(), mask=np.append(missing, False))
    return pa.ListArray.from_arrays(offsets, items, kind)


class _Tally:
    """Content of a split."""

    def __init__(self) -> None:
        self.labels, self.stand, self.fall = 0, 0, 0
        self.orders: set[int] = set()

    def add(self, labels: Sequence[Label]) -> None:
        self.labels += len(labels)
        self.stand += sum(label["stands"] is True for label in labels)
        self.fall += sum(label["stands"] is False for label in labels)
        self.orders |= {label["order"] for label in labels}

    @property
    def numbers(self) -> dict[str, int]:
        return {"labels": self.labels, "orders": len(self.orders), "stand": self.stand, "fall": self.fall}


def _card(labeller: Labeller, source: str | Path, tally: dict[str, _Tally], judged: Sequence[Label]) -> dict[str, Any]:
    is_file = isinstance(source, Path)
    return {
        "what": "placements of boxes on pallets, labelled by physics",
        "petmjx": __version__,
        "orders": {
            "source": source.name if isinstance(source, Path) else source,
            "sha256": hashlib.sha256(source.read_bytes()).hexdigest() if isinstance(source, Path) else None,
            "number": labeller.orders.count if is_file else None,
        },
        "options": labeller.options,
        "simulation": labeller.pallets.simulation.model_dump(mode="json"),
        "engine": labeller.pallets.engine,
        "splits": {split: numbers.numbers for split, numbers in tally.items()},
        "columns": {name: {"type": str(kind), "meaning": meaning} for name, (kind, meaning) in COLUMNS.items()},
        "baselines": baselines(judged),
    }


def baselines(labels: Sequence[Label]) -> dict[str, dict[str, float | int]]:
    """Accuracy of rules and of ``petmjx.placement_stability`` for placements: name → number of labels, and shares of
    standing and of falling placements that are found, and their mean. Empty if no label stands, or none falls.

    ``placement_stability`` was trained for boxes that a robot places inexactly; above 0.5 the new box stands for it.
    """
    judged_labels = [label for label in labels if label["stands"] is not None]
    stands = np.array([label["stands"] for label in judged_labels], bool)
    if stands.all() or not stands.any():
        return {}
    plans = plans_of_labels(judged_labels)
    answers = criteria(plans, only=RULES)
    of_new = answers.boxes.groupby("plan_id", sort=False).last()
    of_all = answers.plans.set_index("plan_id")
    ids = [plan.plan_id for plan in plans]
    accepted = {
        name: (of_all if name == "equilibrium" else of_new).loc[ids, name].fillna(False).to_numpy(bool)
        for name in RULES
    }
    accepted["placement_stability"] = np.array([placement_stability(plan)[-1] > 0.5 for plan in plans])
    judged = {}
    for name, says in accepted.items():
        standing, falling = float(says[stands].mean()), float((~says[~stands]).mean())
        judged[name] = {
            "labels": len(judged_labels),
            "standing_found": standing,
            "falling_found": falling,
            "mean": (standing + falling) / 2,
        }
    return judged


def _page(card: dict[str, Any]) -> str:
    """The card for people."""
    orders, options, splits = card["orders"], card["options"], card["splits"]
    total = sum(numbers["labels"] for numbers in splits.values())
    source = f"the file {orders['source']} (SHA-256 {orders['sha256']})" if orders["sha256"] else "petmjx's generator"
    errors = options["errors"]
    lines = [
        "# Placements labelled by physics",
        "",
        f"{count_text(total, 'label')} by petmjx {card['petmjx']} on {card['engine']}; all options are in {CARD}.",
        "",
        "## What",
        "",
        "Each row is a box that is put onto a pallet of other boxes, and what a score of the pallet with it says "
        "(`petmjx score`): whether it stands, what fails first, and the forces on all boxes. "
        + (f"`share` is of {errors} worlds in which a robot places the box inexactly." if errors else "")
        + "",
        "",
        "## From which orders, and how",
        "",
        f"Orders come from {source}. Boxes come in the order's sequence. {100 * options['explore']:g} % of them go to "
        "a random place first (an extreme point inside the carrier at which the box would rest, whatever bears it), "
        "all others to one of the four lowest places with three quarters of the base borne (`careful`). Where the "
        "pallet does not stand, the box is taken back and tried once at such a place. So pallets are neither random "
        "nor a packer's.",
        "",
        "## Splits",
        "",
        "An order is in one split by its boxes, in any sequence and turned in any way. Orders with the same boxes are "
        "in one split, so that no split has seen an order of another.",
        "",
        "| split | labels | orders | stand | fall | without a verdict |",
        "| --- | ---: | ---: | ---: | ---: | ---: |",
    ]
    for split, n in splits.items():
        n_without_verdict = n["labels"] - n["stand"] - n["fall"]
        lines.append(f"| {split} | {n['labels']} | {n['orders']} | {n['stand']} | {n['fall']} | {n_without_verdict} |")
    lines += ["", "## Columns", "", "| column | type | meaning |", "| --- | --- | --- |"]
    lines += [f"| `{name}` | {of['type']} | {of['meaning']} |" for name, of in card["columns"].items()]
    lines += ["", "## Baselines", ""]
    if not card["baselines"]:
        return "\n".join([*lines, "Not judged: the split test has no labels of both kinds.", ""])
    first = next(iter(card["baselines"].values()))
    lines += [
        f"On {count_text(first['labels'], 'label')} of the split test: the shares of standing and of falling "
        "placements that are found, and their mean (0.5: a guess).",
        "",
        "| baseline | standing | falling | mean |",
        "| --- | ---: | ---: | ---: |",
        *(
            f"| `{name}` | {of['standing_found']:.3f} | {of['falling_found']:.3f} | {of['mean']:.3f} |"
            for name, of in card["baselines"].items()
        ),
        "",
    ]
    return "\n".join(lines)
