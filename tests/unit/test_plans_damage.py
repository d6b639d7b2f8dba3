"""Damaged files: whatever happens to the bytes, good plans are read and everything else is listed."""

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

from petmjx.errors import InputError
from petmjx.plans.plan import Plan
from petmjx.plans.plan_set import PlanSet
from petmjx.plans.read import load_plans

pytestmark = pytest.mark.filterwarnings("ignore::petmjx.PlanWarning")  # boxes at random places look like anything

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


class Sample:
    """A whole file, its plans as read from it, and each plan's bytes from the key's quote to the last bracket."""

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


def stands_unbroken(plan_bytes: bytes, damaged: bytes) -> bool:
    """A backslash put before a plan's first quote breaks the plan: that quote then belongs to a longer name."""
    return re.search(rb"(?<!\\)" + re.escape(plan_bytes), damaged) is not None


def lost_plans(sample: Sample, damaged: bytes) -> list[str]:
    """Check one damaged copy; returns the plans whose bytes stand in it unbroken and which were not read.

    A plan whose id is claimed twice is not lost but undecidable if a line says that its id is repeated.
    """
    found = sample.load(damaged)
    read = {plan.plan_id: plan for plan in found}
    repeated = {skipped.plan_id for skipped in found.skipped if "repeated plan id" in skipped.message}
    if not found.skipped:
        # Nothing was noticed: then the damage has made another, whole file, and all of that is read.
        assert set(json.loads(damaged.decode("utf-8-sig", "surrogateescape"))) == set(read)
    for skipped in found.skipped:
        assert skipped.message.startswith(f"{sample.path}: ")
        assert skipped.message.isprintable()
    return [
        plan_id
        for plan_id, plan in sample.plans.items()
        if stands_unbroken(sample.bytes_of[plan_id], damaged)
        and plan_id not in repeated
        and not (plan_id in read and same(read[plan_id], plan))
    ]


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
def test_200_randomly_damaged_copies_lose_nothing_of_the_rest(samples: list[Sample], which: int) -> None:
    sample = samples[which]
    rng = random.Random(20_240 + which)
    for _ in range(200):
        damaged = sample.data
        for _ in range(rng.choice([1, 1, 1, 2, 3])):
            damaged = damage_once(damaged, rng) or b"{"
        assert lost_plans(sample, damaged) == []


@settings(max_examples=300, deadline=None, derandomize=True)
@given(which=st.integers(0, 2), at=st.floats(0, 1), cut=st.integers(0, 60), put=st.binary(max_size=12))
def test_any_single_replacement_loses_nothing_of_the_rest(
    samples: list[Sample], which: int, at: float, cut: int, put: bytes
) -> None:
    sample = samples[which]
    begin = int(at * len(sample.data))
    assume(begin > 0 or not put.startswith(b"\x1f\x8b"))  # that makes it a gzip file, with nothing of the plans in it
    assert lost_plans(sample, sample.data[:begin] + put + sample.data[begin + cut :]) == []


STRUCTURE = st.lists(st.sampled_from(['"', "{", "}", "[", "]", ",", ":", "\\", " ", "\n", '"x": ', "7"]), max_size=6)


@settings(max_examples=500, deadline=None, derandomize=True)
@given(
    which=st.integers(0, 2),
    plan=st.integers(0, N_PLANS - 1),
    offset=st.integers(-6, 20),
    cut=st.integers(0, 8),
    put=STRUCTURE,
)
def test_structure_broken_at_a_plan_start_loses_nothing_of_the_rest(
    samples: list[Sample], which: int, plan: int, offset: int, cut: int, put: list[str]
) -> None:
    """Brackets, quotes and commas lost or added where plans meet: the hardest places to find the way back."""
    sample = samples[which]
    begin = max(sample.data.index(list(sample.bytes_of.values())[plan]) + offset, 0)
    damaged = sample.data[:begin] + "".join(put).encode() + sample.data[begin + cut :]
    assert lost_plans(sample, damaged) == []


@pytest.mark.parametrize("which", [0, 1])
def test_a_file_cut_off_anywhere_keeps_every_whole_plan(samples: list[Sample], which: int) -> None:
    sample = samples[which]
    plan_ends = [sample.data.index(of_plan) + len(of_plan) for of_plan in sample.bytes_of.values()]
    for end in sorted({*range(1, len(sample.data) - 1, 97), *plan_ends, *(end + 1 for end in plan_ends[:-1])}):
        damaged = sample.data[:end]
        assert lost_plans(sample, damaged) == []
        found = sample.load(damaged)
        assert len(found.skipped) == 1, "one cut is one line"
    message = found.skipped[0].message
    for part in ("truncated?", "line ", "column "):
        assert part in message


def test_one_spot_is_one_line_with_its_place(samples: list[Sample]) -> None:
    sample = samples[1]
    third = list(sample.plans)[2]
    at = sample.data.index(b'"orientation"', sample.data.index(f'"{third}"'.encode()))
    damaged = sample.data[:at] + sample.data[at + 1 :]
    found = sample.load(damaged)
    line = damaged.count(b"\n", 0, at) + 1
    (skipped,) = found.skipped
    assert skipped.plan_id == third
    assert len(found) == N_PLANS - 1
    assert f"plan {third}: not JSON at line {line}, column " in skipped.message
    assert "reading goes on at line " in skipped.message
    with pytest.raises(InputError, match=f"plan {third}: not JSON at line {line}"):
        load_plans(sample.path, strict=True)


def test_a_wrapped_file_is_not_taken_for_damage(samples: list[Sample]) -> None:
    found = samples[0].load(b'{"plans": ' + samples[0].data + b"}")
    assert [s.plan_id for s in found.skipped] == ["plans"]
    assert len(found) == 0


def test_two_broken_plans_are_two_lines(samples: list[Sample]) -> None:
    sample = samples[0]
    ids = list(sample.plans)
    damaged = sample.data
    for plan_id in (ids[3], ids[9]):
        at = damaged.index(b'}, "orientation"', damaged.index(f'"{plan_id}"'.encode()))
        damaged = damaged[:at] + damaged[at + 1 :]
    found = sample.load(damaged)
    assert [s.plan_id for s in found.skipped] == [ids[3], ids[9]]
    assert len(found) == N_PLANS - 2


def test_damaged_gzip_files_keep_what_unpacks(samples: list[Sample]) -> None:
    sample = samples[1]
    packed = gzip.compress(sample.data)
    rng = random.Random(8)
    n_read = 0
    for _ in range(60):
        at = rng.randrange(len(packed))
        damaged = packed[:at] if rng.random() < 0.5 else packed[:at] + rng.randbytes(3) + packed[at + 3 :]
        found = sample.load(damaged)
        assert len(found) == N_PLANS or found.skipped
        n_read += len(found)
    assert n_read > 60, "on average much of a file lies before the damage"
    cut = sample.load(packed[: len(packed) * 3 // 4])
    assert len(cut) > N_PLANS // 3
    assert all(same(plan, sample.plans[plan.plan_id]) for plan in cut)
    assert "gzip data is cut off" in cut.skipped[0].message


def test_broken_utf8_costs_only_its_plan(samples: list[Sample]) -> None:
    sample = samples[0]
    at = sample.data.index("ä".encode())
    found = sample.load(sample.data[:at] + b"\xff" + sample.data[at + 1 :])
    assert len(found) == N_PLANS - 1
    assert found.skipped[0].message.endswith("article is not UTF-8 text")
