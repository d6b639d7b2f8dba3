"""The options of scores with confidence (``Confidence``): the number of worlds with random errors, and the errors.

Defaults, units, checks and descriptions are defined only here. docs/confidence.md explains the options to users.
"""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from petmjx.common.checked_records import CheckedRecord, CliFlag, complaint, within
from petmjx.options.run_options import File


class Confidence(CheckedRecord):
    """Whether a score also reports how certain its verdicts are. For this report, each plan is also simulated with
    random errors of placements and boxes."""

    confidence: Annotated[int | None, within(4, 100_000), CliFlag("--confidence", "N")] = Field(
        None,
        description="also simulate each plan in this many worlds with random errors of placement, friction, mass and "
        "size, and report the share of worlds in which the plan stands. At least 4 worlds are needed, since fewer "
        "cannot show that the share differs from one half",
    )
    errors: Annotated[File | None, CliFlag("--errors", "FILE", default="the ready-made sweep confidence")] = Field(
        None, description="sweep file with the random errors of the robot and of the cartons"
    )

    exact_too: Annotated[bool, CliFlag("--exact-too")] = Field(
        False,
        description="simulate each world with errors a second time, with boxes that appear at their places instead of "
        "being carried; report the plans whose share of standing worlds differs between the two simulations by more "
        "than chance",
    )

    @model_validator(mode="after")
    def _errors_of_something(self) -> Self:
        if self.errors is not None and self.confidence is None:
            raise complaint("needs the option confidence (the number of worlds)", "errors")
        if self.exact_too and self.confidence is None:
            raise complaint("needs the option confidence (the number of worlds)", "exact_too")
        return self
