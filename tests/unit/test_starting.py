"""A GPU starts while plans are read, where one will be used, and whatever goes wrong there is told by who needs it."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from petmjx.basics.errors import InputError
from petmjx.engines import resolve
from petmjx.engines.resolve import starting
from petmjx.options.run_options import RunOptions


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Is set where a GPU is started."""
    event = threading.Event()
    monkeypatch.setattr(resolve, "cuda_devices", lambda: ("a GPU",))
    monkeypatch.setattr(resolve, "_start_gpu", event.set)
    return event


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"engine": "mjx-warp"}, True),
        ({"engine": "auto"}, True),
        ({"engine": "mujoco"}, False),
        ({"engine": "mjx-warp", "workers": 2}, False),
    ],
)
def test_it_starts_where_it_will_be_the_engine(
    options: dict[str, object], expected: bool, started: threading.Event, tmp_path: Path
) -> None:
    (tmp_path / "plans.json").write_bytes(b" " * (resolve.WORTH_A_GPU))
    for plans in (tmp_path, [tmp_path / "plans.json"]):
        started.clear()
        with starting(RunOptions(**options), plans):
            pass
        assert started.is_set() is expected


def test_auto_starts_none_for_few_plans_or_without_one(
    started: threading.Event, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "plans.json").write_text("{}")
    for plans in (tmp_path / "plans.json", tmp_path / "missing", None, 3, "\0"):
        with starting(RunOptions(), plans):
            pass
    monkeypatch.setattr(resolve, "cuda_devices", lambda: ())
    with starting(RunOptions(engine="mjx-warp"), tmp_path):
        pass
    assert not started.is_set()


def test_what_is_wrong_with_plans_is_not_held_up(monkeypatch: pytest.MonkeyPatch) -> None:
    released = threading.Event()
    monkeypatch.setattr(resolve, "cuda_devices", lambda: ("a GPU",))
    monkeypatch.setattr(resolve, "_start_gpu", released.wait)
    with pytest.raises(InputError, match="no such"), starting(RunOptions(engine="mjx-warp"), None):
        raise InputError("no such file")
    released.set()


def test_a_gpu_that_does_not_start_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resolve, "cuda_devices", lambda: ("a GPU",))
    monkeypatch.setattr(resolve.importlib, "import_module", lambda name: 1 / 0)
    with starting(RunOptions(engine="mjx-warp"), None):
        pass
