"""The package as an index and its readers get it: one version, one address, and links that work outside the
repository."""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from petmjx.cli import main

REPOSITORY = Path(__file__).resolve().parents[2]
PROJECT: dict[str, Any] = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
ADDRESS: str = PROJECT["project"]["urls"]["Repository"]

ADDRESSED = ("CITATION.cff", "README.md", "SECURITY.md", "mkdocs.yml", "pyproject.toml")
"""Files that contain the address of the repository."""


def text_of(name: str) -> str:
    return (REPOSITORY / name).read_text(encoding="utf-8")


def test_the_repository_has_one_address() -> None:
    owned = re.compile(r"https?://[\w.]+/petmjx(?:/petmjx)?\b")
    for name in ADDRESSED:
        addresses = set(owned.findall(text_of(name)))
        assert addresses == {ADDRESS}, name
    assert all(url.startswith(ADDRESS) for url in PROJECT["project"]["urls"].values())


def test_a_checkout_without_tags_has_the_version_of_the_fallback() -> None:
    fallback = PROJECT["tool"]["hatch"]["version"]["fallback-version"]
    assert f'__version__ = "{fallback}"' in text_of("petmjx/version.py")


def test_the_long_description_has_no_relative_links() -> None:
    text = text_of("README.md")
    pictures = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text)
    for substitution in PROJECT["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]["substitutions"]:
        text = re.sub(substitution["pattern"], substitution["replacement"], text)
    targets = re.findall(r"\]\(([^)]+)\)", text)
    assert targets
    assert not [target for target in targets if not target.startswith(("https://", "#"))]
    for picture in pictures:
        assert f"({ADDRESS}/raw/HEAD/{picture})" in text


def test_the_public_workflow_tests_what_the_package_claims() -> None:
    claimed = {line.rpartition(" ")[2] for line in PROJECT["project"]["classifiers"] if "Python :: 3." in line}
    workflow = text_of(".github/workflows/ci.yml")
    (matrix,) = re.findall(r"python: \[(.*)\]", workflow)
    assert set(re.findall(r"[\d.]+", matrix)) == claimed
    assert "run: .ci/run" in workflow


def test_the_citation_names_what_the_package_does() -> None:
    citation = text_of("CITATION.cff")
    assert f"license: {PROJECT['project']['license']}\n" in citation
    assert f"abstract: {PROJECT['project']['description']}\n" in citation
    for author in PROJECT["project"]["authors"]:
        assert f"- name: {author['name']}\n" in citation


@pytest.mark.parametrize(
    ("shell", "typed"),
    [
        ("bash", {"COMP_WORDS": "petmjx score --sched", "COMP_CWORD": "2"}),
        ("zsh", {"_TYPER_COMPLETE_ARGS": "petmjx score --sched"}),
        ("fish", {"_TYPER_COMPLETE_ARGS": "petmjx score --sched", "_TYPER_COMPLETE_FISH_ACTION": "get-args"}),
    ],
)
def test_shells_complete_options(
    shell: str, typed: dict[str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["petmjx"])
    # as if petmjx ran as a script; otherwise its name would be "python -m …"
    monkeypatch.setattr(sys.modules["__main__"], "__package__", None)
    for name, value in ({"_PETMJX_COMPLETE": f"complete_{shell}"} | typed).items():
        monkeypatch.setenv(name, value)
    assert main([]) == 0
    printed = capsys.readouterr().out
    assert "--schedule" in printed
    assert "--shard" not in printed
