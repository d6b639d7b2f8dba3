"""Columns with the poses of boxes: matrices, or positions with quaternions, angles or rotation matrices."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from petmjx.common.units import FloatArray
from petmjx.plans.cell_numbers import number_fault_of
from petmjx.plans.column_extraction import XYZ, ColumnExtraction
from petmjx.plans.column_names import LENGTH_UNITS, words_of
from petmjx.plans.known_forms import GLTF, THREE_JS
from petmjx.plans.size_and_place_columns import Geometry, Sizes, places_in, sizes_in
from petmjx.plans.turn_columns import (
    angles_of,
    bad_member,
    is_matrix,
    is_rotation,
    matrix_of,
    rotations_of_angles,
    rotations_of_quaternions,
    tilt,
)

_Rotations = tuple[FloatArray, dict[str, str], int]
"""(n, 3, 3) rotation matrices of the boxes; role → name of the column with this role; index of the column that errors
name."""
_ROUNDED_SCALE: Final = 0.01
"""Largest difference of a scale factor from 1 that rounding of the matrix explains."""
_LEVEL: Final = 2e-3
"""A box counts as level and at right angles if the cosine of the angle between each of its axes and the nearest
coordinate axis differs from 1 by at most this value. The angle is then at most 3.6°. Cosines in files may have only
three digits."""


def pose_choices(extraction: ColumnExtraction) -> list[Geometry]:
    """The possible geometries (sizes and places of all boxes) from columns of matrices, or of positions and
    rotations."""
    header, n = extraction.table.header, len(extraction.table.rows)
    sizes = sizes_in(extraction)
    matrix = _column_with(extraction, is_matrix)
    if matrix is not None:
        rotations, places = np.full((n, 3, 3), np.nan), np.full((n, 3), np.nan)
        for row, cell in enumerate(extraction.cells(matrix)):
            array = matrix_of(cell)
            if array is None:
                extraction.bad(row, matrix, f"must be the matrix of a pose{bad_member(cell)}")
            else:
                rotations[row], places[row] = array[:3, :3], array[:3, 3]
        rotations, scale = _without_scale(rotations)
        if sizes is None and np.allclose(scale, 1.0, equal_nan=True):
            return []
        size, axes, unit, _, columns, anchor, _ = sizes or Sizes(np.ones((n, 3)), XYZ, "", False, {})
        # if the scales of the matrices equal the sizes, they only repeat the sizes
        if not np.allclose(size, scale, rtol=1e-3, equal_nan=True):
            size = size * scale
            _check_scales(extraction, scale, matrix)
        geometry = Geometry(size, places, axes, unit, unit, anchor, columns={**columns, "pose": header[matrix]})
        return [_turned(extraction, geometry, rotations, matrix)]
    options = (
        _quaternions(extraction) or _angles(extraction) or _turning_matrices(extraction) or _frames(extraction)
        if sizes
        else []
    )
    at = places_in(extraction) if options else None
    if sizes is None or at is None:
        return []
    tilted = [int((tilt(rotation) > _LEVEL).sum()) for rotation, *_ in options]
    geometries = []
    for number, (rotation, named, index) in enumerate(options):
        if tilted[number] == min(tilted):
            columns = {**sizes.columns, **at.columns, **named}
            anchor = at.anchor or sizes.anchor
            geometry = Geometry(sizes.size, at.place, sizes.axes, sizes.unit, at.unit, anchor, columns=columns)
            geometries.append(_turned(extraction, replace(geometry, prior=0.4 * number), rotation, index))
    return geometries


def _column_with(extraction: ColumnExtraction, is_of_kind: Callable[[Any], bool]) -> int | None:
    """The first column that has a cell of a kind in one of the first rows; None if there is no such column."""
    rows = extraction.table.rows[:3]
    columns = range(len(extraction.table.header))
    return next((index for index in columns if any(is_of_kind(row[index]) for row in rows)), None)


def _check_scales(extraction: ColumnExtraction, scale: FloatArray, index: int) -> None:
    """Report matrices that scale their boxes if most matrices of the column do not scale their boxes. Matrices of
    scenes of three.js and glTF are not reported, since there any matrix may scale its box."""
    scaled = np.flatnonzero((np.abs(scale - 1.0) >= _ROUNDED_SCALE).any(axis=1))
    if extraction.source.form in (THREE_JS, GLTF) or len(scaled) * 2 > len(scale):
        return
    for row in scaled.tolist():
        factor = scale[row, np.argmax(np.abs(scale[row] - 1.0))]
        extraction.bad(row, index, f"scales the box by {factor:.3g}, unlike the matrices of other rows")


def _without_scale(matrices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, 3, 3) rotations, and (n, 3) scale factors along the axes of the boxes, of matrices that turn and scale.
    If all factors are nearly 1, exactly 1 is returned, since matrices in files are rounded."""
    scale: FloatArray = np.linalg.norm(matrices, axis=1)
    if not (np.abs(scale - 1.0) >= _ROUNDED_SCALE).any():
        return matrices, np.ones_like(scale)
    scale = np.where(scale > 0, scale, 1.0)
    return matrices / scale[:, None, :], scale


def _quaternions(extraction: ColumnExtraction) -> list[_Rotations]:
    """Rotations by quaternions, if there are any. In a list without names, the quaternion's component "w" may be the
    first or the last number."""
    header = extraction.table.header
    named, turned = extraction.columns_of("quaternion"), extraction.columns_of("rotation")
    if "w" in named:
        named = {**extraction.columns_of("euler"), **named}
    elif "3" in turned:
        named = turned
    components = [named.get(axis, [None])[0] for axis in ("w", "x", "y", "z")]
    listed = [named.get(str(axis), [None])[0] for axis in range(4)]
    orders = (
        [components] if None not in components else [listed, [listed[3], *listed[:3]]] if None not in listed else []
    )
    rotations = []
    for number, order in enumerate(orders):
        indices = [index for index in order if index is not None]
        values = np.stack([extraction.numbers(index, LENGTH_UNITS)[0] for index in indices], axis=1)
        columns = _roles("quaternion", [header[index] for index in indices])
        columns |= {"order of quaternions": "x, y, z, w"} if number == 1 else {}
        for row in np.flatnonzero((values == 0).all(axis=1)).tolist():
            extraction.bad(row, indices[0], "must not be 0 in all four components of a quaternion")
        rotations.append((rotations_of_quaternions(values), columns, indices[0]))
    return rotations


def _angles(extraction: ColumnExtraction) -> list[_Rotations]:
    """Rotations by angles about at least two of the axes, if there are any: "rx", "ry" and "rz"; roll, pitch and
    yaw; lists of three."""
    named = {axis: columns[0] for axis, columns in extraction.columns_of("euler").items()}
    quaternions, turned = extraction.columns_of("quaternion"), extraction.columns_of("rotation")
    listed = turned if {*"012"} <= turned.keys() else quaternions if {*"012"} <= quaternions.keys() else {}
    if listed:
        named = {axis: listed[str(number)][0] for number, axis in enumerate(XYZ)}
    elif {*XYZ} <= quaternions.keys():  # without a column for w, "orientation.x" … are angles
        named = {axis: quaternions[axis][0] for axis in XYZ}
    elif named and "z" not in named:
        yaws = [index for index in turned.get("", ()) if "yaw" in words_of(extraction.table.header[index])]
        if yaws:
            named["z"] = yaws[0]
    if len(named) < 2:
        return []
    indices = list(named.values())
    angles = np.zeros((len(extraction.table.rows), 3))
    angles[:, [XYZ.index(axis) for axis in named]] = angles_of(
        [extraction.cells(index) for index in indices], extraction.table.decimal
    )
    for row, axis in np.argwhere(np.isnan(angles)).tolist():
        index = named[XYZ[axis]]
        extraction.bad(row, index, number_fault_of(extraction.table.rows[row][index], extraction.table.decimal))
    columns = _roles("angle", [extraction.table.header[index] for index in indices])
    return [
        (rotation, {**columns, **({"order of angles": "z, y, x"} if number else {})}, indices[0])
        for number, rotation in enumerate(rotations_of_angles(angles))
    ]


def _turning_matrices(extraction: ColumnExtraction) -> list[_Rotations]:
    """Rotations by matrices (3, 3), if there are any."""
    index = _column_with(extraction, is_rotation)
    if index is None:
        return []
    rotations = np.full((len(extraction.table.rows), 3, 3), np.nan)
    for row, cell in enumerate(extraction.cells(index)):
        try:
            rotations[row] = np.array(cell, float)
        except (TypeError, ValueError):
            extraction.bad(row, index, f"must be a 3×3 matrix of numbers{bad_member(cell)}")
    return [(rotations, {"rotation": extraction.table.header[index]}, index)]


def _frames(extraction: ColumnExtraction) -> list[_Rotations]:
    """Rotations by the x and the y axis of each box ("X Axis", "Y Axis"), if there are columns with these vectors."""
    indices = [extraction.axis_columns[axis] for axis in "xy" if axis in extraction.axis_columns]
    if len(indices) < 2:
        return []
    x, y = (extraction.triples(index)[0] for index in indices)
    with np.errstate(invalid="ignore", divide="ignore"):
        axes = [vector / np.linalg.norm(vector, axis=1, keepdims=True) for vector in (x, y, np.cross(x, y))]
    return [(np.stack(axes, axis=2), _roles("axis", [extraction.table.header[index] for index in indices]), indices[0])]


def _turned(extraction: ColumnExtraction, geometry: Geometry, rotation: FloatArray, index: int) -> Geometry:
    """The geometry with the rotations of its boxes (``Geometry.turn``). Boxes whose rotation is not a multiple of right
    angles are refused; their errors name the column ``index``."""
    for row in np.flatnonzero(tilt(rotation) > _LEVEL):
        cosine = np.abs(rotation[row]).max(axis=1)
        degrees = np.degrees(np.arccos(np.clip(cosine.min(), 0, 1)))
        is_rotation_of_box = cosine.max() <= 1 + _ROUNDED_SCALE
        fault = f"is turned by {degrees:.3g}° out of right angles: edges of boxes must be parallel to x, y and z"
        extraction.bad(int(row), index, fault if is_rotation_of_box else "is no rotation")
    return replace(geometry, placed=True, turn=np.rint(rotation))


def _roles(role: str, names: Sequence[str]) -> dict[str, str]:
    """Several columns may have one role together, such as a rotation. The result maps a numbered role (``rotation``,
    ``rotation (2)``, …) to the name of each of these columns. Columns that are members of one list count as one
    column."""
    names = list(dict.fromkeys(name.rpartition("[")[0] or name for name in names))
    return {role if number == 1 else f"{role} ({number})": name for number, name in enumerate(names, start=1)}
