"""Masses of the boxes of another tool's file (``masses_kg``): from weights, from densities, or from the usual density
of boxes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable_name, three_digits
from petmjx.common.units import FloatArray
from petmjx.plans.box_columns import BoxColumns
from petmjx.plans.cell_numbers import grams_with_points
from petmjx.plans.column_names import DENSITY_UNITS, LENGTH_UNITS, MASS_UNITS, limits_in
from petmjx.plans.convention_checks import HEAVIEST_KG_M3, LIGHTEST_KG_M3
from petmjx.plans.plan_fields import LARGEST_KG, SMALLEST_KG, positive_fault
from petmjx.plans.readings import Wishes

if TYPE_CHECKING:
    from petmjx.plans.item_columns import ItemColumns

USUAL_KG_M3: Final = 300.0
"""Density of boxes if a file has no weights: the density of cartons in BED-BPP's orders. Verdicts hardly depend on a
density that is the same for all boxes."""
SET_KG_M3: Final = 200.0
"""Assumed density of the boxes in RoboBPP's sets, which give no masses. The mean density of BED-BPP's boxes is
similar."""
_WATER_KG_M3: Final = 1000.0
_RELATIVE: Final = 1.5
"""If no density in a column without a unit exceeds this value, the densities are relative to the density of water."""
_LEAST_KG_M3: Final = 25.0
"""A column of densities without a unit may be in another unit than kg/m³ if its median is smaller than this value.
Cartons of crisps have a density of 30 kg/m³ (1.9 lb/ft³), usual cartons 300 kg/m³ (19 lb/ft³)."""


def assumed_density(columns: BoxColumns, wishes: Wishes) -> float | None:
    """Density of boxes that have no weight, kg/m³; None: all boxes have weights."""
    weight = columns.weight
    lacks_weights = weight is None or (wishes.density_kg_m3 is not None and bool(np.isnan(weight).any()))
    return (wishes.density_kg_m3 or USUAL_KG_M3) if lacks_weights else None


def masses_kg(
    columns: BoxColumns | ItemColumns,
    unit: str,
    size: FloatArray,
    wishes: Wishes,
    faults: dict[int, str],
    notes: list[str],
    *,
    length_unit: str,
    usual_kg_m3: float = USUAL_KG_M3,
    counts: NDArray[np.int64] | None = None,
) -> FloatArray:
    """(n,) for each row, the mass of one box, kg. Missing masses are computed from the density. Adds faults of masses
    to ``faults``, and notes to ``notes``.

    Args:
        unit: unit of the weights.
        size: (n, 3) sizes of the boxes, mm.
        length_unit: unit of the file's sizes.
        usual_kg_m3: density of boxes without weights if the caller gives none.
        counts: (n,) number of boxes of each row, if the weight in a row is that of all boxes of the row; None: the
            weight in a row is that of one box.

    Raises:
        InputError: densities have no unit, and may be in kg/m³ or in another unit.
    """
    volume: FloatArray = size.prod(axis=1) / 1e9
    density = wishes.density_kg_m3 or usual_kg_m3
    if columns.weight is None:
        notes.append(f"no weights: {density:g} kg/m³ (--density)")
        return np.asarray(volume * density)
    if columns.weight_is_density:
        return np.asarray(volume * columns.weight * _density_factor(columns, length_unit, notes))
    name = columns.columns["total weight" if "total weight" in columns.columns else "weight"]
    mass = columns.weight * MASS_UNITS[unit]
    mass = _with_thousands(columns, name, unit, mass, volume if counts is None else volume * counts, notes)
    if counts is not None:
        notes.append("the weight in a row is the weight of all boxes of the row")
        mass = mass / np.maximum(counts, 1)
    empty = np.isnan(mass) | ~(mass > 0)
    if wishes.density_kg_m3 is not None and empty.any():
        notes.append(f"{count_text(int(empty.sum()), 'missing weight')}: {density:g} kg/m³")
        for row in np.flatnonzero(empty).tolist():
            if columns.faults.get(row, ("", ""))[0] == name:
                faults.pop(row, None)
        return np.asarray(np.where(empty, volume * density, mass))
    limits = limits_in(SMALLEST_KG, LARGEST_KG, unit, MASS_UNITS)
    for row in np.flatnonzero((mass < SMALLEST_KG) | (mass > LARGEST_KG)).tolist():
        fault = positive_fault(name, float(columns.weight[row]), *limits)
        if fault is None and counts is not None:
            fault = (
                f"{name} is {columns.weight[row]:g} {unit} for all {counts[row]:,} boxes of the row, so a box would "
                f"weigh {mass[row]:.3g} kg; must be from {SMALLEST_KG:g} to {LARGEST_KG:g} kg"
            )
        if fault is not None:
            faults.setdefault(row, fault)
    return np.asarray(mass)


def _with_thousands(
    columns: BoxColumns | ItemColumns, name: str, unit: str, mass: FloatArray, volume: FloatArray, notes: list[str]
) -> FloatArray:
    """(n,) masses of the rows, kg. If the column is in grams, "9.500" may mean 9500 g, with a point between thousands.
    This meaning is chosen if the boxes would otherwise be lighter than any real box, and would not be too heavy with
    9500 g. Then a note tells the user.

    Args:
        name: name of the column.
        volume: (n,) volume of the boxes of a row, m³.
    """
    table = columns.source.boxes.table
    texts = grams_with_points(table.column(name), table.decimal, unit) if name in table.header else {}
    rows = [row for row in texts if mass[row] > 0 and volume[row] > 0]
    if not rows:
        return mass
    density = float(np.median(mass[rows] / volume[rows]))
    if density >= LIGHTEST_KG_M3 or density * 1000 > HEAVIEST_KG_M3:
        return mass
    text = texts[rows[0]]
    notes.append(
        f"{printable_name(name)}: {text} is read as {text.replace('.', '')}, with a point between thousands (boxes "
        f"would have {three_digits(density)} kg/m³ otherwise)"
    )
    mass = mass.copy()
    mass[rows] *= 1000
    return mass


def _density_factor(columns: BoxColumns | ItemColumns, length_unit: str, notes: list[str]) -> float:
    """The unit of a column of densities, in kg/m³. Adds a note that tells the unit.

    Raises:
        InputError: the unit is unknown.
    """
    assert columns.weight is not None
    densities = columns.weight[~np.isnan(columns.weight)]
    largest, median = (densities.max(), float(np.median(densities))) if len(densities) else (math.inf, math.inf)
    if columns.weight_unit:
        notes.append(f"weights are computed from densities in {columns.weight_unit.replace('3', '³')}")
        return DENSITY_UNITS[columns.weight_unit]
    if largest <= _RELATIVE:
        notes.append("weights are computed from densities relative to water")
        return _WATER_KG_M3
    imperial = LENGTH_UNITS[length_unit] in (LENGTH_UNITS["in"], LENGTH_UNITS["ft"])
    if imperial or median < _LEAST_KG_M3:
        name = printable_name(columns.columns["density"])
        raise InputError(
            f"{name} has densities in an unknown unit (median: {median:g}); write their unit into the name of the "
            f'column, such as "{name} [kg/m3]" or "{name} [lb/ft3]"'
        )
    notes.append("weights are computed from densities in kg/m³")
    return 1.0
