"""Lists the candidates for the reading of a file. Each candidate is one way to read the file's numbers. The column
names, the form of the file and the caller's options decide which ways are possible."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, permutations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from petmjx.common.units import FloatArray
from petmjx.plans.box_columns import BoxColumns
from petmjx.plans.column_extraction import SIZE_WORDS, XYZ, role_of
from petmjx.plans.column_names import LENGTH_UNITS, word_set, words_of
from petmjx.plans.input_conventions import ANCHORS
from petmjx.plans.known_forms import SCENE
from petmjx.plans.plausibility import Layout
from petmjx.plans.readings import POSES, Wishes
from petmjx.plans.size_and_place_columns import Geometry
from petmjx.plans.turn_columns import Turns

_SIX: Final = np.array([(0, 1, 2), (1, 0, 2), (1, 2, 0), (2, 1, 0), (2, 0, 1), (0, 2, 1)])
"""py3dbp's ``rotation_type`` → which of width, height and depth lies along each of the three axes (as in its function
``get_dimension``)."""

_PERMUTATIONS: Final = np.array(list(permutations(range(3))))
"""Number of a permutation of the three sizes → which of the sizes lies along each axis. The permutations are numbered
in alphabetical order, as in files of other programs: 0 is XYZ, 1 is XZY, and so on (``ROTATION_RULES``)."""
_ANCHOR_PRIOR: Final = {"corner": 0.0, "centre": 1.0, "base-centre": 1.8, "far-corner": 2.5, "top-centre": 3.0}
_OTHER_CORNER_COST: Final = 3.0  # cost of a reading with coordinates of a corner that is not in ``_ANCHOR_PRIOR``
_OF_GRIPPERS: Final = word_set("gripper greifer tcp")
_GRIPPER_PRIOR: Final = [
    ("top-centre", 0.0),
    ("centre", 1.0),
    ("base-centre", 1.8),
    ("corner", 2.5),
    ("far-corner", 3.0),
]
"""Words for a robot's gripper in names of coordinates, and the costs of anchors for coordinates with such a name. A
gripper holds a box at the middle of its top."""
_TURNED_ARRAY: Final = 0.6
"""Cost of a reading with the sizes of boxes before they are turned, for an array without column names. Arrays mostly
come from programs that train packers, and have sizes as placed."""
_PLACED_POINT_COST: Final = 0.8
"""Cost of a reading in which coordinates of poses describe a point of the box as placed (a corner, or the centre of the
base or the top). By its definition, a pose turns a box about the point that its coordinates describe."""
_FIRM_COST: Final = 3.0
"""Cost of a reading that contradicts what is known from the form of the file, the names of its columns, or the
rotations."""


AXES_ALONG: Final = {"z": (0, 1, 2), "y": (0, 2, 1), "x": (1, 2, 0), "-z": (0, 1, 2), "-y": (0, 2, 1)}
"""The file's vertical axis → the file's axes (by their numbers) along the plan's x, y and z."""

X_UP_COST: Final = 2.0
"""Cost of a reading with x upwards, before any numbers are considered."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One possible reading of a ``Geometry`` (a choice of the columns for sizes and places), before units are
    chosen."""

    geometry: Geometry
    pair: tuple[int, int, int]
    up: str
    anchor: str
    rule: str
    prior: float
    scale: float = 1.0
    """The unit of sizes divided by the unit of coordinates."""

    @property
    def point(self) -> FloatArray:
        """(3,) the anchor, as shares of the extents along the plan's axes. The names of corners refer to the file's
        axes: the corner with the smallest coordinates is an upper one if heights are counted downwards."""
        point = np.array(ANCHORS[self.anchor])
        if self.anchor.startswith("corner-"):
            point = point[list(AXES_ALONG[self.up])]
        if self.up.startswith("-") and "corner" in self.anchor:
            point[2] = 1 - point[2]
        return point

    @property
    def along(self) -> tuple[str, str, str]:
        axes = [self.geometry.axes[index] for index in self.pair]
        names = [role_of(axes[index]) for index in AXES_ALONG[self.up]]
        return names[0], names[1], names[2]


def turned_sizes(columns: BoxColumns, candidate: Candidate) -> FloatArray:
    """(n, 3) sizes of boxes as placed, along the file's axes."""
    geometry = candidate.geometry
    size = geometry.size[:, candidate.pair]
    if geometry.turn is not None:
        turned: FloatArray = np.einsum("nij,nj->ni", np.abs(geometry.turn), np.nan_to_num(size, nan=np.nan))
        return turned
    turns = columns.turns
    if candidate.rule == "none" or turns is None:
        return size
    if candidate.rule in ("swap", "swap back", "degrees"):
        codes = np.maximum(turns.codes, 0)
        first, second, _ = AXES_ALONG[candidate.up]
        level = [{first: second, second: first}.get(axis, axis) for axis in range(3)]
        odd = codes % 2 == (candidate.rule != "swap back")
        return np.where(odd[:, None], size[:, level], size)
    placed_sides = _sides_along_axes(turns, candidate.rule)
    return np.take_along_axis(geometry.size if candidate.rule == "letters" else size, placed_sides, axis=1)


def _sides_along_axes(turns: Turns, rule: str) -> NDArray[np.int64]:
    """(n, 3) which of the three sizes of each box lies along each of the file's axes, for rules that may turn a box
    about any axis."""
    if rule == "letters":
        assert turns.letters is not None
        return turns.letters
    first = 1 if rule.endswith("from 1") else 0
    six = _PERMUTATIONS if rule.startswith("permutations") else _SIX
    sides: NDArray[np.int64] = six[np.clip(np.maximum(turns.codes, 0) - first, 0, 5)]
    return sides


_TIPPED_COST, _TIPPED_NEXT_COST = 1.5, 1.0
"""Costs of a reading in which some boxes are tipped on a side: ``_TIPPED_NEXT_COST`` if py3dbp's rotations are only 0
and 1, else ``_TIPPED_COST``. If a box does not fit unturned, py3dbp tries rotation 1 next, whichever axis is the
vertical."""


def tipping_cost(columns: BoxColumns, candidate: Candidate, rows: NDArray[np.int64]) -> float:
    """How implausible it is that boxes are turned as in a reading: boxes on pallets mostly stay upright, so the same
    side of all boxes is vertical.

    Args:
        rows: numbers of the rows that are examined.
    """
    turns, sizes = columns.turns, candidate.geometry.size[rows]
    if turns is None or candidate.rule in ("none", "swap", "swap back", "degrees", *POSES):
        return 0.0
    sides = _sides_along_axes(turns, candidate.rule)[rows, AXES_ALONG[candidate.up][2]]
    is_cube = np.ptp(sizes, axis=1) == 0  # the rotation of a cube shows nothing
    if len(set(sides[~is_cube].tolist())) < 2:
        return 0.0
    codes = set(turns.codes[rows].tolist())
    return _TIPPED_NEXT_COST if candidate.rule == "py3dbp" and codes <= {0, 1} else _TIPPED_COST


def layout_of(
    columns: BoxColumns, candidate: Candidate, rows: NDArray[np.int64], container: Mapping[str, float] | None = None
) -> Layout:
    """The corners and sizes of a plan's boxes as the candidate reads them, along the plan's axes, in the file's unit of
    coordinates.

    Args:
        rows: numbers of the plan's rows.
    """
    size = turned_sizes(columns, candidate) * candidate.scale
    place = candidate.geometry.place
    order = AXES_ALONG[candidate.up]
    if candidate.rule == POSES[1] and (turn := candidate.geometry.turn) is not None:
        # Coordinates describe a point of the box before it is turned. Convert them to the coordinates of the same point
        # of the turned box.
        point = np.empty(3)
        point[list(order)] = candidate.point
        if candidate.up.startswith("-"):
            point[order[2]] = 1 - point[order[2]]  # along the file's axis
        unturned = candidate.geometry.size[:, candidate.pair] * candidate.scale
        place = place + np.einsum("nij,nj->ni", turn, (0.5 - point) * unturned) - (0.5 - point) * size
    size, place = size[rows][:, order], place[rows][:, order]
    if candidate.up.startswith("-"):
        place[:, 2] *= -1
    low = place - candidate.point * size
    if candidate.up.startswith("-") and np.nanmax(low[:, 2] + size[:, 2], initial=-math.inf) <= 0:
        low[:, 2] -= np.nanmin(low[:, 2], initial=0.0)  # heights are measured from the top of the load
    extents = _container_along(candidate, container or {}, order)
    if candidate.up == "y" and container and container.keys() == {"0", "1", "2"}:
        # the listed sizes may be length, width and height, and not the extents along x, y and z
        listed = np.array([container[axis] for axis in "012"])
        far = np.nanmax(low + size, axis=0, initial=-math.inf)
        is_listed = (far <= listed).all() and ((far > extents).any() or listed[2] > extents[2])
        extents = listed if is_listed else extents
    return Layout(low, size, extents)


def _container_along(candidate: Candidate, container: Mapping[str, float], order: Sequence[int]) -> FloatArray:
    """Sizes of a container along the plan's axes; NaN if unknown."""
    axes = candidate.geometry.axes
    for names in (tuple(axes[index] for index in candidate.pair), XYZ, ("0", "1", "2")):
        if all(name in container for name in names):
            return np.array([container[name] for name in names], float)[list(order)]
    if len(container) == 2 and container.keys() <= set(XYZ):  # a deck
        return np.array([container.get(name, math.nan) for name in XYZ])[list(order)]
    if "width" not in container or not {"length", "height"} & container.keys():
        return np.full(3, np.nan)
    level = (container.get("length", math.nan), container["width"])
    if "length" not in container:
        level = (container["width"], container.get("depth", math.nan))
    return np.array([*level, container.get("height", math.nan)], float)


def candidates(columns: BoxColumns, wishes: Wishes) -> Iterator[Candidate]:
    """Yield all readings that the column names, the file's form and the caller's options allow. Each reading has a
    prior: its cost before any numbers are considered."""
    form = columns.source.form
    sizes, places = wishes.length_units
    scale = LENGTH_UNITS[sizes] / LENGTH_UNITS[places] if sizes != places else 1.0
    for geometry in columns.geometries:
        rules = _rules(geometry, columns, wishes)
        for up, up_prior in _ups(geometry, columns, wishes):
            for pair, pair_prior in _pairs(geometry, up, columns, wishes):
                for rule, rule_prior in rules:
                    if rule == "letters" and pair != (0, 1, 2):
                        continue
                    for anchor, anchor_prior in _anchors(geometry, form.anchor, wishes):
                        prior = geometry.prior + up_prior + pair_prior + rule_prior + anchor_prior
                        if rule == "degrees":
                            # An angle of 0 means that the length lies along x. So the cost of a reading with another
                            # assignment of sizes to axes (``pair_prior``) is counted twice.
                            prior += pair_prior
                        if geometry.turn is not None and not wishes.rule:
                            if anchor == "centre" or (geometry.turn == np.eye(3)).all():
                                if rule == POSES[1]:
                                    continue  # both rules place all boxes alike, so only the other rule is tried
                            elif rule == POSES[0]:
                                prior += _PLACED_POINT_COST
                        yield Candidate(geometry, pair, up, anchor, rule, prior, scale)


def _ups(geometry: Geometry, columns: BoxColumns, wishes: Wishes) -> list[tuple[str, float]]:
    if wishes.up:
        return [(wishes.up, 0.0)]
    form = columns.source.form
    if form.name == SCENE.name:
        return [(form.up, 0.0)]
    named_axis = form.up or geometry.named_up
    if named_axis:
        return [(up, 0.0 if up == named_axis else _FIRM_COST) for up in ("z", "y")]
    if geometry.turn is not None and (axis := _turning_axis(geometry.turn)):
        return [(up, 0.0 if up == axis else _FIRM_COST) for up in ("z", "y")]
    if form.rule == "py3dbp" or set(geometry.axes) == {"width", "height", "depth"}:
        return [("z", 0.2), ("y", 0.2)]
    listed = _order_in_file(columns, geometry)
    usual = [("z", 0.0), ("y", 1.8 if listed == ("length", "width", "height") else 1.0)]
    if listed == ("length", "height", "width") or _is_of_scene(geometry):
        usual = [("y", 0.0), ("z", 0.7)]
    # x is tried only if the size of the container is known, since it shows whether x is the vertical
    return [*usual, ("x", X_UP_COST)] if columns.source.boxes.containers else usual


def candidates_on_side(columns: BoxColumns, wishes: Wishes) -> Iterator[Candidate]:
    """Yield all readings with x upwards. Yield none if ``candidates`` yields these readings, too, or if the vertical is
    already known from column names, the form, a container or the caller."""
    free = [geometry for geometry in columns.geometries if not geometry.named_up and geometry.turn is None]
    form = columns.source.form
    if free and not (wishes.up or form.up or form.rule == "py3dbp" or columns.source.boxes.containers):
        for candidate in candidates(replace(columns, geometries=free), replace(wishes, up="x")):
            yield replace(candidate, prior=candidate.prior + X_UP_COST)


def candidates_downwards(columns: BoxColumns, wishes: Wishes) -> Iterator[Candidate]:
    """Yield all readings in which heights are counted downwards along z or y. Yield none if column names or the caller
    give the vertical, or if the form gives both the vertical and the point of a box."""
    form = columns.source.form
    free = [geometry for geometry in columns.geometries if not geometry.named_up]
    ups = [way for way in (("-z", 2, 0.0), ("-y", 1, 1.0)) if form.up in ("", way[0][1])]
    for geometry in () if wishes.up or (form.up and form.anchor) else free:
        for up, axis, up_cost in ups:
            tops = geometry.place[:, axis]
            if geometry.anchor == "corner" and geometry.axes == XYZ:
                tops = tops + geometry.size[:, axis]
            is_below = np.nanmax(tops, initial=-math.inf) <= 0 and np.nanmin(tops, initial=0.0) < 0
            up_cost += _DOWNWARDS_COST if is_below else _DOWNWARDS_ABOVE_0_COST
            ways = [(replace(wishes, up=up), up_cost)]
            if not (wishes.anchor or form.anchor or geometry.anchor):
                ways.append((replace(wishes, up=up, anchor=f"corner{up}"), up_cost + _LOWER_CORNER_COST))
            for chosen, cost in ways:
                for candidate in candidates(replace(columns, geometries=[geometry]), chosen):
                    yield replace(candidate, prior=candidate.prior + cost)


_DOWNWARDS_COST, _DOWNWARDS_ABOVE_0_COST = 2.0, 4.5
"""Costs of a reading in which heights are counted downwards: ``_DOWNWARDS_COST`` if no height is above 0, else
``_DOWNWARDS_ABOVE_0_COST``."""
_LOWER_CORNER_COST: Final = 0.3
"""Cost of a reading in which heights are counted downwards, and coordinates are those of the lower corner, which has
the largest height, instead of the upper one."""


def candidates_of_corners(columns: BoxColumns, wishes: Wishes) -> Iterator[Candidate]:
    """Yield the readings in which coordinates describe a corner that ``candidates`` does not try. Yield none if column
    names, the form or the caller give the anchor (the point of a box that coordinates describe)."""
    free = [geometry for geometry in columns.geometries if not geometry.anchor and geometry.turn is None]
    is_known = not free or wishes.anchor or columns.source.form.anchor
    for corner in () if is_known else [anchor for anchor in ANCHORS if anchor not in _ANCHOR_PRIOR]:
        chosen = replace(columns, geometries=free), replace(wishes, anchor=corner)
        for candidate in chain(candidates(*chosen), candidates_on_side(*chosen)):
            yield replace(candidate, prior=candidate.prior + _OTHER_CORNER_COST)


def _turning_axis(turn: FloatArray) -> str:
    """The axis about which boxes are turned, "y" or "z", if all turned boxes are turned about it. Boxes of a pile are
    turned about the vertical. The result is "" if no box is turned, or boxes are turned about several axes.

    Args:
        turn: (n, 3, 3) rotation matrices.
    """
    is_turned = np.isfinite(turn).all(axis=(1, 2)) & (np.abs(turn) != np.eye(3)).any(axis=(1, 2))
    if not is_turned.any():
        return ""
    fixed = [bool((np.abs(turn[is_turned, axis, axis]) == 1).all()) for axis in range(3)]
    return "y" if fixed == [False, True, False] else "z" if fixed == [False, False, True] else ""


def _pairs(
    geometry: Geometry, up: str, columns: BoxColumns, wishes: Wishes
) -> list[tuple[tuple[int, int, int], float]]:
    """Pairs (assignment, prior), one for each possible assignment of sizes to axes. An assignment has the indices of
    the sizes that lie along the file's first, second and third axis. The prior is the cost of the assignment before any
    numbers are considered."""
    axes = geometry.axes
    if len(wishes.along) == 3:
        names = [role_of(axis) for axis in axes]
        if sorted(names) == sorted(wishes.along):
            order = AXES_ALONG[up]
            along = [names.index(wishes.along[order.index(axis)]) for axis in range(3)]
            return [((along[0], along[1], along[2]), 0.0)]
    if not set(axes) <= set(SIZE_WORDS):
        if axes == XYZ:
            return [((0, 1, 2), 0.0), ((1, 0, 2), 4.0), ((0, 2, 1), 4.0)]
        return [((0, 1, 2), 0.0), ((1, 0, 2), 2.2), ((0, 2, 1), 2.4)]
    upright = "height" if "height" in axes else "depth"
    pairs = []
    vertical, listed = AXES_ALONG[up][2], _order_in_file(columns, geometry)
    for pair in permutations(range(3)):
        pair_axes = [axes[index] for index in pair]
        level = [name for name in pair_axes if name != upright]
        if pair_axes[vertical] == upright:
            usual_level = ["length", "width"] if "length" in level and "width" in level else ["width", "depth"]
            if "length" in level and "depth" in level:
                usual_level = ["length", "depth"]
            # with y upwards, graphics programs list the width before the length
            is_listed = up == "y" or (listed.index(level[0]) < listed.index(level[1]))
            prior = 0.0 if level == usual_level else 0.8 if is_listed else 2.0
        elif pair == (0, 1, 2):  # this pairing follows the order of the axes, not the names of the sizes
            is_listed = "depth" in axes and listed == axes
            prior = 0.0 if columns.source.form.rule == "py3dbp" else 0.6 if is_listed else 3.0
        else:
            continue
        if columns.source.form.rule == "py3dbp" and pair != (0, 1, 2):
            prior += _FIRM_COST
        pairs.append(((pair[0], pair[1], pair[2]), prior))
    return pairs


def _order_in_file(columns: BoxColumns, geometry: Geometry) -> tuple[str, ...]:
    """The words for the sizes in the order of their columns. In py3dbp, the axes have the order width, height,
    depth."""
    header = columns.source.boxes.table.header
    names = {axis: geometry.columns.get(role_of(axis), "") for axis in geometry.axes}
    return tuple(sorted(names, key=lambda axis: header.index(names[axis]) if names[axis] in header else 0))


def _is_of_scene(geometry: Geometry) -> bool:
    """Whether boxes have a position, a rotation and a scale, as in scenes of three.js, Unity and Babylon, in which y is
    the vertical."""
    return geometry.turn is not None and any("scale" in words_of(name) for name in geometry.columns.values())


def _rules(geometry: Geometry, columns: BoxColumns, wishes: Wishes) -> list[tuple[str, float]]:
    if geometry.turn is not None:
        return [(rule, 0.0) for rule in (POSES if wishes.rule not in POSES else (wishes.rule,))]
    if columns.turns is None or wishes.sizes == "placed":
        return [("none", 0.0)]
    if wishes.rule and (wishes.rule == "none" or wishes.rule in columns.turns.rules):
        return [(wishes.rule, 0.0)]
    form = columns.source.form
    named_rule = wishes.sizes or form.sizes or ("placed" if geometry.placed else "")
    rules = []
    for number, rule in enumerate(columns.turns.rules):
        if form.rule in columns.turns.rules and rule != form.rule:
            continue
        if rule == "py3dbp" and number and not form.rule and "type" not in columns.turns.column.lower():
            continue
        guess = columns.turns.guess_cost + _TURNED_ARRAY * (not columns.source.boxes.table.has_header)
        rules.append((rule, 0.5 * bool(number) * (rule != "swap back") + guess))
    if wishes.sizes == "item":
        return rules
    placed = _FIRM_COST if named_rule == "item" else 0.0
    turned = _FIRM_COST if named_rule == "placed" else 0.0
    if not named_rule:
        hint = _sizes_by_article(columns, geometry)
        if not hint:
            hints = {_sizes_by_length(columns, geometry), _sizes_by_name(columns, geometry)} - {""}
            hint = hints.pop() if len(hints) == 1 else ""  # hints that contradict each other decide nothing
        placed, turned = placed + (2.5 if hint == "item" else 0.0), turned + (2.5 if hint == "placed" else 0.0)
    return [("none", placed), *((rule, prior + turned) for rule, prior in rules)]


def _sizes_by_article(columns: BoxColumns, geometry: Geometry) -> str:
    """Whether sizes are given for the placed box or for the item. Boxes of one article in different orientations show
    which of the two is true. The result is "" if this is unknown."""
    turns, names = columns.turns, columns.article
    if turns is None or names is None:
        return ""
    codes = turns.codes if turns.letters is None else turns.letters @ np.array([9, 3, 1])
    n_same = n_other = 0
    first: dict[str, int] = {}
    for row, name in enumerate(names):
        begin = first.setdefault(name, row)
        if not name or begin == row or codes[begin] == codes[row] or (codes[begin] - codes[row]) % 2 == 0:
            continue
        one, two = geometry.size[begin], geometry.size[row]
        if np.isnan(one).any() or np.isnan(two).any() or np.allclose(one[0], one[1]):
            continue
        if np.allclose(one, two):
            n_same += 1
        elif np.allclose(np.sort(one), np.sort(two)):
            n_other += 1
    return "item" if n_same > 3 * n_other else "placed" if n_other > 3 * n_same else ""


_LEAST_BY_LENGTH: Final = 3
"""Lengths and widths are evidence of whether sizes are given for placed boxes or for items. For this evidence, the
length must differ from the width in at least this number of turned boxes, and in at least this number of unturned
boxes. If no kind of boxes is both turned and unturned, kinds are counted instead of boxes."""
_LONGER_SHARE: Final = 0.9
"""Lengths and widths are evidence of whether sizes are given for placed boxes or for items. For this evidence, the
length must exceed the width in at least this share of the unturned boxes."""


def _sizes_by_length(columns: BoxColumns, geometry: Geometry) -> str:
    """Whether sizes are given for the placed box or for the item. The length of an item is rarely smaller than its
    width. So if the length is larger than the width even in rows of turned boxes, the sizes are those of items. The
    result is "" if this is unknown."""
    turns = columns.turns
    if turns is None or not {"length", "width"} <= set(geometry.axes):
        return ""
    length, width = (geometry.size[:, geometry.axes.index(side)] for side in ("length", "width"))
    is_turned = turns.codes % 2 == 1 if turns.letters is None else turns.letters[:, 0] == geometry.axes.index("width")
    differ = np.isfinite(length - width) & (length != width)
    # boxes of equal sizes with the same side up have the same kind
    kind = length * width + 1j * geometry.size.sum(axis=1)
    is_mixed = np.isin(kind[is_turned & differ], kind[~is_turned & differ]).any()
    shares = []
    for group in (is_turned & differ, ~is_turned & differ):
        # if no item is both turned and unturned, many boxes of one item are no more evidence than one box
        if len(kind[group] if is_mixed else np.unique(kind[group])) < _LEAST_BY_LENGTH:
            return ""
        shares.append(float(np.mean(length[group] > width[group])))
    turned_share, unturned_share = shares
    if unturned_share < _LONGER_SHARE:
        return ""
    return "item" if turned_share >= _LONGER_SHARE else "placed" if turned_share <= 1 - _LONGER_SHARE else ""


_OF_ITEMS: Final = word_set("item article sku product original nominal unrotated")
_OF_YAWS: Final = word_set("yaw theta heading azimuth psi rx ry rz x y z")
"""Words that mean sizes before the box is turned: ``_OF_ITEMS`` in the names of sizes, ``_OF_YAWS`` in the name of a
column of rotations. An angle about an axis ("rz", "rot_z") turns a box whose sizes are known without this angle."""


def _sizes_by_name(columns: BoxColumns, geometry: Geometry) -> str:
    """The text "item" if names say that the sizes are those of the item before it is turned; "" if names do not say
    it."""
    roles = {*map(role_of, geometry.axes), "sizes"}
    names = [name for role, name in geometry.columns.items() if role in roles]
    is_item = bool(names) and all(_OF_ITEMS.intersection(words_of(name)) for name in names)
    is_yaw = columns.turns is not None and bool(_OF_YAWS.intersection(words_of(columns.turns.column)))
    return "item" if is_item or is_yaw else ""


def _anchors(geometry: Geometry, known: str, wishes: Wishes) -> list[tuple[str, float]]:
    if wishes.anchor:
        return [(wishes.anchor, 0.0)]
    if geometry.anchor:
        return [(geometry.anchor, 0.0)]
    if geometry.turn is not None and not known:
        return [("centre", 0.0), ("base-centre", 1.2), ("corner", 1.8), ("top-centre", 2.4)]
    if not known and _OF_GRIPPERS.intersection(*(words_of(geometry.columns.get(axis, "")) for axis in XYZ)):
        return _GRIPPER_PRIOR
    if known:
        return [(anchor, 0.0 if anchor == known else _FIRM_COST + prior) for anchor, prior in _ANCHOR_PRIOR.items()]
    return list(_ANCHOR_PRIOR.items())
