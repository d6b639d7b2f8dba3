"""Shares and searches: intervals compared with published values, searches compared with known answers, and EUMOS's
limits at their edges."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import ArrayLike
from support.outcomes import make_boxes, make_outcome

from petmjx.engines.metrics import BoxMetrics
from petmjx.engines.verdict import Flag, Outcome, Reason, Verdict
from petmjx.options.thresholds import Thresholds
from petmjx.results.share_statistics import ALL_PLANS, KEYS, ONE_PLAN, share_standing, wilson_interval
from petmjx.runs.eumos_limits import eumos_assessment
from petmjx.runs.level_search import LevelSearch, Probe, failure_mode


def moved(pos: np.ndarray, max_sway_m: list[float], dropped: bool = False) -> BoxMetrics:
    """Metrics of boxes that came to rest at these places."""
    n = len(pos)
    return make_boxes(n, pos=pos, max_sway_m=np.array(max_sway_m), dropped=np.array([dropped] * n))


def outcome(verdict: Verdict, reason: Reason = Reason.NONE, culprit: int = -1) -> Outcome:
    return make_outcome(1, verdict, reason, culprit=culprit)


STANDS = Probe.of(outcome(Verdict.STABLE))
SLID = Probe.of(outcome(Verdict.UNSTABLE, Reason.SHIFT, culprit=0))


def search_with(search: LevelSearch, levels: ArrayLike, survives: Callable[[float], bool]) -> int:
    """Run the tests of a search until it ends. Returns the number of rounds of tests."""
    rounds, values = 0, np.asarray(levels)
    while tests := search.next_levels():
        search.record({level: STANDS if survives(values[level]) else SLID for level in reversed(tests)})
        rounds += 1
    return rounds


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [
        # Newcombe (1998), Statistics in Medicine 17, table I, method 3 (score without continuity correction).
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0000, 0.1611),
        (1, 29, 0.0061, 0.1718),
        (29, 29, 1 - 0.1170, 1.0),
    ],
)
def test_wilson_interval_has_its_published_values(successes: int, n: int, low: float, high: float) -> None:
    bounds = wilson_interval(successes, n)
    assert float(bounds[0]) == pytest.approx(low, abs=5e-5)
    assert float(bounds[1]) == pytest.approx(high, abs=5e-5)


def test_wilson_interval_is_vectorised_mirrored_and_widens() -> None:
    low, high = wilson_interval(np.arange(33), 32)
    np.testing.assert_allclose(low, 1 - high[::-1], atol=1e-15)
    assert (low <= np.arange(33) / 32).all()
    assert (high >= np.arange(33) / 32).all()
    assert wilson_interval(0, 0) == (0.0, 1.0)
    assert wilson_interval(16, 32, 0.99)[0] < low[16]
    for bad in ((5, 4), (-1, 4)):
        with pytest.raises(ValueError, match="between 0 and n"):
            wilson_interval(*bad)


def test_share_standing_counts_by_plan_and_axis_and_leaves_invalid_worlds_out() -> None:
    rows = [
        ("a", 1, 0.5, "stable"),
        ("a", 2, 0.5, "unstable"),
        ("a", 3, 1.0, "invalid"),
        ("a", 4, 1.0, "invalid"),
        ("b", 1, 0.5, "stable"),
        ("b", 3, 1.0, "stable"),
        ("b", 0, np.nan, "unstable"),
    ]
    worlds = pd.DataFrame(rows, columns=["plan_id", "variant", "level_g", "verdict"])
    summary = shares_by_key(worlds, ["level_g"])
    assert summary.loc[(ALL_PLANS, "", "", ""), ["n_worlds", "n_standing", "n_invalid"]].tolist() == [7, 3, 2]
    assert summary.loc[(ONE_PLAN, "a", "level_g", "0.5"), "share"] == 0.5
    nothing_known = summary.loc[(ONE_PLAN, "a", "level_g", "1")]
    assert nothing_known[["share", "low", "high"]].isna().all()
    assert summary.loc[(ALL_PLANS, "", "level_g", "0.5"), "share"] == pytest.approx(2 / 3)
    pd.testing.assert_frame_equal(summary, shares_by_key(worlds.sample(frac=1, random_state=1), ["level_g"]))


def shares_by_key(worlds: pd.DataFrame, axes: list[str]) -> pd.DataFrame:
    """Shares of standing worlds, with the index scope, plan id ("" for all plans), axis and value."""
    return share_standing(worlds, axes).fillna({"plan_id": ""}).set_index([*KEYS])


def test_what_is_not_drawn_has_no_interval() -> None:
    worlds = pd.DataFrame({"plan_id": "a", "level_g": [0.1, 0.2, 0.3], "verdict": ["stable", "stable", "unstable"]})
    for given in (worlds, worlds.assign(draw=[np.nan, 0, 1])):
        total = shares_by_key(given, []).loc[(ONE_PLAN, "a", "", "")]
        assert total["share"] == pytest.approx(2 / 3)
        assert total["n_draws"] == 0
        assert total[["low", "high"]].isna().all()


def test_an_interval_is_that_of_independent_draws() -> None:
    verdicts = ["stable", "unstable"] * 10 + ["stable"] * 20
    worlds = pd.DataFrame({"plan_id": "a", "error_mm": [1.0] * 20 + [2.0] * 20, "verdict": verdicts})
    alone = shares_by_key(worlds.assign(draw=range(40)), []).loc[(ONE_PLAN, "a", "", "")]
    assert alone["n_draws"] == 40
    assert (alone["low"], alone["high"]) == tuple(map(float, wilson_interval(30, 40)))
    shared = shares_by_key(worlds.assign(draw=[*range(20)] * 2), ["error_mm"])
    total = shared.loc[(ONE_PLAN, "a", "", "")]
    assert (total["n_worlds"], total["n_draws"], total["share"]) == (40, 20, 0.75)
    assert (total["low"], total["high"]) == tuple(map(float, wilson_interval(15, 20)))
    assert shared.loc[(ONE_PLAN, "a", "error_mm", "1"), "high"] == float(wilson_interval(10, 20)[1])
    invalid = worlds.assign(draw=range(40), verdict=["invalid"] * 20 + verdicts[20:])
    assert shares_by_key(invalid, []).loc[(ALL_PLANS, "", "", ""), "n_draws"] == 20
    nothing = shares_by_key(worlds.assign(draw=range(40), verdict="invalid"), []).iloc[0]
    assert nothing[["share", "low", "high"]].isna().all()


@pytest.mark.parametrize("plan_id", ["*", "", "all", "plan"])
def test_no_plan_s_id_is_taken_for_all_plans(plan_id: str) -> None:
    worlds = pd.DataFrame({"plan_id": [plan_id, "b"], "level_g": 0.1, "verdict": ["stable", "unstable"]})
    summary = share_standing(worlds, ["level_g"])
    assert not summary.duplicated([*KEYS]).any()
    totals = summary[summary["scope"] == ALL_PLANS]
    assert totals["plan_id"].isna().all()
    assert totals["n_worlds"].tolist() == [2, 2]
    assert summary.groupby("plan_id")["n_worlds"].sum().to_dict() == {plan_id: 2, "b": 2}


@pytest.mark.parametrize(("sections", "most_rounds"), [(1, 8), (3, 4), (7, 3), (200, 1)])
def test_a_search_finds_the_level_to_the_tolerance_in_counted_evaluations(sections: int, most_rounds: int) -> None:
    levels = np.round(np.arange(201) * 0.01, 12)
    for limit in [*np.random.default_rng(1).uniform(0.0, 2.0, 40), 0.004, 1.9999]:
        search = LevelSearch(201, STANDS, sections, from_zero=True)
        assert search_with(search, levels, lambda level, limit=limit: level < limit) <= most_rounds
        assert search.n_tests <= most_rounds * sections
        assert levels[search.largest_survived] < limit <= levels[search.first_failed]
        assert search.first_failed == search.largest_survived + 1
        assert (search.box, search.mode, search.monotone) == (0, "slide", True)
    search = LevelSearch(201, STANDS, sections, from_zero=True)
    search_with(search, levels, lambda level: True)
    assert (search.largest_survived, search.first_failed, search.box, search.mode) == (200, None, -1, "")


def test_a_search_leaves_out_what_does_not_stand_at_rest() -> None:
    fallen, search = (LevelSearch(3, at_rest, from_zero=True) for at_rest in (SLID, STANDS))
    assert (fallen.stands_at_rest, search.stands_at_rest) == (False, True)
    assert fallen.next_levels() == []
    assert (fallen.largest_survived, fallen.first_failed) == (None, None)
    assert (fallen.box, fallen.mode, fallen.n_tests) == (0, "slide", 0)
    assert search.next_levels() == [1, 2]
    tilted = make_outcome(5, Verdict.UNSTABLE, Reason.TILT, culprit=4, max_tilt_deg=np.full(5, 30.0))
    search.record({1: Probe.of(tilted), 2: SLID})
    assert (search.largest_survived, search.first_failed) == (0, 1)
    assert (search.box, search.mode) == (4, "tilt")
    assert search.next_levels() == []


def test_a_search_with_a_lower_bound_above_zero_tests_that_bound() -> None:
    search = LevelSearch(2, STANDS, sections=5)
    assert search.next_levels() == [0, 1]
    search.record({0: SLID, 1: SLID})
    assert (search.largest_survived, search.first_failed) == (None, 0)


def test_a_survivor_above_a_failure_is_told_and_not_believed() -> None:
    search = LevelSearch(11, STANDS, sections=4, from_zero=True)
    # The pallet jams between 0.55 and 0.9: it survives 0.6 and 0.8 although it fails at 0.4.
    search_with(search, np.arange(11) / 10, lambda level: level < 0.35 or 0.55 < level < 0.9)
    assert (search.largest_survived, search.first_failed) == (3, 4)
    assert not search.monotone


def test_a_search_reads_outcomes_and_counts_invalid_ones_as_not_survived() -> None:
    search = LevelSearch(4, STANDS, from_zero=True)
    answers = [
        outcome(Verdict.STABLE),
        outcome(Verdict.INVALID, Reason.NONFINITE),
        outcome(Verdict.UNSTABLE, Reason.DROP, culprit=0),
    ]
    search.record(dict(zip(search.next_levels(), map(Probe.of, answers), strict=True)))
    assert (search.largest_survived, search.first_failed) == (1, 2)
    assert (search.mode, search.n_invalid) == ("nonfinite", 1)
    assert failure_mode(answers[0]) == ""


def test_a_search_counts_tests_that_still_moved() -> None:
    moving = make_outcome(1, Verdict.UNSTABLE, Reason.SHIFT, culprit=0, flags=Flag.MOVING)
    assert Probe.of(moving).moving
    row = {"verdict": "stable", "culprit": None, "mode": "", "flags": int(Flag.MOVING | Flag.FORKED)}
    assert Probe.from_row(row).moving
    assert not Probe.from_row(row | {"flags": int(Flag.FORKED)}).moving
    search = LevelSearch(4, STANDS, from_zero=True)
    search.record({1: STANDS, 2: Probe.from_row(row), 3: Probe.of(moving)})
    assert (search.n_moving, search.largest_survived) == (2, 2)
    assert (search.at_survived, search.at_failed) == (Probe.from_row(row), Probe.of(moving))


def test_the_mode_is_that_of_the_box_that_went_first() -> None:
    def mode(box: int, tilt_limit_deg: float = 20.0) -> str:
        boxes = {"dropped": np.array([False, False, True]), "max_tilt_deg": np.array([3.0, 25.0, 90.0])}
        fallen = make_outcome(3, Verdict.UNSTABLE, Reason.DROP, culprit=box, **boxes)
        return failure_mode(fallen, Thresholds(tilt_deg=tilt_limit_deg))

    assert [mode(0), mode(1), mode(2)] == ["slide", "tilt", "drop"]
    assert mode(1, tilt_limit_deg=30.0) == "slide"
    assert failure_mode(outcome(Verdict.UNSTABLE, Reason.TILT)) == "tilt"


def test_a_search_refuses_what_it_cannot_use() -> None:
    with pytest.raises(ValueError, match="must have results"):
        LevelSearch(2, STANDS, from_zero=True).record({0: STANDS})
    for bad in ((0, 1), (1, 0)):
        with pytest.raises(ValueError, match="must be ≥ 1"):
            LevelSearch(bad[0], STANDS, bad[1])


HALF = np.array([[0.2, 0.15, 0.25], [0.2, 0.15, 0.25]])
SETTLED = np.array([[0.2, 0.15, 0.25], [0.2, 0.15, 0.75]])


def assess(pos: np.ndarray, max_sway_m: list[float], dropped: bool = False) -> dict[str, Any]:
    """EUMOS's columns, without the prefix ``eumos_``, of boxes that came to rest at these places."""
    assessment = eumos_assessment(moved(pos, max_sway_m, dropped), SETTLED, HALF)
    return {name.removeprefix("eumos_"): value for name, value in assessment.items()}


def shifted(lower_m: list[float], upper_m: list[float]) -> np.ndarray:
    return SETTLED + np.array([lower_m, upper_m])


def test_eumos_limits_are_shares_of_the_load_s_height() -> None:
    # the load is 1 m high
    still = assess(SETTLED, [0.0, 0.09])
    assert still == {"elastic_share": 0.09, "permanent_share": 0.0, "foot_permanent_m": 0.0, "passed": True}
    assert not assess(SETTLED, [0.0, 0.101])["passed"]
    at_limit = assess(shifted([0.0, 0.0, 0.0], [0.03, 0.04, 0.5]), [0.0, 0.05])
    assert at_limit["permanent_share"] == pytest.approx(0.05)
    beyond = assess(shifted([0, 0, 0], [0.051, 0, 0]), [0.0, 0.051])
    assert beyond["elastic_share"] < 0.1
    assert not beyond["passed"]
    foot = assess(shifted([0.041, 0, 0], [0, 0, 0]), [0.041, 0.0])
    assert foot["permanent_share"] < 0.05
    assert foot["foot_permanent_m"] == pytest.approx(0.041)
    assert not foot["passed"]


def test_eumos_never_passes_a_drop_or_a_test_that_did_not_run() -> None:
    assert assess(SETTLED, [0.0, 0.0])["passed"]
    assert not assess(SETTLED, [0.0, 0.0], dropped=True)["passed"]
    assert assess(SETTLED, [np.nan, np.nan])["passed"] is False
