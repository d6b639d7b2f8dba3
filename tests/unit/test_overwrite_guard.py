"""No command replaces, follows or removes a file or link that it did not write, even if the file has the name of one of
its outputs."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
from support.command_line import only_line
from support.outcomes import make_outcome, make_plan
from unit.test_packer_comparison import write

import petmjx
from petmjx.cli import main
from petmjx.common.errors import InputError
from petmjx.results.run_folder import TABLES

pytest.importorskip("scipy")

BOX = {"length_mm": 400, "width_mm": 300, "height_mm": 200, "weight_kg": 5, "x_mm": 0, "y_mm": 0, "z_mm": 0}
ITEM = {"article": "a", "id": "1", "product_group": "g", "length/mm": 400, "width/mm": 300, "height/mm": 200}


def tables(*names: str) -> list[str]:
    return [f"{name}{suffix}" for name in names for suffix in (".parquet", ".csv")]


OF_RUN = ["run.json", ".lock", *(f"{table}/part-00000.parquet" for table in TABLES)]
OF_BOARD = ["index.html", "leaderboard.json", "orders.json", "plans/x.json", "plans/y.json", "plans/baseline.json"]
OF_BOARD += ["stories/1-1.html", "stories/2021-2022.html", "runs/x/run.json"]
COMMANDS: dict[str, tuple[list[str], list[str]]] = {
    "score": (["score", "p.json", "--engine", "mujoco", "--out", "out"], OF_RUN),
    "score --name": (["score", "--name", "x=p.json", "--name", "y=p.json", "--engine", "mujoco", "--out", "out"],
                     ["x/run.json", "y/run.json", "y/worlds/part-00000.parquet"]),
    "sweep": (["sweep", "s.toml", "p.json", "--engine", "mujoco", "--out", "out"], OF_RUN[:3]),
    "merge": (["merge", "half-1", "half-2", "--out", "out"], OF_RUN[:3]),
    "criteria": (["criteria", "p.json", "--run", "x-run", "--processes", "1", "--out", "out"],
                 [*tables("boxes", "plans", "judged", "thresholds"), "criteria.json"]),
    "compare": (["compare", "--packers", "x-run", "y-run", "--out", "out"],
                tables("packers", "pairs", "reasons", "decided", "plans")),
    "loads": (["loads", "x-run", "p.json", "--articles", "a.csv", "--out", "out"], tables("box_loads", "plan_loads")),
    "kpis": (["kpis", "p.json", "--orders", "o.json", "--assume-stable", "--xlsx", "--out", "out",
              "--leaderboard", "2026-11-22_doe_layers_offline3dbp"],
             [*tables("kpis"), "summary.json", "kpis.xlsx", "2026-11-22_doe_layers_offline3dbp.json"]),
    "leaderboard": (["leaderboard", "x=p.json", "y=q.json", "--orders", "o.json", "--baselines", "--engine", "mujoco",
                     "--stories", "1", "--out", "out"], OF_BOARD),
    "convert": (["convert", "p.json", "--out", "out/c.csv"], ["c.csv"]),
    "samples": (["samples", "-n", "1", "--workers", "1", "--out", "out/s.json"], ["s.json"]),
    "export": (["export", "o1", "p.json", "--out", "out/e.xml"], ["e.xml"]),
    "show": (["show", "o1", "p.json", "--engine", "mujoco", "--html", "out/h.html"], ["h.html"]),
    "report": (["report", "x-run", "--out", "out/r.html"], ["r.html"]),
    "figure": (["compare", "--packers", "x-run", "y-run", "--svg", "out/f.svg"], ["f.svg"]),
}  # fmt: skip
NAMED = ("convert", "samples", "export", "show", "report", "figure")
"""Commands whose output file is named by the user."""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    plan = petmjx.Plan.from_boxes("o1", [{**BOX, "article": "a", "item_id": "1"}])
    for name in ("p.json", "q.json"):
        petmjx.save_plans(plan, folder / name)
    order = {"item_sequence": {"1": ITEM | {"weight/kg": 5, "sequence": 1}}, "properties": {"target": "euro-pallet"}}
    (folder / "o.json").write_text(json.dumps({"o1": order}))
    (folder / "a.csv").write_text("article,strength_n\na,100\n")
    (folder / "s.toml").write_text('name = "s"\nplans = "given"\n\n[axes]\nfriction_factor = [0.9, 1.1]\n')
    for name in ("x-run", "y-run"):
        petmjx.score(folder / "p.json", engine="mujoco", out=folder / name)
    petmjx.save_plans([make_plan("m1"), make_plan("m2")], folder / "m.json")
    for part in (1, 2):
        petmjx.score(folder / "m.json", engine="mujoco", shard=f"{part}/2", out=folder / f"half-{part}")
    return folder


def as_file(path: Path, outside: Path) -> None:
    path.write_text("mine")


def as_folder(path: Path, outside: Path) -> None:
    path.mkdir()
    (path / "mine.txt").write_text("mine")


def as_link(path: Path, outside: Path) -> None:
    path.symlink_to(outside / "precious")


def as_dangling_link(path: Path, outside: Path) -> None:
    path.symlink_to(outside / "nothing")


def as_link_to_a_folder(path: Path, outside: Path) -> None:
    path.symlink_to(outside)


KINDS = (as_file, as_folder, as_link, as_dangling_link, as_link_to_a_folder)


def everything(folder: Path) -> dict[str, str | bytes]:
    """Everything below a folder: path → target of a link, "folder", or the bytes of a file."""
    return dict(_walk(folder))


def _walk(folder: Path) -> Iterator[tuple[str, str | bytes]]:
    for path in sorted(folder.iterdir()):
        if path.is_symlink():
            yield str(path), f"link to {os.readlink(path)}"
        elif path.is_dir():
            yield str(path), "folder"
            yield from _walk(path)
        else:
            yield str(path), path.read_bytes()


@pytest.fixture(scope="module")
def work(inputs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all inputs. The folder ``out`` in it is made again for each case."""
    return Path(shutil.copytree(inputs, tmp_path_factory.mktemp("work") / "here"))


@pytest.mark.parametrize("command", COMMANDS)
def test_nothing_of_the_user_is_touched(
    command: str, work: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(work)
    arguments, names = COMMANDS[command]
    inputs_before = everything(work)
    for number, name in enumerate(names):
        # the first name is tested with every kind of obstacle; the other names with a file, a link, and one more kind
        # in turn
        for kind in KINDS if number == 0 else (as_file, as_link, KINDS[(1, 3, 4)[number % 3]]):
            outside = tmp_path / f"outside-{number}-{kind.__name__}"
            outside.mkdir()
            (outside / "precious").write_text("mine")
            path = work / "out" / name
            path.parent.mkdir(parents=True)
            kind(path, outside)
            before = everything(work / "out") | everything(outside)
            replaces = kind is as_file and name in _NAMED_FILES
            for overwrite in (
                ([], ["--overwrite"]) if kind is as_file and not replaces else ([["--overwrite"], []][replaces],)
            ):
                code = main([*arguments, *overwrite])
                line = only_line(capsys.readouterr().err)
                assert code == 2, (name, kind.__name__, line)
                assert f"out/{name}" in line or "out: already contains" in line, (name, kind.__name__, line)
                assert everything(work / "out") | everything(outside) == before, (name, kind.__name__, line)
            shutil.rmtree(work / "out")
    assert everything(work) == inputs_before


_NAMED_FILES = ("c.csv", "s.json", "e.xml", "h.html", "r.html", "f.svg", "2026-11-22_doe_layers_offline3dbp.json")
"""Output files that the user names: with --overwrite, an existing regular file with this name is replaced."""


@pytest.mark.parametrize("table", [*TABLES, "stories", "runs"])
@pytest.mark.parametrize("kind", [as_file, as_link_to_a_folder, as_dangling_link])
def test_folders_within_are_neither_links_nor_files(
    table: str, kind: Callable[[Path, Path], None], inputs: Path, tmp_path: Path
) -> None:
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "part-00000.parquet").write_text("mine")
    (tmp_path / "out").mkdir()
    kind(tmp_path / "out" / table, tmp_path / "outside")
    before = everything(tmp_path)
    options: dict[str, Any] = {"engine": "mujoco", "out": tmp_path / "out", "overwrite": True}
    if table in TABLES:
        with pytest.raises(InputError, match=rf"{table}: is (a link|not a folder)"):
            petmjx.score(inputs / "p.json", **options)
    else:
        with pytest.raises(InputError, match=f"already contains {table}"):
            petmjx.leaderboard([inputs / "p.json", inputs / "q.json"], **options)
    assert everything(tmp_path) == before


def test_own_files_are_replaced_if_asked(
    inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(inputs, tmp_path / "work")
    monkeypatch.chdir(tmp_path / "work")
    for command, (arguments, _) in COMMANDS.items():
        if command in ("score --name", "merge", *NAMED):
            continue
        assert main(arguments) == 0, capsys.readouterr().err
        before = everything(Path("out"))
        capsys.readouterr()
        assert main(arguments) == 2
        line = only_line(capsys.readouterr().err)
        assert "--overwrite" in line
        assert everything(Path("out")) == before
        assert main([*arguments, "--overwrite"]) == 0, capsys.readouterr().err
        assert everything(Path("out")).keys() == before.keys()
        shutil.rmtree("out")


def test_an_input_is_never_replaced(
    inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The input is kept, whether the output has the input's path or another name (hard link) of the same file."""
    monkeypatch.chdir(tmp_path)
    petmjx.save_plans(make_plan("m1"), "plans.csv")
    write(tmp_path / "A", {"m1": make_outcome()})
    os.link("plans.csv", "boxes.csv")
    for arguments in (["plans.csv"], ["boxes.csv"], ["."]):
        for overwrite in ([], ["--overwrite"]):
            before = everything(tmp_path)
            assert main(["criteria", *arguments, "--out", ".", *overwrite]) == 2
            assert ".csv: is an input, so it cannot be written" in only_line(capsys.readouterr().err)
            assert everything(tmp_path) == before
    for out in ("A/run.json", "A/worlds/part-00000.parquet"):
        before = everything(tmp_path)
        assert main(["report", "A", "--out", out, "--overwrite"]) == 2
        assert f"{out}: is an input" in only_line(capsys.readouterr().err)
        assert everything(tmp_path) == before


def test_plans_in_the_place_of_a_run_s_table_are_kept(inputs: Path, tmp_path: Path) -> None:
    """The folder ``plans`` has parts of a data set that another tool wrote. The data set lies where the run would write
    its own table ``plans``."""
    (tmp_path / "plans").mkdir()
    part = tmp_path / "plans" / "part-00000.parquet"
    petmjx.save_plans(make_plan("m1"), part)
    before = part.read_bytes()
    for overwrite in (False, True):
        with pytest.raises(InputError, match=r"plans/part-00000\.parquet: was not written by petmjx"):
            petmjx.score(tmp_path / "plans", engine="mujoco", out=tmp_path, overwrite=overwrite)
        assert part.read_bytes() == before
    assert not (tmp_path / "run.json").exists()


def test_a_board_that_was_cut_short_goes_on(inputs: Path, tmp_path: Path) -> None:
    packers = {"x": inputs / "p.json", "y": inputs / "q.json"}

    def cut(name: str) -> Any:
        if name == "y":
            raise KeyboardInterrupt
        return nullcontext()

    with pytest.raises(KeyboardInterrupt):
        petmjx.leaderboard(packers, tmp_path / "board", engine="mujoco", stories=1, watch=cut)
    assert json.loads((tmp_path / "board" / "leaderboard.json").read_text())["unfinished"] is True
    page = petmjx.leaderboard(packers, tmp_path / "board", engine="mujoco", stories=1)
    data = json.loads((page.parent / "leaderboard.json").read_text())
    assert "unfinished" not in data
    assert data["files"] == [
        "index.html", "leaderboard.json", "plans/x.json", "plans/y.json", "stories/1-1.html", "stories/2-1.html"
    ]  # fmt: skip
    petmjx.leaderboard(packers, tmp_path / "board", engine="mujoco", stories=0, overwrite=True)
    assert not list((tmp_path / "board" / "stories").iterdir())
