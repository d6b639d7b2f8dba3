"""Conversions of units, which happen only in this module. Inside petmjx all values are in SI units; plans are in
millimetres."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

MM_PER_M = 1000.0
MICROMETRES_PER_M = 1_000_000.0

STANDARD_GRAVITY = 9.81
"""Gravity in m/s², as in the reference implementation. Levels in g are multiples of this value."""

LENGTHS_MM: Final[Mapping[str, tuple[float, str]]] = {
    "mm": (1.0, "millimetres"),
    "cm": (10.0, "centimetres"),
    "m": (1000.0, "metres"),
    "in": (25.4, "inches"),
}
MASSES_KG: Final[Mapping[str, tuple[float, str]]] = {
    "kg": (1.0, "kilograms"),
    "g": (0.001, "grams"),
    "lb": (0.45359237, "pounds"),
    "t": (1000.0, "tonnes"),
}
"""Units that users can name → their size in millimetres or kilograms, and their name."""

PLAN_UNITS: Final = "mm,kg"
"""The default units of plans."""


def plan_units(text: str) -> tuple[str, str]:
    """The units of lengths and of masses in a text such as "cm", "g" or "cm,g". A missing unit is taken from
    ``PLAN_UNITS``.

    Raises:
        ValueError: the text has an unknown unit, or two units of the same kind.
    """
    names = [name.strip() for name in text.split(",")]
    lengths = [name for name in names if name in LENGTHS_MM]
    masses = [name for name in names if name in MASSES_KG]
    if len(lengths) > 1 or len(masses) > 1 or len(lengths) + len(masses) != len(names):
        unit_names = f"one of {', '.join(LENGTHS_MM)} and one of {', '.join(MASSES_KG)}"
        raise ValueError(f"must be {unit_names}, separated by a comma, such as cm or cm,g")
    usual_length, usual_mass = PLAN_UNITS.split(",")
    return (lengths or [usual_length])[0], (masses or [usual_mass])[0]


def mm_to_m(value_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Millimetres → metres."""
    return value_mm / MM_PER_M


def round_to_micrometre(value_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Round metres half-up to 1 µm, as the reference implementation does when it writes its models.

    The value in micrometres is first rounded to a thousandth. For instance, the float64 of 0.1234565 m is slightly
    below the half, but still rounds up, as its decimal notation suggests.
    """
    micrometres: NDArray[Any] = np.round(value_m * MICROMETRES_PER_M, 3)
    return np.floor(micrometres + 0.5) / MICROMETRES_PER_M


def seconds_to_steps(duration_s: float, timestep_s: float) -> int:
    """Number of whole steps in a duration, by the reference's rule: ``int(duration / timestep)``.

    Truncation is deliberate. 0.7 / 0.002 is 349.99… in float64, so 0.7 s are 349 steps. A run can be compared with the
    reference to the last digit only if both count steps by the same rule.
    """
    return int(duration_s / timestep_s)


def deg_to_rad(angle_deg: float) -> float:
    """Degrees → radians."""
    return math.radians(angle_deg)
