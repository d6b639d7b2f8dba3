"""What names, units and numbers of other tools' files show about their meaning: one small case for each kind."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest

import petmjx
from petmjx.plans.column_names import known_meanings, split_unit

pytestmark = pytest.mark.filterwarnings("ignore::petmjx.PlanWarning")

PILE = (
    (0, 0, 0, 600, 400, 300, 12), (600, 0, 0, 600, 400, 300, 12), (0, 400, 0, 600, 400, 300, 12),
    (0, 0, 300, 400, 300, 250, 6.5), (400, 0, 300, 400, 300, 250, 6.5), (0, 300, 300, 300, 400, 200, 5.25),
)  # fmt: skip
"""(x, y, z, length, width, height, kg) of boxes on a pallet, mm."""


def load(tmp_path: Path, name: str, content: str | bytes, **options: Any) -> petmjx.PlanSet:
    (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
    return petmjx.load_plans(tmp_path / name, **options)


def table(header: str, rows: Any = PILE, mark: str = ",") -> str:
    return "\n".join([mark.join(header.split(",")), *(mark.join(map(str, row)) for row in rows), ""])


def check(plan_set: petmjx.PlanSet, weights: bool = True) -> None:
    (plan,) = plan_set.plans
    wanted = np.array(PILE)
    np.testing.assert_allclose(np.hstack([plan.corner_mm, plan.size_mm]), wanted[:, :6], atol=0.05)
    if weights:
        np.testing.assert_allclose(plan.mass_kg, wanted[:, 6], rtol=1e-4)


@pytest.mark.parametrize(
    ("header", "encoding"),
    [
        ("X,Y,Z,Длина мм,Ширина мм,Высота мм,Вес кг", "cp1251"),
        ("X坐标,Y坐标,Z坐标,长度(mm),宽度(mm),高度(mm),重量(kg)", "gb18030"),
        ("X座標,Y座標,Z座標,長さ(mm),幅(mm),高さ(mm),重量(kg)", "cp932"),
        ("X좌표,Y좌표,Z좌표,길이(mm),너비(mm),높이(mm),무게(kg)", "cp949"),
        ("X,Y,Z,Uzunluk mm,Genişlik mm,Yükseklik mm,Ağırlık kg", "cp1254"),
        ("X,Y,Z,Délka mm,Šířka mm,Výška mm,Váha kg", "utf-16"),
        ("č. X,č. Y,č. Z,Délka mm,Šířka mm,Výška mm,Váha kg", "utf-16"),
        ("X,Y,Z,Lengte mm,Breedte mm,Hoogte mm,Brutogewicht (kg)", "utf-8"),
        ("X,Y,Z,L mm,W mm,H mm,Zwaarte [kg]", "utf-8"),  # only the unit tells that the column has weights
    ],
)
def test_headers_in_further_languages_and_encodings(tmp_path: Path, header: str, encoding: str) -> None:
    check(load(tmp_path, "plan.csv", table(header, mark=";").encode(encoding)))


def test_units_may_be_those_of_objects_and_lists(tmp_path: Path) -> None:
    assert split_unit("box.size_mm[0]") == ("box.size[0]", "mm")
    assert split_unit("dims_in.l") == ("dims.l", "in")
    inches = [[round(value / 25.4, 4) for value in box[:6]] for box in PILE]
    boxes = [{"at_in": {"position_in": box[:3]}, "extent_in": box[3:], "kg": 9} for box in inches]
    check(load(tmp_path, "plan.json", json.dumps({"boxes": boxes})), weights=False)


@pytest.mark.parametrize(
    "names", ["Halbe Länge,Halbe Breite,Halbe Höhe", "Halblänge,Halbbreite,Halbhöhe", "half_l,half_w,half_h"]
)
def test_half_sizes_imply_centres(tmp_path: Path, names: str) -> None:
    rows = [[*(np.array(box[:3]) + np.array(box[3:6]) / 2), *(np.array(box[3:6]) / 2), box[6]] for box in PILE]
    check(load(tmp_path, "plan.csv", table(f"x,y,z,{names},kg", rows), units="mm"))


def test_numbered_coordinates_are_two_corners_in_json(tmp_path: Path) -> None:
    assert known_meanings(["x1", "y1", "z1", "length"])["x1"].kind == "position"
    names = ("x1", "y1", "z1", "x2", "y2", "z2", "kg")
    ends = np.hstack([np.array(PILE)[:, :3], np.array(PILE)[:, :3] + np.array(PILE)[:, 3:6], np.array(PILE)[:, 6:]])
    boxes = [dict(zip(names, row, strict=True)) for row in ends.tolist()]
    check(load(tmp_path, "plan.json", json.dumps({"unit": "mm", "boxes": boxes})))
    lists = [{"flb": row[:3], "tbr": row[3:6], "kg": row[6]} for row in ends.tolist()]  # a list of an unknown name
    check(load(tmp_path, "plan.json", json.dumps({"unit": "mm", "boxes": lists})))


def test_numbers_of_several_plans_are_a_packing_order(tmp_path: Path) -> None:
    """A field "order" that counts the boxes of each plan does not name customers' orders."""
    boxes = [
        {"x": 0, "y": 0, "z": 200 * k, "length": 400, "width": 300, "height": 200, "order": k + 1} for k in range(3)
    ]
    data = {"pallets": [{"id": name, "boxes": boxes[::-1]} for name in "ABC"]}
    plans = load(tmp_path, "plans.json", json.dumps(data), units="mm", up="z").plans
    assert [plan.corner_mm[:, 2].tolist() for plan in plans] == [[0, 200, 400]] * 3


def test_rows_before_one_of_their_supports_are_no_packing_order(tmp_path: Path) -> None:
    """The bridge lies on two boxes, and is listed between them. A column of an unknown name has a possible order."""
    rows = [(0, 0, 0, 400, 400, 300, 1), (0, 0, 300, 900, 400, 100, 3), (500, 0, 0, 400, 400, 300, 2)]
    rows += [(400 * k, 400, 0, 400, 300, 200, 4 + k) for k in range(3)]
    plan_set = load(tmp_path, "plan.csv", table("x,y,z,length,width,height,note", rows), units="mm", up="z")
    assert plan_set.plans[0].corner_mm[:, 2].tolist() == [0, 0, 300, 0, 0, 0]
    assert "packing order by note" in plan_set.readings[str(tmp_path / "plan.csv")].line()


@pytest.mark.parametrize("word", ["Summa", "I alt", "Ogółem brutto"])
def test_a_row_with_a_sum_and_without_sizes_is_a_total(tmp_path: Path, word: str) -> None:
    rows = [(k, *box) for k, box in enumerate(PILE)]
    content = table("Nr,X,Y,Z,L mm,B mm,H mm,kg", rows) + f"{word},,,,,,,{sum(box[6] for box in PILE)}\n"
    check(load(tmp_path, "plan.csv", content, units="mm"))


def test_units_may_stand_below_the_rule_of_a_printed_table(tmp_path: Path) -> None:
    rows = [f"1 | {' | '.join(f'{value / 10:g}' for value in box[:6])} | {box[6]}" for box in PILE]
    header = ["Palette | X | Y | Z | L | B | H | kg", "--------+---+---+---+---+---+---+---"]
    check(load(tmp_path, "plan.txt", "\n".join([*header, " | cm | cm | cm | cm | cm | cm | kg", *rows])))


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8"])
def test_xml_in_utf_16_and_cut_off_xml(tmp_path: Path, encoding: str) -> None:
    form = '<box x="{}" y="{}" z="{}" length="{}" width="{}" height="{}" mass="{}"/>\n'
    boxes = "".join(form.format(*box) for box in PILE)
    text = f'<?xml version="1.0" encoding="{encoding}"?>\n<plan unit="mm">\n{boxes}</plan>'
    check(load(tmp_path, "plan.xml", text.encode(encoding)))
    (skipped,) = load(tmp_path, "plan.xml", text[:-60].encode(encoding)).skipped
    assert "not XML at line 8" in skipped.message


@pytest.mark.parametrize("up", ["z", "-z"])
def test_poses_turn_boxes_about_the_point_of_their_coordinates(tmp_path: Path, up: str) -> None:
    """A box is turned about its corner by 180°, one by 90°, and one is upside down."""
    turns = {1: np.diag([-1, -1, 1]), 2: np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), 4: np.diag([1, -1, -1])}
    boxes = []
    for number, box in enumerate(PILE):
        turn = turns.get(number, np.eye(3))
        size = np.abs(turn.T) @ box[3:6]
        low = np.array([*box[:2], box[2] if up == "z" else -box[2] - box[5]])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, low - np.minimum(turn @ size, 0)
        boxes.append({"size": size.tolist(), "pose": pose.tolist(), "mass": box[6]})
    plan_set = load(tmp_path, "poses.json", json.dumps(boxes), units="mm", up=up)
    check(plan_set)
    assert "turn the boxes about these points" in plan_set.readings[str(tmp_path / "poses.json")].line()
    (reading,) = load(tmp_path, "poses.json", json.dumps(boxes), units="mm").readings.values()
    assert reading.up == up


def test_gravity_of_a_scene_shows_the_vertical(tmp_path: Path) -> None:
    geom = '<freejoint/><geom type="box" size=".2 .2 .2" mass="6"/>'
    bodies = "".join(f'<body pos="{x} .2 {z}">{geom}</body>' for x in (0.2, 0.6) for z in (0.2, 0.6))
    scene = f'<mujoco><option gravity="0 -9.81 0"/><worldbody>{bodies}</worldbody></mujoco>'
    (plan,) = load(tmp_path, "scene.xml", scene).plans
    assert plan.corner_mm[:, 2].tolist() == [0] * 4


@pytest.mark.parametrize("from_top", [0, 600, None])
def test_heights_may_be_counted_downwards(tmp_path: Path, from_top: float | None) -> None:
    """From the deck, below which heights are negative; from a level above the loads; or from the top of each load. A
    bad height moves no other load."""
    loads = {"A": PILE, "B": PILE[:3], "C": PILE}
    rows = [
        (name, *box[:2], (max(b[2] + b[5] for b in pile) if from_top is None else from_top) - box[2] - box[5], *box[3:])
        for name, pile in loads.items()
        for box in pile
    ]
    names = "plan,x,y,z,length,width,height,kg"
    if from_top == 0:
        assert load(tmp_path, "down.csv", table(names, rows), units="mm").readings.popitem()[1].up == "-z"
    rows[-1] = (*rows[-1][:3], 9999, *rows[-1][4:])
    plan_set = load(tmp_path, "down.csv", table(names, rows), units="mm", up="-z", anchor="corner")
    for plan, name in zip(plan_set.plans, "AB", strict=True):
        np.testing.assert_allclose(plan.corner_mm, np.array(loads[name])[:, :3])
    assert plan_set.skipped[0].message.endswith("row 16: z is far from the other boxes, got 9999")


def test_a_rare_reading_in_which_boxes_lie_better_is_asked_about(tmp_path: Path) -> None:
    """Heights are counted downwards along y. With z upwards, one box floats."""
    rows = (
        (0, 340, 0, 390, 340, 310), (0, 340, 310, 390, 340, 310), (390, 460, 0, 410, 220, 180),
        (390, 450, 180, 540, 230, 200), (390, 340, 380, 390, 340, 310), (780, 460, 380, 400, 220, 220),
        (0, 560, 620, 340, 120, 170), (0, 0, 0, 390, 340, 310), (800, 560, 0, 340, 120, 170),
        (780, 240, 380, 400, 220, 220), (0, 120, 310, 400, 220, 220), (780, 20, 380, 400, 220, 220),
    )  # fmt: skip
    content = table("x,y,z,dx,dy,dz,kg", [(*row, 6) for row in rows])
    (refused,) = load(tmp_path, "down.csv", content, units="mm").skipped
    assert "z upwards (1 box floats; 12 boxes in all), or y downwards (no box overlaps" in refused.message


def test_a_row_below_0_may_be_a_tower(tmp_path: Path) -> None:
    rows = [
        ("A", 0, -210, 0, 360, 210, 280, 7), ("A", 0, -320, 0, 360, 110, 170, 2), ("A", 0, -570, 0, 290, 250, 170, 5),
        ("B", 0, -330, 0, 390, 330, 260, 9), ("B", 0, -620, 0, 230, 290, 210, 6), ("B", 0, -910, 0, 230, 290, 210, 6),
    ]  # fmt: skip
    plan_set = load(tmp_path, "row.csv", table("plan,x,y,z,dx,dy,dz,kg", rows), units="mm", anchor="corner")
    assert "y may be downwards, too (--up)" in plan_set.readings.popitem()[1].line()


def test_boxes_listed_from_the_top_may_be_counted_downwards(tmp_path: Path) -> None:
    """The largest box is listed first: it is the lowest one if heights are counted downwards."""
    rows = [(0, 0, 400 - z, 400 - z / 4, 300, 200, 6) for z in (0, 200, 400)]
    plan_set = load(tmp_path, "a.csv", table("x,y,z,length,width,height,kg", rows), units="mm")
    assert "z may be downwards, too (--up)" in plan_set.readings.popitem()[1].line()


def test_a_question_names_every_vertical(tmp_path: Path) -> None:
    rows = sorted((x, y, z, 200, 200, 200, 3) for x in (0, 200) for y in (0, 200) for z in (0, 200))
    (skipped,) = load(tmp_path, "cubes.csv", table("x,y,z,dx,dy,dz,kg", rows), units="mm").skipped
    assert all(f"{axis} upwards" in skipped.message for axis in "xyz")


def test_boxes_mostly_stay_upright(tmp_path: Path) -> None:
    """py3dbp's rotations 0 and 3 exchange width and depth, so that the height stays vertical."""
    rows = [("a", 400, 200, 300, 6, 400 * (k % 2), 0, 300 * (k // 2), 0) for k in range(4)]
    rows += [("a", 400, 200, 300, 6, 300 * (k % 2), 200, 400 * (k // 2), 3) for k in range(4)]
    content = table("name,width,height,depth,weight,x,y,z,rotation_type", rows)
    assert load(tmp_path, "py3dbp.csv", content, units="mm").readings.popitem()[1].up == "y"


def test_arrays_may_have_densities(tmp_path: Path) -> None:
    rows = np.array([[*box[3:6], *box[:3], 250_000.0] for box in PILE]) / 1000
    np.save(tmp_path / "boxes.npy", rows)
    (plan,) = petmjx.load_plans(tmp_path / "boxes.npy").plans
    np.testing.assert_allclose(plan.mass_kg, 250 * plan.size_mm.prod(axis=1) / 1e9)


def test_sizes_of_items_are_those_before_turning(tmp_path: Path) -> None:
    sizes = [400, 400, 300, 300, 300, 300]  # along x
    begins = np.cumsum([0, *sizes[:-1]]).tolist()
    items = [{"sku": "a", "length": 400, "width": 300, "height": 200, "weight": 6}]
    places = [{"sku": "a", "x": x, "y": 0, "z": 0, "rotated": k > 1} for k, x in enumerate(begins)]
    joined = load(tmp_path, "a.json", json.dumps({"items": items, "placements": places}), units="mm", up="z")
    centres = [(x + size / 2, 350 - size / 2, 100) for x, size in zip(begins, sizes, strict=True)]
    rows = [(*centre, 400, 300, 200, 6, 90 * (k > 1)) for k, centre in enumerate(centres)]
    content = table("x,y,z,length,width,height,kg,yaw", rows)
    by_yaw = load(tmp_path, "yaw.csv", content, units="mm", up="z", anchor="centre")
    assert [plan.size_mm[:, 0].tolist() for plan in (*joined, *by_yaw)] == [sizes] * 2


@pytest.mark.parametrize(
    ("names", "x", "z"),
    [("x_center,y_center,z_bottom", 0.5, 0), ("cx,cy,z_top", 0.5, 1), ("x_min,y_min,z_top", 0, 1)],
)
def test_names_of_single_coordinates_show_the_point(tmp_path: Path, names: str, x: float, z: float) -> None:
    rows = [(box[0] + x * box[3], box[1] + x * box[4], box[2] + z * box[5], *box[3:]) for box in PILE]
    check(load(tmp_path, "plan.csv", table(f"{names},length,width,height,kg", rows), units="mm"))


def test_widths_that_would_lie_along_x_are_doubtful(tmp_path: Path) -> None:
    """Either x is that of right corners, or lengths lie along y."""
    sizes = [(460, 390, 250), (430, 290, 200), (370, 230, 270), (420, 190, 240), (420, 190, 240), (270, 230, 240)]
    bottoms = np.cumsum([0, *(height for _, _, height in sizes[:-1])]).tolist()
    rows = [(length, 0, z, length, *others, 6) for z, (length, *others) in zip(bottoms, sizes, strict=True)]
    (refused,) = load(tmp_path, "tower.csv", table(NAMES, rows), units="mm").skipped
    assert "coordinates of corners with the largest x" in refused.message


def test_a_leaning_tower_is_no_wall(tmp_path: Path) -> None:
    rows = [(250 + 70 * k, 200, 400 * (k + 1), 90, 200, 300, 400, 9) for k in range(6)]
    content = table("gripper_x,gripper_y,gripper_z,rz_deg,length_mm,width_mm,height_mm,kg", rows)
    assert load(tmp_path, "tower.csv", content).plans[0].size_mm[0].tolist() == [300, 200, 400]


@pytest.mark.parametrize("name", ["Rotatie", "Foo"])
def test_a_column_of_quarter_turns_has_rotations(tmp_path: Path, name: str) -> None:
    """The last box is turned."""
    rows = [(*box, 180 * (box[2] > 0)) for box in PILE[:-1]] + [(*PILE[-1][:3], 400, 300, 200, PILE[-1][6], 90)]
    content = table(f"{NAMES},{name}", rows)
    check(load(tmp_path, "a.csv", content, units="mm", up="z", anchor="corner", sizes="item"))
    (skipped,) = load(tmp_path, "a.csv", content.replace(",90", ",9O"), units="mm", up="z", anchor="corner").skipped
    assert f"row 7: {name} must be" in skipped.message


def test_other_columns_do_not_make_a_plan_unusable(tmp_path: Path) -> None:
    """A column of yes and no with an odd cell has no rotations if boxes lie well as they are. The name of the last
    column, and the first number of the next line, are no number of a page."""
    rows = [(*box, "maybe" if number == 2 else ("yes", "no")[number % 2], number) for number, box in enumerate(PILE)]
    check(load(tmp_path, "a.csv", table(f"{NAMES},fragile,page", rows), units="mm", up="z", anchor="corner"))


def test_an_empty_field_does_not_hide_the_name_of_a_plan(tmp_path: Path) -> None:
    box = dict(zip(("x", "y", "z", "length", "width", "height", "kg"), PILE[0], strict=True))
    content = json.dumps([{"id": name, "ID": "", "boxes": [box]} for name in "AB"])
    assert [plan.plan_id for plan in load(tmp_path, "a.json", content, units="mm", up="z").plans] == ["A", "B"]


def test_an_angle_about_an_axis_turns_items(tmp_path: Path) -> None:
    """Sizes as placed would lie as well. Five turned boxes of one kind are no evidence that turned boxes are wider than
    long. A gripper holds the middle of the top."""
    rows = [(200 + 400 * k, 150 + 300 * row, 250, 0, 400, 300, 250, 8) for k in range(3) for row in range(2)]
    rows += [(600, 300, 250 + 300 * k, 90, 200, 300, 300, 9) for k in range(1, 6)]
    content = table("gripper_x,gripper_y,gripper_z,rz_deg,length_mm,width_mm,height_mm,kg", rows)
    (plan,) = load(tmp_path, "angles.csv", content).plans
    assert plan.size_mm[-1].tolist() == [300, 200, 300]
    assert plan.corner_mm[-1].tolist() == [450, 200, 1450]
    (refused,) = load(tmp_path, "angles.csv", content.replace("rz_deg", "rotation")).skipped
    assert "--sizes" in refused.message
    turned = table("gripper_x,gripper_y,gripper_z,rz_deg,length_mm,width_mm,height_mm,kg", rows[6:])
    (plan,) = load(tmp_path, "turned.csv", turned, sizes="item").plans
    assert plan.size_mm.tolist() == [[300, 200, 300]] * 5


def test_sheets_with_other_names_of_columns_are_one_file(tmp_path: Path) -> None:
    """The second sheet lacks the packing order."""
    book = openpyxl.Workbook()
    for sheet, header in (
        (book.active, "X [mm],Y [mm],Z [mm],L [mm],W [mm],H [mm],kg,Seq"),
        (book.create_sheet("B"), "Pos X [mm],Pos Y [mm],Pos Z [mm],Length [mm],Width [mm],Height [mm],Weight [kg]"),
        (book.create_sheet("C"), "X [mm],Y [mm],Z [mm],L [mm],W [mm],H [mm],Gross weight [kg]"),
    ):
        names = header.split(",")
        for row in (names, *([*box, number][: len(names)] for number, box in enumerate(PILE))):
            sheet.append(row)
    book.save(tmp_path / "book.xlsx")
    assert len(petmjx.load_plans(tmp_path / "book.xlsx").plans) == 3


PRINTED = """:::: pallet(1200x800x1500, max_weight:9)
FITTED ITEMS:
====>  a(400x300x200, weight: 6) pos([0, 0, 0]) rt(0) vol(1)
====>  b(400x"""
NAMES = "x,y,z,length,width,height,kg"
ROW = (400, 300, 200, 6)
DAMAGED = {
    "line 4: is no box": PRINTED,
    'row 6: pallet must be a whole number ≥ 0, as in all other rows, got "2x"': table(
        f"{NAMES},pallet", [(400 * (k % 3), 0, 0, *ROW, "2x" if k == 4 else 1 + k // 3) for k in range(6)]
    ),
    "row 2: seq is too large": table(f"{NAMES},seq", [(400 * k, 0, 0, *ROW, k or "9e99") for k in range(3)]),
    "row 8: is no box: b; truncated?": table(f"{NAMES},name", [(*box, "a") for box in PILE]) + "b",
    "row 8: y is far from the other boxes, got 9000": table(NAMES, [*PILE, (600, 9000, 300, *ROW)]),
    "row 8 (Total fruit): height is missing": table(
        f"box,{NAMES}", [*((k, *box) for k, box in enumerate(PILE)), ("Total fruit", 600, 300, 300, 400, 300, "", 6)]
    ),
    "row 8: z is below the deck": table(NAMES, [*PILE, (0, 800, -198, 1200, 400, 270, 6)]),
}


@pytest.mark.parametrize("fault", DAMAGED)
def test_damaged_values(tmp_path: Path, fault: str) -> None:
    content = DAMAGED[fault]
    plan_set = load(tmp_path, "a.txt" if content == PRINTED else "a.csv", content, units="mm", up="z")
    assert not plan_set.plans
    assert fault in plan_set.skipped[0].message


def test_a_repeated_key_of_plans_is_named(tmp_path: Path) -> None:
    box = json.dumps([dict(zip(("x", "y", "z", "length", "width", "height", "kg"), PILE[0], strict=True))])
    (refused,) = load(tmp_path, "a.json", f'{{"p": {box}, "p": {box}}}', units="mm").skipped
    assert refused.message.endswith("a.json: p stands twice")


def test_a_repeated_id_of_plans_is_noted(tmp_path: Path) -> None:
    box = dict(zip(("x", "y", "z", "length", "width", "height", "kg"), PILE[0], strict=True))
    pallets = [{"id": "p", "boxes": [box]}, {"id": "p", "boxes": [box, {**box, "z": 300}]}, {"id": "q", "boxes": []}]
    reading = load(tmp_path, "a.json", json.dumps(pallets), units="mm", up="z").readings[str(tmp_path / "a.json")]
    assert {"several plans have id p: other fields or numbers name them", "no box in [2]"} <= {*reading.notes}
    named = [{**pallet, "SSCC": f"34012345000000120{number}"} for number, pallet in enumerate(pallets)]
    plans = load(tmp_path, "a.json", json.dumps(named), units="mm", up="z").plans
    assert [plan.plan_id for plan in plans] == ["340123450000001200", "340123450000001201"]
    rows = [(name, *PILE[0]) for name in "ABA"]
    content = table("plan,x,y,z,length,width,height,kg", rows)
    reading = load(tmp_path, "a.csv", content, units="mm", up="z").readings[str(tmp_path / "a.csv")]
    assert "rows of A are not next to each other, and their boxes overlap: do two plans have one name?" in reading.notes


@pytest.mark.parametrize("unit", ["cm", "mm"])
def test_answers_of_graphql(tmp_path: Path, unit: str) -> None:
    """Plans have the ids of their objects. A deck without a height shows where loads begin whose origin is its
    middle."""
    factor = 0.1 if unit == "cm" else 1
    size = [300 * factor, 200 * factor, 200 * factor]
    places = [(x * factor, y * factor, z * factor) for z in (0, 200) for x in (-300, 0) for y in (-200, 0)]
    boxes = [{"node": {f"position_{unit}": place, f"size_{unit}": size, "kg": 6}} for place in places]
    deck = {"lengthCm": 120, "widthCm": 80}
    loads = [{"node": {"id": name, "carrier": deck, "placements": {"edges": boxes}}} for name in ("P7", "P8")]
    plans = load(tmp_path, "a.json", json.dumps({"data": {"loads": {"edges": loads}}}), up="z").plans
    assert [plan.plan_id for plan in plans] == ["P7", "P8"]
    assert plans[0].corner_mm.min(axis=0).tolist() == [300, 200, 0]


@pytest.mark.parametrize("moment", ["2025-03-14T08:02:2{}.120Z", "14.03.2025 08:0{}", "08:02:2{}"])
def test_times_are_no_ids(tmp_path: Path, moment: str) -> None:
    rows = [(moment.format(number), *box) for number, box in enumerate(PILE)]
    plan_set = load(tmp_path, "a.csv", table(f"scan,{NAMES}", rows), units="mm", up="z")
    check(plan_set)
    assert not any(plan_set.plans[0].item_ids)
    lots = table(f"lot,{NAMES}", [(f"20250314-000{number}", *box) for number, box in enumerate(PILE)])
    assert all(load(tmp_path, "b.csv", lots, units="mm", up="z").plans[0].item_ids)


def test_numbers_of_sap_are_a_packing_order(tmp_path: Path) -> None:
    header = "LfdNr,X,Y,Z,Länge mm,Breite mm,Höhe mm,Bruttogew"
    rows = [(f"{10 * k:05}", *box) for k, box in enumerate(PILE, start=1)]
    plan_set = load(tmp_path, "a.csv", table(header, rows[::-1]), units="kg")
    check(plan_set)
    assert not plan_set.notes


@pytest.mark.parametrize("name", ["Traglast [kg]", "Stapellast (kg)", "Portata [kg]", "Charge admissible [kg]"])
def test_what_a_box_bears_is_no_weight(tmp_path: Path, name: str) -> None:
    rows = [(*row[:6], 60 + number) for number, row in enumerate(PILE)]
    plan_set = load(tmp_path, "a.csv", table(f"x,y,z,L [mm],B [mm],H [mm],{name}", rows))
    assert plan_set.plans[0].mass_kg.max() < 60


def test_words_in_other_scripts() -> None:
    assert known_meanings(["\u1c80\u0435\u0441"]) is not None  # a letter without a lower case
    assert known_meanings(["段ボール", "段"])["段ボール"].kind == "item_id"  # cardboard, not a layer


def test_a_plan_with_too_many_boxes_is_refused_before_readings_are_judged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    columns = f"LU,{NAMES}"
    content = table(columns, [(name, *box) for name in "AB" for box in PILE])
    assert len(load(tmp_path, "a.csv", content, units="mm", up="z", max_boxes=6).plans) == 2
    monkeypatch.setattr("petmjx.plans.plan_rows.choose_reading", None)
    monkeypatch.setattr("petmjx.plans.foreign_plan_builder.choose_reading", None)
    (skipped,) = load(tmp_path, "a.csv", table(NAMES), max_boxes=5).skipped
    assert "plan a: has 6 boxes, more than the largest capacity of 5; if the file has several" in skipped.message
