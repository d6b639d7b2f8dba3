"""Tests of documents and docstrings: names and links refer to things that exist in the repository, and examples run."""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from petmjx.common.checked_records import CheckedRecord
from petmjx.options.simulation import Simulation

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

STRING_OR_COMMENT = re.compile(
    r"""('{3}|"{3})(?:\\.|[^\\])*?\1|"(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*'|(?P<comment>\#[^\n]*)""", flags=re.DOTALL
)
"""A string or a comment of Python. Python's own tokenizer takes ten times as long."""

OUTSIDE = re.compile(r"\b[Tt]he spec\b|\bspec,? section|(?<!\]\()(?<!\]\(\.\./)\.\./|\b[Tt]he issue\b|\bissue \d")
"""References to things that readers of the repository do not have. Links to parent folders are checked by
``test_links_lead_somewhere``."""

ENDS = ("", ".py")
"""Suffixes that the name of a file may lack: a module may be named without ``.py``."""

MADE_BY_THE_BUILD = {"petmjx/ready_sweeps", "petmjx/_version.py"}
"""Paths that exist only in the wheel (pyproject.toml)."""


NO_PATHS = {"petmjx/Palletizing-v0"}
"""Names that look like paths but are not paths."""


def relative(path: Path) -> str:
    return str(path.relative_to(REPOSITORY))


def lines_of(text: str) -> Iterator[tuple[int, str]]:
    yield from enumerate(text.splitlines(), start=1)


Members = dict[str, "Members | str | None"]
"""Names that a module or class defines or imports. The value of a class is its own members. The value of an imported
name is the module from which it is imported. The value of any other name is None."""


class Source(NamedTuple):
    """The parts of a source file that tests need. The syntax tree is not kept: it has a hundred times as many objects,
    which would slow down garbage collection in all later tests."""

    texts: tuple[tuple[int, str], ...]
    """(line, text) of every comment, and of every string that is a statement, such as a docstring."""
    members: Members
    names_in_classes: frozenset[str]


@functools.cache
def source_of(path: Path) -> Source:
    source = path.read_text(encoding="utf-8")
    tree = ast.parse(source)
    texts = []
    names_in_classes: set[str] = set()
    for node in statements_of(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            texts += [(node.lineno + number - 1, line) for number, line in lines_of(node.value.value)]
        elif isinstance(node, ast.ClassDef):
            names_in_classes |= set(members_of(node.body))
    for match in STRING_OR_COMMENT.finditer(source):
        if comment := match["comment"]:
            texts.append((source.count("\n", 0, match.start()) + 1, comment))
    return Source(tuple(texts), members_of(tree.body), frozenset(names_in_classes))


def statements_of(node: ast.AST) -> Iterator[ast.stmt]:
    """All statements in a module or statement. ``ast.walk`` takes three times as long, since it visits expressions."""
    for field in ("body", "handlers", "cases", "orelse", "finalbody"):
        for part in getattr(node, field, ()):
            if isinstance(part, ast.stmt):
                yield part
            yield from statements_of(part)


def members_of(body: list[ast.stmt]) -> Members:
    members: Members = {}
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            members[node.name] = None
        elif isinstance(node, ast.ClassDef):
            members[node.name] = members_of(node.body)
        elif isinstance(node, ast.Assign):
            names = (name for target in node.targets for name in ast.walk(target))
            members |= {name.id: None for name in names if isinstance(name, ast.Name)}
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            members[node.target.id] = None
        elif isinstance(node, ast.Import | ast.ImportFrom):
            module = (node.module or "") if isinstance(node, ast.ImportFrom) else None
            members |= {alias.asname or alias.name: module for alias in node.names}
        elif isinstance(node, ast.If | ast.Try):
            members |= members_of(node.body)
    return members


def all_texts() -> Iterator[tuple[str, str]]:
    """(place, line) of each line of documents, docstrings and comments. Lines that a diff in a document adds are left
    out, since the repository does not have them."""
    for document in DOCUMENTS:
        for number, line in lines_of(document.read_text(encoding="utf-8")):
            if not line.startswith("+"):
                yield f"{relative(document)}:{number}", line
    for source in SOURCES:
        for number, line in source_of(source).texts:
            yield f"{relative(source)}:{number}", line


def anchors_of(document: Path) -> set[str]:
    """The anchors that GitHub makes from the headings of a document."""
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


@functools.cache
def exists(path: str) -> bool:
    """Whether the repository has a file or folder with this path or pattern."""
    return any(any(REPOSITORY.glob(path.rstrip("/") + end)) for end in ENDS)


def test_paths_that_are_named_exist() -> None:
    missing = []
    for where, line in all_texts():
        for path in MENTIONED_PATH.findall(line):
            if path not in MADE_BY_THE_BUILD | NO_PATHS and not exists(path):
                missing.append(f"{where}: {path}")
    assert not missing, "\n".join(missing)


def module_path(parts: list[str]) -> Path | None:
    base = REPOSITORY.joinpath(*parts)
    candidates = (base.with_suffix(".py"), base / "__init__.py")
    return next((path for path in candidates if path.is_file()), None)


@functools.cache
def resolves(name: str) -> bool:
    """Whether a name such as "petmjx.world.scene" is a module, or is defined in a module. Nothing is imported.

    Public names such as ``petmjx.score`` are imported by ``petmjx/__init__.py``. For public names, the module that
    defines the name is checked.
    """
    parts = name.split(".")
    depth = max((depth for depth in range(1, len(parts) + 1) if module_path(parts[:depth])), default=0)
    module = module_path(parts[:depth]) if depth else None
    if module is None:
        return False
    members: Members | None = source_of(module).members
    for number, part in enumerate(parts[depth:], start=depth + 1):
        if members is None or part not in members:
            return False
        member = members[part]
        if isinstance(member, str):
            return resolves(".".join([member, part, *parts[number:]]))
        members = member
    return True


def test_names_of_petmjx_exist() -> None:
    unknown = [
        f"{where}: {name}" for where, line in all_texts() for name in MENTIONED_NAME.findall(line) if not resolves(name)
    ]
    assert not unknown, "\n".join(unknown)


def test_roles_in_docstrings_resolve() -> None:
    """The name in a Sphinx role is a name of petmjx, or is defined or imported in the same file."""
    unknown = []
    for source in SOURCES:
        known = source_of(source).names_in_classes | set(source_of(source).members)
        for number, line in source_of(source).texts:
            for name in ROLE.findall(line):
                if not (resolves(name) if name.startswith("petmjx.") else name.split(".")[0] in known):
                    unknown.append(f"{relative(source)}:{number}: {name}")
    assert not unknown, "\n".join(unknown)


def test_no_text_points_outside_the_repository() -> None:
    this_path = relative(Path(__file__))
    outside = [
        f"{where}: {line.strip()}" for where, line in all_texts() if OUTSIDE.search(line) and this_path not in where
    ]
    assert not outside, "\n".join(outside)


def thread_calls(path: Path) -> Iterator[tuple[int, str | None]]:
    """The calls in a source file that start a thread or make a pool of threads: line, and name or prefix of names."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            function = ast.unparse(node.func)
            keyword = {"threading.Thread": "name", "ThreadPoolExecutor": "thread_name_prefix"}.get(function)
            if keyword is not None:
                names = [entry.value for entry in node.keywords if entry.arg == keyword]
                yield node.lineno, str(names[0].value) if names and isinstance(names[0], ast.Constant) else None


def test_every_thread_has_a_name_and_a_line_on_the_page() -> None:
    page = (REPOSITORY / "docs" / "architecture.md").read_text(encoding="utf-8")
    on_the_page = set(re.findall(r"`(petmjx-[\w-]+)`", page))
    calls = {
        f"{relative(source)}:{line}": name
        for source in SOURCES
        if relative(source).startswith("petmjx/")
        for line, name in thread_calls(source)
    }
    assert {where: name for where, name in calls.items() if name not in on_the_page} == {}
    assert on_the_page == set(calls.values()), "the page names no other threads"


def test_the_readme_is_short_and_its_table_is_that_of_the_page() -> None:
    """The README is short. The README shows some lines of the output of ``make demo``; docs/results.md explains all
    lines."""
    lines = (REPOSITORY / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 150
    shown = lines[lines.index("$ make demo") : lines.index("results in petmjx-results/demo") + 1]
    page = (REPOSITORY / "docs" / "results.md").read_text(encoding="utf-8").splitlines()
    assert len(shown) > 15
    assert [line for line in shown if line not in page] == []


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

    def fields(record: CheckedRecord, prefix: str = "") -> Iterator[str]:
        for name in type(record).model_fields:
            value = getattr(record, name)
            yield from fields(value, f"{name}.") if isinstance(value, CheckedRecord) else [f"{prefix}{name}"]

    assert [path for path in fields(Simulation()) if f"`{path}`" not in text] == []
