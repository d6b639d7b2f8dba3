"""Makes rows of tables from scenes. Similar scenes are written into their rows together. Writing one scene after
another would take longer than simulating small worlds on a GPU."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.processes import on_threads
from petmjx.options.materials import PAIR_TABLES
from petmjx.options.simulation import Simulation
from petmjx.world.approach_paths import ApproachPath, approach_path_of, approach_paths_of
from petmjx.world.compliance import compliances, sinks_m
from petmjx.world.film import film_of
from petmjx.world.history import CARRIER
from petmjx.world.release_places import NOTHING, Release, release_of, releases_of
from petmjx.world.scene import IDENTITY_QUAT, Scene
from petmjx.world.scene_arrays import equal_shape_groups, stacked_values
from petmjx.world.surface_pairs import filled_up

MANY: Final = 1_000
"""From this number of rows on, several threads copy faster than one, since NumPy releases the interpreter's lock while
it copies."""

MOST_ROW_THREADS: Final = 8

Rows = dict[str, NDArray[Any]]
"""Name of a field of ``world_constants.Worlds`` → its rows, one per scene. A table of ``Worlds.pairs`` has the name
``PAIR`` + its key."""

PAIR: Final = "pair_"


def rows_of(scenes: Sequence[Scene], width: int, sim: Simulation, boards: int = 1, padding: int = 0) -> Rows:
    """The rows of scenes: all fields of ``world_constants.Worlds`` that do not depend on the job.

    Args:
        scenes: one scene per row. If a scene occurs several times, its values are computed only once.
        width: number of box columns.
        boards: number of columns for the shapes of a carrier; increased if a carrier has more shapes.
        padding: number of padding rows, which repeat the first scene's row.
    """
    distinct = list({id(scene): scene for scene in scenes}.values())
    if len(distinct) == len(scenes):
        return _rows_of_distinct(scenes, width, sim, boards, padding)
    row_of = {id(scene): row for row, scene in enumerate(distinct)}
    fan_out = np.array([row_of[id(scene)] for scene in scenes] + [0] * padding)
    rows = _rows_of_distinct(distinct, width, sim, boards)
    return dict(zip(rows, gather_rows(rows.values(), fan_out), strict=True))


def gather_rows(arrays: Iterable[NDArray[Any]], source: NDArray[np.int64]) -> list[NDArray[Any]]:
    """For each array, the rows whose numbers are in ``source``. ``source`` contains many numbers more than once."""
    threads = MOST_ROW_THREADS if len(source) >= MANY else 1
    return on_threads(partial(np.take, indices=source, axis=0), [*arrays], threads)


def with_padding_rows(values: NDArray[Any], padding: int) -> NDArray[Any]:
    """The rows, followed by padding rows that repeat the first row."""
    return np.concatenate([values, np.repeat(values[:1], padding, axis=0)])


def _rows_of_distinct(scenes: Sequence[Scene], width: int, sim: Simulation, boards: int, padding: int = 0) -> Rows:
    """The rows of scenes that are all different, in the form of ``rows_of``."""
    boards = max(boards, *map(more_shapes, scenes))
    n = len(scenes)
    rows = _empty(n + padding, width, boards)
    for name, values in _scene_values(scenes).items():
        rows[name] = np.empty((n + padding, *values.shape[1:]), values.dtype)
        rows[name][:n] = values

    def put(group: tuple[list[int], bool]) -> None:
        numbers, plain = group
        group_scenes = [scenes[number] for number in numbers]
        if plain:
            release, path = releases_of(group_scenes, sim), approach_paths_of(group_scenes, sim)
            _put_plain(rows, np.array(numbers), group_scenes, release, path)
        else:
            _put(rows, numbers[0], group_scenes[0], sim)

    on_threads(put, [*equal_shape_groups(scenes)], MOST_ROW_THREADS if n >= MANY else 1)
    for values in rows.values():
        values[n:] = values[0]
    return rows


def more_shapes(scene: Scene) -> int:
    """Number of shapes in addition to one shape per box: the shapes of the carrier, and further pieces of sheets and
    pallets.
    """
    return len(scene.shapes.body) - scene.n_boxes if scene.pieces else len(scene.carrier.half_size)


def _empty(n: int, width: int, boards: int) -> Rows:
    """Rows without boxes, into which the values of scenes are written later."""
    start = np.zeros((n, width, 7), np.float32)
    start[:, :, 3:] = IDENTITY_QUAT
    shapes = boards + width
    return {
        "half": np.full((n, width, 3), 0.1, np.float32),
        "middle": np.zeros((n, width, 3), np.float32),
        "target": np.zeros((n, width, 3), np.float32),
        "start": start,
        "support": np.full((n, width), NOTHING, np.int32),
        "sinks": np.zeros((n, width), np.float32),
        "most_followed": np.zeros(n, np.float32),
        "mass": np.ones((n, width + 1), np.float32),
        "inertia_box": np.full((n, width + 1, 3), 0.1, np.float32),
        "first_shape": np.tile(np.arange(width + 2, dtype=np.int32), (n, 1)),
        "shape_body": np.zeros((n, shapes), np.int32),
        "shape_half": np.full((n, shapes, 3), 0.1, np.float32),
        "shape_pos": np.zeros((n, shapes, 3), np.float32),
        "friction": np.ones((n, shapes, 3), np.float32),
        "shape_surface": np.zeros((n, shapes), np.int32),
        "shape_give": np.zeros((n, shapes), np.float32),
        "appears": np.ones(n, np.bool_),
        "way_offset": np.zeros((n, width, 3), np.float32),
        "way_steps": np.zeros((n, width), np.int32),
        "way_aside": np.zeros((n, width, 2, 2), np.float32),
        "falls": np.zeros((n, width), np.bool_),
        "wrap_press": np.zeros((n, width, 3), np.float32),
        "wrap_hold": np.zeros((n, width), np.float32),
    }


def _scene_values(scenes: Sequence[Scene]) -> Rows:
    """The rows of the fields that have one value per scene, not one per box."""
    return {
        "n_boxes": stacked_values(scenes, "n_boxes").astype(np.int32),
        "carrier_pos": stacked_values(scenes, "carrier.pos").astype(np.float32),
        "floor_friction": stacked_values(scenes, "floor_friction").astype(np.float32),
        **{
            PAIR + table.name: np.array([filled_up(scene.pairs, table.name) for scene in scenes]).astype(np.float32)
            for table in PAIR_TABLES
        },
        "floor_z": stacked_values(scenes, "floor_z").astype(np.float32),
        "hand_force": stacked_values(scenes, "placing.force_n").astype(np.float32),
        "hand_speed": stacked_values(scenes, "placing.speed_m_s").astype(np.float32),
    }


def _put_plain(
    rows: Rows, at: NDArray[np.intp], scenes: Sequence[Scene], release: Release, path: ApproachPath | None
) -> None:
    """Write the values of scenes whose arrays have equal shapes (petmjx/world/scene_arrays.py) into their rows, all at
    once."""
    k, s = scenes[0].n_boxes, len(scenes[0].carrier.half_size)
    half = stacked_values(scenes, "half_size")
    quat, place = stacked_values(scenes, "start_quat"), release.pos
    rows["half"][at, :k], rows["target"][at, :k] = half, stacked_values(scenes, "target")
    if path is not None:
        place, quat, rows["appears"][at] = place + path.lift, path.quat, False
        rows["way_offset"][at, :k], rows["way_steps"][at, :k] = path.offset, path.steps
        rows["falls"][at, :k], rows["way_aside"][at, :k] = path.falls, path.aside
    rows["start"][at, :k, :3], rows["start"][at, :k, 3:] = place, quat
    if scenes[0].wrap.holds:
        for row, scene in zip(at.tolist(), scenes, strict=True):
            rows["wrap_press"][row, :k], rows["wrap_hold"][row, :k] = film_of(scene)
    rows["support"][at, :k], rows["most_followed"][at] = release.support, release.most_followed_m
    rows["mass"][at, 0] = stacked_values(scenes, "carrier.mass")
    rows["mass"][at, 1 : k + 1] = stacked_values(scenes, "mass")
    rows["inertia_box"][at, 0] = stacked_values(scenes, "carrier.inertia_box")
    rows["inertia_box"][at, 1 : k + 1] = half
    rows["first_shape"][at, 1:] += s - 1
    rows["shape_body"][at, s : s + k] = np.arange(1, k + 1)
    for name, of_carrier, of_boxes in (
        ("shape_half", "half_size", half),
        ("shape_pos", "shape_pos", 0.0),
        ("friction", "friction", stacked_values(scenes, "friction")),
    ):
        rows[name][at, :s] = stacked_values(scenes, f"carrier.{of_carrier}")
        rows[name][at, s : s + k] = of_boxes


def _put(rows: Rows, row: int, scene: Scene, sim: Simulation) -> None:
    """Write the values of a scene of any kind into its row."""
    k, release, shapes = scene.n_boxes, release_of(scene, sim), scene.shapes
    rows["half"][row, :k], rows["middle"][row, :k] = scene.half_size, scene.middle
    rows["target"][row, :k] = scene.target
    place, quat, path = release.pos, scene.start_quat, approach_path_of(scene, sim)
    if path is not None:
        place, quat, rows["appears"][row] = place + path.lift, path.quat, False
        rows["way_offset"][row, :k], rows["way_steps"][row, :k] = path.offset, path.steps
        rows["falls"][row, :k], rows["way_aside"][row, :k] = path.falls, path.aside
    rows["start"][row, :k, :3], rows["start"][row, :k, 3:] = scene.frames(place, quat), quat
    if scene.wrap.holds:
        rows["wrap_press"][row, :k], rows["wrap_hold"][row, :k] = film_of(scene)
    rows["support"][row, :k], rows["most_followed"][row] = release.support, release.most_followed_m
    rows["mass"][row, : k + 1] = np.append(scene.carrier.mass, scene.mass)
    rows["inertia_box"][row, : k + 1] = scene.inertia_boxes
    s, width = len(shapes.body), rows["half"].shape[1]
    more_shapes = np.bincount(shapes.body - CARRIER, minlength=width + 1) - 1
    rows["first_shape"][row, 1 : k + 2] += np.cumsum(more_shapes[: k + 1])
    rows["first_shape"][row, k + 2 :] += more_shapes[: k + 1].sum()
    rows["shape_body"][row, :s], rows["shape_half"][row, :s] = shapes.body - CARRIER, shapes.half_size
    rows["shape_pos"][row, :s], rows["friction"][row, :s] = shapes.pos, shapes.friction
    rows["shape_surface"][row, :s] = shapes.surface
    if scene.stiffness is not None:
        rows["sinks"][row, :k] = sinks_m(scene, sim.physics.gravity_m_s2)
        rows["shape_give"][row, :s] = np.append(compliances(scene.stiffness, scene.half_size), 0.0)[shapes.body]
