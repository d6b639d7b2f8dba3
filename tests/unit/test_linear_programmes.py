"""Linear programmes: the same answers as with SciPy's ``milp``, without its import."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, milp

from petmjx.common import linear_programmes
from petmjx.common.linear_programmes import Entries, minimised
from petmjx.common.units import FloatArray

SEED = 33528


def programmes() -> list[tuple[FloatArray, ...]]:
    """Random programmes of several sizes, among them some without solution."""
    random = np.random.default_rng(SEED)
    drawn = []
    for _ in range(40):
        m, n = random.integers(1, 30, 2)
        rows = np.where(random.random((m, n)) < 0.3, random.normal(size=(m, n)), 0.0)
        bound = np.where(random.random(n) < 0.5, np.inf, random.random(n))
        inside = rows @ (random.random(n) * np.minimum(bound, 1.0))
        least, most = inside - random.exponential(size=m), inside + random.exponential(size=m)
        least[0] += 1.5 * random.integers(0, 2)
        drawn.append((random.exponential(size=n), rows, least, most, bound))
    return drawn


@pytest.mark.parametrize("without", [False, True], ids=["HiGHS", "another SciPy"])
def test_the_answers_are_those_of_scipy(without: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if without:
        monkeypatch.setattr(linear_programmes, "_highs", lambda: None)
    solved = 0
    for cost, rows, least, most, bound in programmes():
        answer = minimised(cost, Entries.of(rows), (least, most), (np.zeros(len(cost)), bound))
        expected = milp(cost, constraints=LinearConstraint(rows, least, most), bounds=Bounds(0.0, bound)).x
        assert (answer is None) == (expected is None)
        if answer is not None:
            solved += 1
            assert answer.tobytes() == expected.tobytes()
    assert 10 < solved < 40


def test_a_module_that_cannot_be_loaded_is_left_to_scipy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    *folders, name = linear_programmes._NAME.split(".")
    folder = tmp_path.joinpath(*folders)
    folder.mkdir(parents=True)
    (folder / f"{name}.py").write_text("HighsLp = None\nraise ImportError('a library is missing')\n")
    scipy = importlib.machinery.ModuleSpec("scipy", None, origin=str(tmp_path / "scipy" / "__init__.py"))
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: scipy)
    monkeypatch.delitem(sys.modules, linear_programmes._NAME, raising=False)
    one = np.ones(1)
    assert minimised(one, Entries.of(np.ones((1, 1))), (one, one), (one, one)).tolist() == [1.0]
    assert linear_programmes._NAME not in sys.modules, "SciPy could not load the module any more"


def test_scipy_is_not_imported_and_can_be_imported_later() -> None:
    code = """
import sys
import numpy as np
from petmjx.common.linear_programmes import Entries, minimised
bounds = np.zeros(2), np.array([0.25, 1.0])
print(minimised(np.ones(2), Entries.of(np.ones((1, 2))), (np.ones(1), np.ones(1)), bounds))
print("scipy.optimize" in sys.modules)
from scipy.optimize import linprog
print(linprog([1.0, 2.0], A_ub=[[-1.0, -1.0]], b_ub=[-1.0]).x)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    first, imported, second = done.stdout.splitlines()
    assert np.fromstring(first.strip("[]"), sep=" ").sum() == 1.0
    assert (imported, second) == ("False", "[1. 0.]")
