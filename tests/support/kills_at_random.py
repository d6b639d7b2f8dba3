"""Kills runs at random moments (SIGKILL) and resumes them until they finish. No world may be lost or occur twice.

    python tests/support/kills_at_random.py FOLDER score 100 grid 20

Runs are child processes, forked from a process that has imported all modules and started no thread. The worlds of these
runs end without physics. So a run takes a tenth of a second, and kills hit it at all moments: while worlds end, while
it reads its folder, writes a part or renames a file, or when it has just begun.
"""

from __future__ import annotations

import gc
import os
import random
import signal
import sys
import time
from pathlib import Path

import mujoco
import pyarrow.dataset

import petmjx
import petmjx.runs.confidence
import petmjx.runs.sweep_study
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.mujoco.world_run import WorldRun
from petmjx.results.run_writer import RunWriter
from petmjx.runs.forked_worlds import Batching

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.equal_runs import GRID, PLANS, SEARCH, assert_same, tables
from support.fake_engine import end_without_physics

WORLDS_PER_PART = 3


def run(kind: str, folder: Path, *, resume: bool) -> petmjx.RunResults:
    """Make or resume a short run with small parts."""
    engine = MujocoEngine(threads=2)
    if kind == "score":
        return petmjx.score(PLANS[:24], out=folder, resume=resume, engine=engine)
    file = folder.parent / f"{kind}.toml"
    batching = Batching(placements=2)
    return petmjx.sweep(file, PLANS[3:6], out=folder, resume=resume, engine=engine, batching=batching)


def start(kind: str, folder: Path) -> int:
    """Start a child process whose run resumes the folder. Returns the id of the child process."""
    child = os.fork()
    if child:
        return child
    try:
        run(kind, folder, resume=True)
    except BaseException as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
        os._exit(1)
    os._exit(0)


def leftovers(folder: Path) -> bool:
    """Whether a kill hit a part while it was being written."""
    worlds = {file.name for file in folder.glob("worlds/part-*")}
    boxes = {file.name for file in folder.glob("boxes/part-*")}
    return bool(boxes - worlds) or bool(list(folder.rglob("*.tmp")))


def kill(folder: Path, kind: str, kills: int, rng: random.Random) -> None:
    """Kill ``kills`` runs of one kind, and compare the resumed runs with an undisturbed run."""
    begin = time.monotonic()
    child = start(kind, folder / f"{kind}-whole")  # in a child: this process starts no threads
    assert os.waitpid(child, 0)[1] == 0
    whole_s = time.monotonic() - begin
    expected = tables(petmjx.load_run(folder / f"{kind}-whole"))
    done = runs = in_part = 0
    while done < kills or runs == 0:
        out = folder / f"{kind}-{runs}"
        while True:
            child = start(kind, out)
            if done < kills:
                time.sleep(rng.uniform(0, whole_s))
                os.kill(child, signal.SIGKILL)
            _, status = os.waitpid(child, 0)
            if not os.WIFSIGNALED(status):
                assert status == 0, f"{out} could not be resumed"
                break
            done += 1
            in_part += leftovers(out)
        assert_same(petmjx.load_run(out), expected)
        runs += 1
    print(
        f"{kind}: {done} kills ({in_part} within a part) in {runs} runs of {len(expected['worlds'])} worlds: all equal"
    )


def main(folder: Path, kills_by_kind: dict[str, int], seed: int = 0) -> None:
    gc.freeze()  # children search no garbage among the imported objects
    mujoco.mj_version(), pyarrow.dataset.dataset, petmjx.score  # so that children need not load them
    defaults = RunWriter.__init__.__kwdefaults__
    assert defaults is not None
    defaults["worlds_per_part"] = WORLDS_PER_PART
    WorldRun.run = end_without_physics  # type: ignore[method-assign]
    os.fsync = lambda descriptor: None  # a kill loses nothing that the kernel has received
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "grid.toml").write_text(GRID)
    (folder / "search.toml").write_text(SEARCH)
    rng = random.Random(seed)
    for kind, kills in kills_by_kind.items():
        kill(folder, kind, kills, rng)


if __name__ == "__main__":
    kinds, counts = sys.argv[2::2], map(int, sys.argv[3::2])
    main(Path(sys.argv[1]), dict(zip(kinds, counts, strict=True)))
