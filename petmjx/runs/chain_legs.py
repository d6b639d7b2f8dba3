"""The legs of a transport chain: their tables in sweep files, and the outcome of a simulation after a leg.

A chain is the journey of a pallet: its boxes are placed, and the pallet is then shaken in several parts, called legs.
In sweep files, the tables ``[[legs]]`` and ``[[remedies]]`` define a chain. docs/chains.md explains chains to users.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, Final, Self

import numpy as np
from pydantic import Field, StrictFloat, model_validator

from petmjx.common.checked_records import CheckedRecord, complaint, similar, within
from petmjx.common.errors import InputError
from petmjx.common.text import printable_name
from petmjx.common.units import seconds_to_steps
from petmjx.engines.metrics import BoxMetrics, box_metrics
from petmjx.engines.verdict import Outcome, Verdict
from petmjx.options.walls import Side
from petmjx.runs.sweep_axes import Direction, Range, Strengths, Turn
from petmjx.world.job import ACCELERATION, Drive, Excitation
from petmjx.world.profiles.profile import Profile, Strength
from petmjx.world.profiles.profile_registry import resolve
from petmjx.world.variants import DriveSpec, LegSpec

PLACING: Final = "placing"
"""Name of the first part of a chain, in which boxes are placed and come to rest. The first leg begins when the boxes
are at rest."""

AS_IS: Final = ""
"""Value of the columns ``remedy`` for the unchanged chain. For a changed chain, these columns have the name of the
remedy."""

MOST_LEGS: Final = 100

_EDGES: Final = ("plan_edge_m", "plan_edge_box", "build_edge_m", "build_edge_box", "build_edge_step")
"""Fields of an outcome that hold the smallest distances of loads from the edges of their supports: in the plan, and
while the pallet is built. A leg does not change these fields."""

Name = Annotated[str, Field(max_length=100)]
Factor = Annotated[StrictFloat, Field(gt=0), within(0, 100)]


class Event(CheckedRecord):
    """One profile (motion of the carrier) that shakes the pallet during a leg."""

    profile: Name = Field(description="name of a profile of accelerations, or of a family of such profiles")
    direction: Direction = Field(0.0, description="angle by which the profile is turned from +x towards +y, degrees")
    level: Strengths | None = Field(
        None, description="level of the profile, g; or {from, to}: a level between the two is drawn for each world"
    )
    scale: Strengths | None = Field(
        None, description="factor on the profile; or {from, to}: a factor between the two is drawn for each world"
    )

    @property
    def drawn(self) -> bool:
        """Whether the strength of the profile differs from world to world."""
        return isinstance(self.level, Range) or isinstance(self.scale, Range)


class Leg(CheckedRecord):
    """One table ``[[legs]]``. A leg without events only changes the film around the pallet or opens doors of the
    carrier."""

    name: Name = Field(description="name of the leg in the results")
    events: tuple[Event, ...] = Field(
        (), max_length=MOST_LEGS, description="profiles that shake the pallet during the leg, one after the other"
    )
    pause_s: Annotated[StrictFloat, Field(ge=0), within(0, 60)] = Field(
        1.0, description="time between the end of an event and the beginning of the next one, s"
    )
    wrap_turns: Turn | None = Field(None, description="number of turns of film around the pallet from this leg on")
    open_walls: tuple[Side, ...] = Field(
        (),
        description="walls of the carrier that are opened like doors at this leg and stay open: left, right, front, "
        "back",
    )


class Remedy(CheckedRecord):
    """One table ``[[remedies]]``: a change of one leg. The changed and the unchanged chain are simulated with the same
    random numbers."""

    name: Name = Field(description="name of the remedy in the results")
    leg: Name = Field(description="name of the leg that is changed")
    wrap_turns: Turn | None = Field(
        None, description="number of turns of film from this leg on, instead of the leg's own number"
    )
    factor: Factor | None = Field(None, description="factor on the levels and scales of the leg's events")

    @model_validator(mode="after")
    def _changes_something(self) -> Self:
        if self.wrap_turns is None and self.factor is None:
            raise ValueError("changes nothing: give wrap_turns or factor")
        return self


def check_name(name: str, *path: str | int) -> None:
    """Raise a ValidationError if a name has no visible characters, or has characters, such as line breaks, that would
    spoil tables."""
    if not name.strip() or not name.isprintable():
        raise complaint(
            f": '{printable_name(name)}' must have visible characters, and no control characters such as line breaks",
            *path,
            "name",
        )


def check_chain(legs: Sequence[Leg], remedies: Sequence[Remedy], defined: Mapping[str, Profile]) -> None:
    """Check that the tables of a chain fit together. A validator calls this function.

    Args:
        defined: name → profile, for the profiles that the file defines.

    Raises:
        ValidationError: a table is wrong. The message names the table and the field.
    """
    names = [leg.name for leg in legs]
    for number, name in enumerate(names):
        check_name(name, "legs", number)
        if name == PLACING or name in names[:number]:
            conflict = "the name of the part before the first leg" if name == PLACING else "another leg"
            raise complaint(f": {name!r} is already {conflict}", "legs", number, "name")
    if legs and not any(leg.events or leg.open_walls for leg in legs):
        raise complaint("have no events and open no walls: nothing happens to the pallet", "legs")
    for number, leg in enumerate(legs):
        for place, event in enumerate(leg.events):
            _check_event(event, defined, ("legs", number, "events", place))
    if remedies and not legs:
        raise complaint("need [[legs]], because each remedy changes a leg", "remedies")
    for number, remedy in enumerate(remedies):
        check_name(remedy.name, "remedies", number)
        if remedy.name in [other.name for other in remedies[:number]]:
            raise complaint(f": {remedy.name!r} is already another remedy", "remedies", number, "name")
        if remedy.leg not in names:
            raise complaint(f": no leg {remedy.leg!r}{similar(remedy.leg, names)}", "remedies", number, "leg")
        leg = legs[names.index(remedy.leg)]
        if remedy.factor is not None and not any(_has_strength(event, defined) for event in leg.events):
            text = f": no event of leg {remedy.leg!r} has a level or scale to change"
            raise complaint(text, "remedies", number, "factor")


def _has_strength(event: Event, defined: Mapping[str, Profile]) -> bool:
    return any(profile.strength is not Strength.ANGLE for profile in resolve(event.profile, defined))


def _check_event(event: Event, defined: Mapping[str, Profile], path: tuple[str | int, ...]) -> None:
    try:
        profiles = resolve(event.profile, defined)
    except InputError as error:
        raise complaint(f": {error}", *path, "profile") from None
    for profile in profiles:
        if profile.kind != ACCELERATION:
            text = f": {profile.name!r} pushes the carrier; legs need profiles of accelerations"
            raise complaint(text, *path, "profile")
        for name in (Strength.LEVEL, Strength.SCALE):
            if getattr(event, name) is not None and profile.strength is not name:
                has = "an angle of its own" if profile.strength is Strength.ANGLE else f"a {profile.strength}"
                raise complaint(f"contradicts profile {profile.name!r}, which has {has}", *path, name)
            if isinstance(drawn := getattr(event, name), Range) and not drawn.continuous:
                raise complaint("is drawn at random between 'from' and 'to': leave out 'step' and 'count'", *path, name)
        if profile.strength is Strength.LEVEL and event.level is None:
            raise complaint(f"is missing: profile {profile.name!r} needs a level in g", *path, "level")


def profiles_of_legs(legs: Sequence[Leg], defined: Mapping[str, Profile]) -> dict[str, Profile]:
    """Name → profile, for the profiles of all legs."""
    events = (event for leg in legs for event in leg.events)
    return {profile.name: profile for event in events for profile in resolve(event.profile, defined)}


def legs_with(legs: Sequence[Leg], remedy: Remedy | None, defined: Mapping[str, Profile]) -> tuple[LegSpec, ...]:
    """The legs that shake the pallet or open walls, changed as the remedy says. Each returned leg has the number of
    turns of film that are around the pallet during the leg."""
    specs: list[LegSpec] = []
    turns: float | None = None
    open_walls: tuple[Side, ...] = ()
    for leg in legs:
        turns, factor = (turns if leg.wrap_turns is None else leg.wrap_turns), 1.0
        open_walls = tuple(dict.fromkeys([*open_walls, *leg.open_walls]))
        if remedy is not None and remedy.leg == leg.name:
            turns = turns if remedy.wrap_turns is None else remedy.wrap_turns
            factor = 1.0 if remedy.factor is None else remedy.factor
        drives = []
        for event in leg.events:
            strength = next((value for value in (event.level, event.scale) if value is not None), 1.0)
            for profile in resolve(event.profile, defined):
                by = 1.0 if profile.strength is Strength.ANGLE else factor
                low, high = (strength.low, by * strength.high) if isinstance(strength, Range) else (strength, None)
                drives.append(DriveSpec(profile.name, by * low, event.direction, high))
        if drives or leg.open_walls:
            pause_s = 0.0 if len(drives) == 1 else leg.pause_s
            specs.append(LegSpec(leg.name, tuple(drives), pause_s, turns, open_walls))
    return tuple(specs)


def in_a_row(name: str, drives: Sequence[Drive], pause_s: float, timestep_s: float) -> Excitation:
    """Join several motions of the carrier into one excitation (an array of samples), with pauses between the motions.
    Without motions, the excitation is one pause."""
    pause = np.zeros((seconds_to_steps(pause_s, timestep_s), 3))
    if not drives:
        return Excitation(name, ACCELERATION, pause if len(pause) else np.zeros((1, 3)))
    # the total mass does not matter, because it affects only forces, and these drives are accelerations
    parts = [part for drive in drives for part in (drive.rows(total_mass=0.0), pause)]
    return Excitation(name, ACCELERATION, np.concatenate(parts[:-1]))


def with_sustained_force(leg: Outcome, before: BoxMetrics) -> Outcome:
    """The outcome of a leg, to which ``sustained_top_force_n`` is added: the largest force at rest on the top of each
    box after this leg or any earlier part of the journey.

    Args:
        before: metrics after the previous leg, or after the placement if this is the first leg.
    """
    forces_n = before.sustained_top_force_n, before.rest_top_force_n, leg.boxes.rest_top_force_n
    return replace(leg, boxes=replace(leg.boxes, sustained_top_force_n=np.fmax.reduce(forces_n)))


def after(before: Outcome, leg: Outcome, timestep_s: float) -> Outcome:
    """The outcome of a world after one more leg. Times are counted from the placement of the first box.

    Metrics that are largest values, such as the largest force at rest (``sustained_top_force_n``), are the largest
    values of the journey so far. The poses of the boxes and ``rest_top_force_n`` are the values at the end of the leg.

    Args:
        before: the outcome after the previous leg, in which the pallet still stood.
        leg: the outcome of this leg alone, whose times are counted from the end of the placement.
    """
    since_s = before.n_steps * timestep_s
    leg = with_sustained_force(leg, before.boxes)
    boxes, old = leg.boxes, before.boxes
    largest = {
        metric.attribute: np.fmax(getattr(old, metric.attribute), getattr(boxes, metric.attribute))
        for metric in box_metrics()
        if metric.is_peak
    }
    history = leg.history
    if history is not None and before.history is not None:
        history = before.history.then(replace(history, time_s=history.time_s + since_s))
    edges: dict[str, Any] = {}
    if leg.verdict is Verdict.STABLE:  # distances of loads from edges in the plan are the same after every leg
        largest["plan_edge_m"] = old.plan_edge_m
        edges = {name: getattr(before, name) for name in _EDGES}
    return replace(
        leg,
        **edges,
        boxes=replace(boxes, **largest, drop_s=boxes.drop_s + since_s),
        first_sign_s=leg.first_sign_s + since_s,
        sim_time_s=leg.sim_time_s + since_s,
        n_steps=before.n_steps + leg.n_steps,
        flags=before.flags | leg.flags,
        margin=leg.margin if leg.verdict is Verdict.INVALID else min(before.margin, leg.margin),
        history=history,
    )
