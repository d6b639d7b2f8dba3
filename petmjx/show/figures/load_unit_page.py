"""A PDF file with a page about each load unit (loaded pallet) of a chain, to be sent to others. A page shows the four
sides of the load unit, the probability that it arrives, and the assumptions.

``petmjx report DIR --pdf FILE`` writes the file, with matplotlib. docs/chains.md shows an example.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from petmjx.analysis.criteria import load_tipping_g
from petmjx.analysis.crushing import SUSTAINED
from petmjx.analysis.plan_contacts import find_contacts
from petmjx.common.atomic_write import atomic_write
from petmjx.common.checked_records import option
from petmjx.common.errors import InputError
from petmjx.common.text import box_label, count_text, printable, printable_name
from petmjx.common.units import MM_PER_M
from petmjx.options.carriers import Carrier, walls_of
from petmjx.options.simulation import Simulation
from petmjx.plans.plan import Plan
from petmjx.plans.plan_warnings import DEFAULT_TOLERANCE_MM
from petmjx.results.run_reader import RunResults, is_chain
from petmjx.results.share_statistics import ONE_PLAN
from petmjx.runs.chain_legs import AS_IS, PLACING
from petmjx.runs.chain_summary import WHOLE_WAY, arrivals
from petmjx.show.figures.figure_style import draw_intervals, new_figure, paper_style
from petmjx.show.pages.palette import article_colours
from petmjx.show.table_layout import percent
from petmjx.world.film import film_of
from petmjx.world.profiles.accelerations import EN_12195_FORWARD_G, EN_12195_SIDEWAYS_G
from petmjx.world.scene import build_scene

A4_IN: Final = (8.27, 11.69)

MOST_PAGES: Final = 50
"""Largest number of pages in a file. There is one page per plan."""

LETTERS: Final = 128
"""Largest number of letters in a line of text."""

FOOTER: Final = 0.045
"""Height of the space at the bottom of a page for the line with the versions, as a share of the page."""

SIDES: Final = (("front", 0, 1, 1.0), ("right", 1, 0, -1.0), ("back", 0, 1, -1.0), ("left", 1, 0, 1.0))
"""For each view of the load: its name, the horizontal axis in the view, the axis perpendicular to the view, and the
direction of this perpendicular axis: away from the eye (1) or towards the eye (-1). Axis 0 is x, axis 1 is y."""

MIRRORED: Final = frozenset({"back", "left"})
"""Views in which the horizontal axis points to the left."""


def write_load_unit_pages(run: RunResults, plans: Mapping[str, Plan], path: Path) -> int:
    """Write a PDF file with a page for each plan in the run of a chain. Returns the number of pages.

    Raises:
        InputError: the run is not the run of a chain, is not complete, or has too many plans; or none of its plans was
            found.
    """
    if is_chain(run.info) and run.unfinished:
        n_worlds, expected = run.info["counts"]["worlds"], count_text(run.info["expected_worlds"], "world")
        raise InputError(
            f"{run.path}: is not complete ({n_worlds:,} of {expected}): continue with {option('--resume', 'True')}"
        )
    if not is_chain(run.info) or run.summary is None:
        raise InputError(
            f"{run.path}: is not the run of a chain, so it has no PDF pages; 'petmjx score PLANS --chain NAME' "
            "makes such a run"
        )
    rows = [row for row in arrivals(run.summary).to_dict("records") if row["plan_id"] in plans]
    if not rows:
        raise InputError(
            f"{run.path}: the files of its plans were not found: name the files or folders that have the plans"
        )
    if len(rows) > MOST_PAGES:
        raise InputError(f"{run.path}: has {len(rows):,} plans, but a file can have at most {MOST_PAGES} pages")
    from matplotlib.backends.backend_pdf import PdfPages

    with paper_style(), atomic_write(path) as file, PdfPages(file, metadata={"CreationDate": None}) as pages:
        for row in rows:
            pages.savefig(_page(run, plans[str(row["plan_id"])], row))
    return len(rows)


def sentence(row: Mapping[Any, Any]) -> str:
    """Sentences about the share of worlds in which a plan arrives. ``row`` is a row of the table ``arrivals``."""
    judged = row["n_worlds"] - row["n_invalid"]
    if not judged:
        return "No world has a verdict."
    interval = "" if pd.isna(row["low"]) else f" (95 % interval: {percent(row['low'])} to {percent(row['high'])})"
    text = f"Arrives in {row['n_standing']:,} of {judged:,} worlds: P = {percent(row['share'])}{interval}."
    if not row["weakest_leg"]:
        return f"{text} The pallet fails in no leg."
    box = "" if pd.isna(row["box"]) else f"; there, box {int(row['box'])} fails first most often"
    return f"{text} Weakest leg: {row['weakest_leg']}{box}."


def _page(run: RunResults, plan: Plan, row: Mapping[Any, Any]) -> Any:
    figure = new_figure(*A4_IN, layout=None)
    figure.text(0.07, 0.96, printable(plan.plan_id), fontsize=15, fontweight="bold", va="top")
    figure.text(0.07, 0.935, "\n".join(textwrap.wrap(sentence(row), 88)), fontsize=10, va="top")
    for place, side in enumerate(SIDES):
        axes = figure.add_axes((0.05 + 0.225 * place, 0.66, 0.215, 0.235))
        _draw_side(axes, plan, *side)
    _draw_legs(figure.add_axes((0.2, 0.47, 0.73, 0.15)), run, plan)
    texts = [("Load unit", _facts(run, plan)), ("What would help", _remedies(run, plan)), ("Assumed", _assumed(run))]
    wrapped = [
        (title, "\n".join(part for line in lines for part in textwrap.wrap(line, LETTERS, subsequent_indent="   ")))
        for title, lines in texts
    ]
    wrapped = [(title, text) for title, text in wrapped if text]
    # a long chain has many lines, so all text is made as small as needed to fit
    top, title_height, line_height = 0.43, 0.03, 0.0135
    height = sum(title_height + line_height * (text.count("\n") + 1) for _, text in wrapped)
    smaller = min(1.0, (top - FOOTER) / height)
    y = top
    for title, text in wrapped:
        figure.text(0.07, y, title, fontsize=10 * smaller, fontweight="bold", va="top")
        figure.text(0.07, y - 0.018 * smaller, text, fontsize=8 * smaller, va="top", linespacing=1.35)
        y -= smaller * (title_height + line_height * (text.count("\n") + 1))
    versions = run.info.get("versions", {})
    version_text = ", ".join(f"{name} {versions[name]}" for name in ("petmjx", "mujoco", "python") if name in versions)
    engine = run.info.get("config", {}).get("engine", "")
    figure.text(0.07, 0.03, f"{version_text}; engine {engine}; {run.info.get('started', '')}", fontsize=7, color="0.4")
    return figure


def _draw_side(axes: Any, plan: Plan, name: str, across: int, into: int, away: float) -> None:
    """Draw the load as seen from one side. Boxes that are farther away are drawn first."""
    from matplotlib.patches import Rectangle

    colours = article_colours(plan.articles)
    low, high = plan.corner_mm, plan.corner_mm + plan.size_mm
    depth = low[:, into] if away > 0 else -high[:, into]
    for box in np.argsort(-depth, kind="stable").tolist():
        size = plan.size_mm[box, across], plan.size_mm[box, 2]
        place = low[box, across], low[box, 2]
        axes.add_patch(Rectangle(place, *size, facecolor=colours[box], edgecolor="black", linewidth=0.5))
    left, right, top = low[:, across].min(), high[:, across].max(), high[:, 2].max()
    axes.add_patch(Rectangle((left, -80), right - left, 80, facecolor="0.75", edgecolor="0.4", linewidth=0.5))
    # all views have the scale of the widest view
    extent = high[:, :2].max(axis=0) - low[:, :2].min(axis=0)
    middle, reach = (left + right) / 2, extent.max() / 2 + 30
    axes.set_xlim((middle + reach, middle - reach) if name in MIRRORED else (middle - reach, middle + reach))
    axes.set_ylim(-100, top + 30)
    axes.set_aspect("equal", anchor="S")
    axes.set_axis_off()
    axes.set_title(name, fontsize=8)


def _rows_of(run: RunResults, plan: Plan) -> pd.DataFrame:
    """The rows about one plan in the summary of a chain."""
    assert run.summary is not None
    return run.summary[(run.summary["scope"] == ONE_PLAN) & (run.summary["plan_id"] == plan.plan_id)]


def _draw_legs(axes: Any, run: RunResults, plan: Plan) -> None:
    rows = _rows_of(run, plan)
    rows = rows[rows["remedy"] == AS_IS]
    names = ["whole way" if leg == WHOLE_WAY else printable_name(str(leg)) for leg in rows["leg"]]
    draw_intervals(axes, names, *(100 * rows[name] for name in ("share", "low", "high")))
    axes.set_xlim(-2, 102)
    axes.set_title("share of the worlds that reached a leg and stand after it, %; lines: 95 % intervals", loc="left")


def _facts(run: RunResults, plan: Plan) -> Iterator[str]:
    top = float((plan.corner_mm + plan.size_mm)[:, 2].max())
    simulation = run.info["config"]["simulation"]
    carrier = run.carrier
    name = carrier.value if isinstance(carrier, Carrier) else printable_name(carrier.name)
    on = "a slab as large as the load" if carrier is Carrier.FOOTPRINT else f"the carrier {name}"
    boxes = count_text(plan.n_boxes, "box", "boxes")
    yield f"{boxes}, {plan.mass_kg.sum():,.0f} kg, {top / MM_PER_M:.2f} m high, on {on}."
    slides_g = float(simulation["physics"]["box_friction"][0])
    tips_g = float(load_tipping_g(find_contacts(plan, DEFAULT_TOLERANCE_MM))[-1])
    limits = f"EN 12195-1 asks for {EN_12195_FORWARD_G:g} g forward, {EN_12195_SIDEWAYS_G:g} g sideways and rearward"
    begins = f"the load slides from {slides_g:.2f} g on and tips from {tips_g:.2f} g on"
    yield f"As one rigid body without film, {begins}; {limits}."
    yield _film(run, plan, slides_g)
    yield from _most_loaded(run, plan)


def _film(run: RunResults, plan: Plan, slides_g: float) -> str:
    """A text about the film: how many turns of film are around the load, and from which leg on; and the smallest
    acceleration at which the wrapped load slides (formula in docs/wrap.md).

    Args:
        slides_g: smallest acceleration at which the load slides without film, g. In g, this acceleration equals the
            coefficient of friction between load and carrier.
    """
    sim = Simulation.read(run.info["config"]["simulation"])
    legs = [leg for leg in run.info["config"]["sweep"]["legs"] if leg.get("wrap_turns") is not None]
    if not (legs or sim.wrap.holds):
        return "No film."
    turns = [f"{leg['wrap_turns']:g} turns from {printable_name(leg['name'])} on" for leg in legs]
    most = max([leg["wrap_turns"] for leg in legs], default=sim.wrap.turns)
    wrap = sim.wrap.changed(turns=most)
    text = (
        f"Film of {wrap.film_mm:g} mm width, with a tension of {wrap.force_n:g} N in each turn: "
        f"{', '.join(turns) or f'{most:g} turns'}."
    )
    if not wrap.holds:
        return text
    film = film_of(build_scene(plan, sim.changed(wrap=wrap)))
    weight_n = float(plan.mass_kg.sum()) * sim.physics.gravity_m_s2
    held_g = slides_g * (1 + wrap.hat_n / weight_n) + float(film.hold.sum()) / weight_n
    return f"{text} Held to its carrier by {most:g} turns of film, the load slides from {held_g:.2f} g on."


def _most_loaded(run: RunResults, plan: Plan) -> Iterator[str]:
    """A text about the box with the largest force on its top, in the worlds in which the plan arrives."""
    if not run.keeps_boxes:
        return
    worlds = run.worlds[run.worlds["plan_id"] == plan.plan_id]
    arrived = worlds.loc[(worlds["remedy"] == AS_IS) & (worlds["leg"] == WHOLE_WAY), ["plan_id", "variant"]]
    boxes = run.boxes.merge(arrived, on=["plan_id", "variant"])
    if boxes.empty:
        return
    rest = SUSTAINED if SUSTAINED in boxes else "rest_top_force_n"
    largest = boxes.groupby("box")[[rest, "max_top_force_n"]].median()
    box = int(largest["max_top_force_n"].idxmax())
    rest_n, peak_n = largest.loc[box]
    label = box_label(box, plan.articles[box])
    of = "medians of worlds that arrive"
    strength = float("nan") if plan.strength_n is None else float(plan.strength_n[box])
    bears = "" if np.isnan(strength) else f"; in a press it bears {strength:,.0f} N"
    yield f"Most loaded: box {label}, {rest_n:,.0f} N at rest, {peak_n:,.0f} N at the peak ({of}){bears}."


def _remedies(run: RunResults, plan: Plan) -> list[str]:
    rows = _rows_of(run, plan)
    rows = rows[(rows["leg"] == WHOLE_WAY) & (rows["remedy"] != AS_IS)]
    lines = []
    for row in rows.sort_values("gain", ascending=False, kind="stable").to_dict("records"):
        span = "" if pd.isna(row["gain_low"]) else f" ({100 * row['gain_low']:+.0f} to {100 * row['gain_high']:+.0f})"
        lines.append(f"{row['remedy']}: {percent(row['share'])}, {100 * row['gain']:+.0f} points{span}")
    return lines


def _assumed(run: RunResults) -> list[str]:
    """Texts about the assumptions: the errors, the legs of the chain, and the limits of the model."""
    sweep = run.info["config"]["sweep"]
    errors = ", ".join(f"{name} {_value(value)}" for name, value in sweep["axes"].items())
    lines = [f"Chain {printable_name(str(sweep['name']))}; {PLACING} with {errors or 'no errors'}."]
    lines += [f"{leg['name']}: {_leg_text(leg)}." for leg in sweep["legs"]]
    sim = Simulation.read(run.info["config"]["simulation"])
    walls = walls_of(sim.carrier, sim.walls).standing
    alone = (
        f"Walls stand on the {', '.join(walls)}; there are no" if walls else "The pallet stands alone, without walls,"
    )
    limits = sim.thresholds
    lines.append(
        f"{alone} straps or neighbours. Boxes are rigid. A world arrives if, after each leg, no box has fallen, "
        f"no box lies more than {MM_PER_M * limits.shift_m:g} mm from its planned place, and no box is tilted by more "
        f"than {limits.tilt_deg:g}°."
    )
    return [printable(line) for line in lines]


def _leg_text(leg: Mapping[str, Any]) -> str:
    events = []
    for event in leg["events"]:
        strengths = (("level", " {} g"), ("scale", " × {}"))
        strength = "".join(form.format(_range(event[name])) for name, form in strengths if event.get(name))
        events.append(f"{event['profile']}{strength} {event['direction']:g}°")
    film = [] if leg.get("wrap_turns") is None else [f"{leg['wrap_turns']:g} turns of film from here on"]
    return ", ".join([*events, *film]) or "nothing"


def _value(values: Sequence[Any] | Any) -> str:
    return ", ".join(f"{value:g}" if isinstance(value, float) else str(value) for value in values)


def _range(strength: float | Mapping[str, float]) -> str:
    return f"{strength['low']:g} to {strength['high']:g}" if isinstance(strength, Mapping) else f"{strength:g}"
