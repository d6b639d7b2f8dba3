"""The strength of cartons (``CartonStrength``): measured, or computed from the carton's board by McKee's formula.

The formula is 5.87 · edge crush strength · √(thickness · perimeter) (McKee, Gander, Wachuta 1963, "Compression strength
formula for corrugated boxes", Paperboard Packaging 48(8)). McKee's formula gives the strength of a new box in a press;
the strength in use is this strength divided by a safety factor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

MCKEE: Final = 5.87
"""Factor of McKee's formula in its simple form, without a unit."""


@dataclass(frozen=True)
class CartonStrength:
    """The strength that one row of a table of articles gives: in newtons, or through properties of the cartons' board.

    Attributes:
        strength_n: strength, N. If ``strength_n`` is None, the strength is computed from the board by McKee's formula.
        ect_kn_m: edge crush strength of the board, kN/m.
        thickness_mm: thickness of the board, mm.
        safety_factor: divisor of the strength. If ``safety_factor`` is None, the strength is not divided.
    """

    strength_n: float | None = None
    ect_kn_m: float | None = None
    thickness_mm: float | None = None
    safety_factor: float | None = None

    def of_box(self, length_mm: float, width_mm: float) -> float:
        """The largest load that a box with a base of ``length_mm`` × ``width_mm`` can bear, N."""
        strength = self.strength_n
        if strength is None:
            perimeter_mm = 2 * (length_mm + width_mm)
            # kN/m is N/mm
            strength = MCKEE * (self.ect_kn_m or 0.0) * math.sqrt((self.thickness_mm or 0.0) * perimeter_mm)
        return strength / (self.safety_factor or 1.0)
