"""Which worlds of a run are recorded, and which of the recorded histories are kept (``Recording``): all histories, the
histories of some plans, or the histories of worlds that fail."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, first_names
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.options.run_options import ALL, FAILED, RunOptions
from petmjx.plans.plan import Plan
from petmjx.results.table_parts import Parts
from petmjx.world.history import Record

_KEY = ("plan_id", "variant")


@dataclass(frozen=True)
class Recording:
    """Which worlds (simulations of one plan each) a run records, and which of the recorded histories it keeps.

    Whether a world fails is known only when it ends. So with ``failed_only``, the engine records all worlds, and the
    history of a stable world is deleted when the world ends. This way, no world must be simulated again to be recorded,
    and the histories of stable worlds do not fill the memory.

    Attributes:
        record: how the engine records: time between two frames, and level of detail. If ``record`` is None, nothing is
            recorded.
        plan_ids: ids of the plans whose worlds are recorded. If ``plan_ids`` is None, the worlds of all plans are
            recorded.
        failed_only: whether to keep only the histories of worlds that are not stable.
    """

    record: Record | None = None
    plan_ids: frozenset[str] | None = None
    failed_only: bool = False

    def of(self, plan: Plan) -> Record | None:
        """The settings with which the engine records the worlds of a plan; None if these worlds are not recorded."""
        return self.record if self.plan_ids is None or plan.plan_id in self.plan_ids else None

    def kept(self, outcome: Outcome) -> Outcome:
        """The outcome, without its history if the run does not keep this history."""
        if outcome.history is None or not self.failed_only or outcome.verdict is not Verdict.STABLE:
            return outcome
        return replace(outcome, history=None)

    def missing(self, parts: Parts) -> int:
        """Number of completed worlds that should have a history but have none."""
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
    """Make the ``Recording`` of a run from the run's options.

    Args:
        engine: name of the engine of the run.

    Raises:
        InputError: a plan to record is not among ``plans``, or the engine cannot record the requested details.
    """
    choice = options.record
    if choice is None:
        return NO_RECORDING
    if options.record_details and engine != "mujoco":
        raise InputError(f"record_details needs the engine mujoco, but the run's engine is {engine}")
    record = Record(options.record_interval_s, options.record_details)
    if choice in (ALL, FAILED):
        return Recording(record, failed_only=choice == FAILED)
    plan_ids = {plan.plan_id for plan in plans}
    names: Iterable[str] = choice
    if isinstance(choice, str):
        names = [choice] if choice in plan_ids else filter(None, map(str.strip, choice.split(",")))
    ids = frozenset(names)
    unknown = sorted(ids - plan_ids)
    if unknown:
        raise InputError(
            f"record: {first_names(unknown)}: not among the {count_text(len(plan_ids), 'plan')} of the run"
        )
    return Recording(record, ids)
