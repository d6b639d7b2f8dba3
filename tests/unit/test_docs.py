"""Documents and docstrings name what exists, point nowhere outside the repository, and their examples run."""

from __future__ import annotations

import ast
import functools
import io
import json
import os
import re
import shlex
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.pictures import needs_pictures
from support.plan_files import placement

from petmjx.checked import Checked
from petmjx.config import Simulation
from petmjx.plans.articles import read_articles
from petmjx.plans.read import load_plans

REPOSITORY = Path(__file__).resolve().parents[2]
DOCUMENTS = (
    REPOSITORY / "README.md",
    REPOSITORY / "benchmarks" / "README.md",
    REPOSITORY / "sweeps" / "README.md",
    REPOSITORY / "CONTRIBUTING.md",
    REPOSITORY / "SECURITY.md",
    *sorted((REPOSITORY / "docs").rglob("*.md")),
)
FOLDERS = ("petmjx", "tests", "benchmarks", "examples", "tools")
SOURCES = tuple(path for folder in FOLDERS for path in sorted((REPOSITORY / folder).rglob("*.py")))

LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
MENTIONED_PATH = re.compile(r"(?<![\w./-])(?:petmjx|docs|tests|benchmarks|sweeps|examples|tools)/[\w./*-]*[\w*/]")
MENTIONED_NAME = re.compile(r"(?<![\w./-])petmjx(?:\.[A-Za-z_]\w*)+(?![\w/])")
ROLE = re.compile(r":(?:func|class|meth|mod|data|attr):`~?([\w.]+)`")
CODE_BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", flags=re.DOTALL | re.MULTILINE)
HEADING = re.compile(r"^#+ (.+)$", flags=re.MULTILINE)

OUTSIDE = re.compile(r"\b[Tt]he spec\b|\bspec,? section|(?<!\]\()(?<!\]\(\.\./)\.\./|\b[Tt]he issue\b|\bissue \d")
"""What readers of the repository do not have. Links that go up are for `test_links_lead_somewhere`."""

ENDS = ("", ".py")
"""A module may be named without its ending."""

MADE_BY_THE_BUILD = {"petmjx/ready_sweeps", "petmjx/_version.py"}
"""Paths of the wheel alone (pyproject.toml)."""


NO_PATHS = {"petmjx/Palletizing-v0"}
"""Names that look like one."""


def relative(path: Path) -> str:
    return str(path.relative_to(REPOSITORY))


def lines_of(text: str) -> Iterator[tuple[int, str]]:
    yield from enumerate(text.splitlines(), start=1)


@functools.cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def docstrings_and_comments(path: Path) -> Iterator[tuple[int, str]]:
    """(line, text) of every comment, and of every string that stands as a statement (docstrings of fields too)."""
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield from ((node.lineno + number - 1, line) for number, line in lines_of(node.value.value))
    source = path.read_text(encoding="utf-8")
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string


def all_texts() -> Iterator[tuple[str, str]]:
    """(where, line) of documents, docstrings and comments. What a diff adds is not there yet."""
    for document in DOCUMENTS:
        for number, line in lines_of(document.read_text(encoding="utf-8")):
            if not line.startswith("+"):
                yield f"{relative(document)}:{number}", line
    for source in SOURCES:
        for number, line in docstrings_and_comments(source):
            yield f"{relative(source)}:{number}", line


def anchors_of(document: Path) -> set[str]:
    """Anchors of a document's headings, as GitHub makes them."""
    headings = HEADING.findall(document.read_text(encoding="utf-8"))
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("document", [*DOCUMENTS, REPOSITORY / "CHANGELOG.md"], ids=relative)
def test_links_lead_somewhere(document: Path) -> None:
    broken = []
    for target in LINK.findall(document.read_text(encoding="utf-8")):
        if "://" in target:
            continue
        name, _, anchor = target.partition("#")
        path = document.parent / name if name else document
        if not path.exists() or (anchor and anchor not in anchors_of(path)):
            broken.append(target)
    assert not broken


def exists(path: str) -> bool:
    """Whether a path, or a pattern of paths, is in the repository."""
    return any(any(REPOSITORY.glob(path.rstrip("/") + end)) for end in ENDS)


def test_paths_that_are_named_exist() -> None:
    missing = []
    for where, line in all_texts():
        for path in MENTIONED_PATH.findall(line):
            if path not in MADE_BY_THE_BUILD | NO_PATHS and not exists(path):
                missing.append(f"{where}: {path}")
    assert not missing, "\n".join(missing)


def members_of(body: list[ast.stmt]) -> dict[str, ast.stmt]:
    """Names that a module or class defines or imports, and by which statement."""
    found: dict[str, ast.stmt] = {}
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found[node.name] = node
        elif isinstance(node, ast.Assign):
            found |= {
                name.id: node for target in node.targets for name in ast.walk(target) if isinstance(name, ast.Name)
            }
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            found[node.target.id] = node
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found |= {alias.asname or alias.name: node for alias in node.names}
        elif isinstance(node, ast.If | ast.Try):
            found |= members_of(node.body)
    return found


def module_path(parts: list[str]) -> Path | None:
    base = REPOSITORY.joinpath(*parts)
    candidates = (base.with_suffix(".py"), base / "__init__.py")
    return next((path for path in candidates if path.is_file()), None)


def resolves(name: str) -> bool:
    """Whether a dotted name below petmjx is a module, or something in one. Nothing is imported for it.

    Public names (``petmjx.score``) are imports of ``petmjx/__init__.py``, and are followed to where they are defined.
    """
    parts = name.split(".")
    depth = max((depth for depth in range(1, len(parts) + 1) if module_path(parts[:depth])), default=0)
    module = module_path(parts[:depth]) if depth else None
    if module is None:
        return False
    body = tree_of(module).body
    for number, part in enumerate(parts[depth:], start=depth + 1):
        node = members_of(body).get(part)
        if isinstance(node, ast.ImportFrom):
            return resolves(".".join([node.module or "", part, *parts[number:]]))
        if node is None:
            return False
        body = node.body if isinstance(node, ast.ClassDef) else []
    return True


def test_names_of_petmjx_exist() -> None:
    unknown = [
        f"{where}: {name}" for where, line in all_texts() for name in MENTIONED_NAME.findall(line) if not resolves(name)
    ]
    assert not unknown, "\n".join(unknown)


def test_roles_in_docstrings_resolve() -> None:
    """A Sphinx role has a name of petmjx, or one that its own file defines or imports."""
    unknown = []
    for source in SOURCES:
        known = set(members_of(tree_of(source).body))
        for node in ast.walk(tree_of(source)):
            if isinstance(node, ast.ClassDef):
                known |= set(members_of(node.body))
        for number, line in docstrings_and_comments(source):
            for name in ROLE.findall(line):
                if not (resolves(name) if name.startswith("petmjx.") else name.split(".")[0] in known):
                    unknown.append(f"{relative(source)}:{number}: {name}")
    assert not unknown, "\n".join(unknown)


def test_no_text_points_outside_the_repository() -> None:
    own = relative(Path(__file__))
    outside = [f"{where}: {line.strip()}" for where, line in all_texts() if OUTSIDE.search(line) and own not in where]
    assert not outside, "\n".join(outside)


def blocks(document: str, language: str) -> list[str]:
    text = (REPOSITORY / "docs" / document).read_text(encoding="utf-8")
    return [body for name, body in CODE_BLOCK.findall(text) if name == language]


def run_in(folder: Path, program: str) -> str:
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def with_the_minimal_plan(tmp_path: Path) -> Path:
    (tmp_path / "plans.json").write_text(blocks("plan-format.md", "json")[0], encoding="utf-8")
    (tmp_path / "plans.csv").write_text(blocks("plan-format.md", "csv")[0], encoding="utf-8")
    return tmp_path


def test_examples_of_the_plan_format_run(with_the_minimal_plan: Path) -> None:
    for program in blocks("plan-format.md", "python"):
        printed = run_in(with_the_minimal_plan, program)
        for expected in re.findall(r"print\(.*\)  # (.+)", program):
            assert expected in printed


def test_the_examples_of_both_forms_are_the_same_plan(with_the_minimal_plan: Path) -> None:
    (a,), (b,) = (load_plans(with_the_minimal_plan / name).plans for name in ("plans.json", "plans.csv"))
    assert (a.size_mm == b.size_mm).all()
    assert (a.corner_mm == b.corner_mm).all()
    assert a.articles == b.articles


def test_examples_of_kpis_and_loads_run(with_the_minimal_plan: Path) -> None:
    """After the commands that their pages begin with."""
    item = json.loads(blocks("plan-format.md", "json")[0])["my-first-plan"][0]["item"]
    order = {"item_sequence": {"1": item, "2": item}, "properties": {"target": "euro-pallet"}}
    (with_the_minimal_plan / "orders.json").write_text(json.dumps({"my-first-plan": order}), encoding="utf-8")
    (with_the_minimal_plan / "articles.csv").write_text(blocks("loads.md", "csv")[0], encoding="utf-8")
    (with_the_minimal_plan / "articles.toml").write_text(blocks("loads.md", "toml")[0], encoding="utf-8")
    score = "import petmjx\npetmjx.score('plans.json', engine='mujoco', check='static', duration_s=1, out='{}')\n"
    for document, folder in (("kpis.md", "standing"), ("loads.md", "results")):
        printed = run_in(with_the_minimal_plan, score.format(folder) + "\n".join(blocks(document, "python")))
        assert "my-first-plan" in printed
    assert read_articles(with_the_minimal_plan / "articles.csv") == read_articles(
        with_the_minimal_plan / "articles.toml"
    )


def test_the_example_of_a_carrier_runs(tmp_path: Path) -> None:
    (tmp_path / "half-pallet.toml").write_text(blocks("carriers.md", "toml")[0], encoding="utf-8")
    assert "half pallet 5" in run_in(tmp_path, blocks("carriers.md", "python")[0])


def test_examples_of_extending_run(with_the_minimal_plan: Path) -> None:
    """All blocks as one program."""
    printed = run_in(with_the_minimal_plan, "\n".join(blocks("extending.md", "python")))
    assert "hand-bridge" in printed
    assert "level_g" in printed


@needs_pictures()
def test_examples_of_seeing_run(tmp_path: Path) -> None:
    run_in(tmp_path, "\n".join(blocks("seeing.md", "python")))
    assert "hand-falls-off" in (tmp_path / "plan.html").read_text(encoding="utf-8")


def test_examples_of_criteria_run(tmp_path: Path) -> None:
    pytest.importorskip("shapely")
    pytest.importorskip("scipy")
    assert "centre_slack" in run_in(tmp_path, "\n".join(blocks("criteria.md", "python")))


def program_of_blocks(document: Path) -> str:
    """The Python blocks of a document, in order."""
    found = CODE_BLOCK.findall(document.read_text(encoding="utf-8"))
    return "\n".join(body for language, body in found if language == "python")


def test_examples_of_the_readme_and_of_results_run(tmp_path: Path) -> None:
    """As one program, in a folder where ``make demo`` has left its results."""
    pytest.importorskip("duckdb")
    demo = "import petmjx\npetmjx.score(limit=6, engine='mujoco', out='petmjx-results/demo')"
    documents = (REPOSITORY / "README.md", *(REPOSITORY / "docs" / name for name in ("results.md", "python.md")))
    programs = [program_of_blocks(document) for document in documents]
    assert all(programs)
    printed = run_in(tmp_path, "\n".join([demo, *programs]))
    assert all(word in printed for word in ("first_sign_s", "worst_shift_mm", "unstable", "largest_level_g"))


def test_the_readme_is_short_and_its_table_is_that_of_the_page() -> None:
    """It shows some lines of what ``make demo`` prints; docs/results.md explains them all."""
    lines = (REPOSITORY / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 150
    shown = lines[lines.index("$ make demo") : lines.index("results in petmjx-results/demo") + 1]
    page = (REPOSITORY / "docs" / "results.md").read_text(encoding="utf-8").splitlines()
    assert len(shown) > 15
    assert [line for line in shown if line not in page] == []


def test_examples_of_the_loop_run(tmp_path: Path) -> None:
    pytest.importorskip("gymnasium")
    assert re.search(r"1\d boxes, \d left out: stable", run_in(tmp_path, "\n".join(blocks("loop.md", "python"))))


LESSONS = ("start.md", *(f"tutorials/{name}.md" for name in ("score", "see", "sweep", "packers", "train")))


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


@needs_pictures()
@pytest.mark.parametrize("document", LESSONS)
def test_lessons_run(document: str, tmp_path: Path) -> None:
    """As a newcomer types them, in an empty folder with the files that the pages show."""
    pytest.importorskip("scipy")
    pytest.importorskip("gymnasium")
    (tmp_path / "plans.csv").write_text(blocks("start.md", "csv")[0], encoding="utf-8")
    (tmp_path / "tilted.toml").write_text(blocks("tutorials/sweep.md", "toml")[0], encoding="utf-8")
    printed = run_in(tmp_path, program_of(document))
    if found := re.search(r"(\d+)% stood before training, and (\d+)% stand now", printed):
        assert int(found[1]) + 30 < int(found[2])
    shown = [line for body in blocks(document, "console") for line in body.splitlines() if not line.startswith("$")]
    assert not [line for line in shown if line.split() and " ".join(line.split()) not in " ".join(printed.split())]


def edited(field: str, value: Any) -> list[dict[str, Any]]:
    """Eight placements, the last with another value of one field; None takes the field away."""
    plan = [placement() for _ in range(8)]
    holder = plan[7] if field in plan[7] else plan[7]["item"]
    holder[field] = value
    if value is None:
        del holder[field]
    return plan


def lacking(*fields: tuple[int, str]) -> list[dict[str, Any]]:
    """Three placements without some fields."""
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
    """The first row of the example with other values."""
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


def default_of(path: str) -> object:
    value: Any = Simulation()
    for name in path.split("."):
        assert name in type(value).model_fields, f"Simulation has no {path}"
        value = getattr(value, name)
    return value


def as_documented(value: object) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, tuple):
        return ", ".join(str(entry) for entry in value)
    return "none" if value is None else str(value)


def test_the_rules_name_the_defaults() -> None:
    text = (REPOSITORY / "docs" / "rules.md").read_text(encoding="utf-8")
    tables = re.findall(r"^\| option \| default \| meaning \|\n\| --- .*\n((?:\|.*\n)+)", text, flags=re.MULTILINE)
    rows = [re.match(r"\| `([\w.]+)` \| (.+?) \|", row) for table in tables for row in table.splitlines()]
    named = {row[1]: row[2] for row in rows if row is not None}
    assert len(named) == len(rows)
    assert {path: as_documented(default_of(path)) for path in named} == named


def test_the_rules_name_every_option_of_a_run() -> None:
    text = (REPOSITORY / "docs" / "rules.md").read_text(encoding="utf-8")

    def fields(record: Checked, prefix: str = "") -> Iterator[str]:
        for name in type(record).model_fields:
            value = getattr(record, name)
            yield from fields(value, f"{name}.") if isinstance(value, Checked) else [f"{prefix}{name}"]

    assert [path for path in fields(Simulation()) if f"`{path}`" not in text] == []
