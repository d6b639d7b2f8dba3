"""Replaces the process that makes attempts beside a run: tasks run at once in this process, on scripted engines."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from petmjx.engines.protocol import Engine
from petmjx.engines.subprocess.attempt_process import AttemptAnswer, AttemptTask


@dataclass
class AtOnce:
    """Simulates each task at once, on the engine with the task's name. Errors become answers, as in a real process
    beside a run."""

    engine_named: Callable[[str], Engine]
    tasks: list[AttemptTask] = field(default_factory=list)
    answers: list[AttemptAnswer] = field(default_factory=list)

    def begin(self, task: AttemptTask) -> None:
        self.tasks.append(task)
        try:
            (outcome,) = self.engine_named(task.engine).run([task.job], task.sim)
        except Exception as error:
            self.answers.append(AttemptAnswer(task.number, None, str(error)))
        else:
            self.answers.append(AttemptAnswer(task.number, outcome))

    def ended(self, *, wait: bool) -> Iterator[AttemptAnswer]:
        while self.answers:
            yield self.answers.pop(0)

    def close(self) -> None:
        self.tasks.clear()
