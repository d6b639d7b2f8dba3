"""Options that several commands share: their names, units, defaults and help, written once."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from petmjx.config import Carrier, Check, Schedule


class EngineName(StrEnum):
    """Engines by name; ``auto`` takes the one expected to finish first."""

    AUTO = "auto"
    MUJOCO = "mujoco"
    MJX_JAX = "mjx-jax"
    MJX_WARP = "mjx-warp"


class PhysicsName(StrEnum):
    """Physics presets by name."""

    PALLET = "pallet"
    REFERENCE = "reference"


PlanPaths = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="[PLANS]...",
        help="BED-BPP packing plans: JSON files (also gzipped) or folders of them. Without any: the bundled samples.",
        show_default=False,
    ),
]
CheckOption = Annotated[
    Check,
    typer.Option("--check", metavar="NAME", help="one-by-one: place box after box. static: all stand from the start."),
]
ScheduleOption = Annotated[
    Schedule,
    typer.Option(
        "--schedule",
        metavar="NAME",
        help="adaptive: place the next box as soon as the pallet is quiet and nothing creeps. "
        "brisk: creeping boxes hold nothing up. fixed: one every --interval.",
    ),
]
EngineOption = Annotated[
    EngineName,
    typer.Option(
        "--engine",
        metavar="NAME",
        help="mujoco: C MuJoCo on CPU threads. mjx-jax, mjx-warp: MJX in batches. "
        "auto: mjx-warp where it runs and pays off, else mujoco.",
    ),
]
PhysicsOption = Annotated[
    PhysicsName,
    typer.Option(
        "--physics",
        metavar="NAME",
        help="pallet: elliptic friction cones, a wooden pallet. reference: as the PET-Physics implementation.",
    ),
]
IntervalOption = Annotated[
    float,
    typer.Option("--interval", metavar="S", help="Time between two placements, s; the longest unless fixed."),
]
DurationOption = Annotated[float, typer.Option("--duration", metavar="S", help="Length of the static check, s.")]
SampleIntervalOption = Annotated[
    float, typer.Option("--sample-interval", metavar="S", help="Time between two samples of the metrics, s.")
]
SizeReductionOption = Annotated[
    float,
    typer.Option("--size-reduction-mm", metavar="MM", help="Each box dimension is reduced by this, mm."),
]
CarrierOption = Annotated[
    Carrier,
    typer.Option(
        "--carrier",
        metavar="NAME",
        help="What the boxes stand on. footprint: the plan's own extent. euro-pallet: 1200×800 mm. "
        "rollcontainer: 800×700 mm (x × y).",
    ),
]
NoEarlyStopOption = Annotated[
    bool, typer.Option("--no-early-stop", help="Go on to the end of the schedule after a box has dropped.")
]
LimitOption = Annotated[
    int | None, typer.Option("--limit", metavar="N", min=1, help="Take only this many plans.", show_default="all")
]
StrictOption = Annotated[bool, typer.Option("--strict", help="Stop at the first unusable plan instead of skipping it.")]
ThreadsOption = Annotated[
    int | None,
    typer.Option(
        "--threads", metavar="N", min=1, help="CPU threads of the engine mujoco.", show_default="all there are"
    ),
]
LanesOption = Annotated[
    int | None,
    typer.Option(
        "--lanes", metavar="N", min=1, help="Worlds at once of the MJX engines.", show_default="from device memory"
    ),
]
OutOption = Annotated[
    Path | None,
    typer.Option("--out", "-o", metavar="DIR", help="Folder for the results.", show_default="petmjx-results/DATE-TIME"),
]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="Replace the results that the folder holds.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")]
