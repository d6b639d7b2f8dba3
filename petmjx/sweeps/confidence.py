"""How sure a score is: the share of worlds that stand with the errors of a stated robot and its cartons.

It is a sweep of single errors with replicates and the nominal world, with a summary of its own. Users read about it in
docs/confidence.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import pandas as pd
import pyarrow as pa

from petmjx.basics.errors import InputError
from petmjx.metrics.spec import DIMENSIONLESS
from petmjx.results.listed import Parts
from petmjx.results.schema import summary_table
from petmjx.results.shares import ONE_PLAN, share_standing
from petmjx.results.writer import RunWriter
from petmjx.sweeps.file import Sweep, load_sweep
from petmjx.sweeps.ready import find_sweep
from petmjx.verdict import Verdict
from petmjx.world.variants import Distribution

READY_MADE: Final = "confidence"
"""The sweep file with the errors of a common robot and of corrugated cartons."""

EVEN: Final = 0.5

_NUMBERS: Final = ("margin", "n_worlds", "n_standing", "n_invalid", "share", "low", "high")

_DESCRIPTIONS: Final = {
    "plan_id": "id of the packing plan",
    "verdict": "of the nominal world, without errors",
    "reason": "why the nominal world is not stable; empty where it is",
    "margin": "of the nominal world; null where it is invalid",
    "n_worlds": "worlds with errors",
    "n_standing": "worlds with errors that are stable",
    "n_invalid": "worlds with errors that have no verdict; not in the share",
    "share": "stable worlds / worlds with a verdict; null where there is none",
    "low": "lower end of the share's Wilson 95 % interval",
    "high": "upper end of it",
    "coin_toss": "whether the interval contains one half: it is open whether the pallet stands more often than "
    "it falls",
}


def confidence_sweep(n_worlds: int, errors: Path | None, simulation: Mapping[str, Any]) -> Sweep:
    """The sweep that asks how sure the scores of plans are.

    Args:
        n_worlds: worlds with errors for each plan, beside the nominal one.
        errors: a sweep file of errors, or the name of a ready-made one; None: ``READY_MADE``.
        simulation: fields of ``Simulation`` that replace those of the file.

    Raises:
        InputError: an unusable file, or one that has more than single errors.
    """
    found = load_sweep(find_sweep(errors or READY_MADE), plans_given=True, simulation=simulation)
    wrong = _what_is_no_error(found)
    if wrong:
        raise InputError(f"{found.file}: {wrong}")
    return found.model_copy(update={"nominal": True, "replicates": n_worlds})


def _what_is_no_error(sweep: Sweep) -> str:
    """The line about something that a file of errors may not have; empty if there is nothing wrong."""
    if sweep.search is not None:
        return "[search] contradicts confidence, which asks for a share: use petmjx sweep"
    if sweep.profiles:
        return "axes.profile contradicts confidence, which is about pallets at rest: use petmjx sweep"
    if sweep.sample is not None:
        return 'mode = "sample" contradicts confidence, which draws every world from the same errors'
    for name, axis in sweep.axes.items():
        if not isinstance(axis.values[0], Distribution):
            return f"axes.{name} contradicts confidence: it is not an error, but the same in every world"
        if len(axis.values) > 1:
            return f"axes.{name} must be one error for confidence, got {len(axis.values)}"
    if not any(axis.random for axis in sweep.axes.values()):
        return "axes have nothing random: every world would be the same"
    return ""


def summarise_confidence(parts: Parts) -> pd.DataFrame:
    """One row a plan, in the order given: its nominal verdict, and the share that stands with errors.

    Columns: docs/confidence.md.

    Args:
        parts: of the run, all of them written and in order.
    """
    wanted = ["plan_id", "variant", "verdict", "reason", "margin"]
    worlds = pa.concat_tables(parts.table("worlds", wanted)).to_pandas()
    nominal = worlds[worlds["variant"] == 0]
    drawn = worlds[worlds["variant"] > 0]
    shares = share_standing(drawn.assign(draw=drawn["variant"]), ())
    found = nominal.merge(shares[shares["scope"] == ONE_PLAN], on="plan_id", how="left")
    found["coin_toss"] = (found["low"] <= EVEN) & (found["high"] >= EVEN)
    return found[[*_DESCRIPTIONS]]


def write_confidence(writer: RunWriter) -> None:
    """Write the table ``summary`` of a run with confidence, whose parts are all written and in order.

    Raises:
        PetmjxError: the file cannot be written.
    """
    units = dict.fromkeys(_NUMBERS, DIMENSIONLESS)
    writer.write_summary(summary_table(summarise_confidence(writer.parts), units, _DESCRIPTIONS))


def contradicted(summary: pd.DataFrame) -> pd.Series[bool]:
    """For each plan, whether most worlds with errors come out against its nominal verdict, beyond chance."""
    stands = summary["verdict"] == Verdict.STABLE.value
    falls = summary["verdict"] == Verdict.UNSTABLE.value
    return (stands & (summary["high"] < EVEN)) | (falls & (summary["low"] > EVEN))
