"""Variants: how a world differs from its plan's nominal one.

A variant has two halves. What changes before or while boxes are placed (friction, mass, sizes, placement
errors) is its *placement*; what shakes the finished pallet (profile, strength, direction) is its *drive*.
Worlds of a plan with equal ``placement_key`` share one placement, whose settled state is forked. Their scenes:
petmjx.world.apply.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum
from functools import cached_property

import numpy as np

from petmjx.basics.units import FloatArray
from petmjx.options.placing import Placing, Way


class DistributionShape(StrEnum):
    """Family of a distribution."""

    FIXED = "fixed"
    NORMAL = "normal"
    UNIFORM = "uniform"


@dataclass(frozen=True)
class Distribution:
    """The distribution of one error, in the unit of its axis.

    ``fixed``: always ``centre``; ``normal``: mean ``centre`` and standard deviation ``spread``;
    ``uniform``: from ``centre − spread`` to ``centre + spread``.
    """

    shape: DistributionShape = DistributionShape.FIXED
    centre: float = 0.0
    spread: float = 0.0

    @property
    def random(self) -> bool:
        return self.shape is not DistributionShape.FIXED and self.spread > 0

    @property
    def zero(self) -> bool:
        return self.centre == 0 and not self.random

    def draw(self, rngs: Iterable[np.random.Generator], shape: tuple[int, ...]) -> FloatArray:
        """(m, …) samples of each generator, or (1, …) where nothing is random: then none is asked for.

        Standard numbers are drawn and then scaled. So with the same generator, twice the spread gives each box twice
        the error, and levels of a sweep can be compared pair by pair.
        """
        if self.random and self.shape is DistributionShape.NORMAL:
            return self.centre + self.spread * np.array([rng.standard_normal(shape) for rng in rngs])
        if self.random and self.shape is DistributionShape.UNIFORM:
            return self.centre + self.spread * (2.0 * np.array([rng.random(shape) for rng in rngs]) - 1.0)
        return np.full((1, *shape), self.centre)

    def label(self) -> str:
        """Its text in the results, if the axis has distributions of several shapes."""
        if self.zero:
            return "0"
        if self.shape is DistributionShape.FIXED:
            return f"fixed({self.centre:g})"
        if self.shape is DistributionShape.NORMAL:
            return f"normal({self.centre:g}, {self.spread:g})"
        return f"uniform({self.centre - self.spread:g}, {self.centre + self.spread:g})"


ZERO = Distribution()


@dataclass(frozen=True)
class PlacementChange:
    """What is different while boxes are placed. Factors multiply; errors are drawn for each box.

    Attributes:
        box_friction_factor, carrier_friction_factor: on all three friction coefficients. MuJoCo takes the
            larger coefficient of two touching geoms, so a lower value on one side alone changes little.
        mass_factor: on the mass of every box; the carrier's mass does not change.
        friction_rel: relative change of the friction of boxes and carrier, on top of the factors (0.1 = 10 % more). One
            draw for the whole world: all cartons are of one board, on a day of one humidity.
        mass_rel: relative change of each box's mass, on top of the factor.
        size_mm: added to each dimension of each box, mm.
        size_rel: relative change of each dimension (0.01 = 1 % larger).
        x_mm, y_mm, yaw_deg: placement error of each box.
        drop_height_mm: height above its place at which a box is released; negative draws count as 0.
        placing_name: how boxes are placed, a value of ``petmjx.options.placing.Way``; None: as the options say.
        placing_height_mm, placing_side_mm, placing_speed_m_s, placing_force_n, tines_height_mm: instead of those of
            ``petmjx.options.placing.Placing``; None: those.
        wrap_turns: of film, instead of those of ``petmjx.options.wrap.Wrap``; None: those.
        shifts_from_release: shifts are measured from where a box was released instead of from the plan.
    """

    box_friction_factor: float = 1.0
    carrier_friction_factor: float = 1.0
    mass_factor: float = 1.0
    friction_rel: Distribution = ZERO
    mass_rel: Distribution = ZERO
    size_mm: Distribution = ZERO
    size_rel: Distribution = ZERO
    x_mm: Distribution = ZERO
    y_mm: Distribution = ZERO
    yaw_deg: Distribution = ZERO
    drop_height_mm: Distribution = ZERO
    placing_name: str | None = None
    placing_height_mm: float | None = None
    placing_side_mm: float | None = None
    placing_speed_m_s: float | None = None
    placing_force_n: float | None = None
    tines_height_mm: float | None = None
    wrap_turns: float | None = None
    shifts_from_release: bool = False

    def placing(self, placing: Placing, *, errors: bool) -> Placing:
        """How boxes are placed that would be placed so; ``errors``: their places or sizes have errors."""
        other = {
            "name": Way(self.placing_name) if self.placing_name is not None else None,
            "height_mm": self.placing_height_mm,
            "side_mm": self.placing_side_mm,
            "speed_m_s": self.placing_speed_m_s,
            "force_n": self.placing_force_n,
            "tines_mm": self.tines_height_mm,
        }
        given = {name: value for name, value in other.items() if value is not None}
        chosen = placing.for_errors if errors else placing
        return chosen.changed(**given) if given else chosen

    @cached_property
    def random(self) -> bool:
        """Whether two replicates differ."""
        values = (getattr(self, entry.name) for entry in fields(self))
        return any(isinstance(value, Distribution) and value.random for value in values)


UNCHANGED = PlacementChange()

PlacementKey = tuple[PlacementChange, int]


@dataclass(frozen=True)
class DriveSpec:
    """What shakes the finished pallet: the name of a profile, its scale or level, and its direction."""

    profile: str
    scale: float = 1.0
    direction_deg: float = 0.0


@dataclass(frozen=True)
class Variant:
    """One set of changes to a plan's nominal world.

    Attributes:
        index: ``variant`` in the results; 0 is the nominal world.
        placement, drive: the two halves. Without a drive the world ends when the placement is at rest.
        replicate: which repetition; random numbers depend on (seed, plan id, replicate) alone.
        parameters: result column → value.
    """

    index: int
    placement: PlacementChange = UNCHANGED
    drive: DriveSpec | None = None
    replicate: int = 0
    parameters: Mapping[str, float | int | str] = field(default_factory=dict, hash=False)

    @property
    def placement_key(self) -> PlacementKey:
        """Equal for variants of one plan that share a placement. Replicates share it, unless something random acts
        while boxes are placed."""
        return (self.placement, self.replicate if self.placement.random else 0)
