"""Files of other tools are read correctly, or refused with a message that names both possible readings. A message about
damage names its place."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from support.foreign_files import CASES, KINDS, READABLE, damaged

import petmjx
from petmjx.cli.main import main
from petmjx.common.errors import InputError
from petmjx.plans.plausibility import Layout, layout_cost, order_cost, same_layouts
from petmjx.plans.readings import CHOOSER, read_reading, reading_toml

pytestmark = pytest.mark.filterwarnings("ignore::petmjx.PlanWarning")

SHARED = Path(__file__).parents[2].parent / "shared" / "cases" / "files"


@pytest.mark.parametrize("name", CASES)
def test_files_of_other_tools_are_read_right_or_refused(name: str, tmp_path: Path) -> None:
    case = CASES[name]
    plan_set = petmjx.load_plans(case.write(tmp_path))
    assert not case.mismatch(plan_set.plans)
    assert bool(plan_set.skipped) == bool(case.refused)
    assert all("\n" not in skipped.message for skipped in plan_set.skipped)


@pytest.mark.parametrize("name", READABLE[::4])
def test_a_wrong_value_is_named_with_its_row_and_column(name: str, tmp_path: Path) -> None:
    kind = KINDS[READABLE.index(name) // 4 % len(KINDS)]
    bad = damaged(CASES[name], kind)
    (skipped,) = petmjx.load_plans(bad.write(tmp_path)).skipped
    assert not bad.lacks(skipped.message), skipped.message


@pytest.mark.parametrize("name", [*READABLE[1::9], "no-headers.csv", "quaternions-w-last.json", "far-corners.json"])
def test_a_written_reading_reads_the_same_without_a_guess(name: str, tmp_path: Path) -> None:
    file = CASES[name].write(tmp_path)
    plan_set = petmjx.load_plans(file)
    ((source, reading),) = plan_set.readings.items()
    written = tmp_path / "as.toml"
    written.write_text(reading_toml(reading, source), encoding="utf-8")
    for known in (written, reading):
        again = petmjx.load_plans(file, reading=known)
        for one, two in zip(plan_set, again, strict=True):
            np.testing.assert_array_equal(one.corner_mm, two.corner_mm)
            np.testing.assert_array_equal(one.size_mm, two.size_mm)
            np.testing.assert_array_equal(one.mass_kg, two.mass_kg)


def tower(**changes: Any) -> list[dict[str, Any]]:
    """Rows of three boxes: two side by side on the deck, and one on top of both."""
    rows = [
        {"id": "a", "x": 0, "y": 0, "z": 0, "length": 400, "width": 300, "height": 200, "weight": 6},
        {"id": "b", "x": 400, "y": 0, "z": 0, "length": 300, "width": 300, "height": 200, "weight": 5},
        {"id": "c", "x": 200, "y": 0, "z": 200, "length": 350, "width": 300, "height": 150, "weight": 4},
    ]
    return [row | changes for row in rows]


def write(file: Path, value: Any) -> Path:
    file.write_text(value if isinstance(value, str) else json.dumps(value), encoding="utf-8")
    return file


def test_names_and_order_are_filled_in_with_a_note(tmp_path: Path) -> None:
    file = write(tmp_path / "load.json", tower()[::-1])
    with pytest.warns(petmjx.PlanWarning, match="boxes are placed from the ground up") as caught:
        (plan,) = petmjx.load_plans(file).plans
    assert len(caught) == 1
    assert (plan.plan_id, plan.item_ids) == ("load", ("b", "a", "c"))
    assert "no plan_id: load" in str(caught[0].message)


def test_boxes_without_weights_have_a_density(tmp_path: Path) -> None:
    rows = [{name: value for name, value in row.items() if name != "weight"} for row in tower()]
    file = write(tmp_path / "load.json", rows)
    volume_m3 = np.array([0.4 * 0.3 * 0.2, 0.3 * 0.3 * 0.2, 0.35 * 0.3 * 0.15])
    np.testing.assert_allclose(petmjx.load_plans(file, units="mm").plans[0].mass_kg, 300 * volume_m3)
    np.testing.assert_allclose(petmjx.load_plans(file, units="mm", density=500).plans[0].mass_kg, 500 * volume_m3)


def test_a_packing_order_that_repeats_is_no_plan(tmp_path: Path) -> None:
    rows = [row | {"step": number} for row, number in zip(tower(), (1, 2, 2), strict=True)]
    (skipped,) = petmjx.load_plans(write(tmp_path / "load.json", rows)).skipped
    assert "plan load, [1] and [2]: step 2 occurs twice; several plans?" in skipped.message
    assert skipped.message.endswith("; no packing order? then --columns sequence=-")


def test_bed_bpp_in_centimetres_keeps_the_order_of_its_list(tmp_path: Path) -> None:
    """``item.sequence`` is the number of an item in the customer's order, not the packing order."""
    placements = [
        {
            "item": {"id": row["id"], "article": "", "sequence": number, "weight/kg": row["weight"]}
            | {f"{name}/cm": row[name] / 10 for name in ("length", "width", "height")},
            "orientation": 0,
            "flb_coordinates": [row[axis] / 10 for axis in "xyz"],
        }
        for row, number in zip(tower(), (9, 4, 7), strict=True)
    ]
    (plan,) = petmjx.load_plans(write(tmp_path / "plans.json", {"P": placements})).plans
    assert plan.item_ids == ("a", "b", "c")
    assert plan.size_mm[2].tolist() == [350, 300, 150]
    assert plan.corner_mm.tolist() == [[0, 0, 0], [400, 0, 0], [200, 0, 200]]


def test_a_row_that_cannot_be_read_refuses_its_plan_alone(tmp_path: Path) -> None:
    rows = ["pallet;id;L;W;H;kg;X;Y;Z"]
    for name in "PQ":
        rows += [
            ";".join([name, *(str(value) for value in (r["id"], 400, 300, 200, 6, 0, 0, 200 * k))])
            for k, r in enumerate(tower())
        ]
    rows[5] = rows[5].rpartition(";")[0]
    plan_set = petmjx.load_plans(write(tmp_path / "p.csv", "\n".join(rows) + "\n"))
    assert [plan.plan_id for plan in plan_set] == ["P"]
    assert "plan Q, row 6: has 8 fields instead of 9" in plan_set.skipped[0].message


CUBES = [{"name": f"c{k}", "WHD": [300] * 3, "position": [300 * (k % 2), 300 * (k // 2), 0]} for k in range(4)]


def test_a_tie_names_both_readings_and_the_option_that_decides(tmp_path: Path) -> None:
    file = write(tmp_path / "cubes.json", {"fitItem": [{**cube, "rotationType": 0} for cube in CUBES]})
    (skipped,) = petmjx.load_plans(file, units="mm").skipped
    assert "can be read in two ways: z upwards" in skipped.message
    assert ", or y upwards" in skipped.message
    assert "say which with --up (x, y, z, -y or -z), or with --as FILE.toml; columns: width=WHD[0]" in skipped.message
    flat, wall = (petmjx.load_plans(file, units="mm", up=up).plans[0] for up in ("z", "y"))
    assert flat.corner_mm[:, 2].tolist() == [0, 0, 0, 0]
    assert sorted(wall.corner_mm[:, 2]) == [0, 0, 300, 300]


def test_a_tie_is_asked_where_somebody_answers(tmp_path: Path) -> None:
    file = write(tmp_path / "cubes.json", {"fitItem": [{**cube, "rotationType": 0} for cube in CUBES]})
    sources: list[str] = []

    def choose(source: str, error: Any) -> Any:
        sources.append(source)
        return next(reading for reading in error.readings if reading.up == "y")

    token = CHOOSER.set(choose)
    try:
        (plan,) = petmjx.load_plans(file, units="mm").plans
    finally:
        CHOOSER.reset(token)
    assert sources == [str(file)]
    assert sorted(plan.corner_mm[:, 2]) == [0, 0, 300, 300]


def test_columns_that_no_name_tells_can_be_said(tmp_path: Path) -> None:
    lines = [
        "P;Q;R;Tx;Ty;Tz",
        *(";".join(map(str, list(row.values())[4:7] + list(row.values())[1:4])) for row in tower()),
    ]
    file = write(tmp_path / "odd.csv", "\n".join(lines) + "\n")
    assert petmjx.load_plans(file).skipped
    columns = "length=P,width=Q,height=R,x=Tx,y=Ty,z=Tz"
    (plan,) = petmjx.load_plans(file, columns=columns, units="mm").plans
    assert plan.corner_mm.tolist() == [[0, 0, 0], [400, 0, 0], [200, 0, 200]]
    (skipped,) = petmjx.load_plans(file, columns={"length": "nowhere"}).skipped
    assert "has no column nowhere (length)" in skipped.message
    with pytest.raises(InputError, match="columns must be ROLE=NAME"):
        petmjx.load_plans(file, columns="length")


def test_three_numbers_in_a_cell_and_units_behind_numbers(tmp_path: Path) -> None:
    rows = ["Karton;Abmessungen (L x B x H) mm;Gewicht;Position (x,y,z) mm"]
    for row in tower():
        size, grams = f"{row['length']}x{row['width']}x{row['height']}", 1000 * row["weight"]
        rows.append(f"{row['id']};{size};{grams} g;({row['x']}, {row['y']}, {row['z']})")
    (plan,) = petmjx.load_plans(write(tmp_path / "load.csv", "\n".join(rows) + "\n")).plans
    assert plan.size_mm[2].tolist() == [350, 300, 150]
    assert plan.corner_mm.tolist() == [[0, 0, 0], [400, 0, 0], [200, 0, 200]]
    assert plan.mass_kg.tolist() == [6, 5, 4]


def test_sizes_come_from_a_table_of_items(tmp_path: Path) -> None:
    places = [{"sku": row["id"], "x": row["x"], "y": row["y"], "z": row["z"]} for row in tower()]
    file = write(tmp_path / "places.json", {"boxes": places})
    rows = [[row[name] for name in ("id", "length", "width", "height", "weight")] for row in tower()]
    items = write(
        tmp_path / "goods.csv", "\n".join(",".join(map(str, row)) for row in [["sku", "L", "W", "H", "kg"], *rows])
    )
    assert "no sizes" in petmjx.load_plans(file).skipped[0].message
    (plan,) = petmjx.load_plans(file, items=items).plans
    assert plan.size_mm[2].tolist() == [350, 300, 150]
    assert plan.mass_kg.tolist() == [6, 5, 4]


def py3dbp_bin() -> SimpleNamespace:
    items = [
        SimpleNamespace(
            name=row["id"], width=row["length"], height=row["width"], depth=row["height"], weight=row["weight"],
            rotation_type=0, position=[row["x"], row["y"], row["z"]],
        )
        for row in tower()
    ]  # fmt: skip
    return SimpleNamespace(name="euro", width=1200, height=800, depth=1500, items=items, unfitted_items=[])


@pytest.mark.parametrize("form", ["bin", "packer", "frame", "array", "list"])
def test_objects_of_python_are_read_too(form: str) -> None:
    array = np.array([[row[name] for name in ("length", "width", "height", "x", "y", "z")] for row in tower()], float)
    value = {
        "bin": py3dbp_bin(),
        "packer": SimpleNamespace(bins=[py3dbp_bin()]),
        "frame": pd.DataFrame(tower()),
        "array": array,
        "list": tower(),
    }[form]
    (plan,) = petmjx.load_plans(value, units="mm", up="z").plans
    assert plan.corner_mm.tolist() == [[0, 0, 0], [400, 0, 0], [200, 0, 200]]
    assert plan.size_mm[2].tolist() == [350, 300, 150]


def test_info_says_how_a_file_is_read_and_writes_it_down(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write(tmp_path / "load.json", tower())
    written = tmp_path / "as.toml"
    assert main(["info", str(file), "--write-as", str(written)]) == 0
    text = capsys.readouterr().out
    assert f"{file}: JSON; 1 plan, 3 boxes" in text
    assert "mm, kg; coordinates of corners; z upwards; length, width, height along x, y, z; sizes as placed" in text
    assert read_reading(written).columns["length"] == "length"
    assert main(["convert", str(file), "--as", str(written), "-o", str(tmp_path / "plans.csv")]) == 0
    assert petmjx.load_plans(tmp_path / "plans.csv").plans[0].item_ids == ("a", "b", "c")
    assert main(["info", str(file), "--json"]) == 0
    (record,) = json.loads(capsys.readouterr().out.partition("\n[")[2].join(["[", ""]) or "[]")
    assert record["reading"]["units"] == "mm"
    assert main(["convert", str(file), "--as", str(tmp_path / "no.toml"), "-o", str(tmp_path / "p.csv")]) == 2
    assert "no.toml: no such file" in capsys.readouterr().err


def test_a_bad_written_reading_is_one_line(tmp_path: Path) -> None:
    for text, message in (
        ('anchor = "edge"', "anchor must be one of corner, centre, .*, corner-yz, got .edge."),
        ('colour = "red"', "unknown field colour"),
        ('units = "miles"', "'units' must be a unit of length, such as mm, got .miles."),
        ('units = "mm/cm/m"', "'units' must be a unit of length, such as mm, got .mm/cm/m."),
    ):
        with pytest.raises(InputError, match=f"as.toml: {message}"):
            read_reading(write(tmp_path / "as.toml", text))


def test_costs_of_layouts_count_what_is_odd() -> None:
    """The faults that count are: a box inside another box, a box in the air, and a box with only half of its base on
    its support."""
    none = np.full(3, np.nan)
    size = np.full((2, 3), 100.0)

    def cost(second: tuple[float, float, float]) -> tuple[float, tuple[int, int, int, float]]:
        total, _, counts = layout_cost(Layout(np.array([[0.0, 0, 0], second]), size, none))
        return total, counts

    assert cost((100, 0, 0)) == (0.0, (0, 0, 0, 2.0))
    assert cost((0, 0, 100)) == (0.0, (0, 0, 0, 2.0))
    assert cost((50, 0, 0))[1][:3] == (2, 0, 0)
    assert cost((0, 0, 150))[1][:3] == (0, 1, 0)
    assert cost((50, 0, 100))[1] == (0, 0, 0, 1.5)
    assert cost((0, 0, 100))[0] < cost((50, 0, 100))[0] < cost((0, 0, 150))[0]


def test_one_odd_box_among_many_counts() -> None:
    """One box floats above a layer of 80 boxes. As a share of all boxes, it would hardly count."""
    size = np.full((81, 3), 100.0)
    low = np.array([(100.0 * (k % 9), 100.0 * (k // 9), 0) for k in range(81)])
    even, *_ = layout_cost(Layout(low, size, np.full(3, np.nan)))
    low[40, 2] = 150
    odd, _, (_, n_floating, _, _) = layout_cost(Layout(low, size, np.full(3, np.nan)))
    assert n_floating == 1
    assert odd - even >= 1.0


def test_mirror_images_turns_and_shifts_are_the_same_layout() -> None:
    none = np.full(3, np.nan)
    low = np.array([[0.0, 0, 0], [400, 0, 0], [0, 0, 200]])
    size = np.array([[400.0, 300, 200], [200, 300, 200], [300, 200, 100]])
    one = Layout(low, size, none)
    turned = Layout(low[:, [1, 0, 2]] + 7, size[:, [1, 0, 2]], none)
    mirrored = Layout(np.column_stack([600 - low[:, 0] - size[:, 0], low[:, 1:]]), size, none)
    other = Layout(low + np.array([[0, 0, 0], [20, 0, 0], [0, 0, 0]]), size, none)
    assert same_layouts([one], [turned])
    assert same_layouts([one], [mirrored])
    assert not same_layouts([one], [other])


@pytest.mark.skipif(not SHARED.is_dir(), reason="shared/cases/files is not here")
def test_the_given_files() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", petmjx.PlanWarning)
        sets = {file.name: petmjx.load_plans(file) for file in sorted(SHARED.iterdir())}
    boxes = {name: [plan.n_boxes for plan in plan_set] for name, plan_set in sets.items()}
    assert boxes == {
        "centres_in_metres.json": [3],
        "german_headers.csv": [2],
        "nested_placements.json": [2],
        "packingsolver.csv": [22],
        "packingsolver_items.csv": [],
        "plain_list.json": [2],
        "py3dbp.csv": [26],
        "py3dbp.json": [26],
        "py3dbp_printed.txt": [26],
        "scene_of_boxes.xml": [2],
        "submission_without_sizes.json": [],
        "types_and_quantities.csv": [],
    }
    one, *others = (sets[name].plans[0] for name in ("py3dbp.json", "py3dbp.csv", "py3dbp_printed.txt"))
    for other in others:
        np.testing.assert_array_equal(one.corner_mm, other.corner_mm)
        np.testing.assert_array_equal(one.size_mm, other.size_mm)
    centred = sets["centres_in_metres.json"].plans[0]
    assert centred.corner_mm.round(6).tolist() == [[0, 0, 0], [400, 0, 0], [100, 100, 200]]
    assert sets["nested_placements.json"].plans[0].mass_kg.tolist() == [6, 6]
    assert sets["packingsolver.csv"].plans[0].mass_kg[0] == 12
    for name in ("packingsolver_items.csv", "types_and_quantities.csv"):
        assert "no places; pack them first: petmjx samples --orders" in sets[name].skipped[0].message
    assert (
        "no sizes: name a file that has them with --items FILE"
        in sets["submission_without_sizes.json"].skipped[0].message
    )


@pytest.mark.parametrize("form", [list, pd.DataFrame])
def test_strict_errors_about_objects_name_them_once(form: Any) -> None:
    rows = [
        {"L": 40, "W": 30, "H": -20 if (pallet, x) == ("b", 40) else 20, "x": x, "y": 0, "z": 0, "pallet": pallet}
        for pallet in "ab"
        for x in (0, 40)
    ]
    with pytest.raises(InputError, match=r"^(python|data frame): plan b, [^:]*3[^:]*: H must be > 0, got -20\.0$"):
        petmjx.load_plans(form(rows), strict=True)


@pytest.mark.parametrize("name", [7, None, np.int64(7), "P7"])
def test_names_of_dictionaries_may_be_any_values(name: Any) -> None:
    boxes = [{"x": 400 * k, "y": 0, "z": 0, "length": 400, "width": 300, "height": 200, "weight": 5} for k in range(3)]
    for value in ({name: boxes}, {"P7": dict(zip((name, 1, 2), boxes, strict=True))}):
        (plan,) = petmjx.load_plans(value)
        assert plan.corner_mm[:, 0].tolist() == [0, 400, 800]


@pytest.mark.parametrize("is_late", [False, True])
def test_a_box_listed_before_its_support_makes_an_order_implausible(is_late: bool) -> None:
    """Two stacks of two boxes. Both are listed from the ground up, or one of them from the top down."""
    lower, upper = [(0, 0, 0), (400, 0, 0)], [(0, 0, 400), (400, 0, 400)]
    low = np.array([lower[0], upper[1], upper[0], lower[1]] if is_late else lower + upper, float)
    assert bool(order_cost([Layout(low, np.full((4, 3), 400.0), np.full(3, np.nan))])) == is_late
