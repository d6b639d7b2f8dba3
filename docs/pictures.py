"""Makes the pictures of the documents again, from bundled and generated plans: ``make pictures``."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from petmjx.cli.main import main
from petmjx.packers.sample_plans import generate_one
from petmjx.plans.bedbpp_writer import write_plans

FOLDER = Path(__file__).resolve().parent / "pictures"

COMMANDS = (
    "show s0-000016 --no-early-stop --png collapse.png --size 400x480",
    "show s0-000016 --no-early-stop --gif collapse.gif --size 400x400 --speed 1 --fps 12.5",
    "show s0-000013 --png forces.png --colour force --arrows --size 560x640 --view 25/12",
    "show s0-001784 --png shifts.png --colour shift --size 400x360",
    "show hand-overhang-55 --png planned.png --colour planned --size 400x360 --at 0.5,0.9,end --view 20/12",
    "show s0-005459 PLANS --png accepted-and-falls.png --size 330x400",
    "show s0-005630 PLANS --png later-load.png --size 330x400",
    "show s0-002720 PLANS --png refused-and-stands.png --size 440x440 --colour force",
    "show gap REALITY --png tips-into-gap.png --size 330x300 --carrier epal-1 --placing tines --at 0.3,0.5,0.6,end "
    "--view 65/10",
    "show pushed REALITY --png pushed-onto.png --size 560x360 --carrier euro-pallet --placing hand --at end --view 4/6",
    "show bottles REALITY --png pressed-in.png --size 360x360 --at end --view 4/6",
)
"""Each file of the folder is made by one of these functions. ``PLANS`` has the plans of ``GENERATED``, ``REALITY``
those of docs/reality.md."""

GENERATED = (2720, 5459, 5630)
"""Plans of ``petmjx samples``, seed 0, by their numbers."""


def files() -> list[str]:
    """The names of the files that the commands make."""
    return [word for command in COMMANDS for word in shlex.split(command) if word.endswith((".png", ".gif"))]


def make() -> int:
    """Run all commands; the exit code is that of the first one that fails."""
    with TemporaryDirectory() as folder:
        plans = Path(folder) / "plans.json"
        write_plans(plans, (generate_one(number, seed=0) for number in GENERATED))
        reality = str(Path(__file__).with_name("reality.json"))
        places = {"PLANS": str(plans), "REALITY": reality} | {file: str(FOLDER / file) for file in files()}
        for command in COMMANDS:
            words = [places.get(word, word) for word in shlex.split(command)]
            if code := main([*words, "--engine", "mujoco", "--overwrite"]):
                return code
    return 0


if __name__ == "__main__":
    sys.exit(make())
