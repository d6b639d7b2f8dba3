"""The records of options: checks of values, presets, changes, and that options are the same after they were written as
JSON."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest

from petmjx import PHYSICS, Check, Cone, Physics, Quiet, RunOptions, Schedule, Simulation, Thresholds
from petmjx.common.checked_records import CheckedRecord
from petmjx.common.errors import InputError
from petmjx.options.sorted_options import sorted_options


@pytest.mark.parametrize(
    ("record", "values", "line"),
    [
        (Physics, {"gravity_m_s2": -9.81}, "gravity_m_s2 must be > 0, got -9.81"),
        (Physics, {"timestep_s": 0}, "timestep_s must be > 0, got 0"),
        (Physics, {"timestep_s": 0.1}, "timestep_s must be from 0.0001 to 0.02, got 0.1"),
        (Physics, {"box_friction": (-1, 0, 0)}, "box_friction must be ≥ 0, got (-1.0, 0.0, 0.0)"),
        (Physics, {"box_friction": -1}, "box_friction must be a list, got -1"),
        (
            Physics,
            {"solimp": (1.5, 0.9, 0.01)},
            "solimp must be two impedances between 0 and 1 and a width > 0 m, got (1.5, 0.9, 0.01)",
        ),
        (Thresholds, {"shift_m": 0}, "shift_m must be > 0, got 0"),
        (Quiet, {"steps": 0}, "steps must be ≥ 1, got 0"),
        (Simulation, {"physics": "moon"}, "physics must be pallet or reference, or a table of values, got 'moon'"),
        (Simulation, {"physics": "custom"}, "physics must be pallet or reference, or a table of values, got 'custom'"),
        (Simulation, {"physics": {"gravity_m_s2": -9.81}}, "physics.gravity_m_s2 must be > 0, got -9.81"),
        (Simulation, {"thresholds": {"shift": 1}}, "thresholds.shift: unknown field; did you mean shift_m?"),
        (Simulation, {"interval_s": -1.0}, "interval_s must be > 0, got -1.0"),
        (Simulation, {"interval_s": 0.001}, "interval_s must be at least the timestep of 0.002 s, got 0.001"),
        (Simulation, {"duration_s": math.inf}, "duration_s must be a finite number, got inf"),
        (Simulation, {"check": "dynamic"}, "check must be 'one-by-one' or 'static', got 'dynamic'"),
        (Simulation, {"schedule": "slow"}, "schedule must be 'fixed' or 'adaptive', got 'slow'"),
        (
            Simulation,
            {"schedule": "brisk"},
            "schedule must be 'fixed' or 'adaptive': 'brisk' was removed, since 'adaptive' now takes as few steps",
        ),
        (Simulation, {"total_time_factor": 2.0}, "total_time_factor needs check='one-by-one' and schedule='fixed'"),
        (
            Simulation,
            {"schedule": "fixed", "total_time_factor": 2.0, "rest_s": 3.0},
            "rest_s contradicts total_time_factor: drop one of them",
        ),
        (RunOptions, {"lanes": 0}, "lanes must be ≥ 1, got 0"),
    ],
)
def test_a_bad_value_is_one_line(record: type[CheckedRecord], values: dict[str, Any], line: str) -> None:
    with pytest.raises(InputError) as constructed:
        record(**values)
    assert str(constructed.value) == line
    with pytest.raises(InputError) as read:
        record.read(values)
    assert str(read.value) == line


def test_an_error_names_the_place_that_was_read() -> None:
    with pytest.raises(InputError, match=r"^physics\.timestep_s must be > 0, got 0$"):
        Simulation.read({"physics": {"timestep_s": 0}})


def test_an_interval_may_be_as_short_as_the_timestep() -> None:
    assert Simulation(interval_s=0.001, physics={"timestep_s": 0.001}).interval_s == 0.001


def test_options_are_sorted_by_record_and_unknown_ones_refused_with_a_hint() -> None:
    of_simulation, of_run = sorted_options({"schedule": "fixed", "threads": 2, "check": "static"})
    assert of_simulation == {"schedule": "fixed", "check": "static"}
    assert of_run == {"threads": 2}
    with pytest.raises(InputError, match=r"^unknown option intervall_s; did you mean interval_s\?$"):
        sorted_options({"intervall_s": 1.0})
    with pytest.raises(InputError, match=r"^unknown option xyz; there are check, schedule, .*, overwrite, "):
        sorted_options({"xyz": 1})
    inside = r"^unknown option tilt_deg; it is a field of thresholds: thresholds=\{'tilt_deg': …\}$"
    with pytest.raises(InputError, match=inside):
        sorted_options({"tilt_deg": 15})
    with pytest.raises(InputError, match=r"^unknown option wrap_turns; it is a field of wrap: wrap=\{'turns': …\}$"):
        sorted_options({"wrap_turns": 4})
    assert not set(Simulation.model_fields) & set(RunOptions.model_fields)


def test_records_cannot_be_changed_in_place() -> None:
    with pytest.raises(ValueError, match="frozen"):
        Simulation().interval_s = 1.0  # type: ignore[misc]  # the assignment is what is tested


@pytest.mark.parametrize("name", list(PHYSICS))
def test_presets_by_name(name: str) -> None:
    assert Simulation(physics=name).physics == Physics(name=name) == PHYSICS[name]
    assert PHYSICS[name].name == name


def test_a_changed_preset_loses_its_name() -> None:
    fine = Physics.read({"name": "reference", "timestep_s": 0.001})
    assert (fine.name, fine.cone, fine.carrier_friction[0]) == ("custom", Cone.PYRAMIDAL, 3.0)
    assert fine.changed(timestep_s=0.002).name == "reference"
    assert Physics(timestep_s=0.001).cone is PHYSICS["pallet"].cone
    values = PHYSICS["reference"].model_dump(exclude={"name"})
    assert Physics(**values).name == "reference"
    assert Physics(**values | {"impratio": 2.0}).name == "custom"


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"physics": "reference", "check": "static"},
        {"physics": {"name": "reference", "timestep_s": 0.001}, "thresholds": {"shift_m": 0.03}, "solver": "cg"},
        {"schedule": "fixed", "total_time_factor": 2.5, "quiet": {"steps": 40}, "solver_tolerance": 1e-9},
    ],
)
def test_a_simulation_written_as_json_is_read_as_it_was(options: dict[str, Any]) -> None:
    sim = Simulation(**options)
    again = Simulation.read(json.loads(json.dumps(sim.model_dump(mode="json"))))
    assert again == sim
    assert again.physics.name == sim.physics.name


def test_changes_keep_what_they_do_not_name() -> None:
    sim = Simulation(physics="reference", thresholds={"shift_m": 0.03}, interval_s=0.5)
    changed = sim.changed(schedule="fixed", thresholds={"tilt_deg": 15}, physics={"timestep_s": 0.001})
    assert (changed.schedule, changed.interval_s, changed.check) == (Schedule.FIXED, 0.5, Check.ONE_BY_ONE)
    assert changed.thresholds == Thresholds(shift_m=0.03, tilt_deg=15)
    assert changed.physics == PHYSICS["reference"].changed(timestep_s=0.001)
    # a table that names a preset, or a record, replaces all fields
    assert sim.changed(physics={"name": "pallet", "timestep_s": 0.001}).physics == Physics(timestep_s=0.001)
    assert sim.changed(thresholds=Thresholds(tilt_deg=15)).thresholds == Thresholds(tilt_deg=15)
    assert sim == Simulation(physics="reference", thresholds={"shift_m": 0.03}, interval_s=0.5)


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"interval_s": -1}, "interval_s must be > 0, got -1"),
        ({"physics": {"timestep_s": 0.01}, "interval_s": 0.005}, "interval_s must be at least the timestep of 0.01 s"),
        ({"speed": 2}, "speed: unknown field"),
        ({"thresholds": {"shift_m": -2}}, "thresholds.shift_m must be > 0, got -2"),
    ],
)
def test_changes_are_checked(changes: dict[str, Any], line: str) -> None:
    with pytest.raises(InputError) as caught:
        Simulation().changed(**changes)
    assert line in str(caught.value)


def test_rest_is_waited_for_with_elliptic_cones_only() -> None:
    assert Simulation().waits_for_rest
    assert Simulation(schedule="fixed").waits_for_rest
    assert not Simulation(physics="reference").waits_for_rest
