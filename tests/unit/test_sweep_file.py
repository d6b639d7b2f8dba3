"""Sweep files: the ready-made files can be read, and a sweep makes the intended worlds and starts them from the right
states."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.command_line import write
from support.plans import make_plan

import petmjx
from petmjx.common.errors import InputError
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Check, Schedule
from petmjx.plans.plan import Plan
from petmjx.runs.study import MAX_WORLDS
from petmjx.runs.sweep_cost import work_of
from petmjx.runs.sweep_file import MIN_TOLERANCE, Search, Sweep, load_sweep
from petmjx.runs.sweep_study import SweepStudy
from petmjx.runs.sweep_worlds import SweepPlan
from petmjx.world.error_distributions import DistributionShape
from petmjx.world.variants import Variant

SWEEPS = Path(__file__).parents[2] / "sweeps"
READY_MADE = sorted(path.name for path in SWEEPS.glob("*.toml"))


def sweep_file(folder: Path, text: str) -> Path:
    return write(folder / "x.toml", f'plans = "samples"\n{text}')


def sweep_plan(folder: Path, text: str, *plans: Plan, allow_large: bool = False) -> SweepPlan:
    return SweepPlan(load_sweep(sweep_file(folder, text)), plans or (make_plan("plan", 4),), allow_large)


def sweep_study(folder: Path, text: str) -> SweepStudy:
    return SweepStudy(load_sweep(sweep_file(folder, text)), [make_plan("plan", 4)], RunOptions())


def variants(plan: SweepPlan) -> list[Variant]:
    """All variants of the first plan."""
    return [variant for _, members in plan.placements() for variant in members]


WORLDS = {
    "chain-film-road.toml": (128, 32),
    "chain-film-truck.toml": (128, 32),
    "chain-to-wrapper.toml": (96, 32),
    "confidence.toml": (16, 16),
    "en-12195-1.toml": (8, 1),
    "eumos-search.toml": (48, 1),
    "eumos.toml": (64, 1),
    "friction.toml": (13, 13),
    "placement-and-transport.toml": (400, 400),
    "placement-error.toml": (384, 384),
    "radial-force.toml": (1, 1),
    "tilt.toml": (4, 1),
    "wrap-search.toml": (80, 5),
}


@pytest.mark.parametrize("name", READY_MADE)
def test_ready_made_sweeps_load_and_make_the_worlds_they_promise(name: str) -> None:
    sweep = load_sweep(SWEEPS / name)
    assert sweep.name == Path(name).stem
    assert sweep.description
    plan = SweepPlan(sweep, [make_plan("a", 4), make_plan("b", 9)])
    worlds, placements = WORLDS[name]
    assert (plan.n_variants, plan.n_placements, plan.n_worlds) == (worlds, placements, 2 * worlds)
    groups = list(plan.groups())
    assert len(groups) == 2 * placements
    if sweep.search is None:
        made = variants(plan)
        assert [variant.index for variant in made] == list(range(1, worlds + 1)) or sweep.sample
        assert sorted(variant.index for variant in made) == list(range(1, worlds + 1))
        assert set(made[0].parameters) == set(plan.parameter_columns)
    scene = plan.scene(groups[0])
    assert scene.n_boxes == 4
    assert f"{worlds:,} variant" in plan.amount
    readme = (SWEEPS.parent / "docs" / "sweeps.md").read_text(encoding="utf-8")
    line = next(line for line in readme.splitlines() if f"`{name}`" in line)
    assert str(worlds) in line
    assert sweep.resolved()["simulation"]["interval_s"] > 0


def test_kinetic_friction_is_that_of_the_ctu_code_where_a_sweep_is_by_it() -> None:
    shares = {name: load_sweep(SWEEPS / name).simulation.physics.kinetic_friction_share for name in READY_MADE}
    kinetic = {name: share for name, share in shares.items() if share != 1}
    assert kinetic == dict.fromkeys(
        ["chain-film-road.toml", "chain-film-truck.toml", "chain-to-wrapper.toml", "en-12195-1.toml"], 0.75
    )
    assert all("CTU Code" in (SWEEPS / name).read_text(encoding="utf-8") for name in kinetic)


def test_every_sweep_of_the_list_is_there() -> None:
    assert sorted(WORLDS) == READY_MADE


def test_more_than_a_million_worlds_need_a_yes(tmp_path: Path) -> None:
    text = "replicates = 1000\n[axes]\nplacement_error_mm = {distribution = 'normal', sd = 1}\n" + (
        "profile = 'radial'\nscale = {from = 1, to = 2, count = 1001}"
    )
    with pytest.raises(InputError, match=r"make 1,001,000 worlds .* more than 1,000,000: pass allow_large=True"):
        sweep_plan(tmp_path, text)
    large = sweep_plan(tmp_path, text, allow_large=True)
    assert large.n_worlds == 1_001_000 > MAX_WORLDS
    first = next(large.groups())
    assert len(first.variants) == 1001


def test_a_grid_places_once_and_forks_into_all_drives(tmp_path: Path) -> None:
    plan = sweep_plan(
        tmp_path,
        "replicates = 3\nnominal = true\n[axes]\nplacement_error_mm = [0, 2]\nmass_factor = [1.0, 1.1]\n"
        "profile = ['radial', 'jolts']\ndirection = ['+x', 45]\nscale = {from = 0.5, to = 1.5, step = 0.5}",
    )
    groups = list(plan.groups())
    # Each of 2 masses without an error is placed once; each of 2 masses with an error three times; and there is the
    # nominal world.
    assert len(groups) == plan.n_placements + 1 == 9
    assert [len(group.variants) for group in groups] == [1] + [12] * 8
    assert plan.n_variants == sum(len(group.variants) for group in groups)
    for group in groups:
        keys = {variant.placement_key for variant in group.variants}
        assert keys == {group.placement.placement_key}
    keys = [group.placement.placement_key for group in groups[1:]]
    assert len(set(keys)) == 8
    assert groups[0].variants[0].index == 0
    assert plan.drive(groups[0].plan, groups[0].variants[0]) is None
    assert list(plan.parameter_columns) == [
        "placement_error_mm", "mass_factor", "profile", "direction_deg", "scale", "replicate",
    ]  # fmt: skip
    made = variants(plan)
    assert len({variant.index for variant in made}) == len(made)
    assert {variant.parameters["direction_deg"] for variant in made[1:]} == {0.0, 45.0}
    assert plan.parameter_columns["direction_deg"] == "deg"


def test_worlds_of_one_profile_share_its_samples(tmp_path: Path) -> None:
    plan = sweep_plan(tmp_path, "[axes]\nprofile = 'eumos-40509'\nlevel = [0.5, 1.0]\ndirection = ['+x', '-y']")
    (group,) = plan.groups()
    drives = [plan.drive(group.plan, variant) for variant in group.variants]
    assert len({id(drive.excitation.samples) for drive in drives if drive}) == 1
    assert [(drive.scale, round(drive.yaw_rad, 6)) for drive in drives if drive] == [
        (0.5, 0.0), (1.0, 0.0), (0.5, 4.712389), (1.0, 4.712389),
    ]  # fmt: skip


def test_random_vibration_is_repeated_without_new_placements(tmp_path: Path) -> None:
    plan = sweep_plan(
        tmp_path,
        "replicates = 4\n[axes]\nprofile = ['truck', 'radial']\n"
        "[profiles.truck]\nkind = 'random'\npsd = [[2, 0.01], [50, 0.01]]\nduration_s = 2",
        make_plan("a", 4),
        make_plan("b", 4),
    )
    groups = list(plan.groups())
    assert len(groups) == 2
    assert plan.n_variants == len(groups[0].variants) == 4 + 1
    drawn = {}
    for group in groups:
        for variant in group.variants[:4]:
            drive = plan.drive(group.plan, variant)
            assert drive is not None
            drawn[group.plan.plan_id, variant.replicate] = drive.excitation.samples.tobytes()
    assert len(set(drawn.values())) == 8
    again = plan.drive(groups[0].plan, groups[0].variants[2])
    assert again is not None
    assert again.excitation.samples.tobytes() == drawn["a", 2]


def test_samples_are_drawn_the_same_whatever_else_is_swept(tmp_path: Path) -> None:
    text = "mode = 'sample'\nsample = {n}\nseed = 5\n[axes]\nfriction_factor = {{from = 0.5, to = 1.5}}\n{more}"
    profile = "profile = ['radial', 'jolts']\nscale = [1, 2]"
    short = variants(sweep_plan(tmp_path, text.format(n=10, more="")))
    long = variants(sweep_plan(tmp_path, text.format(n=50, more=profile)))
    assert [v.placement for v in short] == [v.placement for v in long[:10]]
    factors = np.array([variant.placement.box_friction_factor for variant in long])
    assert ((factors > 0.5) & (factors < 1.5)).all()
    assert len(set(factors)) == 50
    assert {v.drive.profile for v in long if v.drive} == {"radial", "jolts"}


def test_samples_of_drives_alone_share_one_placement(tmp_path: Path) -> None:
    plan = sweep_plan(
        tmp_path, "mode = 'sample'\nsample = 20\n[axes]\nprofile = 'eumos-40509'\nlevel = {from = 0.1, to = 1}"
    )
    (group,) = plan.groups()
    assert len(group.variants) == 20
    assert plan.n_placements == 1


def test_distributions_are_read_and_shown(tmp_path: Path) -> None:
    plan = sweep_plan(
        tmp_path,
        "[axes]\nplacement_error_x_mm = [0, 2]\ndrop_height_mm = 3\n"
        "yaw_error_deg = [1, {distribution = 'uniform', low = -1, high = 3}]",
    )
    made = variants(plan)
    assert {v.parameters["placement_error_x_mm"] for v in made} == {0.0, 2.0}
    assert {v.parameters["yaw_error_deg"] for v in made} == {"normal(0, 1)", "uniform(-1, 3)"}
    last = made[-1].placement
    assert (last.x_mm.shape, last.x_mm.spread, last.y_mm.zero) == (DistributionShape.NORMAL, 2.0, True)
    assert (last.yaw_deg.shape, last.yaw_deg.centre, last.yaw_deg.spread) == (DistributionShape.UNIFORM, 1.0, 2.0)
    assert (last.drop_height_mm.shape, last.drop_height_mm.centre) == (DistributionShape.FIXED, 3.0)


def test_directions_of_a_range_have_names_too(tmp_path: Path) -> None:
    ranges = ("{from = '+x', to = '-y', step = 90}", "{from = 0, to = 270, count = 4}")
    texts = [f"[axes]\nprofile = 'eumos-40509'\nlevel = 0.3\ndirection = {values}" for values in ranges]
    by_name, by_angle = (sweep_plan(tmp_path, text).sweep.axes["direction"].values for text in texts)
    assert by_name == by_angle == (0.0, 90.0, 180.0, 270.0)


def test_a_search_numbers_its_worlds_by_what_they_test(tmp_path: Path) -> None:
    plan = sweep_plan(
        tmp_path,
        "[axes]\nmass_factor = [1.0, 1.2]\nprofile = 'eumos-40509'\ndirection = ['+x', '-x']\n"
        "[search]\nupper = 1.0\ntolerance = 0.01",
    )
    groups = list(plan.groups())
    assert len(groups) == 2
    assert plan.sweep.search_levels.tolist() == [round(0.01 * k, 2) for k in range(101)]
    assert [item.direction_deg for item in plan.search_items()] == [0.0, 180.0]
    made = {
        plan.search_variant(group, item, level).index for group in groups for item in (0, 1) for level in range(101)
    }
    assert made == set(range(1, 405))
    variant = plan.search_variant(groups[1], 1, 37)
    assert variant.drive is not None
    assert (variant.drive.scale, variant.drive.direction_deg) == (0.37, 180.0)
    assert variant.parameters == {
        "mass_factor": 1.2, "profile": "eumos-40509", "direction_deg": 180.0, "level_g": 0.37,
    }  # fmt: skip
    assert set(plan.parameter_columns) == set(variant.parameters)
    assert variant.placement_key == groups[1].placement.placement_key


@pytest.mark.parametrize(
    ("lower", "upper", "tolerance", "expected"),
    [
        (0, 0.25, 0.1, [0.0, 0.1, 0.2, 0.25]),
        (0, 0.27, 0.1, [0.0, 0.1, 0.2, 0.27]),
        (0.1, 0.4, 0.1, [0.1, 0.2, 0.3, 0.4]),
        (0, 0.3, 0.1, [0.0, 0.1, 0.2, 0.3]),
        (0.5, 0.6, 1, [0.5, 0.6]),
        (0.5, 0.50001, 1, [0.5, 0.50001]),
    ],
)
def test_a_search_ends_at_its_upper_end(
    lower: float, upper: float, tolerance: float, expected: list[float], tmp_path: Path
) -> None:
    search = f"lower = {float(lower)}\nupper = {float(upper)}\ntolerance = {float(tolerance)}"
    plan = sweep_plan(tmp_path, f"[axes]\nprofile = 'eumos-40509'\n[search]\n{search}")
    assert plan.sweep.search_levels.tolist() == expected


def test_the_levels_of_the_ready_made_search_are_hundredths() -> None:
    levels = load_sweep(SWEEPS / "eumos-search.toml").search_levels
    assert levels.tolist() == [round(0.01 * k, 12) for k in range(201)]


def test_levels_always_rise_and_end_at_the_upper_end() -> None:
    rng = np.random.default_rng(1)
    for lower, width, steps in rng.uniform((0, 0.01, 1), (900, 90, 999), (50, 3)).tolist():
        search = Search(lower=lower, upper=lower + width, tolerance=max(width / steps, MIN_TOLERANCE))
        levels = Sweep(search=search, axes={"profile": "eumos-40509"}).search_levels
        assert (np.diff(levels) > 0).all()
        assert levels[0] == pytest.approx(lower, abs=1e-11)
        assert levels[-1] == lower + width


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[axes]\nprofile = 'eumos-40509'\nlevel = [0.1, 0.2]", {}),
        ("nominal = true\n[axes]\nplacement_error_mm = 2", {1: 0}),
        ("replicates = 2\n[axes]\nplacement_error_mm = [0, 2]", {2: 0, 3: 1}),
        ("replicates = 2\n[axes]\nprofile = ['radial', 'truck']\n[profiles.truck]\nkind = 'random'\n"
         "psd = [[1, 0.01], [40, 0.01]]", {2: 0, 3: 1}),
        ("mode = 'sample'\nsample = 3\n[axes]\nfriction_factor = {from = 0.5, to = 1}", {1: 1, 2: 2, 3: 3}),
    ],
    ids=["nothing random", "an error", "replicates", "vibration", "sample"],
)  # fmt: skip
def test_draws_are_the_worlds_with_something_random(text: str, expected: dict[int, int], tmp_path: Path) -> None:
    assert sweep_plan(tmp_path, text).draws() == expected


def test_radial_force_ends_where_the_reference_ends() -> None:
    sweep = load_sweep(SWEEPS / "radial-force.toml")
    plan = SweepPlan(sweep, [make_plan("long", 40), make_plan("short", 26)])
    sim = sweep.simulation
    assert (sim.check, sim.schedule, sim.early_stop) == (Check.ONE_BY_ONE, Schedule.FIXED, False)
    (variant,) = variants(plan)
    dt = sim.physics.timestep_s
    # The reference implementation simulates 25,000 steps for 40 boxes, and 16,250 steps for 26 boxes, in which the
    # chain of pushes is cut off.
    for packing_plan, total, nominal in zip(plan.plans, (25_000, 16_250), (11_000, 7_500), strict=True):
        drive = plan.drive(packing_plan, variant)
        assert drive is not None
        assert nominal + len(drive.excitation.samples) + int(drive.rest_s / dt) == total
        # The chain itself begins with a pause of 2 s.
        assert np.flatnonzero(drive.excitation.samples.any(axis=1))[0] == 1000


TOO_SHORT_FOR_ONE_BOX = (
    "[simulation]\nschedule = 'fixed'\ninterval_s = 0.5\nsettle_s = 0.1\ntotal_time_factor = 1.2\n"
    "[axes]\nprofile = 'radial'"
)


def test_plans_whose_run_ends_before_their_profile_are_skipped(tmp_path: Path) -> None:
    one, four = make_plan("one", 1), make_plan("four", 4)
    results = petmjx.sweep(sweep_file(tmp_path, TOO_SHORT_FOR_ONE_BOX), [one, four], engine="mujoco")
    assert results.worlds["plan_id"].tolist() == ["four"]
    (skipped,) = results.info["skipped"]
    assert skipped["plan_id"] == "one"
    assert "plan one: its worlds end before the profile begins, at 1.2 times the placement time" in skipped["error"]
    for plans, strict in (([one], False), ([four, one], True)):
        with pytest.raises(InputError, match="plan one: its worlds end before"):
            petmjx.sweep(sweep_file(tmp_path, TOO_SHORT_FOR_ONE_BOX), plans, engine="mujoco", strict=strict)


def test_what_a_timestep_cannot_show_is_refused_before_the_run(tmp_path: Path) -> None:
    text = "[axes]\nprofile = 'fast'\n[profiles.fast]\nkind = 'random'\npsd = [[1, 0.1], [300, 0.1]]"
    with pytest.raises(InputError, match=r"x\.toml: profile fast: PSD reaches 300 Hz, .* below 250 Hz"):
        sweep_plan(tmp_path, text)
    sweep = load_sweep(sweep_file(tmp_path, text), simulation={"physics": {"timestep_s": 0.001}})
    assert SweepPlan(sweep, [make_plan("plan", 4)]).n_worlds == 1


def test_estimates_know_that_a_fallen_pallet_is_not_shaken_again(tmp_path: Path) -> None:
    """The first leg has 0.3 g, at which a column of boxes of 300 mm tips over if it is higher than 1 m. In film, it
    stands."""
    text = """
[[legs]]
name = "conveyor"
{film}events = [{{ profile = "eumos-40509", level = 0.3 }}]
[[legs]]
name = "truck"
pause_s = 0.2
events = [{{ profile = "eumos-40509", level = 0.5 }}, {{ profile = "eumos-40509", level = 0.1 }}]
"""
    low, high = (make_plan(boxes=[((400.0, 300.0, 300.0), (0, 0, 300 * k), 6) for k in range(n)]) for n in (3, 4))
    works = [
        work_of(SweepPlan(load_sweep(sweep_file(tmp_path, text.format(film=film)), plans_given=True), [low, high]))
        for film in ("", "wrap_turns = 4\n")
    ]
    assert [work.rounds for work in works] == [2, 2]
    assert works[0].driven_share[0] == 1
    stands = (0.25 / 0.3) ** 8
    assert works[0].driven_share[1] == pytest.approx((200 + stands * 500) / 700, rel=0.01)
    assert works[1].driven_share == [1, 1]
    assert works[0].shaken.tolist() == pytest.approx([2, 2 * (200 + stands * 500) / 700], rel=0.01)
    # the first leg is gentle
    assert works[0].gentle == pytest.approx([200 / 700, 200 / (200 + stands * 500)], rel=0.01)
    assert [work.filmed for work in works] == [[0, 0], [1, 1]], "film stays on for the next legs"


def test_estimates_know_when_a_tilted_load_falls(tmp_path: Path) -> None:
    """A column of boxes of 300 mm, 1.5 m high, is expected to fall at 0.4 g, and a low load to slide at its friction of
    0.5. The carrier tilts by 5° per second; gravity then acts along the carrier."""
    high, low = (make_plan(boxes=[((400.0, 300.0, 300.0), (0, 0, 300 * k), 6) for k in range(n)]) for n in (5, 1))
    text = "[axes]\nprofile = 'tilt'"

    def drive_steps(plan: Plan, text: str = text) -> float:
        return work_of(SweepPlan(load_sweep(sweep_file(tmp_path, text), plans_given=True), [plan])).drive_steps

    for plan, limit_g in ((high, 0.4), (low, 0.5)):
        begins_s = np.degrees(np.arctan(limit_g)) / 5
        assert drive_steps(plan) == pytest.approx(begins_s / 0.002 + 250, rel=0.15)
    assert drive_steps(high) < drive_steps(low)
    whole = 11 / 0.002 + 115  # 9 s to 45°, one second there, one second back
    assert drive_steps(high, text + "\nwrap_turns = [4]") == pytest.approx(whole, rel=0.01)
    assert drive_steps(high, "[simulation]\nearly_stop = false\n" + text) == pytest.approx(whole, rel=0.01)


def test_estimates_know_the_rounds_of_a_search_and_gentle_drives(tmp_path: Path) -> None:
    text = "[axes]\nprofile = 'eumos-40509'\nlevel = {from = 0.1, to = 0.8, count = 8}"
    assert (sweep_study(tmp_path, text).work.gentle, sweep_study(tmp_path, text).work.rounds) == (3 / 8, 1)
    search = "[axes]\nprofile = 'eumos-40509'\n[search]\nupper = 1.0\ntolerance = 0.25\nsections = {sections}"
    for sections, rounds in ((1, 3), (3, 2), (9, 1)):
        work = sweep_study(tmp_path, search.format(sections=sections)).work
        assert (work.rounds, work.gentle) == (rounds, 0.5)


def test_estimates_count_placements_once(tmp_path: Path) -> None:
    text = "[axes]\nprofile = 'eumos-40509'\nlevel = {{from = 0.001, to = 0.064, count = {count}}}"
    one, many = (sweep_study(tmp_path, text.format(count=count)) for count in (2, 64))
    # the profile lasts 0.4 s, and then the pallet becomes quiet
    assert many.work.steps - one.work.steps == pytest.approx([62 * (200 + 115)])
    estimate = many.size(100.0)
    assert estimate.startswith("64 worlds (1 plan × 64 variants) from 1 placement, about ")
    also_nominal = sweep_study(tmp_path, "nominal = true\n" + text.format(count=64)).size(None)
    assert also_nominal.startswith("65 worlds (1 plan × 65 variants) from 2 placements, about ")
    assert estimate.endswith(" steps, about 2 min")
    assert many.size(100.0, recorded=48).endswith(" steps left, about 25 s")
