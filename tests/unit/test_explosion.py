"""The explosion rule: large accelerations must last, and two boxes that land one after the other do not explode."""

from __future__ import annotations

import pytest

from petmjx.engines.mujoco.explosion import Explosion

LANDING = 50
"""Steps that a box needs to land."""


@pytest.mark.parametrize(
    ("samples", "explodes"),
    [
        # (step, step of the last placement, whether an acceleration is above its threshold)
        pytest.param([(100, 0, True), (200, 0, True)], True, id="lasts"),
        pytest.param([(100, 0, True)], False, id="one sample"),
        pytest.param([(100, 0, True), (200, 0, False), (300, 0, True)], False, id="two strikes"),
        pytest.param([(100, 0, True), (200, 180, False), (300, 180, True)], False, id="two boxes that land"),
        pytest.param([(100, 0, True), (200, 180, True), (300, 180, True)], True, id="lasts beyond a placement"),
        pytest.param([(100, 90, True), (125, 90, True), (150, 90, True)], False, id="soon after a placement"),
    ],
)
def test_only_accelerations_that_last_are_an_explosion(samples: list[tuple[int, int, bool]], explodes: bool) -> None:
    rule = Explosion(LANDING)
    assert [rule.seen(*sample) for sample in samples][-1] == explodes
