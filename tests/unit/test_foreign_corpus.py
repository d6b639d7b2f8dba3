"""Tests of the corpus of files of other tools. The plans of the corpus can be built. The files of the corpus, read
without petmjx's reader, contain these plans. If only plausibility determines how a file must be read, no other reading
is as plausible."""

from __future__ import annotations

import csv
import io
import json
import re
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import openpyxl
import pytest
from scipy.spatial.transform import Rotation
from support.foreign_case import Case, buildable, difference, overlaps, plausible
from support.foreign_files import CASES, KINDS, READABLE, damaged
from support.foreign_plans import ANCHORS, MM, Convention, Packing, View

import petmjx

SURE = [name for name in READABLE if not CASES[name].may_ask]
ROUNDED_MM = 0.05
"""Tolerance of lengths, mm. In files, lengths are rounded to a tenth of a millimetre or better, centres to a twentieth,
and inches to a thousandth (0.025 mm)."""


def as_read(plan: Packing) -> SimpleNamespace:
    """A plan as petmjx must read it."""
    mass = np.full(plan.n, 5.0) if plan.weight is None else plan.weight
    return SimpleNamespace(size_mm=plan.size, corner_mm=plan.corner, mass_kg=mass, item_ids=plan.ids)


def upright(values: np.ndarray, view: View) -> np.ndarray:
    """The columns of a view in the order x, y, vertical."""
    return values[:, [0, 2, 1]] if view.vertical == 1 else values


def check_boxes(view: View, size: object, corner: object, weight: object = None) -> None:
    """Check that sizes and corners, in mm and along the view's axes, are those of the view's packing."""
    wanted = [view.plan.size, view.plan.corner]
    np.testing.assert_allclose(upright(np.asarray(size, float), view), wanted[0], atol=ROUNDED_MM)
    np.testing.assert_allclose(upright(np.asarray(corner, float), view), wanted[1], atol=ROUNDED_MM)
    if weight is not None:
        np.testing.assert_allclose(np.asarray(weight, float), view.plan.weight, rtol=1e-4)


def content(name: str, folder: Path) -> bytes:
    return CASES[name].write(folder).read_bytes()


def leaves(tree: object, path: str = "") -> Iterator[tuple[str, object]]:
    """(path, value) of each value in a JSON tree."""
    parts = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else None
    if parts is None:
        yield path, tree
        return
    for key, part in parts:
        yield from leaves(part, f"{path}/{key}")


def test_enough_cases_of_many_kinds() -> None:
    assert len(SURE) >= 80
    assert len({CASES[name].writer for name in READABLE}) >= 17
    assert len({CASES[name].convention for name in READABLE}) >= 20
    assert len({name.rpartition(".")[2] for name in CASES}) >= 10
    assert sum(bool(case.refused) for case in CASES.values()) >= 10
    # no two files contain the same plan in the same format
    assert len({(case.writer, case.convention, case.picks, str(case.form)) for case in CASES.values()}) == len(CASES)


@pytest.mark.parametrize("name", READABLE)
def test_the_right_plans_can_be_built(name: str) -> None:
    case = CASES[name]
    for plan in case.plans:
        assert 5 <= plan.n <= 60
        assert not overlaps(plan.size, plan.corner)
        assert buildable(plan.size, plan.corner)
        assert (plan.corner >= 0).all()
        assert ((plan.corner + plan.size)[:, :2] <= plan.deck).all()
        assert len(set(plan.corner[:, 2])) > 2
    assert not case.mismatch([as_read(plan) for plan in case.plans])


def test_where_only_plausibility_tells_no_other_reading_is_as_good() -> None:
    """If only plausibility determines how a file must be read, other readings are less plausible: with another anchor,
    another vertical axis (py3dbp) or sizes before rotation, boxes overlap or float."""
    for name in SURE:
        case = CASES[name]
        for view in case.views():
            size, place = (upright(values * MM[case.convention.length], view) for values in (view.size, view.place))
            for anchor in ANCHORS.keys() - {case.convention.anchor}:
                assert not plausible(size, place - size * ANCHORS[anchor]), (name, anchor)
            low = place - size * ANCHORS[case.convention.anchor]
            if name.startswith(("py3dbp", "web-api")):
                for axes in ([0, 2, 1], [1, 2, 0]):
                    assert not plausible(size[:, axes], low[:, axes]), (name, axes)
            if "turn" in name and not name.startswith("scene") and view.plan.turned.any():
                before = np.where(view.plan.turned[:, None], size[:, [1, 0, 2]], size)
                assert not plausible(before, low), name


def test_the_refused_can_be_read_in_two_ways_or_not_at_all(tmp_path: Path) -> None:
    cubes, apart, small = (
        CASES[name].picks[0]() for name in ("either-vertical.json", "either-turn.csv", "either-unit.csv")
    )
    assert plausible(cubes.size, cubes.corner)
    assert plausible(cubes.size[:, [0, 2, 1]], cubes.corner[:, [0, 2, 1]])
    assert plausible(apart.size, apart.corner)
    assert plausible(apart.size[:, [1, 0, 2]], apart.corner)
    as_inches = ((small.size + small.corner) * 2.54).max(0)
    assert (as_inches[:2] <= small.deck).all()
    rows = list(csv.reader(io.StringIO(content("types-with-layers.csv", tmp_path).decode())))
    assert rows[0][5:] == ["Quantity", "Layers"]
    assert sum(int(row[5]) for row in rows[1:]) == CASES["types-with-layers.csv"].picks[0]().n
    with pytest.raises(ValueError, match="allow_pickle"):
        np.load(CASES["trajectories.npy"].write(tmp_path))


def test_differences_are_seen() -> None:
    plan = CASES["list.json"].plans[0]
    read = as_read(plan)
    assert not difference(plan, read)
    moved, turned, heavy = (np.array(values) for values in (plan.corner, plan.size, plan.weight))
    moved[7, 1] += 0.5
    turned[3] = turned[3, [1, 0, 2]]
    heavy[5] *= 1.01
    shifted = plan.corner + np.array([20.0, 5.0, 0.0])
    assert "box 7: y" in difference(plan, SimpleNamespace(**{**vars(read), "corner_mm": moved}))
    assert "box 3: " in difference(plan, SimpleNamespace(**{**vars(read), "size_mm": turned}))
    assert "box 5: " in difference(plan, SimpleNamespace(**{**vars(read), "mass_kg": heavy}))
    of_shifted = SimpleNamespace(**{**vars(read), "corner_mm": shifted})
    assert difference(plan, of_shifted)
    assert not difference(plan, of_shifted, frozenset({"shift"}))
    raised = SimpleNamespace(**{**vars(read), "corner_mm": plan.corner + np.array([0.0, 0.0, 5.0])})
    assert difference(plan, raised, frozenset({"shift"}))
    far = plan.corner[:, [1]] + plan.size[:, [1]]
    mirrored = replace(plan, corner=np.hstack([plan.corner[:, [0]], 800 - far, plan.corner[:, [2]]]))
    quarter = replace(plan, corner=np.hstack([800 - far, plan.corner[:, [0, 2]]]), size=plan.size[:, [1, 0, 2]])
    diagonal = replace(plan, corner=plan.corner[:, [1, 0, 2]], size=plan.size[:, [1, 0, 2]])
    for other, free in ((mirrored, {"mirror"}), (quarter, {"turn"}), (diagonal, {"turn", "mirror"})):
        assert difference(plan, as_read(other))
        assert not difference(plan, as_read(other), frozenset(free))
    assert difference(plan, as_read(diagonal), frozenset({"turn"}))
    doubled = replace(plan, size=2 * plan.size, corner=2 * plan.corner)
    assert not difference(plan, as_read(doubled), frozenset({"scale"}))
    levels = plan.take(np.lexsort([plan.corner[:, 0], plan.corner[:, 2]]))
    assert difference(plan, as_read(levels))
    assert not difference(plan, as_read(levels), order="any")
    assert "before what bears it" in difference(plan, as_read(plan.take(np.arange(plan.n)[::-1])), order="any")
    case = CASES["shuffled-with-step.json"]
    assert case.mismatch([as_read(plan)])
    assert case.mismatch([]) == "0 plans instead of 1"
    assert "no sizes" in CASES["poses-alone.npy"].mismatch([as_read(plan)])


def test_plans_of_petmjx_are_compared(tmp_path: Path) -> None:
    """Plans are also compared in BED-BPP's own format, which petmjx reads in only one way."""
    case = replace(CASES["bed-bpp-in-lb.json"], convention=Convention(), form={"length": "mm", "mass": "kg"})
    plans = petmjx.load_plans(case.write(tmp_path)).plans
    assert not case.mismatch(plans)
    assert case.mismatch(plans[::-1])


def test_json_by_the_sources_of_its_tools(tmp_path: Path) -> None:
    """JSON files are checked with the definitions in their tools' sources: ``get_dimension`` of py3dbp,
    ``makeDictItem`` of the server, units of packvium, placements of containers, and poses."""
    sides = (
        lambda w, h, d: (w, h, d),
        lambda w, h, d: (h, w, d),
        lambda w, h, d: (h, d, w),
        lambda w, h, d: (d, h, w),
        lambda w, h, d: (d, w, h),
        lambda w, h, d: (w, d, h),
    )
    seen: set[int] = set()
    for name, unit in (
        ("py3dbp-depth-up.json", 1),
        ("py3dbp-height-up.json", 1),
        ("py3dbp-metres-height-up.json", 1000),
    ):
        (view,) = CASES[name].views()
        items = json.loads(content(name, tmp_path))[0]["fitted_items"]
        articles = np.array([[float(item[side]) for side in ("width", "height", "depth")] for item in items])
        turns = [item["rotation_type"] for item in items]
        size = np.array([sides[turn](*article) for turn, article in zip(turns, articles, strict=True)])
        corner = np.array([[float(value) for value in item["position"]] for item in items])
        check_boxes(view, size * unit, corner * unit, [item["weight"] for item in items])
        seen |= set(turns)
    assert seen == set(range(6))
    printed = content("py3dbp-printed.txt", tmp_path).decode()
    pattern = r"(\w+)\(([\d.]+)x([\d.]+)x([\d.]+), weight: ([\d.]+)\) pos\(\[(.*)\]\) rt\((\d)\)"
    rows = [row for row in re.findall(pattern, printed) if row[0] != "spare"]
    size = [sides[int(row[6])](*map(float, row[1:4])) for row in rows]
    corner = [[float(re.sub(r"[^\d.]", "", value)) for value in row[5].split(", ")] for row in rows]
    check_boxes(CASES["py3dbp-printed.txt"].views()[0], size, corner, [row[4] for row in rows])
    assert [row[0] for row in rows] == list(CASES["py3dbp-printed.txt"].plans[0].ids)

    items = json.loads(content("web-api-centres.json", tmp_path))["data"]["fitItem"]
    size = np.array([item["WHD"] for item in items])
    corner = np.array([item["position"] for item in items]) - size // 2
    check_boxes(CASES["web-api-centres.json"].views()[0], size * 10, corner * 10, [item["weight"] for item in items])

    for container, view in zip(
        json.loads(content("packvium-inches.json", tmp_path))["containers"],
        CASES["packvium-inches.json"].views(),
        strict=True,
    ):
        boxes = container["placements"]
        size = [[box["dimensions"][side]["ticks"] / 16000 for side in ("length", "width", "height")] for box in boxes]
        check_boxes(view, size, [[box["position"][axis]["ticks"] / 16000 for axis in "xyz"] for box in boxes])
        assert float(boxes[3]["dimensions"]["width"]["value"]) * 25.4 == pytest.approx(size[3][1], abs=1e-4)
    for container, view in zip(
        json.loads(content("java-containers.json", tmp_path))["containers"],
        CASES["java-containers.json"].views(),
        strict=True,
    ):
        boxes = container["stack"]["placements"]
        size = [[box["stackable"][side] for side in ("dx", "dy", "dz")] for box in boxes]
        grams = np.array([box["stackable"]["weight"] for box in boxes])
        check_boxes(view, size, [[box[axis] for axis in "xyz"] for box in boxes], grams / 1000)
    (view,) = CASES["quaternions-w-first.json"].views()
    boxes = json.loads(content("quaternions-w-first.json", tmp_path))["boxes"]
    turns = [Rotation.from_quat(box["quat"], scalar_first=True).as_matrix() for box in boxes]
    size = 1000 * np.array([np.abs(turn) @ box["size"] for turn, box in zip(turns, boxes, strict=True)])
    check_boxes(view, size, 1000 * np.array([box["pos"] for box in boxes]) - size / 2, [box["mass"] for box in boxes])
    boxes = json.loads(content("goods-sequence-y-up.json", tmp_path))["_Container"]["_Goods"]
    boxes.sort(key=lambda box: box["sequenceNr"])
    plan = CASES["goods-sequence-y-up.json"].plans[0]
    np.testing.assert_allclose([[box["width"], box["length"], box["height"]] for box in boxes], plan.size)
    np.testing.assert_allclose([[box["x"], box["z"], box["y"]] for box in boxes], plan.corner)


@pytest.mark.parametrize("name", [name for name in READABLE if name.startswith("scene-") and name.endswith(".xml")])
def test_scenes_by_mujoco(name: str, tmp_path: Path) -> None:
    """Scenes are checked with MuJoCo: the boxes are those of MuJoCo's model in its initial state."""
    case = CASES[name]
    (view,) = case.views()
    model = mujoco.MjModel.from_xml_path(str(case.write(tmp_path)))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    floor_m = case.form.get("pallet_m", 0.0)
    geoms = [model.body(name).geomadr[0] for name in view.plan.ids]
    half = np.array([np.abs(data.geom_xmat[geom].reshape(3, 3)) @ model.geom_size[geom] for geom in geoms])
    middle = np.array([data.geom_xpos[geom] for geom in geoms])
    origin_m = 0.0 if case.convention.origin == "corner" else np.array([0.6, 0.4, 0.0])
    corner = middle - half + origin_m - [0, 0, floor_m]
    check_boxes(view, 2000 * half, 1000 * corner, [model.body(name).mass[0] for name in view.plan.ids])


def test_tables_by_other_readers(tmp_path: Path) -> None:
    """Tables are checked with other readers: Python's csv, openpyxl, the XML of an .ods file, and NumPy."""
    text = content("german-cp1252.csv", tmp_path).decode("cp1252")
    header, *rows = csv.reader(io.StringIO(text), delimiter=";")
    assert header[2:6] == ["Länge [mm]", "Breite [mm]", "Höhe [mm]", "Gewicht [kg]"]
    values = np.array([[float(cell.replace(",", ".")) for cell in row[2:]] for row in rows])
    (view,) = CASES["german-cp1252.csv"].views()
    check_boxes(view, values[:, :3], values[:, 4:], values[:, 3])
    assert rows[0][0] == "Käse-001"
    text = content("spanish-utf16-tabs.txt", tmp_path).decode("utf-16")
    header, *rows = csv.reader(io.StringIO(text), delimiter="\t")
    assert header[2] == "Largo (mm)"
    text = content("german-letters-thousands.csv", tmp_path).decode()
    rows = list(csv.reader(io.StringIO(text), delimiter=";"))[1:]
    assert any("." in cell for row in rows for cell in row[6:])
    values = np.array([[float(cell.replace(".", "").replace(",", ".")) for cell in row[2:]] for row in rows])
    check_boxes(CASES["german-letters-thousands.csv"].views()[0], values[:, :3], values[:, 4:], values[:, 3])
    rows = list(csv.DictReader(io.StringIO(content("y-up.csv", tmp_path).decode())))
    plan = CASES["y-up.csv"].plans[0]
    size = [[float(row[side]) for side in ("length", "width", "height")] for row in rows]
    np.testing.assert_allclose(size, plan.size)
    np.testing.assert_allclose([[float(row[f"pos_{axis}"]) for axis in "xzy"] for row in rows], plan.corner)

    book = openpyxl.load_workbook(CASES["french-sheet-each.xlsx"].write(tmp_path))
    views = CASES["french-sheet-each.xlsx"].views()
    assert book.sheetnames == [view.plan.name for view in views]
    for sheet, view in zip(book, views, strict=True):
        header, *rows = sheet.iter_rows(values_only=True)
        assert header[2] == "Longueur (cm)"
        values = np.array([row[2:] for row in rows], float)
        check_boxes(view, values[:, :3] * 10, values[:, 4:] * 10, values[:, 3])
    with zipfile.ZipFile(CASES["polish-cm.ods"].write(tmp_path)) as archive:
        written = archive.read("content.xml").decode()
    assert "Szerokość [cm]" in written
    values = np.array(re.findall(r'office:value="(-?[\d.]+)"', written), float).reshape(-1, 7)
    check_boxes(CASES["polish-cm.ods"].views()[0], values[:, :3] * 10, values[:, 4:] * 10, values[:, 3])

    array = np.load(CASES["corners-far-corners-padded.npy"].write(tmp_path))
    array = array[array[:, 8] == 1]
    (view,) = CASES["corners-far-corners-padded.npy"].views()
    check_boxes(view, (array[:, 3:6] - array[:, :3]) * 10, array[:, :3] * 10)
    rows = list(csv.DictReader(io.StringIO(content("packingsolver-two-bins.csv", tmp_path).decode())))
    items = list(csv.DictReader(io.StringIO((tmp_path / "packingsolver-two-bins_items.csv").read_text())))
    for number, view in enumerate(CASES["packingsolver-two-bins.csv"].views()):
        boxes = [row for row in rows if row["TYPE"] == "ITEM" and int(row["BIN"]) == number]
        size = [[row[side] for side in ("LX", "LY", "LZ")] for row in boxes]
        weight = [items[int(row["ID"])]["WEIGHT"] for row in boxes]
        check_boxes(view, size, [[row[axis] for axis in "XYZ"] for row in boxes], weight)


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_differ_at_one_place(kind: str) -> None:
    for name in READABLE:
        case: Case = CASES[name]
        document = case.documents()[0]
        bad = damaged(case, kind)
        sound = document.content()
        assert bad.content != sound, name
        if bad.kind == "truncated":
            assert len(bad.content) < len(sound), name
            continue
        assert bad.place.row is not None
        assert bad.place.column
        if name.endswith((".csv", ".tsv", ".txt", ".xml")):
            encoding = getattr(document, "csv", document).encoding
            before, after = (text.decode(encoding).splitlines() for text in (sound, bad.content))
            changed = [line for line, (a, b) in enumerate(zip(before, after, strict=True), 1) if a != b]
            assert changed == [bad.place.row], name
        elif name.endswith(".json"):
            before, after = (dict(leaves(json.loads(text.decode(document.encoding)))) for text in (sound, bad.content))
            # packvium writes each length twice, but an empty length only once
            assert sum(before.get(path, ...) != value for path, value in after.items()) in (
                1,
                1 + name.startswith("packvium"),
            ), name
    message = "list.json: box 27: y must be a number, got 4q0"
    assert not damaged(CASES["list.json"], "word").lacks(message.replace("27", "26"))
    assert damaged(CASES["list.json"], "word").lacks(message) == "the row"
    assert damaged(CASES["list.json"], "word").lacks(message.replace("27: y", "26: x")) == "the column"
    assert damaged(CASES["list.json"], "word").lacks("other.json") == "the file"
