"""How often Python looks for objects that refer to each other is petmjx's to say in processes of its own alone."""

from __future__ import annotations

import gc
import subprocess
import sys

import pytest

from petmjx.basics import garbage

OWN_PROCESS = """
import gc
from petmjx.basics.garbage import EVERY, collect_rarely, pass_over_what_is_there
collect_rarely()
assert gc.get_threshold() == EVERY
pass_over_what_is_there()
assert gc.get_freeze_count() > 1000
"""


def test_in_a_process_of_its_own_it_looks_rarely_and_passes_over_what_is_there() -> None:
    subprocess.run([sys.executable, "-c", OWN_PROCESS], check=True)


def test_in_a_users_process_it_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    before = gc.get_threshold()
    monkeypatch.setattr(gc, "freeze", lambda: pytest.fail("the user's objects"))
    garbage.pass_over_what_is_there()
    assert gc.get_threshold() == before
