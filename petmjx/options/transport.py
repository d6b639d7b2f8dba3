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
        description="take each plan through a transport chain, from the robot to the dock, in worlds with random "
        "errors, and report how likely the pallet is to arrive: the name of a ready-made chain, such as "
        "chain-film-truck, or a sweep file with legs; the option confidence, else the chain's file, sets the number of "
        "worlds",
    )
