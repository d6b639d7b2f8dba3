"""Writers of tables, texts, arrays and scenes in the forms of other tools. As in ``support.foreign_json``, each writer
takes packings in the units and axes of its tool, and returns documents (files), the main one first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from support.foreign_documents import Arrays, Csv, Document, Table, Text
from support.foreign_json import before_turn, keyed, local, number, numbers, six_ways
from support.foreign_plans import View

# Arrays.


def array(
    name: str, views: Sequence[View], *, columns: str, whole: bool = False, names: Sequence[str] = ()
) -> list[Document]:
    """An array of one plan, or an .npz file of several plans. ``columns``: words for groups of columns: size, place,
    high (the far corner), article (sizes before the turn), weight, turn, one, zero. "pad" adds rows of zeros at the
    end."""
    arrays: dict[str, np.ndarray] = {}
    for view in views:
        article = np.array([before_turn(view, k) for k in range(len(view))])
        groups = {
            "size": view.size,
            "place": view.place,
            "high": view.place + view.size,
            "article": article,
            "weight": view.weight[:, None],
            "turn": view.plan.turned[:, None].astype(float),
            "one": np.ones((len(view), 1)),
            "zero": np.zeros((len(view), 1)),
        }
        words = columns.split()
        values = np.hstack([groups[word] for word in words if word != "pad"])
        if "pad" in words:
            values = np.vstack([values, np.zeros((80 - len(values), values.shape[1]))])
        arrays[view.plan.name] = values.astype(int) if whole else values
    first = {word: 3 * k for k, word in enumerate(words[:2])}
    size = next((first[word] for word in ("size", "article", "high") if word in first), 3)
    if len(views) == 1 and not name.endswith(".npz"):
        arrays = {"": next(iter(arrays.values()))}
        boxes = [("", k) for k in range(len(views[0]))]
    else:
        boxes = [(view.plan.name, k) for view in views for k in range(len(view))]
    return [Arrays(name, arrays, boxes, ("", size + 1), ("", first["place"] + 1))]


def named_arrays(name: str, views: Sequence[View], *, with_poses: bool = False) -> list[Document]:
    """An .npz file with one array for each field."""
    (view,) = views
    arrays = {"sizes": view.size, "positions": view.place, "weights": view.weight}
    place = ("positions", 1)
    if with_poses:
        turned = [local(view, k) for k in range(len(view))]
        matrices = np.array(
            [np.block([[turn, at[:, None]], [0, 0, 0, 1]]) for (turn, _), at in zip(turned, view.place, strict=True)]
        )
        arrays = {"poses": matrices, "sizes": np.array([size for _, size in turned]), "masses": view.weight}
        place = ("poses", 7)
    return [Arrays(name, arrays, [("", k) for k in range(len(view))], ("sizes", 1), place)]


def poses_alone(name: str, views: Sequence[View]) -> list[Document]:
    """An array of (n, 4, 4) poses, without sizes."""
    (document,) = named_arrays(name, views, with_poses=True)
    return [Arrays(name, {"": document.arrays["poses"]}, document.boxes, ("", 0), ("", 3))]


def pickled(name: str, views: Sequence[View]) -> list[Document]:
    """Episodes of different lengths, as repositories of reinforcement learning save them: an array of Python objects,
    which is saved as a pickle."""
    episodes = np.empty(len(views), object)
    for k, view in enumerate(views):
        episodes[k] = np.hstack([view.size, view.place, np.zeros((len(view), 1))])
    return [Arrays(name, {"": episodes}, [], ("", 0), ("", 0))]


# Texts.


def py3dbp_text(name: str, views: Sequence[View]) -> list[Document]:
    """The bins and items that the example in py3dbp's README prints, including items that did not fit."""
    lines: list[str] = []
    boxes = []
    for view in views:
        deck = "x".join(f"{side:.1f}" for side in view.deck)
        lines += [
            f"::::::::::: {view.plan.name}({deck}, max_weight:1500.0) vol({np.prod(view.deck):.1f})",
            "FITTED ITEMS:",
        ]
        for k in range(len(view)):
            sides, turn = six_ways(view, k)
            boxes.append(len(lines))
            shown = "x".join(f"{side:.{view.decimals}f}" for side in sides)
            place = ", ".join(f"Decimal('{value:.{view.decimals}f}')" if value else "0" for value in view.place[k])
            lines.append(
                f"====>  {view.plan.ids[k]}({shown}, weight: {view.weight[k]:.3f}) pos([{place}]) rt({turn}) "
                f"vol({np.prod(sides):.1f})"
            )
        lines += ["UNFITTED ITEMS:", "====>  spare(50.0x40.0x30.0, weight: 1.0) pos([0, 0, 0]) rt(0) vol(60000.0)"]
        lines += [
            "***************************************************",
            "***************************************************",
        ]
    return [Text(name, lines, boxes, (r"\((-?[\d.]+)x", "width"), (r"pos\(\[(?:Decimal\(')?(-?[\d.]+)", "pos"))]


def py3dbp_csv(name: str, views: Sequence[View], *, decimal_names: bool = False) -> list[Document]:
    """Rows of items. ``decimal_names``: whether numbers are written as Python shows decimals."""
    (view,) = views
    rows: list[list[Any]] = [["name", "width", "height", "depth", "weight", "x", "y", "z", "rotation_type"]]
    for k in range(len(view)):
        sides, turn = six_ways(view, k)
        values: list[Any] = [*sides, float(view.weight[k]), *view.place[k]]
        if decimal_names:
            values = [f"Decimal('{value:.{view.decimals}f}')" for value in values]
        rows.append([view.plan.ids[k], *values, turn])
    return [Table(name, {"": rows}, [("", k + 1) for k in range(len(view))], 2, 6)]


def plain_numbers(name: str, views: Sequence[View]) -> list[Document]:
    """The text that ``np.savetxt`` writes: sizes and corners as numbers, without headers."""
    (view,) = views
    lines = [" ".join(f"{value:.18e}" for value in row) for row in np.hstack([view.size, view.place])]
    return [Text(name, lines, range(len(view)), (r"^(\S+)", "1"), (r"^(?:\S+ ){4}(\S+)", "5"))]


def d_wave(name: str, views: Sequence[View]) -> list[Document]:
    """The table of D-Wave's example. Bins stand in a row along x, one deck length apart."""
    lines = [f"# Number of bins used: {len(views)}", f"# Number of cases packed: {sum(map(len, views))}"]
    lines += [
        "# Objective value: 104.457",
        "",
        "  case_id    bin-location    orientation      x      y      z    x'    y'    z'",
    ]
    lines.append("---------  --------------  -------------  -----  -----  -----  ----  ----  ----")
    boxes = []
    for number_, view in enumerate(views):
        case_ids = {article: k for k, article in enumerate(dict.fromkeys(view.plan.articles))}
        for k in range(len(view)):
            x, y, z = view.place[k] + [number_ * view.deck[0], 0, 0]
            sides = "".join(f"{number(side):>6}" for side in view.size[k])
            boxes.append(len(lines))
            way = 1 + 2 * int(view.plan.turned[k])
            case = case_ids[view.plan.articles[k]]
            lines.append(f"{case:9}{number_ + 1:16}{way:15}{number(x):>7}{number(y):>7}{number(z):>7}{sides}")
    return [Text(name, lines, boxes, (r"(\S+)\s+\S+\s+\S+$", "x'"), (r"(\S+)\s+\S+\s+\S+\s+\S+\s+\S+$", "y"))]


def mjcf(
    name: str,
    views: Sequence[View],
    *,
    density: bool = False,
    base: bool = False,
    pallet_m: float = 0.0,
    turn: str = "",
    default: bool = False,
    cylinder: bool = False,
) -> list[Document]:
    """An MJCF scene of free boxes.

    Args:
        density: whether densities are written instead of masses.
        base: whether the frame of a body is at the centre of its box's base, with the geom above it.
        pallet_m: height of a static pallet on which the boxes stand, m.
        turn: "quat" or "euler": turned boxes have the sizes before the turn, and a rotation by 90°.
        default: whether mass and type are in a default class, and are partly repeated in the bodies.
        cylinder: whether one body is no box.
    """
    (view,) = views
    middle = view.deck[:2] / 2
    lines = ['<mujoco model="pallet">', '  <option gravity="0 0 -9.81"/>']
    if default:
        lines.append('  <default><default class="carton"><geom type="box" rgba="0.8 0.6 0.4 1"/></default></default>')
    lines += ["  <worldbody>", '    <light pos="0 0 4"/>', '    <geom name="floor" type="plane" size="3 3 0.1"/>']
    if pallet_m:
        at, half = (0.0, 0.0, pallet_m / 2), (*middle, pallet_m / 2)
        lines.append(f'    <geom name="pallet" type="box" pos="{_words(at)}" size="{_words(half)}"/>')
    boxes = []
    for k in range(len(view)):
        half, place = view.size[k] / 2, view.place[k] + [0, 0, pallet_m]
        way = ""
        if turn and view.plan.turned[k]:
            half = half[[1, 0, 2]]
            way = ' quat="0.70710678 0 0 0.70710678"' if turn == "quat" else ' euler="0 0 90"'
        weight = f'mass="{view.weight[k]:.6g}"'
        if density:
            weight = f'density="{view.weight[k] / view.size[k].prod():.9g}"'
        form = 'class="carton"' if default else 'type="box"'
        if cylinder and k == len(view) - 1:
            form, half = 'type="cylinder"', half[[0, 2]]
        offset = f'pos="0 0 {half[2]:.6g}" ' if base else ""
        joint = '<joint type="free"/>' if base else "<freejoint/>"
        boxes.append(len(lines))
        body = f'<body name="{view.plan.ids[k]}" pos="{_words(place)}"{way}>'
        lines.append(f'    {body}{joint}<geom {form} {offset}size="{_words(half)}" {weight}/></body>')
    lines += ["  </worldbody>", "</mujoco>"]
    return [Text(name, lines, boxes, (r'size="([^ "]+)', "size"), (r'<body[^>]*pos="([^ "]+)', "pos"))]


def _words(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(f"{value:.6g}" for value in values)


def thpack(name: str, views: Sequence[View]) -> list[Document]:
    """An order in the form of Bischoff and Ratcliff's data sets: a container, types of boxes, and quantities, without
    places."""
    (view,) = views
    types: dict[tuple[int, ...], int] = {}
    for size in view.size:
        types[tuple(sorted((int(side) for side in size), reverse=True))] = (
            types.get(tuple(sorted(map(int, size), reverse=True)), 0) + 1
        )
    lines = ["1", "1 2502505", " ".join(str(int(side)) for side in view.deck), str(len(types))]
    lines += [f"{k} {a} 1 {b} 1 {c} 1 {many}" for k, ((a, b, c), many) in enumerate(types.items(), 1)]
    return [Text(name, lines, [], ("", ""), ("", ""))]


# Tables.

HEADERS = {
    "en": "Pallet Step Box Article Length Width Height Weight X Y Z",
    "de": "Palette Reihenfolge Karton Artikel Länge Breite Höhe Gewicht X-Position Y-Position Z-Position",
    "fr": "Palette Ordre Colis Référence Longueur Largeur Hauteur Poids X Y Z",
    "es": "Palé Orden Bulto Artículo Largo Ancho Alto Peso X Y Z",
    "it": "Pallet Sequenza Collo Articolo Lunghezza Larghezza Altezza Peso X Y Z",
    "pl": "Paleta Kolejność Karton Towar Długość Szerokość Wysokość Waga X Y Z",
    "short": "p n id sku l w h m x y z",
    "letters": "Pal Nr ID Art L B H Gew X Y Z",
    "snake": "pallet_id seq box_id sku length width height weight pos_x pos_y pos_z",
    "centres": "Pallet Step Box Article Length Width Height Weight Centre_X Centre_Y Centre_Z",
}
FIELDS = ["pallet", "step", "id", "article", "length", "width", "height", "weight", "x", "y", "z"]
TOTAL = {"en": "Total", "de": "Summe", "fr": "Total", "es": "Total", "it": "Totale", "pl": "Razem"}


def table(
    name: str,
    views: Sequence[View],
    *,
    words: str = "en",
    fields: str = "id article length width height weight x y z",
    units: tuple[str, str] = ("", ""),
    style: str = " [{}]",
    csv: Csv | None = None,
    titles: Sequence[Sequence[Any]] = (),
    unit_row: bool = False,
    turn: tuple[str, Any, Any] | None = None,
    sheet_each: bool = False,
    interleaved: bool = False,
    total: bool = False,
    text_numbers: bool = False,
    headers: bool = True,
) -> list[Document]:
    """A table with one row for each box.

    Args:
        words: key of ``HEADERS``, which has the names of the columns.
        fields: names of the columns' fields, in the order of the columns.
        units: units of lengths and of masses in the headers. Empty if units are not named.
        style: format of a unit behind a header.
        titles: rows above the header.
        unit_row: whether units are in a row of their own below the header.
        turn: header of a column that tells whether a box was turned, and its two values. Sizes are then those before
            the turn.
        sheet_each: whether each plan has a sheet of its own.
        interleaved: whether rows of several plans alternate.
        total: whether a row of sums is at the end.
    """
    named = dict(
        zip(
            FIELDS,
            (word.replace("_", " ") if words == "centres" else word for word in HEADERS[words].split()),
            strict=True,
        )
    )
    of_field = {field: units[1] if field == "weight" else units[0] for field in FIELDS[4:]}
    chosen = fields.split()
    header = [named[f] + (style.format(of_field[f]) if of_field.get(f) and not unit_row else "") for f in chosen]
    if turn:
        header.append(turn[0])
    above = [*map(list, titles), *([header] if headers else [])]
    if unit_row:
        above.append([f"[{of_field[f]}]" if of_field.get(f) else "" for f in chosen])
    sheets: dict[str, list[list[Any]]] = {}
    boxes = []
    pairs = [(view, k) for view in views for k in range(len(view))]
    if interleaved:
        pairs.sort(key=lambda pair: pair[1])
    for view, k in pairs:
        title = view.plan.name if sheet_each else "Plan"
        rows = sheets.setdefault(title, [list(row) for row in above])
        size = before_turn(view, k) if turn else view.size[k]
        known = {
            "pallet": view.plan.name,
            "step": int(view.step[k]) if view.step is not None else k + 1,
            "id": view.plan.ids[k],
            "article": view.plan.articles[k],
            "weight": float(view.weight[k]),
            **keyed("length height width" if view.vertical == 1 else "length width height", size),
            **keyed("x y z", view.place[k]),
        }
        boxes.append((title, len(rows)))
        rows.append([known[field] for field in chosen] + ([turn[1 + int(view.plan.turned[k])]] if turn else []))
    if total:
        for rows in sheets.values():
            sums = [TOTAL[words], *[None] * (len(header) - 1)]
            sums[chosen.index("weight")] = round(sum(row[chosen.index("weight")] for row in rows[len(above) :]), 3)
            rows += [[None] * len(header), sums]
    if name.endswith(".parquet"):
        sheets = {
            title: [rows[0], *[[float(c) if isinstance(c, int) else c for c in row] for row in rows[1:]]]
            for title, rows in sheets.items()
        }
    at = chosen.index("width"), chosen.index("y")
    place = Table(
        name,
        sheets,
        boxes,
        *at,
        len(above) - 1 - unit_row if headers else None,
        csv or Csv(),
        text_numbers,
        views[0].decimals,
    )
    return [place]


def types(
    name: str, views: Sequence[View], *, header: Sequence[str], csv: Csv | None = None, lines: int = 0
) -> list[Document]:
    """Rows of articles with quantities (and layers), without places."""
    (view,) = views
    kinds: dict[str, list[Any]] = {}
    for k, article in enumerate(view.plan.articles):
        row = kinds.setdefault(article, [article, *numbers(before_turn(view, k)), float(view.weight[k]), 0])
        row[5] += 1
    rows = [[*row, 1 + row[5] // 6][: len(header)] for row in kinds.values()]
    return [Table(name, {"Plan": [list(header), *rows]}, [], 2, 2, 0, csv or Csv())]


def certificate(name: str, views: Sequence[View], *, items: bool = True) -> list[Document]:
    """A certificate (solution file) of packingsolver, and beside it the table of items, which has the weights. The
    column ID is the row of the item in this table."""
    kinds: dict[str, list[Any]] = {}
    for view in views:
        for k, article in enumerate(view.plan.articles):
            row = kinds.setdefault(article, [*numbers(before_turn(view, k)), 0, float(view.weight[k])])
            row[3] += 1
    order = list(kinds)
    rows: list[list[Any]] = [["TYPE", "ID", "COPIES", "BIN", "X", "Y", "Z", "LX", "LY", "LZ", "ROTATION"]]
    boxes = []
    for number_, view in enumerate(views):
        rows.append(["BIN", 0, 1, number_, 0, 0, 0, *numbers(view.deck), None])
        for k in range(len(view)):
            boxes.append(("", len(rows)))
            turn = "YXZ" if view.plan.turned[k] else "XYZ"
            place = [*numbers(view.place[k]), *numbers(view.size[k])]
            rows.append(["ITEM", order.index(view.plan.articles[k]), 1, number_, *place, turn])
    documents: list[Document] = [Table(name, {"": rows}, boxes, 8, 5)]
    if items:
        stem = name.rpartition(".")[0]
        documents.append(
            Table(f"{stem}_items.csv", {"": [["X", "Y", "Z", "COPIES", "WEIGHT"], *kinds.values()]}, [], 1, 1)
        )
    return documents
