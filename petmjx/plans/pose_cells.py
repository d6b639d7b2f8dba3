"""Poses in other forms than nested matrices (``with_pose_column``): numbers of a matrix in columns or in a text, and
frames of KUKA robots. The poses become one column of matrices."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.plans.cell_numbers import cell_number
from petmjx.plans.raw_tables import BoxList, RawTable
from petmjx.plans.turn_columns import rotations_of_angles

_LISTED: Final = re.compile(r"^(.*)\[(\d+)\]$")
"""The name of a member of a list: "pose[3]"."""
_ROW_AND_COLUMN: Final = re.compile(r"^(.*?)[\s_.]*[\[(]?([0-4])[\])\s_,.]*[\[(]?([0-4])[\])]?$")
"""The name of an entry of a matrix: "m00", "R_1_2", "T[0][3]"."""
_SHAPES: Final = {(3, 3): 9, (3, 4): 12, (4, 4): 16}
"""Shape of a matrix → its number of entries: a rotation; a rotation and a place; a rotation and a place, with a last
row 0, 0, 0, 1."""
# With possessive quantifiers, the time for matching is linear in the length of the text, even if the text is malicious.
_NUMBER: Final = r"[-+]?+(?:\d++(?:\.\d*+)?+|\.\d++)(?:[eE][-+]?+\d++)?+"
_ONLY_NUMBERS: Final = re.compile(rf"[\s\[\](),;]*+(?:{_NUMBER}[\s\[\](),;]*+)++")
_FRAME: Final = re.compile(rf"\s*+\{{\s*+(?:\w++\s*+:\s*+)?+(?:\w++\s++{_NUMBER}\s*+,?+\s*+)++\}}\s*+")
"""A frame of KUKA's robot language: "{X 600, Y 0, Z 150, A 90, B 0, C 0}"."""
_AXES: Final = ("X", "Y", "Z")
_ANGLES: Final = ("C", "B", "A")
"""A KUKA frame's angles about x, y and z, in degrees. The turn about z comes first. Each further turn is about an axis
that has already been turned, so the matrix is the product of the turns about z, y and x."""
_RIGHT: Final = 0.02
"""Largest deviation of a rotation's columns from unit vectors at right angles. Numbers in files are rounded."""


def with_pose_column(boxes: BoxList) -> BoxList:
    """A list of boxes with one column of matrices (nested lists). In ``boxes``, the numbers of a matrix are in several
    columns, or each matrix is a text in one column. A list without such columns is returned unchanged."""
    table = boxes.table
    if not table.has_header or not table.rows:
        return boxes
    columns = _matrix_columns(table.header)
    if columns is not None:
        name, indices, shape = columns
        matrices = _matrices([[row[index] for index in indices] for row in table.rows], shape)
        return boxes if matrices is None else replace(boxes, table=_replaced(table, name, indices, matrices))
    for index, name in enumerate(table.header):
        if (matrices := _matrices_of_texts(table.cells(index))) is not None:
            return replace(boxes, table=_replaced(table, name, [index], matrices))
    return boxes


def _matrix_columns(header: Sequence[str]) -> tuple[str, list[int], tuple[int, int] | None] | None:
    """The columns that together hold a matrix, one entry each; None if there are no such columns. Returns a name for
    the matrix, the indices of the columns, and the shape of the matrix. The indices follow the rows of the matrix. If
    the columns only number the entries ("pose[3]"), the shape is None, and the entries may follow the matrix's rows or
    its columns."""
    lists: dict[str, dict[int, int]] = {}
    entries: dict[str, dict[tuple[int, int], int]] = {}
    for index, name in enumerate(header):
        if (entry := _ROW_AND_COLUMN.match(name)) is not None:
            entries.setdefault(entry[1], {})[int(entry[2]), int(entry[3])] = index
        if (member := _LISTED.match(name)) is not None:
            lists.setdefault(member[1], {})[int(member[2])] = index
    for name, members in lists.items():
        if len(members) in _SHAPES.values() and sorted(members) == list(range(len(members))):
            return name, [members[number] for number in range(len(members))], None
    for by_place in entries.values():
        rows, columns = ({place[axis] for place in by_place} for axis in (0, 1))
        shape = len(rows), len(columns)
        if shape in _SHAPES and len(by_place) == _SHAPES[shape] and min(rows) == min(columns) < 2:
            indices = [by_place[place] for place in sorted(by_place)]
            return f"{header[indices[0]]} … {header[indices[-1]]}", indices, shape
    return None


def _matrices_of_texts(cells: Sequence[Any]) -> list[Any] | None:
    """The matrices in a column of texts. A cell without a matrix is unchanged. The result is None if most cells have no
    matrix."""
    texts = [cell for cell in cells if isinstance(cell, str) and cell.strip()]
    if not texts or len(texts[0]) > 2000:
        return None
    if _FRAME.fullmatch(texts[0]):
        frames = [_matrix_of_frame(cell) for cell in cells]
        if sum(matrix is not None for matrix in frames) * 2 <= len(cells):
            return None
        return [cell if matrix is None else matrix for cell, matrix in zip(cells, frames, strict=True)]
    if not _ONLY_NUMBERS.fullmatch(texts[0]):
        return None
    rows = [
        re.findall(_NUMBER, cell) if isinstance(cell, str) and _ONLY_NUMBERS.fullmatch(cell) else [] for cell in cells
    ]
    matrices = _matrices(rows, None)
    if matrices is None:
        return None
    return [matrix if numbers else cell for cell, matrix, numbers in zip(cells, matrices, rows, strict=True)]


def _matrix_of_frame(cell: Any) -> list[list[float]] | None:
    """The matrix (3, 4) of a frame of KUKA's robot language; None if the cell has none."""
    if not isinstance(cell, str) or not _FRAME.fullmatch(cell):
        return None
    values = {name.upper(): float(number) for name, number in re.findall(rf"(\w+)\s+({_NUMBER})", cell)}
    if not values.keys() >= {*_AXES}:
        return None
    angles = np.array([[values.get(name, 0.0) for name in _ANGLES]])
    rotation = rotations_of_angles(angles)[0][0]
    return [[*row, values[axis]] for row, axis in zip(rotation.tolist(), _AXES, strict=True)]


def _matrices(rows: Sequence[Sequence[Any]], shape: tuple[int, int] | None) -> list[Any] | None:
    """Nested lists from the entries of matrices. A row in which an entry is no number keeps its entries as they are.
    The result is None if the numbers of most rows are not the entries of a rotation matrix.

    Args:
        shape: shape of the matrices; None: the entries are listed by rows or by columns, whichever gives rotations.
    """
    count = max(map(len, rows))
    numbers = [[cell_number(cell) for cell in row] for row in rows]
    complete = [row for row in range(len(rows)) if len(rows[row]) == count and all(numbers[row])]
    if not complete or count not in _SHAPES.values() or len(complete) * 2 < len(rows):
        return None
    values = np.array([[number.value for number in numbers[row] if number is not None] for row in complete])
    n_columns = {size: columns for (_, columns), size in _SHAPES.items()}[count]
    by_rows = values.reshape(len(values), -1, n_columns)
    ways = [by_rows] if shape is not None else [by_rows, np.swapaxes(values.reshape(len(values), n_columns, -1), 1, 2)]
    matrices = next((way for way in ways if np.mean(_are_rotations(way[:, :3, :3])) > 0.5), None)
    if matrices is None:
        return None
    nested: list[Any] = [list(row) for row in rows]
    for row, matrix in zip(complete, matrices.tolist(), strict=True):
        nested[row] = matrix
    return nested


def _are_rotations(matrices: FloatArray) -> NDArray[np.bool_]:
    """(n,) whether the columns of matrices (n, 3, 3) are unit vectors at right angles."""
    with np.errstate(invalid="ignore", over="ignore"):
        deviation = np.swapaxes(matrices, 1, 2) @ matrices - np.eye(3)
        return np.asarray(np.abs(deviation).max(axis=(1, 2)) <= _RIGHT)


def _replaced(table: RawTable, name: str, indices: Sequence[int], cells: Sequence[Any]) -> RawTable:
    """A table in which one new column replaces several columns. The new column stands at the place of the first of
    these columns."""
    first, others = indices[0], {*indices[1:]}
    kept = [index for index in range(len(table.header)) if index not in others]
    header = tuple(name if index == first else table.header[index] for index in kept)
    rows = [
        tuple(cell if index == first else row[index] for index in kept)
        for row, cell in zip(table.rows, cells, strict=True)
    ]
    return replace(table, header=header, rows=rows)
