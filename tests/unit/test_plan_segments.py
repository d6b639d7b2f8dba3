"""Tests of segments of JSON files: read apart and joined, they give what the whole file gives."""

from __future__ import annotations

import json
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.plans import make_plan, stack

import petmjx
from petmjx.common.errors import InputError
from petmjx.options.run_options import RunOptions
from petmjx.plans.plan_reader import read_plans
from petmjx.plans.plan_segments import Segment, joined, read_segment, segments_of
from petmjx.plans.plan_set import PlanSet
from petmjx.plans.plan_transfer_arrays import JoinedPlans

OPTIONS, EXTENT_MM = RunOptions(), (1200.0, 800.0)


@pytest.fixture
def entries(tmp_path: Path) -> dict[str, Any]:
    """Id → placements of twelve plans of one to five boxes."""
    plans = [make_plan(f"plan {n}", stack(1 + n % 5)) for n in range(12)]
    petmjx.save_plans(plans, tmp_path / "made.json")
    read: dict[str, Any] = json.loads((tmp_path / "made.json").read_text())
    return read


def write(folder: Path, entries: dict[str, Any], **style: Any) -> Path:
    file = folder / "plans.json"
    file.write_text(json.dumps(entries, **style))
    return file


def facts(plan_set: PlanSet) -> list[Any]:
    arrays = ("size_mm", "corner_mm", "mass_kg", "sequence", "orientation")
    plans = [
        (
            plan.plan_id,
            plan.articles,
            plan.item_ids,
            plan.product_groups,
            [getattr(plan, name).tobytes() for name in arrays],
        )
        for plan in plan_set.plans
    ]
    return [
        plans,
        *(plan_set.skipped, plan_set.warnings, plan_set.notes, plan_set.conventions),
        list(plan_set.numbers.items()),
    ]


def in_segments(file: Path, count: int) -> PlanSet | None:
    """The plans of a file, read in segments. None if it cannot be read so."""
    contents = [read_segment(segment, OPTIONS, EXTENT_MM) for segment in segments_of(file, count)]
    numbered = [skipped.number is not None for content in contents for skipped in content.plan_set.skipped]
    return joined(contents, EXTENT_MM) if contents and all(numbered) else None


@pytest.mark.parametrize("style", [{}, {"indent": 1}, {"separators": (",", ":")}], ids=["usual", "indented", "compact"])
@pytest.mark.parametrize("count", [1, 2, 5, 40])
def test_segments_give_the_whole(tmp_path: Path, entries: dict[str, Any], style: dict[str, Any], count: int) -> None:
    odd = json.loads(json.dumps(entries["plan 4"]))
    odd[-1]["flb_coordinates"][2] += 50  # this box floats
    more = json.loads(json.dumps(entries["plan 3"]))
    more[0]["item"]["colour"] = "red"
    entries |= {"faulty": [{"item": 1}], "odd": odd, "more": more, "last": entries["plan 2"]}
    file = write(tmp_path, entries, **style)
    segments = segments_of(file, count)
    assert 1 <= len(segments) <= count
    assert len(segments) > 1 or count == 1
    assert list(chain.from_iterable(json.loads(segment.text()) for segment in segments)) == list(entries)
    whole, of_segments = read_plans(file, OPTIONS, extent_mm=EXTENT_MM), in_segments(file, count)
    assert of_segments is not None
    assert facts(of_segments) == facts(whole)
    assert (len(whole.skipped), len(whole.warnings), len(whole.notes)) == (1, 1, 1)


def test_conventions_are_searched_in_all_plans(tmp_path: Path, entries: dict[str, Any]) -> None:
    """Each segment has plans whose coordinates are centres, but only together they are counted."""
    for placements in entries.values():
        for placement in placements:
            size = [placement["item"][name] for name in ("length/mm", "width/mm", "height/mm")]
            corner = placement["flb_coordinates"]
            placement["flb_coordinates"] = [place + length / 2 for place, length in zip(corner, size, strict=True)]
    file = write(tmp_path, entries)
    of_segments = in_segments(file, 3)
    assert of_segments is not None
    assert of_segments.conventions == read_plans(file, OPTIONS, extent_mm=EXTENT_MM).conventions != []


def test_a_cut_inside_a_plan_is_noticed(tmp_path: Path, entries: dict[str, Any]) -> None:
    for placements in entries.values():
        placements[0]["item"] |= {"tags": [1], "parts": [{"of": "item"}]}
    assert in_segments(write(tmp_path, entries), 7) is None


def test_a_cut_inside_a_text_is_noticed(tmp_path: Path, entries: dict[str, Any]) -> None:
    """The article ends with ``],`` and the next field begins with ``: [{``, so both together look like two plans."""
    for placements in entries.values():
        for placement in placements:
            del placement["item"]["article"]
            placement["item"] = {"article": "], ", ": [{": 1, **placement["item"]}
    file = write(tmp_path, entries)
    assert file.read_bytes()[segments_of(file, 5)[0].end - 3 :].startswith(b' "],')
    assert in_segments(file, 5) is None


@pytest.mark.parametrize("text", ["", "[1]", '{"a": 1', '\ufeff{"a": [{}], "b": [{}]}', "a;b"])
def test_other_texts_are_not_cut(tmp_path: Path, text: str) -> None:
    file = tmp_path / "plans.json"
    file.write_text(text)
    assert segments_of(file, 3) == []


def test_faults_of_the_file_are_not_read_in_segments(tmp_path: Path, entries: dict[str, Any]) -> None:
    file = write(tmp_path, entries)
    text = file.read_text()
    file.write_text(text.replace('"plan 7"', "plan 7"))
    assert in_segments(file, 3) is None
    file.write_text(text.replace('"plan 11"', '"plan 0"'))
    assert in_segments(file, 3) is None
    file.write_text(text)
    with pytest.raises(OSError, match="shorter"):
        Segment(file, 1, len(text) + 5).text()
    strict = RunOptions(strict=True)
    file.write_text(json.dumps({"faulty": [{"item": {"length/mm": 1}}], **entries}))
    with pytest.raises(InputError, match="faulty"):
        read_segment(segments_of(file, 2)[0], strict, EXTENT_MM)


def test_columns_keep_every_field() -> None:
    boxes: Any = {"size_mm": [[400, 300, 200]] * 2, "corner_mm": [[0, 0, 0], [0, 0, 200]], "mass_kg": [6, 7]}
    plans = [
        make_plan("usual", stack(2)),
        petmjx.Plan.from_boxes("materials", **boxes, material=["wood", ""]),
        petmjx.Plan.from_boxes("orientations", **boxes, orientation=[0, 1], product_group=["a", ""]),
        make_plan("last", stack(3)),
    ]
    again = JoinedPlans.of(plans).plans
    assert [plan.plan_id for plan in again] == [plan.plan_id for plan in plans]
    for plan, before in zip(again, plans, strict=True):
        for name in petmjx.Plan.__dataclass_fields__:
            value, expected = getattr(plan, name), getattr(before, name)
            if isinstance(expected, np.ndarray):
                assert value.dtype == expected.dtype
                assert value.tobytes() == expected.tobytes()
            else:
                assert value == expected
    assert JoinedPlans.of([]).plans == []
