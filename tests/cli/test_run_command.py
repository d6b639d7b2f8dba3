"""Signals to a command that runs inside ``stoppable``."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from petmjx.cli.main import main
from petmjx.cli.run_command import stoppable
from petmjx.loop.placement_labels import Labeller


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    """Restore the signal handlers after a test. ``stoppable`` leaves its handlers in place after a signal, because a
    process is then about to end."""
    numbers = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
    before = {number: signal.getsignal(number) for number in numbers}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_comes_while_an_object_is_finalised_stops_the_body_after_that(number: signal.Signals) -> None:
    finalised = []

    class Finalised:
        def __del__(self) -> None:
            signal.raise_signal(number)
            time.sleep(0)  # here Python runs the signal handler
            finalised.append(self.__class__)

    def wait_for_the_end() -> None:
        with stoppable():
            Finalised()
            assert finalised == [Finalised]
            time.sleep(5)

    with pytest.raises(KeyboardInterrupt):
        wait_for_the_end()


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, 130)])
def test_a_command_that_is_stopped_leaves_no_hidden_files(
    number: signal.Signals,
    code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A signal ends any command, also one without a run, such as ``label``, whose folder is locked at that time."""

    def episodes(self: Labeller, *arguments: object) -> Iterator[object]:
        assert [*tmp_path.glob("labels/.*")]
        signal.raise_signal(number)
        time.sleep(5)
        yield []

    monkeypatch.setattr(Labeller, "episodes", episodes)
    arguments = ["label", "-n", "9", "-o", str(tmp_path / "labels"), "--engine", "mujoco", "--pallets", "1"]
    assert main(arguments) == code
    assert capsys.readouterr().err == "petmjx: interrupted: nothing was written\n"
    assert not [*tmp_path.iterdir()]
