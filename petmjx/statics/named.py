"""The criteria by name: what each asks, and what its slack is. Tables, columns and docs are made from this list.

A criterion of your own, step by step: docs/extending.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from petmjx.basics.checked import hint
from petmjx.basics.errors import InputError
from petmjx.basics.text import shown
from petmjx.basics.units import FloatArray
from petmjx.metrics.spec import DIMENSIONLESS
from petmjx.statics.asked import Asked
from petmjx.statics.base import corner_and_area_slack
from petmjx.statics.load_polygon import load_polygon_slack
from petmjx.statics.loads import equilibrium_slack, even_bedding, lever_rule, load_slack, strength_slack

SUPPORT_SHARES: Final = (1.0, 0.9, 0.8, 0.75, 0.7, 0.6, 0.5)
"""Shares of the base that are asked for: full support, and those of Bortfeldt & Wäscher's survey and the ADAMS
study."""

LEAST_CORNERS: Final = 3

CORNER_AREA_PAPER: Final = (0.60, 0.80, 0.95)
CORNER_AREA_CODE: Final = (0.50, 0.85, 0.95)
"""Shares asked for with four corners, three, and fewer, in the paper and in its authors' code."""

_MM: Final = "mm"

LEANING: Final = "force_balance_leaning"


@dataclass(frozen=True)
class Criterion:
    """One criterion of static stability.

    Attributes:
        name: of its columns.
        asks: what a box must have to be stable.
        slack: what the slack is; its sign is the answer.
        unit: of the slack.
        source: where the criterion comes from.
        slack_of: (n,) the slacks of a plan's boxes; NaN where there is none.
        strict: whether a slack of 0 is not enough.
        number: the number behind it, if a threshold can be asked of it; "" otherwise.
        ends: whether nothing is asked after the first box that fails.
        usual: whether it is asked if none is named.
    """

    name: str
    asks: str
    slack: str
    unit: str
    source: str
    slack_of: Callable[[Asked], FloatArray]
    strict: bool = False
    number: str = ""
    ends: bool = False
    usual: bool = True


def _support(share: float) -> Criterion:
    return Criterion(
        f"support_{100 * share:.0f}",
        f"at least {100 * share:.0f} % of the base is borne",
        f"borne share - {share:g}",
        DIMENSIONLESS,
        "Bortfeldt & Wäscher 2013",
        lambda inputs: inputs.share - share,
        number="borne share of the base" if share == 1 else "",
    )


def _corner_area(name: str, least: tuple[float, float, float], source: str) -> Criterion:
    four, three, fewer = (f"{100 * share:.0f} %" for share in least)
    return Criterion(
        name,
        f"more than {four} of the base is borne with 4 corners, {three} with 3, {fewer} with fewer",
        "borne share - share asked for",
        DIMENSIONLESS,
        source,
        lambda inputs: corner_and_area_slack(inputs.share, inputs.corners, least),
        strict=True,
    )


CRITERIA: Final = (
    *map(_support, SUPPORT_SHARES),
    Criterion(
        "three_corners",
        f"at least {LEAST_CORNERS} of the 4 bottom corners lie on something",
        f"corners borne - {LEAST_CORNERS}",
        DIMENSIONLESS,
        "Paquay, Schyns, Limbourg 2016",
        lambda inputs: (inputs.corners - LEAST_CORNERS).astype(np.float64),
    ),
    _corner_area("corner_area_paper", CORNER_AREA_PAPER, "Zhao et al. 2021, paper"),
    _corner_area("corner_area_code", CORNER_AREA_CODE, "Zhao et al. 2021, code"),
    Criterion(
        "centre",
        "its centre lies over the hull of its contact areas",
        "distance of the centre from the hull's edge, inwards",
        _MM,
        "common",
        lambda inputs: inputs.hulls.distance(np.arange(inputs.contacts.n_boxes), inputs.contacts.centre_mm[:, :2]),
        number="centre inside the hull's edge",
    ),
    Criterion(
        "load_polygon",
        "its centre lies over the hull of its contact areas, as far as these can be loaded",
        "distance of the centre from that hull's edge, inwards",
        _MM,
        "Gao et al. 2025, arXiv 2507.09123",
        lambda inputs: load_polygon_slack(inputs.contacts),
        number="centre inside the load polygon's edge",
    ),
    Criterion(
        "stacking_tree",
        "weight and load, passed down by the lever rule, lie over the contact hull, here and below",
        "least distance of the resultant from a hull's edge, inwards",
        _MM,
        "Zhao et al. 2022, arXiv 2108.13680",
        lambda inputs: load_slack(inputs.contacts, inputs.hulls, lever_rule),
        number="resultant inside the hulls' edges",
    ),
    Criterion(
        "equilibrium",
        "weight and load, passed down in balance, lie over the contact hull, here and below",
        "least distance of the resultant from a hull's edge, inwards",
        _MM,
        "Ramos et al. 2016",
        lambda inputs: equilibrium_slack(inputs.contacts, inputs.hulls),
        number="resultant inside the hulls' edges",
    ),
    Criterion(
        "force_balance",
        "forces exist at the corners of all contact areas that balance every box",
        "share of an even load that every corner can carry",
        DIMENSIONLESS,
        "StableLego, arXiv 2402.10711; Whiting et al. 2009",
        lambda inputs: inputs.balance[0],
        number="even load on every corner",
        ends=True,
    ),
    Criterion(
        LEANING,
        "such forces exist if boxes may also press on neighbours that they touch side by side",
        "share of an even load that every corner can carry",
        DIMENSIONLESS,
        "StableLego, arXiv 2402.10711; Whiting et al. 2009",
        lambda inputs: inputs.balance[1],
        number="even load on every corner",
        ends=True,
    ),
    Criterion(
        "strength",
        "neither it nor a box that bears part of it carries more than its strength, by loads passed down in balance",
        "1 - load / strength, the least of these boxes that have a strength; 1 where none has",
        DIMENSIONLESS,
        "McKee, Gander, Wachuta 1963, or strengths of the user's",
        lambda inputs: strength_slack(inputs.contacts, inputs.strength_n, even_bedding),
        usual=False,  # where no strength is known it accepts everything
    ),
)
"""In the order of tables: from criteria of the base to criteria of the whole stack."""

NAMES: Final = tuple(criterion.name for criterion in CRITERIA)
_UNNAMED: Final = tuple(criterion.name for criterion in CRITERIA if criterion.usual)


def chosen_criteria(names: Iterable[str] | None = None) -> tuple[Criterion, ...]:
    """The criteria of these names in the order of ``CRITERIA``; if none is named those that usually are.

    Raises:
        InputError: there is no such criterion.
    """
    chosen_names = tuple(names or ()) or _UNNAMED
    for name in chosen_names:
        if name not in NAMES:
            raise InputError(f"criteria: there is no {shown(name)}; {hint(name, NAMES)}")
    return tuple(criterion for criterion in CRITERIA if criterion.name in chosen_names)
