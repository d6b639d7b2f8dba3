"""Statistics of two shares from paired samples, compared with published examples, with statsmodels, and with simulated
samples."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from statsmodels.stats.contingency_tables import mcnemar
from statsmodels.stats.multitest import multipletests

from petmjx.common.errors import InputError
from petmjx.results.share_statistics import PairedCounts, holm, mcnemar_p, newcombe_interval, wilson_interval

counts = st.builds(PairedCounts, *[st.integers(0, 200)] * 4)


@pytest.mark.parametrize(
    ("found", "difference", "low", "high", "digits"),
    [
        # Fagerland, Lydersen, Laake (2017), "Statistical analysis of contingency tables", chapter 8: complete response
        # before and after consolidation therapy (Cavo et al. 2012)
        (PairedCounts(59, 16, 6, 80), -0.0621, -0.1186, -0.0046, 4),
        # the same book: airway hyper-responsiveness before and after transplantation (Bentur et al. 2009)
        (PairedCounts(1, 7, 1, 12), -0.286, -0.507, -0.026, 3),
    ],
)
def test_newcombe_interval_has_its_published_values(
    found: PairedCounts, difference: float, low: float, high: float, digits: int
) -> None:
    assert round(found.difference, digits) == difference
    assert tuple(round(bound, digits) for bound in newcombe_interval(found)) == (low, high)


@given(found=counts)
def test_newcombe_interval_holds_the_difference_and_turns_round(found: PairedCounts) -> None:
    low, high = newcombe_interval(found)
    assert -1 <= low <= high <= 1
    turned = PairedCounts(found.both, found.only_b, found.only_a, found.neither)
    assert newcombe_interval(turned) == pytest.approx((-high, -low), abs=1e-12)
    # if standing and falling are exchanged, only the sign of the difference changes
    mirrored = PairedCounts(found.neither, found.only_b, found.only_a, found.both)
    assert newcombe_interval(mirrored) == pytest.approx((-high, -low), abs=1e-12)
    if found.n:
        assert low - 1e-12 <= found.difference <= high + 1e-12


@given(found=counts, more=st.sampled_from([0.8, 0.99]))
def test_more_confidence_is_a_wider_interval(found: PairedCounts, more: float) -> None:
    narrow, wide = sorted([newcombe_interval(found), newcombe_interval(found, more)], key=lambda b: b[1] - b[0])
    assert wide[0] <= narrow[0] + 1e-12
    assert narrow[1] <= wide[1] + 1e-12


@pytest.mark.parametrize("cells", [(0.55, 0.1, 0.15, 0.2), (0.9, 0.02, 0.07, 0.01), (0.3, 0.3, 0.3, 0.1)])
def test_newcombe_interval_covers_as_often_as_it_says(cells: tuple[float, ...]) -> None:
    rng = np.random.default_rng(0)
    draws = rng.multinomial(80, cells, size=2000)
    bounds = np.array([newcombe_interval(PairedCounts(*map(int, draw))) for draw in draws])
    truth = cells[2] - cells[1]
    covered = ((bounds[:, 0] <= truth) & (truth <= bounds[:, 1])).mean()
    # The interval should cover 95 %. Four standard errors of 2,000 draws are 2 percentage points, and the correction
    # for continuity makes the interval a little wider.
    assert 0.93 <= covered <= 0.99


def test_without_a_common_trial_everything_is_possible() -> None:
    nothing = PairedCounts(0, 0, 0, 0)
    assert newcombe_interval(nothing) == (-1, 1)
    assert np.isnan(nothing.difference)
    assert mcnemar_p(nothing) == 1.0


@given(found=counts)
def test_mcnemar_is_statsmodels_exact_test(found: PairedCounts) -> None:
    table = [[found.both, found.only_a], [found.only_b, found.neither]]
    assert mcnemar_p(found) == pytest.approx(mcnemar(table, exact=True).pvalue, rel=1e-9)


def test_mcnemar_says_which_extra_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy.stats", None)
    with pytest.raises(InputError, match=r"needs SciPy: pip install 'petmjx\[packers\]'"):
        mcnemar_p(PairedCounts(1, 2, 3, 4))


def test_holm_is_statsmodels() -> None:
    rng = np.random.default_rng(0)
    for number in (1, 2, 3, 6, 10):
        for p_values in (rng.random(number), rng.random(number) / 100, np.full(number, 0.03)):
            assert holm(p_values.tolist()) == pytest.approx(multipletests(p_values, method="holm")[1], abs=1e-12)


def test_an_empty_list_of_tests_has_no_correction() -> None:
    assert len(holm([])) == 0


def test_the_shares_own_intervals_are_scipys() -> None:
    from scipy.stats import binomtest

    for hits, n in ((0, 7), (3, 9), (9, 9), (1998, 2000)):
        expected = binomtest(hits, n).proportion_ci(method="wilson")
        low, high = wilson_interval(hits, n)
        assert (float(low), float(high)) == pytest.approx((expected.low, expected.high), abs=1e-12)
