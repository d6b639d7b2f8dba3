"""Tests of the folder for compiled programs. petmjx finds a folder even if the home folder cannot be used. If there is
no folder at all, ``auto`` chooses an engine that compiles nothing."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from petmjx.common import compile_caches
from petmjx.common.compile_caches import VARIABLES, cache_folder, temporary_folder, why_no_folder, why_not_written
from petmjx.common.errors import EngineUnavailable
from petmjx.common.machine import why_no_warp_on_cpu
from petmjx.engines.engine_choice import choose
from petmjx.show.doctor_report import _cache


@pytest.fixture(autouse=True)
def fresh(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """No folder has been chosen yet, and temporary folders are below ``tmp_path``."""
    for name in ("PETMJX_CACHE_DIR", *VARIABLES.values()):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for cached in (compile_caches._why_unusable, temporary_folder):
        cached.cache_clear()
    yield
    for cached in (compile_caches._why_unusable, temporary_folder):
        cached.cache_clear()


def test_the_folder_that_is_asked_for_is_made(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert cache_folder("warp") == tmp_path / "home/.cache/petmjx/warp"
    assert cache_folder("warp").is_dir()
    monkeypatch.setenv("PETMJX_CACHE_DIR", str(tmp_path / "named"))
    assert cache_folder("jax") == tmp_path / "named/jax"
    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path / "of warp"))
    assert cache_folder("warp") == tmp_path / "of warp"
    assert why_not_written("warp") == ""
    assert why_no_folder("warp") is None


def unwritable(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Make the folder for compiled programs impossible to write, even for root. Returns the expected message."""
    if kind == "a file":
        (tmp_path / "home").write_text("")
        return "home/.cache/petmjx/warp cannot be written: Not a directory"
    if kind == "a named file":
        (tmp_path / "file").write_text("")
        monkeypatch.setenv("PETMJX_CACHE_DIR", str(tmp_path / "file"))
        return "file/warp cannot be written: Not a directory"
    if kind == "Warp's own":
        monkeypatch.setenv("WARP_CACHE_PATH", "/proc/none")
        return "/proc/none cannot be written: "
    if kind == "read-only":
        monkeypatch.setenv("HOME", "/proc")
        return "/proc/.cache/petmjx/warp cannot be written: "
    if kind == "a folder of a version":  # as if root had made the folder, so that the user cannot write into it
        made = tmp_path / "home/.cache/petmjx/warp/1.9.0"
        made.mkdir(parents=True)
        real = tempfile.TemporaryFile

        def refuse(dir: Path) -> object:  # the name of the argument is that in tempfile
            if dir == made:
                raise PermissionError(13, "Permission denied")
            return real(dir=dir)

        monkeypatch.setattr(compile_caches.tempfile, "TemporaryFile", refuse)
        return "warp cannot be written: Permission denied"
    monkeypatch.setattr(Path, "home", _no_home)
    return "no home folder: Could not determine home directory."


def _no_home() -> Path:
    raise RuntimeError("Could not determine home directory.")


KINDS = ("a file", "a named file", "Warp's own", "read-only", "a folder of a version", "no home")


@pytest.mark.parametrize("kind", KINDS)
def test_else_a_temporary_one_takes_its_place_and_doctor_says_why(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reason = unwritable(kind, tmp_path, monkeypatch)
    folder = tmp_path / "temporary" / f"petmjx-cache-{os.getuid()}"
    assert cache_folder("warp") == folder / "warp"
    assert folder.stat().st_mode & 0o777 == 0o700
    assert reason in why_not_written("warp")
    assert why_no_folder("warp") is None
    line = _cache("warp")
    assert line.startswith(f"{folder / 'warp'} (since ")
    assert reason in line


@pytest.mark.parametrize("kind", ["link", "writable by others", "file"])
def test_a_temporary_folder_of_others_is_not_taken(kind: str, tmp_path: Path) -> None:
    """A temporary folder is not used if other users can write into it: they could replace the compiled programs that
    petmjx runs."""
    folder = tmp_path / "temporary" / f"petmjx-cache-{os.getuid()}"
    if kind == "link":
        (tmp_path / "elsewhere").mkdir()
        folder.symlink_to(tmp_path / "elsewhere")
    elif kind == "file":
        folder.write_text("")
    else:
        folder.mkdir()
        folder.chmod(0o777)
    chosen_folder = temporary_folder()
    assert chosen_folder != folder
    assert chosen_folder.parent == folder.parent
    assert chosen_folder.stat().st_mode & 0o777 == 0o700


def test_without_any_folder_auto_takes_mujoco_and_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "home").write_text("")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "nowhere"))
    why = why_no_folder("warp")
    assert why is not None
    assert why.startswith("no folder for compiled programs: ")
    assert "home/.cache/petmjx/warp cannot be written: Not a directory, and no temporary one" in why
    assert why.endswith("; set PETMJX_CACHE_DIR")
    assert why_no_warp_on_cpu() == why
    with pytest.raises(EngineUnavailable, match="no folder for compiled programs"):
        cache_folder("jax")
    engine, reason = choose({"mujoco": 9.0, "mjx-warp-cpu": 1.0, "mjx-warp": 99.0}, 1, why_no_gpu=lambda: "no GPU")
    assert engine == "mujoco"
    assert reason == f"mjx-warp-cpu would be faster but cannot run: {why}"
    assert _cache("warp") == why
