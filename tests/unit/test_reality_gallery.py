"""The comparison of petmjx with measurements: tosses that petmjx itself simulated are reproduced, and noise and
friction are estimated correctly from the data."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from support.command_line import only_line

from benchmarks import cube_toss_study, cube_tosses, real_friction, reality
from benchmarks.__main__ import main
from benchmarks.cube_tosses import Path3, Start, Tosses, read_tosses

RATE_HZ = 148.0
N, SAMPLES = 8, 90
SIGMA_M_S, SIGMA_RAD_S = 0.02, 0.1
"""Noise of the first velocities of the tosses below, m/s and rad/s."""


def made(friction: float = 0.18) -> Tosses:
    """Tosses simulated by petmjx. The velocities of their first samples have noise."""
    rng = np.random.default_rng(3)
    counts = np.full(N, SAMPLES)
    pos = np.column_stack([rng.uniform(-0.1, 0.1, (N, 2)), rng.uniform(0.16, 0.2, N)])
    quat = rng.normal(size=(N, 4))
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    velocity = np.hstack([rng.uniform(-0.9, 0.9, (N, 2)), rng.uniform(-0.2, 0.2, (N, 1)), rng.uniform(-5, 5, (N, 3))])
    empty = Tosses(RATE_HZ, counts, np.zeros((N * SAMPLES, 3)), np.zeros((N * SAMPLES, 4)), np.zeros((N * SAMPLES, 6)))
    (paths,) = cube_tosses.simulated(empty, [Start(pos, quat, velocity, np.full(N, friction))])
    places, turns = np.concatenate([path.pos for path in paths]), np.concatenate([path.quat for path in paths])
    rows = np.repeat(velocity, SAMPLES, axis=0)
    rows[:, :2] = np.repeat(velocity[:, :2], SAMPLES, axis=0)
    return Tosses(RATE_HZ, counts, places, turns, rows)


@pytest.fixture(scope="module")
def own() -> Tosses:
    return made()


def written(data: Tosses, path: Path) -> Path:
    np.savez(
        path,
        pos_m=data.pos,
        quat_wxyz=data.quat,
        vel_m_s=data.velocity[:, :3],
        angvel_body_rad_s=data.velocity[:, 3:],
        n_samples=data.n_samples,
        rate_hz=data.rate_hz,
    )
    return path


def test_tosses_that_petmjx_made_are_met(own: Tosses, tmp_path: Path) -> None:
    data = read_tosses(written(own, tmp_path / "own.npz"))
    comparison = cube_toss_study.compared(data, "mujoco")
    assert comparison["right_face"] == 1.0
    assert comparison["place_median_mm"] < 1e-6
    assert comparison["path_mean_mm"] < 1e-6
    assert all(test["ks"] == 0 for test in comparison["distributions"].values())


def test_friction_is_found_from_each_half(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cube_toss_study, "FRICTIONS", (0.12, 0.21, 0.25))
    fit = cube_toss_study.friction(made(friction=0.21), "mujoco")
    assert [half["friction"] for half in fit["halves"]] == [0.21, 0.21]
    assert fit["halves"][0]["errors_of_other_half"]["place_median_mm"] < 1e-6


def test_noise_of_velocities_is_found_from_the_flight(own: Tosses) -> None:
    rng = np.random.default_rng(8)
    velocity = own.velocity.copy()
    velocity[own.first] += rng.normal(0.0, np.repeat([SIGMA_M_S, SIGMA_RAD_S], 3), (N, 6))
    sigma = cube_tosses.noise(Tosses(own.rate_hz, own.n_samples, own.pos, own.quat, velocity))
    # There are only 24 numbers of each kind. Also, petmjx's steps follow another parabola than the exact one, which
    # changes the velocity by g·dt/2, 10 mm/s.
    assert sigma.vel_m_s == pytest.approx(SIGMA_M_S, rel=0.5)
    assert sigma.angvel_rad_s == pytest.approx(SIGMA_RAD_S, rel=0.5)
    assert sigma.turn_rad < 0.005


def test_perturbed_starts_are_as_far_off_as_they_say() -> None:
    n = 2000
    quat = np.tile([0.5, 0.5, 0.5, 0.5], (n, 1))
    start = Start(np.zeros((n, 3)), quat, np.zeros((n, 6)), np.full(n, 0.2))
    sigma = cube_tosses.Noise(3e-4, 0.01, 0.02, 0.1)
    other = cube_tosses.perturbed(start, sigma, np.random.default_rng(1))
    assert other.pos.std() == pytest.approx(sigma.pos_m, rel=0.05)
    angle = np.radians(cube_tosses.angle_deg(other.quat, quat))
    assert np.sqrt((angle**2).mean() / 3) == pytest.approx(sigma.turn_rad, rel=0.05)
    assert other.velocity[:, :3].std() == pytest.approx(sigma.vel_m_s, rel=0.05)
    assert other.velocity[:, 3:].std() == pytest.approx(sigma.angvel_rad_s, rel=0.05)
    np.testing.assert_allclose(np.linalg.norm(other.quat, axis=1), 1.0, atol=1e-12)


def test_a_point_drawn_like_the_others_is_within_regions_as_often_as_they_say() -> None:
    rng = np.random.default_rng(2)
    ranks = np.array([cube_toss_study._rank(rng.standard_t(2, (20, 2))) for _ in range(2000)])
    for region in (0.5, 0.9):
        assert (ranks <= region).mean() == pytest.approx(region, abs=4 * np.sqrt(region * (1 - region) / 2000))
    far = np.vstack([[50.0, 0.0], rng.normal(size=(19, 2))])
    assert cube_toss_study._rank(far) == 1.0


def test_faces_and_time_to_rest() -> None:
    turned = np.array([np.cos(np.pi / 4), np.sin(np.pi / 4), 0.0, 0.0])
    assert cube_tosses.face_up(np.array([1.0, 0.0, 0.0, 0.0])) == 4
    # turned by 90° about x, the cube has its y axis up
    assert cube_tosses.face_up(turned) == 2
    assert cube_tosses.face_up(np.full(4, np.nan)) == -1
    pos = np.zeros((40, 3))
    pos[:20, 0] = np.linspace(0.1, 0.0, 20)
    movement = cube_tosses.wholes([Path3(pos, np.tile([1.0, 0.0, 0.0, 0.0], (40, 1)))], 100.0)
    assert movement.way_mm[0] == pytest.approx(100.0)
    assert movement.turn_deg[0] == 0.0
    assert movement.duration_s[0] == pytest.approx(0.18)  # at this time, the cube is within 3 mm of its final place


def test_a_toss_without_an_end_is_infinitely_far(own: Tosses) -> None:
    paths = [own.path(toss) for toss in range(N)]
    paths[0] = Path3(np.full_like(paths[0].pos, np.nan), np.full_like(paths[0].quat, np.nan))
    errors = cube_tosses.errors(own, paths)
    assert not errors.right_face[0]
    assert errors.right_face[1:].all()
    assert errors.place_mm[0] == np.inf


def test_rows_that_fail_say_so() -> None:
    rows = [
        reality.Row("a", "source", "1 mm", "2 mm", "1 mm", "mujoco", "why", holds=False),
        reality.Row("b", "source", "1 mm", "1 mm", "0 mm", "mujoco", holds=True),
        reality.Row("c", "source", "1 mm", "1 mm", "0 mm", reality.ALL_ENGINES),
    ]
    results = [{"case": "reality-soft-columns", "rows": [vars(row) for row in some]} for some in (rows, rows[2:])]
    heading, blank, titles, _, *lines = reality.table(results).splitlines()
    assert (heading, blank) == ("### Soft columns", "")
    assert lines == [
        "| a | 1 mm | 2 mm | 1 mm | `mujoco` | **fails**: why | source |",
        "| b | 1 mm | 1 mm | 0 mm | `mujoco` | holds | source |",
        "| c | 1 mm | 1 mm | 0 mm | all |  | source |",
    ]
    assert titles.count("|") == lines[0].count("|")


def test_rows_that_differ_in_one_number_share_a_line() -> None:
    def row(quantity: str, petmjx: str, *, holds: bool = True) -> reality.Row:
        return reality.Row(quantity, "source", "1", petmjx, "0", "mujoco", "", holds)

    rows = [
        row("fall of 10 × 20 mm from 10 mm, worse of 1 and 2 ms", "a"),
        row("fall of 10 × 20 mm from 30 mm, worse of 1 and 2 ms", "b"),
        row("fall of 10 × 20 mm from 50 mm, worse of 1 and 2 ms", "c", holds=False),
        row("no number", "d"),
        row("fall of 30 × 20 mm from 50 mm, worse of 1 and 2 ms", "c", holds=False),
    ]
    assert reality.merged(rows) == [
        row("fall of 10 × 20 mm from 10, 30 mm, worse of 1 and 2 ms", "a; b"),
        row("fall of 10 × 20, 30 × 20 mm from 50 mm, worse of 1 and 2 ms", "c", holds=False),
        row("no number", "d"),
    ]


def test_rows_of_numbers_alone_tell_their_difference() -> None:
    numbers = SimpleNamespace(quantity="angle, °", source="Housner", expected=12.5, value=12.25, engine="mujoco")
    row = reality.Row.of(numbers)
    assert row == reality.Row("angle, °", "Housner", "12.5", "12.25", "-0.25", "mujoco")
    assert reality.Row.of(row) is row


@pytest.mark.parametrize("part", [part for part in reality.PARTS if reality.present(part)])
def test_parts_are_there(part: str) -> None:
    assert callable(importlib.import_module(reality.PARTS[part]).rows)


def test_where_to_get_the_tosses_is_one_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    options = ["--part", "tosses", "--out", str(tmp_path / "out.jsonl")]
    assert main(["reality", "--data", str(tmp_path), *options]) == 2
    line = only_line(capsys.readouterr().err)
    assert "cube_tosses_400.npz: no such file" in line
    assert "ContactNets" in line
    (tmp_path / "other.npz").write_bytes(b"no arrays")
    assert main(["reality", "--data", str(tmp_path / "other.npz"), *options]) == 2
    assert "other.npz: no file of tosses" in only_line(capsys.readouterr().err)


def test_the_table_replaces_the_one_in_a_page(
    own: Tosses, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, small in (("RUNS", 2), ("MEMBERS", 3), ("FRICTIONS", (0.18, 0.2))):
        monkeypatch.setattr(cube_toss_study, name, small)
    page = tmp_path / "page.md"
    page.write_text(f"before\n{reality.BEGIN}\nstale rows\n{reality.END}\nafter\n")
    data = written(own, tmp_path / "own.npz")
    out = tmp_path / "out.jsonl"
    arguments = ["--part", "tosses", "--data", str(data), "--write", str(page), "--out", str(out)]
    assert main(["reality", *arguments]) == 0, capsys.readouterr().err
    text = page.read_text()
    assert "stale rows" not in text
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "| 8 tosses: share that ends with the measured face up | 100.0 % | 100.0 % |" in text
    assert '"between_runs_median_mm"' in out.read_text()


def test_the_real_tosses_are_read_and_tell_their_noise(real_data: Path) -> None:
    if not (real_data / "reality").is_dir():
        pytest.skip("the measured tosses do not lie beside this checkout")
    data = read_tosses(real_data / "reality", 40)
    assert len(data) == 40
    sigma = cube_tosses.noise(data)
    assert 2e-4 < sigma.pos_m < 5e-4
    assert 0.2 < np.degrees(sigma.turn_rad) < 0.7
    assert 0.005 < sigma.vel_m_s < 0.03
    assert 0.02 < sigma.angvel_rad_s < 0.2


def test_frictions_of_cartons_are_told_apart_from_the_default() -> None:
    inside, outside = (real_friction._row_of_friction(real_friction.CARTONS[k]) for k in (0, 3))
    assert inside.holds
    assert not outside.holds
    assert outside.miss == "0.10"
