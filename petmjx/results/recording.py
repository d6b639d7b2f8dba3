"""Which worlds of a run are recorded, and whose histories are kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from petmjx.basics.errors import InputError
from petmjx.basics.text import counted, first_names
from petmjx.history import Record
from petmjx.options.run_options import ALL, FAILED, RunOptions
from petmjx.plans.plan import Plan
from petmjx.results.listed import Parts
from petmjx.verdict import Outcome, Verdict

_KEY = ("plan_id", "variant")


@dataclass(frozen=True)
class Recording:
    """What a run records.

    Whether a world fails is known in the end, so with ``failed_only`` all are recorded, and the histories of those that
    stand are let go at once: nothing is simulated twice, and memory holds the worlds that are under way.

    Attributes:
        record: what engines are asked for; None: nothing is recorded.
        plan_ids: plans whose worlds are recorded; None: all.
        failed_only: keep the histories of worlds that are not stable.
    """

    record: Record | None = None
    plan_ids: frozenset[str] | None = None
    failed_only: bool = False

    def of(self, plan: Plan) -> Record | None:
        """What is recorded of a plan's worlds."""
        return self.record if self.plan_ids is None or plan.plan_id in self.plan_ids else None

    def kept(self, outcome: Outcome) -> Outcome:
        """The outcome, without its history where that is not to be kept."""
        if outcome.history is None or not self.failed_only or outcome.verdict is not Verdict.STABLE:
            return outcome
        return replace(outcome, history=None)

    def missing(self, parts: Parts) -> int:
        """How many worlds that a run has already should have a history, but have none."""
        if self.record is None:
            return 0
        frames = parts.table("frames", _KEY)
        recorded_keys = {key for part in frames for key in zip(*part.to_pydict().values(), strict=True)}
        worlds = [part.to_pydict() for part in parts.table("worlds", (*_KEY, "verdict"))]
        rows = (row for part in worlds for row in zip(*part.values(), strict=True))
        return sum(
            (self.plan_ids is None or plan_id in self.plan_ids)
            and not (self.failed_only and verdict == Verdict.STABLE.value)
            and (plan_id, variant) not in recorded_keys
            for plan_id, variant, verdict in rows
        )


NO_RECORDING = Recording()


def recording_of(options: RunOptions, engine: str, plans: Sequence[Plan]) -> Recording:
    """What a run of these plans records.

    Args:
        engine: its name.

    Raises:
        InputError: a plan that is to be recorded is not there, or the engine cannot record what is asked for.
    """
    choice = options.record
    if choice is None:
        return NO_RECORDING
    if options.record_details and engine != "mujoco":
        raise InputError(f"record_details needs the engine mujoco, and the run's is {engine}")
    record = Record(options.record_interval_s, options.record_details)
    if choice in (ALL, FAILED):
        return Recording(record, failed_only=choice == FAILED)
    known = {plan.plan_id for plan in plans}
    ids = frozenset(choice if not isinstance(choice, str) else [choice] if choice in known else _split(choice))
    unknown = sorted(ids - known)
    if unknown:
        raise InputError(f"record: {first_names(unknown)}: not among the {counted(len(known), 'plan')} of the run")
    return Recording(record, ids)


def _split(text: str) -> list[str]:
    return [name for name in (part.strip() for part in text.split(",")) if name]
