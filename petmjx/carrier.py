"""What boxes stand on: the carriers that petmjx has, and their extents."""

from __future__ import annotations

from enum import StrEnum


class Carrier(StrEnum):
    """What the boxes stand on."""

    FOOTPRINT = "footprint"
    EURO_PALLET = "euro-pallet"
    ROLLCONTAINER = "rollcontainer"
    EPAL_1 = "epal-1"
    GMA_48X40 = "gma-48x40"
    PET_EUR = "pet-eur"


CARRIER_EXTENT_M: dict[Carrier, tuple[float, float] | None] = {
    Carrier.FOOTPRINT: None,
    Carrier.EURO_PALLET: (1.2, 0.8),
    Carrier.ROLLCONTAINER: (0.8, 0.7),
    Carrier.EPAL_1: (1.2, 0.8),
    Carrier.GMA_48X40: (1.219, 1.016),
    Carrier.PET_EUR: (1.2, 0.8),
}
"""x–y extent of each carrier in metres. None: the plan's bounding box."""

TARGETS = (Carrier.EURO_PALLET, Carrier.ROLLCONTAINER)
"""Carriers that are BED-BPP's targets."""
