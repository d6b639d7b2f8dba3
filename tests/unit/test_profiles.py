"""Profiles that shake the pallet: windows that are exact to the step, exact integrals, the RMS that a PSD prescribes,
and reproducible phases."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from support.plans import make_plan

from petmjx.common.errors import InputError
from petmjx.common.units import STANDARD_GRAVITY
from petmjx.runs.sweep_file import load_sweep
from petmjx.runs.sweep_worlds import SweepPlan
from petmjx.world.profiles.accelerations import Tilt
from petmjx.world.profiles.force_windows import JOLTS, RADIAL, RADIAL_CHAIN, SINE, Window, WindowProfile, chain
from petmjx.world.profiles.measured_profiles import read_psd, read_windows
from petmjx.world.profiles.profile import Profile, Strength
from petmjx.world.profiles.profile_registry import BUILT_IN, FAMILIES, resolve
from petmjx.world.profiles.profiles_of_sweep_files import define_profiles
from petmjx.world.profiles.random_vibration import RandomVibration, psd_integral, psd_rms_g
from petmjx.world.random_streams import WorldKey

DT = 0.002
FIRST_DRAWS = [0.08556518956524295, 0.26279225484417856, 0.4202946722471652]
"""The values of WorldKey(7, "00100408", 3).rng("x").random(3)."""

ROUNDING = 1e-12
"""Rounding error of sums of some thousand float64 terms of size 1."""

PSD = ((1.0, 1e-4), (4.0, 1e-2), (16.0, 1e-2), (40.0, 1e-3), (200.0, 1e-5))


def samples(profile: Profile, start_s: float = 0.0) -> np.ndarray:
    return profile.excitation(DT, start_s).samples


def defined(table: dict[str, object], folder: Path = Path()) -> Profile:
    return define_profiles({"own": table}, folder)["own"]


def test_radial_is_ten_windows_of_fifteen_or_so_steps_with_the_table_s_vectors() -> None:
    rows = samples(RADIAL)
    acting = np.flatnonzero(rows.any(axis=1))
    # int(0.33/dt) − int(0.3/dt) is 15 or 16 steps, depending on truncation. The ten windows do not touch each other.
    starts = acting[np.flatnonzero(np.diff(acting, prepend=-10) > 1)]
    assert starts.tolist() == [int(t / DT) for t in (0.0, 0.3, 0.6, 0.9, 1.2, 1.5, 1.8, 2.1, 3.1, 3.4)]
    expected = [int((t + 0.03) / DT) - int(t / DT) for t in (0.0, 0.3, 0.6, 0.9, 1.2, 1.5, 1.8, 2.1, 3.1, 3.4)]
    assert len(acting) == sum(expected)
    assert rows[0].tolist() == [math.sqrt(2), 0.0, 0.1]
    assert rows[int(3.4 / DT)].tolist() == [0.0, 1.0, 1.0]
    assert len(rows) == RADIAL.n_steps(DT) == int((3.4 + 0.03) / DT)


def test_jolts_add_up_where_they_overlap() -> None:
    rows = samples(JOLTS)
    both = rows[int(1.1 / DT) : int(1.15 / DT)]
    np.testing.assert_allclose(both, np.tile([0.5, 0.0, 0.0], (25, 1)), atol=ROUNDING)
    np.testing.assert_allclose(rows[int(1.1 / DT) - 1], [0.9, 0.1, 0.0])
    np.testing.assert_allclose(rows[int(1.2 / DT)], [-0.4, -0.1, 0.0])
    assert rows[:, 2].max() == 10.0


def test_sine_has_99_windows_and_follows_the_sine() -> None:
    assert len(SINE.windows) == 99
    rows = samples(SINE)
    assert not rows[: int(0.1 / DT)].any()
    np.testing.assert_allclose(rows[int(5.0 / DT) + 3], [math.sin(5.0), 0.0, math.sin(15.0)])


def test_windows_are_rounded_in_absolute_time() -> None:
    profile = WindowProfile("one", (Window(0.3, 0.03, (1.0, 0.0, 0.0)),), "test")
    for start_s in (0.0, 0.001, 20.041, 22.0, 7.123):
        rows = samples(profile, start_s)
        begin = int((start_s + 0.3) / DT) - int(start_s / DT)
        end = int(((start_s + 0.3) + 0.03) / DT) - int(start_s / DT)
        assert np.flatnonzero(rows.any(axis=1)).tolist() == list(range(begin, end)), start_s


def test_demo_chain_is_seven_scaled_radials() -> None:
    rows = samples(RADIAL_CHAIN, 22.0)
    assert len(RADIAL_CHAIN.windows) == 70
    for link, factor in enumerate((1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 2.0)):
        vectors = np.array([window.vector for window in RADIAL_CHAIN.windows[10 * link : 10 * link + 10]])
        np.testing.assert_array_equal(vectors, factor * np.array([window.vector for window in RADIAL.windows]))
    assert not rows[: int(24.0 / DT) - 11000].any()
    assert rows[int(24.0 / DT) - 11000, 0] == math.sqrt(2)
    assert rows[int(39.0 / DT) - 11000, 0] == pytest.approx(2 * math.sqrt(2))
    # At 10.1 s after the beginning of the chain, its third and fourth radial would push together. In the reference
    # implementation, only one of them pushes.
    at = int((22.0 + 10.1) / DT) - 11000 + 5
    assert rows[at].tolist() in ([1.2, 0.0, 1.2], [0.0, 1.3 * math.sqrt(2), 0.1 * 1.3])


def test_windows_that_replace_each_other_act_one_at_a_time() -> None:
    def push(start_s: float, x: float) -> Window:
        return Window(start_s, 0.02, (x, 0.0, 0.0))

    # Two windows that act together, then a window that begins while another one acts: its force ends at the first end
    # of a window after its beginning.
    windows = (push(0.01, 1.0), push(0.01, 2.0), push(0.1, 4.0), push(0.11, 8.0))
    added = samples(WindowProfile("add", windows, "test"))[:, 0]
    replaced = samples(WindowProfile("replace", windows, "test", replaces=True))[:, 0]
    assert added[5:15].tolist() == [3.0] * 10
    assert replaced[5:15].tolist() == [2.0] * 10
    assert added[50:65].tolist() == [4.0] * 5 + [12.0] * 5 + [8.0] * 5
    assert replaced[50:65].tolist() == [4.0] * 5 + [8.0] * 5 + [0.0] * 5
    assert np.count_nonzero(replaced) == 20


def test_windows_that_follow_one_another_do_not_replace_each_other() -> None:
    # five of the 98 following windows begin one step before the window before them ends, since times become whole steps
    added, replaced = samples(SINE), samples(replace(SINE, replaces=True))
    assert np.array_equal(added.any(axis=1), replaced.any(axis=1))
    assert np.count_nonzero((added != replaced).any(axis=1)) == 5


@pytest.mark.parametrize("steps", [0, 1, 2])
def test_short_windows_act_alone_as_with_others(steps: int) -> None:
    short, long = Window(0.02, steps * DT, (1.0, 0.0, 0.0)), Window(0.1, 0.02, (2.0, 0.0, 0.0))
    for windows in ((short, long), (replace(long, start_s=0.04), replace(short, start_s=0.2))):
        added = samples(WindowProfile("add", windows, "test"))
        assert np.array_equal(samples(WindowProfile("replace", windows, "test", replaces=True)), added)


def test_impulse_of_a_chain_is_the_sum_of_its_links() -> None:
    twice = chain("twice", [(RADIAL, 0.0, 1.0), (RADIAL, 1.0, 0.5), (JOLTS, 0.25, 2.0)], "test")
    # The number of steps of a window differs by at most one between offsets. So the comparison uses a timestep that
    # divides all times.
    dt = 0.01 / 64
    total = twice.excitation(dt).samples.sum(axis=0) * dt
    radial = RADIAL.excitation(dt).samples.sum(axis=0) * dt
    jolts = JOLTS.excitation(dt).samples.sum(axis=0) * dt
    one_step_of_each_window = dt * 30 * 20
    np.testing.assert_allclose(total, 1.5 * radial + 2 * jolts, atol=one_step_of_each_window)


def test_eumos_trapezoid_has_its_integral_and_plateau() -> None:
    (eumos,) = resolve("eumos-40509")
    for dt in (0.002, 0.001, 0.003):
        rows = eumos.excitation(dt).samples
        assert rows.sum(axis=0)[0] * dt == pytest.approx(STANDARD_GRAVITY * 0.35, rel=1e-12)
        assert rows[:, 0].max() == pytest.approx(STANDARD_GRAVITY)
        assert not rows[:, 1:].any()
    rows = samples(eumos)
    assert len(rows) == 200
    assert np.count_nonzero(np.isclose(rows[:, 0], STANDARD_GRAVITY)) == 150
    assert rows[:25, 0].tolist() == pytest.approx([STANDARD_GRAVITY * (i + 0.5) / 25 for i in range(25)])


@pytest.mark.parametrize(
    ("name", "level_g", "direction"),
    [("forward", 0.8, (-1, 0)), ("rearward", 0.5, (1, 0)), ("left", 0.5, (0, -1)), ("right", 0.5, (0, 1))],
)
def test_en_12195_1_levels_and_directions(name: str, level_g: float, direction: tuple[int, int]) -> None:
    (profile,) = resolve(f"en-12195-1-{name}")
    peak = samples(profile)[500]
    np.testing.assert_allclose(peak, STANDARD_GRAVITY * level_g * np.array([*direction, 0.0]), atol=ROUNDING)
    assert profile in resolve("en-12195-1")


def test_tilt_keeps_gravity_s_length_and_tells_its_angle() -> None:
    tilt = Tilt(max_deg=30.0, rate_deg_s=10.0, hold_s=0.5, return_s=1.0)
    gravity = np.array([0.0, 0.0, -STANDARD_GRAVITY]) - samples(tilt)
    np.testing.assert_allclose(np.linalg.norm(gravity, axis=1), STANDARD_GRAVITY, rtol=ROUNDING)
    angle = np.degrees(np.arctan2(-gravity[:, 0], -gravity[:, 2]))
    # The carrier tilts by 10°/s for 3 s, rests for 0.5 s, and returns within 1 s. The angle during a step is the angle
    # at the end of the step.
    expected = {1: 0.02, 700: 14.0, 750: 15.0, 1500: 30.0, 1600: 30.0, 1750: 30.0, 2000: 15.0, len(angle): 0.0}
    for step, angle_deg in expected.items():
        assert angle[step - 1] == pytest.approx(angle_deg, abs=1e-9)


@pytest.mark.parametrize("duration_ms", [6.0, 11.0, 20.0])
def test_half_sine_changes_velocity_by_two_over_pi(duration_ms: float) -> None:
    shock = defined({"kind": "half-sine", "duration_ms": duration_ms, "axis": [0, 0, 2]})
    rows = samples(shock)
    assert rows[:, 2].sum() * DT == pytest.approx(2 / math.pi * STANDARD_GRAVITY * duration_ms / 1000, rel=1e-12)
    assert len(rows) == math.ceil(duration_ms / 2)
    assert shock.strength is Strength.LEVEL


def test_psd_integral_has_its_closed_forms() -> None:
    flat = ((10.0, 0.02), (60.0, 0.02))
    assert psd_rms_g(flat) == pytest.approx(1.0)
    reciprocal = ((1.0, 0.5), (100.0, 0.005))  # a slope of −1, for which the integral is a logarithm
    assert psd_integral(reciprocal, np.array([100.0]))[0] == pytest.approx(0.5 * math.log(100))
    grid = np.geomspace(1, 200, 200_001)
    density = np.exp(np.interp(np.log(grid), np.log([f for f, _ in PSD]), np.log([g for _, g in PSD])))
    numeric = np.trapezoid(density, grid)
    assert psd_integral(PSD, np.array([1e9]))[0] == pytest.approx(numeric, rel=1e-6)


@pytest.mark.parametrize("duration_s", [4.0, 10.0, 10.002])
def test_random_vibration_has_the_psd_s_rms(duration_s: float) -> None:
    vibration = RandomVibration("truck", PSD, duration_s, "xz")
    rows = vibration.excitation(DT, world=WorldKey(3, "plan")).samples / STANDARD_GRAVITY
    rms = np.sqrt((rows**2).mean(axis=0))
    assert rms[0] == pytest.approx(psd_rms_g(PSD), rel=1e-9)
    assert rms[2] == pytest.approx(psd_rms_g(PSD), rel=1e-9)
    assert rms[1] == 0
    # Not only the integral of the spectrum is right: its power is at the frequencies of the PSD.
    power = 2 * np.abs(np.fft.rfft(rows[:, 0]) / len(rows)) ** 2
    frequency = np.fft.rfftfreq(len(rows), DT)
    plateau = (frequency > 4.5) & (frequency < 15.5)
    np.testing.assert_allclose(power[plateau] * len(rows) * DT, 0.01, rtol=1e-6)


def test_random_vibration_depends_on_seed_plan_replicate_and_name_alone() -> None:
    vibration = RandomVibration("truck", PSD, 4.0)
    keys = [WorldKey(seed, plan, replicate) for seed in (0, 1) for plan in ("a", "b") for replicate in (0, 1)]
    forwards = [vibration.excitation(DT, world=key).samples for key in keys]
    backwards = [vibration.excitation(DT, world=key).samples for key in reversed(keys)][::-1]
    for one, other in zip(forwards, backwards, strict=True):
        assert np.array_equal(one, other)
    assert len({rows.tobytes() for rows in forwards}) == len(keys)
    renamed = RandomVibration("ship", PSD, 4.0).excitation(DT, world=keys[0]).samples
    assert not np.array_equal(renamed, forwards[0])


def test_random_numbers_are_the_same_on_every_machine() -> None:
    # These numbers are fixed: a change of the way in which keys give random numbers would change every published sweep.
    drawn = WorldKey(7, "00100408", 3).rng("x").random(3)
    np.testing.assert_array_equal(drawn, WorldKey(7, "00100408", 3).rng("x").random(3))
    assert drawn.tolist() == pytest.approx(FIRST_DRAWS, abs=1e-15)


def test_random_vibration_refuses_what_the_timestep_cannot_show() -> None:
    with pytest.raises(InputError, match="250 Hz"):
        RandomVibration("fast", ((1.0, 0.1), (300.0, 0.1)), 4.0).excitation(DT)


def test_every_built_in_profile_names_its_source() -> None:
    text = (Path(__file__).parents[2] / "docs" / "profiles.md").read_text(encoding="utf-8")
    for name, profile in BUILT_IN.items():
        assert profile.source
        family = next((family for family, members in FAMILIES.items() if name in members), name)
        assert f"| `{family}` |" in text, name
        assert len(profile.excitation(DT).samples) == profile.n_steps(DT)


def test_windows_from_parquet_and_toml_agree(tmp_path: Path) -> None:
    columns = {"start_s": [0.0, 0.5], "duration_s": [0.1, 0.25], "x": [1.0, 0.0], "y": [0.0, -2.0], "z": [0.1, 0.0]}
    pyarrow.parquet.write_table(pyarrow.table(columns), tmp_path / "push.parquet")
    lines = []
    for row in zip(*columns.values(), strict=True):
        lines += ["[[window]]", *(f"{key} = {value}" for key, value in zip(columns, row, strict=True))]
    (tmp_path / "push.toml").write_text("\n".join(lines))
    inline = defined({"kind": "windows", "windows": [[0, 0.1, 1, 0, 0.1], [0.5, 0.25, 0, -2, 0]]})
    for name in ("push.parquet", "push.toml"):
        named = defined({"kind": "windows", "file": name}, tmp_path)
        assert np.array_equal(samples(inline), samples(named))
        assert named.source == f"user's file {name}"
    assert samples(inline)[260].tolist() == [0.0, -2.0, 0.0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[window]]\nstart_s = 1\nduration_s = 1\nx = 1\ny = 0\n", "window[0].z is missing: force along z"),
        ("[[window]]\nstart_s = 1\nduration_s = 0\nx = 1\ny = 0\nz = 0\n", "window[0].duration_s must be > 0, got 0"),
        ("[[window]]\nstart_s = -1\nduration_s = 1\nx = 1\ny = 0\nz = 0\n", "window[0].start_s must be ≥ 0, got -1"),
        (
            "[[window]]\nstart_s = 1\nduration_s = 1\nx = 'a'\ny = 0\nz = 0\n",
            "window[0].x must be a finite number, got 'a'",
        ),
        ("[[window]]\nstart_s = 1\nduration_s = 1\nx = 1\ny = 0\nz = 0\nw = 0\n", "window[0].w: unknown field"),
        ("", "window is missing: one table [[window]] for each push"),
        ("window = []", "window must have at least 1 entry, got 0"),
        ("window = 3", "window must be a list, got 3"),
        ("[[window", "not valid TOML"),
    ],
)
def test_bad_window_files_get_one_clear_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_windows(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_are_no_parquet_or_missing_are_refused(tmp_path: Path) -> None:
    (tmp_path / "no.parquet").write_text("no")
    with pytest.raises(InputError, match="is not Parquet"):
        read_windows(tmp_path / "no.parquet")
    for name in ("gone.parquet", "gone.toml"):
        with pytest.raises(InputError, match="no such file"):
            read_windows(tmp_path / name)


def test_psd_tables_from_csv(tmp_path: Path) -> None:
    path = tmp_path / "psd.csv"
    path.write_text("# truck\nfrequency_hz,g2_per_hz\n1,0.1\n10,0.01\n")
    assert read_psd(path) == ((1.0, 0.1), (10.0, 0.01))
    for text, message in (
        ("1,0.1\n", "row must have at least 2 entries, got 1"),
        ("1,0.1\n1,0.2\n", "row must have frequencies that rise, got 1 Hz after 1 Hz in row 1"),
        ("1,0.1\n2,-1\n", r"row\[1\]\[1\] must be > 0, got -1"),
        ("1,0.1\n2,nan\n", r"row\[1\]\[1\] must be a finite number, got nan"),
        ("1,0.1\n2,x\n", r"row\[1\]\[1\] must be a finite number, got 'x'"),
        ("1,0.1\n2,3,4\n", r"row\[1\] must have at most 2 entries, got 3"),
        ("1,0.1\n2\n", r"row\[1\]\[1\] is missing"),
        ("1,1e-40\n2,1\n", "must have densities of at least 1e-30"),
        ("1,1000000\n1000,1000000\n", "must have an RMS of at most 1000 g"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=message):
            read_psd(path)


def test_tilt_turns_whatever_gravity_there_is(tmp_path: Path) -> None:
    """A load slides at atan μ on the moon, too. An acceleration in m/s² does not depend on gravity."""
    excitations: dict[tuple[str, float], np.ndarray] = {}
    for profile, gravity in ((name, g) for name in ("tilt", "eumos-40509") for g in (9.81, 1.62)):
        file = tmp_path / "sweep.toml"
        level = "level = 0.5\n" if profile != "tilt" else ""
        file.write_text(f"[simulation.physics]\ngravity_m_s2 = {gravity}\n[axes]\nprofile = '{profile}'\n{level}")
        plan = SweepPlan(load_sweep(file, plans_given=True), [make_plan()])
        (group,) = plan.groups()
        drive = plan.drive(group.plan, group.variants[-1])
        assert drive is not None
        excitations[profile, gravity] = drive.excitation.samples
    np.testing.assert_allclose(excitations["tilt", 1.62], excitations["tilt", 9.81] * 1.62 / 9.81)
    np.testing.assert_array_equal(excitations["eumos-40509", 1.62], excitations["eumos-40509", 9.81])
