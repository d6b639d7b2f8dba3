"""Converts recorded histories of worlds (poses and forces over time) to rows of tables, and back.

The tables are ``histories``, ``frames`` and ``contacts``. petmjx.results.recording decides which worlds have histories.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.common.units import FloatArray
from petmjx.results.run_reader import RunResults, rows_of
from petmjx.results.schema import RANK
from petmjx.world.history import Contacts, History
from petmjx.world.job import ACCELERATION, FORCE

_DRIVES: Final = ((FORCE, "drive_force", "_n"), (ACCELERATION, "drive_acc", ""))
"""Kind of drive (force on the carrier, or acceleration of the carrier) → prefix and suffix of the names of its columns
in ``frames``."""

_XYZ: Final = "xyz"
_WXYZ: Final = "wxyz"


@dataclass(frozen=True, eq=False)
class RecordedWorld:
    """A recorded world (simulation of a plan) with its history. ``rank`` is the position of the world in the order of
    the run."""

    plan_id: str
    variant: int
    history: History
    rank: int

    @property
    def size(self) -> int:
        """Memory that the arrays of the history take, bytes."""
        contacts = vars(self.history.contacts) if self.history.contacts is not None else {}
        arrays = [*vars(self.history).values(), *contacts.values()]
        return sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))


Columns = Mapping[str, Any]


def history_columns(worlds: Sequence[RecordedWorld]) -> Columns:
    """Columns of the table ``histories``, which has one row for each frame and placed box of each recorded world,
    sorted by world, frame and packing order."""
    parts = []
    for world in worlds:
        history = world.history
        frame, box = np.nonzero(np.arange(history.pos.shape[1]) < history.n_placed[:, None])
        indices = frame, box
        columns: dict[str, Any] = {"box": box, "top_force_n": history.top_force_n[indices]}
        columns |= _components("pos", history.pos[indices], _XYZ, "_m") | _components(
            "quat", history.quat[indices], _WXYZ
        )
        for name in ("lin_acc", "ang_acc"):
            columns |= _components(name, _or_null(getattr(history, name), indices, 3), _XYZ)
        columns["penetration_m"] = _or_null(history.penetration_m, indices, 1)[:, 0]
        parts.append(columns | _key(history, frame))
    return _stacked_columns(worlds, parts)


def frame_columns(worlds: Sequence[RecordedWorld]) -> Columns:
    """Columns of the table ``frames``."""
    parts = []
    for world in worlds:
        history = world.history
        columns: dict[str, Any] = {"n_placed": history.n_placed}
        columns |= _components("carrier_pos", history.carrier_pos, _XYZ, "_m")
        columns |= _components("carrier_quat", history.carrier_quat, _WXYZ)
        for kind, name, end in _DRIVES:
            values = history.drive if history.drive_kind == kind else np.full(history.drive.shape, np.nan)
            columns |= _components(name, values, _XYZ, end)
        parts.append(columns | _key(history, np.arange(len(history.time_s))))
    return _stacked_columns(worlds, parts)


def contact_columns(worlds: Sequence[RecordedWorld]) -> Columns:
    """Columns of the table ``contacts``. Worlds that were recorded without details have no rows."""
    parts = []
    detailed = [world for world in worlds if world.history.contacts is not None]
    for world in detailed:
        contacts = world.history.contacts
        assert contacts is not None
        columns: dict[str, Any] = {"body_1": contacts.body[:, 0], "body_2": contacts.body[:, 1]}
        columns |= _components("point", contacts.point, _XYZ, "_m") | _components("normal", contacts.normal, _XYZ)
        columns |= _components("force", contacts.force, _XYZ, "_n") | {"distance_m": contacts.distance}
        parts.append(columns | _key(world.history, contacts.frame))
    return _stacked_columns(detailed, parts)


TABLES: Final[Mapping[str, Callable[[Sequence[RecordedWorld]], Columns]]] = {
    "histories": history_columns,
    "frames": frame_columns,
    "contacts": contact_columns,
}
"""Name of a table → the function that makes the columns of this table."""


def read_history(run: RunResults, plan_id: str, variant: int, n_boxes: int) -> History | None:
    """Read the history of a world. The result is None if the world was not recorded.

    Args:
        n_boxes: number of boxes of the plan.

    Raises:
        InputError: a part is damaged, or the tables contradict each other.
    """
    boxes, frames, touches = (_read(run, table, plan_id, variant) for table in TABLES)
    if frames is None or boxes is None:
        return None
    f, (frame, box) = len(frames["frame"]), (boxes["frame"], boxes["box"])
    exists = (frame >= 0) & (frame < f) & (box >= 0) & (box < n_boxes)
    if not np.array_equal(frames["frame"], np.arange(f)) or not exists.all():
        raise InputError(
            f"{run.path}: the tables `histories` and `frames` contradict each other about plan "
            f"{printable_name(plan_id)}"
        )

    def spread(values: FloatArray) -> FloatArray:
        wide = np.full((f, n_boxes, *values.shape[1:]), np.nan)
        wide[frame, box] = values
        return wide

    kinds = {kind: _vector(frames, name, _XYZ, end) for kind, name, end in _DRIVES}
    kind = next((kind for kind, values in kinds.items() if np.isfinite(values).all()), "")
    detailed = not np.isnan(boxes["penetration_m"]).all()
    return History(
        time_s=frames["time_s"],
        n_placed=frames["n_placed"].astype(np.int32),
        pos=spread(_vector(boxes, "pos", _XYZ, "_m")),
        quat=spread(_vector(boxes, "quat", _WXYZ)),
        top_force_n=spread(boxes["top_force_n"]),
        carrier_pos=_vector(frames, "carrier_pos", _XYZ, "_m"),
        carrier_quat=_vector(frames, "carrier_quat", _WXYZ),
        drive=kinds[kind] if kind else np.zeros((f, 3)),
        drive_kind=kind,
        lin_acc=spread(_vector(boxes, "lin_acc", _XYZ)) if detailed else None,
        ang_acc=spread(_vector(boxes, "ang_acc", _XYZ)) if detailed else None,
        penetration_m=spread(boxes["penetration_m"]) if detailed else None,
        contacts=_contacts(touches) if detailed else None,
    )


def _components(name: str, values: FloatArray, parts: str, end: str = "") -> dict[str, FloatArray]:
    """Split an array of shape (rows, components) into one column per component."""
    return {f"{name}_{part}{end}": values[:, i] for i, part in enumerate(parts)}


def _vector(columns: Mapping[str, FloatArray], name: str, parts: str, end: str = "") -> FloatArray:
    """Join the columns of a vector into an array of shape (rows, components). This function is the inverse of
    ``_components``."""
    return np.stack([columns[f"{name}_{part}{end}"] for part in parts], axis=1)


def _or_null(values: FloatArray | None, indices: tuple[NDArray[np.intp], NDArray[np.intp]], width: int) -> FloatArray:
    """(rows, width) one row of ``width`` components for each pair (frame, box) in ``indices``; NaN if ``values`` is
    None."""
    if values is None:
        return np.full((len(indices[0]), width), np.nan)
    return values[indices].reshape(-1, width)


def _key(history: History, frame: NDArray[np.integer]) -> dict[str, Any]:
    return {"frame": frame, "time_s": history.time_s[frame]}


def _stacked_columns(worlds: Sequence[RecordedWorld], parts: Sequence[Columns]) -> Columns:
    """Columns with the values of several worlds, one world after another, and additional columns that identify the
    world of each row."""
    columns: dict[str, Any] = {name: np.concatenate([part[name] for part in parts]) for name in (parts or [{}])[0]}
    rows = np.repeat(np.arange(len(worlds)), [len(part["frame"]) for part in parts])
    columns["plan_id"] = pa.array([world.plan_id for world in worlds], pa.string()).take(pa.array(rows))
    columns["variant"] = np.array([world.variant for world in worlds], np.int32)[rows]
    columns[RANK] = np.array([world.rank for world in worlds], np.int64)[rows]
    return columns


def _read(run: RunResults, table: str, plan_id: str, variant: int) -> dict[str, Any] | None:
    """A mapping from columns to values, for the rows of one world in a table. Null becomes NaN. The result is None if
    the world has no rows."""
    rows = rows_of(run, table, plan_id, variant)
    if rows is None:
        return None
    numbers = rows.drop_columns(["plan_id", "variant"])
    return {name: numbers[name].to_numpy() for name in numbers.column_names}


def _contacts(columns: Mapping[str, Any] | None) -> Contacts:
    if columns is None:
        return Contacts.none()
    return Contacts(
        frame=columns["frame"],
        body=np.stack([columns["body_1"], columns["body_2"]], axis=1),
        point=_vector(columns, "point", _XYZ, "_m"),
        normal=_vector(columns, "normal", _XYZ),
        force=_vector(columns, "force", _XYZ, "_n"),
        distance=columns["distance_m"],
    )
