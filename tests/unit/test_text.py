"""Texts in the form in which messages show them."""

from __future__ import annotations

import pytest

from petmjx.common.text import count_text, duration, is_text, one_line, printable, printable_name, rounded_text


def test_nouns_follow_their_number() -> None:
    assert [count_text(n, "plan") for n in (0, 1, 2, 2000)] == ["0 plans", "1 plan", "2 plans", "2,000 plans"]
    assert [count_text(n, "box", "boxes") for n in (1, 3)] == ["1 box", "3 boxes"]


def test_names_from_files_are_printable_and_short() -> None:
    assert printable("plän €") == "plän €"
    assert printable("a\nb\ud800") == "a\\nb\\ud800"
    assert printable_name("x" * 60) == "x" * 60
    assert printable_name("x" * 61) == "x" * 60 + "…"
    assert [is_text(text) for text in ("plain", "plän", "\ud800")] == [True, True, False]
    assert one_line(ValueError("two\n  lines")) == "ValueError: two lines"


@pytest.mark.parametrize(
    ("count", "text"), [(7.4, "7"), (136_400, "136 thousand"), (2.5e6, "2.5 million"), (3e9, "3 billion")]
)
def test_large_numbers_have_three_digits(count: float, text: str) -> None:
    assert rounded_text(count) == text


@pytest.mark.parametrize(("seconds", "text"), [(0.2, "1 s"), (89, "89 s"), (600, "10 min"), (9000, "2.5 h")])
def test_times_to_wait(seconds: float, text: str) -> None:
    assert duration(seconds) == text
