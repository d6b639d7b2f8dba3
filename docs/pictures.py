"""Makes the pictures of the documents again, from the bundled plans: ``make pictures``."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

from petmjx.cli.main import main

FOLDER = Path(__file__).resolve().parent / "pictures"

COMMANDS = (
    "show s0-000016 --no-early-stop --png collapse.png --size 400x480",
    "show s0-000016 --no-early-stop --gif collapse.gif --size 400x400 --speed 1 --fps 12.5",
    "show s0-000013 --png forces.png --colour force --arrows --size 560x640 --view 25/12",
    "show s0-001784 --png shifts.png --colour shift --size 400x360",
    "show hand-overhang-55 --png planned.png --colour planned --size 400x360 --at 0.5,0.9,end --view 20/12",
)
"""Each file of the folder is made by one of these."""


def files() -> list[str]:
    """The names of the files that the commands make."""
    return [word for command in COMMANDS for word in shlex.split(command) if word.endswith((".png", ".gif"))]


def make() -> int:
    """Run all commands; the exit code is that of the first one that fails."""
    for command in COMMANDS:
        words = [str(FOLDER / word) if word in files() else word for word in shlex.split(command)]
        if code := main([*words, "--engine", "mujoco"]):
            return code
    return 0


if __name__ == "__main__":
    sys.exit(make())
