"""Types are right, and type checkers know the options of `petmjx.score` and `petmjx.sweep`.

`make test` runs the type checker here, beside other tests, since it takes half a minute on a core the first time.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import get_type_hints

import pytest

from petmjx import api
from petmjx.options.confidence import Confidence
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.options.transport import Transport
from petmjx.runs.option_types import ScoreOptions, SweepOptions
from tools.option_types import TARGET, option_types

KNOWN = """\
import petmjx
from typing import Any

petmjx.score("plans.json", threads=2, engine="mujoco", out="results", record=["A", "B"])
petmjx.score(physics="reference", schedule="fixed", thresholds={"tilt_deg": 5}, carrier=petmjx.Carrier.EPAL_1)
petmjx.score(physics={"name": "pallet", "timestep_s": 0.001, "solref": [0.02, 1]}, quiet=petmjx.Quiet(steps=50))
petmjx.score(confidence=16, world_timeout_s=None)
petmjx.sweep("eumos", limit=2, rest_s=1)
read_from_a_file: dict[str, Any] = {"threads": 2}
petmjx.score(**read_from_a_file)
"""

REFUSED = (
    "petmjx.score(threds=2)",
    "petmjx.score(threads='two')",
    "petmjx.score(physics='palet')",
    "petmjx.score(physics={'timestep': 0.001})",
    "petmjx.score(thresholds={'tilt_degrees': 5})",
    "petmjx.score(schedule='brisk')",
    "petmjx.score(engine='warp')",
    "petmjx.score(engine=3)",
    "petmjx.score(carrier=3)",
    "petmjx.score(rest_s='1')",
    "petmjx.sweep('eumos', confidence=16)",
)


def test_the_types_are_those_of_the_records() -> None:
    assert TARGET.read_text(encoding="utf-8") == option_types(), "an option has changed: run `make options`"


def test_what_is_typed_is_what_is_taken() -> None:
    known = [set(record.model_fields) for record in (Simulation, RunOptions, Confidence, Transport)]
    assert set(get_type_hints(ScoreOptions)) == set.union(*known)
    assert set(get_type_hints(SweepOptions)) == set.union(*known[:2])
    assert api.score.__annotations__["options"] == "Unpack[ScoreOptions]"


@pytest.mark.slow
def test_a_type_checker_knows_options_and_objects_to_mistakes_alone(
    repository: Path, tmp_path: Path, cache_folder: Path
) -> None:
    """mypy checks all files, with the options in pyproject.toml, and a program of a user.

    What mypy knows of files that have not changed is kept for later test runs, also those of other checkouts: mypy
    compares the contents of files. Such a run takes 2 s instead of 45 s of CPU time. The cache consists of files, since
    one database cannot be written by two runs at the same time. Where ``make check`` has left a cache, it is used.
    """
    pytest.importorskip("mypy", reason="mypy is not installed (extra: dev)")
    (program := tmp_path / "program_of_a_user.py").write_text(KNOWN + "\n".join(REFUSED) + "\n", encoding="utf-8")
    with open(repository / "pyproject.toml", "rb") as options:
        folders = tomllib.load(options)["tool"]["mypy"]["files"]
    kept = ["--cache-dir", str(cache_folder / "mypy"), "--no-sqlite-cache"]
    cache = [] if (repository / ".mypy_cache").is_dir() else kept
    command = [sys.executable, "-m", "mypy", "--no-pretty", *cache, *folders, program]
    environment = {**os.environ, "MYPYPATH": str(repository), "PYTHONPATH": ""}
    done = subprocess.run(command, cwd=repository, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stdout + done.stderr
    errors = [line for line in done.stdout.splitlines() if ": error: " in line]
    of_user = [line for line in errors if program.name in line]
    assert [line for line in errors if line not in of_user] == []
    first = KNOWN.count("\n") + 1
    assert {int(line.split(":")[1]) for line in of_user} == set(range(first, first + len(REFUSED))), done.stdout
