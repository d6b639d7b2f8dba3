"""Shapes of arrays: annotations are checked at every call, records have the annotated shapes, and all names of axes are
listed."""

from __future__ import annotations

import ast
import importlib.util
import re
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import AbstractArray, TypeCheckError, jaxtyped
from support.fake_stepper import FakeEngine, FakeStepper, fake_scene, run_all

import petmjx.engines.mjx
from petmjx.engines.mjx import box_motion as motion
from petmjx.engines.mjx.first_states import started_states
from petmjx.engines.mjx.padded_template import parked_positions
from petmjx.engines.mjx.rollout import CHUNK_PASSES, BatchRollout
from petmjx.engines.mjx.rules import Rules
from petmjx.engines.mjx.timetable import Timetable, build_timetable
from petmjx.engines.mjx.world_constants import NEVER, Worlds, upload_worlds
from petmjx.engines.mjx.world_state import Metrics, State, fresh_state, narrow, per_box, put_resized, take_rows
from petmjx.options.simulation import Simulation
from petmjx.world.job import Job
from petmjx.world.surface_pairs import MOST_SURFACES

ROWS, WIDTH = 8, 5
SIM = Simulation()
JOBS = [Job(fake_scene(*[1.0] * n)) for n in (1, 3, WIDTH, 2, 4)]

checked = pytest.mark.skipif(importlib.util.find_spec("beartype") is None, reason="beartype is not installed")


# ---------------------------------------------------------------------- calls


@checked
@pytest.mark.parametrize(
    ("pos", "target"),
    [
        pytest.param((2, 3, 3), (2, 3), id="rank"),
        pytest.param((2, 3, 4), (2, 3, 4), id="size"),
        pytest.param((2, 3, 3), (2, 1, 3), id="axes that differ"),
    ],
)
def test_a_metric_refuses_shapes_other_than_its_own(pos: tuple[int, ...], target: tuple[int, ...]) -> None:
    with pytest.raises(TypeCheckError, match="target" if pos[-1] == 3 else "pos"):
        motion.shift(jnp.zeros(pos), jnp.zeros(target), 0.001)


@checked
def test_compiled_functions_check_while_they_are_traced() -> None:
    with pytest.raises(TypeCheckError, match="quat"):
        jax.jit(motion.tilt_deg)(jnp.zeros((2, 3, 3)))


@checked
def test_a_timetable_of_unequal_lengths_is_refused() -> None:
    table = build_timetable(SIM, 2)
    values = {**vars(table), "due": table.due[:-1]}
    with pytest.raises(TypeCheckError, match="due"):
        Timetable(**values)


@checked
def test_results_are_checked_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    assert parked_positions(2).shape == (2, 3)
    monkeypatch.setattr(jnp, "stack", lambda parts, axis: parts[0])
    with pytest.raises(TypeCheckError, match="return"):
        parked_positions(2)


# ---------------------------------------------------------------------- records


def axis_sizes(record: Any) -> dict[str, int]:
    """Check all fields of a record, and of the records in it, against their annotations. Returns name of an axis →
    size."""
    sizes: dict[str, int] = {}

    def visit(part: Any) -> None:
        for name, kind in get_type_hints(type(part)).items():
            value = getattr(part, name)
            if hasattr(kind, "_fields"):
                visit(value)
                continue
            arrays = {name: value}
            if get_origin(kind) is dict:
                (_, kind), arrays = get_args(kind), value
            if isinstance(kind, type) and issubclass(kind, AbstractArray):
                for key, array in arrays.items():
                    assert isinstance(array, kind), f"{type(part).__name__}.{key}: {array.dtype}{array.shape}: {kind}"
                    axes = zip(kind.dim_str.split(), array.shape, strict="..." not in kind.dim_str)
                    sizes.update((axis, size) for axis, size in axes if not axis.isdigit() and axis != "...")

    with jaxtyped("context"):
        visit(record)
    return sizes


def of_boxes(rows: int, boxes: int) -> dict[str, int]:
    """Sizes of the axes of ``Worlds`` if each carrier has one shape."""
    of_bodies = {"body": boxes + 1, "body_end": boxes + 2, "shape": boxes + 1}
    return {"world": rows, "box": boxes, **of_bodies, "surface": MOST_SURFACES}


@pytest.fixture(scope="module")
def worlds() -> Worlds:
    return upload_worlds(JOBS, ROWS, WIDTH, {}, SIM)


@pytest.fixture(scope="module")
def table(worlds: Worlds) -> State:
    return fresh_state(worlds, all_placed=False, ends=jnp.full(ROWS, NEVER), rest_steps=100)


def test_a_table_is_as_annotated(worlds: Worlds, table: State) -> None:
    assert axis_sizes(worlds) == of_boxes(ROWS, WIDTH)
    assert axis_sizes(table) == {"world": ROWS, "box": WIDTH}


def test_states_that_start_from_a_kept_one_are_as_annotated(table: State) -> None:
    (kept,) = run_all(FakeEngine(), [Job(fake_scene(1.0), keep_state=True)], SIM)
    assert kept.state is not None
    assert len(kept.state.qpos) == kept.n_boxes == 1, "of its own boxes, whatever its table had room for"
    forks = [Job(job.scene, start=kept.state) for job in JOBS]
    assert axis_sizes(started_states(forks, table)) == {"world": ROWS, "box": WIDTH}


@pytest.mark.parametrize("driven", [False, True])
def test_a_chunk_of_steps_is_as_annotated(worlds: Worlds, table: State, driven: bool) -> None:
    model = FakeStepper(WIDTH, held=driven)
    lockstep = BatchRollout(Rules(SIM, build_timetable(SIM, WIDTH), WIDTH, driven=driven), model)
    after, memory, trail = jax.jit(lockstep.chunk)(table, model.blank_memory(ROWS), worlds, jnp.zeros((1, 1, 3)))
    assert axis_sizes(after) == {"world": ROWS, "box": WIDTH}
    assert axis_sizes(trail) == {"step": CHUNK_PASSES, "world": ROWS, "box": WIDTH}
    assert memory.forces.shape == model.blank_memory(ROWS).forces.shape


def test_a_field_of_the_wrong_kind_is_found(worlds: Worlds, table: State) -> None:
    wrong = [
        worlds._replace(inertia_box=worlds.inertia_box[:, 1:]),
        worlds._replace(n_boxes=worlds.mass[:, 0]),
        table._replace(metrics=table.metrics._replace(culprit=table.placed[1:])),
    ]
    for record in wrong:
        with pytest.raises(AssertionError, match=r"inertia_box|n_boxes|culprit"):
            axis_sizes(record)


def test_states_are_cut_along_their_boxes_and_nothing_else(table: State) -> None:
    assert axis_sizes(narrow(table, 2)) == {"world": ROWS, "box": 2}
    for leaf, same in zip(jax.tree.leaves(table), jax.tree.leaves(narrow(table, WIDTH)), strict=True):
        np.testing.assert_array_equal(leaf, same)
    assert axis_sizes(take_rows(table, jnp.array([3, 99]))) == {"world": 2, "box": WIDTH}
    # The box axis is the second axis of every field that has a box axis.
    for kind in (Metrics, State):
        has_boxes = {name for name, hint in get_type_hints(kind).items() if "box" in getattr(hint, "dim_str", "")}
        assert set(per_box(kind)) == has_boxes


def test_states_can_be_put_into_tables_for_other_numbers_of_boxes(table: State) -> None:
    """If the state has fewer boxes than the table, the other boxes of the table stay unchanged. If it has more, the
    additional boxes are dropped."""
    rows = jnp.array([5, 0, ROWS])
    anew = take_rows(jax.tree.map(lambda values: values + 1, table), jnp.arange(3))
    resized = put_resized(table, rows, narrow(anew, 2))
    for before, new, after in zip(*(jax.tree.leaves(tree) for tree in (table, narrow(anew, 2), resized)), strict=True):
        expected = np.array(before)
        for k, row in enumerate((5, 0)):
            expected[(row, *map(slice, new.shape[1:]))] = new[k]
        np.testing.assert_array_equal(after, expected)
    cut, resized = narrow(put_resized(table, rows, anew), 2), put_resized(narrow(table, 2), rows, anew)
    for one, other in zip(jax.tree.leaves(resized), jax.tree.leaves(cut), strict=True):
        np.testing.assert_array_equal(one, other)


# ---------------------------------------------------------------------- names of axes


def annotated_axes(path: Path) -> set[str]:
    """Names of the axes in the jaxtyping annotations of a module."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        match node:
            case ast.Subscript(value=ast.Name(id=kind), slice=ast.Tuple(elts=[_, ast.Constant(value=str(axes))])):
                if re.match(r"(Float|Int|Bool|Shaped)\d*$", kind):
                    names |= set(re.findall(r"[a-z]\w*", axes))
    return names


def test_axes_have_the_names_that_are_listed(repository: Path) -> None:
    listed = set(re.findall(r"``(\w+)``", petmjx.engines.mjx.__doc__ or ""))
    folders = ("petmjx/engines/mjx", "petmjx/engines/warp")
    modules = [path for folder in folders for path in sorted((repository / folder).glob("*.py"))]
    used = {name: path.name for path in modules for name in annotated_axes(path)}
    assert {"world", "box"} <= used.keys()
    assert {name: path for name, path in used.items() if name not in listed} == {}
    assert listed - used.keys() == set()
