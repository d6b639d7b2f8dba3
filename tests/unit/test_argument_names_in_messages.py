"""Errors in Python name arguments, and errors of the command line name options. The other tests are for messages and
values that were misleading."""

from __future__ import annotations

import re
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.command_line import only_line, run
from support.outcomes import make_plan
from support.plans import stack

import petmjx
from petmjx.common.checked_records import option, typed_options
from petmjx.common.errors import InputError
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.runs.notebook_progress import ScriptLines

CALLS = {
    "score": (lambda at: petmjx.score(make_plan(), engine="mujoco", out=at / "run"), "out, or pass overwrite=True"),
    "merge": (lambda at: petmjx.merge_runs([at / "run"], at / "run"), "name another folder with out"),
    "no shard": (lambda at: petmjx.merge_runs([at / "run"], at / "m"), "made without shard"),
    "figure": (lambda at: petmjx.figure(petmjx.load_run(at / "run"), at / "f.svg"), "scores with confidence"),
    "board": (lambda at: petmjx.leaderboard([at / "run"], at / "b", baselines=True), "baselines needs orders"),
    "report": (lambda at: petmjx.report(at / "run", at / "r.html"), "name another file, or pass overwrite=True"),
}


@pytest.mark.parametrize("name", CALLS)
def test_python_has_arguments(name: str, tmp_path: Path) -> None:
    petmjx.score(make_plan(), engine="mujoco", out=tmp_path / "run")
    (tmp_path / "r.html").write_text("mine")
    call, message = CALLS[name]
    with pytest.raises(InputError) as error:
        call(tmp_path)
    assert message in str(error.value)
    assert not re.search(r"--[a-z]", str(error.value))


def test_the_command_line_has_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    petmjx.save_plans(make_plan(), tmp_path / "p.json")
    arguments = ("score", tmp_path / "p.json", "--engine", "mujoco", "--out", tmp_path / "run")
    assert run(*arguments) == 0
    capsys.readouterr()
    assert run(*arguments) == 2
    assert only_line(capsys.readouterr().err).endswith("name another folder with --out, or pass --overwrite")
    assert option("--out") == "out"
    with typed_options():
        assert option("--yes", "True", python="allow_large") == "--yes"
    assert option("--yes", "True", python="allow_large") == "allow_large=True"


def test_a_script_hears_of_its_run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    plans = [make_plan(f"p{number}") for number in range(3)]
    petmjx.score(plans, engine="mujoco", progress=True)
    first, last = capsys.readouterr().err.splitlines()
    assert first.startswith("3 plans, about ")
    assert first.endswith("; engine mujoco (as asked for)")
    assert last.startswith("3 of 3 plans, ")
    petmjx.score(plans, engine="mujoco")
    assert capsys.readouterr().err == ""
    with pytest.raises(InputError, match="progress must be true or false, got 3"):
        petmjx.score(plans, engine="mujoco", progress=3)  # type: ignore[arg-type]


def test_lines_come_while_no_world_ends() -> None:
    messages: list[str] = []
    lines = ScriptLines(messages.append, line_s=0.01)

    class Slow:
        name = "slow"

        def run(self, jobs: Any, sim: Any, progress: Any = None) -> Any:
            while len(messages) < 4:  # the progress thread reports how far the run is
                time.sleep(0.01)
            yield from MujocoEngine(1).run(jobs, sim, progress)

    petmjx.score(make_plan(), engine=Slow(), watcher=lines)
    assert messages[1].startswith("0 of 1 plan")
    assert messages[-1].startswith("1 of 1 plan")


def test_a_plan_can_be_told() -> None:
    plan = make_plan("falls", stack(2, 250.0))
    story = petmjx.tell(plan, engine="mujoco")
    assert story.name == "falls"
    assert story.outcome.verdict.value == "unstable"


def test_an_episode_that_has_ended_is_over() -> None:
    env = pytest.importorskip("petmjx.gym.single_env").PalletizingEnv(most_illegal=1)
    with pytest.raises(InputError, match="call reset"):
        env.step(0)
    _, _ = env.reset(seed=1)
    illegal = int(np.flatnonzero(env.action_masks() == 0)[0])
    *_, truncated, _ = env.step(illegal)
    assert truncated
    with pytest.raises(InputError, match="the episode has ended, or none has begun: call reset"):
        env.step(illegal)
    env.reset(seed=1)
    env.step(illegal)
    env.close()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"check": "static", "duration_s": 60.0}, "duration_s of 60 s is an upper limit: with schedule='adaptive'"),
        ({"duration_s": 60.0}, "duration_s has no effect: only check='static' uses it"),
        ({"check": "static", "duration_s": 0.4, "schedule": "fixed"}, None),
    ],
)
def test_what_a_duration_means_is_said(options: dict[str, Any], said: str | None) -> None:
    warnings = petmjx.score(make_plan(), engine="mujoco", **options).info["warnings"]
    lines = [line for line in warnings if "duration_s" in line]
    assert [line.startswith(said) for line in lines] == [True] if said else lines == []


def test_no_film_is_a_number_of_turns(tmp_path: Path) -> None:
    """0 turns are a reference in a sweep over numbers of turns. The results are the same as without film, to the last
    bit."""
    sweep = '[axes]\nprofile = "eumos-40509"\ndirection = ["+x"]\nlevel = [0.6]\n'
    (tmp_path / "turns.toml").write_text(sweep + "wrap_turns = [0, 4]\n")
    (tmp_path / "none.toml").write_text(sweep)
    plan = make_plan("p", stack(2))
    film = petmjx.sweep(tmp_path / "turns.toml", plan, engine="mujoco").worlds.set_index("wrap_turns")
    none = petmjx.sweep(tmp_path / "none.toml", plan, engine="mujoco").worlds
    numbers = [name for name in none.select_dtypes("float") if name in film]
    without, wrapped = film.loc[0.0, numbers].to_numpy(float), film.loc[4.0, numbers].to_numpy(float)
    np.testing.assert_array_equal(without, none[numbers].to_numpy(float)[0])
    assert not np.array_equal(without, wrapped, equal_nan=True)
