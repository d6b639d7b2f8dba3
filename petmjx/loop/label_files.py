"""Writes labels (placements of boxes with the result of a simulation, as training data). There is a Parquet table for
each split (training, validation, test), and a card that describes the tables and states how accurate simple rules are.

While labels are made, they are written as parts (petmjx.loop.unfinished_labels). The tables are made from the parts at
the end.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from petmjx.analysis.criteria_run import criteria, need_packers
from petmjx.common.atomic_write import atomic_write, write_errors
from petmjx.common.checked_records import option
from petmjx.common.errors import InputError
from petmjx.common.overwrite_guard import check_outputs
from petmjx.common.parquet_files import open_for_arrow
from petmjx.common.safe_read import read_regular
from petmjx.common.text import count_text, printable
from petmjx.loop.placement_labels import COLUMNS, SCHEMA, SPLITS, Label, Labeller, plans_of_labels
from petmjx.loop.unfinished_labels import (
    SPLIT,
    TABLE,
    UNFINISHED,
    LabelParts,
    check_same_set,
    label_cure,
    labels_of,
    n_unfinished,
)
from petmjx.packers.learned_packer import placement_stability
from petmjx.results.folder_lock import held_folder_lock
from petmjx.results.run_folder import part_files
from petmjx.version import __version__

CARD: Final = "card.json"
README: Final = "README.md"

_ROWS: Final = 10_000
"""Number of labels in a part (a file that is written while labels are made), and number of labels in a row group of a
table. A part may also have fewer labels."""

SECONDS_PER_PART: Final = 60.0
"""Time, s, after which the labels of finished episodes (orders packed to the end) are written as a part, even if there
are fewer than ``_ROWS`` labels."""

_MOST_CARD_BYTES: Final = 1 << 20

_REPORTED: Final = 50
"""Number of labels between two reports of progress."""

MOST_JUDGED: Final = 1_000
"""Largest number of labels of the split ``test`` with which the accuracy of rules is determined."""

RULES: Final = ("support_50", "support_75", "support_100", "centre", "equilibrium")
"""Simple rules (criteria of docs/criteria.md) whose accuracy the card states for comparison. ``equilibrium`` must hold
for all boxes of the pallet, all other criteria only for the new box."""


def label_files(folder: Path) -> dict[str, Path]:
    """The path of each split's table in a folder, by the split's name."""
    return {split: folder / f"{split}.parquet" for split in SPLITS}


def write_labels(
    labeller: Labeller,
    count: int,
    folder: Path,
    *,
    source: str | Path,
    overwrite: bool = False,
    resume: bool = False,
    progress: Callable[[int], object] = lambda n_written: None,
) -> dict[str, Any]:
    """Make labels, and write the tables and the card (``card.json``, which describes the tables). Both are written at
    the end. If the process ends before all labels are made, the labels of finished episodes are kept as parts.

    Args:
        source: the file of the orders, or ``endless``, as stated in ``card.json``.
        resume: whether to continue with the unfinished labels in the folder, if there are any. ``count`` may be larger
            than in the command that began the labels.
        progress: function that is called with the number of labels made so far, including the labels of unfinished
            episodes and of earlier commands.

    Returns:
        The content of ``card.json``.

    Raises:
        InputError: the files may not be written, another process writes into the folder, labels in the folder are
            damaged or were made with other orders or options, there is no place for any box of the orders, or shapely
            is missing.
    """
    need_packers()  # the card at the end needs SciPy and shapely, so check for them before the labels are made
    files = label_files(folder)
    outputs = [*files.values(), folder / CARD, folder / README]
    inputs = [source] if isinstance(source, Path) else []
    head = _head(labeller, source)

    def check() -> dict[str, Any] | None:
        """Check the folder. If the labels are to be resumed but are already finished, return their card."""
        n_kept = 0 if overwrite else n_unfinished(folder)
        if not n_kept and resume and os.path.exists(folder / CARD):
            return _finished(folder, head, count)
        if n_kept and not resume:
            raise InputError(
                f"{folder}: holds {count_text(n_kept, 'label')} of an unfinished set; continue with "
                f"{option('--resume', 'True')}, or pass {option('--overwrite', 'True')}"
            )
        check_outputs(outputs, overwrite=overwrite or n_kept > 0, inputs=inputs, folder=folder)
        with write_errors(folder):
            parts = [folder / UNFINISHED, folder / TABLE / "x", *part_files(folder, TABLE)]
        check_outputs(parts, overwrite=True, inputs=inputs, folder=folder)
        return None

    try:
        if (card := check()) is not None:
            return card
    except InputError:
        # if another process is writing into the folder, the lock raises an error about that process, which is more
        # useful than the error of the check
        with suppress(OSError), held_folder_lock(folder):
            pass
        raise
    with ExitStack() as stack:
        if not folder.exists():
            stack.callback(_remove_if_empty, folder)
        with write_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(held_folder_lock(folder))
            if (card := check()) is not None:  # another process may have written into the folder since the first check
                return card
            parts = LabelParts(folder, head, count, resume=resume)
            try:
                _make(labeller, count, parts, progress)
            finally:
                if not parts.n_labels:
                    parts.remove()
        if not parts.n_labels:
            name = printable(str(source)) if isinstance(source, Path) else "orders"
            raise InputError(
                f"{name}: no box has a place on the empty carrier; check {option('--max-height-mm')} "
                f"({labeller.options['max_height_mm']:g}) and {option('--carrier')}"
            )
        card = _write(parts, count, files, head)
        with write_errors(folder):
            parts.remove()
        return card


def _finished(folder: Path, head: Mapping[str, Any], count: int) -> dict[str, Any]:
    """The content of ``card.json`` of the finished labels in a folder. Raises InputError if the folder has other labels
    than the requested ones, or if a table is missing or damaged."""
    try:
        card: dict[str, Any] = json.loads(read_regular(folder / CARD, _MOST_CARD_BYTES))
        n_labels = {split: card["splits"][split]["labels"] for split in SPLITS}
        n_finished = sum(n_labels.values())
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise InputError(f"{folder / CARD}: damaged; name another folder with {option('--out')}") from None
    check_same_set(folder, {name: card.get(name) for name in head}, json.loads(json.dumps(head)))
    if n_finished != count:
        raise InputError(
            f"{folder}: its {count_text(n_finished, 'label')} are finished; "
            f"name another folder with {option('--out')}, or pass {option('--overwrite', 'True')}"
        )
    for split, file in label_files(folder).items():
        try:
            with open_for_arrow(file) as stream, pq.ParquetFile(stream) as table:
                fault = "" if table.metadata.num_rows == n_labels[split] else "damaged"
        except FileNotFoundError:
            fault = "missing"
        except (pa.ArrowException, OSError, ValueError):
            fault = "damaged"
        if fault:
            raise InputError(f"{file}: {fault}; {label_cure()}")
    return card


def _make(labeller: Labeller, count: int, parts: LabelParts, progress: Callable[[int], object]) -> None:
    """Make the missing labels, and add them part by part. If an error or a signal interrupts the work, the labels of
    finished episodes (orders packed to the end) are still added."""
    waiting: list[Label] = []
    written_s, n_before = time.monotonic(), parts.n_labels
    reported = n_before

    def report(n_made: int) -> None:
        nonlocal reported
        if n_before + n_made - reported >= _REPORTED:
            reported = n_before + n_made
            progress(min(reported, count))

    try:
        for labels in labeller.episodes(count - parts.n_labels, parts.next_episode, report):
            waiting += labels
            if len(waiting) >= _ROWS or time.monotonic() - written_s > SECONDS_PER_PART:
                parts.add(waiting)
                waiting, written_s = [], time.monotonic()
    finally:
        parts.add(waiting)


def _write(parts: LabelParts, count: int, files: Mapping[str, Path], head: Mapping[str, Any]) -> dict[str, Any]:
    """Write the tables and the card for the first ``count`` labels of the parts. Returns the content of the card."""
    tally = {split: _Tally() for split in SPLITS}
    judged: list[Label] = []
    last = list(SPLITS)[-1]
    with ExitStack() as stack:
        writers = {
            split: stack.enter_context(pq.ParquetWriter(stack.enter_context(atomic_write(file)), SCHEMA))
            for split, file in files.items()
        }
        for table in _groups(parts.tables(), count):
            for split in SPLITS:
                rows = table.filter(pc.equal(table[SPLIT], split)).select(SCHEMA.names)
                if len(rows):
                    writers[split].write_table(rows.cast(SCHEMA))
                tally[split].add(rows)
                if split == last:
                    judged += labels_of(rows.slice(0, MOST_JUDGED - len(judged)))
    card = {
        **head,
        "splits": {split: numbers.numbers for split, numbers in tally.items()},
        "columns": {name: {"type": str(kind), "meaning": meaning} for name, (kind, meaning) in COLUMNS.items()},
        "baselines": baselines(judged),
    }
    folder = files[last].parent
    for name, text in ((CARD, json.dumps(card, indent=2) + "\n"), (README, _page(card))):
        with atomic_write(folder / name) as path:
            path.write_text(text, encoding="utf-8")
    return card


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):  # an OSError means that the folder is not empty
        folder.rmdir()


def _groups(tables: Iterator[pa.Table], count: int) -> Iterator[pa.Table]:
    """Join the first ``count`` rows of small tables into tables of at least ``_ROWS`` rows (the last table may be
    smaller). The small tables are parts, which have few rows if labels are made slowly (see ``SECONDS_PER_PART``)."""
    waiting: list[pa.Table] = []
    for table in tables:
        waiting.append(table.slice(0, count))
        count -= len(waiting[-1])
        if sum(map(len, waiting)) >= _ROWS:
            yield pa.concat_tables(waiting)
            waiting = []
    if waiting:
        yield pa.concat_tables(waiting)


class _Tally:
    """Counts of the labels and the orders in a split."""

    def __init__(self) -> None:
        self.labels, self.stand, self.fall = 0, 0, 0
        self.orders: set[int] = set()

    def add(self, labels: pa.Table) -> None:
        self.labels += len(labels)
        self.stand += pc.sum(labels["stands"]).as_py() or 0
        self.fall += pc.sum(pc.invert(labels["stands"])).as_py() or 0
        self.orders |= set(labels["order"].unique().to_pylist())

    @property
    def numbers(self) -> dict[str, int]:
        return {"labels": self.labels, "orders": len(self.orders), "stand": self.stand, "fall": self.fall}


def _head(labeller: Labeller, source: str | Path) -> dict[str, Any]:
    """The part of the card (``card.json``) that states how labels were made. If this part of the card is the same for
    two sets, the two sets have the same labels."""
    is_file = isinstance(source, Path)
    reading = labeller.orders.reading
    return {
        "what": "placements of boxes on pallets, labelled by physics",
        "petmjx": __version__,
        "orders": {
            "source": source.name if isinstance(source, Path) else source,
            "sha256": hashlib.sha256(source.read_bytes()).hexdigest() if isinstance(source, Path) else None,
            "number": labeller.orders.count if is_file else None,
            "units": ",".join(filter(None, (reading.wishes.units, reading.wishes.masses))) or None,
            "columns": dict(reading.wishes.columns) or None,
            "density": reading.wishes.density_kg_m3,
        },
        "options": labeller.options,
        "simulation": labeller.simulation.model_dump(mode="json"),
        "engine": labeller.engine,
    }


def baselines(labels: Sequence[Label]) -> dict[str, dict[str, float | int]]:
    """The accuracy of rules and of ``petmjx.placement_stability`` for the placements of the given labels.

    For each rule, the result has the number of labels, the share of standing placements that the rule accepts, the
    share of falling placements that the rule refuses, and the mean of the two shares. The result is empty if no
    placement stands, or if none falls.

    ``placement_stability`` was trained for boxes that a robot places inexactly. ``placement_stability`` accepts a
    placement if its estimate is above 0.5.
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
    """The card as a page of Markdown."""
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
        "Each row is a box that is put onto a pallet of other boxes, and the result of a score (`petmjx score`) of the "
        "pallet with this box: whether the pallet stands, which box fails first, and the forces on all boxes. "
        + (
            f"In {errors} further worlds, a robot places the box inexactly; `share` is the share of these worlds in "
            "which the pallet stands."
            if errors
            else ""
        )
        + "",
        "",
        "## Where the orders come from, and how boxes are placed",
        "",
        f"Orders come from {source}. Boxes come in the order's sequence. {100 * options['explore']:g} % of them "
        "are first put at a random place: an extreme point inside the carrier at which the box rests on "
        "something. All other boxes are put at a careful place (`careful`): one of the four lowest places at "
        "which three quarters of the base are borne. If the pallet does not stand, the box is taken back; a box "
        "that was put at a random place is then tried once more, at a careful place. So pallets are neither "
        "random nor like a packer's pallets.",
        "",
        "## Splits",
        "",
        "The split of an order depends only on its boxes, not on their sequence or orientation. So orders with the "
        "same boxes are in the same split, and no order of one split occurs in another.",
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
        return "\n".join(
            [*lines, "No rule is rated, because no placement of the split `test` stands, or none falls.", ""]
        )
    first = next(iter(card["baselines"].values()))
    lines += [
        f"On {count_text(first['labels'], 'label')} of the split `test`. Column `standing`: share of the standing "
        "placements that the rule accepts; `falling`: share of the falling placements that the rule refuses; `mean`: "
        "mean of both (0.5: as good as a guess).",
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
