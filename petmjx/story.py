"""One world as people see it: what was simulated, frame by frame, and what came of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from petmjx.history import History
from petmjx.plans.plan import Plan
from petmjx.verdict import Outcome
from petmjx.world.job import Drive
from petmjx.world.scene import Scene


@dataclass(frozen=True, eq=False)
class Story:
    """One simulated world with its frames.

    Attributes:
        plan: the plan; ``scene``: its world in numbers, the variant's changes included.
        outcome: verdict, first box, metrics of each box.
        history: the frames; the last one has the poses of ``outcome.boxes``.
        engine: which engine simulated it.
        variant: index of the variant, and its values by column; 0 and empty where the plan has one world.
        drive: what shook it.
        options: the options of the simulation (``petmjx.Simulation``) by field, as in ``run.json``.
        note: one line that readers must see, e.g. that another engine than the run's was used; "" for none.
    """

    plan: Plan
    scene: Scene
    outcome: Outcome
    history: History
    engine: str
    variant: int = 0
    values: Mapping[str, Any] = field(default_factory=dict)
    drive: Drive | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    note: str = ""
