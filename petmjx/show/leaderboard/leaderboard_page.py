"""The main page of a leaderboard, ``index.html``."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import quote

import pandas as pd

from petmjx.analysis.packer_comparison import ALL_SIZES, PackerComparison
from petmjx.analysis.packer_kpis import KPIS
from petmjx.analysis.packer_runs import MISSING
from petmjx.common.text import count_text, printable
from petmjx.options.simulation import Simulation
from petmjx.show.leaderboard.entries import Entry
from petmjx.show.leaderboard.entry_replays import Sample
from petmjx.show.leaderboard.leaderboard_files import ORDERS, PLANS
from petmjx.show.pages.html_page import page
from petmjx.show.pages.markup import Content, Markup, element, joined_markup, table
from petmjx.show.report.chart_frame import figure
from petmjx.show.report.charts import interval_text, intervals, percent
from petmjx.show.report.run_settings import changed_options
from petmjx.version import __version__

MOST_ORDERS: Final = 200
"""Largest number of orders that the page lists. The runs in the board's folder contain all orders."""

MOST_SENTENCES: Final = 15

RATING: Final = (
    "Rating: boxes on plans that stand in the simulation, as a share of all ordered boxes. A box does not count if its "
    "plan falls or has no valid simulation, or if the box is not on the order's target. Nor does a box count if it was "
    "not ordered, if the plan has it more often than ordered, or if it was ordered with another size, mass or "
    "property. Boxes that were left out, and orders without a plan, lower the rating."
)

_MEANS: Final = {
    "boxes": ("boxes placed", ".1f"),
    "left_out": ("left out", ".2f"),
    "height_m": ("height m", ".3f"),
    "kpi_2": ("kpi_2", ".3f"),
    "kpi_1": ("kpi_1", ".3f"),
    "kpi_4": ("kpi_4", ".3f"),
    "kpi_5": ("kpi_5", ".3f"),
    "utilisation_2m": ("use below 2 m", ".3f"),
}
"""Name of a column of ``PackerComparison.packers`` → (heading, format)."""


@dataclass(frozen=True)
class StoryEntry:
    """A story, that is, a page about the simulation of one plan.

    Attributes:
        packer: name of the packer.
        plan_id: id of the plan.
        verdict: verdict of the simulation.
        file: path of the page, relative to the board's folder.
    """

    packer: str
    plan_id: str
    verdict: str
    file: str


@dataclass(frozen=True, eq=False)
class Board:
    """The content of the leaderboard's page, ``index.html``.

    Attributes:
        entries: the rated entries.
        comparison: the comparison of these entries.
        rating: a table with a row for each packer, from ``petmjx.analysis.packer_rating.rate``.
        digests: name of a packer → SHA-256 of the file with its plans in the board's folder. Packers whose plans were
            not found are missing.
        story_entries: the stories.
        orders: whether the board was made with orders.
        stories: largest number of stories per packer.
        options: simulation options with which the board can be made again.
        samples: the replays (plans simulated again) of each entry that has any, including entries that are not rated.
    """

    entries: Sequence[Entry]
    comparison: PackerComparison
    rating: pd.DataFrame
    digests: Mapping[str, str]
    story_entries: Sequence[StoryEntry]
    orders: bool
    stories: int
    options: Simulation
    samples: Sequence[Sample]

    def to_dict(self) -> dict[str, Any]:
        """The board as values for ``leaderboard.json``."""
        return {
            "petmjx": __version__,
            "command": self.command,
            "confidence": self.comparison.confidence,
            "rating": self.rating,
            "packers": self.comparison.packers,
            "pairs": self.comparison.pairs,
            "sentences": self.comparison.sentences,
            "plans_sha256": self.digests,
            "stories": [vars(story) for story in self.story_entries],
            "simulated_again": [sample.to_dict() for sample in self.samples],
            "refused": [{"packer": sample.packer, "why": sample.refusal} for sample in self.samples if sample.refusal],
            "notes": self.notes,
        }

    @property
    def notes(self) -> list[str]:
        """Notes for the reader: refused entries, and other reasons to doubt the board."""
        lost = [entry.name for entry in self.entries if entry.name not in self.digests]
        lines = [sample.refusal or sample.note for sample in self.samples if sample.refusal or sample.note]
        lines += self.comparison.notes
        if not self.orders:
            lines.append(
                "made without orders (--orders): what was ordered is taken from the packers' own plans and runs, so "
                "the rating of a packer depends on the other packers"
            )
        if lost:
            lines.append(
                f"the files of the plans of {', '.join(lost)} were not found, so this page has no simulations to "
                "play and no file of these plans"
            )
        return lines

    @property
    def command(self) -> str:
        """The command that makes the board again, in another folder. The command must be run in the board's folder."""
        entry_names = [entry.name for entry in self.entries if entry.name in self.digests and not entry.ours]
        words = ["petmjx", "leaderboard", *(f"{name}={PLANS}/{name}.json" for name in entry_names)]
        words += ["--orders", ORDERS] if self.orders else []
        words += ["--baselines"] if any(entry.ours for entry in self.entries) else []
        words += ["--stories", str(self.stories), "-o", "../again"]
        config = self.entries[0].run.info.get("config", {})
        words += ["--engine", str(config.get("engine", "auto"))]
        options, defaults = (simulation.model_dump(mode="json") for simulation in (self.options, Simulation()))
        for name, value, _ in changed_options(options, defaults):
            if value is not None and name != "physics.name":
                words += ["--set", f"{name}={_toml(value)}"]
        return shlex.join(words)


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"[{', '.join(map(_toml, value))}]" if isinstance(value, list) else str(value)


def board_page(board: Board) -> str:
    """The leaderboard's page as HTML text."""
    first = board.rating.iloc[0]
    orders = count_text(int(first["n_orders"]), "order")
    sections: list[tuple[str, Content]] = [
        ("Rating", _rating(board)),
        ("Is the difference more than luck?", _luck(board)),
        ("Measures of the plans", _measures(board)),
        ("Stories", _story_list(board)),
        ("Orders on which packers differ", _orders(board)),
        ("Make it again", _rerun_section(board)),
    ]
    body = joined_markup(
        element(
            "header",
            element("p", "petmjx leaderboard", class_="faint"),
            element("h1", f"{count_text(len(board.rating), 'packer')}, {orders}"),
        ),
        element("main", *(element("section", element("h2", title), inner) for title, inner in sections if inner)),
    )
    return page("petmjx leaderboard", body, script="", styles=("report.css", "leaderboard.css"))


def _rating(board: Board) -> Markup:
    own_names = {entry.name for entry in board.entries if entry.ours}
    rows, drawn = [], []
    for row in board.rating.to_dict("records"):
        name = element("strong", row["packer"]) if row["rank"] == 1 else element("span", row["packer"])
        mark = element("span", " of petmjx", class_="faint") if row["packer"] in own_names else None
        span = interval_text(row["low"], row["high"])
        stand = f"{row['n_stable']:,} of {row['n_orders']:,}"
        other_cells = [f"{row[column]:,}" for column in ("n_missing", "n_invalid")]
        rows.append([str(row["rank"]), joined_markup(name, mark), percent(row["rating"]), span, stand, *other_cells])
        drawn.append((row["packer"], row["rating"], row["low"], row["high"], f"{percent(row['rating'])} ({span})"))
    level = f"{100 * board.comparison.confidence:g} %"
    heads = ["rank", "packer", "rating", f"{level} interval", "plans that stand", "no plan", "invalid"]
    chart = figure(f"Rating with {level} intervals", intervals("Rating", drawn))
    notes = [element("p", note, class_="note") for note in board.notes]
    return joined_markup(
        element("p", RATING, class_="hint"), *notes, _rerun_text(board), table(heads, rows, texts=2), chart
    )


def _rerun_text(board: Board) -> Content:
    """A text with the number of plans that were simulated again, for each entry that was given as a run."""
    parts = [
        f"{count_text(len(sample.replays), 'plan')} of {printable(sample.packer)}"
        for sample in board.samples
        if sample.replays and not sample.refusal
    ]
    if not parts:
        return None
    return element("p", f"Simulated again by this board, drawn at random: {', '.join(parts)}.", class_="hint")


def _luck(board: Board) -> Markup:
    sentences = board.comparison.sentences
    items = [element("li", printable(sentence)) for sentence in sentences[:MOST_SENTENCES]]
    n_more = len(sentences) - MOST_SENTENCES
    more_line = (
        element("p", f"{count_text(n_more, 'pair')} more in leaderboard.json.", class_="hint") if n_more > 0 else None
    )
    compared = "Orders with a valid verdict from every packer are compared."
    return joined_markup(element("p", compared, class_="hint"), element("ul", *items), more_line)


def _measures(board: Board) -> Markup:
    means = board.comparison.packers[board.comparison.packers["size"] == ALL_SIZES].set_index("packer")
    columns = [name for name in _MEANS if name in means and means[name].notna().any()]
    rows: list[list[Content]] = []
    for name in board.rating["packer"]:
        values = [means.loc[name, column] for column in columns]
        cells = [format(value, _MEANS[column][1]) for column, value in zip(columns, values, strict=True)]
        rows.append([name, *cells])
    kpis = " BED-BPP defines the KPIs." if any(column in KPIS for column in columns) else ""
    hint = element("p", f"Means over the compared orders.{kpis}", class_="hint")
    return joined_markup(hint, table(["packer", *(_MEANS[column][0] for column in columns)], rows))


def _story_list(board: Board) -> Content:
    if not board.story_entries:
        return None
    rows: list[list[Content]] = []
    for name in board.rating["packer"]:
        links = [
            joined_markup(_link(story, story.plan_id), " ") for story in board.story_entries if story.packer == name
        ]
        rows.append([name, joined_markup(*links)])
    hint = (
        "Each link opens a page that plays the simulation of one plan. The simulation was repeated exactly as it was "
        "when the plan was rated."
    )
    return joined_markup(element("p", hint, class_="hint"), table(["packer", "plans"], rows, texts=2, class_="stories"))


def _link(story: StoryEntry, text: str) -> Markup:
    return element("a", text, href=quote(story.file), class_=f"mark {story.verdict}")


def _orders(board: Board) -> Content:
    names = list(board.rating["packer"])
    verdicts = board.comparison.plans.pivot(index="plan_id", columns="packer", values="verdict")[names]
    differ = verdicts[verdicts.nunique(axis=1) > 1]
    if differ.empty:
        return None
    pages = {(story.packer, story.plan_id): story for story in board.story_entries}
    rows: list[list[Content]] = []
    for plan_id, row in differ.head(MOST_ORDERS).iterrows():
        cells: list[Content] = []
        for name in names:
            board_story, verdict = pages.get((name, str(plan_id))), str(row[name])
            label = "no plan" if verdict == MISSING else verdict
            cells.append(_link(board_story, label) if board_story else element("span", label, class_=f"mark {verdict}"))
        rows.append([str(plan_id), *cells])
    n_more = len(differ) - MOST_ORDERS
    more_line = element("p", f"{count_text(n_more, 'order')} more.", class_="hint") if n_more > 0 else None
    hint = element(
        "p",
        f"{count_text(len(differ), 'order')}. Underlined verdicts lead to pages that play the simulations.",
        class_="hint",
    )
    return joined_markup(hint, table(["order", *names], rows, texts=1 + len(names)), more_line)


def _rerun_section(board: Board) -> Markup:
    rows: list[list[Content]] = []
    for entry in board.entries:
        if entry.name in board.digests:
            file = f"{PLANS}/{entry.name}.json"
            link = element("a", file, href=quote(file))
            rows.append([entry.name, link, element("code", board.digests[entry.name][:16])])
    info = board.entries[0].run.info
    device = f"petmjx {__version__}; the first run: {info.get('device', 'unknown device')}"
    text = "The folder of this page has all plans. This command, typed in that folder, rates the plans again:"
    return joined_markup(
        element("p", text),
        element("pre", element("code", printable(board.command))),
        table(["packer", "plans", "SHA-256 begins with"], rows, texts=3) if rows else None,
        element("p", device, class_="hint"),
    )
