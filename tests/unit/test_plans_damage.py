"""Damaged plan files: whatever happens to the bytes, a file is either read completely as JSON, or refused with the
place of the damage."""

from __future__ import annotations

import gzip
import json
import random
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from support.plan_files import placement

from petmjx.common.errors import InputError
from petmjx.common.unreadable_files import foreign_kind
from petmjx.plans.plan import Plan
from petmjx.plans.plan_reader import load_plans
from petmjx.plans.plan_set import PlanSet

pytestmark = pytest.mark.filterwarnings("ignore::petmjx.PlanWarning")  # boxes at random places cause all kinds of notes

N_PLANS = 14


def sample_plans(seed: int) -> dict[str, list[dict[str, Any]]]:
    rng = random.Random(seed)
    plans = {}
    for index in range(N_PLANS):
        plans[f"{100_400 + index:08d}"] = [
            placement(
                corner=(rng.randrange(600), rng.randrange(400), rng.randrange(900)),
                size=(rng.randrange(100, 600), rng.randrange(100, 400), rng.randrange(80, 300)),
                orientation=rng.randrange(2),
                sequence=box + 1,
                article=rng.choice(["donut", "Knäckebröd", 'so-called "box"', "a, b: [c] {d}"]),
                id=f"{rng.randrange(10**6):08d}",
                **{"weight/kg": round(rng.uniform(0.2, 20), 3)},
            )
            for box in range(rng.randrange(1, 6))
        ]
    return plans


class Pairs(list[tuple[str, Any]]):
    """The pairs of a JSON object, in which ids may be repeated."""


class Sample:
    """An undamaged file, the plans read from it, and the bytes of each plan, from the opening quote of its id to its
    last bracket."""

    def __init__(self, seed: int, indent: int | None, folder: Path) -> None:
        plans = sample_plans(seed)
        self.data = json.dumps(plans, indent=indent, ensure_ascii=False).encode()
        self.path = folder / "sample.json"
        self.path.write_bytes(self.data)
        self.plans = {plan.plan_id: plan for plan in load_plans(self.path)}
        assert list(self.plans) == list(plans)
        starts = [self.data.index(f'"{plan_id}"'.encode()) for plan_id in plans]
        ends = [self.data.rindex(b"]", 0, after) + 1 for after in [*starts[1:], len(self.data)]]
        self.bytes_of = {plan_id: self.data[start:end] for plan_id, start, end in zip(plans, starts, ends, strict=True)}

    def load(self, damaged: bytes) -> PlanSet:
        self.path.write_bytes(damaged)
        return load_plans(self.path)


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> list[Sample]:
    return [Sample(seed, indent, tmp_path_factory.mktemp("damage")) for seed, indent in ((1, None), (2, 4), (3, 1))]


def same(a: Plan, b: Plan) -> bool:
    return (
        (a.plan_id, a.item_ids, a.articles) == (b.plan_id, b.item_ids, b.articles)
        and np.array_equal(a.size_mm, b.size_mm)
        and np.array_equal(a.corner_mm, b.corner_mm)
        and np.array_equal(a.mass_kg, b.mass_kg)
        and np.array_equal(a.sequence, b.sequence)
    )


def check(sample: Sample, damaged: bytes) -> bool:
    """Compare the reading of a damaged copy with that of Python's JSON decoder, which does not get commas behind last
    values. Returns whether the copy is still JSON."""
    plan_set = sample.load(damaged)
    read = {plan.plan_id: plan for plan in plan_set}
    assert len(read) == len(plan_set)
    for skipped in plan_set.skipped:
        assert skipped.message.startswith(f"{sample.path}: ")
        assert skipped.message.isprintable()
    try:
        text = damaged.decode("utf-8", "surrogateescape").removeprefix("\ufeff")
        text = re.sub(r'("(?:\\.|[^"\\\n])*+")|,(?=\s*+[}\]])', lambda match: match[1] or " ", text, flags=re.DOTALL)
        entries = json.loads(text, object_pairs_hook=Pairs)
        last_line = None
    except json.JSONDecodeError as error:
        last_line = error.lineno
    if last_line is not None:
        assert not read
        (refused,) = plan_set.skipped
        assert refused.plan_id is None
        if not any(words in refused.message for words in ("the file is empty", "the top level", "is damaged UTF-")):
            place = re.search(r"not JSON at line (\d+), column (\d+) ", refused.message)
            assert place is not None, refused.message
            assert int(place[1]) <= last_line
        return False
    if not isinstance(entries, Pairs):
        assert not read
        return True
    ids = [plan_id for plan_id, _ in entries]
    assert set(read) <= set(ids)
    assert len(plan_set) + len(plan_set.skipped) == max(len(ids), 1), "each plan is read, or has its line"
    for plan_id, plan in sample.plans.items():
        if sample.bytes_of[plan_id] in damaged and ids.count(plan_id) == 1:
            assert same(read[plan_id], plan)
    return True


def damage_once(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    length = min(rng.choice([1, 1, 2, 5, 30, 300, 2000]), len(data) - at)
    kind = rng.choice(["flip", "set", "delete", "truncate", "insert", "insert json", "duplicate", "swap", "zero"])
    if kind == "flip":
        return data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :]
    if kind == "set":
        return data[:at] + bytes([rng.choice(b'{}[]",:\\\n\x00\xff0a-')]) + data[at + 1 :]
    if kind == "delete":
        return data[:at] + data[at + length :]
    if kind == "truncate":
        return data[:at]
    if kind == "insert":
        return data[:at] + rng.randbytes(length) + data[at:]
    if kind == "insert json":
        return data[:at] + bytes(rng.choices(b'{}[]",:\\ 1a', k=rng.randrange(1, 6))) + data[at:]
    if kind == "duplicate":
        source = rng.randrange(len(data))
        return data[:at] + data[source : source + length] + data[at:]
    if kind == "swap":
        return data[at:] + data[:at]
    return data[:at] + bytes(length) + data[at + length :]


@pytest.mark.parametrize("which", [0, 1, 2])
def test_randomly_damaged_copies_are_read_whole_or_refused(samples: list[Sample], which: int) -> None:
    sample = samples[which]
    rng = random.Random(20_240 + which)
    n_json = 0
    for _ in range(100):
        damaged = sample.data
        for _ in range(rng.choice([1, 1, 1, 2, 3])):
            damaged = damage_once(damaged, rng) or b"{"
        n_json += check(sample, damaged)
    assert 10 < n_json < 90


@settings(max_examples=150, deadline=None, derandomize=True)
@given(which=st.integers(0, 2), at=st.floats(0, 1), cut=st.integers(0, 60), put=st.binary(max_size=12))
def test_any_single_replacement_is_read_whole_or_refused(
    samples: list[Sample], which: int, at: float, cut: int, put: bytes
) -> None:
    sample = samples[which]
    begin = int(at * len(sample.data))
    # these two bytes would make the file a gzip file without any of the plans
    assume(begin > 0 or not put.startswith(b"\x1f\x8b"))
    replaced = sample.data[:begin] + put + sample.data[begin + cut :]
    assume(foreign_kind(replaced) is None)
    check(sample, replaced)


STRUCTURE = st.lists(st.sampled_from(['"', "{", "}", "[", "]", ",", ":", "\\", " ", "\n", '"x": ', "7"]), max_size=6)


@settings(max_examples=125, deadline=None, derandomize=True)
@given(
    which=st.integers(0, 2),
    plan=st.integers(0, N_PLANS - 1),
    offset=st.integers(-6, 20),
    cut=st.integers(0, 8),
    put=STRUCTURE,
)
def test_structure_broken_at_a_plan_start_is_read_whole_or_refused(
    samples: list[Sample], which: int, plan: int, offset: int, cut: int, put: list[str]
) -> None:
    """Brackets, quotes and commas are removed or added where one plan ends and the next begins."""
    sample = samples[which]
    begin = max(sample.data.index(list(sample.bytes_of.values())[plan]) + offset, 0)
    check(sample, sample.data[:begin] + "".join(put).encode() + sample.data[begin + cut :])


@pytest.mark.parametrize("which", [0, 1])
def test_a_file_cut_off_anywhere_is_refused(samples: list[Sample], which: int) -> None:
    sample = samples[which]
    for end in range(1, len(sample.data) - 1, 97):
        plan_set = sample.load(sample.data[:end])
        assert len(plan_set) == 0
        (skipped,) = plan_set.skipped
        assert re.search(r"not JSON at line \d+, column \d+ \(the file ends .*truncated\?\)", skipped.message)


def test_a_damaged_spot_is_one_line_with_its_place(samples: list[Sample]) -> None:
    sample = samples[1]
    third = list(sample.plans)[2]
    at = sample.data.index(b'"orientation"', sample.data.index(f'"{third}"'.encode()))
    damaged = sample.data[:at] + sample.data[at + 1 :]
    line, column = damaged.count(b"\n", 0, at) + 1, at - damaged.rindex(b"\n", 0, at)
    place = f"plan {third}: not JSON at line {line}, column {column} "
    (skipped,) = sample.load(damaged).skipped
    assert skipped.message.startswith(f"{sample.path}: {place}(Expecting property name")
    assert (skipped.plan_id, skipped.number) == (None, None)
    with pytest.raises(InputError, match=re.escape(place)):
        load_plans(sample.path, strict=True)


def test_of_a_refused_file_nothing_is_left(samples: list[Sample], tmp_path: Path) -> None:
    """The ids of a refused file may be used by other files, its plans get no numbers, and no warning names its unknown
    fields or bad plans."""
    text = json.dumps({"bad": [], "A": [placement(colour="red")], "B": [placement()]})
    (tmp_path / "a.json").write_text(text[:-1])
    (tmp_path / "b.json").write_text(json.dumps({"B": [placement()], "A": [placement()]}))
    plan_set = load_plans([tmp_path / "a.json", tmp_path / "b.json"])
    assert [(plan.plan_id, plan.source) for plan in plan_set] == [(name, str(tmp_path / "b.json")) for name in "BA"]
    assert plan_set.numbers == {"B": 0, "A": 1}
    assert len(plan_set.skipped) == 1
    assert plan_set.notes == []
    assert load_plans(tmp_path / "a.json", limit=1).numbers == {"A": 1}, "what is read is as much as is wanted"


def test_a_wrapped_file_is_not_taken_for_damage(samples: list[Sample]) -> None:
    plan_set = samples[0].load(b'{"plans": ' + samples[0].data + b"}")
    assert [s.plan_id for s in plan_set.skipped] == ["plans"]
    assert len(plan_set) == 0


def test_damaged_gzip_files_keep_what_unpacks(samples: list[Sample]) -> None:
    sample = samples[1]
    packed = gzip.compress(sample.data)
    rng = random.Random(8)
    n_read = 0
    for _ in range(60):
        at = rng.randrange(len(packed))
        damaged = packed[:at] if rng.random() < 0.5 else packed[:at] + rng.randbytes(3) + packed[at + 3 :]
        plan_set = sample.load(damaged)
        assert len(plan_set) == N_PLANS or plan_set.skipped
        n_read += len(plan_set)
    assert n_read > 60, "on average much of a file lies before the damage"
    cut = sample.load(packed[: len(packed) * 3 // 4])
    assert len(cut) > N_PLANS // 3
    assert all(same(plan, sample.plans[plan.plan_id]) for plan in cut)
    assert "gzip data is cut off" in cut.skipped[0].message


def test_broken_utf8_costs_only_its_plan(samples: list[Sample]) -> None:
    sample = samples[0]
    at = sample.data.index("ä".encode())
    plan_set = sample.load(sample.data[:at] + b"\xff" + sample.data[at + 1 :])
    assert len(plan_set) == N_PLANS - 1
    assert plan_set.skipped[0].message.endswith("article is not UTF-8 text")


def test_comments_and_commas_behind_last_values_are_read(tmp_path: Path) -> None:
    text = "// by hand\n" + json.dumps({"A": [placement()]}).replace("{", "/* a plan */ {", 1).replace("}]", ",}, ]")
    (tmp_path / "p.json").write_text(text)
    assert [plan.plan_id for plan in load_plans(tmp_path / "p.json")] == ["A"]
