"""Writers of JSON files in the forms of other tools. Each writer takes packings in the units and axes of its tool, and
returns documents (files), the main one first. The forms are those of the tools' output, documentation or source code;
the contents are petmjx's own."""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from support.foreign_documents import Document, Json, Table
from support.foreign_plans import MM, View

Box = dict[str, Any]
PY3DBP = ("WHD", "HWD", "HDW", "DHW", "DWH", "WDH")
"""Rotation types of py3dbp, in their order: the letters of the sides along x, y and z."""
LEVEL = [
    np.diag(signs)[list(axes)]
    for axes in itertools.permutations(range(3))
    for signs in itertools.product((1, -1), repeat=3)
]
LEVEL = [matrix for matrix in LEVEL if np.linalg.det(matrix) > 0]
"""The 24 rotations after which a box is level."""


def number(value: float) -> int | float:
    value = float(value)
    return int(value) if value.is_integer() else value


def numbers(values: Sequence[float] | np.ndarray) -> list[int | float]:
    return [number(value) for value in values]


def keyed(names: str, values: Sequence[float] | np.ndarray) -> dict[str, int | float]:
    return dict(zip(names.split(), numbers(values), strict=True))


def before_turn(view: View, k: int) -> np.ndarray:
    """The sizes of a box before it was turned about the vertical."""
    size, flat = view.size[k].copy(), [axis for axis in range(3) if axis != view.vertical]
    if view.plan.turned[k]:
        size[flat] = size[flat[::-1]]
    return size


def six_ways(view: View, k: int) -> tuple[list[int | float], int]:
    """Width, height and depth of the article, and the rotation type that turns them into the sizes of the placed
    box."""
    placed = numbers(view.size[k])
    sides = sorted(placed)
    letters = PY3DBP[zlib.crc32(view.plan.articles[k].encode()) % 6]  # all boxes of one article have the same sides
    article = [sides["WHD".index(letter)] for letter in letters]
    rotated = [[article["WHD".index(letter)] for letter in letters] for letters in PY3DBP]
    return article, rotated.index(placed)


def local(view: View, k: int) -> tuple[np.ndarray, np.ndarray]:
    """A rotation after which the box is level, and the sizes of the box in its own frame."""
    turn = LEVEL[(7 * k + 5) % 24]
    return turn, np.abs(turn).T @ view.size[k]


def tree(
    name: str,
    views: Sequence[View],
    *,
    item: Callable[[View, int], Any],
    wrap: Callable[[list[list[Any]], Sequence[View]], Any],
    size: tuple[str | int, ...],
    place: tuple[str | int, ...],
    encoding: str = "utf-8",
    indent: int | None = None,
    lines: bool = False,
) -> list[Document]:
    """A JSON file. ``item`` makes the value of each box, and ``wrap`` puts all boxes together."""
    boxes = [[item(view, k) for k in range(len(view))] for view in views]
    flat = [(k, box) for plan in boxes for k, box in enumerate(plan)]
    return [Json(name, wrap(boxes, views), flat, size, place, encoding, indent, lines)]


def columns_json(name: str, views: Sequence[View]) -> list[Document]:
    """A data frame as ``to_dict("list")`` returns it: one list for each column."""
    (view,) = views
    root: dict[str, list[Any]] = {"id": list(view.plan.ids)}
    for names, values in (("x y z", view.place), ("length width height", view.size), ("weight", view.weight[:, None])):
        root |= {column: numbers(values[:, axis]) for axis, column in enumerate(names.split())}
    return [Json(name, root, [(k, _ColumnBox(root, k)) for k in range(len(view))], ("width",), ("y",))]


class _ColumnBox:
    """A box whose values are in lists, one list for each column."""

    def __init__(self, root: dict[str, list[Any]], row: int) -> None:
        self.root, self.row = root, row

    def __getitem__(self, key: str) -> Any:
        return self.root[key][self.row]

    def __setitem__(self, key: str, value: Any) -> None:
        self.root[key][self.row] = value


def json_boxes(
    name: str,
    views: Sequence[View],
    *,
    place: str = "x y z",
    size: str = "length width height",
    far: bool = False,
    weight: str = "weight",
    ids: str = "id",
    step: str = "",
    root: str = "boxes",
    deck: str = "",
    unit: str = "",
    extra: Box | None = None,
    indent: int | None = None,
    encoding: str = "utf-8",
) -> list[Document]:
    """JSON in the forms of many programs.

    Args:
        place, size: keys of the three values: "x y z"; in a dictionary of their own, "position:x y z"; or as a list,
            "position".
        far: whether the far corners are written instead of sizes.
        weight, ids, step: keys of these values. Empty if they are not written.
        root: where the boxes are. An empty text: the file is a list of boxes. A key: the list with this key. "by id": a
            dictionary of boxes; "layers": pallets, layers, boxes; "lines": JSON Lines.
        deck: keys of the sizes of the deck, in the same form as those of boxes. Empty if they are not written.
        unit: unit that follows each number, which is then a text. Empty if numbers are written as numbers.
        extra: further entries of the root.
    """

    def shown(value: float) -> Any:
        return f"{number(value)} {unit}" if unit else number(value)

    def three(names: str, values: np.ndarray) -> Box:
        key, _, inner = names.rpartition(":")
        listed = [shown(value) for value in values]
        if " " not in inner:
            return {inner: listed}
        words = dict(zip(inner.split(), listed, strict=True))
        return {key: words} if key else words

    def item(view: View, k: int) -> Box:
        box: Box = {ids: view.plan.ids[k]} if ids else {}
        box |= three(size, view.size[k] + (view.place[k] if far else 0)) | three(place, view.place[k])
        box |= {weight: f"{number(view.weight[k])} kg" if unit else number(view.weight[k])} if weight else {}
        return box | ({step: int(view.step[k]) if view.step is not None else k + 1} if step else {})

    def wrap(boxes: list[list[Any]], views: Sequence[View]) -> Any:
        about = {**(three(deck, views[0].deck) if deck else {}), **(extra or {})}
        if root in ("", "lines"):
            return boxes[0]
        if root == "by id":
            return {**about, "boxes": dict(zip(views[0].plan.ids, boxes[0], strict=True))}
        if root == "layers":
            layers = [[{"boxes": plan[k : k + 6]} for k in range(0, len(plan), 6)] for plan in boxes]
            pallets = [{"id": view.plan.name, "layers": part} for view, part in zip(views, layers, strict=True)]
            return {**about, "result": {"pallets": pallets, "unplaced": []}}
        outer, _, key = root.rpartition(".")
        return {outer: {**about, key: boxes[0]}} if outer else {**about, key: boxes[0]}

    paths = []
    for names in (size, place):
        key, _, inner = names.rpartition(":")
        words = inner.split()
        paths.append(
            tuple(part for part in (key, words[1] if len(words) > 1 else inner) if part)
            + ((1,) if len(words) == 1 else ())
        )
    return tree(
        name,
        views,
        item=item,
        wrap=wrap,
        size=paths[0],
        place=paths[1],
        encoding=encoding,
        indent=indent,
        lines=root == "lines",
    )


def bed_bpp(name: str, views: Sequence[View], *, length: str, mass: str, encoding: str = "utf-8") -> list[Document]:
    def item(view: View, k: int) -> Box:
        sides = {
            f"{side}/{length}": value for side, value in keyed("length width height", before_turn(view, k)).items()
        }
        goods = {"article": view.plan.articles[k], "id": view.plan.ids[k], "product_group": "food", **sides}
        return {
            "item": {**goods, f"weight/{mass}": number(view.weight[k]), "sequence": k + 1},
            "orientation": int(view.plan.turned[k]),
            "flb_coordinates": numbers(view.place[k]),
        }

    return tree(
        name,
        views,
        item=item,
        wrap=lambda boxes, views: {view.plan.name: plan for view, plan in zip(views, boxes, strict=True)},
        size=("item", f"width/{length}"),
        place=("flb_coordinates", 1),
        encoding=encoding,
    )


def py3dbp_json(name: str, views: Sequence[View], *, strings: bool = False) -> list[Document]:
    """The attributes of py3dbp's bins and items. ``strings``: whether decimals are texts, as
    ``json.dumps(default=str)`` writes them."""

    def item(view: View, k: int) -> Box:
        sides, turn = six_ways(view, k)
        shown = (lambda value: f"{value:.{view.decimals}f}") if strings else float
        return {
            "name": view.plan.ids[k],
            **{side: shown(value) for side, value in zip(("width", "height", "depth"), sides, strict=True)},
            "weight": shown(view.weight[k]),
            "rotation_type": turn,
            "position": [shown(value) for value in view.place[k]],
            "number_of_decimals": view.decimals,
        }

    def wrap(boxes: list[list[Any]], views: Sequence[View]) -> Any:
        spare = {"name": "left over", "width": 50.0, "height": 40.0, "depth": 30.0, "weight": 1.0, "rotation_type": 0}
        return [
            {
                "bin": f"{view.plan.name}({'x'.join(str(float(side)) for side in view.deck)}, max_weight:1500.0)",
                "fitted_items": plan,
                "unfitted_items": [{**spare, "position": [0, 0, 0], "number_of_decimals": 1}],
            }
            for view, plan in zip(views, boxes, strict=True)
        ]

    return tree(name, views, item=item, wrap=wrap, size=("height",), place=("position", 2), indent=1)


def web_api(name: str, views: Sequence[View], *, turned: bool) -> list[Document]:
    """The answer of a server that a fork of py3dbp has, in whole numbers. ``turned``: if True, WHD are the sizes as
    placed, and positions are centres, as its code writes; if False, WHD are the sizes before the rotation, and
    positions are corners, as its documentation shows."""
    whole = all((view.size % 2 == 0).all() for view in views)
    assert whole or not turned, "the server halves whole numbers"

    def item(view: View, k: int) -> Box:
        sides, turn = six_ways(view, k)
        return {
            "WHD": numbers(view.size[k]) if turned else sides,
            "color": "#FFFF37",
            "loadbear": 100,
            "name": view.plan.articles[k],
            "partNumber": view.plan.ids[k],
            "position": numbers(view.place[k]),
            "rotationType": turn,
            "type": "cube",
            "weight": number(view.weight[k]),
        }

    def wrap(boxes: list[list[Any]], views: Sequence[View]) -> Any:
        (view,) = views
        spare = {"WHD": [70, 100, 30], "color": "blue", "name": "spare", "partNumber": "spare-1", "position": [0, 0, 0]}
        box = {
            "WHD": numbers(view.deck),
            "gravity": [],
            "partNumber": "Bin",
            "position": numbers(view.deck / 2),
            "weight": 1500,
        }
        return {
            "Success": True,
            "data": {
                "box": [box],
                "fitItem": boxes[0],
                "unfitItem": [{**spare, "rotationType": 5, "type": "cube", "weight": 20}],
            },
        }

    return tree(name, views, item=item, wrap=wrap, size=("WHD", 1), place=("position", 0), indent=2)


def java_containers(name: str, views: Sequence[View]) -> list[Document]:
    """Containers of a Java program that packs containers. Each has a stack of placements."""

    def item(view: View, k: int) -> Box:
        goods = {
            "id": view.plan.ids[k],
            "name": view.plan.articles[k],
            **keyed("dx dy dz", view.size[k]),
            "type": "box",
        }
        return {
            "stackable": {**goods, "weight": round(float(view.weight[k]))},
            **keyed("x y z", view.place[k]),
            "step": k,
            "points": [],
        }

    def wrap(boxes: list[list[Any]], views: Sequence[View]) -> Any:
        containers = []
        for number_, (view, plan) in enumerate(zip(views, boxes, strict=True)):
            deck = keyed("dx dy dz", view.deck)
            loads = dict(zip(("loadDx", "loadDy", "loadDz"), deck.values(), strict=True))
            stack = {"step": 0, "placements": plan}
            about = {"id": view.plan.name, "name": f"pallet {number_ + 1}", "type": "container", "step": number_}
            containers.append({**about, **deck, **loads, "stack": stack})
        return {"containers": containers}

    return tree(name, views, item=item, wrap=wrap, size=("stackable", "dy"), place=("x",))


def packvium(name: str, views: Sequence[View], *, unit: str) -> list[Document]:
    """A result of packvium, with lengths as ticks of 1/16000 mm, and as texts with a unit. The result has no weights of
    items."""

    def length(value: float) -> Box:
        return {"ticks": round(float(value) * MM[unit] * 16000), "value": f"{number(value)}", "unit": unit}

    def lengths(names: str, values: np.ndarray) -> Box:
        return {key: length(value) for key, value in zip(names.split(), values, strict=True)}

    def item(view: View, k: int) -> Box:
        return {
            "item_id": view.plan.ids[k],
            "item_type": view.plan.articles[k],
            "position": lengths("x y z", view.place[k]),
            "dimensions": lengths("length width height", view.size[k]),
            "orientation": "WLH" if view.plan.turned[k] else "LWH",
            "support_ratio": "1.000000",
            "top_load": {"ticks": 40_000_000_000, "value": "5000", "unit": "g"},
        }

    def wrap(boxes: list[list[Any]], views: Sequence[View]) -> Any:
        containers = []
        for view, plan in zip(views, boxes, strict=True):
            deck = lengths("length width height", view.deck)
            about = {"id": view.plan.name, "container_type": "euro", "inner_dimensions": deck, "outer_dimensions": deck}
            containers.append({**about, "volume_utilization": "0.500000", "placements": plan})
        done = {
            "status": "feasible",
            "complete": True,
            "score": [0, 1],
            "algorithm": {"profile": "balanced", "seed": 0},
        }
        return {**done, "containers": containers, "unpacked_items": [], "warnings": [], "alternatives": []}

    return tree(name, views, item=item, wrap=wrap, size=("dimensions", "width"), place=("position", "x"))


def benchmark(name: str, views: Sequence[View], *, sizes: bool = True, articles: bool = True) -> list[Document]:
    """The newer benchmark: centres in metres, with x along the width. ``sizes``: if False, the file is a submission
    without sizes, and a table of articles (with sizes before the turn) is beside it."""
    (view,) = views

    def item(view: View, k: int) -> Box:
        box: Box = {"id": view.plan.ids[k], "sku_id": view.plan.articles[k], "position": keyed("x y z", view.place[k])}
        if sizes:
            box |= {"dimensions": keyed("width depth height", view.size[k]), "weight": number(view.weight[k])}
        return {**box, "rotation": 90 if view.plan.turned[k] else 0}

    def wrap(boxes: list[list[Any]], views: Sequence[View]) -> Any:
        root = {"order_id": view.plan.name, "boxes": boxes[0]}
        if not sizes:
            return root
        return {
            "container": keyed("width depth height", view.deck),
            **root,
            "kind": "full",
            "stats": {"placed": len(view)},
        }

    documents = tree(name, views, item=item, wrap=wrap, size=("dimensions", "depth"), place=("position", "y"))
    if not sizes and articles:
        rows: dict[str, list[Any]] = {}
        for k in range(len(view)):
            rows[view.plan.articles[k]] = [view.plan.articles[k], *before_turn(view, k), float(view.weight[k])]
        table = [["sku_id", "width", "depth", "height", "weight"], *rows.values()]
        documents.append(Table("articles.csv", {"": table}, [], 1, 1))
    return documents


def poses(name: str, views: Sequence[View], *, way: str, tilt: bool = False) -> list[Document]:
    """Poses of the boxes' centres, in metres. The boxes are turned by any of the 24 rotations after which they are
    level. ``way``: how rotations are written, "matrix", "wxyz", "xyzw" or "words"; ``tilt``: whether one box leans."""

    def item(view: View, k: int) -> Box:
        turn, size = local(view, k)
        rotation = Rotation.from_matrix(turn)
        if tilt and k == len(view) - 1:
            rotation = Rotation.from_euler("x", 20, degrees=True) * rotation
        x, y, z, w = (round(float(value), 8) for value in rotation.as_quat())
        pose: Box = {
            "matrix": {
                "pose": np.block([[rotation.as_matrix().round(9), view.place[k][:, None]], [0, 0, 0, 1]]).tolist()
            },
            "wxyz": {"pos": numbers(view.place[k]), "quat": [w, x, y, z]},
            "xyzw": {"position": numbers(view.place[k]), "orientation": [x, y, z, w]},
            "words": {"position": keyed("x y z", view.place[k]), "orientation": {"x": x, "y": y, "z": z, "w": w}},
        }[way]
        return {"name": view.plan.ids[k], "size": numbers(size), "mass": number(view.weight[k]), **pose}

    place = {"matrix": ("pose", 1, 3), "wxyz": ("pos", 1), "xyzw": ("position", 1), "words": ("position", "y")}[way]
    return tree(name, views, item=item, wrap=lambda boxes, views: {"boxes": boxes[0]}, size=("size", 1), place=place)
