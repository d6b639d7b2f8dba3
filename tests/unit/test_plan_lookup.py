"""A run stores its plans, to the last bit. So the run's folder is enough to read the plans, wherever they came from and
wherever the folder is now."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from support.command_line import run

import petmjx
from petmjx.cli import main
from petmjx.common.errors import InputError
from petmjx.plans.plan import Plan
from petmjx.results.plan_digests import plan_digest, records_of
from petmjx.results.stored_plans import kept_plans, placements_table
from petmjx.results.table_parts import Parts

FIELDS = [name for name in Plan.__slots__ if name != "source"]


def plans() -> list[Plan]:
    """Plans with only the required fields, and plans with all optional fields."""
    tower = {"size_mm": [[400, 300, 200]] * 2, "corner_mm": [[0, 0, 0], [0, 0, 200]], "mass_kg": [6.1, 5 / 3]}
    odd = np.nextafter(np.array([[400.0, 300, 200]] * 2), 1e9)
    everything = {
        "orientation": [1, 0], "product_group": ["dairy", ""], "material": ["wood", ""], "article": ["a", "日本"],
        "item_id": ["1", "2"], "stiffness_n_mm": [200.0, np.nan], "strength_n": [np.nan, 900.0],
        "approach_deg": [0.0, 45.5], "com_length_mm": [10.0, 0.0], "order_sequence": [7, 3],
    }  # fmt: skip
    sheet = {**tower, "size_mm": [[400, 300, 200], [400, 300, 2]]}
    return [
        Plan.from_boxes("plain", **tower),
        Plan.from_boxes("exact", **{**tower, "size_mm": odd}),
        Plan.from_boxes("everything", **tower, **everything),
        Plan.from_boxes("sheet", **sheet, kind=["box", "sheet"]),
        Plan("bare", "python", odd, np.zeros((2, 3)), np.ones(2), ("", ""), ("", ""), np.array([5, 2])),
        Plan("named", "python", odd, np.zeros((2, 3)), np.ones(2), ("", ""), ("", ""), np.array([5, 2]),
             materials=("", ""), stiffness_n_mm=np.full(2, np.nan)),
    ]  # fmt: skip


def same(one: Plan, other: Plan) -> bool:
    def bits(value: object) -> object:
        return (value.dtype, value.tobytes()) if isinstance(value, np.ndarray) else value

    return all(bits(getattr(one, name)) == bits(getattr(other, name)) for name in FIELDS)


def test_what_is_kept_is_what_was_given(tmp_path: Path) -> None:
    known = plans()
    table = placements_table(known)
    assert table is not None
    parts = Parts(tmp_path, {}).replaced("placements", table)
    plan_by_id = kept_plans(parts, records_of(known), [plan.plan_id for plan in known])
    assert list(plan_by_id) == [plan.plan_id for plan in known]
    for plan in known:
        kept = plan_by_id[plan.plan_id]
        assert plan_digest(kept) == plan_digest(plan)
        assert same(kept, plan), plan.plan_id
        assert kept.source == plan.source
    assert kept_plans(parts, records_of(known), ["exact", "none"]).keys() == {"exact"}
    assert table.nbytes < 1_500 * len(known)


@pytest.fixture(scope="module")
def moved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three runs in folders that were moved: a run of plan objects, a run whose plan file is gone, and a sweep whose
    sweep file is gone."""
    made, now = tmp_path_factory.mktemp("made"), tmp_path_factory.mktemp("now")
    boxes = {"size_mm": [[400, 300, 200]] * 2, "mass_kg": [6.0, 5.0], "strength_n": [1.0, 1.0]}
    objects = [Plan.from_boxes(f"p{k}", corner_mm=[[0, 0, 0], [60.0 * k, 0, 200]], **boxes) for k in range(3)]
    petmjx.score(objects, engine="mujoco", out=made / "objects")
    petmjx.save_plans(objects[:2], made / "plans.csv")
    petmjx.score(made / "plans.csv", engine="mujoco", out=made / "file")
    (made / "own.toml").write_text('[axes]\nfriction_factor = [0.9, 1.1]\n[simulation]\ncarrier = "euro-pallet"\n')
    petmjx.sweep(made / "own.toml", objects[:1], engine="mujoco", out=made / "sweep")
    petmjx.score(objects[:1], engine="mujoco", confidence=4, errors=_errors(made), out=made / "sure")
    for k in (1, 2):
        petmjx.score(objects, engine="mujoco", shard=f"{k}/2", out=made / f"half-{k}")
    petmjx.merge_runs([made / "half-1", made / "half-2"], made / "merged")
    for name in ("objects", "file", "sweep", "sure", "merged"):
        shutil.move(made / name, now / name)
    shutil.rmtree(made)
    return now


def _errors(folder: Path) -> Path:
    (folder / "mine.toml").write_text("[axes]\nplacement_error_mm = 2\n")
    return folder / "mine.toml"


@pytest.mark.parametrize(
    ("folder", "variant"), [("objects", None), ("file", None), ("sweep", 1), ("sure", 2), ("merged", None)]
)
def test_the_folder_alone_is_enough(
    folder: str, variant: int | None, moved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    world = [] if variant is None else ["--variant", str(variant)]
    assert run("show", "p0", moved / folder, *world) == 0
    assert run("show", "p0", moved / folder, *world, "--html", "p0.html") == 0
    assert run("export", "p0", moved / folder, *world, "-o", "p0.xml") == 0
    assert run("report", moved / folder, "-o", "r.html") == 0
    assert "not found again" not in Path("r.html").read_text()
    story = petmjx.tell("p0", moved / folder, variant=variant)
    row = petmjx.load_run(moved / folder).worlds.set_index(["plan_id", "variant"]).loc[("p0", variant or 0)]
    assert story.outcome.verdict.value == row["verdict"]
    assert story.outcome.n_steps == row["n_steps"]


def test_loads_and_leaderboards_need_no_files(moved: Path, tmp_path: Path) -> None:
    assert petmjx.loads(moved / "objects").plans["overloaded"].sum() >= 1
    page = petmjx.leaderboard([moved / "objects", moved / "file"], tmp_path / "board", stories=1)
    assert (page.parent / "plans" / "objects.json").exists()


def test_a_run_in_memory_keeps_them_where_it_is_written() -> None:
    results = petmjx.score(plans()[:2], engine="mujoco")
    assert petmjx.tell("plain", results.path).outcome.verdict.value == results.worlds.verdict[0]
    assert pq.read_table(results.path / "placements" / "part-00000.parquet").num_rows == 4


def test_resumed_runs_keep_them_once(tmp_path: Path) -> None:
    petmjx.score(plans()[:2], engine="mujoco", out=tmp_path / "run")
    part = tmp_path / "run" / "placements" / "part-00000.parquet"
    before = part.read_bytes()
    petmjx.score(plans()[:2], engine="mujoco", out=tmp_path / "run", resume=True)
    assert part.read_bytes() == before
    assert [file.name for file in part.parent.iterdir()] == ["part-00000.parquet"]


def test_the_folder_of_a_run_stands_for_its_plans(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The folder of a run also stands for plans that were never in a file."""
    folder, again, file = tmp_path / "R", tmp_path / "again", tmp_path / "plans.json"
    given = plans()[:3]
    names = [plan.plan_id for plan in given]
    petmjx.score(given, engine="mujoco", check="static", duration_s=0.1, out=folder)
    assert petmjx.score(folder, engine="mujoco", check="static", out=again).worlds.plan_id.tolist() == names
    for options in ({"run": folder}, {"plans": str(folder)}, {"plans": [folder], "run": petmjx.load_run(folder)}):
        criteria_results = petmjx.criteria(**options, only=("support_75",))
        assert criteria_results.plans.plan_id.tolist() == names
    assert main(["criteria", "--run", str(folder), "--only", "support_75", "--json"]) == 0
    assert main(["convert", str(folder), "--out", str(file)]) == 0
    assert [plan.plan_id for plan in petmjx.load_plans(file)] == names
    capsys.readouterr()
    with pytest.raises(InputError, match=r"R: the folder of a run, not of plans: 'petmjx convert' writes"):
        petmjx.load_plans(folder)
