"""Trials on forks of a settled pallet: a changed plan shares the placements before its first change with its parent.

The parent's boxes are placed once. Where a changed plan departs from it, the settled pallet is forked, and only the
rest is simulated. The rules are those of a run. But a fork is simulated once: what a score simulates again with other
settings (docs/rules.md, section 9) is not. So a plan that stands on a fork has to be scored before that is said.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from petmjx.engines.protocol import Engine
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Check, Schedule, Simulation
from petmjx.repairs.drafts import Draft
from petmjx.world.scene import Scene, build_scene

MOST_SLOTS: Final = 24
"""Lengths of a parent's plan at which it is kept settled. Plans that depart from it between two of them begin at the
shorter one."""


def can_fork(sim: Simulation) -> bool:
    """Whether worlds with these options can be forked while they are built."""
    return sim.check is Check.ONE_BY_ONE and sim.schedule is Schedule.ADAPTIVE and not sim.has_soft


class Forks:
    """Trials of changed plans on forks of their parents.

    Args:
        engine: an engine with open worlds.
    """

    def __init__(self, engine: Engine, sim: Simulation) -> None:
        self._engine, self._sim = engine, sim

    def outcomes(self, parent: Draft, drafts: Sequence[Draft]) -> list[Outcome | None]:
        """The outcome of each draft; None: it cannot be forked from the parent, since its carrier or the friction
        between its materials is another one."""
        scenes = [build_scene(draft.as_plan(), self._sim) for draft in drafts]
        base = build_scene(parent.as_plan(), self._sim)
        lengths = [
            _shared_length(parent, draft) if _same_world(base, scene) else -1
            for draft, scene in zip(drafts, scenes, strict=True)
        ]
        numbers = [number for number, length in enumerate(lengths) if length >= 0]
        results: list[Outcome | None] = [None] * len(drafts)
        if not numbers:
            return results
        marks = _marks([lengths[number] for number in numbers])
        worlds = self._engine.open([base.first(0)] * (len(marks) + 1), self._sim, max(s.n_boxes for s in scenes))
        worlds.go_on()
        settled: dict[int, int] = {}
        boxes = 0
        for slot, mark in enumerate(marks, start=1):
            if mark > boxes:
                worlds.put([0], [base.first(mark)])
                worlds.go_on()
                boxes = mark
            if worlds.read([0])[0].ended:  # the parent falls here, and what departs later falls as it does
                break
            worlds.fork([0], [slot])
            settled[mark] = slot
        starts = [max(mark for mark in settled if mark <= lengths[number]) for number in numbers]
        outcomes = worlds.try_scenes([settled[start] for start in starts], [scenes[number] for number in numbers])
        for number, outcome in zip(numbers, outcomes, strict=True):
            results[number] = outcome
        return results


def _marks(lengths: Sequence[int]) -> list[int]:
    """The lengths at which the parent is kept, rising, 0 included."""
    different = sorted({0, *lengths})
    if len(different) <= MOST_SLOTS:
        return different
    return [different[k] for k in np.unique(np.linspace(0, len(different) - 1, MOST_SLOTS).round().astype(int))]


def _shared_length(parent: Draft, draft: Draft) -> int:
    """Number of placements at the beginning that both have. At least one placement of the draft is its own."""
    most = min(len(parent.order), len(draft.order)) - 1
    rows, others = np.array(parent.order[:most], int), np.array(draft.order[:most], int)
    differ = rows != others
    if not differ.all():
        same = ~differ
        moved = np.zeros(len(rows), bool)
        for of_parent, of_draft in ((parent.corner_mm, draft.corner_mm), (parent.size_mm, draft.size_mm)):
            moved[same] |= (of_parent[rows[same]] != of_draft[rows[same]]).any(axis=1)
        moved[same] |= np.array([(box in parent.moved) != (box in draft.moved) for box in rows[same].tolist()], bool)
        differ |= moved
    return int(np.argmax(differ)) if differ.any() else most


def _same_world(base: Scene, scene: Scene) -> bool:
    """Whether two scenes have the same carrier, and boxes without materials and sheets, which make other tables."""
    if any(one.pieces or one.pair_friction is not None or one.pair_landing is not None for one in (base, scene)):
        return False
    return all(np.array_equal(value, getattr(scene.carrier, name)) for name, value in vars(base.carrier).items())
