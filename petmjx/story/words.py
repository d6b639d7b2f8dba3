"""A story in sentences: the verdict and its reason, which box failed first, when and by what."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from petmjx.basics.text import box_in_words, shown
from petmjx.basics.units import MM_PER_M, STANDARD_GRAVITY, FloatArray
from petmjx.engines.looked_at import NEAR_M as _NEAR_M
from petmjx.engines.looked_at import leaning_boxes
from petmjx.metrics import motion_np
from petmjx.options.config import Check, Thresholds
from petmjx.plans.warnings import DEFAULT_TOLERANCE_MM, gaps_mm
from petmjx.story.tell import Story
from petmjx.verdict import Flag, Reason, Verdict
from petmjx.world.building import steps_beyond
from petmjx.world.give import sinks_m

MOST_LEANING: Final = 3
"""Most boxes that a line about leaning names."""

REASONS: Final = {
    Reason.NONE: "no box shifted by more than {shift}, tilted by more than {tilt:g}° or dropped",
    Reason.NONFINITE: "the simulation gave numbers that are not finite",
    Reason.OVERFLOW: "there were more contacts than the engine had room for",
    Reason.EXPLOSION: "accelerations were impossibly large before any box had moved",
    Reason.OUT_OF_MEMORY: "the device had too little memory",
    Reason.SINKING: "boxes sank into what bears them",
    Reason.FAILED: "the simulation failed",
    Reason.TIMEOUT: "the simulation took longer than its time limit",
    Reason.DROP: "{boxes} dropped",
    Reason.TILT: "a box tilted by more than {tilt:g}°",
    Reason.SHIFT: "a box shifted by more than {shift}",
}
"""Reason → a sentence without its full stop. In braces: the thresholds, and the boxes that dropped."""


def thresholds_of(story: Story) -> Thresholds:
    """The limits that the verdict was judged by."""
    return Thresholds(**story.options.get("thresholds", {}))


def sinks_of(story: Story) -> FloatArray | None:
    """(n,) how far each box comes down by design, m; None: not at all."""
    physics = story.options.get("physics", {})
    gravity = physics.get("gravity_m_s2", STANDARD_GRAVITY) if isinstance(physics, Mapping) else STANDARD_GRAVITY
    return sinks_m(story.scene, gravity)


def reason_in_words(story: Story) -> str:
    """Why the verdict is what it is, as a sentence without its full stop."""
    outcome, limits = story.outcome, thresholds_of(story)
    dropped = int(outcome.boxes.dropped[: outcome.n_placed].sum())
    boxes = "a box" if dropped == 1 else f"{dropped} boxes"
    words = REASONS.get(outcome.reason, str(outcome.reason))
    words = words.format(shift=_mm(limits.shift_m), tilt=limits.tilt_deg, boxes=boxes)
    return f"{words}: {shown(outcome.message)}" if outcome.message else words


def notes_in_words(story: Story) -> list[str]:
    """Warnings for the reader, one line each: the story's note, and flags that make the verdict doubtful."""
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
        notes.append("The hand found no room for a box: it let go away from the box's place.")
    if outcome.flags & Flag.TIMESTEP:
        notes.append("At half the timestep the verdict differs.")
    return notes


def _knife_edge(story: Story) -> str:
    """The load that is nearest to an edge, on either side: which box's, how near, and when."""
    outcome = story.outcome
    nearest: list[tuple[float, int, str]] = []
    for of_boxes, least_m, box, when in (
        (outcome.boxes.plan_edge_m, outcome.plan_edge_m, outcome.plan_edge_box, "by the plan"),
        (outcome.boxes.rest_edge_m, outcome.rest_edge_m, outcome.rest_edge_box, "at rest"),
        (np.array([]), outcome.build_edge_m, outcome.build_edge_box, "while it is built"),
    ):
        nearest += [(abs(edge_m), number, when) for number, edge_m in enumerate(of_boxes.tolist())]
        nearest.append((abs(least_m), box, when))
    edge_m, box, when = min((edge for edge in nearest if not math.isnan(edge[0])), default=(math.nan, -1, ""))
    load = f" of box {box} ({shown(story.plan.articles[box])})" if box >= 0 else ""
    if not edge_m <= _NEAR_M:  # of a box's own weight, or after a placement, that is the nearest of none
        return "A load acts at the edge of what bears it: a tenth of a millimetre may change the verdict."
    return (
        f"A load acts at the edge of what bears it, within {MM_PER_M * edge_m:.2g} mm, {when}: "
        f"a tenth of a millimetre may change the verdict{' (the load' + load + ')' if load else ''}."
    )


def _hangs_over(story: Story) -> list[str]:
    """The box that hangs over while a plan is built, and the box that comes too late to hold it."""
    outcome = story.outcome
    if not outcome.build_edge_m < 0:
        return []
    box = outcome.build_edge_box
    begins, held = steps_beyond(story.scene, box)
    if begins < 0:
        return []
    overhang = f"While the plan is built, box {box} hangs over from step {begins} on"
    if held < 0:
        return [f"{overhang}; nothing that is placed later holds it."]
    return [f"{overhang}; its counterweight, box {held}, comes too late."]


def _leans(story: Story) -> str:
    """Which boxes lie otherwise than planned."""
    boxes = story.outcome.boxes
    tilt, lower_m = motion_np.tilt_deg(boxes.quat), -boxes.shift_m[:, 2]
    leaning = leaning_boxes(story.outcome).tolist()
    listed = [
        f"box {box} ({shown(story.plan.articles[box])}) is tilted by {tilt[box]:.1f}° and lies "
        f"{_mm(max(lower_m[box], 0.0))} lower than planned"
        for box in sorted(leaning, key=lambda box: -tilt[box])[:MOST_LEANING]
    ]
    more = f", and {len(leaning) - len(listed)} more" if len(leaning) > len(listed) else ""
    return f"It stands, but leans: {'; '.join(listed)}{more}."


def first_box_in_words(story: Story) -> str:
    """Which box failed first, when and why, as a sentence; "" where none did."""
    box = story.outcome.culprit
    if box < 0:
        return ""
    when = "" if math.isnan(story.outcome.first_sign_s) else f" at {story.outcome.first_sign_s:.2f} s"
    name = "B" + box_in_words(box, story.plan.articles[box] or story.plan.item_ids[box])[1:]
    gap_mm = _gap_mm(story, box)
    planned = f"was planned {_mm(gap_mm / MM_PER_M)} in the air and " if gap_mm > DEFAULT_TOLERANCE_MM else ""
    signs = " and ".join(_signs(story, box)) or "crossed a limit"
    return f"{name} {planned}failed first:{when} it {signs}."


def _gap_mm(story: Story, box: int) -> float:
    """How far above what is there at its placement a box is planned, mm."""
    in_order = story.options.get("check") != Check.STATIC
    return float(gaps_mm(story.plan.corner_mm, story.plan.size_mm, in_order)[box])


def _signs(story: Story, box: int) -> list[str]:
    """The limits that a box was beyond at the first sign, each with how far; between two frames on a straight line."""
    limits = thresholds_of(story)
    pos, quat = (_at(story, values[:, box])[None] for values in (story.history.pos, story.history.quat))
    if not np.isfinite(pos).all():
        return []
    sinks = sinks_of(story)
    box_sinks = None if sinks is None else sinks[[box]]
    shift = float(np.abs(motion_np.shift(pos, story.scene.target[[box]], limits.shift_floor_m, box_sinks)).max())
    tilt = float(motion_np.tilt_deg(quat)[0])
    signs = []
    if motion_np.has_dropped(pos, quat, story.scene.half_size[[box]], limits)[0]:
        signs.append("had dropped")
    if tilt > limits.tilt_deg:
        signs.append(f"was tilted by {tilt:.1f}° (limit {limits.tilt_deg:g}°)")
    if shift > limits.shift_m:
        signs.append(f"had shifted by {_mm(shift)} (limit {_mm(limits.shift_m)})")
    return signs


def _at(story: Story, values: FloatArray) -> FloatArray:
    """(k,) values at the first sign, of (f, k) values in frames."""
    time_s, sign_s = story.history.time_s, story.outcome.first_sign_s
    return np.array([np.interp(sign_s, time_s, column) for column in values.T])


def how_it_was_simulated(story: Story) -> list[tuple[str, str]]:
    """Names and values of what the answer depends on most: engine, physics, check, schedule, carrier, solver."""
    options, outcome = story.options, story.outcome
    physics = options.get("physics", "")
    facts = [("engine", story.engine), ("physics", _named(physics))]
    facts += [(name, _named(options[name])) for name in ("check", "schedule", "carrier") if name in options]
    facts.append(("solver", outcome.solver if outcome.attempt == 1 else f"{outcome.solver}, attempt {outcome.attempt}"))
    if story.drive is not None:
        drive = story.drive
        facts.append(("shaken by", f"{drive.excitation.name} × {drive.scale:g}, {math.degrees(drive.yaw_rad):g}°"))
    facts += [(shown(str(name)), _value(value)) for name, value in story.values.items() if value is not None]
    facts.append(("simulated", f"{outcome.sim_time_s:.2f} s in {outcome.n_steps:,} steps"))
    return [(name, value) for name, value in facts if value]


def _named(option: object) -> str:
    """An option's value; of one that is a table, its name."""
    return shown(str(option.get("name") if isinstance(option, Mapping) else option))


def _value(value: object) -> str:
    """The value of a variant's column."""
    return f"{value:.4g}" if isinstance(value, float) else shown(str(value))


def _mm(length_m: float) -> str:
    return f"{MM_PER_M * length_m:.3g} mm" if length_m < 0.1 else f"{MM_PER_M * length_m:,.0f} mm"
