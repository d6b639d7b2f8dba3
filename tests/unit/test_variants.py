"""Variants of a plan's world: what they change in a scene, what they leave unchanged, and which random numbers they
use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.world.error_distributions import Distribution, DistributionShape
from petmjx.world.scene import Scene, build_scene
from petmjx.world.variants import UNCHANGED, DriveSpec, PlacementChange, Variant, apply, apply_all

NORMAL_5 = Distribution(DistributionShape.NORMAL, 0.0, 5.0)

TOUCH_M = 1e-9
"""Rounding error of heights of some metres in float64, m."""


def make_plan(corner_mm: list[list[float]], size_mm: list[list[float]], plan_id: str = "plan") -> Plan:
    n = len(corner_mm)
    return Plan(
        plan_id=plan_id,
        source="test",
        size_mm=np.array(size_mm, dtype=float),
        corner_mm=np.array(corner_mm, dtype=float),
        mass_kg=np.arange(1.0, n + 1),
        item_ids=("",) * n,
        articles=("",) * n,
        sequence=np.arange(n),
    )


def stack(n_columns: int = 3, n_layers: int = 4) -> Scene:
    """Columns of boxes side by side along x. No box connects two columns."""
    corners = [[400.0 * c, 0.0, 200.0 * layer] for layer in range(n_layers) for c in range(n_columns)]
    return build_scene(make_plan(corners, [[400, 300, 200]] * len(corners)), Simulation())


def vary(scene: Scene, replicate: int = 0, plan_id: str = "plan", seed: int = 0, **change: object) -> Scene:
    placement = replace(PlacementChange(), **change)  # type: ignore[arg-type]
    return apply(scene, plan_id, Variant(1, placement, replicate=replicate), seed)


def deepest_vertical_overlap(scene: Scene) -> float:
    """Largest vertical overlap of two boxes that stand above one another, m."""
    worst = -np.inf
    bottom = scene.start_pos[:, 2] - scene.half_size[:, 2]
    top = scene.start_pos[:, 2] + scene.half_size[:, 2]
    for a in range(scene.n_boxes):
        for b in range(scene.n_boxes):
            apart = np.abs(scene.start_pos[a, :2] - scene.start_pos[b, :2]) - scene.half_size[a, :2]
            overlaps = (apart < scene.half_size[b, :2]).all()
            if overlaps and scene.start_pos[a, 2] - scene.start_pos[b, 2] > 0.1:
                worst = max(worst, top[b] - bottom[a])
    return float(worst)


def test_the_nominal_variant_changes_nothing() -> None:
    scene = stack()
    assert apply(scene, "plan", Variant(0), 0) is scene
    driven = Variant(5, drive=DriveSpec("radial", 2.0, 90.0))
    assert apply(scene, "plan", driven, 0) is scene


def test_factors_scale_friction_and_masses_but_not_the_carrier_s_mass_or_the_floor() -> None:
    scene = stack()
    varied = vary(scene, box_friction_factor=0.5, carrier_friction_factor=0.8, mass_factor=1.25)
    assert varied.friction[0] == pytest.approx((0.25, 0.0025, 0.00005))
    assert varied.carrier.friction[0] == pytest.approx((0.4, 0.004, 0.00008))
    assert varied.floor_friction == scene.floor_friction
    np.testing.assert_array_equal(varied.mass, scene.mass * 1.25)
    assert varied.carrier.mass == scene.carrier.mass
    np.testing.assert_array_equal(varied.start_pos, scene.start_pos)
    np.testing.assert_array_equal(varied.half_size, scene.half_size)


def test_placement_errors_move_the_release_but_not_the_plan() -> None:
    scene = stack()
    varied = vary(scene, x_mm=NORMAL_5, y_mm=Distribution(DistributionShape.UNIFORM, 0.0, 2.0))
    offset = varied.start_pos - scene.start_pos
    assert 1e-3 < np.abs(offset[:, 0]).max() < 0.03
    assert 0 < np.abs(offset[:, 1]).max() <= 0.002
    assert not np.array_equal(offset[:, 0], offset[:, 1])
    np.testing.assert_array_equal(varied.target, scene.target)
    np.testing.assert_array_equal(offset[:, 2], 0)
    np.testing.assert_array_equal(vary(scene, x_mm=NORMAL_5, shifts_from_release=True).target[:, 0],
                                  vary(scene, x_mm=NORMAL_5).start_pos[:, 0])  # fmt: skip


def test_yaw_turns_boxes_about_the_vertical() -> None:
    scene = stack()
    varied = vary(scene, yaw_deg=Distribution(DistributionShape.FIXED, 90.0))
    half = np.sqrt(0.5)
    np.testing.assert_allclose(varied.start_quat, np.tile([half, 0, 0, half], (scene.n_boxes, 1)), atol=1e-15)
    drawn = vary(scene, yaw_deg=NORMAL_5).start_quat
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1.0)
    assert len(np.unique(drawn[:, 3])) == scene.n_boxes


def test_drop_height_lifts_the_release_and_never_lowers_it() -> None:
    scene = stack()
    lifted = vary(scene, drop_height_mm=Distribution(DistributionShape.FIXED, 5.0))
    np.testing.assert_allclose(lifted.start_pos[:, 2] - scene.start_pos[:, 2], 0.005)
    np.testing.assert_array_equal(lifted.target, scene.target)
    drawn = vary(scene, drop_height_mm=NORMAL_5)
    assert (drawn.start_pos[:, 2] >= scene.start_pos[:, 2]).all()
    assert (drawn.start_pos[:, 2] > scene.start_pos[:, 2]).any()


@pytest.mark.parametrize(
    "size", [NORMAL_5, Distribution(DistributionShape.UNIFORM, 2.0, 2.0), Distribution(DistributionShape.FIXED, -3.0)]
)
def test_sizes_that_change_are_set_down_on_the_actual_tops(size: Distribution) -> None:
    scene = stack()
    varied = vary(scene, size_mm=size)
    np.testing.assert_array_equal(varied.start_pos[:, :2], scene.start_pos[:, :2])
    bottom = (varied.start_pos - varied.half_size)[:, 2].reshape(4, 3)
    top = (varied.start_pos + varied.half_size)[:, 2].reshape(4, 3)
    np.testing.assert_allclose(bottom[0], 0.0, atol=TOUCH_M)
    assert deepest_vertical_overlap(varied) <= TOUCH_M
    # Every box stands on the highest box that it overlaps, seen from above.
    for layer in range(1, 4):
        assert ((bottom[layer] - top[layer - 1]) >= -TOUCH_M).all()
    assert np.isclose(bottom[1:], top[:-1], rtol=0, atol=TOUCH_M).any()
    np.testing.assert_array_equal(varied.target, varied.start_pos)


def test_relative_tolerance_scales_each_dimension() -> None:
    scene = stack()
    varied = vary(scene, size_rel=Distribution(DistributionShape.FIXED, 0.01))
    np.testing.assert_allclose(varied.half_size, scene.half_size * 1.01)
    tiny = vary(scene, size_rel=Distribution(DistributionShape.FIXED, -5.0))
    np.testing.assert_allclose(tiny.half_size, scene.half_size * 0.1)


def test_a_bridge_rests_on_the_higher_of_its_supports() -> None:
    corners = [[0, 0, 0], [400, 0, 0], [200, 0, 200]]
    # with the contacts of the preset reference, a box is lower by the size reduction, and falls by this distance
    for physics, fall_m in (("pallet", 0.0), ("reference", 1e-4)):
        scene = build_scene(make_plan(corners, [[400, 300, 200]] * 3), Simulation(physics=physics))
        varied = vary(scene, size_mm=NORMAL_5, replicate=4)
        top = (varied.start_pos + varied.half_size)[:, 2]
        bottom = (varied.start_pos - varied.half_size)[:, 2]
        assert bottom[2] == pytest.approx(max(top[0], top[1]) + fall_m, abs=TOUCH_M)
        assert top[0] != top[1]


def test_a_box_pushed_over_a_slightly_higher_neighbour_is_set_on_it_and_a_wall_is_not_climbed() -> None:
    corners = [[0, 0, 0], [400, 0, 0], [0, 0, 200], [0, 320, 0], [0, 320, 300]]
    sizes = [[400, 300, 200], [400, 300, 204], [400, 300, 200], [400, 300, 300], [400, 300, 100]]
    scene = build_scene(make_plan(corners, sizes), Simulation())
    varied = vary(
        scene, x_mm=Distribution(DistributionShape.FIXED, 10.0), y_mm=Distribution(DistributionShape.FIXED, 0.0)
    )
    # All boxes move in the same way, so box 2 comes over no other box. If it moved alone, it would stand on box 1, 4 mm
    # higher.
    np.testing.assert_allclose(varied.start_pos[:, 2], scene.start_pos[:, 2], atol=TOUCH_M)
    for replicate in range(30):
        moved = vary(scene, x_mm=NORMAL_5, y_mm=NORMAL_5, replicate=replicate)
        assert deepest_vertical_overlap(moved) <= TOUCH_M
        rise = moved.start_pos[2, 2] - scene.start_pos[2, 2]
        apart = moved.start_pos[1, 0] - moved.start_pos[2, 0] - moved.half_size[1, 0] - moved.half_size[2, 0]
        assert rise == pytest.approx(0.004 if apart < 0 else 0.0, abs=1e-6)


def test_random_numbers_depend_on_seed_plan_and_replicate_alone() -> None:
    scene = stack()
    keys = [(seed, plan, replicate) for seed in (0, 1) for plan in ("a", "b") for replicate in (0, 1, 2)]

    def run(order: list[tuple[int, str, int]]) -> dict[tuple[int, str, int], bytes]:
        return {
            (seed, plan, replicate): vary(
                scene, replicate, plan, seed, x_mm=NORMAL_5, size_mm=NORMAL_5, yaw_deg=NORMAL_5
            ).start_pos.tobytes()
            for seed, plan, replicate in order
        }

    forwards, backwards = run(keys), run(keys[::-1])
    assert forwards == backwards
    assert len(set(forwards.values())) == len(keys)
    one = Variant(3, PlacementChange(x_mm=NORMAL_5))
    other = Variant(77, PlacementChange(x_mm=NORMAL_5), DriveSpec("radial"))
    np.testing.assert_array_equal(apply(scene, "a", one, 0).start_pos, apply(scene, "a", other, 0).start_pos)


def test_levels_of_an_error_share_their_draws_and_axes_do_not_disturb_each_other() -> None:
    scene = stack()
    small = vary(scene, x_mm=Distribution(DistributionShape.NORMAL, 0.0, 1.0)).start_pos[:, 0] - scene.start_pos[:, 0]
    large = vary(scene, x_mm=NORMAL_5, yaw_deg=NORMAL_5, drop_height_mm=NORMAL_5)
    np.testing.assert_allclose(large.start_pos[:, 0] - scene.start_pos[:, 0], 5 * small, atol=1e-12)


def test_distributions_have_their_moments() -> None:
    rng = np.random.default_rng(0)
    n = 20_000
    standard_error = 5.0 / np.sqrt(n)
    (normal,) = Distribution(DistributionShape.NORMAL, 2.0, 5.0).draw([rng], (n,))
    assert abs(normal.mean() - 2.0) < 4 * standard_error
    assert normal.std() == pytest.approx(5.0, rel=0.03)
    (uniform,) = Distribution(DistributionShape.UNIFORM, -1.0, 1.0).draw([rng], (n,))
    assert -2 <= uniform.min() < -1.99
    assert -0.01 < uniform.max() <= 0
    assert Distribution(DistributionShape.FIXED, 3.0).draw([rng], (2,)).tolist() == [[3.0, 3.0]]


def test_placement_key_separates_placements_and_merges_drives() -> None:
    calm, shaky = PlacementChange(mass_factor=1.1), PlacementChange(x_mm=NORMAL_5)
    assert Variant(1, calm, DriveSpec("radial")).placement_key == Variant(2, calm, DriveSpec("sine")).placement_key
    assert Variant(1, calm, replicate=0).placement_key == Variant(2, calm, replicate=5).placement_key
    assert Variant(1, shaky, replicate=0).placement_key != Variant(2, shaky, replicate=5).placement_key
    assert Variant(1, calm).placement_key != Variant(1).placement_key
    never = PlacementChange(x_mm=Distribution(DistributionShape.NORMAL, 0.0, 0.0))
    assert Variant(1, never, replicate=0).placement_key == Variant(2, never, replicate=5).placement_key


def test_many_worlds_are_made_together_as_each_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("petmjx.world.variants.AT_A_TIME", 3)
    scene = stack()
    changes = (
        PlacementChange(x_mm=NORMAL_5, yaw_deg=NORMAL_5, size_mm=NORMAL_5),
        UNCHANGED,
        PlacementChange(friction_rel=Distribution(DistributionShape.UNIFORM, 0.0, 0.2), mass_factor=1.2),
        PlacementChange(drop_height_mm=NORMAL_5, shifts_from_release=True),
    )
    variants = [Variant(k, changes[k // 5], replicate=k) for k in range(20)]
    for variant, varied_scene in zip(variants, apply_all(scene, "a", variants, 4), strict=True):
        alone = apply(scene, "a", variant, 4)
        for name in ("half_size", "mass", "target", "start_pos", "start_quat", "friction"):
            np.testing.assert_array_equal(getattr(varied_scene, name), getattr(alone, name), err_msg=name)
        assert varied_scene.placing == alone.placing
        assert (varied_scene is scene) == (variant.placement == UNCHANGED)
