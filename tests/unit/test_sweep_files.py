"""Sweep files: the ready-made ones load, bad ones get one clear line, worlds are enumerated and forked as meant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import petmjx
from petmjx.config import Check, Schedule
from petmjx.errors import InputError
from petmjx.plans.plan import Plan
from petmjx.sweeps.file import load_sweep
from petmjx.sweeps.grid import MAX_WORLDS, SweepPlan
from petmjx.world.variants import Shape, Variant

SWEEPS = Path(__file__).parents[2] / "sweeps"
READY_MADE = sorted(path.name for path in SWEEPS.glob("*.toml"))


def make_plan(plan_id: str = "plan", n_boxes: int = 4) -> Plan:
    return Plan(
        plan_id=plan_id,
        source="test",
        size_mm=np.tile([[400.0, 300.0, 200.0]], (n_boxes, 1)),
        corner_mm=np.array([[0.0, 0.0, 200.0 * k] for k in range(n_boxes)]),
        mass_kg=np.ones(n_boxes),
        item_ids=("",) * n_boxes,
        articles=("",) * n_boxes,
        sequence=np.arange(n_boxes),
    )


def write(folder: Path, text: str, plans: str = 'plans = "samples"\n') -> Path:
    path = folder / "x.toml"
    path.write_text(plans + text, encoding="utf-8")
    return path


def sweep_plan(folder: Path, text: str, *plans: Plan, allow_large: bool = False) -> SweepPlan:
    return SweepPlan(load_sweep(write(folder, text)), plans or (make_plan(),), allow_large)


def variants(plan: SweepPlan) -> list[Variant]:
    """The variants of the first plan."""
    return [variant for _, members in plan.placements() for variant in members]


WORLDS = {
    "en-12195-1.toml": (8, 1),
    "eumos-search.toml": (48, 1),
    "eumos.toml": (64, 1),
    "friction.toml": (13, 13),
    "placement-and-transport.toml": (400, 400),
    "placement-error.toml": (384, 384),
    "radial-force.toml": (1, 1),
    "tilt.toml": (4, 1),
}


@pytest.mark.parametrize("name", READY_MADE)
def test_ready_made_sweeps_load_and_make_the_worlds_they_promise(name: str) -> None:
    sweep = load_sweep(SWEEPS / name)
    assert sweep.name == Path(name).stem
    assert sweep.description
    plan = SweepPlan(sweep, [make_plan("a"), make_plan("b", 9)])
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
    assert f"{worlds:,} variant" in plan.size(60.0)
    readme = (SWEEPS.parent / "docs" / "sweeps.md").read_text(encoding="utf-8")
    line = next(line for line in readme.splitlines() if f"`{name}`" in line)
    assert str(worlds) in line
    assert sweep.resolved()["simulation"]["interval_s"] > 0


def test_every_sweep_of_the_list_is_there() -> None:
    assert sorted(WORLDS) == READY_MADE


BAD = {
    "unknown axis": ("[axes]\nspeed = [1]", "axes.speed: unknown field; there are profile, direction"),
    "empty axis": ("[axes]\nmass_factor = []", "axes.mass_factor is empty"),
    "no axes": ("seed = 1", "axes is empty: nothing is varied"),
    "negative scale": ("[axes]\nprofile = 'radial'\nscale = -1", "axes.scale must be > 0, got -1"),
    "negative scale in a list": ("[axes]\nprofile = 'radial'\nscale = [1, -1]", "axes.scale[1] must be > 0, got -1"),
    "zero level": ("[axes]\nprofile = 'eumos-40509'\nlevel = 0", "axes.level must be > 0, got 0"),
    "text scale": ("[axes]\nprofile = 'radial'\nscale = ['big']", "axes.scale[0] must be a finite number, got 'big'"),
    "infinite": ("[axes]\nmass_factor = inf", "axes.mass_factor must be a finite number, got inf"),
    "negative sd": ("[axes]\nplacement_error_mm = -2", "axes.placement_error_mm must be ≥ 0, got -2"),
    "twice": ("[axes]\nmass_factor = [1.0, 1]", "axes.mass_factor holds 1 twice"),
    "bad direction": ("[axes]\nprofile = 'radial'\ndirection = 'up'", "axes.direction must be degrees or one of +x"),
    "scale with tilt": ("[axes]\nprofile = 'tilt'\nscale = [1, 2]", "axes.scale contradicts profile 'tilt'"),
    "level with tilt": (
        "[axes]\nprofile = ['eumos-40509', 'tilt']\nlevel = 1",
        "axes.level contradicts profile 'tilt'",
    ),
    "level with force": ("[axes]\nprofile = 'radial'\nlevel = 1", "axes.level contradicts profile 'radial'"),
    "scale with eumos": ("[axes]\nprofile = 'eumos-40509'\nscale = 1", "axes.scale contradicts profile 'eumos-40509'"),
    "scale and level": (
        "[axes]\nprofile = 'eumos-40509'\nscale = 1\nlevel = 1",
        "axes.scale contradicts axes.level",
    ),
    "direction without profile": ("[axes]\ndirection = ['+x']", "axes.direction needs axes.profile"),
    "unknown profile": ("[axes]\nprofile = 'ctu-sea'", "axes.profile: unknown profile 'ctu-sea'; there are"),
    "profile twice": (
        "[axes]\nprofile = ['en-12195-1', 'en-12195-1-left']",
        "axes.profile holds 'en-12195-1-left' twice",
    ),
    "random without psd": (
        "[axes]\nprofile = 'truck'\n[profiles.truck]\nkind = 'random'",
        "profiles.truck.psd is missing: random vibration needs a PSD table",
    ),
    "random by name": ("[axes]\nprofile = 'random'", "axes.profile: 'random' needs a PSD table"),
    "psd file missing": (
        "[axes]\nprofile = 'truck'\n[profiles.truck]\nkind = 'random'\npsd = 'gone.csv'",
        "cannot be read as a PSD table",
    ),
    "psd falling": (
        "[axes]\nprofile = 'truck'\n[profiles.truck]\nkind = 'random'\npsd = [[2, 1], [1, 1]]",
        "profiles.truck.psd must have frequencies that rise, got 1 Hz after 2 Hz in row 1",
    ),
    "psd too low": (
        "[axes]\nprofile = 't'\n[profiles.t]\nkind = 'random'\npsd = [[0.01, 1], [1, 1]]",
        "profiles.t.duration_s must be at least 50",
    ),
    "profile field": ("[axes]\nprofile = 't'\n[profiles.t]\nkind = 'tilt'\nmax = 3", "profiles.t.max: unknown field"),
    "profile kind": ("[axes]\nprofile = 't'\n[profiles.t]\nkind = 'push'", "profiles.t.kind must be one of windows"),
    "profile name": ("[profiles.tilt]\nkind = 'tilt'\n[axes]\nprofile='tilt'", "profiles.tilt: the name of a built-in"),
    "chain of accelerations": (
        "[axes]\nprofile = 't'\n[profiles.t]\nkind = 'chain'\nof = [{profile = 'tilt'}]",
        "profiles.t.of[0].profile: only force profiles can be chained",
    ),
    "level and search": (
        "[axes]\nprofile = 'eumos-40509'\nlevel = [1]\n[search]",
        "axes.level contradicts [search]",
    ),
    "search without profile": ("[axes]\nmass_factor = 1\n[search]", "[search] needs axes.profile"),
    "search with tilt": ("[axes]\nprofile = 'tilt'\n[search]", "[search] cannot be used with profile 'tilt'"),
    "search of two kinds": (
        "[axes]\nprofile = ['radial', 'eumos-40509']\n[search]",
        "[search] needs profiles of one kind",
    ),
    "search bounds": (
        "[axes]\nprofile = 'radial'\n[search]\nlower = 1\nupper = 0.5",
        "search.upper must be > lower = 1, got 0.5",
    ),
    "search tolerance": (
        "[axes]\nprofile = 'radial'\n[search]\ntolerance = 0",
        "search.tolerance must be > 0, got 0",
    ),
    "search in samples": (
        "mode = 'sample'\nsample = 3\n[axes]\nprofile = 'radial'\n[search]",
        '[search] contradicts mode = "sample"',
    ),
    "friction twice": ("[axes]\nfriction_factor = 1\nbox_friction_factor = 1", "axes.friction_factor contradicts"),
    "error twice": ("[axes]\nplacement_error_mm = 1\nplacement_error_x_mm = 1", "axes.placement_error_mm contradicts"),
    "replicates of nothing": ("replicates = 5\n[axes]\nmass_factor = 1", "replicates = 5 needs something random"),
    "range without step": ("[axes]\nmass_factor = {from = 1, to = 2}", "axes.mass_factor needs step or count"),
    "range backwards": ("[axes]\nmass_factor = {from = 2, to = 1, step = 1}", "axes.mass_factor.to must be > from = 2"),
    "range step": ("[axes]\nmass_factor = {from = 1, to = 2, step = 0}", "axes.mass_factor.step must be > 0, got 0"),
    "range too fine": (
        "[axes]\nmass_factor = {from = 1, to = 2, step = 1e-9}",
        "axes.mass_factor.step 1e-09 makes more than 100,000 values",
    ),
    "range of errors": (
        "[axes]\nyaw_error_deg = {from = 1, to = 2, step = 1}",
        "axes.yaw_error_deg.distribution is missing: it must be one of normal, uniform, fixed",
    ),
    "distribution": ("[axes]\nyaw_error_deg = {distribution = 'beta'}", "axes.yaw_error_deg.distribution must be one"),
    "distribution field": (
        "[axes]\nyaw_error_deg = {distribution = 'normal', sigma = 1}",
        "axes.yaw_error_deg.sigma: unknown field; there are distribution, mean, sd",
    ),
    "distribution missing": (
        "[axes]\nyaw_error_deg = {distribution = 'uniform', low = 1}",
        "yaw_error_deg.high is missing",
    ),
    "unknown table": ("[simulations]\ninterval_s = 1\n[axes]\nmass_factor = 1", "simulations: unknown field"),
    "unknown option": ("[simulation]\nspeed = 1\n[axes]\nmass_factor = 1", "simulation.speed: unknown field"),
    "bad interval": (
        "[simulation]\ninterval_s = -1\n[axes]\nmass_factor = 1",
        "simulation.interval_s must be > 0, got -1",
    ),
    "bad check": ("[simulation]\ncheck = 'shake'\n[axes]\nmass_factor = 1", "simulation.check must be 'one-by-one' or"),
    "bad physics": (
        "[simulation]\nphysics = 'moon'\n[axes]\nmass_factor = 1",
        "simulation.physics must be pallet or",
    ),
    "bad seed": ("seed = 'a'\n[axes]\nmass_factor = 1", "seed must be a whole number, got 'a'"),
    "total time": (
        "[simulation]\ntotal_time_factor = 2\n[axes]\nprofile = 'radial'",
        "simulation.total_time_factor needs check one-by-one and schedule fixed",
    ),
    "sample without number": ("mode = 'sample'\n[axes]\nmass_factor = 1", "sample is missing"),
    "number without sample": ("sample = 3\n[axes]\nmass_factor = 1", 'sample contradicts mode = "grid"'),
    "syntax": ("[axes]\nmass_factor = = 1", "not valid TOML: Invalid value (at line 3, column 15)"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_sweep_files_get_one_line_that_names_file_and_field(tmp_path: Path, case: str) -> None:
    text, message = BAD[case]
    path = write(tmp_path, text)
    with pytest.raises(InputError) as caught:
        load_sweep(path)
    said = str(caught.value)
    assert said.startswith(f"{path}: ")
    assert message in said
    assert "\n" not in said


def test_missing_plans_are_named(tmp_path: Path) -> None:
    body = "[axes]\nmass_factor = 1"
    for plans, message in (
        ("", "plans is missing: name plan files"),
        ("plans = []\n", "plans is empty"),
        ("plans = 'gone.json'\n", "plans: no such file or folder"),
        ("plans = ['x.toml', 'gone.json']\n", "gone.json"),
        ("plans = 3\n", "plans"),
    ):
        path = write(tmp_path, body, plans)
        with pytest.raises(InputError, match=message) as caught:
            load_sweep(path)
        assert "\n" not in str(caught.value)
    assert load_sweep(write(tmp_path, body, ""), plans_given=True).plans is None
    assert load_sweep(write(tmp_path, body, "plans = 'x.toml'\n")).plans == (tmp_path / "x.toml",)
    with pytest.raises(InputError, match=r"gone\.toml: no such file"):
        load_sweep(tmp_path / "gone.toml")
    with pytest.raises(InputError, match="no usable plan"):
        SweepPlan(load_sweep(write(tmp_path, body)), [])


def test_binary_and_folder_are_refused(tmp_path: Path) -> None:
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not UTF-8"):
        load_sweep(tmp_path / "b.toml")
    with pytest.raises(InputError, match="cannot be read"):
        load_sweep(tmp_path)


def test_more_than_a_million_worlds_need_a_yes(tmp_path: Path) -> None:
    text = "replicates = 1000\n[axes]\nplacement_error_mm = {distribution = 'normal', sd = 1}\n" + (
        "profile = 'radial'\nscale = {from = 1, to = 2, count = 1001}"
    )
    with pytest.raises(InputError, match=r"make 1,001,000 worlds .* more than 1,000,000: pass --yes"):
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
    # 2 masses without an error once each, 2 with one thrice each, and the nominal world.
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
        make_plan("a"),
        make_plan("b"),
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
    assert (last.x_mm.shape, last.x_mm.spread, last.y_mm.zero) == (Shape.NORMAL, 2.0, True)
    assert (last.yaw_deg.shape, last.yaw_deg.centre, last.yaw_deg.spread) == (Shape.UNIFORM, 1.0, 2.0)
    assert (last.drop_height_mm.shape, last.drop_height_mm.centre) == (Shape.FIXED, 3.0)


def test_a_search_numbers_its_worlds_by_what_they_test(tmp_path: Path) -> None:
    plan = sweep_plan(
        tmp_path,
        "[axes]\nmass_factor = [1.0, 1.2]\nprofile = 'eumos-40509'\ndirection = ['+x', '-x']\n"
        "[search]\nupper = 1.0\ntolerance = 0.01",
    )
    groups = list(plan.groups())
    assert len(groups) == 2
    assert plan.search_levels.tolist() == [round(0.01 * k, 2) for k in range(101)]
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


def test_radial_force_ends_where_the_reference_ends() -> None:
    sweep = load_sweep(SWEEPS / "radial-force.toml")
    plan = SweepPlan(sweep, [make_plan("long", 40), make_plan("short", 26)])
    sim = sweep.simulation
    assert (sim.check, sim.schedule, sim.early_stop) == (Check.ONE_BY_ONE, Schedule.FIXED, False)
    (variant,) = variants(plan)
    dt = sim.physics.timestep_s
    # Reference: 25,000 steps for 40 boxes, 16,250 for 26, where the chain is cut.
    for each, total, nominal in zip(plan.plans, (25_000, 16_250), (11_000, 7_500), strict=True):
        drive = plan.drive(each, variant)
        assert drive is not None
        assert nominal + len(drive.excitation.samples) + int(drive.rest_s / dt) == total
        # The chain's own first offset: 2 s.
        assert np.flatnonzero(drive.excitation.samples.any(axis=1))[0] == 1000


TOO_SHORT_FOR_ONE_BOX = (
    "[simulation]\nschedule = 'fixed'\ninterval_s = 0.5\nsettle_s = 0.1\ntotal_time_factor = 1.2\n"
    "[axes]\nprofile = 'radial'"
)


def test_plans_whose_run_ends_before_their_profile_are_skipped(tmp_path: Path) -> None:
    one, four = make_plan("one", 1), make_plan("four", 4)
    results = petmjx.sweep(write(tmp_path, TOO_SHORT_FOR_ONE_BOX), [one, four], engine="mujoco")
    assert results.worlds["plan_id"].tolist() == ["four"]
    (skipped,) = results.info["skipped"]
    assert skipped["plan_id"] == "one"
    assert "plan one: the run ends before its profile begins, at 1.2 times the placement time" in skipped["error"]
    for plans, strict in (([one], False), ([four, one], True)):
        with pytest.raises(InputError, match="plan one: the run ends before"):
            petmjx.sweep(write(tmp_path, TOO_SHORT_FOR_ONE_BOX), plans, engine="mujoco", strict=strict)


def test_what_a_timestep_cannot_show_is_refused_before_the_run(tmp_path: Path) -> None:
    text = "[axes]\nprofile = 'fast'\n[profiles.fast]\nkind = 'random'\npsd = [[1, 0.1], [300, 0.1]]"
    with pytest.raises(InputError, match=r"x\.toml: profile fast: PSD reaches 300 Hz, .* less than 250 Hz"):
        sweep_plan(tmp_path, text)
    sweep = load_sweep(write(tmp_path, text), simulation={"physics": {"timestep_s": 0.001}})
    assert SweepPlan(sweep, [make_plan()]).n_worlds == 1


def test_estimates_count_placements_once(tmp_path: Path) -> None:
    text = "[axes]\nprofile = 'eumos-40509'\nlevel = {{from = 0.01, to = 0.64, count = {count}}}"
    one, many = (sweep_plan(tmp_path, text.format(count=count)) for count in (2, 64))
    # 0.4 s of profile and 1 s of rest
    assert many.work().steps - one.work().steps == pytest.approx([62 * (200 + 500)])
    said = many.size(100.0)
    assert said.startswith("64 worlds (1 plan × 64 variants) from 1 placement, about ")
    assert said.endswith(" steps, about 2 min")


HOSTILE = {
    "whole number of many digits": ("seed = " + "9" * 5000, "not valid TOML: Exceeds the limit"),
    "the same in hexadecimals": ("seed = 0x" + "f" * 5000, "seed must be < 9.22337e+18, got int too large to be shown"),
    "a number of 400 digits": ("[axes]\nscale = " + "9" * 400, "axes.scale must be a finite number, got 999"),
    "lists in lists": ("a = " + "[" * 5000 + "]" * 5000, "lists or tables in too many levels"),
    "tables in tables": ("[axes]\nscale." + ".".join("a" * 3000) + " = 1", "a key of more than 64 parts"),
    "not a number": ("[axes]\nscale = nan", "axes.scale must be a finite number, got nan"),
    "infinite bound": (
        "[axes]\nprofile = 'radial'\n[search]\nupper = inf",
        "search.upper must be a finite number, got inf",
    ),
    "long list": (f"[axes]\nmass_factor = {[1 + k / 1e6 for k in range(100_001)]}", "has 100,001 values, more than"),
    "no mass": ("[axes]\nmass_factor = [1.0, 1e-18]", "axes.mass_factor must be ≥ 0.001, got 1e-18"),
    "true for a number": ("[axes]\nmass_factor = true", "axes.mass_factor must be a finite number, got True"),
    "text for a truth": ("nominal = 'yes'", "nominal must be true or false, got 'yes'"),
    "line break in a name": ('[axes]\n"a\\nb" = 1', "axes.a\\nb: unknown field"),
    "long name": (f"{'a' * 1000} = 1", "aaaa…: unknown field"),
    "file name with a zero": (
        "[profiles.t]\nkind = 'random'\npsd = \"a\\u0000\"\n[axes]\nprofile = 't'",
        "cannot be read as a PSD table: embedded null byte",
    ),
    "endless profile": (
        "[profiles.t]\nkind = 'windows'\nwindows = [[1e300, 1, 1, 0, 0]]\n[axes]\nprofile = 't'",
        "profiles.t.windows[0].start_s must be from 0 to 3600, got 1e+300",
    ),
    "chains that double": (
        "[profiles.p0]\nkind = 'windows'\nwindows = [[0, 1, 1, 0, 0]]\n"
        + "".join(
            f"[profiles.p{k}]\nkind = 'chain'\nof = [{{profile = 'p{k - 1}'}}, {{profile = 'p{k - 1}'}}]\n"
            for k in range(1, 60)
        )
        + "[axes]\nprofile = 'p59'",
        "profiles.p17.of has more than 100,000 windows",
    ),
    "axes that are no table": ("axes = 3", "axes must be a table, got 3"),
    "profiles that are no tables": ("[profiles]\nt = 3", "profiles.t must be a table, got 3"),
    "no kind": ("[profiles.t]\nmax_deg = 3", "profiles.t.kind is missing: it must be one of windows, chain"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_sweep_files_get_one_short_line(tmp_path: Path, case: str) -> None:
    text, message = HOSTILE[case]
    path = write(tmp_path, text)
    with pytest.raises(InputError) as caught:
        load_sweep(path)
    said = str(caught.value)
    assert said.startswith(f"{path}: ")
    assert message in said
    assert said.isprintable()
    assert len(said) - len(str(path)) < 400
