"""Plans made from data frames and plain values in Python."""

from __future__ import annotations

from decimal import Decimal
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from test_tables import frame_of, ids, messages

import petmjx
from petmjx.plans.plan import Plan
from petmjx.plans.plan_reader import load_plans
from petmjx.results.plan_digests import plan_digest

pytestmark = pytest.mark.usefixtures("in_tmp_path")


def test_frames_of_many_types() -> None:
    assert ids(load_plans(frame_of())) == ["A", "B"]
    frame = frame_of(plan_id=[7, 7, 8], article=[1, 2, 3], orientation=[0.0, 1.0, 0.0])
    plan_set = load_plans(frame.astype({"article": "category", "weight_kg": "Float32", "sequence": "int8"}))
    assert ids(plan_set) == ["7", "8"]
    assert plan_set.plans[0].articles == ("1", "2")
    assert plan_set.plans[0].turned.tolist() == [False, True]
    assert ids(load_plans(pa.Table.from_pandas(frame_of()))) == ["A", "B"]
    assert ids(load_plans(frame_of().iloc[::-1], limit=1)) == ["B"]


def test_bad_values_in_frames() -> None:
    plan_set = load_plans(
        frame_of(
            weight_kg=[5, "5", 5],
            x_mm=[0, 0, np.nan],
        )
    )
    assert messages(plan_set) == [
        'data frame: plan A, row 1: weight_kg must be a number, got "5"',
        "data frame: plan B, row 2: x_mm is missing",
    ]
    for column, values, fault in (
        ("weight_kg", [5, 5, True], "weight_kg must be a number, got true"),
        ("weight_kg", [5, 5, 10**400], "weight_kg must be finite, got an integer of more than 60 digits"),
        ("weight_kg", [5, 5, Decimal("-5.5")], "weight_kg must be > 0, got -5.5"),
        ("weight_kg", [5, 5, pd.NaT], "weight_kg is missing"),
        ("weight_kg", [5, 5, pd.Timestamp(0)], 'weight_kg must be a number, got "1970-01-01 00:00:00"'),
        ("weight_kg", [5, 5, [5]], "weight_kg must be a number, got a list"),
        ("article", ["a", "b", "\ud800"], "article is not UTF-8 text"),
        ("article", ["a", "b", None], "article is missing"),
        ("orientation", [0, 0, "1"], 'orientation must be 0 or 1, got "1"'),
    ):
        plan_set = load_plans(frame_of(**{column: pd.Series(values, dtype=object)}))
        assert messages(plan_set) == [f"data frame: plan B, row 2: {fault}"]
        assert ids(plan_set) == ["A"]
    with pytest.raises(petmjx.InputError, match="plan B, row 2"):
        load_plans(frame_of(x_mm=[0, 0, np.inf]), strict=True)


def test_frames_are_scored_as_files_are() -> None:
    options: dict[str, Any] = {"engine": "mujoco", "check": "static", "duration_s": 0.05}
    frame = frame_of()
    petmjx.save_plans(load_plans(frame), "plans.json")
    from_frame, from_file = petmjx.score(frame, **options), petmjx.score("plans.json", **options)
    of_frame, of_file = (
        run.boxes.sort_values(["plan_id", "box"], ignore_index=True) for run in (from_frame, from_file)
    )
    pd.testing.assert_frame_equal(of_frame, of_file)
    assert from_frame.info["identity"] == from_file.info["identity"]


def test_plans_from_boxes() -> None:
    box = {"length_mm": 400, "width_mm": 300, "height_mm": 200, "weight_kg": 6, "x_mm": 0, "y_mm": 0}
    arrays = {"size_mm": [[400, 300, 200]] * 2, "corner_mm": [[0, 0, 0], [0, 0, 200]], "mass_kg": (6, 6)}
    plans = [
        Plan.from_boxes("tower", [{**box, "z_mm": 0}, {**box, "z_mm": 200}]),
        Plan.from_boxes("tower", {**{name: [value] * 2 for name, value in box.items()}, "z_mm": np.array([0, 200])}),
        Plan.from_boxes("tower", **arrays),
        Plan.from_boxes("tower", pd.DataFrame([{**box, "z_mm": 0}, {**box, "z_mm": 200}])),
    ]
    assert len({plan_digest(plan) for plan in plans}) == 1
    assert plans[0].size_mm.tolist() == [[400, 300, 200]] * 2
    turned = Plan.from_boxes(
        "tower", [{**box, "z_mm": 0}, {**box, "z_mm": 200}], orientation=[0, 1], article=["a", "b"]
    )
    assert turned.size_mm.tolist() == [[400, 300, 200], [300, 400, 200]]
    assert turned.articles == ("a", "b")


def test_sizes_as_boxes_stand_are_not_turned_again() -> None:
    """The arrays of a plan, together with its ``orientation``, give the same plan again, in millimetres or in another
    unit. The same holds for the plan of a pallet (``Pallets``)."""
    box = {"length_mm": 600, "width_mm": 200, "height_mm": 100, "weight_kg": 6, "x_mm": 0, "y_mm": 0}
    more = {"com_length_mm": [50, 0], "com_width_mm": [0, 10]}
    plan = Plan.from_boxes("A", [{**box, "z_mm": 0}, {**box, "z_mm": 100}], orientation=[1, 0], **more)
    assert plan.size_mm.tolist() == [[200, 600, 100], [600, 200, 100]]
    arrays = {"size_mm": plan.size_mm, "corner_mm": plan.corner_mm, "mass_kg": plan.mass_kg}
    for orientation in (plan.orientation, [1, 0], pd.Series([1.0, 0.0])):
        again = Plan.from_boxes("A", **arrays, orientation=orientation, **more)
        assert plan_digest(again) == plan_digest(plan)
        np.testing.assert_array_equal(again.item_size_mm, plan.item_size_mm)
        np.testing.assert_array_equal(again.item_com_mm, [[50, 0, 0], [0, 10, 0]])
    in_cm = {name: np.asarray(values) / 10 for name, values in arrays.items()}
    in_cm["mass_kg"] = plan.mass_kg
    assert Plan.from_boxes("A", **in_cm, orientation=[1, 0], units="cm").size_mm.tolist() == plan.size_mm.tolist()
    pallets = petmjx.Pallets(1, engine="mujoco")
    for size, corner, mass in zip(plan.size_mm, plan.corner_mm, plan.mass_kg, strict=True):
        pallets.place(size_mm=size, corner_mm=corner, mass_kg=mass)
    packed = pallets.plan(0, orientation=plan.orientation)
    pallets.close()
    assert packed.size_mm.tolist() == plan.size_mm.tolist()
    assert packed.item_size_mm.tolist() == [[600, 200, 100]] * 2
    with pytest.raises(petmjx.InputError, match="orientation must be 0 or 1, got 2"):
        Plan.from_boxes("A", **arrays, orientation=[2, 0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mass_kg": None}, "plan t: column weight_kg is missing"),
        ({"mass_kg": [1, 2]}, "plan t: all fields must have one value for each box, got length_mm 1, "),
        ({"mass_kg": [-1]}, "plan t, box 0: weight_kg must be > 0, got -1"),
        ({"size_mm": [400, 300, 200]}, "plan t: size_mm must have the shape (n, 3), got (3,)"),
        ({"size_mm": [[]]}, "plan t: size_mm must have the shape (n, 3), got (1, 0)"),
        ({"size_mm": [["a", 1, 2]]}, 'plan t, box 0: length_mm must be a number, got "a"'),
        ({"colour": ["red"]}, "plan t: unknown field colour"),
        ({"article": 5}, "plan t: article must be a list of values, one for each box, got 5"),
        ({"kind": "sheet"}, "plan t: kind must be a list of values, one for each box, got 'sheet'"),
        ({"size_mm": np.zeros((0, 3)), "corner_mm": np.zeros((0, 3)), "mass_kg": []}, "plan t: has no box"),
    ],
)
def test_boxes_that_are_refused(changes: dict[str, Any], message: str) -> None:
    good: dict[str, Any] = {"size_mm": [[400, 300, 200]], "corner_mm": [[0, 0, 0]], "mass_kg": [6]}
    with pytest.raises(petmjx.InputError) as raised:
        Plan.from_boxes("t", **(good | changes))
    assert str(raised.value).startswith(message)
