"""Tests of imports: modules import only from earlier layers, and reading results never loads a simulator."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Collection
from pathlib import Path

import pytest

from petmjx.common.garbage_collection import no_collection

LAYERS: tuple[frozenset[str], ...] = (
    frozenset({"_version", "version", "common"}),
    frozenset({"options"}),
    frozenset({"plans"}),
    frozenset({"world"}),
    frozenset({"engines"}),
    frozenset({"results"}),
    frozenset({"runs"}),
    frozenset({"analysis"}),
    frozenset({"api"}),
    frozenset({"packers"}),
    frozenset({"repairs"}),
    frozenset({"show"}),
    frozenset({"loop"}),
    frozenset({"gym", "jax"}),
    frozenset({"cli", "__main__"}),
)
"""Layers of petmjx's modules and packages, from first to last. A module may import from its own layer and from earlier
layers. Every module must be in a layer, except ``petmjx/__init__``: it imports only the version, and looks up other
names when they are first used. No other module imports it."""

READERS = (
    "petmjx.results.run_reader",
    "petmjx.analysis.run_comparison",
    "petmjx.analysis.packer_comparison",
    "petmjx.show.run_tables",
    "petmjx.show.pages.story_page",
    "petmjx.show.report.report_page",
    "petmjx.plans",
    "petmjx.analysis.criteria_run",
)
SIMULATORS = ("jax", "mujoco", "warp")


def layer_of(part: str) -> int:
    for number, names in enumerate(LAYERS):
        if part in names:
            return number
    raise AssertionError(f"petmjx.{part} has no layer in tests/unit/test_imports.py")


def source_files(repository: Path) -> list[Path]:
    return sorted((repository / "petmjx").rglob("*.py"))


def module_of(path: Path, repository: Path) -> str:
    return ".".join(path.relative_to(repository).with_suffix("").parts).removesuffix(".__init__")


def imported_modules(path: Path, modules: Collection[str]) -> set[str]:
    """Those of ``modules`` that a file imports at any place, including imports in functions, imports only for types,
    and imports by a name in a string."""
    names = set()
    # In CPython 3.11, a collection of garbage inside ``ast.parse`` may let another thread parse. Then one of the two
    # raises SystemError ("AST constructor recursion depth mismatch").
    with no_collection():
        tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            inside = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= inside if inside <= set(modules) else {node.module or "", *inside}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value != "petmjx":
            names.add(node.value)
    return names & set(modules)


def import_graph(repository: Path) -> dict[str, set[str]]:
    """Module → the modules of petmjx that it imports. The package ``petmjx`` itself is left out, since all modules can
    be reached from it."""
    paths = {module_of(path, repository): path for path in source_files(repository)}
    graph = {module: imported_modules(path, paths) for module, path in paths.items() if module != "petmjx"}
    package = sorted(module for module, targets in graph.items() if "petmjx" in targets)
    assert not package, f"these import the package: {package}"
    return graph


def circle_in(graph: dict[str, set[str]]) -> tuple[str, ...]:
    """A circle of imports, from a module back to this module; empty if there is no circle."""
    done: set[str] = set()

    def visit(module: str, trail: tuple[str, ...]) -> tuple[str, ...]:
        if module in trail:
            return (*trail[trail.index(module) :], module)
        if module in done:
            return ()
        circle = next(filter(None, (visit(neighbour, (*trail, module)) for neighbour in sorted(graph[module]))), ())
        done.add(module)
        return circle

    return next(filter(None, (visit(module, ()) for module in sorted(graph))), ())


def part_of(module: str) -> str:
    """The module or package directly below ``petmjx`` that contains a module."""
    return module.split(".")[1]


@pytest.fixture(scope="module")
def graph(repository: Path) -> dict[str, set[str]]:
    return import_graph(repository)


def test_imports_run_one_way(graph: dict[str, set[str]]) -> None:
    wrong = [
        f"{module} imports {target}"
        for module, targets in graph.items()
        for target in sorted(targets)
        if layer_of(part_of(target)) > layer_of(part_of(module))
    ]
    assert not wrong, "\n".join(wrong)


def test_no_circle_among_modules_also_behind_functions(graph: dict[str, set[str]]) -> None:
    assert not circle_in(graph)


def test_no_circle_among_packages(graph: dict[str, set[str]]) -> None:
    parts: dict[str, set[str]] = {}
    for module, targets in graph.items():
        part = part_of(module)
        parts.setdefault(part, set()).update({part_of(target) for target in targets} - {part})
    assert not circle_in(parts)


def test_circles_behind_functions_and_names_are_found(tmp_path: Path) -> None:
    texts = {
        "a": "import petmjx.b",
        "b": "def late():\n    from petmjx import c",
        "c": "import importlib\nNAMES = {'d': 'petmjx.d'}",
        "d": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from petmjx.a import A",
        "e": "def late():\n    import pyarrow, petmjx.d",
    }
    (tmp_path / "petmjx").mkdir()
    for name, text in texts.items():
        (tmp_path / "petmjx" / f"{name}.py").write_text(text)
    graph = import_graph(tmp_path)
    assert circle_in(graph) == tuple(f"petmjx.{name}" for name in "abcda")
    graph["petmjx.d"].clear()
    assert circle_in(graph) == ()


def loaded_by(*statements: str) -> list[str]:
    """Lines "statement: simulators" with the simulators that are loaded after each statement. All statements run in the
    same new interpreter."""
    code = f"""
import sys
for statement in {statements!r}:
    exec(statement)
    if loaded := [name for name in {SIMULATORS!r} if name in sys.modules]:
        print(statement, loaded, sep=": ")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


def test_what_reads_results_loads_no_simulator() -> None:
    names = "import petmjx; petmjx.load_plans, petmjx.load_run, petmjx.compare_runs"
    engine = "import petmjx.engines.mujoco.engine"
    assert loaded_by(names, *(f"import {module}" for module in READERS), engine) == [f"{engine}: ['mujoco']"]


def test_a_process_of_searches_loads_neither_tables_nor_simulators() -> None:
    """Without tables and simulators, a process of searches starts in half a second."""
    code = f"import sys, petmjx.repairs.search_processes\nprint(*{{'pandas', *{SIMULATORS}}} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_the_command_does_not_wait_for_the_warp_of_mjx() -> None:
    """Warp can still be imported later, and MJX prints no message about it."""
    pytest.importorskip("warp", reason="warp-lang is not installed (extra: warp)")
    code = (
        "import sys\nfrom petmjx.common.processes import claim_process\nclaim_process()\n"
        "from petmjx.engines.mjx.mjx_import import mjx\nprint('warp' in sys.modules, mjx.step.__name__)\nimport warp"
    )
    command = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert command.stdout == "False step\n"


def test_public_names_are_there() -> None:
    import petmjx

    for name in petmjx.__all__:
        assert getattr(petmjx, name) is not None
    assert set(petmjx.__all__) <= set(dir(petmjx))
    with pytest.raises(AttributeError, match="no attribute 'scores'"):
        petmjx.scores  # noqa: B018


def test_old_names_warn() -> None:
    import petmjx

    with pytest.warns(FutureWarning, match=r"petmjx\.Told is now petmjx\.PlacementResults"):
        assert petmjx.Told is petmjx.PlacementResults


def test_old_attributes_warn() -> None:
    import pandas as pd

    import petmjx
    from petmjx.analysis.kpis import Kpis

    plans: dict[str, petmjx.Plan] = {}
    rating = Kpis(pd.DataFrame(), {}, (), (), plans, {})
    with pytest.warns(DeprecationWarning, match=r"Kpis\.found is now Kpis\.plans_by_id"):
        assert rating.found is plans
    pallets = petmjx.Pallets(2, engine="mujoco")
    with pytest.warns(DeprecationWarning, match=r"Pallets\.told is now Pallets\.results"):
        answer = pallets.told(1)
    assert answer.pallet.tolist() == [1]
    assert answer.verdict.tolist() == pallets.results(1).verdict.tolist()
    pallets.close()


def test_a_run_loads_pandas_only_while_its_engine_works(tmp_path: Path) -> None:
    code = (
        "import os, sys, petmjx\n"
        "class Engine:\n"
        "    name = 'mine'\n"
        "    def run(self, jobs, sim, progress=None):\n"
        "        os._exit('pandas' in sys.modules)\n"
        f"petmjx.score(engine=Engine(), out={str(tmp_path / 'out')!r})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "run.json").exists()
