"""Tests of ``petmjx label``. Labels are the verdicts of simulations. No order is in two splits (train, validation,
test). The numbers on the card are right."""

from __future__ import annotations

import json
import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import nullcontext
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import petmjx
from petmjx.cli import main
from petmjx.common.errors import InputError
from petmjx.loop.episode_orders import Boxes, Orders, order_reading
from petmjx.loop.label_files import CARD, README, RULES, baselines, label_files, write_labels
from petmjx.loop.placement_labels import COLUMNS, SPLITS, Label, Labeller, plans_of_labels, split_of
from petmjx.loop.unfinished_labels import LabelParts, check_same_set, labels_of

MUJOCO: dict[str, Any] = {"engine": "mujoco", "threads": 1}


def some_orders(count: int = 24) -> pd.DataFrame:
    """Orders of three boxes each, with few different sizes. Each order has a twin with the same boxes, rotated and in
    another sequence."""
    rng = np.random.default_rng(0)
    rows = []
    for order in range(0, count, 2):
        sizes, masses = rng.choice([200, 300, 400, 600], (3, 3)), rng.integers(2, 9, 3)
        for twin, at in ((order, [0, 1, 2]), (order + 1, [2, 0, 1])):
            rows += [(twin, *(sizes[k][::-1] if twin % 2 else sizes[k]), masses[k]) for k in at]
    return pd.DataFrame(rows, columns=["order_id", "length_mm", "width_mm", "height_mm", "weight_kg"])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("labels")
    some_orders().to_csv(folder / "orders.csv", index=False)
    command = ["label", str(folder / "orders.csv"), "-n", "60", "-o", str(folder / "set"), "--engine", "mujoco"]
    assert main([*command, "--threads", "1", "--pallets", "8", "--explore", "0.8"]) == 0
    return folder


def tables(folder: Path) -> dict[str, pd.DataFrame]:
    return {split: pq.read_table(file).to_pandas() for split, file in label_files(folder / "set").items()}


def test_labels_are_what_a_score_says(folder: Path) -> None:
    labels = pd.concat(tables(folder).values()).sort_values(["episode", "step"]).reset_index(drop=True)
    assert list(labels) == list(COLUMNS)
    assert len(labels) == 60
    assert 3 <= (labels["stands"] == False).sum() < 55  # noqa: E712  # null is neither
    rows = [
        {**row, "size_mm": np.stack(row["size_mm"]), "corner_mm": np.stack(row["corner_mm"])}
        for row in labels.to_dict("records")
    ]
    scored = petmjx.score(plans_of_labels(rows), carrier="euro-pallet", **MUJOCO)
    worlds = scored.worlds
    np.testing.assert_array_equal(labels["stands"].astype(bool), worlds["verdict"] == "stable")
    np.testing.assert_array_equal(labels["reason"], worlds["reason"].fillna(""))
    np.testing.assert_array_equal(labels["culprit"].fillna(-1), worlds["culprit"].fillna(-1).astype(int))
    stands = labels["stands"].astype(bool).to_numpy()
    np.testing.assert_allclose(labels["margin"][stands], worlds["margin"][stands], atol=1e-4)
    forces = np.concatenate(labels["top_force_n"][stands].to_list())
    same = scored.boxes[scored.boxes["plan_id"].isin(worlds["plan_id"][stands])]["rest_top_force_n"]
    np.testing.assert_allclose(forces, same, atol=0.01)


def test_no_order_is_in_two_splits_under_any_name(folder: Path) -> None:
    """No order is in two splits, under any name: an order and its twin, which has the same boxes, are in the same
    split."""
    by_split = {split: set((table["order"] // 2).tolist()) for split, table in tables(folder).items()}
    pairs = [pair for some in by_split.values() for pair in some]
    assert len(pairs) == len(set(pairs))
    assert len(by_split["train"]) > 5
    rng = np.random.default_rng(1)
    drawn = [
        split_of(Boxes(rng.uniform(100, 500, (4, 3)), rng.uniform(1, 9, 4), np.full(4, np.nan))) for _ in range(2000)
    ]
    for split, share in SPLITS.items():
        assert abs(drawn.count(split) / 2000 - share) < 3 * np.sqrt(share * (1 - share) / 2000)


def test_the_card_counts_what_is_there(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    card = json.loads((folder / "set" / CARD).read_text(encoding="utf-8"))
    for split, table in tables(folder).items():
        assert card["splits"][split] == {
            "labels": len(table),
            "orders": table["order"].nunique(),
            "stand": int((table["stands"] == True).sum()),  # noqa: E712  # null is neither
            "fall": int((table["stands"] == False).sum()),  # noqa: E712
        }
    assert card["orders"]["source"] == "orders.csv"
    assert card["simulation"]["carrier"] == "euro-pallet"
    assert card["options"]["explore"] == 0.8
    page = (folder / "set" / README).read_text(encoding="utf-8")
    assert card["orders"]["sha256"] in page
    assert all(f"`{name}`" in page for name in COLUMNS)
    assert main(["label", "-n", "10", "-o", str(folder / "set")]) == 2
    assert "train.parquet" in capsys.readouterr().err


def test_more_labels_begin_with_the_same_ones_however_many_pallets_and_groups(folder: Path) -> None:
    orders = Orders(some_orders())
    few = list(Labeller(orders, pallets=5, groups=2, explore=0.8, **MUJOCO).labels(9))
    known = pd.concat(tables(folder).values()).sort_values(["episode", "step"]).head(9)
    assert [label["stands"] for label in few] == known["stands"].tolist()
    np.testing.assert_array_equal(
        [label["corner_mm"][-1] for label in few], np.stack([c[-1] for c in known["corner_mm"]])
    )


def test_a_long_order_among_short_ones_ends_no_set() -> None:
    """A long order among short orders does not end a set too early. While the first of two pallets gets 14 boxes, the
    other pallet could use up all short orders."""
    sizes = {"width_mm": 200, "height_mm": 100, "weight_kg": 3}
    order_ids = [0] * 14 + [*range(1, 40)]
    rows = [{"order_id": order, "length_mm": 300 if order else 200, **sizes} for order in order_ids]
    labels = [
        list(Labeller(Orders(pd.DataFrame(rows)), pallets=pallets, groups=groups, explore=0, **MUJOCO).labels(30))
        for pallets, groups in ((1, 1), (2, 1), (3, 3))
    ]
    assert [len(of_pallets) for of_pallets in labels] == [30, 30, 30]
    for alone, *others in zip(*labels, strict=True):
        for beside in others:
            assert (alone["episode"], alone["step"]) == (beside["episode"], beside["step"])
            np.testing.assert_array_equal(alone["corner_mm"], beside["corner_mm"])


def test_orders_without_a_place_end_no_set() -> None:
    """Orders for which there is no place do not end a set too early. While one pallet gets the box of an order that
    fits, other pallets use up many orders of which no box fits."""
    sizes = {"length_mm": 400, "width_mm": 300, "weight_kg": 3}
    rows = [{"order_id": 0, "height_mm": 200, **sizes}] + 6 * [{"order_id": 1, "height_mm": 2500, **sizes}]
    for pallets, groups in ((8, 1), (5, 2)):
        labeller = Labeller(Orders(pd.DataFrame(rows)), pallets=pallets, groups=groups, **MUJOCO)
        labels = list(labeller.labels(20))
        assert [label["episode"] for label in labels] == [*range(0, 40, 2)]


def test_labels_have_shares_of_worlds_with_errors() -> None:
    orders = Orders(some_orders(2))
    (label,) = Labeller(orders, pallets=1, errors=4, **MUJOCO).labels(1)
    assert label["share"] in {0.0, 0.25, 0.5, 0.75, 1.0}


def test_baselines_are_judged_by_what_they_find() -> None:
    """The baselines on the card are rated by how many falling boxes they find. The labels have two boxes on the
    carrier, and boxes that overhang another box."""
    base = ((400, 300, 200), (0, 0, 0), 6.0)

    def label(step: int, corner: tuple[float, float, float], stands: bool | None) -> dict[str, Any]:
        size, first, mass = base
        return {
            "episode": 0,
            "step": step,
            "size_mm": np.array([size, size], float),
            "corner_mm": np.array([first, corner], float),
            "mass_kg": np.array([mass, mass]),
            "stands": stands,
        }

    labels = [
        label(0, (400, 0, 0), True),
        label(1, (0, 0, 200), True),
        label(2, (150, 0, 200), True),  # 62 % of the base are supported
        label(3, (300, 0, 200), False),
        label(4, (300, 0, 200), None),
    ]
    judged = baselines(labels)
    assert set(judged) == {*RULES, "placement_stability"}
    assert judged["support_75"] == {
        "labels": 4,
        "standing_found": pytest.approx(2 / 3),
        "falling_found": 1.0,
        "mean": pytest.approx(5 / 6),
    }
    assert judged["support_50"]["mean"] == judged["centre"]["mean"] == 1.0
    assert baselines(labels[:3]) == {}


def test_what_is_wrong_with_labels_is_one_line(tmp_path: Path) -> None:
    pytest.importorskip("gymnasium", reason="gymnasium is not installed (extra: gym)")
    from petmjx.gym.single_env import PalletizingEnv

    sizes = {"length_mm": 2000, "width_mm": 2000, "height_mm": 100, "weight_kg": 1}
    too_long = pd.DataFrame([{"order_id": order, **sizes} for order in "abb"])
    with pytest.raises(
        InputError, match=r"orders: no box has a place on the empty carrier; check max_height_mm \(1800\)"
    ):
        write_labels(Labeller(Orders(too_long), pallets=4, **MUJOCO), 5, tmp_path / "none", source="endless")
    assert not (tmp_path / "none").exists()
    thin = pd.DataFrame([{"order_id": order, **sizes, "length_mm": side} for order, side in (("A7", 90), ("B8", 4))])
    for reader in (lambda **how: Labeller(Orders(thin), **how), lambda **how: PalletizingEnv(orders=thin, **how)):
        with pytest.raises(InputError, match=r"^orders: order B8, box 1: a side of 4 mm vanishes under"):
            reader(size_reduction_mm=6, **MUJOCO)
    with pytest.raises(InputError, match=r"^size_mm: a side of 4 mm vanishes under the size reduction of 6 mm"):
        petmjx.Pallets(1, size_reduction_mm=6, **MUJOCO).place(size_mm=[4, 300, 200], corner_mm=[0, 0, 0], mass_kg=1)
    with pytest.raises(InputError, match="explore must be"):
        Labeller(Orders(too_long), explore=2, **MUJOCO)


def test_without_shapely_no_label_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without shapely, no label is made, since the baselines on the card need shapely."""
    monkeypatch.setitem(sys.modules, "shapely", None)
    labeller = Labeller(Orders(some_orders(2)), pallets=1, **MUJOCO)
    with pytest.raises(InputError, match=r"^criteria need shapely: pip install 'petmjx\[packers\]'"):
        write_labels(labeller, 1, tmp_path / "set", source="endless", progress=pytest.fail)
    assert not (tmp_path / "set").exists()


def test_one_run_at_a_time_writes_labels_into_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """While a run makes labels in a folder, another run with this folder is refused, also after the first part was
    written."""
    monkeypatch.setattr("petmjx.loop.label_files._ROWS", 1)
    labeller = Labeller(Orders(some_orders(2)), pallets=1, **MUJOCO)
    out = tmp_path / "set"
    refusals: list[str] = []

    class Watched(Labeller):
        def episodes(self, *arguments: Any) -> Iterator[list[Label]]:
            yield from super().episodes(*arguments)
            for how in ({}, {"overwrite": True}, {"resume": True}):
                with pytest.raises(InputError) as refused:
                    write_labels(labeller, 1, out, source="endless", **how)
                refusals.append(str(refused.value))

    card = write_labels(Watched(Orders(some_orders(2)), pallets=1, **MUJOCO), 2, out, source="endless")
    assert sum(numbers["labels"] for numbers in card["splits"].values()) == 2
    assert len(refusals) == 3
    assert all("another run (process" in refusal for refusal in refusals)
    assert {file.name for file in out.iterdir()} == {
        "train.parquet",
        "validation.parquet",
        "test.parquet",
        CARD,
        README,
    }
    with pytest.raises(InputError, match="exists"):
        write_labels(labeller, 1, out, source="endless")


def test_labels_that_were_interrupted_go_on_as_if_they_had_not_been(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """If a run is interrupted and resumed, the labels, their order and the card are the same as without an
    interruption."""
    monkeypatch.setattr("petmjx.loop.label_files._ROWS", 10)
    out, whole = tmp_path / "set", Labeller.episodes
    command = ["label", str(folder / "orders.csv"), "-o", str(out), "--engine", "mujoco", "--threads", "1"]
    command += ["--explore", "0.8", "--pallets"]

    def cut_short(labeller: Labeller, *arguments: Any) -> Iterator[list[Label]]:
        for number, labels in enumerate(whole(labeller, *arguments)):
            if number == 4:
                raise KeyboardInterrupt
            yield labels

    monkeypatch.setattr(Labeller, "episodes", cut_short)
    assert main([*command, "8", "-n", "60"]) == 130
    (n_kept,) = re.findall(r"interrupted: (\d+) of 60 labels are in .*set; --resume continues", capsys.readouterr().err)
    assert 8 <= int(n_kept) < 30
    assert main([*command, "8", "-n", "60"]) == 2
    assert f"set: holds {n_kept} labels of an unfinished set; continue with --resume, or" in capsys.readouterr().err
    assert main([*command, "8", "-n", "60", "--resume", "--seed", "1"]) == 2
    assert (
        "cannot be resumed, because its labels were made in another way (options.seed was 0, is 1)"
        in capsys.readouterr().err
    )
    monkeypatch.setattr(Labeller, "episodes", whole)
    assert main([*command, "3", "-n", "60", "--resume"]) == 0
    for split, file in label_files(folder / "set").items():
        assert pq.read_table(file).equals(pq.read_table(out / f"{split}.parquet")), split
    assert (out / CARD).read_text(encoding="utf-8") == (folder / "set" / CARD).read_text(encoding="utf-8")
    assert len(list(out.iterdir())) == 5
    assert main([*command, "3", "-n", "60", "--resume"]) == 0, "finished labels stay as they are"
    assert main([*command, "3", "-n", "60", "--resume", "--overwrite"]) == 2


def test_labels_of_an_earlier_version_are_continued(tmp_path: Path) -> None:
    now = {"orders": {"sha256": None}, "simulation": petmjx.Simulation().model_dump(mode="json")}
    for name, differs in (("wrap", ""), ("longest_wait_s", "simulation.longest_wait_s was null, is 10.0")):
        before = {**now, "simulation": {key: value for key, value in now["simulation"].items() if key != name}}
        with pytest.raises(InputError, match=differs) if differs else nullcontext():
            check_same_set(tmp_path, before, now)


@pytest.fixture(scope="module")
def unfinished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An unfinished set that should have 60 labels. The unfinished set has two parts, with one episode each."""
    folder = tmp_path_factory.mktemp("unfinished")
    some_orders(2).to_csv(folder / "orders.csv", index=False)
    out = folder / "set"
    one = labeller_of(folder / "orders.csv")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("petmjx.loop.label_files._ROWS", 1)
        patch.setattr(Labeller, "episodes", ends_after(2))
        with pytest.raises(RuntimeError):
            write_labels(one, 60, out, source=folder / "orders.csv")
    return out


def test_labels_of_another_version_are_not_resumed(begun: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    schema = pq.read_schema(next((begun / "parts").rglob("*.parquet")))
    masses = pa.field("mass_kg", pa.list_(pa.float32()))
    other = schema.set(schema.get_field_index("mass_kg"), masses)
    monkeypatch.setattr("petmjx.loop.unfinished_labels._PART_SCHEMA", other)
    orders = begun.parent / "orders.csv"
    with pytest.raises(InputError, match=r"labels of another version of petmjx; make the labels again"):
        write_labels(labeller_of(orders), 60, begun, source=orders, resume=True)


def labeller_of(orders: Path, **reading: Any) -> Labeller:
    return Labeller(Orders(orders, reading=order_reading(**reading)), pallets=2, **MUJOCO)


def ends_after(n_episodes: int) -> Any:
    """A replacement for ``Labeller.episodes`` that fails after ``n_episodes`` episodes."""
    whole = Labeller.episodes

    def episodes(labeller: Labeller, *arguments: Any) -> Iterator[list[Label]]:
        yield from islice(whole(labeller, *arguments), n_episodes)
        raise RuntimeError

    return episodes


@pytest.fixture
def begun(unfinished: Path, tmp_path: Path) -> Path:
    """A copy of the unfinished set."""
    shutil.copytree(unfinished.parent, tmp_path, dirs_exist_ok=True)
    return tmp_path / "set"


def listed(folder: Path) -> dict[str, Any]:
    entries: dict[str, Any] = json.loads((folder / "unfinished.json").read_text(encoding="utf-8"))
    return entries


def content(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def damaged_part(folder: Path, name: str) -> str:
    part = folder / "parts" / name
    part.write_bytes(part.read_bytes()[:-1])
    return rf"{name}: damaged part, it differs from what the run wrote; make the labels again, with overwrite=True"


def missing_part(folder: Path, name: str) -> str:
    (folder / "parts" / name).unlink()
    return rf"{name}: missing, though the run wrote it; make the labels again, with overwrite=True"


def folder_as_part(folder: Path, name: str) -> str:
    (folder / "parts" / name).unlink()
    (folder / "parts" / name).mkdir()
    return rf"{name}: cannot be written: is a folder"


def other_entries(**changes: Any) -> Any:
    def damage(folder: Path, name: str) -> str:
        (folder / "unfinished.json").write_text(json.dumps({**listed(folder), **changes}))
        return r"unfinished.json: damaged; make the labels again, with overwrite=True"

    return damage


@pytest.mark.parametrize(
    "damage",
    [
        *(damaged_part, missing_part, folder_as_part),
        *(
            other_entries(labels=500),
            other_entries(labels=-5),
            other_entries(labels=0),
            other_entries(next_episode=7),
            other_entries(labels=1.5),
        ),
        *(other_entries(parts={"parts": ["part-00000.parquet"]}), other_entries(parts={"parts": {"part-x": ""}})),
    ],
)
def test_what_is_damaged_is_named_before_labels_are_made(
    damage: Any, begun: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Damage of a set is named before labels are made. No file is lost. ``overwrite`` makes the labels again, unless a
    part is a folder."""
    line = damage(begun, "part-00001.parquet")
    before, source = content(begun), begun.parent / "orders.csv"
    monkeypatch.setattr(Labeller, "episodes", lambda *_: pytest.fail("labels are made"))
    with pytest.raises(InputError, match=line):
        write_labels(labeller_of(source), 60, begun, source=source, resume=True)
    assert content(begun) == before
    monkeypatch.undo()
    if damage is folder_as_part:
        with pytest.raises(InputError, match=line):
            write_labels(labeller_of(source), 2, begun, source=source, overwrite=True)
        assert content(begun) == before
    else:
        write_labels(labeller_of(source), 2, begun, source=source, overwrite=True)
        assert len(list(begun.iterdir())) == 5


def test_labels_of_another_reading_or_number_are_not_resumed(begun: Path) -> None:
    """Labels are not resumed if orders are read differently, or with another number of pallets. Labels are resumed if
    the same file has another name."""
    before, renamed = content(begun), begun.parent / "renamed.csv"
    (begun.parent / "orders.csv").rename(renamed)
    n_kept = listed(begun)["labels"]
    for reading, line in (
        ({"density": 900}, r"orders.density was null, is 900.0"),
        ({"units": "mm,kg"}, r'orders.units was null, is "mm,kg"'),
        ({"columns": {"length": "length_mm"}}, r'orders.columns was null, is {"length": "length_mm"}'),
    ):
        with pytest.raises(InputError, match=r"its labels were made in another way \(" + re.escape(line)):
            write_labels(labeller_of(renamed, **reading), 60, begun, source=renamed, resume=True)
    with pytest.raises(InputError, match=rf"set: holds {n_kept} labels; pass count {n_kept} or more"):
        write_labels(labeller_of(renamed), n_kept - 1, begun, source=renamed, resume=True)
    assert content(begun) == before
    card = write_labels(labeller_of(renamed), n_kept, begun, source=renamed, resume=True)
    assert (card["orders"]["source"], card["orders"]["density"]) == ("renamed.csv", None)
    finished = content(begun)
    renamed.rename(begun.parent / "again.csv")
    again = begun.parent / "again.csv"
    assert write_labels(labeller_of(again), n_kept, begun, source=again, resume=True) == card
    for count in (n_kept - 1, n_kept + 1):
        with pytest.raises(InputError, match=rf"its {n_kept} labels are finished; name another folder"):
            write_labels(labeller_of(again), count, begun, source=again, resume=True)
    assert content(begun) == finished
    table = begun / "train.parquet"
    for change, fault in ((lambda: table.write_bytes(finished[table.name][:-9]), "damaged"), (table.unlink, "missing")):
        change()
        with pytest.raises(InputError, match=rf"train.parquet: {fault}; make the labels again"):
            write_labels(labeller_of(again), n_kept, begun, source=again, resume=True)


def test_labels_up_to_the_end_of_the_last_episode_are_resumed_with_the_same_number(begun: Path) -> None:
    """Labels can be resumed with the same number even if there are more labels, up to the end of the last episode. A
    run makes whole episodes; here, it was killed before it wrote its tables."""
    source, entries = begun.parent / "orders.csv", listed(begun)
    (begun / "unfinished.json").write_text(json.dumps({**entries, "count": entries["labels"] - 1}))
    card = write_labels(labeller_of(source), entries["labels"] - 1, begun, source=source, resume=True)
    assert sum(numbers["labels"] for numbers in card["splits"].values()) == entries["labels"] - 1


def test_a_run_without_a_label_leaves_nothing_that_refuses_the_next(
    begun: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, out = begun.parent / "orders.csv", begun.parent / "empty"
    monkeypatch.setattr(Labeller, "episodes", ends_after(0))
    with pytest.raises(RuntimeError):
        write_labels(labeller_of(source), 60, out, source=source)
    assert not out.exists()
    monkeypatch.undo()
    shutil.rmtree(begun / "parts")  # as if the run was killed before it wrote the first part
    (begun / "unfinished.json").write_text(json.dumps({**listed(begun), "labels": 0, "next_episode": 0, "parts": {}}))
    write_labels(labeller_of(source), 2, begun, source=source)
    assert len(list(begun.iterdir())) == 5


def test_progress_of_a_resumed_command_counts_its_own_labels(
    begun: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("petmjx.loop.label_files._REPORTED", 1)
    n_kept = listed(begun)["labels"]
    command = ["label", str(begun.parent / "orders.csv"), "-o", str(begun), "-n", str(n_kept + 4), "--pallets", "2"]
    assert main([*command, "--engine", "mujoco", "--threads", "1", "--resume"]) == 0
    assert re.search(r"^4 of 4 labels", capsys.readouterr().err, re.MULTILINE)


def test_labels_of_parts_are_those_that_were_made(tmp_path: Path) -> None:
    labeller = Labeller(Orders(some_orders(2)), pallets=1, **MUJOCO)
    head: dict[str, Any] = {"orders": {"sha256": None}}
    parts = LabelParts(tmp_path, head, 1, resume=False)
    (labels, *_) = labeller.episodes(1)
    parts.add(labels)
    again = LabelParts(tmp_path, head, len(labels), resume=True)
    assert (again.n_labels, again.next_episode) == (len(labels), 1)
    (table,) = again.tables()
    for ours, theirs in zip(labels_of(table), labels, strict=True):
        assert ours["stands"] == theirs["stands"]
        np.testing.assert_allclose(ours["corner_mm"], theirs["corner_mm"], rtol=1e-6)
