"""The scripts in examples/ are run as users start them."""

from __future__ import annotations

import json
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from support.programs import run_program

import petmjx

ITEM = {"article": "carton", "id": "1", "product_group": "tea"}
SIZE = {"length/mm": 400, "width/mm": 300, "height/mm": 200, "weight/kg": 5, "sequence": 1}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with two plans of two boxes, one of which falls, and with orders of two boxes."""
    sizes, masses = [[600, 400, 250], [400, 300, 200]], [12, 5]
    plans = [
        petmjx.Plan.from_boxes(name, size_mm=sizes, corner_mm=[[0, 0, 0], [x, 50, 250]], mass_kg=masses)
        for name, x in (("careful", 100), ("daring", 420))
    ]
    petmjx.save_plans(plans, tmp_path / "plans.json")
    order = {"item_sequence": {"1": ITEM | SIZE, "2": ITEM | SIZE}, "properties": {"target": "euro-pallet"}}
    (tmp_path / "orders.json").write_text(json.dumps({"A": order, "B": order}), encoding="utf-8")
    return tmp_path


def run(folder: Path, repository: Path, command: list[str], **environment: str) -> str:
    given = {**os.environ, "PYTHONPATH": str(repository), **environment}
    done = subprocess.run(command, cwd=folder, env=given, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_label_plans(folder: Path, repository: Path) -> None:
    script = repository / "examples" / "label_plans.py"
    printed = run_program(script, "plans.json", "labels.csv", "--engine", "mujoco", folder=folder)
    assert "2 labels in labels.csv, 50.0% stand" in printed
    assert dict(pd.read_csv(folder / "labels.csv")[["plan_id", "stands"]].values) == {"careful": 1.0, "daring": 0.0}
    sure = ("labels.parquet", "--run", "sure", "--engine", "mujoco", "--confidence", "4")
    run_program(script, "plans.json", *sure, folder=folder)
    assert list(pd.read_parquet(folder / "labels.parquet")["stands"]) == [1.0, 0.0]


@pytest.mark.slow
def test_training_in_jax(tmp_path: Path, repository: Path) -> None:
    script = str(repository / "examples" / "train_in_jax.py")
    few = ["--updates", "2", "--pallets", "2", "--steps", "3", "--epochs", "1", "--boxes", "3", "--orders", "4"]
    command = [sys.executable, script, *few, "--held-out", "2", "--engine", "mujoco"]
    # Users have JAX's default for arrays of different ranks. Without optimisations, XLA compiles a third faster.
    settings = {"JAX_NUMPY_RANK_PROMOTION": "allow", "JAX_DISABLE_MOST_OPTIMIZATIONS": "1"}
    printed = run(tmp_path, repository, command, **settings)
    assert re.fullmatch(
        r"(update \d: \d+ episodes with a mean return of -?\d+\.\d+\n){2}2 other orders: a mean return of \d+\.\d+\n",
        printed,
    )


@pytest.mark.parametrize(
    ("script", "library", "few"),
    [
        (
            "train_with_sb3.py",
            "sb3_contrib",
            ["--steps", "32", "--pallets", "4", "--rollout", "4", "--engine", "mujoco"],
        ),
        ("train_with_rllib.py", "tree", ["--updates", "1", "--steps", "16", "--pallets", "2"]),
    ],
)
def test_training_with_libraries(tmp_path: Path, repository: Path, script: str, library: str, few: list[str]) -> None:
    pytest.importorskip("torch", reason="PyTorch is not installed")
    pytest.importorskip(library, reason=f"{library} is not installed")
    path = os.pathsep.join([str(repository), os.environ.get("PYTHONPATH", "")])
    printed = run(tmp_path, repository, [sys.executable, str(repository / "examples" / script), *few], PYTHONPATH=path)
    assert "ep_rew_mean" in printed or "update 1: return" in printed


def test_judge_packer(folder: Path, repository: Path) -> None:
    pytest.importorskip("scipy", reason="SciPy is not installed (extra: packers)")
    script = repository / "examples" / "judge_packer.py"
    printed = run_program(script, "orders.json", "--engine", "mujoco", folder=folder)
    assert "mine  2         2    1.0" in printed
    assert "no order is decided" in printed


def test_slurm_array(folder: Path, repository: Path) -> None:
    """Both jobs of a Slurm array of two jobs are run, and their results are merged."""
    petmjx_command = folder / "petmjx"
    petmjx_command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m petmjx "$@"\n')
    petmjx_command.chmod(0o755)
    script = repository / "examples" / "slurm_array.sh"
    for number in (1, 2):
        slurm = {"SLURM_ARRAY_TASK_ID": str(number), "SLURM_ARRAY_TASK_COUNT": "2", "SLURM_CPUS_PER_TASK": "1"}
        path = f"{folder}{os.pathsep}{os.environ['PATH']}"
        run(folder, repository, [str(script), "plans.json", "results"], PATH=path, **slurm)
    merged = petmjx.merge_runs(sorted((folder / "results").glob("shard-*")), folder / "all")
    assert set(merged.worlds["plan_id"]) == {"careful", "daring"}


def test_ray_cluster(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """This test checks only the options that the script passes. tests/unit/test_worker_pool.py tests the workers,
    because Ray takes long to start."""
    arguments: dict[str, Any] = {}
    monkeypatch.setattr(petmjx, "score", lambda plans, **options: arguments.update(options, plans=plans))
    script = repository / "examples" / "ray_cluster.py"
    monkeypatch.setattr(sys, "argv", [str(script), "plans.json", "results", "--ray", "head:6379"])
    runpy.run_path(str(script), run_name="__main__")
    assert arguments.pop("plans") == Path("plans.json")
    options = petmjx.RunOptions(**arguments)
    assert (options.ray, options.asked_workers, options.resume) == ("head:6379", "auto", True)
