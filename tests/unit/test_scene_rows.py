"""Tables of similar worlds that are filled in together equal tables that are filled in world by world, to the last
bit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from jax.tree import leaves, leaves_with_path
from support.plans import heap, make_plan, make_scene, stack

from petmjx.engines.contact_penetration import stiffened
from petmjx.engines.mjx import scene_rows, world_constants
from petmjx.engines.mjx.scene_rows import rows_of
from petmjx.engines.mjx.world_constants import upload_worlds
from petmjx.options.simulation import Simulation
from petmjx.world.error_distributions import Distribution, DistributionShape
from petmjx.world.job import Job
from petmjx.world.scene import Scene, build_scene
from petmjx.world.scene_arrays import AT_A_TIME, equal_shape_groups
from petmjx.world.variants import PlacementChange, Variant, apply_all

ERROR = Distribution(DistributionShape.NORMAL, 0.0, 3.0)
SHARE = Distribution(DistributionShape.NORMAL, 0.0, 0.05)


def with_errors(sim: Simulation, count: int, n_boxes: int = 24) -> list[Scene]:
    """Worlds of one plan with random errors of places, turns, sizes, masses, friction and drop heights."""
    change = PlacementChange(
        x_mm=ERROR, y_mm=ERROR, yaw_deg=ERROR, size_mm=ERROR, mass_rel=SHARE, friction_rel=SHARE, drop_height_mm=ERROR
    )
    variants = [Variant(k + 1, change, replicate=k) for k in range(count)]
    return list(apply_all(build_scene(make_plan("heap", heap(n_boxes)), sim), "heap", variants, seed=3))


def one_by_one(scenes: Sequence[Scene]) -> Iterator[tuple[list[int], bool]]:
    return (([number], False) for number in range(len(scenes)))


@pytest.mark.parametrize(
    "options",
    [
        {"placing": "exact"},
        {"placing": "drop"},
        {"placing": "hand", "carrier": "epal-1"},
        {"placing": "tines"},
        {"physics": "reference"},
        {"check": "static"},
        {"wrap": {"turns": 3}},
    ],
)
def test_worlds_that_are_alike_are_filled_in_together(
    options: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    sim = Simulation(**options)
    scenes = [*with_errors(sim, 5), make_scene(stack(3), sim), *with_errors(sim, AT_A_TIME), *with_errors(sim, 2, 7)]
    together = rows_of(scenes, 28, sim, 1)
    with monkeypatch.context() as patch:
        patch.setattr(scene_rows, "MANY", len(scenes))
        in_threads = rows_of(scenes, 28, sim, 1, padding=3)
    monkeypatch.setattr(scene_rows, "equal_shape_groups", one_by_one)
    apart = rows_of(scenes, 28, sim, 1)
    assert together.keys() == apart.keys() == in_threads.keys()
    for name, values in apart.items():
        np.testing.assert_array_equal(together[name], values, err_msg=name, strict=True)
        np.testing.assert_array_equal(in_threads[name], [*values, *[values[0]] * 3], err_msg=name)


def test_groups_have_each_scene_once_and_only_those_alike() -> None:
    sim = Simulation()
    scenes = [*with_errors(sim, AT_A_TIME + 5, 7), make_scene(stack(3), sim), make_scene(stack(3), sim)]
    scene_groups = list(equal_shape_groups(scenes))
    assert sorted(number for numbers, _ in scene_groups for number in numbers) == [*range(len(scenes))]
    assert sorted(len(numbers) for numbers, _ in scene_groups) == [2, 5, AT_A_TIME]
    assert all(len({scenes[number].n_boxes for number in numbers}) == 1 for numbers, _ in scene_groups)


def test_boxes_are_released_where_the_stiffness_of_their_own_contacts_puts_them() -> None:
    scenes = [make_scene(n) for n in (3, 1, 4)]
    stiffness = (None, 0.5, None, 0.5, 0.1)
    jobs = [Job(scene, stiff=stiff) for scene, stiff in zip([*scenes, scenes[0], scenes[2]], stiffness, strict=True)]
    together = upload_worlds(jobs, 8, 4, {}, Simulation())
    for row, job in enumerate([*jobs, *[jobs[0]] * 3]):
        sim = Simulation() if job.stiff is None else stiffened(Simulation(), job.stiff)
        alone = upload_worlds([replace(job, stiff=None)], 1, 4, {}, sim)
        for (path, rows), expected in zip(leaves_with_path(together), leaves(alone), strict=True):
            assert np.array_equal(rows[row], expected[0]), (row, path)
    assert not np.array_equal(together.start[0], together.start[3]), "softer contacts give way by more"


def test_padding_rows_made_on_the_device_are_those_made_on_the_host(monkeypatch: pytest.MonkeyPatch) -> None:
    jobs = [Job(make_scene(n)) for n in (3, 1, 4)]
    on_host = upload_worlds(jobs, 8, 4, {}, Simulation())
    monkeypatch.setattr(world_constants, "MANY_PADDING_ROWS", 5)
    on_device = upload_worlds(jobs, 8, 4, {}, Simulation())
    for (path, rows), expected in zip(leaves_with_path(on_host), leaves(on_device), strict=True):
        assert rows.dtype == expected.dtype, path
        assert np.array_equal(rows, expected), path
