"""Processes that do a share of the work end with the one that started them, and do not keep it from ending."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.command_line import only_line

from petmjx.basics.machine import own_environment

_SCRIPT = """
from petmjx.plans.samples.parallel import in_order

if __name__ == "__main__":
    for value in in_order(abs, range(-9, 10**9), workers=2, alone=1, chunk=1):
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
        parent.communicate(timeout=30)  # it ends when nobody has standard output any more
    assert parent.returncode == -number


def test_the_command_ends_when_plans_cannot_be_written() -> None:
    command = "import sys; sys.argv[0] = 'petmjx'; from petmjx.__main__ import command; command()"
    asked = ["samples", "-n", "300", "--workers", "2", "-o", "/dev/full"]
    ended = subprocess.run(
        [sys.executable, "-c", command, *asked], env=own_environment(), capture_output=True, text=True, timeout=30
    )
    assert ended.returncode == 2
    assert "/dev/full: cannot be written" in only_line(ended.stderr)
