"""The examples in the documents run, and the error messages that they show are those of petmjx."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from support.pictures import needs_pictures
from support.plan_files import placement
from support.programs import run_program
from test_docs import CODE_BLOCK, REPOSITORY

from petmjx.plans.articles import read_articles
from petmjx.plans.plan_reader import load_plans


def blocks(document: str, language: str) -> list[str]:
    text = (REPOSITORY / "docs" / document).read_text(encoding="utf-8")
    return [body for name, body in CODE_BLOCK.findall(text) if name == language]


@pytest.fixture
def with_the_minimal_plan(tmp_path: Path) -> Path:
    (tmp_path / "plans.json").write_text(blocks("plan-format.md", "json")[0], encoding="utf-8")
    (tmp_path / "plans.csv").write_text(blocks("plan-format.md", "csv")[0], encoding="utf-8")
    return tmp_path


def test_examples_of_the_plan_format_run(with_the_minimal_plan: Path) -> None:
    for program in blocks("plan-format.md", "python"):
        printed = run_program(program, folder=with_the_minimal_plan)
        for expected in re.findall(r"print\(.*\)  # (.+)", program):
            assert expected in printed


def test_the_examples_of_both_forms_are_the_same_plan(with_the_minimal_plan: Path) -> None:
    (a,), (b,) = (load_plans(with_the_minimal_plan / name).plans for name in ("plans.json", "plans.csv"))
    assert (a.size_mm == b.size_mm).all()
    assert (a.corner_mm == b.corner_mm).all()
    assert a.articles == b.articles


def test_examples_of_kpis_and_loads_run(with_the_minimal_plan: Path) -> None:
    """The examples of KPIs and loads run after the commands at the beginning of their pages."""
    item = json.loads(blocks("plan-format.md", "json")[0])["my-first-plan"][0]["item"]
    order = {"item_sequence": {"1": item, "2": item}, "properties": {"target": "euro-pallet"}}
    (with_the_minimal_plan / "orders.json").write_text(json.dumps({"my-first-plan": order}), encoding="utf-8")
    (with_the_minimal_plan / "articles.csv").write_text(blocks("loads.md", "csv")[0], encoding="utf-8")
    (with_the_minimal_plan / "articles.toml").write_text(blocks("loads.md", "toml")[0], encoding="utf-8")
    score = "import petmjx\npetmjx.score('plans.json', engine='mujoco', check='static', duration_s=1, out='{}')\n"
    for document, folder in (("kpis.md", "standing"), ("loads.md", "results")):
        program = score.format(folder) + "\n".join(blocks(document, "python"))
        printed = run_program(program, folder=with_the_minimal_plan)
        assert "my-first-plan" in printed
    assert read_articles(with_the_minimal_plan / "articles.csv") == read_articles(
        with_the_minimal_plan / "articles.toml"
    )


def test_the_example_of_a_carrier_runs(tmp_path: Path) -> None:
    (tmp_path / "half-pallet.toml").write_text(blocks("carriers.md", "toml")[0], encoding="utf-8")
    own, of_units = blocks("carriers.md", "python")
    assert "half pallet 5" in run_program(own, folder=tmp_path)
    assert "stable" in run_program(of_units, folder=tmp_path)


def test_examples_of_extending_run(with_the_minimal_plan: Path) -> None:
    """All Python blocks of the page about extending petmjx run as one program."""
    printed = run_program("\n".join(blocks("extending.md", "python")), folder=with_the_minimal_plan)
    assert "hand-bridge" in printed
    assert "level_g" in printed


@needs_pictures()
def test_examples_of_seeing_run(tmp_path: Path) -> None:
    run_program("\n".join(blocks("seeing.md", "python")), folder=tmp_path)
    assert "hand-falls-off" in (tmp_path / "plan.html").read_text(encoding="utf-8")


def test_examples_of_criteria_run(tmp_path: Path) -> None:
    pytest.importorskip("shapely")
    pytest.importorskip("scipy")
    assert "centre_slack" in run_program("\n".join(blocks("criteria.md", "python")), folder=tmp_path)


def program_of_blocks(document: Path) -> str:
    """The Python blocks of a document, in order."""
    code_blocks = CODE_BLOCK.findall(document.read_text(encoding="utf-8"))
    return "\n".join(body for language, body in code_blocks if language == "python")


def test_examples_of_the_readme_and_of_results_run(tmp_path: Path) -> None:
    """The examples of README and results run as one program, in a folder with the results of ``make demo``."""
    pytest.importorskip("duckdb")
    demo = "import petmjx\npetmjx.score(limit=6, engine='mujoco', out='petmjx-results/demo')"
    documents = (REPOSITORY / "README.md", *(REPOSITORY / "docs" / name for name in ("results.md", "python.md")))
    programs = [program_of_blocks(document) for document in documents]
    assert all(programs)
    printed = run_program("\n".join([demo, *programs]), folder=tmp_path)
    assert all(word in printed for word in ("first_sign_s", "worst_shift_mm", "unstable", "largest_level_g"))


def test_examples_of_the_loop_run(tmp_path: Path) -> None:
    pytest.importorskip("gymnasium")
    printed = run_program("\n".join(blocks("loop.md", "python")), folder=tmp_path)
    assert re.search(r"1\d boxes, \d left out: stable", printed)


@pytest.mark.parametrize("number", range(4))
def test_examples_of_training_run(number: int, tmp_path: Path) -> None:
    """Each example of the page about training runs in a new interpreter, after the command on the page. Examples with
    libraries that are not installed are skipped."""
    pytest.importorskip("gymnasium")
    programs = blocks("training.md", "python")
    assert len(programs) == 4
    for library in ("torch", "sb3_contrib"):
        if re.search(rf"^(import|from) {library}\b", programs[number], flags=re.MULTILINE):
            pytest.importorskip(library, reason=f"{library} is not installed")
    if "labels/" in programs[number]:
        few = {"length_mm": [400, 300] * 20, "width_mm": 300, "height_mm": [200, 250] * 20, "weight_kg": 5}
        orders = pd.DataFrame({"order_id": [order for order in range(20) for _ in range(2)], **few})
        orders["length_mm"] += orders["order_id"]  # so that no two orders are equal
        orders.to_csv(tmp_path / "orders.csv", index=False)
        (command,) = re.findall(r"^\$ petmjx (label .+)$", blocks("training.md", "console")[0], flags=re.MULTILINE)
        run_program(f"from petmjx.cli import main; assert main({shlex.split(command)!r}) == 0", folder=tmp_path)
    assert run_program(programs[number], folder=tmp_path) or number == 0


def test_no_page_needs_an_import_before_gymnasium_knows_the_environment() -> None:
    pages = [*(REPOSITORY / "docs").rglob("*.md"), *(REPOSITORY / "examples").rglob("*.py"), REPOSITORY / "README.md"]
    bare = [str(page) for page in pages if re.search(r'make(_vec)?\(\s*"petmjx/Pall', page.read_text(encoding="utf-8"))]
    assert not bare


LESSONS = ("start.md", *(f"tutorials/{name}.md" for name in ("score", "see", "sweep", "packers", "loop", "train")))


def program_of(document: str) -> str:
    """The petmjx commands and the Python blocks of a page, in order. Other commands (pip, …) are left out."""
    steps = ["from petmjx.cli import main"]
    for language, body in CODE_BLOCK.findall((REPOSITORY / "docs" / document).read_text(encoding="utf-8")):
        if language == "console":
            commands = [shlex.split(line)[2:] for line in body.splitlines() if line.startswith("$ petmjx ")]
            steps += [f"assert main({command!r}) == 0" for command in commands]
        elif language == "python":
            steps.append(body)
    return "\n".join(steps)


SHORTER = {"tutorials/train.md": {"range(10)": "range(3)", "24, seed=100": "9, seed=100"}}
"""Page → replaced text: training takes a third of the time, and learns less."""


@needs_pictures()
@pytest.mark.parametrize("document", LESSONS)
def test_lessons_run(document: str, tmp_path: Path) -> None:
    """The lessons run as a new user types them, in a folder that contains only the files shown on the pages."""
    pytest.importorskip("scipy")
    pytest.importorskip("gymnasium")
    (tmp_path / "plans.csv").write_text(blocks("start.md", "csv")[0], encoding="utf-8")
    (tmp_path / "tilted.toml").write_text(blocks("tutorials/sweep.md", "toml")[0], encoding="utf-8")
    program = program_of(document)
    for long, short in SHORTER.get(document, {}).items():
        assert long in program
        program = program.replace(long, short)
    printed = run_program(program, folder=tmp_path)
    if match := re.search(r"(\d+)% stood before training, and (\d+)% stand now", printed):
        assert int(match[1]) + 30 < int(match[2])
    shown = [line for body in blocks(document, "console") for line in body.splitlines() if not line.startswith("$")]
    assert not [line for line in shown if line.split() and " ".join(line.split()) not in " ".join(printed.split())]


def edited(field: str, value: Any) -> list[dict[str, Any]]:
    """Eight placements. One field of the last placement has another value, or is removed if ``value`` is None."""
    plan = [placement() for _ in range(8)]
    holder = plan[7] if field in plan[7] else plan[7]["item"]
    holder[field] = value
    if value is None:
        del holder[field]
    return plan


def lacking(*fields: tuple[int, str]) -> list[dict[str, Any]]:
    """Three placements without the given fields (number of the placement, name of the field)."""
    plan = [placement() for _ in range(3)]
    for number, field in fields:
        del (plan[number] if field in plan[number] else plan[number]["item"])[field]
    return plan


REFUSED = {
    "missing": edited("weight/kg", None),
    "much missing": lacking((0, "weight/kg"), (2, "weight/kg"), (2, "sequence"), (2, "orientation")),
    "negative": edited("weight/kg", -1),
    "metres": edited("length/mm", 0.6),
    "text": edited("height/mm", "220"),
    "not a number": edited("height/mm", float("nan")),
    "orientation": edited("orientation", 2),
    "corner": edited("flb_coordinates", [0, 0]),
    "empty": [],
    "too many": [placement() for _ in range(600)],
}


@pytest.mark.parametrize("plan", REFUSED.values(), ids=REFUSED)
@pytest.mark.usefixtures("in_tmp_path")
def test_refusals_read_as_the_plan_format_says(plan: list[Any]) -> None:
    Path("plans.json").write_text(json.dumps({"A": plan}), encoding="utf-8")
    (skipped,) = load_plans("plans.json").skipped
    assert f"| `{skipped.message}` |" in (REPOSITORY / "docs" / "plan-format.md").read_text(encoding="utf-8")


HEADER, ROW = blocks("plan-format.md", "csv")[0].splitlines()[:2]


def table_row(plan_id: str, sequence: int = 1, **changes: object) -> str:
    """The first row of the example table, with some values changed."""
    values = dict(zip(HEADER.split(","), ROW.split(","), strict=True)) | {"plan_id": plan_id, "sequence": sequence}
    return ",".join(map(str, (values | changes).values()))


REFUSED_TABLES = {
    "value": [*(table_row("A", number) for number in range(15)), table_row("A", 15, weight_kg=-1)],
    "missing": [table_row("A", weight_kg=""), table_row("A", 2, weight_kg="", x_mm="")],
    "twice": [
        table_row("B"),
        table_row("C", 6),
        table_row("C", 8),
        table_row("C", 7),
        table_row("D"),
        table_row("C", 7),
    ],
    "no row": [table_row("A"), table_row("B") + ",7"],
    "quotation mark": [table_row("A"), table_row("B", article='"carton')],
    "no plan": [table_row("A"), table_row("")],
}


@pytest.mark.parametrize("rows", REFUSED_TABLES.values(), ids=REFUSED_TABLES)
@pytest.mark.usefixtures("in_tmp_path")
def test_refusals_of_tables_read_as_the_plan_format_says(rows: list[str]) -> None:
    Path("plans.csv").write_text("\n".join([HEADER, *rows, ""]), encoding="utf-8")
    (skipped,) = load_plans("plans.csv").skipped
    assert f"| `{skipped.message}` |" in (REPOSITORY / "docs" / "plan-format.md").read_text(encoding="utf-8")
