"""A score's way through the code stays short: which files it enters, and that it does not come back to them."""

from __future__ import annotations

import gc
import subprocess
import sys
from collections import defaultdict
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest
from support.plans import make_plan, stack

import petmjx

MOST_FILES = 53
"""That a warm score enters in its own thread. What an engine's threads enter is the engine's."""

MOST_THAT_LEAD_ON = 29
"""Of these, files from which the way leads on into others. Where it ends (units, texts, options, arithmetic, columns) a
reader who follows it need not look twice."""

BESIDE = {"sweeps", "statics", "rating", "packers", "story", "show", "pages", "pictures", "cli"}
"""What hangs on the mission's way."""

MANY_DOORS = {
    "basics/checked.py",  # the base of all records of options
    "options/config.py",  # a record of options, which says what follows from them
    "engines/cpu/engine.py",  # the protocol of engines: one makes it, one asks for its device, one runs it
    "plans/plan_set.py",  # a record, which checks what it is made of
    "world/scene.py",  # a record, of which whoever has a world reads sizes and masses
}
"""Files that more than two others enter."""


@dataclass
class Way:
    """Files of petmjx that were entered in one thread, each with the files from which it was."""

    entered_from: dict[str, set[str]] = field(default_factory=lambda: defaultdict(set))

    @property
    def files(self) -> set[str]:
        return set(self.entered_from)

    @property
    def leading_on(self) -> set[str]:
        return {file for callers in self.entered_from.values() for file in callers}


def way_of(run: Any, package: Path) -> Way:
    """The way of a call through the package, without what its other threads do."""
    way, inside = Way(), str(package) + "/"

    def file_of(code: CodeType) -> str:
        return code.co_filename.removeprefix(inside) if code.co_filename.startswith(inside) else ""

    def note(frame: FrameType, event: str, argument: object) -> None:
        file = file_of(frame.f_code) if event == "call" else ""
        if not file:
            return
        caller = frame.f_back
        while caller is not None and not file_of(caller.f_code):
            caller = caller.f_back
        before = file_of(caller.f_code) if caller is not None else ""
        way.entered_from[file] |= {before} - {file, ""}

    gc.collect()
    gc.disable()  # what other tests left would be freed on this way
    sys.setprofile(note)
    try:
        run()
    finally:
        sys.setprofile(None)
        gc.enable()
    return way


@pytest.fixture(scope="module")
def way() -> Way:
    run = partial(petmjx.score, [make_plan("p", stack(3))], engine="mujoco", threads=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.delitem(sys.modules, "IPython", raising=False)  # which other tests import: a notebook has a longer way
        run()  # what is read and made once
        return way_of(run, Path(petmjx.__file__).parent)


def test_a_score_crosses_few_files(way: Way) -> None:
    assert len(way.files) <= MOST_FILES, "\n".join(sorted(way.files))
    assert len(way.leading_on) <= MOST_THAT_LEAD_ON, sorted(way.leading_on)
    assert "simulate.py" in way.leading_on


def test_a_score_enters_nothing_beside_its_way(way: Way) -> None:
    assert not BESIDE & {file.partition("/")[0] for file in way.files}


def test_a_score_imports_nothing_beside_its_way() -> None:
    code = "import sys, petmjx.api\nprint(*{name.split('.')[1] for name in sys.modules if name.startswith('petmjx.')})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not BESIDE & set(done.stdout.split())


def test_a_score_does_not_go_to_and_fro(way: Way) -> None:
    doors = {file: way.entered_from[file] for file in way.leading_on}
    assert {file for file, callers in doors.items() if len(callers) > 2} <= MANY_DOORS, doors
    back = {(a, b) for a in way.files for b in way.entered_from[a] if a in way.entered_from[b]}
    # worlds are made as they are asked for, so that memory does not grow with the number of plans
    assert back == {("study.py", "engines/retry.py"), ("engines/retry.py", "study.py")}


def test_threads_of_engines_are_not_counted(way: Way) -> None:
    assert "engines/cpu/engine.py" in way.files
    assert "engines/cpu/world.py" not in way.files
