"""Imports run one way, reading results never loads a simulator, and the README's examples run as printed."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

LAYERS: tuple[frozenset[str], ...] = (
    frozenset({"errors", "text", "units", "machine", "bounded", "checked", "arguments", "whole", "config"}),
    frozenset({"run_options"}),
    frozenset({"plans", "history"}),
    frozenset({"world"}),
    frozenset({"metrics"}),
    frozenset({"verdict"}),
    frozenset({"engines"}),
    frozenset({"results"}),
    frozenset({"sweeps", "statics"}),
    frozenset({"packers", "rating"}),
    frozenset({"simulate"}),
    frozenset({"api", "doctor", "story"}),
    frozenset({"show", "pages", "pictures"}),
    frozenset({"cli", "__main__"}),
)
"""Modules and packages of petmjx, from left to right. A module imports from its own layer or those before it; what has
no layer fails the test. ``petmjx/__init__`` imports nothing: it looks names up when they are first used."""

READERS = (
    "petmjx.results.reader",
    "petmjx.results.compare",
    "petmjx.packers.compare",
    "petmjx.show.tables",
    "petmjx.pages.story_page",
    "petmjx.pages.report.make",
    "petmjx.plans",
    "petmjx.statics.run",
)
SIMULATORS = ("jax", "mujoco", "warp")


def layer_of(part: str) -> int:
    for number, names in enumerate(LAYERS):
        if part in names:
            return number
    raise AssertionError(f"petmjx.{part} has no layer in tests/unit/test_imports.py")


def imported_modules(path: Path) -> set[str]:
    """Modules of petmjx that a file imports anywhere in it, also inside functions."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            module = node.module or ""
            found |= {f"{module}.{alias.name}" for alias in node.names} if module == "petmjx" else {module}
    return {name for name in found if name.split(".")[0] == "petmjx"}


def source_files(repository: Path) -> list[Path]:
    return sorted((repository / "petmjx").rglob("*.py"))


def part_of(path: Path, repository: Path) -> str:
    """First name below petmjx: the module, or the package that holds it."""
    return path.relative_to(repository / "petmjx").with_suffix("").parts[0]


def test_imports_run_one_way(repository: Path) -> None:
    wrong = []
    for path in source_files(repository):
        part = part_of(path, repository)
        if part == "__init__":
            continue
        for name in imported_modules(path):
            target = name.partition(".")[2].partition(".")[0]
            if target in ("", "__version__"):
                continue
            if layer_of(target) > layer_of(part):
                wrong.append(f"{path.relative_to(repository)} imports {name}")
    assert not wrong, "\n".join(wrong)


def test_no_two_modules_import_each_other(repository: Path) -> None:
    graph: dict[str, set[str]] = {}
    for path in source_files(repository):
        part = part_of(path, repository)
        targets = {name.split(".")[1] for name in imported_modules(path) if "." in name}
        graph.setdefault(part, set()).update(targets - {part, "__version__"})
    graph.pop("__init__")
    done: set[str] = set()

    def visit(part: str, trail: tuple[str, ...]) -> None:
        assert part not in trail, " → ".join((*trail, part))
        if part not in done:
            for target in sorted(graph.get(part, ())):
                visit(target, (*trail, part))
            done.add(part)

    for part in sorted(graph):
        visit(part, ())


def loaded_by(statement: str) -> set[str]:
    """Which simulators are loaded after a statement in a fresh interpreter."""
    code = f"import sys\n{statement}\nprint(*[name for name in {SIMULATORS!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


@pytest.mark.parametrize("module", READERS)
def test_what_reads_results_loads_no_simulator(module: str) -> None:
    assert loaded_by(f"import {module}") == set()


def test_public_names_are_there_and_cheap() -> None:
    import petmjx

    for name in petmjx.__all__:
        assert getattr(petmjx, name) is not None
    assert set(petmjx.__all__) <= set(dir(petmjx))
    with pytest.raises(AttributeError, match="no attribute 'scores'"):
        petmjx.scores  # noqa: B018
    assert loaded_by("import petmjx; petmjx.load_plans, petmjx.load_run, petmjx.compare_runs") == set()


def readme_blocks(repository: Path, language: str) -> list[str]:
    text = (repository / "README.md").read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)


def test_readme_examples_run_as_printed(repository: Path, tmp_path: Path) -> None:
    """All Python blocks, in order, as one program, in a folder where ``make demo`` has left its results."""
    program = "\n".join(readme_blocks(repository, "python"))
    assert "petmjx.score(" in program
    assert "duckdb.sql(" in program
    environment = {**os.environ, "PYTHONPATH": str(repository)}

    def python(*arguments: str) -> str:
        command = [sys.executable, *arguments]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    python("-m", "petmjx", "score", "--engine", "mujoco", "--limit", "6", "--out", "petmjx-results/demo")
    printed = python("-c", program)
    assert "worst_shift_mm" in printed
    assert "unstable" in printed
