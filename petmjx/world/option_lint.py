"""Notes for the user on options that have no effect, and on options and plans that are probably wrong."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import Final

import numpy as np

from petmjx.common.errors import InputError
from petmjx.common.text import count_text, printable_name, three_digits
from petmjx.common.units import MM_PER_M, FloatArray, mm_to_m
from petmjx.options.carriers import Carrier
from petmjx.options.physics import Physics
from petmjx.options.placing import Placing, Way
from petmjx.options.simulation import Attempts, Check, Schedule, Simulation
from petmjx.options.walls import Side, Walls
from petmjx.options.wrap import Wrap
from petmjx.plans.plan import Plan
from petmjx.plans.plan_warnings import DEFAULT_TOLERANCE_MM, MOST_NAMED
from petmjx.world.carrier_boards import has_walls, pallet
from petmjx.world.scene import build_scene, carrier_of
from petmjx.world.supports import bearing_of
from petmjx.world.surface_pairs import check_surfaces

_USES: Final = {
    Way.EXACT: (),
    Way.DROP: ("height_mm",),
    Way.HAND: ("height_mm", "side_mm", "speed_m_s", "force_n"),
    Way.TINES: ("height_mm", "side_mm", "speed_m_s", "force_n", "tines_mm"),
}
"""Way of placing boxes → the fields of ``Placing`` that have an effect if boxes are placed in this way."""

_OF_SLABS: Final = ("floor_z_m", "carrier_half_height_m", "carrier_mass_kg")
"""Fields of ``Physics`` that have no effect if the carrier is made of boards."""

_AXES: Final = {
    "placing_height_mm": "height_mm",
    "placing_side_mm": "side_mm",
    "placing_speed_m_s": "speed_m_s",
    "placing_force_n": "force_n",
    "tines_height_mm": "tines_mm",
}
"""Axis of a sweep → the field of ``Placing`` that it changes."""


def notes_about(
    sim: Simulation, plans: Sequence[Plan], *, axes: Collection[str] = (), errors: bool = False, driven: bool = False
) -> list[str]:
    """All notes about a run, one line each.

    Args:
        sim: the options.
        plans: the plans.
        axes: names of the axes of a sweep.
        errors: whether places or sizes of boxes have errors in some worlds.
        driven: whether some worlds are shaken.

    Raises:
        InputError: materials are wrong (see ``check_surfaces``), MuJoCo cannot simulate the soft boxes, or film is
            wrapped around a plan that has pallets among its boxes.
    """
    return [
        *_carrier_notes(sim),
        *check_surfaces(plans, sim),
        *_placing_notes(sim.placing, axes, errors),
        *_wrap_notes(sim.wrap, axes, driven, plans),
        *_gap_notes(sim, plans),
        *_wall_notes(sim, plans),
        *_stiffness_notes(sim, plans, errors),
        *_attempt_notes(sim, driven),
        *_static_notes(sim),
    ]


def _idle(names: Sequence[str], why: str) -> Iterator[str]:
    """The note that options have no effect; no note if ``names`` is empty."""
    if names:
        yield f"{' and '.join(names)} {'has' if len(names) == 1 else 'have'} no effect: {why}"


def _count_and_first(box_names: Sequence[str]) -> tuple[str, str]:
    """A text with the number of boxes, and a text with the names of the first ones."""
    first = ", ".join(box_names[:MOST_NAMED]) + (", …" if len(box_names) > MOST_NAMED else "")
    return count_text(len(box_names), "box", "boxes"), first


def _carrier_notes(sim: Simulation) -> Iterator[str]:
    """Notes on options that have no effect with a carrier of boards."""
    board_pallet, physics = pallet(sim.carrier), sim.physics
    if board_pallet is None:
        return
    name = printable_name(sim.carrier if isinstance(sim.carrier, Carrier) else sim.carrier.name or "the carrier")
    idle = [f"physics.{field}" for field in _OF_SLABS if getattr(physics, field) != Physics.model_fields[field].default]
    yield from _idle(idle, f"{name} is made of boards, which have their own height and mass")
    frictions = [friction for friction in board_pallet.frictions if friction is not None]
    if not physics.has_own_friction and frictions and min(frictions) < physics.box_friction[0]:
        reason = f"a contact has the larger coefficient of its two bodies, and boxes have {physics.box_friction[0]:g}"
        yield f"friction {min(frictions):g} of boards of {name} has no effect with pyramidal cones: {reason}"


def _placing_notes(placing: Placing, axes: Collection[str], errors: bool) -> Iterator[str]:
    way = placing.name
    if way is Way.AUTO:
        way = Way.HAND if errors else Way.EXACT
    changed = [name for name, info in Placing.model_fields.items() if getattr(placing, name) != info.default]
    idle = [f"placing.{name}" for name in changed if name != "name" and name not in _USES[way]]
    idle += [axis for axis, field in _AXES.items() if axis in axes and field not in _USES[way]]
    yield from _idle(idle, f"boxes are placed by {way}")


def _wrap_notes(wrap: Wrap, axes: Collection[str], driven: bool, plans: Sequence[Plan]) -> Iterator[str]:
    holds = wrap.turns > 0 or "wrap_turns" in axes
    unit = next((plan for plan in plans if plan.pallets), None)
    if holds and unit is not None:
        raise InputError(
            f"plan {printable_name(unit.plan_id)}: wrap.turns: this plan has pallets among its boxes, and film "
            "would hold the boxes on them to the carrier, not to these pallets; leave film out"
        )
    if holds and not driven:
        yield "wrap has no effect: there is no profile, and film acts only while a pallet is shaken"
    elif not holds:
        changed = [name for name, info in Wrap.model_fields.items() if getattr(wrap, name) != info.default]
        yield from _idle([f"wrap.{name}" for name in changed], "there are no turns of film")


def _gap_notes(sim: Simulation, plans: Sequence[Plan]) -> Iterator[str]:
    """Notes on boxes that stand on a carrier of boards and whose middle is beside the boards that carry them."""
    board_pallet = pallet(sim.carrier)
    if board_pallet is None:
        return
    deck_mm = board_pallet.deck_mm
    names = [f"box {box} of {printable_name(plan.plan_id)}" for plan in plans for box in _over_gaps(plan, deck_mm)]
    if names:
        count, first = _count_and_first(names)
        verb = "stands" if len(names) == 1 else "stand"
        yield f"{count} on the carrier {verb} with the middle over a gap between boards ({first})"


def _wall_notes(sim: Simulation, plans: Sequence[Plan]) -> Iterator[str]:
    """Notes on options of walls for a carrier without walls, and on boxes that overlap a wall in the plan."""
    if not has_walls(sim):
        idle = [f"walls.{name}" for name in Walls.model_fields if getattr(sim.walls, name) not in (None, ())]
        yield from _idle(idle, "the carrier has no walls")
        return
    names = [
        f"box {box} of {printable_name(plan.plan_id)} by {three_digits(depth)} mm on the {side}"
        for plan in plans
        for box, side, depth in _through_walls(plan, sim)
    ]
    if names:
        count, first = _count_and_first(names)
        yield f"{count} {'reaches' if len(names) == 1 else 'reach'} through a wall of the carrier ({first})"


def _through_walls(plan: Plan, sim: Simulation) -> Iterator[tuple[int, Side, float]]:
    """(box, side of the wall, depth of the overlap in mm) for each box that overlaps a wall in the plan. If a box
    overlaps several walls, only the deepest overlap is listed."""
    place, half = (mm_to_m(values) for values in (plan.corner_mm + plan.size_mm / 2, plan.size_mm / 2))
    depth = carrier_of(plan, sim).room.depths(place, half, DEFAULT_TOLERANCE_MM / MM_PER_M)
    depth_mm = np.stack([MM_PER_M * depth[:, int(side.is_far), side.axis] for side in Side], axis=1)
    for box in np.flatnonzero(depth_mm.max(axis=1) > DEFAULT_TOLERANCE_MM).tolist():
        deepest = int(depth_mm[box].argmax())
        yield box, list(Side)[deepest], float(depth_mm[box, deepest])


def _stiffness_notes(sim: Simulation, plans: Sequence[Plan], errors: bool) -> Iterator[str]:
    """Notes on boxes that are too soft for their loads, and on options of soft boxes that have no effect."""
    if sim.has_soft and errors and sim.placing.name is Way.AUTO:
        raise InputError(
            "soft: in worlds with errors, a hand would carry boxes, but soft boxes appear at their places; pass "
            "placing='exact'"
        )
    giving = [plan for plan in plans if plan.stiffness_n_mm is not None]
    if sim.soft and (not giving or not sim.physics.has_own_friction):
        yield "soft has no effect: no box has a stiffness, or the physics ignores stiffness"
    if sim.has_soft:
        _check_soft(sim, plans if sim.attempts is Attempts.SOFT else giving)
    if not sim.physics.has_own_friction:
        return
    names = [f"box {box} of {printable_name(plan.plan_id)}" for plan in giving for box in _pressed_through(plan, sim)]
    if names:
        count, first = _count_and_first(names)
        yield (
            f"{count} {'is' if len(names) == 1 else 'are'} compressed by more than half of the height by the plan's "
            f"loads ({first}): check stiffness_n_mm"
        )


def _attempt_notes(sim: Simulation, driven: bool) -> Iterator[str]:
    if driven and sim.attempts is Attempts.SOFT:
        yield (
            "attempts='soft' has no effect on worlds with a profile: the profile begins from a settled placement, "
            "whose boxes are rigid"
        )


def _static_notes(sim: Simulation) -> Iterator[str]:
    """A note if ``duration_s`` is set but does not determine the duration, or has no effect."""
    duration_set = sim.duration_s != Simulation.model_fields["duration_s"].default
    if duration_set and sim.check is Check.STATIC and sim.schedule is Schedule.ADAPTIVE:
        yield (
            f"duration_s of {sim.duration_s:g} s is an upper limit: with schedule='adaptive', a static check ends "
            "when the pallet rests; with schedule='fixed', it lasts exactly this long"
        )
    elif duration_set and sim.check is not Check.STATIC:
        yield "duration_s has no effect: only check='static' uses it"


def _check_soft(sim: Simulation, plans: Sequence[Plan]) -> None:
    from petmjx.world.soft_boxes import check_soft  # imported here, since it loads MuJoCo

    for plan in plans:
        scene = build_scene(plan, sim)
        try:
            check_soft(scene.all_soft if sim.attempts is Attempts.SOFT else scene)
        except InputError as error:
            raise InputError(f"plan {printable_name(plan.plan_id)}: {error}") from None


def _pressed_through(plan: Plan, sim: Simulation) -> list[int]:
    scene = build_scene(plan, sim)
    assert scene.stiffness is not None
    load_n = sim.physics.gravity_m_s2 * (bearing_of(scene).loads(scene.n_boxes)[:, 0] - scene.mass / 2)
    boxes: list[int] = np.flatnonzero(load_n / scene.stiffness > scene.half_size[:, 2]).tolist()
    return boxes


def _over_gaps(plan: Plan, deck_mm: FloatArray) -> list[int]:
    lying = np.flatnonzero(np.abs(plan.corner_mm[:, 2]) <= DEFAULT_TOLERANCE_MM)
    low, high = plan.corner_mm[lying, :2], (plan.corner_mm + plan.size_mm)[lying, :2]
    begin, end = np.maximum(low[:, None], deck_mm[None, :, 0]), np.minimum(high[:, None], deck_mm[None, :, 1])
    borne = (end > begin).all(axis=2, keepdims=True)
    # The middle of each box is compared with the rectangle around its supports, not with their convex hull. Since the
    # rectangle contains the hull, a middle outside the rectangle is certainly outside the hull.
    least, most = np.where(borne, begin, np.inf).min(axis=1), np.where(borne, end, -np.inf).max(axis=1)
    middle = (low + high) / 2
    boxes: list[int] = lying[((middle < least) | (middle > most)).any(axis=1)].tolist()
    return boxes
