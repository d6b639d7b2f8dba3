"""Files of packing plans in the conventions of other tools, each with its right result. Tests read them with
``petmjx.load_plans``. This collection was written without looking at the code of the reader.

    PYTHONPATH=.:tests python -m support.foreign_files FOLDER

writes all files, each into a folder of the same name, and the damaged files into ``damaged``.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from support import foreign_json as js
from support import foreign_tables as tb
from support.foreign_case import Case, Damaged, case_of, damaged
from support.foreign_documents import KINDS, Csv
from support.foreign_plans import CUBE_MM, Convention, Packing, packing

__all__ = ["CASES", "KINDS", "READABLE", "Case", "Damaged", "damaged"]


P = partial(partial, packing)
BALANCED = {"packer": "balanced"}
CM, M = Convention("cm"), Convention("m")
GRAMS, POUNDS = Convention(mass="g"), Convention("in", "lb")
Y, CM_Y = Convention(up="y"), Convention("cm", up="y")
CENTRES, MIDDLE = Convention("m", anchor="centre"), Convention("m", anchor="centre", origin="middle")
Y_UP = frozenset({"mirror", "turn"})
SHIFT = frozenset({"shift"})
TITLES = (("Palettierplan 4711",), ("Stand: 28.11.2026", None, "Halle 3"), ())


def _bed_bpp_and_json() -> list[Case]:
    boxes, three_d = js.json_boxes, "dimensions:width height depth"
    pounds = {"size": "length_in width_in height_in", "place": "x_in y_in z_in", "weight": "weight_lb"}
    goods = {"size": "width height length", "root": "_Container._Goods", "deck": "_Width _Height _Length"}
    return [
        case_of("bed-bpp-cm-g.json", js.bed_bpp, P(0, 24), convention=Convention("cm", "g"), length="cm", mass="g"),
        case_of("bed-bpp-in-lb.json", js.bed_bpp, P(1, 18), P(2, 30, prefix="C"), POUNDS, length="in", mass="lb"),
        case_of(
            "bed-bpp-m-utf8-bom.json", js.bed_bpp, P(3, 40, **BALANCED), M, length="m", mass="kg", encoding="utf-8-sig"
        ),
        case_of("list.json", boxes, P(4, 54), root=""),
        case_of(
            "position-object-cm.json",
            boxes,
            P(5, 33),
            CM,
            place="position:x y z",
            size="dimensions:length width height",
            root="items",
            deck="pallet:length width height",
            extra={"units": "cm"},
        ),
        case_of(
            "arrays-centres-m.json",
            boxes,
            P(6, 20),
            CENTRES,
            place="position",
            size="size",
            root="placed",
            deck="container_size",
            weight="mass",
            indent=2,
        ),
        case_of("dx-dy-dz-grams.json", boxes, P(7, 19), GRAMS, size="dx dy dz", root="packed.boxes"),
        case_of(
            "lx-ly-lz.json",
            boxes,
            P(8, 15, **BALANCED),
            size="LX LY LZ",
            place="X Y Z",
            weight="",
            ids="ID",
            lost=("weight",),
        ),
        case_of(
            "whd-y-up.json", boxes, P(10, 29), Y, size="WHD", place="position", root="items", deck="bin", free=Y_UP
        ),
        case_of(
            "scene-graph-centres-y-up.json",
            boxes,
            P(5, 44, **BALANCED),
            Convention("m", anchor="centre", up="y"),
            place="position:x y z",
            size=three_d,
            root="scene.children",
            free=Y_UP,
        ),
        case_of(
            "scene-graph-middle-y-up.json",
            boxes,
            P(4, 40),
            Convention("m", anchor="centre", up="y", origin="middle"),
            place="position:x y z",
            size=three_d,
            weight="",
            root="meshes",
            free=Y_UP | SHIFT,
            lost=("weight",),
        ),
        case_of(
            "pallets-layers-boxes.json",
            boxes,
            P(11, 25),
            P(12, 41, prefix="C"),
            P(13, 18, prefix="D"),
            root="layers",
            size="size:l w h",
            place="pos:x y z",
        ),
        case_of("shuffled-with-step.json", boxes, P(14, 36), shuffled=True, step="sequence", root="items"),
        case_of(
            "shuffled-without-step.json", boxes, P(15, 28), shuffled=True, order="any", root="items", convention=CM
        ),
        case_of("numbers-with-units.json", boxes, P(16, 22), unit="mm"),
        case_of(
            "numbers-with-cm.json", boxes, P(17, 31, **BALANCED), CM, unit="cm", place="position:x y z", root="items"
        ),
        case_of("inches-pounds.json", boxes, P(18, 27), convention=POUNDS, **pounds),
        case_of("boxes-by-id.json", boxes, P(19, 26), root="by id", ids=""),
        case_of("far-corners.json", boxes, P(20, 34), size="max", place="min", far=True, weight="weight_kg"),
        case_of("json-lines.jsonl", boxes, P(21, 17), root="lines", convention=CM),
        case_of("columns.json", js.columns_json, P(22, 23)),
        case_of(
            "goods-sequence-y-up.json",
            boxes,
            P(23, 30),
            Y,
            shuffled=True,
            step="sequenceNr",
            weight="",
            free=Y_UP,
            lost=("weight",),
            **goods,
        ),
        case_of(
            "far-corner-anchor-cm.json",
            boxes,
            P(24, 21),
            Convention("cm", anchor="far-corner"),
            root="cartons",
            size="l w h",
        ),
        case_of(
            "base-centres.json",
            boxes,
            P(25, 38),
            Convention("mm", anchor="base-centre"),
            root="cartons",
            place="base_center",
            size="size",
        ),
        case_of(
            "middle-of-pallet.json",
            boxes,
            P(26, 45),
            Convention("mm", origin="middle"),
            root="boxes",
            deck="pallet:length width height",
        ),
        case_of("utf16.json", boxes, P(27, 20, prefix="Kiste Ä"), encoding="utf-16", root=""),
    ]


def _py3dbp() -> list[Case]:
    grid = {"grid_mm": 20}
    return [
        case_of("py3dbp-depth-up.json", js.py3dbp_json, P(0, 27)),
        case_of("py3dbp-height-up.json", js.py3dbp_json, P(2, 42), convention=Y, free=Y_UP),
        case_of(
            "py3dbp-decimals-as-text.json", js.py3dbp_json, P(5, 50, **BALANCED), P(7, 19, prefix="C"), CM, strings=True
        ),
        case_of(
            "py3dbp-metres-height-up.json", js.py3dbp_json, P(28, 24), Convention("m", up="y"), strings=True, free=Y_UP
        ),
        case_of("py3dbp-rows.csv", tb.py3dbp_csv, P(29, 33)),
        case_of("py3dbp-decimals-height-up.csv", tb.py3dbp_csv, P(30, 26), CM_Y, decimal_names=True, free=Y_UP),
        case_of("py3dbp-printed.txt", tb.py3dbp_text, P(31, 37)),
        case_of(
            "py3dbp-printed-two-bins-height-up.txt", tb.py3dbp_text, P(32, 21), P(33, 29, prefix="C"), CM_Y, free=Y_UP
        ),
        case_of("web-api-centres.json", js.web_api, P(4, 40, **grid), Convention("cm", anchor="centre"), turned=True),
        case_of("web-api-corners.json", js.web_api, P(35, 40), turned=False),
    ]


def _solvers() -> list[Case]:
    tens = {"grid_mm": 10}
    submission = {"sizes": False, "lost": (), "free": frozenset({"turn"})}
    short_m = Convention("m", anchor="centre", short_first=True)
    return [
        case_of("packingsolver-two-bins.csv", tb.certificate, P(0, 27), P(36, 44, prefix="C"), lost=("ids",)),
        case_of(
            "packingsolver-without-items.csv",
            tb.certificate,
            P(37, 35, **BALANCED),
            items=False,
            lost=("ids", "weight"),
        ),
        case_of("packingsolver-cm.csv", tb.certificate, P(38, 16, **tens), convention=CM, lost=("ids",)),
        case_of(
            "java-containers.json", js.java_containers, P(39, 20), P(40, 31, prefix="C"), P(41, 12, prefix="D"), GRAMS
        ),
        case_of("java-one-container-cm.json", js.java_containers, P(42, 48), convention=Convention("cm", "g")),
        case_of(
            "d-wave-one-bin.txt", tb.d_wave, P(43, 35, **tens), convention=CM, lost=("ids", "weight"), may_ask=True
        ),
        case_of("d-wave-two-bins-in-a-row.txt", tb.d_wave, P(44, 20), P(45, 28, prefix="C"), lost=("ids", "weight")),
        case_of("packvium-mm.json", js.packvium, P(46, 32), P(12, 20, prefix="C"), unit="mm", lost=("weight",)),
        case_of(
            "packvium-inches.json", js.packvium, P(48, 24), convention=Convention("in"), unit="in", lost=("weight",)
        ),
        case_of("benchmark-centres.json", js.benchmark, P(49, 39), convention=short_m, free=frozenset({"turn"})),
        case_of("benchmark-submission.json", js.benchmark, P(50, 34), convention=short_m, **submission),
        case_of(
            "benchmark-without-articles.json",
            js.benchmark,
            P(50, 34),
            short_m,
            articles=False,
            refused="it has no sizes, and no table of articles is beside it",
            **submission,
        ),
    ]


def _arrays_and_scenes() -> list[Case]:
    lost = {"lost": ("ids", "weight")}
    cube = {"deck": CUBE_MM, **BALANCED}
    return [
        case_of("sizes-corners.npy", tb.array, P(0, 27), columns="size place", **lost),
        case_of("corners-sizes-cm.npy", tb.array, P(2, 36), convention=CM, columns="place size", may_ask=True, **lost),
        case_of(
            "corners-far-corners-padded.npy",
            tb.array,
            P(4, 50, grid_mm=10, **cube),
            CM,
            columns="place high one zero one pad",
            may_ask=True,
            **lost,
        ),
        case_of("sizes-before-turn.npy", tb.array, P(5, 40, **BALANCED), columns="article place turn", **lost),
        case_of(
            "weights-in-a-column-m.npy", tb.array, P(7, 19), M, columns="size place weight", lost=("ids",), may_ask=True
        ),
        case_of("episodes.npz", tb.array, P(8, 15), P(13, 26), P(10, 29), columns="size place zero", **lost),
        case_of(
            "ten-units.npy",
            tb.array,
            P(11, 30, grid_mm=100, **cube),
            Convention("dm"),
            columns="size place",
            whole=True,
            free=frozenset({"scale"}),
            may_ask=True,
            **lost,
        ),
        case_of("named-arrays.npz", tb.named_arrays, P(12, 33), lost=("ids",)),
        case_of("poses-and-sizes.npz", tb.named_arrays, P(14, 28), convention=CENTRES, with_poses=True, lost=("ids",)),
        case_of("numbers-alone.txt", tb.plain_numbers, P(15, 26), may_ask=True, **lost),
        case_of("matrices-m.json", js.poses, P(16, 25), convention=CENTRES, way="matrix"),
        case_of("quaternions-w-first.json", js.poses, P(17, 21), convention=CENTRES, way="wxyz"),
        case_of("quaternions-w-last.json", js.poses, P(18, 30), convention=MIDDLE, way="xyzw", free=SHIFT),
        case_of("quaternions-named.json", js.poses, P(19, 18), convention=CENTRES, way="words"),
        case_of("scene-masses.xml", tb.mjcf, P(20, 24), convention=CENTRES),
        case_of(
            "scene-densities-on-pallet.xml",
            tb.mjcf,
            P(21, 31),
            Convention("m", anchor="base-centre", origin="middle"),
            density=True,
            base=True,
            pallet_m=0.144,
        ),
        case_of("scene-turned-quat.xml", tb.mjcf, P(22, 38, **BALANCED), convention=CENTRES, turn="quat"),
        case_of("scene-turned-euler-default.xml", tb.mjcf, P(23, 27), MIDDLE, turn="euler", default=True, free=SHIFT),
        case_of("tilted.json", js.poses, P(19, 18), CENTRES, way="wxyz", tilt=True, refused="a box is not level"),
        case_of("poses-alone.npy", tb.poses_alone, P(14, 28), convention=CENTRES, refused="it has no sizes"),
        case_of(
            "trajectories.npy",
            tb.pickled,
            P(8, 15),
            P(10, 29),
            refused="it is a pickle of objects, which is never read",
        ),
        case_of("scene-with-cylinder.xml", tb.mjcf, P(20, 24), CENTRES, cylinder=True, refused="a body is no box"),
    ]


def _sheets() -> list[Case]:
    numbered = "step id article length width height weight x y z"
    german = {"words": "de", "units": ("mm", "kg")}
    return [
        case_of("german-with-titles.xlsx", tb.table, P(0, 27), fields=numbered, titles=TITLES, **german),
        case_of(
            "french-sheet-each.xlsx",
            tb.table,
            P(2, 30),
            P(24, 20, prefix="C"),
            CM,
            words="fr",
            units=("cm", "kg"),
            style=" ({})",
            sheet_each=True,
        ),
        case_of(
            "english-centres-m.xlsx", tb.table, P(4, 44), CENTRES, words="centres", units=("m", "kg"), style=" ({})"
        ),
        case_of(
            "spanish-text-numbers.xlsx",
            tb.table,
            P(5, 25),
            CM,
            words="es",
            units=("cm", "kg"),
            csv=Csv(decimal=","),
            text_numbers=True,
        ),
        case_of(
            "english-inches-pallets-total.xlsx",
            tb.table,
            P(6, 22),
            P(26, 28, prefix="C"),
            POUNDS,
            units=("in", "lb"),
            fields="pallet id length width height weight x y z",
            style=" ({})",
            total=True,
        ),
        case_of("unit-row.xlsx", tb.table, P(7, 19), words="de", units=("cm", "kg"), convention=CM, unit_row=True),
        case_of("italian.ods", tb.table, P(10, 29), words="it", units=("mm", "kg"), style=" ({})", titles=TITLES[:1]),
        case_of("polish-cm.ods", tb.table, P(12, 41, **BALANCED), convention=CM, words="pl", units=("cm", "kg")),
        case_of(
            "french-grams-shuffled.ods",
            tb.table,
            P(13, 35),
            GRAMS,
            words="fr",
            units=("mm", "g"),
            fields=numbered,
            shuffled=True,
        ),
        case_of(
            "centimetres.parquet",
            tb.table,
            P(14, 36),
            CM,
            words="snake",
            fields="id length width height x y z",
            units=("cm", "kg"),
            style="_{}",
            lost=("weight",),
        ),
    ]


def _delimited() -> list[Case]:
    umlaut = {"prefix": "Käse-"}
    comma = partial(Csv, ";", ",")
    return [
        case_of(
            "german-cp1252.csv",
            tb.table,
            P(0, 27, **umlaut),
            words="de",
            units=("mm", "kg"),
            csv=comma(encoding="cp1252", end="\r\n"),
        ),
        case_of(
            "german-cm-bom.csv",
            tb.table,
            P(1, 18),
            CM,
            words="de",
            units=("cm", "kg"),
            style=" in {}",
            csv=comma(encoding="utf-8-sig"),
        ),
        case_of(
            "german-letters-thousands.csv",
            tb.table,
            P(2, 44),
            words="letters",
            units=("mm", "kg"),
            csv=comma(thousands="."),
        ),
        case_of(
            "french-cp1252.csv",
            tb.table,
            P(4, 33, prefix="Pâté "),
            CM,
            words="fr",
            units=("cm", "kg"),
            style=" ({})",
            csv=comma(encoding="cp1252"),
        ),
        case_of(
            "spanish-utf16-tabs.txt",
            tb.table,
            P(5, 51),
            words="es",
            units=("mm", "kg"),
            style=" ({})",
            csv=Csv("\t", ",", encoding="utf-16", end="\r\n"),
        ),
        case_of(
            "italian-bars.csv", tb.table, P(6, 24), convention=CM, words="it", units=("cm", "kg"), csv=Csv("|", ",")
        ),
        case_of("polish-metres.csv", tb.table, P(8, 15), convention=M, words="pl", units=("m", "kg"), csv=comma()),
        case_of(
            "english-centres-m.csv", tb.table, P(13, 26), CENTRES, words="centres", units=("m", "kg"), style=" ({})"
        ),
        case_of("sep-line.csv", tb.table, P(10, 29), units=("mm", "kg"), csv=comma(mark=True, end="\r\n")),
        case_of(
            "pallets-interleaved.csv",
            tb.table,
            P(11, 20),
            P(16, 30, prefix="C"),
            P(17, 26, prefix="D"),
            words="snake",
            fields="pallet id length width height weight x y z",
            interleaved=True,
        ),
        case_of(
            "steps-shuffled.csv",
            tb.table,
            P(18, 40),
            shuffled=True,
            fields="id step length width height weight x y z",
            units=("mm", "kg"),
        ),
        case_of(
            "rows-shuffled.csv",
            tb.table,
            P(19, 26),
            shuffled=True,
            order="any",
            units=("mm", "kg"),
            style="_{}",
            words="snake",
        ),
        case_of(
            "middle-of-pallet.csv", tb.table, P(20, 52), Convention(origin="middle"), units=("mm", "kg"), free=SHIFT
        ),
        case_of(
            "far-corner-of-pallet.csv",
            tb.table,
            P(22, 34),
            Convention("cm", origin="far"),
            units=("cm", "kg"),
            free=SHIFT,
        ),
        case_of(
            "right-corner-of-pallet.csv", tb.table, P(23, 43), Convention(origin="right"), words="short", free=SHIFT
        ),
        case_of("inches-pounds.csv", tb.table, P(25, 31), POUNDS, units=("in", "lbs"), style=" ({})"),
        case_of(
            "orientation-before-turn.csv", tb.table, P(4, 47), units=("mm", "kg"), turn=("Orientation", "LWH", "WLH")
        ),
        case_of(
            "rotation-before-turn-cm.csv", tb.table, P(5, 38, **BALANCED), CM, words="snake", turn=("rotation", 0, 90)
        ),
        case_of(
            "letters-without-units-cm.csv",
            tb.table,
            P(27, 23),
            CM,
            words="short",
            fields="id length width height weight x y z",
        ),
        case_of(
            "y-up.csv", tb.table, P(28, 37), Y, words="snake", fields="id x y z length height width weight", free=Y_UP
        ),
        case_of(
            "quoted-decimal-commas.csv", tb.table, P(29, 19), CM, units=("cm", "kg"), csv=Csv(",", ",", quote=True)
        ),
        case_of(
            "units-below-headers.csv", tb.table, P(30, 28), units=("mm", "kg"), unit_row=True, titles=(("Export",),)
        ),
        case_of(
            "no-headers.csv",
            tb.table,
            P(31, 20),
            fields="length width height x y z",
            headers=False,
            may_ask=True,
            lost=("ids", "weight"),
        ),
        case_of(
            "windows-no-weights.tsv",
            tb.table,
            P(32, 24),
            words="snake",
            fields="article length width height x y z",
            csv=Csv("\t", end="\r\n"),
            lost=("ids", "weight"),
        ),
    ]


def _without_places() -> list[Case]:
    no_places = "its rows are types with quantities, which have no places"
    english = ("Product", "Length (cm)", "Width (cm)", "Height (cm)", "Weight (kg)", "Quantity", "Layers")
    german = ("Artikel", "Länge [mm]", "Breite [mm]", "Höhe [mm]", "Gewicht [kg]", "Anzahl", "Lagen")
    either = "the file can be read in two ways: "
    return [
        case_of("types-with-layers.csv", tb.types, P(0, 40), convention=CM, header=english, refused=no_places),
        case_of("types-german.xlsx", tb.types, P(2, 42), header=german, refused=no_places),
        case_of(
            "types-quantities.csv", tb.types, P(4, 42), header=("sku", "l", "w", "h", "kg", "qty"), refused=no_places
        ),
        case_of(
            "thpack.txt", tb.thpack, P(5, 50), refused="it is an order: types of boxes with quantities, and no places"
        ),
        case_of("either-vertical.json", js.py3dbp_json, _cubes, refused=f"{either}with height or with depth upwards"),
        case_of(
            "either-turn.csv",
            tb.table,
            _far_apart,
            fields="id length width height x y z",
            units=("mm", "kg"),
            turn=("rotation", 0, 90),
            refused=f"{either}sizes before or after the turn",
        ),
        case_of(
            "either-unit.csv",
            tb.table,
            _small,
            CM,
            words="short",
            fields="id length width height x y z",
            refused=f"{either}centimetres or inches",
        ),
    ]


def _of_boxes(
    *boxes: tuple[tuple[float, ...], tuple[float, ...]], turned: bool = False, deck: tuple[float, float] | None = None
) -> Packing:
    """A packing of boxes that are given as (size, corner), mm."""
    size, corner = (np.array(values, float) for values in zip(*boxes, strict=True))
    names = tuple(f"B{k}" for k in range(1, len(boxes) + 1))
    plan = Packing("P1", size, corner, np.full(len(boxes), 6.0), names, names, np.full(len(boxes), turned))
    return plan if deck is None else replace(plan, deck=deck)


def _cubes() -> Packing:
    """Four cubes in a square. With one vertical axis, all four are on the deck; with another, two stand on two."""
    cube = (300.0, 300.0, 300.0)
    return _of_boxes(*((cube, (300.0 * x, 300.0 * y, 0.0)) for y in range(2) for x in range(2)), deck=(2000.0, 2000.0))


def _far_apart() -> Packing:
    """Two boxes with so much space between them that they may be turned or not."""
    size = (300.0, 400.0, 200.0)
    return _of_boxes((size, (0.0, 0.0, 0.0)), (size, (700.0, 300.0, 0.0)), turned=True)


def _small() -> Packing:
    """Eight boxes on a part of the deck. If the numbers are read as inches, they fill a pallet."""
    size = (200.0, 150.0, 100.0)
    return _of_boxes(*((size, (200.0 * x, 150.0 * y, 100.0 * z)) for z in range(2) for y in range(2) for x in range(2)))


CASES = {
    case.name: case
    for cases in (_bed_bpp_and_json, _py3dbp, _solvers, _arrays_and_scenes, _sheets, _delimited, _without_places)
    for case in cases()
}
READABLE = [name for name, case in CASES.items() if not case.refused]


if __name__ == "__main__":
    for name, case in CASES.items():
        print(case.write(Path(sys.argv[1]) / name), f"refused: {case.refused}" if case.refused else "")
        if not case.refused:
            bad = damaged(case)
            print(bad.write(Path(sys.argv[1]) / "damaged" / name), bad.kind, bad.place)
