"""The code of the process that makes further attempts at worlds beside a run (``AttemptProcess``)."""

from __future__ import annotations

from petmjx.engines.engine_registry import make_engine
from petmjx.engines.protocol import Engine
from petmjx.engines.subprocess.attempt_process import serve_attempts


def main() -> None:
    """Simulate the worlds of tasks, one after another, until the pipe of tasks ends."""
    serve_attempts(engine_with_one_thread)


def engine_with_one_thread(name: str) -> Engine:
    """The engine with this name, with one CPU thread."""
    return make_engine(name, threads=1)
