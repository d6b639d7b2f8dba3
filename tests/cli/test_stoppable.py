"""Signals to a command whose body can be stopped."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator

import pytest

from petmjx.cli.run_command import stoppable


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    """A body that was stopped keeps its handlers, since the process is about to end."""
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
            time.sleep(0)  # where Python runs its handler
            finalised.append(self.__class__)

    def wait_for_the_end() -> None:
        with stoppable():
            Finalised()
            assert finalised == [Finalised]
            time.sleep(5)

    with pytest.raises(KeyboardInterrupt):
        wait_for_the_end()
