"""The only module that converts units. Inside petmjx, all values are in SI units, except lengths in plans and in some
options, which are in millimetres."""

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
"""Acceleration of gravity in m/s², as in the reference implementation (PET-Physics). Accelerations in g are multiples
of this value."""

LENGTHS_MM: Final[Mapping[str, tuple[float, str]]] = {
    "mm": (1.0, "millimetres"),
    "cm": (10.0, "centimetres"),
    "dm": (100.0, "decimetres"),
    "m": (1000.0, "metres"),
    "in": (25.4, "inches"),
    "ft": (304.8, "feet"),
}
MASSES_KG: Final[Mapping[str, tuple[float, str]]] = {
    "kg": (1.0, "kilograms"),
    "g": (0.001, "grams"),
    "lb": (0.45359237, "pounds"),
    "t": (1000.0, "tonnes"),
}
"""Abbreviation of a unit that users can write → size of the unit in millimetres or kilograms, and name of the unit."""

PLAN_UNITS: Final = "mm,kg"
"""The default units of plans."""


def plan_units(text: str) -> tuple[str, str]:
    """The unit of lengths and the unit of masses that a text such as "cm", "g" or "cm,g" names. If the text names only
    one of the two, the other is taken from ``PLAN_UNITS``. A unit such as "cm/mm" has two parts: the unit of sizes, and
    the unit of coordinates.

    Raises:
        ValueError: the text has an unknown unit, or two units of the same kind.
    """
    names = [name.strip() for name in text.split(",")]
    lengths = [name for name in names if name.count("/") < 2 and {*name.split("/")} <= LENGTHS_MM.keys()]
    masses = [name for name in names if name in MASSES_KG]
    if len(lengths) > 1 or len(masses) > 1 or len(lengths) + len(masses) != len(names):
        lengths_text, masses_text = ", ".join(LENGTHS_MM), ", ".join(MASSES_KG)
        raise ValueError(
            f"must be one of {lengths_text} (lengths), one of {masses_text} (masses), or one of each with a comma "
            "between them, such as cm,g; cm/mm means sizes in cm and coordinates in mm"
        )
    usual_length, usual_mass = PLAN_UNITS.split(",")
    return (lengths or [usual_length])[0], (masses or [usual_mass])[0]


def mm_to_m(value_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Millimetres → metres."""
    return value_mm / MM_PER_M


def round_to_micrometre(value_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Round lengths in metres to whole micrometres; halves are rounded up. The reference implementation (PET-Physics)
    rounds in the same way when it writes its models.

    The value in micrometres is first rounded to a thousandth. So 0.1234565 m is rounded up to 0.123457 m, although the
    float64 number nearest to 0.1234565 is slightly smaller than 0.1234565.
    """
    micrometres: NDArray[Any] = np.round(value_m * MICROMETRES_PER_M, 3)
    return np.floor(micrometres + 0.5) / MICROMETRES_PER_M


def seconds_to_steps(duration_s: float, timestep_s: float) -> int:
    """Number of whole time steps in a duration, computed as in the reference implementation (PET-Physics):
    ``int(duration / timestep)``.

    Truncation is deliberate. 0.7 / 0.002 is 349.99… in float64, so 0.7 s are 349 steps. Results can agree with the
    reference implementation to the last digit only if both programs count steps in the same way.
    """
    return int(duration_s / timestep_s)


def deg_to_rad(angle_deg: float) -> float:
    """Degrees → radians."""
    return math.radians(angle_deg)
