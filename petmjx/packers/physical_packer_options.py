"""Options of the packer ``physical``."""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from petmjx.common.checked_records import CheckedRecord, CliFlag, shown_value, within

PHYSICAL: Final = "physical"
"""The packer's name."""

MOST_CLEARANCE_MM: Final = 200.0
MOST_CLEARANCES: Final = 16
LEAST_WORLDS: Final = 4
MOST_WORLDS: Final = 100_000
"""Smallest and largest number of worlds with errors, the same as in ``petmjx.options.confidence.Confidence``."""


def _split(values: Any) -> Any:
    """The numbers in a text with commas, as the command line passes it. A value that is no text is returned
    unchanged."""
    if not isinstance(values, str):
        return values
    try:
        return tuple(float(text) for text in values.split(","))
    except ValueError:
        raise ValueError(f"must be numbers separated by commas, {shown_value(values)}") from None


def _clearances(values: tuple[float, ...]) -> tuple[float, ...]:
    if not 1 <= len(values) <= MOST_CLEARANCES or len(set(values)) < len(values):
        raise ValueError(f"must be 1 to {MOST_CLEARANCES} different numbers, {shown_value(values)}")
    if not all(0 <= value <= MOST_CLEARANCE_MM for value in values):
        raise ValueError(f"must be from 0 to {MOST_CLEARANCE_MM:g} mm, {shown_value(values)}")
    return values


def _worlds(value: int) -> int:
    if value != 0 and not LEAST_WORLDS <= value <= MOST_WORLDS:
        raise ValueError(f"must be 0, or from {LEAST_WORLDS} to {MOST_WORLDS:,}, {shown_value(value)}")
    return value


class PhysicalOptions(CheckedRecord):
    """Options of the packer ``physical``: how wide it searches for packings, and how it chooses among them."""

    width: Annotated[int, within(1, 256), CliFlag("--width", "N")] = Field(
        2, description="number of packings that the search keeps at each step"
    )
    branch: Annotated[int, within(1, 64), CliFlag("--branch", "N")] = Field(
        3, description="number of candidates that each step of the search tries for each kept packing"
    )
    clearances_mm: Annotated[
        tuple[float, ...], BeforeValidator(_split), AfterValidator(_clearances), CliFlag("--clearances", "MM,…")
    ] = Field(
        (3.0, 6.0, 10.0),
        description="free space between neighbours, mm; one search for each value",
    )
    worlds: Annotated[int, AfterValidator(_worlds), CliFlag("--worlds", "N")] = Field(
        16,
        description="number of worlds with errors of placement, size, mass and friction in which a packing is "
        "simulated, at least 4; 0: packings are simulated only with boxes placed exactly",
    )
    least_share: Annotated[float, within(0, 1), CliFlag("--least-share", "0…1")] = Field(
        0.9, description="least share of the worlds with errors in which a packing must stand"
    )
    maximise: Annotated[Literal["utilisation", "share"], CliFlag("--maximise", "utilisation|share")] = Field(
        "utilisation",
        description="what is maximised: utilisation: the utilisation, among packings that stand in enough of the "
        "worlds with errors (option least_share); share: the share of worlds with errors in which a packing stands",
    )
