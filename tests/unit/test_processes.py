"""Processes that do a part of the work end together with the process that started them, and do not prevent it from
ending."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.command_line import only_line

from petmjx.common.machine import own_environment
from petmjx.common.parallel_map import UnorderedResults

_SCRIPT = """
from petmjx.common.parallel_map import ordered_results

if __name__ == "__main__":
    for value in ordered_results(abs, range(-9, 10**9), workers=2, alone=1, chunk=1):
        print(value, flush=True)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_none_is_left_when_their_parent_is_killed(number: int, tmp_path: Path) -> None:
    path = tmp_path / "script.py"
    path.write_text(_SCRIPT)
    with subprocess.Popen([sys.executable, path], stdout=subprocess.PIPE, env=own_environment()) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == b"9\n"
        parent.send_signal(number)
        parent.communicate(timeout=120)  # the process ends when no process has its standard output open any more
    assert parent.returncode == -number


def test_the_command_ends_when_plans_cannot_be_written() -> None:
    command = "import sys; sys.argv[0] = 'petmjx'; from petmjx.__main__ import command; command()"
    arguments = ["samples", "-n", "300", "--workers", "2", "-o", "/dev/full"]
    ended = subprocess.run(
        [sys.executable, "-c", command, *arguments], env=own_environment(), capture_output=True, text=True, timeout=120
    )
    assert ended.returncode == 2
    assert "/dev/full: cannot be written" in only_line(ended.stderr)


def test_results_are_taken_as_they_come() -> None:
    with UnorderedResults(told, range(30), workers=2) as coming:
        results = dict(coming.take(waits=True))
        assert results
        assert not coming.ended
        while some := coming.take(waits=True):
            results.update(some)
        assert coming.ended
    niceness = os.nice(0)
    assert results == {number: ("", niceness + 5, number**2) for number in range(30)}
    with UnorderedResults(told, range(2), workers=1) as coming:
        assert coming.alone
        assert coming.take(waits=False) == []
        assert not coming.ended
        batches = [coming.take(waits=True) for _ in range(3)]
        assert coming.ended
    assert [[(number, square) for number, (*_, square) in some] for some in batches] == [[(0, 0)], [(1, 1)], []]


def test_what_tasks_raise_is_raised() -> None:
    def tasks() -> Iterator[int]:
        yield 1
        raise ValueError("the second task")

    def take_all(workers: int) -> None:
        with UnorderedResults(abs, tasks(), workers) as coming:
            while coming.take(waits=True):
                pass

    for workers in (1, 2):
        with pytest.raises(ValueError, match="the second task"):
            take_all(workers)


def told(number: int) -> tuple[str | None, int, int]:
    """GPUs that the process may use, its niceness, and the square of a number."""
    return os.environ.get("CUDA_VISIBLE_DEVICES"), os.nice(0), number**2


def test_who_interrupts_a_search_does_not_wait_for_its_tasks() -> None:
    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt), UnorderedResults(time.sleep, [100.0] * 4, 2):
        raise KeyboardInterrupt
    assert time.monotonic() - begin < 50


@pytest.mark.parametrize("is_command", [False, True])
def test_only_the_command_leaves_lasting_objects_out_of_later_collections(is_command: bool) -> None:
    """In a user's process, garbage that exists when an engine starts must be collected later."""
    code = f"""
import gc
from petmjx.common.garbage_collection import no_collection
from petmjx.common.processes import claim_process
if {is_command}:
    claim_process()
with no_collection():
    pass
assert gc.get_freeze_count() == 0
with no_collection(lasting=True):
    assert not gc.isenabled()
print(gc.isenabled(), gc.get_freeze_count() > 1000)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", str(is_command)]
