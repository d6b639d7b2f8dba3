"""Tests of chains (journeys of a pallet in parts, called legs). A leg begins with the boxes where the previous leg left
them. The summary gives the share of worlds in which a pallet arrives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
import pandas as pd
import pytest
from support.outcomes import make_outcome
from support.plans import make_plan, stack
from support.sweeps import QUICK, Recorder, leaning, write_sweep

import petmjx
from petmjx.common.errors import InputError
from petmjx.common.units import STANDARD_GRAVITY
from petmjx.engines.job_stream import JobStream
from petmjx.engines.metrics import SampleAt, box_metrics
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Progress, says_at_hand, takes_stream
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.plans.bundled import bundled_path
from petmjx.runs.chain_legs import after
from petmjx.runs.chain_summary import ChainColumns, summarise_chain
from petmjx.runs.hopeless_profiles import slide_m
from petmjx.runs.merge import merge_runs
from petmjx.runs.sweep_file import load_sweep
from petmjx.runs.sweep_run import SweepRun
from petmjx.runs.sweep_worlds import SweepPlan
from petmjx.runs.worlds_of_earlier_run import worlds_of_run
from petmjx.world.error_distributions import Distribution, DistributionShape
from petmjx.world.job import Job
from petmjx.world.profiles.accelerations import eumos_40509
from petmjx.world.random_streams import WorldKey, rngs

ERRORS = """
seed = 3
replicates = 2
[axes]
placement_error_mm = 3
"""

PUSH = '{ profile = "eumos-40509", level = 0.45 }'
BACK = '{ profile = "eumos-40509", level = 0.45, direction = "-x" }'


def legs(**events: str) -> str:
    """TOML text of legs, given by their names and their events."""
    return "\n".join(f'[[legs]]\nname = "{name}"\nevents = [{text}]' for name, text in events.items())


def test_a_chain_of_one_leg_is_a_sweep_to_the_last_bit(tmp_path: Path) -> None:
    push = '{ profile = "eumos-40509", level = 0.4, direction = "+y" }'
    plans = [leaning("a"), leaning("b", 3, 90.0), leaning("falls", 2, -380.0)]
    one = petmjx.sweep(write_sweep(tmp_path, ERRORS + QUICK + legs(truck=push)), plans, engine="mujoco")
    axes = 'profile = "eumos-40509"\nlevel = 0.4\ndirection = "+y"\n'
    other = petmjx.sweep(write_sweep(tmp_path, ERRORS + axes + QUICK), plans, engine="mujoco")
    common = [name for name in other.worlds if name in one.worlds]
    assert {*other.worlds} - {*common} == {
        "profile", "level_g", "direction_deg", "eumos_elastic_share", "eumos_permanent_share",
        "eumos_foot_permanent_m", "eumos_passed",
    }  # fmt: skip
    assert set(one.worlds["verdict"]) == {"stable", "unstable"}
    pd.testing.assert_frame_equal(one.worlds[common], other.worlds[common], check_exact=True)
    pd.testing.assert_frame_equal(one.boxes, other.boxes, check_exact=True)


SLIDES = """
[simulation]
carrier = "euro-pallet"
settle_s = 0.4
rest_s = 0.5
[simulation.thresholds]
shift_m = 0.5
[axes]
friction_factor = 0.6
"""
"""TOML text of a sweep in which boxes have the friction 0.3 and may slide by half a metre."""

BLOCK = make_plan("block", stack(1, at_mm=(600, 250)))
"""A plan with a single box. On the side to which the box slides, half a metre of the pallet is free."""


WAY_M = slide_m(0.45 * eumos_40509().excitation(0.002).samples, 0.3, STANDARD_GRAVITY, 0.002)
"""Distance by which a block with friction 0.3 slides in ``PUSH`` according to Coulomb's law, m."""

SLIDING = 0.03
"""Largest relative difference between the distances by which a block slides in simulation and by Coulomb's law."""


@pytest.mark.parametrize("engine", ["mujoco", "mjx-warp-cpu"])
def test_a_block_slides_on_from_where_the_leg_before_left_it(engine: str, tmp_path: Path) -> None:
    assert 0.05 < WAY_M < 0.15
    file = write_sweep(tmp_path, SLIDES + legs(one=PUSH, two=PUSH, back=BACK, both=f"{PUSH}, {PUSH}"))
    run = petmjx.sweep(file, [BLOCK], engine=engine, record="all")
    (box,) = run.boxes.to_dict("records")
    assert box["shift_x_m"] == pytest.approx(-3 * WAY_M, rel=SLIDING)
    assert box["max_sway_m"] == pytest.approx(2 * WAY_M, rel=SLIDING)  # in the leg of two pushes
    (world,) = run.worlds.to_dict("records")
    frames = run.frames["time_s"].to_numpy()
    assert (np.diff(frames) > 0).all()
    assert frames[-1] == pytest.approx(world["sim_time_s"], abs=0.002)


def test_largest_values_are_those_of_all_legs() -> None:
    """Every number that is measured again and again is the largest so far; other values are those of the last leg."""
    often = (SampleAt.STEPS, SampleAt.SAMPLES, SampleAt.LOOKS)
    names = [m.attribute for m in box_metrics() if m.when in often and m.dtype is np.float32]
    assert names == [metric.attribute for metric in box_metrics() if metric.is_peak]
    one, two = (make_outcome(**dict.fromkeys(names, values)) for values in (np.arange(3.0), np.arange(3.0)[::-1]))
    boxes = after(one, two, 0.002).boxes
    assert [getattr(boxes, name).tolist() for name in names] == [[2.0, 1.0, 2.0]] * len(names)
    assert (boxes.pos == two.boxes.pos).all()


def test_a_world_says_in_which_leg_which_box_failed_and_when(tmp_path: Path) -> None:
    strong = '{ profile = "eumos-40509", level = 0.9 }'
    text = QUICK.replace("early_stop = false", 'carrier = "euro-pallet"')
    text += legs(conveyor=PUSH.replace("0.45", "0.2"), truck=strong, dock=PUSH)
    plans = [replace(BLOCK, plan_id="stands"), make_plan("falls", stack(2, -380.0, at_mm=(600, 250)))]
    plan = SweepPlan(load_sweep(file := write_sweep(tmp_path, text), plans_given=True), plans)
    progress = Progress()
    shares = {
        world.plan.plan_id: progress.work_share for world in SweepRun(plan, MujocoEngine(1), progress=progress).worlds()
    }
    # each plan has a placement and three legs; the stack of two boxes falls in its placement, the single box in leg two
    assert shares == {"falls": pytest.approx((8 + 1) / 12), "stands": 1.0}
    worlds = petmjx.sweep(file, plans, engine="mujoco").worlds.set_index("plan_id")
    falls, stands = worlds.loc["falls"], worlds.loc["stands"]
    assert (falls["leg"], falls["n_steps"]) == ("placing", 0)
    assert (stands["leg"], stands["mode"]) == ("truck", "slide")
    assert 0.05 < stands["sign_in_profile_s"] < 0.4
    conveyor_s = 0.002 * 315  # 200 steps of the profile, and 115 steps until the pallet rests
    began_s = stands["sim_time_s"] - 0.002 * stands["n_steps"] + conveyor_s
    assert stands["first_sign_s"] == pytest.approx(began_s + stands["sign_in_profile_s"], abs=1e-9)


def test_film_is_around_the_pallet_from_its_leg_on(tmp_path: Path) -> None:
    film = '[[legs]]\nname = "film"\nwrap_turns = 6\n'
    off = '[[legs]]\nname = "unwrapped"\nwrap_turns = 0\nevents = [' + PUSH + "]\n"
    more = '[[remedies]]\nname = "more film"\nleg = "film"\nwrap_turns = 9\n'
    text = SLIDES + legs(one=PUSH) + "\n" + film + legs(two=PUSH) + "\n" + off + more
    engine = Recorder(2)
    run = petmjx.sweep(write_sweep(tmp_path, text), [BLOCK], engine=engine)
    assert run.worlds["remedy"].tolist() == ["", "more film"]
    turns = [[job.scene.wrap.turns for job in jobs] for jobs, _ in engine.batches]
    # turns of film: the placement and the leg before the film are simulated only once
    assert turns == [[0], [0], [6, 9], [0, 0]]
    assert [job.poses is None for jobs, _ in engine.batches for job in jobs] == [True, True, *[False] * 4]
    # in leg two, film holds the box
    assert run.boxes["shift_x_m"].tolist() == pytest.approx([-2 * WAY_M] * 2, rel=SLIDING)
    edges = ["plan_edge_m", "plan_edge_box", "build_edge_m", "build_edge_box", "build_edge_step"]
    placed = petmjx.score([BLOCK], engine="mujoco").worlds[edges]
    # distances from edges, by the plan, are those of the first leg; later legs do not compute them
    for row in range(2):
        pd.testing.assert_frame_equal(run.worlds[edges].iloc[[row]].reset_index(drop=True), placed, check_exact=True)


DRAWN = """
seed = 5
replicates = 5
[axes]
friction_tolerance_rel = { distribution = "uniform", low = -0.5, high = 0.3 }
"""
"""TOML text of an axis with random friction, from 0.25 to 0.65."""


def test_intervals_cover_known_probabilities() -> None:
    """Intervals contain the true probability as often as they should. A block slides if a push is stronger than its
    random friction, so the probability is known. Each plan has 40 worlds."""
    n, distribution = 40, Distribution(DistributionShape.UNIFORM, -0.1, 0.4)
    level_g = np.linspace(0.26, 0.64, 200)
    known = (0.65 - level_g) / 0.4
    parts = []
    for place, level in enumerate(level_g.tolist()):
        draws = distribution.draw(rngs([WorldKey(5, f"p{place}", k) for k in range(n)], "friction-rel"), (1,))[:, 0]
        stands = 0.5 * (1 + draws) > level
        verdict, leg = np.where(stands, "stable", "unstable"), np.where(stands, "", "truck")
        values = {"verdict": verdict, "leg": leg, "culprit": np.where(stands, None, 0), "remedy": ""}
        parts.append(pd.DataFrame({"plan_id": f"p{place}", "variant": np.arange(1, n + 1), **values}))
    summary = summarise_chain(pd.concat(parts, ignore_index=True), ChainColumns(("truck",), (), random=True))
    rows = summary.query("scope == 'plan' and leg == ''")
    covers = (rows["low"] <= known) & (known <= rows["high"])
    assert 185 <= covers.sum() <= 197
    error = (rows["share"] - known).mean()
    assert abs(error) < NormalDist().inv_cdf(0.999) * np.sqrt((known * (1 - known)).mean() / n / 200)
    assert summary["gain"].isna().all()


REMEDIES = """
[[remedies]]
name = "slower"
leg = "truck"
factor = 0.5
[[remedies]]
name = "wrapped"
leg = "truck"
wrap_turns = 8
"""


def test_a_summary_counts_leg_by_leg_and_what_remedies_gain(tmp_path: Path) -> None:
    """In pushes of 0.2 g, a box never slides too far, whatever its random friction is. In pushes of 0.6 g, it slides
    too far if its friction is small. With film, or half of the film, it never slides too far."""
    weak, strong = PUSH.replace("0.45", "0.2"), PUSH.replace("0.45", "0.6")
    text = DRAWN + QUICK.replace("early_stop = false", "") + legs(conveyor=weak, truck=strong)
    file = write_sweep(tmp_path, text + REMEDIES)
    run = petmjx.sweep(file, [make_plan("block", stack(1)), make_plan("twin", stack(1))], engine="mujoco")
    assert run.summary is not None
    worlds, summary = run.worlds, run.summary.set_index(["scope", "plan_id", "remedy", "leg"])
    slid = worlds[(worlds["remedy"] == "") & (worlds["plan_id"] == "block") & (worlds["verdict"] == "unstable")]
    n = len(slid)
    assert 0 < n < 5
    assert set(slid["leg"]) == {"truck"}
    counts = summary[["n_worlds", "n_standing", "n_invalid"]]
    assert counts.loc[("plan", "block", "")].to_numpy().tolist() == [[5, 5 - n, 0], [5, 5, 0], [5, 5, 0], [5, 5 - n, 0]]
    whole = summary.loc[("plan", "block", "", "")]
    assert (whole["weakest_leg"], whole["box"], whole["share"]) == ("truck", 0, 1 - n / 5)
    for remedy in ("slower", "wrapped"):
        row = summary.loc[("plan", "block", remedy, "")]
        assert (row["only_with"], row["only_without"], row["gain"]) == (n, 0, pytest.approx(n / 5))
        assert row["gain_low"] > -0.6
    both = summary.xs("all").reset_index().query("leg == '' and remedy == 'slower'").iloc[0]
    assert both["only_with"] == worlds.query("remedy == ''")["verdict"].eq("unstable").sum()


def test_levels_are_drawn_once_a_world_and_shared_by_remedies(tmp_path: Path) -> None:
    """Each world has a random level, which it also has with remedies. Above a certain level, a block with friction 0.5
    slides by more than 20 mm."""
    drawn = '{ profile = "eumos-40509", level = { from = 0.45, to = 0.75 } }'
    text = "replicates = 8\n" + QUICK.replace("early_stop = false", 'carrier = "euro-pallet"') + legs(truck=drawn)
    file = write_sweep(tmp_path, text + REMEDIES.partition('[[remedies]]\nname = "wrapped')[0])
    plan = SweepPlan(load_sweep(file, plans_given=True), [BLOCK])
    worlds = [variant for _, variants in plan.placements() for variant in variants]
    drives = [plan.leg_drive(BLOCK, variant, variant.legs[0]) for variant in worlds]
    levels, slower = np.array([drive.scale for drive in drives]).reshape(-1, 2).T
    assert slower == pytest.approx(levels / 2)
    assert len(set(levels)) == 8
    assert levels.min() >= 0.45
    assert levels.max() <= 0.75
    samples = eumos_40509().excitation(0.002).samples
    ways_m = np.array([slide_m(level * samples, 0.5, STANDARD_GRAVITY, 0.002) for level in levels])
    assert 0 < (ways_m < 0.02).sum() < 8
    assert (np.abs(ways_m - 0.02) > SLIDING * 0.02).all()  # no distance is so near to 20 mm that the verdict is open
    run = petmjx.sweep(file, [BLOCK], engine="mujoco")
    stands = run.worlds["verdict"].eq("stable").to_numpy().reshape(-1, 2)
    assert stands[:, 0].tolist() == (ways_m < 0.02).tolist()
    assert stands[:, 1].all()
    assert run.summary is not None
    assert run.summary.query("scope == 'plan' and leg == ''")["low"].notna().all()


def test_resumed_and_merged_runs_have_the_same_answers(tmp_path: Path) -> None:
    file = write_sweep(
        tmp_path, DRAWN.replace("5\n[", "2\n[") + QUICK + legs(one=PUSH, two=BACK) + REMEDIES.replace("truck", "two")
    )
    plans = [make_plan(f"p{k}", stack(1)) for k in range(2)]
    whole = petmjx.score(plans, chain=file, engine="mujoco", out=tmp_path / "whole")
    engine = Recorder(1)
    again = petmjx.score(plans, chain=file, engine="mujoco", out=tmp_path / "whole", resume=True)
    for share in (1, 2):
        petmjx.score(plans, chain=file, engine="mujoco", out=tmp_path / f"{share}", shard=f"{share}/2")
    merged = merge_runs([tmp_path / "1", tmp_path / "2"], tmp_path / "merged")
    for other in (again, merged):
        pd.testing.assert_frame_equal(whole.summary, other.summary, check_exact=True)
        pd.testing.assert_frame_equal(whole.worlds, other.worlds, check_exact=True)
    worlds, index = worlds_of_run(whole, "p1", variant=2)
    world = SweepRun(worlds, engine).world("p1", index)
    row = whole.worlds.query("plan_id == 'p1' and variant == 2").iloc[0]
    assert (world.outcome.margin, world.outcome.n_steps) == (row["margin"], row["n_steps"])


class _Interrupted(MujocoEngine):
    """The engine ``mujoco``, interrupted after 14 of 20 outcomes."""

    @says_at_hand
    @takes_stream
    def run(
        self, jobs: Sequence[Job] | JobStream[Any], sim: Simulation, progress: Progress | None = None
    ) -> Iterator[Outcome]:
        yield from islice(super().run(jobs, sim, progress), 14)
        raise KeyboardInterrupt


def test_worlds_arrive_while_others_have_not_begun_and_an_interrupted_run_keeps_them(tmp_path: Path) -> None:
    """There are four placements, each followed by a first leg and three variants of a second leg. Legs are simulated
    before all placements are finished. If the run is interrupted, the finished worlds are kept."""
    text = DRAWN.replace("5\n[", "2\n[") + QUICK + legs(one=PUSH.replace("0.45", "0.1"), two=BACK)
    file = write_sweep(tmp_path, text + REMEDIES.replace("truck", "two"))
    plans = [make_plan(f"p{k}", stack(1)) for k in range(2)]
    with pytest.raises(KeyboardInterrupt):
        petmjx.sweep(file, plans, engine=_Interrupted(1), out=tmp_path / "out")
    assert 4 <= len(petmjx.load_run(tmp_path / "out").worlds) < 12
    resumed = petmjx.sweep(file, plans, engine="mujoco", out=tmp_path / "out", resume=True)
    whole = petmjx.sweep(file, plans, engine="mujoco")
    assert len(whole.worlds) == 12
    for one, other in ((whole.worlds, resumed.worlds), (whole.boxes, resumed.boxes), (whole.summary, resumed.summary)):
        pd.testing.assert_frame_equal(one, other, check_exact=True)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (legs(a='{ profile = "radial" }'), "legs[0].events[0].profile: 'radial' pushes the carrier"),
        (legs(a='{ profile = "eumos" }'), "legs[0].events[0].profile: unknown profile 'eumos'; did you mean"),
        (legs(a='{ profile = "eumos-40509" }'), "legs[0].events[0].level is missing: profile 'eumos-40509'"),
        (legs(a='{ profile = "tilt", scale = 2.0 }'), "legs[0].events[0].scale contradicts profile 'tilt', which"),
        (legs(a='{ profile = "tilt", direction = "up" }'), "legs[0].events[0].direction must be degrees or one of +x"),
        (
            legs(a='{ profile = "eumos-40509", level = { from = 0.1, to = 0.3, step = 0.1 } }'),
            "legs[0].events[0].level is drawn at random between 'from' and 'to': leave out 'step' and 'count'",
        ),
        (legs(a=PUSH, placing=PUSH), "legs[1].name: 'placing' is already the name of the part before the first leg"),
        ('[[legs]]\nname = "film"\nwrap_turns = 3', "legs have no events"),
        ('[[legs]]\nname = "a\\u001b[31m"', "legs[0].name: 'a\\u001b[31m' must have visible characters"),
        (legs(a=PUSH) + '\n[[remedies]]\nname = " "\nleg = "a"\nfactor = 0.5', "remedies[0].name: ' ' must have"),
        (legs(a=PUSH) + '\n[[remedies]]\nname = "x"\nleg = "b"\nfactor = 0.5', "remedies[0].leg: no leg 'b'"),
        (legs(a=PUSH) + '\n[[remedies]]\nname = "x"\nleg = "a"', "remedies[0] changes nothing"),
        (
            legs(a='{ profile = "tilt" }') + '\n[[remedies]]\nname = "x"\nleg = "a"\nfactor = 0.5',
            "remedies[0].factor: no event of leg 'a' has a level or scale",
        ),
        ('[axes]\nprofile = "tilt"\n' + legs(a=PUSH), "axes.profile contradicts legs"),
        ("[axes]\nmass_factor = [1, 2]\n" + legs(a=PUSH), "axes.mass_factor must be one value in a chain, got 2"),
        ("[search]\n" + legs(a=PUSH), "[search] contradicts legs"),
    ],
)  # fmt: skip
def test_chains_that_are_refused(text: str, expected: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as refused:
        load_sweep(write_sweep(tmp_path, text), plans_given=True)
    assert str(refused.value).startswith(f"{tmp_path / 'x.toml'}: {expected}")


def test_a_chain_needs_legs_and_time_and_rigid_boxes(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has no \[\[legs\]\]"):
        petmjx.score([make_plan()], chain="friction")
    with pytest.raises(InputError, match=r"has no \[\[legs\]\]"):
        petmjx.score([make_plan()], chain=write_sweep(tmp_path, ""))
    with pytest.raises(InputError, match="is a folder, not a sweep file"):
        petmjx.score([make_plan()], chain=tmp_path)
    with pytest.raises(InputError, match="legs contradict errors"):
        petmjx.score([make_plan()], confidence=4, errors=write_sweep(tmp_path, legs(a=PUSH)))
    with pytest.raises(InputError, match="errors contradicts chain"):
        petmjx.score([make_plan()], chain="friction", confidence=8, errors="confidence")
    with pytest.raises(InputError, match="a…: no such sweep file"):
        petmjx.score([make_plan()], chain="a" * 5000)
    file = write_sweep(tmp_path, legs(a=PUSH))
    with pytest.raises(InputError, match="confidence = 8 needs a random axis"):
        petmjx.score([make_plan()], chain=file, confidence=8)
    with pytest.raises(InputError, match="legs contradict total_time_factor"):
        petmjx.sweep(file, [make_plan()], schedule="fixed", total_time_factor=2.0)


def test_packers_are_compared_by_how_likely_their_plans_arrive(tmp_path: Path) -> None:
    file = write_sweep(tmp_path, DRAWN + QUICK.replace("early_stop = false", "") + legs(truck=PUSH))
    ids = ("o1", "o2", "o3")
    low = petmjx.score([make_plan(plan_id, stack(1)) for plan_id in ids], chain=file, engine="mujoco")
    high = petmjx.score(
        [make_plan(plan_id, stack(3, size_mm=(100, 100, 300))) for plan_id in ids], chain=file, engine="mujoco"
    )
    compared = petmjx.compare_packers({"low": low, "high": high})
    shares = {}
    for name, run in (("low", low), ("high", high)):
        drawn = run.worlds[run.worlds["variant"] > 0]
        shares[name] = drawn["verdict"].eq("stable").groupby(drawn["plan_id"]).mean()
        row = compared.packers.query("size == 'all' and packer == @name").iloc[0]
        assert row["p_arrives"] == pytest.approx(shares[name].mean())
    gain = shares["high"] - shares["low"]
    assert gain.mean() < 0
    pair = compared.pairs.query("size == 'all'").iloc[0]
    # 4.302653 is Student's factor for three orders
    half = 4.302653 * gain.std() / np.sqrt(3)
    assert (pair["p_gain"], pair["p_gain_high"]) == pytest.approx((gain.mean(), gain.mean() + half))
    assert not compared.notes
    file = write_sweep(tmp_path, DRAWN + QUICK + legs(ship=PUSH))
    other = petmjx.score([make_plan("o1", 1)], chain=file, engine="mujoco")
    notes = petmjx.compare_packers({"low": low, "other": other}).notes
    assert "other was not taken through the same chain as low" in notes


HAT_N = 200.0
"""Force with which a hat of film presses on the top, N."""


@pytest.mark.parametrize("engine", ["mujoco", "mjx-warp-cpu"])
def test_a_force_that_lasts_counts_after_any_leg(engine: str, tmp_path: Path) -> None:
    """A force that lasts counts after any leg. Film presses on a stack in the first leg, and is removed in the second
    leg, so the forces at the end do not show it. A carton carries this force for a moment, but not for a month."""
    gentle = '{ profile = "eumos-40509", level = 0.05 }'
    text = SLIDES.replace("settle_s = 0.4", f"settle_s = 0.4\nwrap = {{ hat_n = {HAT_N} }}")
    text += legs(wrapped=gentle).replace("[[legs]]", "[[legs]]\nwrap_turns = 1") + "\n"
    text += legs(bare=gentle).replace("[[legs]]", "[[legs]]\nwrap_turns = 0")
    two = replace(make_plan("two", stack(2, at_mm=(600, 250))), strength_n=np.array([300.0, 300.0]))
    run = petmjx.sweep(write_sweep(tmp_path, text), [two], engine=engine)
    weight_n = two.mass_kg[1] * STANDARD_GRAVITY
    lower = run.boxes.iloc[0]
    assert lower["rest_top_force_n"] == pytest.approx(weight_n, rel=0.01)
    assert lower["sustained_top_force_n"] == pytest.approx(weight_n + HAT_N, rel=0.01)
    assert run.boxes["sustained_top_force_n"].iloc[1] == 0
    for days, crushed in ((0, "not"), (30, "surely")):
        (plan,) = petmjx.loads(run, stacking={"storage_days": days}).plans.to_dict("records")
        assert (plan["overloaded"], plan["crushed"], plan["crush_box"]) == (False, crushed, 0)


@pytest.mark.parametrize("engine", ["mujoco", "mjx-warp-cpu"])
def test_film_holds_a_block_in_a_truck_up_to_friction_and_hold(engine: str, tmp_path: Path) -> None:
    """A wrapped block slides if the acceleration exceeds friction + (holding force of the film) / weight, in g. EN
    12195-1 requires 0.8 g forward and 0.5 g in the other directions. So a block that film holds up to 0.7 g fails in
    the truck, and a block that film holds up to 0.9 g arrives."""
    weight_n, friction = BLOCK.mass_kg[0] * STANDARD_GRAVITY, 0.3
    hold_of_a_turn_n = 0.3 * 4 * 2 * 5.0 * BLOCK.size_mm[0, 2] / 500.0  # friction × four sides × force of 5 N per turn
    text = SLIDES.replace("settle_s = 0.4", "settle_s = 0.4\nwrap = { force_n = 5.0 }").replace("shift_m = 0.5", "")
    for holds_g, leg in ((0.7, "truck"), (0.9, "")):
        turns = (holds_g - friction) * weight_n / hold_of_a_turn_n
        way = f'[[legs]]\nname = "film"\nwrap_turns = {turns:.4f}\n' + legs(truck='{ profile = "en-12195-1" }')
        run = petmjx.sweep(write_sweep(tmp_path, f"{text}{way}\n{legs(dock=PUSH)}"), [BLOCK], engine=engine)
        assert run.worlds["leg"].tolist() == [leg], holds_g


BALANCE = 0.02
"""Largest relative difference of the peak forces in a rocking tower between two solvers, one of which is stopped early,
so that the motions differ slightly."""


def test_forces_of_a_solver_that_was_stopped_far_from_balance_do_not_count(tmp_path: Path) -> None:
    """If the solver of ``mjx-warp`` has made all its iterations and is far from balance, its forces are up to a hundred
    times too large, so they must not count as peaks."""
    axes = '[simulation.physics]\nkinetic_friction_share = 0.75\n[axes]\nprofile = "eumos-40509"\nlevel = {}\n'
    (tower,) = (plan for plan in petmjx.load_plans(bundled_path()).plans if plan.plan_id == "hand-tower")
    pile = make_plan("pile", stack(5))
    for plan, level, stands in ((tower, 0.2, True), (pile, 0.5, False)):
        file = write_sweep(tmp_path, axes.format(level))
        stopped, exact = (
            petmjx.sweep(file, [plan], engine="mjx-warp-cpu", **options).boxes["max_top_force_n"].to_numpy()
            for options in ({"solver_iterations": 7}, {})
        )
        if stands:
            np.testing.assert_allclose(stopped, exact, rtol=BALANCE)
        else:
            assert (stopped <= (1 + BALANCE) * exact).all()
