"""A story (the simulation of one plan) in words: the verdict in one line, the events in order of time, the reason of
the verdict, and which box failed first, when and why."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

import numpy as np

from petmjx.analysis.story import Story, sinks_of, thresholds_of
from petmjx.common.text import alternatives, box_in_words, count_text, printable_name
from petmjx.common.units import MM_PER_M, FloatArray
from petmjx.engines.knife_edges import is_same_edge, kept_edges, nearest_edge
from petmjx.engines.metrics import box_metrics
from petmjx.engines.mujoco import box_motion
from petmjx.engines.outcome_checks import contact_tilt_boxes, edges_again
from petmjx.engines.verdict import Flag, Reason, Verdict
from petmjx.options.simulation import Check
from petmjx.options.thresholds import FAILURES, MOTION_REASONS
from petmjx.plans.plan_warnings import DEFAULT_TOLERANCE_MM, gaps_mm
from petmjx.world.building_edges import steps_beyond
from petmjx.world.job import FORCE

MOST_DROPS: Final = 8
"""Largest number of boxes whose drops are listed as separate events."""


class Event(NamedTuple):
    """Something that happened in a simulation. ``is_first_sign`` is true for the event in which the first box crosses a
    limit of the verdict."""

    time_s: float
    what: str
    is_first_sign: bool = False


def headline(story: Story) -> str:
    """One line with the verdict, its reason, the first box that failed, and the time of the failure."""
    outcome = story.outcome
    text = outcome.verdict.value + (f" by {outcome.reason.value}" if outcome.reason else "")
    if outcome.verdict is Verdict.STABLE or outcome.reason is Reason.SHIFT:
        text += ", still moving" if outcome.flags & Flag.MOVING else ""
    if outcome.verdict is Verdict.STABLE:
        text += ", leans" if outcome.flags & Flag.LEANS else ""
        return text + ("" if math.isnan(outcome.margin) else f", margin {outcome.margin:.2f}")
    if outcome.culprit < 0:
        return text
    time_text = "" if math.isnan(outcome.first_sign_s) else f", at {outcome.first_sign_s:.2f} s"
    return f"{text}: first {box_name(story, outcome.culprit)}{time_text}"


def box_name(story: Story, box: int) -> str:
    """The name of a box, such as "box 22 (candy-00100723)". The number is the box's index in packing order, from 0. The
    text in brackets is the box's article, or its item id if it has no article."""
    return box_in_words(box, story.plan.articles[box] or story.plan.item_ids[box])


def _subject(story: Story, box: int) -> str:
    """The name of a box at the beginning of a sentence: "Box 22 (candy-00100723)"."""
    return "B" + box_name(story, box)[1:]


def events(story: Story) -> list[Event]:
    """The events of a story in order of time. The last event is the end of the simulation. If more than ``MOST_DROPS``
    boxes drop, one event stands for all later drops."""
    timeline = [*_placements(story), *_shaking_events(story), *_first_sign(story), *_drops(story)]
    timeline.sort(key=lambda event: event.time_s)
    end_s = max(story.outcome.sim_time_s, float(story.history.time_s[-1]))
    return [*timeline, Event(end_s, f"End: {_last_state(story)}")]


def _placements(story: Story) -> Iterator[Event]:
    history = story.history
    grown = np.flatnonzero(np.diff(history.n_placed, prepend=0) > 0)
    if not len(grown):
        return
    placed, first, last = int(history.n_placed[-1]), grown[0], grown[-1]
    of_total = "" if placed == story.plan.n_boxes else f" of {story.plan.n_boxes}"
    if len(grown) == 1:
        yield Event(float(history.time_s[first]), f"{count_text(placed, 'box', 'boxes')}{of_total} placed at once")
        return
    yield Event(float(history.time_s[first]), f"{_subject(story, 0)} is placed, the first of {story.plan.n_boxes}")
    yield Event(float(history.time_s[last]), f"{_subject(story, placed - 1)} is placed, number {placed}{of_total}")


def _shaking_events(story: Story) -> Iterator[Event]:
    if story.drive is None:
        return
    pushed = np.flatnonzero(np.abs(story.history.drive).max(axis=1) > 0)
    if len(pushed):
        excitation = story.drive.excitation
        quantity = "forces on the carrier" if excitation.kind == FORCE else "accelerations of the carrier"
        name = (
            f"{printable_name(excitation.name)}, scale {story.drive.scale:g}, {math.degrees(story.drive.yaw_rad):.0f}°"
        )
        yield Event(float(story.history.time_s[pushed[0]]), f"Shaking begins: {quantity} ({name})")
        yield Event(float(story.history.time_s[pushed[-1]]), "Shaking ends")


def _first_sign(story: Story) -> Iterator[Event]:
    if story.outcome.culprit >= 0 and math.isfinite(story.outcome.first_sign_s):
        yield Event(story.outcome.first_sign_s, first_box_in_words(story), is_first_sign=True)


def _drops(story: Story) -> Iterator[Event]:
    times = story.outcome.boxes.drop_s
    dropped = [int(box) for box in np.argsort(times, kind="stable") if np.isfinite(times[box])]
    for box in dropped[:MOST_DROPS]:
        yield Event(float(times[box]), f"{_subject(story, box)} has dropped")
    if len(dropped) > MOST_DROPS:
        further = count_text(len(dropped) - MOST_DROPS, "further box", "further boxes")
        yield Event(float(times[dropped[MOST_DROPS]]), f"{further} dropped from this time on")


def _last_state(story: Story) -> str:
    outcome = story.outcome
    placed = slice(outcome.n_placed)
    moved = np.abs(outcome.boxes.shift_m[placed])
    largest = f"largest shift {MM_PER_M * np.nanmax(moved):.1f} mm" if np.isfinite(moved).any() else ""
    return ", ".join(part for part in (headline(story).partition(":")[0], largest) if part)


MOST_LEANING: Final = 3
"""Largest number of boxes that a line about leaning boxes names."""


def reason_in_words(story: Story) -> str:
    """A sentence with the reason of the verdict, without full stop."""
    outcome = story.outcome
    deeds = _deeds(story)
    if outcome.reason is Reason.NONE:
        words = f"no box {alternatives(reversed(deeds.values()))}"
    elif outcome.reason is Reason.DROP:
        n_dropped = int(outcome.boxes.dropped[: outcome.n_placed].sum())
        words = f"{'a box' if n_dropped == 1 else f'{n_dropped} boxes'} {deeds[outcome.reason]}"
    else:
        words = f"a box {deeds[outcome.reason]}" if outcome.reason in deeds else outcome.reason.words
    return f"{words}: {printable_name(outcome.message)}" if outcome.message else words


def _deeds(story: Story) -> dict[Reason, str]:
    """Reason of an unstable world → what a box did, such as "tilted by more than 20°"."""
    units, limits = {metric.attribute: metric.unit for metric in box_metrics()}, thresholds_of(story)
    return {
        reason: reason.words.format(**{name: _with_unit(getattr(limits, name), units[metric])} if name else {})
        for reason, metric, name, *_ in FAILURES
    }


def _with_unit(value: float, unit: str) -> str:
    """A value with its unit, which is one of the units of metrics."""
    return {"m": _mm(value), "deg": f"{value:g}°"}.get(unit, f"{value:,g} {unit.replace('^2', '²')}")


def notes_in_words(story: Story) -> list[str]:
    """Warnings for the reader, one line each: the story's note, and lines with reasons why the verdict is doubtful,
    such as boxes that still move."""
    outcome = story.outcome
    notes = [story.note] if story.note else []
    if outcome.verdict is Verdict.INVALID:
        return notes
    if outcome.flags & Flag.MOVING:
        notes.append(
            "Boxes still moved after the longest wait: the verdict may depend on how long the world is simulated."
        )
    if outcome.flags & Flag.KNIFE_EDGE:
        notes.append(_knife_edge(story))
    notes += _hangs_over(story)
    if outcome.flags & Flag.LEANS:
        notes.append(_leans(story))
    if outcome.flags & Flag.NOT_PLACED:
        notes.append("The robot's hand found no room for a box, and released the box beside its planned place.")
    if outcome.flags & Flag.TIMESTEP:
        notes.append("A simulation with half the timestep gives another verdict.")
    return notes


def _knife_edge(story: Story) -> str:
    """A sentence about the load that acts nearest to the edge of its support, inside or outside. The sentence names the
    box, the distance of the load from the edge, and the time."""
    outcome = story.outcome
    table_edges = list(kept_edges(vars(outcome), outcome.boxes.plan_edge_m, outcome.boxes.rest_edge_m))
    recomputed_edges = list(edges_again(story.scene, outcome))
    nearest = nearest_edge(table_edges, outcome.verdict)
    if nearest is None:  # no distance in the tables set the flag; the tables lack the distance of a box's own weight
        nearest = nearest_edge(recomputed_edges, outcome.verdict) or nearest_edge([*table_edges, *recomputed_edges])
    else:  # unlike the tables, the recomputed edges tell whether the load is the box's own weight
        nearest = next((edge for edge in recomputed_edges if is_same_edge(edge, nearest)), nearest)
    if nearest is None:
        return "A load acts at the edge of its support: a tenth of a millimetre may change the verdict."
    time_text = nearest.when + (f", once {box_name(story, nearest.step)} is placed" if nearest.step >= 0 else "")
    load = "own weight" if nearest.own_weight else "load"
    of_box = f" (the {load} of {box_name(story, nearest.box)})" if nearest.box >= 0 else ""
    return (
        f"A load acts within {MM_PER_M * abs(nearest.edge_m):.2g} mm of the edge of its support ({time_text}): a tenth "
        f"of a millimetre may change the verdict{of_box}."
    )


def _hangs_over(story: Story) -> list[str]:
    """A sentence about a box that would fall while the stack is built, because its load acts beyond an edge. If a box
    that is placed later would hold it down, the sentence names that box, too."""
    outcome = story.outcome
    if not outcome.build_edge_m < 0:
        return []
    box = outcome.build_edge_box
    first_step, counterweight = steps_beyond(story.scene, box)
    if first_step < 0:
        return []
    overhang = (
        f"While the plan is built, box {box} hangs too far over the edge of its support from step {first_step} on"
    )
    if counterweight < 0:
        return [f"{overhang}; no box that is placed later holds it down."]
    return [f"{overhang}; its counterweight, box {counterweight}, comes too late."]


def _leans(story: Story) -> str:
    """A sentence about boxes that are tilted or lie too low, although the stack stands."""
    boxes = story.outcome.boxes
    tilt, lower_m = box_motion.tilt_deg(boxes.quat), -boxes.shift_m[:, 2]
    leaning = contact_tilt_boxes(story.outcome).tolist()
    listed = [
        f"box {box} ({printable_name(story.plan.articles[box])}) is tilted by {tilt[box]:.1f}° and lies "
        f"{_mm(max(lower_m[box], 0.0))} lower than planned"
        for box in sorted(leaning, key=lambda box: -tilt[box])[:MOST_LEANING]
    ]
    more_text = f", and {len(leaning) - len(listed)} more" if len(leaning) > len(listed) else ""
    return f"The pallet stands, but leans: {'; '.join(listed)}{more_text}."


def first_box_in_words(story: Story) -> str:
    """A sentence about the first box that failed: which box, when and why; "" if no box failed."""
    box = story.outcome.culprit
    if box < 0:
        return ""
    time_text = "" if math.isnan(story.outcome.first_sign_s) else f" at {story.outcome.first_sign_s:.2f} s"
    gap_mm = _gap_mm(story, box)
    planned = f"was planned {_mm(gap_mm / MM_PER_M)} in the air and " if gap_mm > DEFAULT_TOLERANCE_MM else ""
    deed = "" if story.outcome.reason in MOTION_REASONS else _deeds(story).get(story.outcome.reason, "")
    signs = deed or " and ".join(_signs(story, box)) or ("fell" if planned else "crossed a limit")
    return f"{_subject(story, box)} {planned}failed first:{time_text} it {signs}."


def _gap_mm(story: Story, box: int) -> float:
    """The gap in the plan between the bottom of a box and the bodies that are below it when the box is placed, mm."""
    in_order = story.options.get("check") != Check.STATIC
    return float(gaps_mm(story.plan.corner_mm, story.plan.size_mm, in_order)[box])


def _signs(story: Story, box: int) -> list[str]:
    """A text for each limit that the box had crossed when the first box of the world failed, such as "was tilted by
    20.1° (limit 20°)". Values between two frames are interpolated."""
    limits = thresholds_of(story)
    pos, quat = (_at(story, values[:, box])[None] for values in (story.history.pos, story.history.quat))
    if not np.isfinite(pos).all():
        return []
    sinks = sinks_of(story)
    box_sinks = None if sinks is None else sinks[[box]]
    shift = float(np.abs(box_motion.shift(pos, story.scene.target[[box]], limits.shift_floor_m, box_sinks)).max())
    tilt = float(box_motion.tilt_deg(quat)[0])
    signs = []
    if box_motion.has_dropped(pos, quat, story.scene.half_size[[box]], limits)[0]:
        signs.append("had dropped")
    if tilt > limits.tilt_deg:
        signs.append(f"was tilted by {tilt:.1f}° (limit {limits.tilt_deg:g}°)")
    if shift > limits.shift_m:
        signs.append(f"had shifted by {_mm(shift)} (limit {_mm(limits.shift_m)})")
    return signs


def _at(story: Story, values: FloatArray) -> FloatArray:
    """(k,) ``values`` at the time of the first failure, interpolated between frames. ``values`` has the shape (f, k)
    for f frames."""
    time_s, sign_s = story.history.time_s, story.outcome.first_sign_s
    return np.array([np.interp(sign_s, time_s, column) for column in values.T])


def how_it_was_simulated(story: Story) -> list[tuple[str, str]]:
    """Pairs (name, value) about the simulation: the settings on which the verdict depends most (engine, physics, check,
    schedule, carrier, solver), what shook the pallet, the values of the variant, and the simulated time."""
    options, outcome = story.options, story.outcome
    physics = options.get("physics", "")
    facts = [("engine", story.engine), ("physics", _option_name(physics))]
    facts += [(name, _option_name(options[name])) for name in ("check", "schedule", "carrier") if name in options]
    facts.append(("solver", outcome.solver if outcome.attempt == 1 else f"{outcome.solver}, attempt {outcome.attempt}"))
    if story.drive is not None:
        drive = story.drive
        facts.append(("shaken by", f"{drive.excitation.name} × {drive.scale:g}, {math.degrees(drive.yaw_rad):g}°"))
    facts += [(printable_name(str(name)), _value(value)) for name, value in story.values.items() if value is not None]
    facts.append(("simulated", f"{outcome.sim_time_s:.2f} s in {outcome.n_steps:,} steps"))
    return [(name, value) for name, value in facts if value]


def _option_name(option: object) -> str:
    """The value of an option as text. If the value is a record, the text is the record's name."""
    return printable_name(str(option.get("name") if isinstance(option, Mapping) else option))


def _value(value: object) -> str:
    """A value of a variant, as text."""
    return f"{value:.4g}" if isinstance(value, float) else printable_name(str(value))


def _mm(length_m: float) -> str:
    return f"{MM_PER_M * length_m:.3g} mm" if length_m < 0.1 else f"{MM_PER_M * length_m:,.0f} mm"
