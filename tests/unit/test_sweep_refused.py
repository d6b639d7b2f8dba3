"""Sweep files that are refused: one line names file and field, and says what the field should be."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.command_line import write

from petmjx.common.errors import InputError
from petmjx.runs.sweep_file import load_sweep
from petmjx.runs.sweep_worlds import SweepPlan

# Lines below [axes] → a part of the error message.
AXES = {
    "unknown axis": ("speed = [1]", "axes.speed: unknown field; there are profile, direction"),
    "empty axis": ("mass_factor = []", "axes.mass_factor is empty"),
    "negative scale": ("profile = 'radial'\nscale = -1", "axes.scale must be > 0, got -1"),
    "negative scale in a list": ("profile = 'radial'\nscale = [1, -1]", "axes.scale[1] must be > 0, got -1"),
    "zero level": ("profile = 'eumos-40509'\nlevel = 0", "axes.level must be > 0, got 0"),
    "text scale": ("profile = 'radial'\nscale = ['big']", "axes.scale[0] must be a finite number, got 'big'"),
    "infinite": ("mass_factor = inf", "axes.mass_factor must be a finite number, got inf"),
    "negative sd": ("placement_error_mm = -2", "axes.placement_error_mm must be ≥ 0, got -2"),
    "twice": ("mass_factor = [1.0, 1]", "axes.mass_factor holds 1 twice"),
    "bad direction": ("profile = 'radial'\ndirection = 'up'", "axes.direction must be degrees or one of +x"),
    "scale with tilt": ("profile = 'tilt'\nscale = [1, 2]", "axes.scale contradicts profile 'tilt'"),
    "level with tilt": ("profile = ['eumos-40509', 'tilt']\nlevel = 1", "axes.level contradicts profile 'tilt'"),
    "level with force": ("profile = 'radial'\nlevel = 1", "axes.level contradicts profile 'radial'"),
    "scale with eumos": ("profile = 'eumos-40509'\nscale = 1", "axes.scale contradicts profile 'eumos-40509'"),
    "scale and level": ("profile = 'eumos-40509'\nscale = 1\nlevel = 1", "axes.scale contradicts axes.level"),
    "direction without profile": ("direction = ['+x']", "axes.direction needs axes.profile"),
    "unknown profile": ("profile = 'ctu-sea'", "axes.profile: unknown profile 'ctu-sea'; there are"),
    "profile twice": ("profile = ['en-12195-1', 'en-12195-1-left']", "axes.profile holds 'en-12195-1-left' twice"),
    "random by name": ("profile = 'random'", "axes.profile: 'random' needs a PSD table"),
    "friction twice": ("friction_factor = 1\nbox_friction_factor = 1", "axes.friction_factor contradicts"),
    "error twice": ("placement_error_mm = 1\nplacement_error_x_mm = 1", "axes.placement_error_mm contradicts"),
    "range without step": ("mass_factor = {from = 1, to = 2}", "axes.mass_factor needs 'step' or 'count'"),
    "range backwards": ("mass_factor = {from = 2, to = 1, step = 1}", "axes.mass_factor.to must be > from = 2"),
    "range step": ("mass_factor = {from = 1, to = 2, step = 0}", "axes.mass_factor.step must be > 0, got 0"),
    "range too fine": (
        "mass_factor = {from = 1, to = 2, step = 1e-9}",
        "axes.mass_factor.step 1e-09 makes more than 100,000 values",
    ),
    "range of errors": (
        "yaw_error_deg = {from = 1, to = 2, step = 1}",
        "axes.yaw_error_deg.distribution is missing: it must be one of normal, uniform, fixed",
    ),
    "distribution": ("yaw_error_deg = {distribution = 'beta'}", "axes.yaw_error_deg.distribution must be one"),
    "distribution field": (
        "yaw_error_deg = {distribution = 'normal', sigma = 1}",
        "axes.yaw_error_deg.sigma: unknown field; there are distribution, mean, sd",
    ),
    "distribution missing": ("yaw_error_deg = {distribution = 'uniform', low = 1}", "yaw_error_deg.high is missing"),
    "syntax": ("mass_factor = = 1", "not valid TOML: Invalid value (at line 3, column 15)"),
    "not a number": ("scale = nan", "axes.scale must be a finite number, got nan"),
    "no mass": ("mass_factor = [1.0, 1e-18]", "axes.mass_factor must be ≥ 0.001, got 1e-18"),
    "true for a number": ("mass_factor = true", "axes.mass_factor must be a finite number, got True"),
    "line break in a name": ('"a\\nb" = 1', "axes.a\\nb: unknown field"),
}

# Contents of a sweep file → a part of the error message.
FILES = {
    "no axes": ("seed = 1", "axes is empty: nothing is varied"),
    "random without psd": (
        "[axes]\nprofile = 'truck'\n[profiles.truck]\nkind = 'random'",
        "profiles.truck.psd is missing: PSD table of the vibration",
    ),
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
    "profile name": ("[profiles.tilt]\nkind = 'tilt'\n[axes]\nprofile='tilt'", "profiles.tilt: is the name of"),
    "chain of accelerations": (
        "[axes]\nprofile = 't'\n[profiles.t]\nkind = 'chain'\nof = [{profile = 'tilt'}]",
        "profiles.t.of[0].profile: only force profiles can be chained",
    ),
    "level and search": ("[axes]\nprofile = 'eumos-40509'\nlevel = [1]\n[search]", "axes.level contradicts [search]"),
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
        "search.tolerance must be ≥ 1e-05, got 0",
    ),
    "search in samples": (
        "mode = 'sample'\nsample = 3\n[axes]\nprofile = 'radial'\n[search]",
        '[search] contradicts mode = "sample"',
    ),
    "replicates of nothing": ("replicates = 5\n[axes]\nmass_factor = 1", "replicates = 5 needs a random axis"),
    "unknown table": ("[simulations]\ninterval_s = 1\n[axes]\nmass_factor = 1", "simulations: unknown field"),
    "unknown option": ("[simulation]\nspeed = 1\n[axes]\nmass_factor = 1", "simulation.speed: unknown field"),
    "bad interval": (
        "[simulation]\ninterval_s = -1\n[axes]\nmass_factor = 1",
        "simulation.interval_s must be > 0, got -1",
    ),
    "bad check": ("[simulation]\ncheck = 'shake'\n[axes]\nmass_factor = 1", "simulation.check must be 'one-by-one' or"),
    "bad physics": ("[simulation]\nphysics = 'moon'\n[axes]\nmass_factor = 1", "simulation.physics must be pallet or"),
    "bad seed": ("seed = 'a'\n[axes]\nmass_factor = 1", "seed must be a whole number, got 'a'"),
    "total time": (
        "[simulation]\ntotal_time_factor = 2\n[axes]\nprofile = 'radial'",
        "simulation.total_time_factor needs check='one-by-one' and schedule='fixed'",
    ),
    "sample without number": ("mode = 'sample'\n[axes]\nmass_factor = 1", "sample is missing"),
    "number without sample": ("sample = 3\n[axes]\nmass_factor = 1", 'sample contradicts mode = "grid"'),
    "whole number of many digits": ("seed = " + "9" * 5000, "not valid TOML: Exceeds the limit"),
    "the same in hexadecimals": ("seed = 0x" + "f" * 5000, "seed must be < 9.22337e+18, got int too large to be shown"),
    "a number of 400 digits": ("[axes]\nscale = " + "9" * 400, "axes.scale must be a finite number, got 999"),
    "lists in lists": ("a = " + "[" * 5000 + "]" * 5000, "lists or tables are nested too deeply"),
    "tables in tables": ("[axes]\nscale." + ".".join("a" * 3000) + " = 1", "a key has more than 64 parts"),
    "infinite bound": (
        "[axes]\nprofile = 'radial'\n[search]\nupper = inf",
        "search.upper must be a finite number, got inf",
    ),
    "long list": (f"[axes]\nmass_factor = {[1 + k / 1e6 for k in range(100_001)]}", "has 100,001 values, more than"),
    "text for a truth": ("nominal = 'yes'", "nominal must be true or false, got 'yes'"),
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
        "profiles.p17.of must have at most 100,000 windows",
    ),
    "axes that are no table": ("axes = 3", "axes must be a table, got 3"),
    "profiles that are no tables": ("[profiles]\nt = 3", "profiles.t must be a table, got 3"),
    "no kind": ("[profiles.t]\nmax_deg = 3", "profiles.t.kind is missing: it must be one of windows, chain"),
}

REFUSED = FILES | {case: (f"[axes]\n{text}", message) for case, (text, message) in AXES.items()}


def sweep_file(folder: Path, text: str, plans: str = 'plans = "samples"') -> Path:
    return write(folder / "x.toml", f"{plans}\n{text}")


def test_no_case_is_written_twice() -> None:
    assert len(REFUSED) == len(FILES) + len(AXES)


@pytest.mark.parametrize("case", REFUSED)
def test_bad_sweep_files_get_one_short_line_that_names_file_and_field(tmp_path: Path, case: str) -> None:
    text, message = REFUSED[case]
    path = sweep_file(tmp_path, text)
    with pytest.raises(InputError) as caught:
        load_sweep(path)
    error_line = str(caught.value)
    assert error_line.startswith(f"{path}: ")
    assert message in error_line
    assert error_line.isprintable()
    fault, *_ = error_line.removeprefix(str(path)).partition("; there are ")  # the list grows with each new name
    assert len(fault) < 200


def test_missing_plans_are_named(tmp_path: Path) -> None:
    body = "[axes]\nmass_factor = 1"
    for plans, message in (
        ("", "plans is missing: name plan files"),
        ("plans = []", "plans is empty"),
        ("plans = 'gone.json'", "plans: no such file or folder"),
        ("plans = ['x.toml', 'gone.json']", "gone.json"),
        ("plans = 3", "plans"),
    ):
        path = sweep_file(tmp_path, body, plans)
        with pytest.raises(InputError, match=message) as caught:
            load_sweep(path)
        assert "\n" not in str(caught.value)
    assert load_sweep(sweep_file(tmp_path, body, ""), plans_given=True).plans is None
    assert load_sweep(sweep_file(tmp_path, body, "plans = 'x.toml'")).plans == (tmp_path / "x.toml",)
    with pytest.raises(InputError, match=r"gone\.toml: no such file"):
        load_sweep(tmp_path / "gone.toml")
    with pytest.raises(InputError, match="no usable plan"):
        SweepPlan(load_sweep(sweep_file(tmp_path, body)), [])


def test_binary_and_folder_are_refused(tmp_path: Path) -> None:
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not UTF-8"):
        load_sweep(tmp_path / "b.toml")
    with pytest.raises(InputError, match="cannot be read"):
        load_sweep(tmp_path)
