"""Intervals against published values, bisection against a known answer, EUMOS's limits at their edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from support.outcomes import make_boxes, make_outcome

from petmjx.sweeps.eumos import eumos_assessment
from petmjx.sweeps.search import Bisection, failure_mode
from petmjx.sweeps.shares import ALL_PLANS, share_standing, wilson_interval
from petmjx.verdict import BoxMetrics, Outcome, Reason, Verdict


def moved(pos: np.ndarray, max_sway_m: list[float], dropped: bool = False) -> BoxMetrics:
    """Boxes that came to rest in these places."""
    n = len(pos)
    return make_boxes(n, pos=pos, max_sway_m=np.array(max_sway_m), dropped=np.array([dropped] * n))


def outcome(verdict: Verdict, reason: Reason = Reason.NONE, culprit: int = -1) -> Outcome:
    return make_outcome(1, verdict, reason, culprit=culprit)


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
    summary = share_standing(worlds, ["level_g"]).set_index(["plan_id", "axis", "value"])
    assert summary.loc[(ALL_PLANS, "", ""), ["n_worlds", "n_standing", "n_invalid"]].tolist() == [7, 3, 2]
    assert summary.loc[("a", "level_g", "0.5"), "share"] == 0.5
    nothing_known = summary.loc[("a", "level_g", "1")]
    assert np.isnan(nothing_known["share"])
    assert (nothing_known["low"], nothing_known["high"]) == (0.0, 1.0)
    half = summary.loc[(ALL_PLANS, "level_g", "0.5")]
    assert half["share"] == pytest.approx(2 / 3)
    assert (half["low"], half["high"]) == pytest.approx(tuple(float(x) for x in wilson_interval(2, 3)))
    shuffled = share_standing(worlds.sample(frac=1, random_state=1), ["level_g"]).set_index(summary.index.names)
    pd.testing.assert_frame_equal(summary, shuffled)
    assert set(share_standing(worlds, ["level_g"], per_plan=False)["plan_id"]) == {ALL_PLANS}


@pytest.mark.parametrize(("sections", "most_rounds"), [(1, 8), (3, 4), (7, 3), (200, 1)])
def test_bisection_finds_the_level_to_the_tolerance_in_counted_evaluations(sections: int, most_rounds: int) -> None:
    levels = np.round(np.arange(201) * 0.01, 12)
    rng = np.random.default_rng(1)
    limit = np.concatenate([rng.uniform(0.0, 2.0, 40), [0.004, 1.9999, 5.0]])
    search = Bisection(levels, len(limit), sections=sections)
    tested = 0
    while not search.done:
        items, indices = search.next_tests()
        tested += len(items)
        lived = levels[indices] < limit[items]
        modes = ["" if alive else "slide" for alive in lived]
        search.record(items, indices, survived=lived, modes=modes, boxes=np.where(lived, -1, items))
    result = search.result()
    assert search.rounds <= most_rounds
    assert tested == result["n_tests"].sum() <= len(limit) * most_rounds * sections
    inside = limit < 2.0
    survived, failed = result["largest_survived"].to_numpy(), result["first_failed"].to_numpy()
    assert (survived < limit).all()
    assert (failed[inside] >= limit[inside]).all()
    np.testing.assert_allclose(failed[inside] - survived[inside], 0.01)
    assert survived[-1] == 2.0
    assert np.isnan(failed[-1])
    assert result["box"].tolist() == [*range(42), -1]
    assert result["mode"].tolist() == ["slide"] * 42 + [""]
    assert result["monotone"].all()
    assert search.next_tests()[0].size == 0


def test_bisection_leaves_out_what_does_not_stand_at_rest() -> None:
    search = Bisection([0.0, 0.5, 1.0], 2, stands_at_rest=[False, True])
    assert search.converged.tolist() == [True, False]
    items, indices = search.next_tests()
    assert items.tolist() == [1, 1]
    assert indices.tolist() == [1, 2]
    search.record(items, indices, survived=[False, False], modes=["tilt", "drop"], boxes=[4, 5])
    result = search.result()
    assert np.isnan(result["largest_survived"][0])
    assert np.isnan(result["first_failed"][0])
    assert (result["largest_survived"][1], result["first_failed"][1]) == (0.0, 0.5)
    assert (result["box"][1], result["mode"][1]) == (4, "tilt")


def test_bisection_with_a_lower_bound_above_zero_tests_that_bound() -> None:
    search = Bisection([0.5, 0.6], 1, sections=5)
    items, indices = search.next_tests()
    assert indices.tolist() == [0, 1]
    search.record(items, indices, survived=[False, False])
    assert np.isnan(search.result()["largest_survived"][0])
    assert search.result()["first_failed"][0] == 0.5


def test_a_survivor_above_a_failure_is_told_and_not_believed() -> None:
    search = Bisection(np.arange(11) / 10, 1, sections=4)
    while not search.done:
        items, indices = search.next_tests()
        # Jams between 0.55 and 0.9: survives 0.6 and 0.8 although 0.4 fails.
        level = indices / 10
        search.record(items, indices, survived=(level < 0.35) | ((level > 0.55) & (level < 0.9)))
    result = search.result().iloc[0]
    assert (result["largest_survived"], result["first_failed"]) == (0.3, 0.4)
    assert not result["monotone"]


def test_the_order_of_answers_does_not_matter() -> None:
    levels = np.arange(101) / 100
    limit = np.array([0.313, 0.777])

    def run(reverse: bool) -> pd.DataFrame:
        search = Bisection(levels, 2, sections=3)
        while not search.done:
            items, indices = search.next_tests()
            if reverse:
                items, indices = items[::-1], indices[::-1]
            search.record(items, indices, survived=levels[indices] < limit[items])
        return search.result()

    pd.testing.assert_frame_equal(run(False), run(True))


def test_bisection_reads_outcomes_and_counts_invalid_ones_as_not_survived() -> None:
    search = Bisection([0.0, 0.1, 0.2, 0.3], 1, sections=3)
    items, indices = search.next_tests()
    answers = [
        outcome(Verdict.STABLE),
        outcome(Verdict.INVALID, Reason.NONFINITE),
        outcome(Verdict.UNSTABLE, Reason.DROP, culprit=0),
    ]
    search.record(items, indices, answers)
    result = search.result().iloc[0]
    assert (result["largest_survived"], result["first_failed"]) == (0.1, 0.2)
    assert (result["mode"], result["n_invalid"]) == ("nonfinite", 1)
    assert failure_mode(answers[0]) == ""


def test_the_mode_is_that_of_the_box_that_went_first() -> None:
    def mode(box: int, tilt_limit_deg: float = 20.0) -> str:
        boxes = {"dropped": np.array([False, False, True]), "max_tilt_deg": np.array([3.0, 25.0, 90.0])}
        return failure_mode(make_outcome(3, Verdict.UNSTABLE, Reason.DROP, culprit=box, **boxes), tilt_limit_deg)

    assert [mode(0), mode(1), mode(2)] == ["slide", "tilt", "drop"]
    assert mode(1, tilt_limit_deg=30.0) == "slide"
    assert failure_mode(outcome(Verdict.UNSTABLE, Reason.TILT)) == "tilt"


def test_an_answer_for_each_test_is_asked_for() -> None:
    search = Bisection([0.0, 0.1], 1)
    with pytest.raises(ValueError, match="one answer for each test"):
        search.record([0], [1], survived=[True, False])


def test_bisection_refuses_levels_that_do_not_rise() -> None:
    for bad in ([], [0.1, 0.1], [0.2, 0.1]):
        with pytest.raises(ValueError, match="rising"):
            Bisection(bad, 1)


HALF = np.array([[0.2, 0.15, 0.25], [0.2, 0.15, 0.25]])
SETTLED = np.array([[0.2, 0.15, 0.25], [0.2, 0.15, 0.75]])


def test_eumos_limits_are_shares_of_the_load_s_height() -> None:
    still = eumos_assessment(moved(SETTLED, [0.0, 0.09]), SETTLED, HALF)
    assert still.load_height_m == 1.0
    assert (still.elastic_share, still.permanent_share, still.foot_permanent_m) == (0.09, 0.0, 0.0)
    assert still.passed
    assert not eumos_assessment(moved(SETTLED, [0.0, 0.101]), SETTLED, HALF).elastic_ok
    far = SETTLED + np.array([[0.0, 0.0, 0.0], [0.03, 0.04, 0.5]])
    at_limit = eumos_assessment(moved(far, [0.0, 0.05]), SETTLED, HALF)
    assert at_limit.permanent_share == pytest.approx(0.05)
    beyond = eumos_assessment(moved(SETTLED + np.array([[0, 0, 0], [0.051, 0, 0]]), [0.0, 0.051]), SETTLED, HALF)
    assert not beyond.permanent_ok
    foot = eumos_assessment(moved(SETTLED + np.array([[0.041, 0, 0], [0, 0, 0]]), [0.041, 0.0]), SETTLED, HALF)
    assert foot.permanent_share < 0.05
    assert foot.foot_permanent_m == pytest.approx(0.041)
    assert not foot.passed


def test_eumos_never_passes_a_drop_or_a_test_that_did_not_run() -> None:
    assert not eumos_assessment(moved(SETTLED, [0.0, 0.0], dropped=True), SETTLED, HALF).passed
    missing = eumos_assessment(moved(SETTLED, [np.nan, np.nan]), SETTLED, HALF)
    assert not missing.passed
    assert missing.columns()["eumos_passed"] is False
    assert replace(missing, elastic_share=0.0).passed
