"""The option of a transport chain (``Transport``). docs/chains.md explains it to users."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from petmjx.common.checked_records import CheckedRecord, CliFlag
from petmjx.options.run_options import File


class Transport(CheckedRecord):
    """The transport chain (stages such as trucks and forklifts) that a score simulates for each plan after all boxes
    are placed."""

    chain: Annotated[File | None, CliFlag("--chain", "NAME|FILE")] = Field(
        None,
        description="transport chain, from the robot to the dock, through which each plan is taken in worlds with "
        "random errors; the run reports how likely each pallet is to arrive. Give the name of a ready-made chain, "
        "such as chain-film-truck, or a sweep file with legs. The option confidence sets the number of worlds; by "
        "default, the chain's file sets it",
    )
