"""Scripts, styles and templates of HTML pages: their syntax, their imports, and things that they must never contain.

``make check`` runs this file. The file takes the place of a linter of JavaScript, which would need npm. If Node is
installed, it parses the scripts; further rules are checked in Python. (The browser tests of pages run all scripts.)
"""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

STATIC = Path(__file__).resolve().parents[2] / "petmjx" / "show" / "pages" / "static"
FILES = sorted(STATIC.iterdir())
SCRIPTS = [path for path in FILES if path.suffix == ".js"]

FORBIDDEN = {
    "markup from strings": r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|createContextualFragment|setHTML",
    "code from strings": r"\beval\(|new Function|setTimeout\(\s*[\"']",
    "an address": r"https?:(?!//www\.w3\.org/2000/svg)|//cdn|url\((?!#)",
    "a request": r"\bfetch\(|XMLHttpRequest|WebSocket|EventSource|sendBeacon|import\(",
    "an event handler or style in markup, which the policy forbids": r"<[^>]+\s(?:on\w+|style)=",
    "a form of old": r"\bvar\s|[^=!]==[^=]|!=[^=]",
    "output for debugging": r"console\.|debugger",
    "the end of an element within": r"</(?:script|style)>(?!</?\w|\n?\Z|\n<)|<!--",
}
MOST_LINES = 400
LONGEST_LINE = 125
LONG_LINES = {"story.html"}
"""Files that may have long lines: an icon is a path in a single line."""

IMPORT = re.compile(r'^import (?:\{([^}]*)\}|\* as (\w+)) from "\./(\w+\.js)";$', flags=re.MULTILINE)
EXPORT = re.compile(r"^export (?:async function|function|const|class) (\w+)", flags=re.MULTILINE)


def by_name(path: Path) -> str:
    return path.name


@pytest.mark.parametrize("path", FILES, ids=by_name)
def test_nothing_forbidden(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    code = re.sub(r"^\s*//.*$", "", text, flags=re.MULTILINE) if path.suffix == ".js" else text
    matches = {why: match[0] for why, pattern in FORBIDDEN.items() if (match := re.search(pattern, code))}
    if path.name == "page.html":  # page.html is only the frame into which styles and scripts are put
        matches.pop("the end of an element within", None)
    assert not matches


@pytest.mark.parametrize("path", FILES, ids=by_name)
def test_files_are_small_and_tidy(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").split("\n")
    assert len(lines) <= MOST_LINES
    assert lines[-1] == "", "no line break at the end"
    untidy = [number for number, line in enumerate(lines, 1) if line != line.rstrip() or "\t" in line]
    too_long = [number for number, line in enumerate(lines, 1) if len(line) > LONGEST_LINE]
    assert not untidy
    assert not too_long or path.name in LONG_LINES


PARSE = """
const [fs, vm] = [require("node:fs"), require("node:vm")];
for (const path of process.argv.slice(1)) {
  new vm.SourceTextModule(fs.readFileSync(path, "utf-8"), { identifier: path });
  console.log(path);
}
"""
"""A program of Node that parses modules, and prints the path of each one that it could parse."""


def parsed(*paths: Path) -> subprocess.CompletedProcess[str]:
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    command = [node, "--no-warnings", "--experimental-vm-modules", "-e", PARSE, *map(str, paths)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_node_parses_them(tmp_path: Path) -> None:
    done = parsed(*SCRIPTS)
    assert done.stdout.splitlines() == [str(path) for path in SCRIPTS], done.stderr
    (broken := tmp_path / "broken.js").write_text("export const one = {;\n", encoding="utf-8")
    done = parsed(SCRIPTS[0], broken)
    assert done.stdout.splitlines() == [str(SCRIPTS[0])]
    assert f"{broken}:1" in done.stderr


@pytest.mark.parametrize("path", SCRIPTS, ids=by_name)
def test_imports_exist_and_are_used(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    rest = IMPORT.sub("", text)
    for names, alias, module in IMPORT.findall(text):
        exported = set(EXPORT.findall((STATIC / module).read_text(encoding="utf-8")))
        for name in filter(None, map(str.strip, names.split(","))):
            assert name in exported, f"{module} exports no {name}"
            assert re.search(rf"\b{name}\b", rest), f"{name} is not used"
        for name in re.findall(rf"\b{alias}\.(\w+)", rest) if alias else ():
            assert name in exported, f"{module} exports no {name}"


@pytest.mark.parametrize("path", SCRIPTS, ids=by_name)
def test_exports_are_used_somewhere(path: Path) -> None:
    others = "\n".join(other.read_text(encoding="utf-8") for other in SCRIPTS if other != path)
    text = path.read_text(encoding="utf-8")
    unused = [name for name in EXPORT.findall(text) if not re.search(rf"\b{name}\b", others)]
    assert not unused


def test_every_script_and_style_is_part_of_a_page(repository: Path) -> None:
    """Each script and style is named by another file of a page, or by Python code that makes pages."""
    sources = [*FILES, *(repository / "petmjx" / "show").rglob("*.py")]
    for path in FILES:
        named = [other for other in sources if other != path and path.name in other.read_text(encoding="utf-8")]
        assert named, f"nothing uses {path.name}"
