"""Random errors of mass and friction in sweeps: what they change, by how much, and on which keys their random numbers
depend."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.command_line import write
from support.plans import make_plan, make_scene, stack

import petmjx
from petmjx.common.errors import InputError
from petmjx.runs.hopeless_profiles import hopeless_profiles
from petmjx.runs.sweep_file import load_sweep
from petmjx.world.error_distributions import Distribution, DistributionShape
from petmjx.world.scene import Scene
from petmjx.world.variants import MIN_FRICTION_FRACTION, MIN_MASS_FRACTION, PlacementChange, Variant, apply

SCENE = make_scene(12)
SD_10 = Distribution(DistributionShape.NORMAL, 0.0, 0.1)


def vary(replicate: int = 0, **change: Distribution | float) -> Scene:
    return apply(SCENE, "plan", Variant(1, PlacementChange(**change), replicate=replicate), 0)  # type: ignore[arg-type]


def test_each_box_has_its_own_mass() -> None:
    share = vary(mass_rel=SD_10).mass / SCENE.mass
    assert len(np.unique(share)) == SCENE.n_boxes
    assert 0 < np.abs(share - 1).max() < 0.5
    np.testing.assert_allclose(
        vary(mass_rel=Distribution(DistributionShape.NORMAL, 0.0, 0.2)).mass / SCENE.mass - 1, 2 * (share - 1)
    )
    np.testing.assert_allclose(vary(mass_rel=SD_10, mass_factor=1.5).mass, 1.5 * share * SCENE.mass)


def test_a_world_has_one_friction_for_boxes_and_carrier() -> None:
    shares = set()
    for replicate in range(5):
        varied = vary(replicate, friction_rel=SD_10)
        share = varied.friction[0, 0] / SCENE.friction[0, 0]
        shares.add(share)
        assert varied.friction == pytest.approx(share * SCENE.friction)
        assert varied.carrier.friction == pytest.approx(share * SCENE.carrier.friction)
        assert varied.floor_friction == SCENE.floor_friction
    assert len(shares) == 5
    both = vary(4, friction_rel=SD_10, box_friction_factor=0.5)
    assert both.friction == pytest.approx(0.5 * share * SCENE.friction)


def test_mass_and_friction_stay_positive() -> None:
    light = vary(mass_rel=Distribution(DistributionShape.FIXED, -1.0))
    np.testing.assert_allclose(light.mass, MIN_MASS_FRACTION * SCENE.mass)
    slippery = vary(friction_rel=Distribution(DistributionShape.FIXED, -1.0))
    assert slippery.friction == pytest.approx(MIN_FRICTION_FRACTION * SCENE.friction)


def test_they_disturb_no_other_error() -> None:
    shifted = Distribution(DistributionShape.NORMAL, 0.0, 2.0)
    alone, together = vary(x_mm=shifted), vary(x_mm=shifted, mass_rel=SD_10, friction_rel=SD_10)
    np.testing.assert_array_equal(alone.start_pos, together.start_pos)
    np.testing.assert_array_equal(alone.mass, SCENE.mass)
    np.testing.assert_array_equal(alone.friction, SCENE.friction)


def test_sweeps_have_them_as_axes(tmp_path: Path) -> None:
    file = write(
        tmp_path / "x.toml", "replicates = 2\n[axes]\nmass_tolerance_rel = [0, 0.02]\nfriction_tolerance_rel = 0.1"
    )
    results = petmjx.sweep(file, make_plan("a", stack(2)), engine="mujoco")
    worlds = results.worlds
    assert sorted(
        zip(worlds["friction_tolerance_rel"], worlds["mass_tolerance_rel"], worlds["replicate"], strict=True)
    ) == [(0.1, mass, replicate) for mass in (0.0, 0.02) for replicate in (0, 1)]
    assert results.units("worlds")["mass_tolerance_rel"] == "1"
    assert worlds["rest_top_force_n"].nunique() > 2


@pytest.mark.parametrize("axis", ["mass_tolerance_rel", "friction_tolerance_rel"])
def test_errors_beyond_the_whole_are_refused(axis: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=rf"axes.{axis} must be from -1 to 1, got normal\(0, 2\)"):
        load_sweep(write(tmp_path / "x.toml", f"[axes]\n{axis} = 2"), plans_given=True)


@pytest.mark.parametrize(
    ("error", "friction"), [("0.05", "up to 0.6"), ("{distribution = 'fixed', value = -0.2}", "0.4")]
)
def test_hopeless_profiles_know_the_largest_friction(error: str, friction: str, tmp_path: Path) -> None:
    text = f"[axes]\nprofile = 'en-12195-1-forward'\nfriction_tolerance_rel = {error}"
    (line,) = hopeless_profiles(load_sweep(write(tmp_path / "x.toml", text), plans_given=True))
    assert line == f"en-12195-1-forward reaches 0.8 g: with friction {friction} no unsecured load stays in place"
