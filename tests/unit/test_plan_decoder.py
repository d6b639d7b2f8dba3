"""The fast decoder of plans gives the same plans, faults and notes as the decoder that reads each field by itself."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from petmjx.packers.sample_plans import generate_one
from petmjx.plans import plan_decoder, plan_reader
from petmjx.plans.plan import Plan
from petmjx.plans.plan_reader import load_plans
from petmjx.plans.plan_set import PlanSet

PLANS: dict[str, Any] = dict(generate_one(k, 7) for k in range(6))
IDS = list(PLANS)
TEXT = json.dumps(PLANS)


def same(text: str | bytes, folder: Path, monkeypatch: pytest.MonkeyPatch, **options: Any) -> tuple[PlanSet, list[int]]:
    """The plans of a JSON text, after a check that they equal the plans read field by field. Also returns, for each
    call of the fast decoder, the number of plans that it decoded."""
    path = folder / "plans.json"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    decoded: list[int] = []
    plans_of = plan_decoder._plans_of

    def counted(plan_ids: Any, *rest: Any) -> Any:
        plans = plans_of(plan_ids, *rest)
        decoded.append(sum(plan is not None for plan in plans))
        return plans

    with monkeypatch.context() as fast:
        fast.setattr(plan_decoder, "_plans_of", counted)
        one = load_plans(path, **options)
    with monkeypatch.context() as slow:
        slow.setattr(plan_reader, "decode_entries", lambda *_: None)
        other = load_plans(path, **options)
    assert [plan.plan_id for plan in one] == [plan.plan_id for plan in other]
    for plan, expected in zip(one, other, strict=True):
        for field in fields(Plan):
            value, its = getattr(plan, field.name), getattr(expected, field.name)
            if isinstance(its, np.ndarray):
                np.testing.assert_array_equal(value, its, strict=True)
            else:
                assert value == its, field.name
    for name in ("skipped", "warnings", "notes", "conventions", "numbers"):
        assert getattr(one, name) == getattr(other, name), name
    return one, decoded


@pytest.mark.parametrize("options", [{}, {"units": "cm,g"}, {"anchor": "centre"}, {"max_boxes": 30}])
def test_plans_are_the_same(options: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plan_decoder, "_MOST_PLANS", 4)
    plan_set, decoded = same(TEXT, tmp_path, monkeypatch, **options)
    if not options:
        assert decoded == [4, 2]
        assert len(plan_set.plans) == 6


def changed(change: Callable[[dict[str, Any]], Any]) -> str:
    plans = json.loads(TEXT)
    change(plans)
    return json.dumps(plans)


def item(plans: dict[str, Any]) -> dict[str, Any]:
    return plans[IDS[1]][2]["item"]  # type: ignore[no-any-return]


FAULTS: dict[str, Callable[[dict[str, Any]], Any]] = {
    "negative": lambda plans: item(plans).update({"weight/kg": -1}),
    "boolean": lambda plans: item(plans).update({"weight/kg": True}),
    "text": lambda plans: item(plans).update({"length/mm": "600"}),
    "null": lambda plans: item(plans).update({"length/mm": None}),
    "null group": lambda plans: item(plans).update({"product_group": None}),
    "too long": lambda plans: item(plans).update({"article": "x" * 1001}),
    "huge": lambda plans: item(plans).update({"sequence": 2**63}),
    "fraction": lambda plans: item(plans).update({"sequence": 1.0}),
    "far": lambda plans: plans[IDS[1]][0].update({"flb_coordinates": [0, 0, 20001]}),
    "two": lambda plans: plans[IDS[1]][0].update({"flb_coordinates": [0, 0]}),
    "orientation": lambda plans: plans[IDS[1]][0].update({"orientation": 2}),
    "missing": lambda plans: item(plans).pop("id"),
    "more fields": lambda plans: plans[IDS[1]][0].update({"colour": "red", "approach_deg": 90}),
    "soft": lambda plans: item(plans).update({"stiffness_n_mm": 200.0, "material": "wood"}),
    "floats": lambda plans: item(plans).update({"length/mm": 400.125, "weight/kg": 1e-2}),
    "empty": lambda plans: plans.update({IDS[1]: []}),
    "number": lambda plans: plans.update({IDS[1]: 7}),
    "order": lambda plans: plans.update({IDS[1]: {"item_sequence": {"1": {}}}}),
    "no id": lambda plans: plans.update({"": plans.pop(IDS[1])}),
    "colons": lambda plans: item(plans).update({"article": "a:b", "id": "::"}),
    "id with a colon": lambda plans: plans.update({"a:b": plans.pop(IDS[1])}),
    "other alphabets": lambda plans: (item(plans).update({"article": "Ä😀"}), plans.update({"ß": plans.pop(IDS[2])})),
    "surrogate": lambda plans: item(plans).update({"article": "\ud800"}),
}


@pytest.mark.filterwarnings("ignore:.*kg/m³:petmjx.PlanWarning")
@pytest.mark.parametrize("name", FAULTS)
def test_faults_and_rare_fields_are_the_same(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, decoded = same(changed(FAULTS[name]), tmp_path, monkeypatch)
    assert sum(decoded) in (0, 5, 6)  # the other plans need not be read field by field


def test_names_that_are_no_text_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same bad name in plans that are decoded one after another. The fast decoder relies on msgspec here."""
    monkeypatch.setattr(plan_decoder, "_MOST_PLANS", 2)
    plans = json.loads(TEXT)
    for plan_id in IDS[1::2]:
        plans[plan_id][0]["item"]["article"] = "\udc00 lone"
    plan_set, _ = same(json.dumps(plans), tmp_path, monkeypatch)
    assert [skipped.plan_id for skipped in plan_set.skipped] == IDS[1::2]


@pytest.mark.parametrize(
    "text",
    [
        TEXT.replace('"orientation": 0', '"orientation": 0, "orientation": 1', 1),
        TEXT.replace('"article"', '"article": "twice", "article"', 1),
        TEXT[:-1] + f', "{IDS[0]}": {json.dumps(PLANS[IDS[2]])}}}',
        TEXT[:-1] + ', "x": [NaN]}',
        TEXT[:-1] + ', "x": ' + "[" * 2000 + "]" * 2000 + "}",
        TEXT[:-1] + ', "x": 01}',
        TEXT[:-1] + ', "x": [1,]}',
        TEXT[: len(TEXT) // 2],
        TEXT + "x",
        "{}",
        " " + TEXT.replace(": ", ":\n"),
        TEXT.replace(IDS[3], "a\\u003ab"),
        TEXT.encode().replace(b"article", b"art\xffcle", 1),
        TEXT.encode().replace(IDS[1].encode(), b"\xe4", 1),
    ],
)
def test_damaged_texts_have_the_same_lines(text: str | bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    same(text, tmp_path, monkeypatch)


def test_bytes_that_are_changed_at_random_make_no_difference(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    random_source = random.Random(281128)
    text = json.dumps(dict(list(PLANS.items())[:2])).encode()
    for _ in range(150):
        damaged = bytearray(text)
        for _ in range(random_source.choice((1, 1, 3))):
            damaged[random_source.randrange(len(damaged))] = random_source.choice(b'0123456789,:"{}[]\\ -.eEx\x00\xff')
        same(bytes(damaged), tmp_path, monkeypatch)
