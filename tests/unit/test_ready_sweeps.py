"""Ready-made sweep files are found from a checkout and, as the wheel lays them out, from an installed package."""

from __future__ import annotations

from pathlib import Path

import pytest

from petmjx.common.errors import InputError
from petmjx.runs import ready_sweeps as readymade
from petmjx.runs.ready_sweeps import find_sweep, ready_sweeps


def test_every_sweep_of_the_checkout_is_ready_made(repository: Path) -> None:
    assert {path.name for path in ready_sweeps().values()} == {
        path.name for path in (repository / "sweeps").glob("*.toml")
    }
    assert find_sweep("eumos") == repository / "sweeps" / "eumos.toml"


def test_a_path_comes_before_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "eumos"
    file.write_text("")
    monkeypatch.chdir(tmp_path)
    assert find_sweep("eumos").resolve() == file


def test_an_installed_package_has_its_own_copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "ready_sweeps").mkdir()
    (tmp_path / "ready_sweeps" / "push.toml").write_text("")
    monkeypatch.setattr(readymade, "_FOLDERS", (tmp_path / "ready_sweeps", tmp_path / "sweeps"))
    assert list(ready_sweeps()) == ["push"]
    with pytest.raises(InputError, match="no such sweep file; ready-made sweeps are push"):
        find_sweep("pull")
