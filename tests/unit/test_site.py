"""The documentation site, as far as it can be tested without the packages that build it (`make docs` tests the rest,
with --strict)."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import petmjx
from petmjx.cli.main import application
from petmjx.options.confidence import Confidence
from petmjx.options.physics import Physics
from petmjx.options.quiet import Quiet
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.options.thresholds import Thresholds
from tools import reference

REPOSITORY = Path(__file__).resolve().parents[2]
SETTINGS = (REPOSITORY / "mkdocs.yml").read_text(encoding="utf-8")


def test_every_page_is_in_the_navigation_once() -> None:
    named = re.findall(r"[\w./-]+\.md$", SETTINGS.partition("\nnav:\n")[2], flags=re.MULTILINE)
    inside = {str(path.relative_to(REPOSITORY / "docs")) for path in (REPOSITORY / "docs").rglob("*.md")}
    outside = {name for name in named if name not in inside}
    assert len(named) == len(set(named))
    assert inside <= set(named)
    assert {name for name in outside if not (REPOSITORY / name).is_file()} == set()


def test_the_reference_of_python_has_every_public_name() -> None:
    page = (REPOSITORY / "docs" / "reference" / "python.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^::: petmjx\.(\w+)$", page, flags=re.MULTILINE)) == set(petmjx.__all__) - {"__version__"}


def test_the_reference_of_options_has_every_field_and_its_anchors() -> None:
    text = reference.options()
    for record in (Simulation, Physics, Thresholds, Quiet, Confidence, RunOptions):
        for name in record.model_fields:
            assert f"| `{name}`<br>" in text
    headings = {line[3:].lower().replace(" ", "-") for line in text.splitlines() if line.startswith("## ")}
    assert set(re.findall(r"\(#([\w-]+)\)", text)) <= headings
    assert "| `schedule`<br>`--schedule` | `adaptive` | When the next box is placed" in text
    assert "| `timestep_s`<br>`--set physics.timestep_s=…` | `0.002` |" in text


def test_the_reference_of_commands_has_every_command() -> None:
    text = reference.commands()
    for command in application().registered_commands:
        assert f"## petmjx {command.name}\n" in text
        assert f"Usage: petmjx {command.name} " in text
    assert "--longest-wait S" in text


def test_the_site_asks_nothing_of_servers() -> None:
    assert "font: false" in SETTINGS
    assert "repo_url" not in SETTINGS, "the theme would ask for a repository's stars"
    for name in ("site.css", "search-offline.js"):
        assert "://" not in (REPOSITORY / "docs" / name).read_text(encoding="utf-8")


def test_links_lead_to_pages_or_to_the_repository() -> None:
    hooks = pytest.importorskip("tools.site_hooks", reason="the site's packages are not installed (extra: docs)")

    def link(text: str, source: str, uri: str) -> str:
        return str(hooks.LINK.sub(lambda match: hooks.relinked(match, source, uri, "https://repository"), text))

    assert link("[rules.md](rules.md#x)", "docs/metrics.md", "metrics.md") == "[The rules of a run](rules.md#x)"
    assert link("[it](docs/sweeps.md)", "CHANGELOG.md", "CHANGELOG.md") == "[it](sweeps.md)"
    assert link("[a](../loads.md)", "docs/tutorials/see.md", "tutorials/see.md") == "[a](../loads.md)"
    assert link("[b](../benchmarks/README.md)", "docs/rules.md", "rules.md") == "[b](benchmarks/README.md)"
    away = link("[c](../petmjx/common/units.py) [d](results)", "benchmarks/README.md", "benchmarks/README.md")
    assert (
        away
        == "[c](https://repository/blob/HEAD/petmjx/common/units.py) [d](https://repository/tree/HEAD/benchmarks/results)"
    )
    assert hooks.outside_code("`[e](x)` [f](y)", str.upper) == "`[e](x)` [F](Y)"
