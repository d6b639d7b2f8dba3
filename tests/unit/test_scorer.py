"""``petmjx.Scorer``, a warm engine for small calls: it gives the results of a score, also to several threads, and
writes nothing to disk."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from support.plans import make_plan, stack

import petmjx
from petmjx.common.errors import InputError

REPOSITORY = Path(__file__).parents[2]
PLANS = [
    make_plan("falls", stack(2, 300)),
    make_plan("stands", stack(3)),
    make_plan("one", 1),
    make_plan("falls", stack(2, 260)),
]


def test_it_says_what_a_score_says_and_writes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = petmjx.score(PLANS, engine="mujoco", carrier="epal-1")

    def none(*_: Any, **__: Any) -> None:
        raise AssertionError("a file is opened")

    scorer = petmjx.Scorer(engine="mujoco", threads=2, carrier="epal-1")
    scorer.score(PLANS[2])  # the first call also loads data that later calls reuse
    for name in ("open", "mkdir", "rename"):
        monkeypatch.setattr(os, name, none)
    results = scorer.score(PLANS)
    for table in ("worlds", "boxes", "attempts"):
        pd.testing.assert_frame_equal(getattr(results, table), getattr(expected, table), check_exact=True)
    assert results.worlds.verdict.tolist() == ["unstable", "stable", "stable", "unstable"]
    assert results.worlds.plan_id.tolist()[-1] == "falls#2"


def test_several_threads_and_a_data_frame() -> None:
    with petmjx.Scorer(engine="mujoco", threads=1) as scorer, ThreadPoolExecutor(3) as pool:
        frames = list(pool.map(lambda plan: scorer.score(plan).worlds, PLANS))
        worlds = scorer.score(PLANS).worlds
    for row, frame in enumerate(frames):
        pd.testing.assert_series_equal(frame.margin, worlds.margin[row : row + 1].reset_index(drop=True))
    columns = {
        "plan_id": ["a", "a"],
        "article": "",
        "length_mm": 400,
        "width_mm": 300,
        "height_mm": 200,
        "weight_kg": 5,
    }
    frame = pd.DataFrame(columns | {"x_mm": 0, "y_mm": 0, "z_mm": [0, 200], "sequence": [1, 2]})
    assert petmjx.Scorer(engine="mujoco").score(frame).worlds.verdict.tolist() == ["stable"]


def test_arrays() -> None:
    scorer = petmjx.Scorer(engine="mujoco", threads=1)
    size, corner, mass = np.full((2, 3, 3), np.nan), np.full((2, 3, 3), np.nan), np.full((2, 3), np.nan)
    for row, plan in enumerate(PLANS[:2]):
        size[row, : plan.n_boxes], corner[row, : plan.n_boxes] = plan.size_mm, plan.corner_mm
        mass[row, : plan.n_boxes] = plan.mass_kg
    answer, expected = scorer.tell(size_mm=size, corner_mm=corner, mass_kg=mass), scorer.score(PLANS[:2])
    assert answer.stable.tolist() == [False, True]
    np.testing.assert_array_equal(answer.margin, expected.worlds.margin)
    np.testing.assert_array_equal(answer.top_force_n[1].astype(np.float32), expected.boxes.rest_top_force_n[2:])
    assert np.isnan(answer.top_force_n[0, 2])


def test_what_is_wrong_is_one_line() -> None:
    scorer, good = petmjx.Scorer(engine="mujoco"), np.ones((2, 1, 3))
    for call, message in (
        (lambda: scorer.score("plans.json"), "plans must be plans or a data frame, .*; petmjx.score reads files"),
        (lambda: scorer.score(None), "plans must be plans or a data frame"),  # type: ignore[arg-type]
        (lambda: scorer.score([]), "plans must hold at least one plan"),
        (lambda: scorer.tell(size_mm=good, corner_mm=good, mass_kg=[1, 2]), r"mass_kg must have the shape \(m, k\)"),
        (lambda: scorer.tell(size_mm=good[:1], corner_mm=good, mass_kg=[[1], [2]]), "size_mm must have 2 rows"),
        (lambda: scorer.tell(size_mm=good, corner_mm=good, mass_kg=[[1], [-2]]), "plan '?1'?.*weight"),
        (
            lambda: scorer.tell(size_mm=np.ones((1, 2, 3)), corner_mm=np.ones((1, 2, 3)), mass_kg=[[np.nan, 1]]),
            "mass_kg: row 0 has NaN before its last box",
        ),
        (lambda: petmjx.Scorer(out="x"), "out: a Scorer has no such option"),
        (lambda: petmjx.Scorer(engine="mjx"), "engine must be one of mujoco"),
    ):
        with pytest.raises(InputError, match=message):
            call()


@pytest.mark.slow
@pytest.mark.parametrize(("script", "library"), [("ray_scorer.py", "ray"), ("dask_scorer.py", "distributed")])
def test_an_actor_can_hold_one(script: str, library: str, tmp_path: Path) -> None:
    if importlib.util.find_spec(library) is None:
        pytest.skip(f"{library} is not installed")
    petmjx.save_plans(PLANS[:3], tmp_path / "plans.json")
    done = subprocess.run(
        [sys.executable, str(REPOSITORY / "examples" / script), str(tmp_path / "plans.json")],
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.count(" stable") == 2
    assert done.stdout.count("unstable") == 1
