"""The section that compares several runs of the same plans, or runs of several packers on the same orders."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Final

import pandas as pd

from petmjx.analysis.run_comparison import KEY, Comparison, compare_runs
from petmjx.common.text import count_text, three_digits
from petmjx.engines.verdict import Verdict
from petmjx.results.share_statistics import PairedCounts, newcombe_interval, wilson_interval
from petmjx.show.pages.markup import NOTHING, Content, Markup, element, joined_markup, table
from petmjx.show.report.chart_frame import figure
from petmjx.show.report.charts import interval_text, intervals, percent, stacked_bars
from petmjx.show.report.report_runs import ReportRun
from petmjx.show.report.verdict_shares import plan_link

MOST_FLIPS: Final = 50
"""Largest number of flipped verdicts (different in the two runs) that are listed. The table of plans contains all
flipped verdicts."""

MOST_PAIRS: Final = 28
"""Largest number of pairs of runs that are drawn: the pairs of eight runs."""


def comparison_section(runs: Sequence[ReportRun]) -> Markup:
    """The section that compares several runs, using the worlds that all runs have."""
    if len(runs) < 2:
        return NOTHING
    common = common_verdicts(runs)
    run_words = "both runs" if len(runs) == 2 else f"all {len(runs)} runs"
    parts: list[Content] = [element("p", f"{count_text(len(common), _word(runs))} in {run_words}.")]
    if len(common):
        drawn, differences = _won_and_lost(runs, common)
        parts += [element("div", _rates(runs, common), drawn, class_="charts"), differences]
    if len(runs) == 2:
        comparison = compare_runs(runs[0].results, runs[1].results, packers=True)
        parts.append(_two(runs, comparison, common.index.get_level_values("plan_id").nunique()))
    return joined_markup(*parts)


def _word(runs: Sequence[ReportRun]) -> str:
    return "plan" if all(run.what == "plan" for run in runs) else "world"


def common_verdicts(runs: Sequence[ReportRun]) -> pd.DataFrame:
    """The verdicts of the worlds that all runs have. There is a row for each world, with plan and variant as index, and
    a column for each run, with the number of the run as name."""
    columns = [run.worlds.set_index(KEY)["verdict"].rename(at) for at, run in enumerate(runs)]
    return pd.concat(columns, axis=1, join="inner").sort_index()


def _rates(runs: Sequence[ReportRun], common: pd.DataFrame) -> Markup:
    """A chart of the share of worlds that stand in each run, with Wilson's interval."""
    rows = []
    for at, run in enumerate(runs):
        judged = common[at] != Verdict.INVALID.value
        n, stands = int(judged.sum()), int((common[at] == Verdict.STABLE.value).sum())
        low, high = (float(bound) for bound in wilson_interval(stands, n))
        share = stands / n if n else float("nan")
        text = f"{percent(share)} ({interval_text(low, high)})" if n else "none judged"
        rows.append((run.name, share, low, high, text))
    invalid = int((common == Verdict.INVALID.value).sum().sum())
    note = "Share of worlds that stand, among the worlds that all runs have, with Wilson’s 95 % interval."
    note += f" {count_text(invalid, 'invalid world is', 'invalid worlds are')} not counted." if invalid else ""
    if any(run.kind.sweeps for run in runs):
        note += " Worlds of one plan depend on each other, so the intervals are too narrow."
    return figure("Stable rates", intervals("Stable rates", rows), note)


def _won_and_lost(runs: Sequence[ReportRun], common: pd.DataFrame) -> tuple[Markup, Markup]:
    """A chart and a table about each pair of runs. The chart has the numbers of worlds that stand in both runs, in one
    run, or in neither. The table has the differences between the shares of worlds that stand. Only worlds with a valid
    verdict in both runs are compared."""
    rows, differences = [], []
    pairs = list(itertools.combinations(range(len(runs)), 2))
    for a, b in pairs[:MOST_PAIRS]:
        counts = paired_counts(common[a], common[b])
        parts = [
            ("stable", counts.both, "stand in both"),
            ("won", counts.only_a, f"stand only in {runs[a].name}"),
            ("lost", counts.only_b, f"stand only in {runs[b].name}"),
            ("unstable", counts.neither, "stand in neither"),
        ]
        rows.append((f"{runs[a].name} – {runs[b].name}", parts))
        low, high = (f"{100 * bound:+.1f}".replace("-", "−") for bound in newcombe_interval(counts))
        difference = f"{100 * counts.difference:+.1f}".replace("-", "−") if counts.n else "–"
        differences.append([f"{runs[b].name} − {runs[a].name}", difference, f"{low} to {high}"])
    key = element(
        "p",
        *(
            element("span", text, class_=f"key {class_}")
            for class_, text in (("stable", "both stand"), ("won", "only the first"), ("lost", "only the second"))
        ),
        element("span", "neither", class_="key unstable"),
        class_="keys",
    )
    more_text = f"{len(pairs) - MOST_PAIRS:,} more pairs are not drawn." if len(pairs) > MOST_PAIRS else ""
    picture = stacked_bars("Plans won and lost", rows)
    test = "95 %: Newcombe’s interval of paired shares. 'petmjx compare --packers' also tests these differences."
    drawn = element("div", figure("Plans won and lost, pair by pair", picture, more_text), key)
    listed = table(["difference, points", "", "95 %"], differences)
    return drawn, joined_markup(listed, element("p", test, class_="hint"))


def paired_counts(a: pd.Series, b: pd.Series) -> PairedCounts:
    """Numbers of worlds that stand in both of two runs, in only one of them, or in neither. Only worlds with a valid
    verdict in both runs are counted.

    Args:
        a, b: verdicts of the same worlds in the two runs.
    """
    judged = (a != Verdict.INVALID.value) & (b != Verdict.INVALID.value)
    return PairedCounts.of(*(verdicts[judged] == Verdict.STABLE.value for verdicts in (a, b)))


def _two(runs: Sequence[ReportRun], pair: Comparison, n_plans: int) -> Markup:
    """The confusion matrix of the verdicts of two runs, and a list of flipped verdicts. ``n_plans`` is the number of
    plan ids that both runs have; plans with the same id may have different boxes."""
    a, b = (run.name for run in runs)
    rows = [[str(verdict), *(f"{count:,}" for count in counts)] for verdict, counts in pair.confusion.iterrows()]
    agree = percent(pair.agreement) if pair.agreement is not None else "–"
    caption = f"Verdicts: {pair.n_agree:,} of {count_text(pair.n_common, 'world')} agree ({agree})"
    notes = [element("li", note) for note in pair.notes]
    text = ""
    if pair.n_not_stable:
        text = f"Of {count_text(pair.n_not_stable, 'world')} that are stable in neither run, {pair.same_reason:,} have "
        text += "the same reason"
        text += "." if pair.other_plans else f" and {pair.same_culprit:,} the same first box to fail."
    differ = _how_plans_differ(len(pair.other_plans), n_plans)
    return joined_markup(
        element("h3", f"{a} (a) against {b} (b)"),
        element("p", differ, class_="hint") if differ else NOTHING,
        element("ul", *notes, class_="lines warn") if notes else NOTHING,
        table([f"{a} ↓ {b} →", *map(str, pair.confusion.columns)], rows, caption=caption),
        element("p", text) if text else NOTHING,
        _only(pair, a, b),
        _flips(runs, pair),
    )


def _how_plans_differ(n_other: int, n_plans: int) -> str:
    if not n_other:
        return ""
    if n_other == n_plans:
        return "No plan is the same in both runs: two packers are compared, order by order."
    return f"{n_other:,} of {count_text(n_plans, 'plan')} {'is' if n_other == 1 else 'are'} not the same in both runs."


def _only(pair: Comparison, a: str, b: str) -> Markup:
    parts = [
        f"{count_text(len(frame), 'world')} only in {name}"
        for name, frame in ((a, pair.only_a), (b, pair.only_b))
        if len(frame)
    ]
    return element("p", "; ".join(parts) + ".", class_="hint") if parts else NOTHING


def _flips(runs: Sequence[ReportRun], pair: Comparison) -> Markup:
    flips = pair.flips
    if flips.empty:
        return element("p", "No verdict flipped.")
    rows: list[list[Content]] = []
    for row in flips.head(MOST_FLIPS).to_dict("records"):
        world_link = plan_link(runs[0], str(row["plan_id"]), int(row["variant"]))
        name = str(row["plan_id"]) + (f" / {row['variant']}" if row["variant"] else "")
        cells: list[Content] = [element("a", name, href=f"#{world_link}")]
        cells += [_outcome(row, side) for side in "ab"]
        cells += [_margin(row[f"margin_{side}"]) for side in "ab"]
        rows.append(cells)
    a, b = (run.name for run in runs)
    caption = f"Flipped verdicts ({len(flips):,})"
    caption += f": the first {MOST_FLIPS}" if len(flips) > MOST_FLIPS else ""
    within = None if pair.other_plans else pair.flips_within  # margins of different plans say nothing about flips
    note = (
        ""
        if within is None
        else f"Each of these worlds has a margin from -{three_digits(within)} to {three_digits(within)} in one run."
    )
    return joined_markup(
        table(["plan", a, b, f"margin, {a}", f"margin, {b}"], rows, caption=caption, texts=3),
        element("p", note, " A click on a plan shows its world in both runs, in 3D and side by side.", class_="hint"),
    )


def _margin(value: float) -> str:
    return "–" if pd.isna(value) else f"{value:.2f}".replace("-", "−")


def _outcome(row: dict[str, object], side: str) -> Markup:
    verdict, reason, culprit = (row[f"{name}_{side}"] for name in ("verdict", "reason", "culprit"))
    box = "" if pd.isna(culprit) else f", box {culprit} first"
    reason_text = f" ({reason}{box})" if reason else box
    return joined_markup(element("span", str(verdict), class_=f"mark {verdict}"), reason_text)
