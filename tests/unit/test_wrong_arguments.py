"""Arguments of wrong types in Python: one line with the name of the argument, and no traceback from inside petmjx."""

from __future__ import annotations

import datetime
import inspect
import random
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from support.plans import make_plan

import petmjx
from petmjx.common.errors import PetmjxError
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.packers.sample_plans import generate, write_samples
from petmjx.plans.plan_writer import save_plans

pytestmark = [
    pytest.mark.usefixtures("in_tmp_path"),
    pytest.mark.filterwarnings("ignore::petmjx.PlanWarning"),
]


class Hostile:
    """An object that raises an error whatever it is asked."""

    def __array__(self, *args: Any, **kwargs: Any) -> Any:
        raise RuntimeError("no array")

    def __len__(self) -> int:
        raise RuntimeError("no length")


STRANGE: tuple[Any, ...] = (
    None, True, 0, -1, 1.5, 10**30, 2**63, float("nan"), float("inf"), 1j, Decimal(3), "", " ", "x", "nul\0", b"", b"x",
    bytearray(3), (), [], {}, set(), [1], [None], ["", 3], [[1, 2], [3]], [[1, 2, 3]], [["a", "b", "c"]], {"a": 1},
    {1: 2}, {"plan_id": "A"}, range(3), (k for k in ()), object(), Hostile(), int, len, Ellipsis, slice(3), Path(),
    Path("none"), np.zeros(0), np.zeros(3), np.zeros((3, 3)), np.zeros((2, 2, 2)), np.float64(2), np.array("x"),
    np.array([1, "x", None], object), np.ma.masked_array([1.0], [True]), np.datetime64("2020-01-01"),
    datetime.date(2020, 1, 1), pd.DataFrame(), pd.DataFrame({"plan_id": [1]}), pd.Series([1.0]), pd.NaT,
    make_plan("A"), [make_plan("A")], petmjx.PlanSet([make_plan("A")]), Simulation(), RunOptions(), ValueError("x"),
)  # fmt: skip

BOXES: dict[str, Any] = {
    "size_mm": [[400, 300, 200]] * 2,
    "corner_mm": [[0, 0, 0], [0, 0, 200]],
    "mass_kg": [6, 6],
}
QUICK: dict[str, Any] = {"engine": "mujoco", "check": "static", "duration_s": 0.01, "threads": 1}
RELEASED: dict[str, Any] = {
    "size_mm": [400, 300, 200],
    "mass_kg": 6,
    "pos_m": [[0, 0, 0.2]],
    "quat_wxyz": [1, 0, 0, 0],
    "vel_m_s": [0, 0, 0],
    "angvel_rad_s": [0, 0, 0],
    "times_s": [0.01],
}
FIELDS = {name: getattr(make_plan("A"), name) for name in inspect.signature(petmjx.Plan).parameters}


def _options(function: Any) -> list[str]:
    """Names of arguments, without those for which a wrong value is valid or makes a run long."""
    slow = {"plans", "workers", "ray", "duration_s", "interval_s", "confidence", "out", "resume", "overwrite"}
    return [name for name in inspect.signature(function).parameters if name not in slow]


CALLS: dict[str, tuple[Callable[..., Any], dict[str, Any], list[str]]] = {
    "score": (petmjx.score, {"plans": make_plan("A"), **QUICK}, _options(petmjx.score)),
    "score of": (petmjx.score, QUICK, ["plans"]),
    "score into": (
        petmjx.score,
        {"plans": 3, **QUICK},
        ["out", "orders", "errors", "resume", "overwrite", "workers", "ray"],
    ),
    "sweep": (petmjx.sweep, {"file": "friction", "plans": 3, **QUICK}, ["file", "plans", "watcher", "batching"]),
    "tell": (
        petmjx.tell,
        {"plan_id": "A", "source": make_plan("A"), **QUICK},
        ["plan_id", "source", "plans", "variant", "interval_s", "details"],
    ),
    "Plan": (petmjx.Plan, FIELDS, list(FIELDS)),
    "PlanSet": (petmjx.PlanSet, {}, ["plans", "skipped", "warnings", "notes", "conventions"]),
    "from_boxes": (
        petmjx.Plan.from_boxes,
        {"plan_id": "A", **BOXES},
        ["plan_id", "boxes", *BOXES, "units", "anchor", "article", "orientation", "order_sequence", "sequence"],
    ),
    "load_plans": (
        petmjx.load_plans,
        {"paths": "none.json"},
        ["paths", "limit", "strict", "max_boxes", "carrier_extent_mm", "units", "anchor"],
    ),
    "save_plans": (save_plans, {"plans": make_plan("A"), "path": "a.json"}, ["plans", "path"]),
    "kpis": (
        petmjx.kpis,
        {"plans": make_plan("A"), "orders": "none.json"},
        ["plans", "orders", "run", "strict", "assume_stable"],
    ),
    "release": (
        petmjx.release,
        RELEASED,
        [*RELEASED, "inertia_kg_m2", "friction", "restitution", "ground", "physics", "engine"],
    ),
    "generate": (generate, {"n": 1, "seed": 0}, ["n", "seed", "loose_share", "packer", "workers"]),
    "write_samples": (write_samples, {"path": "b.json", "n": 1, "seed": 0}, ["path", "n", "seed", "packer"]),
}  # fmt: skip


def _call(function: Callable[..., Any], arguments: dict[str, Any]) -> str | None:
    """The line of the error; None if the call raised no error."""
    try:
        function(**arguments)
    except PetmjxError as error:
        return str(error)
    return None


@pytest.mark.parametrize("seed", range(4))
def test_strange_arguments_are_one_line(seed: int) -> None:
    """500 calls in all, each with a strange value of one argument. Any other exception than petmjx's own fails the
    test."""
    rng = random.Random(seed)
    refused = 0
    for _ in range(125):
        function, usual, names = CALLS[rng.choice(list(CALLS))]
        name, value = rng.choice(names), rng.choice(STRANGE)
        line = _call(function, usual | {name: value})
        if line is not None:
            refused += 1
            assert "\n" not in line
            assert 0 < len(line) < 1000
    assert refused > 80


NO_PLANS = (
    "plans must be paths or Plan objects, a single path or Plan, a PlanSet, or a data frame, got {}; petmjx.load_plans "
    "reads dictionaries and arrays"
)


@pytest.mark.parametrize(
    ("call", "name", "value", "line"),
    [
        ("score of", "plans", 3, "plans must be a list of paths or Plan objects, a single path or Plan, a PlanSet, or "
         "a data frame, got 3"),
        ("score of", "plans", "", "plans must be a path, got ''"),
        ("score of", "plans", [b"x"], "plans must be a path, got b'x'"),
        ("score of", "plans", {"a": []}, NO_PLANS.format("a dict")),
        ("score of", "plans", [{"length": 400}], NO_PLANS.format("a dict")),
        ("score of", "plans", np.zeros((2, 6)), NO_PLANS.format("an array")),
        ("score of", "plans", [[0, 0, 0, 400, 300, 200]], NO_PLANS.format("a list")),
        ("score", "out", "", "out must be a path, got ''"),
        ("score", "orders", 3, "orders must be a path, got 3"),
        ("score", "watcher", 3, "watcher must have the methods 'begin' and 'world_done', got 3"),
        ("score", "limit", "many", "limit must be a whole number, got 'many'"),
        ("sweep", "file", None, "file must be a path, got None"),
        ("tell", "plan_id", 3, "plan_id must be text, got 3"),
        ("tell", "interval_s", "1", "interval_s must be a number, got '1'"),
        ("Plan", "size_mm", "big", "size_mm must be an array of numbers, got 'big'"),
        ("Plan", "corner_mm", [[1, 2]], "corner_mm must have the shape (n, 3), got (1, 2)"),
        ("Plan", "mass_kg", [1], "size_mm must have 1 value, as mass_kg has, got 3"),
        ("Plan", "articles", "abc", "articles must be a list of text, got 'abc'"),
        ("PlanSet", "plans", [3], "plans[0] must be Plan objects, got 3"),
        ("from_boxes", "plan_id", 3, "plan_id must be text, got 3"),
        ("from_boxes", "boxes", 3, "plan A: boxes must be a list of dictionaries, got 3"),
        ("load_plans", "strict", "yes", "strict must be true or false, got 'yes'"),
        ("save_plans", "path", "", "path must be a path, got ''"),
        ("release", "size_mm", "big", "size_mm must be an array of numbers, got 'big'"),
        ("release", "ground", 3, "ground must be 'plane', "
         f"{', '.join(map(repr, map(str, [*petmjx.Carrier][1:])))} or a TOML file of boards, got 3"),
        ("release", "times_s", 3, "times_s must have the shape (n), got ()"),
        ("generate", "n", 10**9, "n must be at most 200,000, got 1000000000"),
        ("generate", "n", 2.0, "n must be a whole number, got 2.0"),
    ],
)  # fmt: skip
def test_the_line_names_the_argument(call: str, name: str, value: Any, line: str) -> None:
    function, usual, _ = CALLS[call]
    assert _call(function, usual | {name: value}) == line


READERS: dict[str, Callable[[Any], Any]] = {
    "load_run": petmjx.load_run,
    "loads": lambda value: petmjx.loads(value, "articles.csv"),
    "compare_runs": lambda value: petmjx.compare_runs(value, value),
    "compare_packers": lambda value: petmjx.compare_packers(value),
    "merge_runs": lambda value: petmjx.merge_runs(value, "out"),
    "merge_runs into": lambda value: petmjx.merge_runs(["a", "b"], value),
    "report": lambda value: petmjx.report(value, "report.html"),
}


@pytest.mark.parametrize("value", [None, 5, float("nan"), "", b"run", {1: 2}, [5]])
@pytest.mark.parametrize("name", READERS)
def test_what_reads_runs_refuses_what_is_no_run(name: str, value: Any) -> None:
    with pytest.raises(PetmjxError) as caught:
        READERS[name](value)
    assert "\n" not in str(caught.value)
