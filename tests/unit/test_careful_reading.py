"""Tests of files of other tools that could be read in several ways. petmjx refuses such a file, asks the user for an
option, or names its choice in a note."""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
from itertools import product
from pathlib import Path

import numpy as np
import pytest

import petmjx
from petmjx.show.file_info import file_infos, info_lines

pytestmark = pytest.mark.filterwarnings("ignore::petmjx.PlanWarning")

NAMES = "name,x [mm],y [mm],z [mm],length [mm],width [mm],height [mm],weight [kg]"
BOXES = np.array([[0, 0, 0, 400, 300, 200], [400, 0, 0, 300, 300, 200], [200, 0, 200, 350, 300, 150.0]])
"""(x, y, z, length, width, height), mm, of three boxes: two on the deck, and one that lies across both."""


def load(tmp_path: Path, name: str, content: str | bytes, **options: object) -> petmjx.PlanSet:
    file = tmp_path / name
    file.write_bytes(content.encode() if isinstance(content, str) else content)
    return petmjx.load_plans(file, **options)


def refusal(plan_set: petmjx.PlanSet) -> str:
    """The message of one line about a file from which no plan was read."""
    assert not plan_set.plans
    (skipped,) = plan_set.skipped
    assert "\n" not in skipped.message
    return skipped.message


def array_bytes(shape: str, dtype: str = "<f8", values: bytes = b"", version: int = 1) -> bytes:
    """An .npy file whose header states the given shape, followed by ``values``, which may not fit this shape."""
    header = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return (
        b"\x93NUMPY" + bytes([version, 0]) + struct.pack("<H" if version == 1 else "<I", len(header)) + header + values
    )


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (array_bytes("(100000000000, 6)", values=BOXES.tobytes()), "4,800,000,000,000 bytes, but 144 bytes follow"),
        (array_bytes("(4, 6)", values=BOXES.tobytes(), version=2), "192 bytes, but 144 bytes follow"),
        (array_bytes("(2, 6)", values=BOXES.tobytes()), "96 bytes, but 144 bytes follow"),
        (array_bytes("(100000000000, 0)"), "without values"),
        (array_bytes("(100000000000,)", "<U0"), "without values"),
        (array_bytes("(-1, 6)", values=BOXES.tobytes()), "header cannot be read"),
        (array_bytes("((((", values=BOXES.tobytes()), "header cannot be read"),
        (array_bytes("(3, 6)", values=BOXES.tobytes()).replace(b"'<f8'", b"()   "), "header cannot be read"),
        (array_bytes("(3, 6)", "|O", BOXES.tobytes()), "Python objects"),
        (b"\x93NUMPY\x01\x00", "header cannot be read"),
        (b"\x93NUMPY\x02\x00\xff\xff\xff\x7f", "header cannot be read"),
    ],
)
def test_an_array_whose_header_does_not_fit_its_bytes_is_refused(tmp_path: Path, content: bytes, fault: str) -> None:
    assert fault in refusal(load(tmp_path, "load.npy", content))
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("boxes.npy", content)
    message = refusal(load(tmp_path, "load.npz", packed.getvalue()))
    assert fault in message
    assert "boxes.npy" in message


def test_arrays_of_all_versions_are_read(tmp_path: Path) -> None:
    for version in (1, 2, 3):
        content = array_bytes("(3, 6)", values=BOXES.tobytes(), version=version)
        (plan,) = load(tmp_path, "load.npy", content, units="mm").plans
        np.testing.assert_array_equal(plan.corner_mm, BOXES[:, :3])


@pytest.mark.parametrize("digits", [350, 5000])
@pytest.mark.parametrize("lines", [False, True])
def test_whole_numbers_of_thousands_of_digits_are_named_with_their_place(
    tmp_path: Path, digits: int, lines: bool
) -> None:
    names = ("x", "y", "z", "length", "width", "height")
    rows = [dict(zip(names, row, strict=True)) for row in BOXES.tolist()]
    rows[1]["width"] = "MANY"
    text = "\n".join(map(json.dumps, rows)) if lines else json.dumps(rows)
    plan_set = load(tmp_path, "load.jsonl" if lines else "load.json", text.replace('"MANY"', "9" * digits), units="mm")
    assert f"{'line 2' if lines else '[1]'}: width must be finite" in refusal(plan_set)


def table(rows: list[list[object]], names: str = NAMES) -> str:
    return "\n".join([names, *(",".join(map(str, row)) for row in rows)])


def named(last: str, values: object) -> list[list[object]]:
    """A table with four boxes of different sizes, and an additional last row."""
    boxes = [
        ["a", 0, 0, 0, 400, 300, 200, 6.5],
        ["b", 400, 0, 0, 300, 300, 200, 5],
        ["c", 0, 300, 0, 300, 250, 100, 2.25],
        ["d", 200, 0, 200, 350, 300, 150, 4],
    ]
    numbers = np.array([box[1:] for box in boxes], float)
    row = {"sums": numbers.sum(axis=0), "means": numbers.mean(axis=0).round(1)}.get(str(values), values)
    return [*boxes, [last, *row]]


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("Mittelwert", "means"), ("Ø", "means"), ("", "means"), ("", "sums"), ("all", "sums"), ("Średnia:", "means"),
        ("Durchschnitt", [0, 0, 200, 300, 300, 200, 5]), ("Summe (4)", [0, 0, 350, 300, 250, 200, 17.75]),
        ("Moyenne", "means"), ("Total fruit", ["", "", "", "", "", "", 17.75]),
    ],
)  # fmt: skip
def test_a_row_of_totals_or_means_is_no_box(tmp_path: Path, name: str, values: object) -> None:
    plan_set = load(tmp_path, "load.csv", table(named(name, values)))
    (plan,) = plan_set.plans
    assert plan.n_boxes == 4
    ((_, reading),) = plan_set.readings.items()
    assert any(note.startswith("row 6 ") and note.endswith("left out") for note in reading.notes)


def test_a_total_in_json_is_no_box(tmp_path: Path) -> None:
    names = ("name", "x", "y", "z", "length", "width", "height", "weight")
    for last in (named("Total", [0, 0, 350, 300, 250, 200, 17.75]), named("", "sums")):
        rows = [dict(zip(names, row, strict=True)) for row in last]
        (plan,) = load(tmp_path, "load.json", json.dumps(rows), units="mm").plans
        assert plan.n_boxes == 4


def test_boxes_that_look_like_sums_or_means_are_boxes(tmp_path: Path) -> None:
    plans = {
        "called Total fruit": [*named("Total fruit", [0, 0, 350, 300, 250, 200, 5])],
        "two halves below": [
            ["a", 0, 0, 0, 300, 400, 200, 5], ["b", 300, 0, 0, 300, 400, 200, 5], ["c", 0, 0, 200, 600, 400, 200, 10],
        ],
        "the corners of a layer": [
            [name, x, y, 0, 400, 300, 200, 5]
            for name, x, y in (("a", 0, 0), ("b", 400, 0), ("c", 0, 300), ("d", 400, 300))
        ],
        "the middle last": [
            [name, x, y, 0, 200, 200, 200, 5]
            for name, x, y in (("a", 0, 0), ("b", 400, 0), ("c", 0, 400), ("d", 400, 400), ("e", 200, 200))
        ],
    }  # fmt: skip
    for rows in plans.values():
        (plan,) = load(tmp_path, "load.csv", table(rows), anchor="corner").plans
        assert plan.n_boxes == len(rows)


TOWER = [["b", 0, 0, 200, 400, 300, 200, 5], ["a", 0, 0, 0, 400, 300, 200, 6], ["c", 0, 0, 400, 400, 300, 200, 4]]
"""The rows of three boxes of a pile: the middle, the lowest and the highest box."""


@pytest.mark.parametrize(
    "name", ["N°", "Nr.", "#", "No", "Lfd. Nr.", "Index", "Pick", "Pos", "Seq", "Ordine", "Placed", "Pořadí"]
)
@pytest.mark.parametrize("first", [0, 1])
def test_a_column_that_counts_is_the_packing_order_where_rows_are_not(tmp_path: Path, name: str, first: int) -> None:
    rows = [[*row, number + first] for row, number in zip(TOWER, (1, 0, 2), strict=True)]
    plan_set = load(tmp_path, "load.csv", table(rows, f"{NAMES},{name}"))
    assert plan_set.plans[0].corner_mm[:, 2].tolist() == [0, 200, 400]
    (reading,) = plan_set.readings.values()
    assert reading.columns["sequence"] == name
    again = load(tmp_path, "load.csv", table(rows, f"{NAMES},{name}"), reading=reading)
    assert again.plans[0].corner_mm[:, 2].tolist() == [0, 200, 400]
    beside = [[*TOWER[1], 1], ["d", 400, 0, 0, 400, 300, 200, 5, 0], ["e", 800, 0, 0, 400, 300, 200, 5, 2]]
    if name in ("Pick", "#"):  # such a column may be the packing order, but the order of rows is also possible
        plan_set = load(tmp_path, "load.csv", table(beside, f"{NAMES},{name}"))
        (reading,) = plan_set.readings.values()
        assert any(note.startswith(f"{name} may be the packing order, too") for note in reading.notes)


@pytest.mark.parametrize(
    ("numbers", "flaw"),
    [((1, 0, 3), "has gaps"), ((1, 1, 2, 3), "repeats numbers"), ((7, 5, 6), ""), ((1, 2, 3), ""), ((4711, 12, 7), "")],
)
def test_running_numbers_with_gaps_or_repeats_have_a_note(tmp_path: Path, numbers: tuple[int, ...], flaw: str) -> None:
    rows = [[f"b{k}", 0, 0, 200 * k, 400, 300, 200, 5, number] for k, number in enumerate(numbers)]
    (reading,) = load(tmp_path, "load.csv", table(rows, f"{NAMES},Nr.")).readings.values()
    notes = [note for note in reading.notes if "not read as the packing order" in note]
    assert notes == ([f"Nr. {flaw}, so it is not read as the packing order (--columns sequence=Nr.)"] if flaw else [])


def test_a_note_about_gaps_in_the_packing_order_names_the_column(tmp_path: Path) -> None:
    plan_set = load(tmp_path, "load.csv", table([[*row, 2 * k] for k, row in enumerate(TOWER)], f"{NAMES},Reihenfolge"))
    (note,) = plan_set.notes
    assert note.endswith("load.csv: Reihenfolge has gaps in 1 plan (load); are rows missing?")


def test_columns_with_unknown_units_have_a_note(tmp_path: Path) -> None:
    header = "name,x,y,z,length (outer),width [furlong],height in punkte,weight (stone)"
    (reading,) = load(tmp_path, "load.csv", table(TOWER, header)).readings.values()
    assert [note for note in reading.notes if "unknown unit" in note] == [
        "width [furlong], height in punkte: unknown unit, read as mm (say which with --units)",
        "weight (stone): unknown unit, read as kg (say which with --units)",
    ]
    (named,) = load(tmp_path, "load.csv", table(TOWER, header), units="mm,kg").readings.values()
    assert not any("unknown unit" in note for note in named.notes)


def test_an_order_with_a_box_before_its_support_is_odd(tmp_path: Path) -> None:
    rows = [[*row, number] for row, number in zip(TOWER, (3, 1, 2), strict=True)]
    plan_set = load(tmp_path, "load.csv", table(rows, f"{NAMES},step"))
    (odd,) = plan_set.warnings
    assert odd.floating == ("1 by 200 mm",)


def grid(nx: int, ny: int, nz: int, size: tuple[float, float, float], weight: float) -> str:
    """CSV with nx × ny × nz equal boxes in a block. The headings do not state units."""
    a, b, c = size
    rows = [f"{i * a},{j * b},{k * c},{a},{b},{c},{weight}" for k in range(nz) for j in range(ny) for i in range(nx)]
    return "\n".join(["x,y,z,length,width,height,weight", *rows])


@pytest.mark.parametrize(
    ("block", "ways"),
    [
        ((4, 3, 3, (12, 10, 8), 2), ("inches", "centimetres")),  # 127 or 2,083 kg/m³
        ((2, 2, 4, (16, 12, 10), 1.2), ("centimetres", "inches")),  # 37 kg/m³ in inches, 606 in cm
        ((1, 1, 4, (100, 80, 60), 40), ("centimetres", "millimetres")),  # a pile of large boxes, or of small boxes
    ],
)
def test_units_that_masses_alone_would_decide_are_asked(
    tmp_path: Path, block: tuple[int, int, int, tuple[float, float, float], float], ways: tuple[str, str]
) -> None:
    message = refusal(load(tmp_path, "load.csv", grid(*block)))
    assert "can be read in two ways: " in message
    assert all(f"lengths in {way}" in message for way in ways)
    assert "say which with --units" in message
    assert "kg/m³" in message


@pytest.mark.parametrize(
    ("block", "unit"),
    [
        ((3, 4, 3, (40, 20, 30), 7), "cm"),  # in cm, the block fills 1200 × 800 mm; in inches, it is 3 m long
        ((2, 2, 3, (50, 35, 30), 7), "cm"),  # in inches, the block is larger than pallets
        ((2, 2, 2, (390, 290, 300), 7), "mm"),
        ((3, 4, 3, (0.4, 0.2, 0.3), 7), "m"),
    ],
)
def test_units_by_what_fits_a_pallet(
    tmp_path: Path, block: tuple[int, int, int, tuple[float, float, float], float], unit: str
) -> None:
    (reading,) = load(tmp_path, "load.csv", grid(*block)).readings.values()
    assert (reading.units, reading.masses) == (unit, "kg")
    assert "weights may also be in lb (say which with --units)" in reading.notes


def test_pounds_beside_inches_are_mentioned(tmp_path: Path) -> None:
    text = grid(3, 4, 3, (16, 10, 12), 7)
    for options in ({}, {"units": "in"}):  # a pallet of 48 × 40 inches is usual
        (reading,) = load(tmp_path, "load.csv", text, **options).readings.values()
        assert (reading.units, reading.masses) == ("in", "kg")
        assert "weights may also be in lb (say which with --units)" in reading.notes
    (plan,) = load(tmp_path, "load.csv", text.replace("weight", "weight [lb]"), units="in").plans
    np.testing.assert_allclose(plan.mass_kg, 7 * 0.45359237)
    (reading,) = load(tmp_path, "load.csv", text, units="in,kg").readings.values()
    assert not any("weights may be" in note for note in reading.notes)


def test_converted_lengths_are_inches(tmp_path: Path) -> None:
    """Boxes of 600 × 400 × 300 mm whose sizes are given in inches. The load has the size of no usual pallet."""
    text = grid(1, 2, 3, (23.622, 15.748, 11.811), 7).replace("weight", "weight [kg]")
    (reading,) = load(tmp_path, "load.csv", text).readings.values()
    assert (reading.units, reading.masses) == ("in", "kg")


@pytest.mark.parametrize(
    ("weight", "unit", "density"), [(7000, "grams", "291,667"), (0.02, "tonnes", "0.833"), (150, "grams", "6,250")]
)
def test_absurd_densities_are_odd_in_files_of_any_form(tmp_path: Path, weight: float, unit: str, density: str) -> None:
    text = grid(3, 4, 3, (400, 200, 300), weight).replace("weight", "weight [kg]").replace("length", "length [mm]")
    plans = load(tmp_path, "load.csv", text)
    petmjx.save_plans(plans, tmp_path / "own.csv")
    for file in ("load.csv", "own.csv"):
        line = f"masses look as if they were in {unit}: in plan load box 0"
        (odd,) = (odd for odd in petmjx.load_plans(tmp_path / file).conventions if line in odd)
        assert f" has {density} kg/m³ (1 of 1 plan); if that is so, give units {unit[0]}" in odd
        assert odd in file_infos([tmp_path / file], {})[0][0]["odd"]


def test_info_names_unused_columns_and_why_the_next_best_lost(tmp_path: Path) -> None:
    rows = [[*row, colour, 3] for row, colour in zip(named("e", [800, 0, 0, 300, 300, 100, 3]), "rgbry", strict=True)]
    load(tmp_path, "load.csv", table(rows, f"{NAMES},colour,shelf"))
    infos, _ = file_infos([tmp_path / "load.csv"], {})
    lines = [" ".join(line.split()) for line in info_lines(infos)]
    assert "not used colour, shelf" in lines
    (other,) = (line for line in lines if line.startswith("next best"))
    assert re.search(
        r"less plausible because of (the boxes' places|names, units and usual values) "
        r"\(cost -?[\d.]+ against [\d.]+\)$",
        other,
    )


@pytest.mark.parametrize("header", ["plan_id,sequence,article,", ""])
def test_info_and_reading_name_boxes_that_are_too_heavy_or_too_light(tmp_path: Path, header: str) -> None:
    """In petmjx's own table, and in a table of another tool."""
    names = f"{header}length_mm,width_mm,height_mm,weight_kg,x_mm,y_mm,z_mm"
    for weights, line in (
        ([5, 6, 5, 1000, 5, 5], "box 3{} has 1,000 kg, 41,667 kg/m³, not between 2 and 5,000 kg/m³"),
        (
            [5, 0.005, 5, 6, 0.01, 5],
            "box 1{} has 0.005 kg, 0.208 kg/m³, not between 2 and 5,000 kg/m³; 2 such boxes in all",
        ),
        ([5, 6, 5, 50, 5, 5], None),
    ):
        rows = [
            f"{f'load,{k},a{k},' if header else ''}400,300,200,{weight},{400 * (k % 3)},{300 * (k // 3)},0"
            for k, weight in enumerate(weights)
        ]
        (tmp_path / "load.csv").write_text("\n".join([names, *rows]))
        (info,), _ = file_infos([tmp_path / "load.csv"], {"up": None if header else "z"})
        box = int(np.argmax(np.abs(np.log(np.array(weights) / 5))))
        text = line and f"plan load: {line.format(f' (a{box})' if header else '')}"
        assert info["odd"] == ([text] if text else [])
        notes = load(tmp_path, "load.csv", "\n".join([names, *rows]), up=None if header else "z").conventions
        assert [note.partition(": ")[2] for note in notes if "kg/m³" in note] == info["odd"]


def test_info_names_options_without_effect_for_each_file_however_long_its_path(tmp_path: Path) -> None:
    header = "plan_id,sequence,article,length_mm,width_mm,height_mm,weight_kg,x_mm,y_mm,z_mm"
    files = [tmp_path / f"{'long' * 40}{name}.csv" for name in "ABC"]
    for file in files:
        file.write_text(f"{header}\n{file.stem[-1]},1,a,400,300,200,5,0,0,0")
    infos, _ = file_infos(files, {"up": "z"})
    for info in infos:
        (line,) = info["odd"]
        assert line.startswith("up has no effect on /")
        assert line.endswith(", since it is in petmjx's own form, with z upwards")


def test_a_file_whose_boxes_mostly_overlap_is_refused(tmp_path: Path) -> None:
    """The option that names the point of the boxes tells that the boxes really overlap."""
    names = "name,corner x [mm],corner y [mm],corner z [mm],dx [mm],dy [mm],dz [mm],weight [kg]"
    content = f"{names}\n" + "".join(f"{k},{9 * k},0,0,300,300,300,6\n" for k in range(8))
    message = refusal(load(tmp_path, "load.csv", content))
    reading = "coordinates of corners, z upwards (8 boxes overlap; 8 boxes in all)"
    assert f"no reading is plausible; the best has {reading}" in message
    assert "; if boxes really overlap, say --anchor corner; columns: x size=dx [mm]" in message
    assert refusal(load(tmp_path, "load.csv", content, sizes="item")).endswith("say which with --columns rotation=NAME")
    assert len(load(tmp_path, "load.csv", content, anchor="corner").plans) == 1


@pytest.mark.parametrize("is_reversed", [False, True])
@pytest.mark.parametrize(("order", "other"), [((2, 1, 0), ""), ((1, 2, 0), "y"), ((0, 2, 1), "x")])
def test_the_order_of_boxes_tells_the_vertical_axis(
    tmp_path: Path, order: tuple[int, int, int], other: str, is_reversed: bool
) -> None:
    """A block of equal boxes stands on each of its sides. It is listed along one axis after the other, from the ground
    up or from the top down. If the order contradicts z, the vertical is asked for."""
    corners = [(370 * x, 190 * y, 240 * z) for z in range(3) for y in range(4) for x in range(3)]
    corners.sort(key=lambda corner: [corner[axis] for axis in order], reverse=is_reversed)
    rows = "".join(f"{x},{y},{z},370,190,240,6\n" for x, y, z in corners)
    plan_set = load(tmp_path, "load.csv", f"x [mm],y [mm],z [mm],dx [mm],dy [mm],dz [mm],weight [kg]\n{rows}")
    assert [reading.up for reading in plan_set.readings.values()] == ([] if other else ["z"])
    if other:
        message = refusal(plan_set)
        assert "z upwards (no box overlaps or floats; 36 boxes in all)" in message
        assert f"{other} upwards" in message


def test_tops_with_y_upwards_are_not_taken_for_centres_in_silence(tmp_path: Path) -> None:
    """If the coordinates were read as centres, with z upwards, no box would overlap or float."""
    boxes = (
        (193, 147, 107.5, 386, 147, 215),
        (579, 147, 107.5, 386, 147, 215),
        (965, 147, 107.5, 386, 147, 215),
        (193, 147, 322.5, 386, 147, 215),
        (579, 225, 322.5, 386, 225, 215),
    )
    rows = "".join(f"{','.join(map(str, box))},9\n" for box in boxes)
    names = "x [mm],y [mm],z [mm],dx [mm],dy [mm],dz [mm],weight [kg]"
    message = refusal(load(tmp_path, "load.csv", f"{names}\n{rows}"))
    assert "z upwards, coordinates of centres" in message
    assert "y upwards, coordinates of centres of tops" in message


def test_equal_numbers_do_not_join_boxes_with_items(tmp_path: Path) -> None:
    """The width of all boxes is the height of an item of another order, and both tables number their rows."""
    (tmp_path / "items.csv").write_text("nr,length,width,height,weight\n1,400,300,200,6\n2,500,300,150,5\n")
    for boxes in ("step,x,y,z\n1,0,0,0\n2,0,0,200\n", "box,x,y,z,quux\na,0,0,0,200\nb,0,0,200,200\n"):
        assert not load(tmp_path, "load.csv", boxes).plans


def two_pallets(first: object, second: object, step: bool) -> list[list[object]]:
    """A table with the four boxes of ``named`` on each of two pallets."""
    boxes = named("", "sums")[:-1]
    rows = [[*box, pallet] for pallet in (first, second) for box in boxes]
    return [[*row, number % 4 + 1] for number, row in enumerate(rows)] if step else rows


@pytest.mark.parametrize(
    ("name", "step"),
    [("Stop", False), *((name, True) for name in ("PalNo", "LU", "HU", "SSCC", "Palette", "Nośnik", "Unit"))],
)
def test_a_column_that_separates_pallets_is_used_with_a_note(tmp_path: Path, name: str, step: bool) -> None:
    plan_set = load(tmp_path, "load.csv", table(two_pallets(7, 8, step), f"{NAMES},{name}{',step' * step}"))
    assert [plan.n_boxes for plan in plan_set.plans] == [4, 4]
    (reading,) = plan_set.readings.values()
    assert reading.columns["plan"] == name


@pytest.mark.parametrize("step", [False, True])
def test_a_column_of_another_name_that_separates_pallets_is_named(tmp_path: Path, step: bool) -> None:
    text = table(two_pallets("A", "B", step), f"{NAMES},zone{',step' * step}")
    message = refusal(load(tmp_path, "load.csv", text))
    assert (
        "not if zone separates pallets; say which with --columns plan=zone or --columns plan=- (one pallet)" in message
    )
    assert len(load(tmp_path, "load.csv", text, columns={"plan": "zone"}).plans) == 2
    if not step:
        assert len(load(tmp_path, "load.csv", text, columns={"plan": "-"}, anchor="corner", up="z").plans) == 1


def test_unknown_headers_are_said_to_be_unknown_and_can_be_named(tmp_path: Path) -> None:
    names = "foo,bar,baz,qux,quux,corge,grault"
    text = table([box[1:] for box in named("", "sums")[:-1]], names)
    message = refusal(load(tmp_path, "load.csv", text))
    assert "no column is known as a size or a place of boxes; there are foo, bar, baz" in message
    assert "--columns length=NAME,width=NAME,height=NAME,x=NAME,y=NAME,z=NAME" in message
    roles = dict(zip(("x", "y", "z", "length", "width", "height", "weight"), names.split(","), strict=True))
    (plan,) = load(tmp_path, "load.csv", text, columns=roles, units="mm,kg").plans
    assert plan.size_mm[0].tolist() == [400, 300, 200]


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    rows = "\n".join(f"{400 * number},0,0,400,300,200,5" for number in range(3))
    message = refusal(load(tmp_path, "load.csv", f"foo,bar,baz,qux,height,corge,weight\n{rows}"))
    assert "lacks some of the sizes, and places" in message
    rows = "\n".join(f"{number} {400 * number} 0 0 400 300 200 5" for number in range(1, 4))
    message = refusal(load(tmp_path, "load.txt", f"Nr Mid X Mid Y Z Length Width Height Weight\n{rows}\n"))
    assert "holds no box: row 2 has 8 fields instead of 10; does a name in the header contain a blank?" in message
    np.savez(tmp_path / "poses.npz", poses=np.tile(np.eye(4), (3, 1, 1)))
    message = refusal(petmjx.load_plans(tmp_path / "poses.npz"))
    assert "has places of boxes, but no sizes: name a file that has them with --items FILE" in message


@pytest.mark.parametrize(("name", "n_boxes"), [("EPAL 1", 4), ("Euro-Palette", 4), ("base board", 5)])
def test_a_pallet_below_the_boxes_is_the_deck(tmp_path: Path, name: str, n_boxes: int) -> None:
    boxes = [[*box[:3], float(str(box[3])) + 144, *box[4:]] for box in named("", "sums")[:-1]]
    plan_set = load(tmp_path, "load.csv", table([[name, 0, 0, 0, 1200, 800, 144, 25], *boxes]))
    assert plan_set.plans[0].n_boxes == n_boxes
    assert plan_set.plans[0].corner_mm[:, 2].min() == 0
    (reading,) = plan_set.readings.values()
    assert ("row 2 is the pallet, and left out" in reading.notes) == (n_boxes == 4)


PALLETS = "Pallet,Box,X,Y,Z,Length,Width,Height,Weight\n"


def stacked(*rows: str) -> str:
    """A CSV table of boxes of 400 × 300 × 200 mm. Each box is given as "pallet,name,z"."""
    cells = [row.split(",") for row in rows]
    return PALLETS + "".join(f"{pallet},{name},0,0,{z},400,300,200,6\n" for pallet, name, z in cells)


PLAIN = stacked("A,a,0", "A,b,200", "A,c,400")


def test_a_unit_of_one_cell_says_nothing_about_the_others(tmp_path: Path) -> None:
    lengths = PLAIN.replace("b,0,0,200,400", "b,0,0,200,40 cm")
    assert "row 2 (a): Length has no unit, unlike other rows, got 400" in refusal(load(tmp_path, "a.csv", lengths))
    weights = PLAIN.replace("200,6\nA,c", "200,12 lb\nA,c")
    assert "row 2 (a): Weight has no unit, unlike other rows, got 6" in refusal(load(tmp_path, "b.csv", weights))
    triples = "name,position,dimensions\na,0 0 0,400x300x200\nb,0 0 200,40x30x20 cm\n"
    assert "dimensions has no unit, unlike other rows, got 400" in refusal(load(tmp_path, "c.csv", triples))
    mixed = "name,position,dimensions\na,0 0 0,40 cm x 300 x 200\n"
    assert "dimensions has no unit, unlike other rows, got 300" in refusal(load(tmp_path, "d.csv", mixed))
    orders = "Order,Length,Width,Height,Weight\nA,400,300,200,6\nA,40 cm,300,200,6\n"
    (tmp_path / "e.csv").write_text(orders)
    infos, _ = file_infos([tmp_path / "e.csv"], {})
    assert "Length has no unit" in "\n".join(info_lines(infos))


@pytest.mark.parametrize(
    ("content", "options"),
    [
        (PLAIN.replace("200,400,300", "200,40 cm,300"), {"units": "mm"}),
        (PLAIN.replace("Length", "Length [mm]").replace("200,400,300", "200,40 cm,300"), {}),
        (PLAIN.replace(",0,0,", ",0 mm,0,").replace(",400,300", ",400 mm,300"), {}),  # a 0 needs no unit
        ("name,position,dimensions [mm]\na,0 0 0,400x300x200\nb,0 0 200,40x30x20 cm\n", {"up": "z"}),
    ],
)
def test_cells_without_a_unit_have_that_of_the_header_or_option(
    tmp_path: Path, content: str, options: dict[str, str]
) -> None:
    (plan,) = load(tmp_path, "a.csv", content, **options).plans
    assert np.allclose(plan.size_mm, [400, 300, 200])
    assert np.allclose(plan.corner_mm[:, 2], 200.0 * np.arange(plan.n_boxes))


def test_units_of_an_option_are_those_of_cells_without_unit_alone(tmp_path: Path) -> None:
    content = PALLETS + "A,a,0,0,0,40,30,20,6\nA,b,0,0,20,400 mm,30,20,6\nA,c,0,0,40,40,30,20,6\n"
    (plan,) = load(tmp_path, "a.csv", content, units="cm").plans
    assert np.allclose(plan.size_mm, [400, 300, 200])


def test_names_of_pallets_are_filled_down(tmp_path: Path) -> None:
    plan_set = load(tmp_path, "a.csv", stacked("P1,a,0", ",b,200", "P2,c,0", ",d,200", ",e,400"))
    assert {plan.plan_id: plan.n_boxes for plan in plan_set.plans} == {"P1": 2, "P2": 3}
    assert "Pallet filled down" in next(iter(plan_set.readings.values())).notes
    orders = "Order,Length [mm],Width [mm],Height [mm],Weight [kg]\n" + "".join(
        f"{order},400,300,200,6\n" for order in ("ORD-1", "", "ORD-2", "", "")
    )
    (tmp_path / "o.csv").write_text(orders)
    infos, _ = file_infos([tmp_path / "o.csv"], {})
    assert "2 orders, 5 boxes" in infos[0]["orders"]
    assert "Order filled down" in infos[0]["orders"]


@pytest.mark.parametrize(
    ("rows", "row"),
    [
        (("P1,a,0", "P1,b,200", ",c,400", "P2,d,0", "P2,e,200", "P2,f,400"), 4),
        ((",a,0", "P1,b,200", ",c,400", "P2,d,0", ",e,200", ",f,400"), 2),
    ],
)
def test_scattered_blanks_of_pallets_are_refused(tmp_path: Path, rows: tuple[str, ...], row: int) -> None:
    assert f"row {row}: Pallet is missing" in refusal(load(tmp_path, "a.csv", stacked(*rows)))


@pytest.mark.parametrize("column", ["Length [mm]", "X"])
def test_points_that_may_be_between_thousands_are_refused(tmp_path: Path, column: str) -> None:
    length, x = ("1.200", "0") if column != "X" else ("800", "1.200")
    header = "Box;X;Y;Z;Length [mm];Width [mm];Height [mm];Weight [kg]\n"
    content = f"{header}a;0;0;0;{length};800;200;60\nb;{x};0;0;{length};800;200;60\n"
    line = refusal(load(tmp_path, "a.csv", content))
    assert f"{column} 1.200 may mean 1.2 or 1200: write 1.2 or 1200" in line
    line = refusal(load(tmp_path, "b.csv", content.replace("1.200", "1.125")))
    assert f"{column} 1.125 may mean 1.125 or 1125: write 1.1250 or 1125" in line


@pytest.mark.parametrize(("length", "grams"), [("400", 9500), ("4", 9.5)])
def test_points_in_grams_are_between_thousands_if_boxes_would_be_lighter_than_foam(
    tmp_path: Path, length: str, grams: float
) -> None:
    header = "Box;X mm;Y mm;Z mm;Länge mm;Breite mm;Höhe mm;Masse g\n"
    content = f"{header}a;0;0;0;{length};300;200;9.500\nb;{length};0;0;{length};300;200;12.250\n"
    plan_set = load(tmp_path, "a.csv", content)
    (plan,) = plan_set.plans
    assert np.isclose(plan.mass_kg[0], grams / 1000)
    assert ("Masse g: 9.500 is read as 9500" in plan_set.conventions[0]) == (grams == 9500)


def test_points_of_metres_are_decimal(tmp_path: Path) -> None:
    content = "Box;X;Y;Z;Length [m];Width [m];Height [m]\na;0;0;0;1.200;1;1.000\nb;0;0;1;1.200;1;1.000\n"
    (plan,) = load(tmp_path, "a.csv", content).plans
    assert np.allclose(plan.size_mm, [1200, 1000, 1000])


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("b,0,", "b,NaN,", "X must be finite, got nan"),
        ("b,0,", "b,inf,", "X must be finite, got inf"),
        ("b,0,0,200,400", "b,0,0,200,1e400", "Length must be finite, got inf"),
        ("b,0,0,200,400", "b,0,0,200,-400", "Length must be > 0, got -400"),
        ("b,0,0,200,400,300,200,6", "b,0,0,200,400,300,200,~6", 'Weight must be a number, got "~6"'),
    ],
)
def test_a_bad_cell_is_told_before_doubts_about_axes(tmp_path: Path, old: str, new: str, fault: str) -> None:
    assert f"row 3 (b): {fault}" in refusal(load(tmp_path, "a.csv", PLAIN.replace(old, new)))


def test_origins_in_the_middle_of_containers_have_levels_of_their_own(tmp_path: Path) -> None:
    def bin_of(name: str, height: float) -> dict[str, object]:
        boxes = [
            {"x": 0, "y": 0, "z": z - height / 2, "length": 400, "width": 300, "height": 200, "weight": 6}
            for z in (0, 200)
        ]
        return {"id": name, "length": 1200, "width": 800, "height": height, "items": boxes}

    content = json.dumps({"bins": [bin_of("A", 1000), bin_of("B", 2000)]})
    plans = load(tmp_path, "a.json", content, up="z").plans
    assert [plan.corner_mm[:, 2].tolist() for plan in plans] == [[0, 200], [0, 200]]


def test_the_first_plan_decides_between_two_origins_of_equal_frequency(tmp_path: Path) -> None:
    header, block = "plan,x,y,z,length,width,height", list(product((0, 400), (0, 300), (0, 200)))
    corner = [f"A,{x},{y},{z},400,300,200" for x, y, z in block]
    middle = [f"B,{x - 400},{y - 300},{z},400,300,200" for x, y, z in block]
    for origin, rows in {"given": (*corner, *middle), "middle": (*middle, *corner)}.items():
        plan_set = load(tmp_path, "a.csv", "\n".join((header, *rows)))
        assert [reading.origin for reading in plan_set.readings.values()] == [origin]


def test_a_plan_without_its_bottom_layer_floats_beside_others(tmp_path: Path) -> None:
    content = stacked("A,a,0", "A,b,200", "B,c,200", "B,d,400")
    plan_set = load(tmp_path, "a.csv", content)
    assert [plan.corner_mm[0, 2] for plan in plan_set.plans] == [0, 200]
    assert [odd.n_floating for odd in plan_set.warnings] == [1]
    # heights are measured from the floor
    raised = load(tmp_path, "b.csv", stacked("A,a,144", "A,b,344", "B,c,344", "B,d,544"), up="z")
    assert [plan.corner_mm[0, 2] for plan in raised.plans] == [0, 200]
    # one box has a wrong height
    deep = load(tmp_path, "c.csv", stacked("A,a,-200", "A,b,0", "B,c,0", "B,d,200"), up="z")
    assert [plan.corner_mm[0, 2] for plan in deep.plans if plan.plan_id == "B"] == [0]


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (
            "Box,X,Y,Z,Length,Width,Height,Weight\na,0,0,,400,300,200,6\nb,0,0,,400,300,200,6\n",
            "row 2 (a): Z is missing",
        ),
        ("Box,X,Y,Length,Width,Height,Weight\na,0,0,400,300,200,6\n", "lacks the coordinate z of boxes"),
        ("Order,Length,Width,Height,Weight\nA,400,300,200,6\nA,400,300,200,x\n", "order A, row 3: Weight must be"),
    ],
)
def test_info_takes_no_file_for_orders_that_has_places_or_no_order(tmp_path: Path, content: str, fault: str) -> None:
    (tmp_path / "a.csv").write_text(content)
    infos, _ = file_infos([tmp_path / "a.csv"], {"up": "z"})
    assert not infos[0]["orders"]
    assert fault in "\n".join(info_lines(infos))


@pytest.mark.parametrize(
    "lacking", ["sequence", "article", "weight_kg", "sequence,article", "plan_id,sequence,article"]
)
@pytest.mark.parametrize(
    ("field", "cell", "fault"),
    [
        ("length_mm", "nan", "length_mm must be finite, got nan"),
        ("width_mm", "-5", "width_mm must be > 0, got -5"),
        ("z_mm", "", "z_mm is missing"),
    ],
)
def test_a_bad_cell_is_told_where_all_rows_are_bad_and_columns_are_missing(
    tmp_path: Path, lacking: str, field: str, cell: str, fault: str
) -> None:
    """Without the bad cell, the file could be read. So the message names the bad cell, not the missing columns, which
    only petmjx's own tables need."""
    names = (
        "plan_id",
        "sequence",
        "article",
        "length_mm",
        "width_mm",
        "height_mm",
        "weight_kg",
        "x_mm",
        "y_mm",
        "z_mm",
    )
    row = dict(zip(names, ("A", 1, "box", 400, 300, 200, 6, 0, 0, 0), strict=True)) | {field: cell}
    row = {name: value for name, value in row.items() if name not in lacking.split(",")}
    (skipped,) = load(tmp_path, "a.csv", f"{','.join(row)}\n{','.join(map(str, row.values()))}\n").skipped
    plan = "plan A, " if "plan_id" in row else ""
    name = " (box)" if "article" in row else ""
    assert str(skipped) == f"{tmp_path}/a.csv: {plan}row 2{name}: {fault}"


def test_units_of_chosen_columns_count_even_if_their_words_are_unknown(tmp_path: Path) -> None:
    lines = [NAMES.replace("[mm]", "[cm]").replace("x [cm],y [cm],z [cm]", "Q1 [mm],Q2 [mm],Q3 [mm]")]
    lines += [f"b{k},{','.join(f'{v:g}' for v in (*box[:3], *box[3:] / 10))},6" for k, box in enumerate(BOXES)]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    ((record,), _) = file_infos([tmp_path / "a.csv"], {})
    assert not record["orders"]
    assert "name their columns with --columns x=NAME" in record["skipped"][0]
    ((record,), plan_set) = file_infos([tmp_path / "a.csv"], {"columns": "x=Q1,y=Q2,z=Q3"})
    assert not record["orders"]
    np.testing.assert_allclose(plan_set.plans[0].corner_mm, BOXES[:, :3])
    np.testing.assert_allclose(plan_set.plans[0].size_mm, BOXES[:, 3:])
    ((record,), _) = file_infos([tmp_path / "a.csv"], {"columns": "x=Q1,y=Q2"})
    assert not record["orders"]
    assert record["skipped"]


TWO_SETS = (
    "name,product_length,product_width,product_height,case_length,case_width,case_height,x,y,z,kg\n"
    "a,380,280,180,400,300,200,0,0,0,9\nb,380,280,180,400,300,200,400,0,0,9\n"
)
"""The sizes of a product, and of the case in which it is packed. Without further boxes, both sets are plausible."""


@pytest.mark.parametrize("words", [("product_", "case_"), ("inner ", "outer "), ("item.", ""), ("", "box")])
def test_of_two_sets_of_sizes_the_one_without_floating_boxes_is_read(tmp_path: Path, words: tuple[str, str]) -> None:
    content = f"{TWO_SETS}c,380,280,180,400,300,200,200,0,200,9\n"
    content = content.replace("product_", words[0]).replace("case_", words[1])
    (plan,) = load(tmp_path, "a.csv", content).plans
    assert np.allclose(plan.size_mm, [400, 300, 200])
    bad_cell = content.replace("c,380,280,180,400,300", "c,380,280,180,400,?")
    assert f'{words[1]}width must be a number, got "?"' in refusal(load(tmp_path, "b.csv", bad_cell))


def test_two_plausible_sets_of_sizes_are_refused_and_can_be_named(tmp_path: Path) -> None:
    line = refusal(load(tmp_path, "a.csv", TWO_SETS))
    for word in ("product", "case"):
        assert f"length={word}_length,width={word}_width,height={word}_height (no box" in line
    (plan,) = load(tmp_path, "a.csv", TWO_SETS, columns={"length": "case_length"}).plans
    assert np.allclose(plan.size_mm, [400, 300, 200])


@pytest.mark.parametrize("mark", [",", ";"])
def test_a_comment_above_a_table_is_not_part_of_its_header(tmp_path: Path, mark: str) -> None:
    content = "# all sizes are HALF sizes, places are middles, in mm\nid,a,b,c,x,y,z\nk,3,2,1,3,2,1\nl,3,2,1,9,2,1\n"
    head, _, table = content.partition("\n")
    line = refusal(load(tmp_path, "a.csv", f"{head}\n{table.replace(',', mark)}"))
    assert "no sizes: name their columns with --columns length=NAME,width=NAME,height=NAME" in line
    assert "there are id, a, b, c, x, y, z" in line


def test_sizes_of_any_name_can_be_said_to_be_half_sizes(tmp_path: Path) -> None:
    rows = [
        f"b{k},{','.join(f'{v:g}' for v in (*box[3:] / 2, *(box[:3] + box[3:] / 2)))}" for k, box in enumerate(BOXES)
    ]
    columns = {"x size": "p", "y size": "q", "z size": "r", "half extents": "p"}
    (plan,) = load(tmp_path, "a.csv", "\n".join(["box,p,q,r,x,y,z", *rows]), columns=columns, units="mm", up="z").plans
    np.testing.assert_allclose(np.hstack([plan.corner_mm, plan.size_mm]), BOXES)
