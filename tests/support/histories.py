"""Compares histories and stories with one another and with the tables of a run. The module also has an engine without
histories."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace

import numpy as np
import pandas as pd

import petmjx
from petmjx.engines.mujoco.engine import MujocoEngine
from petmjx.engines.protocol import Progress
from petmjx.engines.verdict import Outcome
from petmjx.options.simulation import Simulation
from petmjx.world.history import Contacts, History
from petmjx.world.job import Job


def history_of(outcome: Outcome) -> History:
    assert outcome.history is not None
    return outcome.history


def assert_equal(one: History | Contacts, other: History | Contacts) -> None:
    """Check that two histories are equal to the last bit."""
    for field in fields(one):
        values, others = getattr(one, field.name), getattr(other, field.name)
        if isinstance(values, Contacts):
            assert_equal(values, others)
        else:
            np.testing.assert_array_equal(values, others, err_msg=field.name)


def assert_tells(story: petmjx.Story, run: petmjx.RunResults) -> None:
    """Check that a story has the same values as the tables of the run."""
    worlds, boxes = (
        table[(table["plan_id"] == story.plan.plan_id) & (table["variant"] == story.variant)]
        for table in (run.worlds, run.boxes)
    )
    (row,) = worlds.to_dict("records")
    outcome, k = story.outcome, story.outcome.n_placed
    assert (outcome.verdict, outcome.reason) == (row["verdict"], row["reason"])
    assert outcome.culprit == (-1 if pd.isna(row["culprit"]) else row["culprit"])
    np.testing.assert_equal(outcome.first_sign_s, row["first_sign_s"])
    assert (outcome.n_steps, outcome.n_placed, outcome.attempt) == (row["n_steps"], row["n_placed"], row["attempt"])
    places = boxes[["pos_x_m", "pos_y_m", "pos_z_m"]].to_numpy()
    np.testing.assert_array_equal(story.history.pos[-1, :k].astype(np.float32), places[:k])
    np.testing.assert_array_equal(story.history.pos[-1, :k], outcome.boxes.pos[:k])
    assert story.history.time_s[-1] == row["sim_time_s"]


class Forgetful(MujocoEngine):
    """An engine that never records histories."""

    name = "forgetful"

    def run(self, jobs: Sequence[Job], sim: Simulation, progress: Progress | None = None) -> Iterator[Outcome]:
        return super().run([replace(job, record=None) for job in jobs], sim, progress)
