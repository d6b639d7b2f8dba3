"""What criteria are asked about: one plan's contacts, and what several criteria need of them, worked out once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from petmjx.basics.units import FloatArray
from petmjx.statics.balance import balance_slack
from petmjx.statics.base import corners_supported, support_share
from petmjx.statics.contacts import IntArray, PlanContacts
from petmjx.statics.friction import Friction
from petmjx.statics.hulls import Hulls, contact_hulls


@dataclass(frozen=True, eq=False)
class Asked:
    """One plan of n boxes.

    Attributes:
        friction: coefficients, for force balance; ``leans``: whether it is also asked with boxes that lean.
        strength_n: (n,) what boxes bear on their tops, N; NaN where it is not known; None: of no box.
    """

    contacts: PlanContacts
    friction: Friction
    leans: bool
    strength_n: FloatArray | None

    @cached_property
    def share(self) -> FloatArray:
        """(n,) borne share of the base."""
        return support_share(self.contacts)

    @cached_property
    def corners(self) -> IntArray:
        """(n,) bottom corners that lie on something."""
        return corners_supported(self.contacts)

    @cached_property
    def hulls(self) -> Hulls:
        """The hulls of the contact areas."""
        return contact_hulls(self.contacts)

    @cached_property
    def balance(self) -> tuple[FloatArray, FloatArray]:
        """(n,) slacks of force balance, without leaning and with it; of the latter NaN unless ``leans``."""
        return balance_slack(self.contacts, self.hulls, self.friction, self.leans)
