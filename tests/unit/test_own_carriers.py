"""Carriers that users define: TOML files of boards, carriers that are refused, and runs that store the boards
themselves."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.command_line import only_line, run, write
from support.plans import make_plan
from support.sound_files import own_carrier

import petmjx
from petmjx.common.errors import InputError
from petmjx.options.carriers import MOST_BOARDS, OwnCarrier, read_carrier
from petmjx.options.physics import PHYSICS
from petmjx.options.simulation import Simulation
from petmjx.options.walls import Side
from petmjx.world.carrier_boards import floor_z_m
from petmjx.world.option_lint import notes_about
from petmjx.world.scene import build_scene

pytestmark = pytest.mark.usefixtures("in_tmp_path")

FILE = Path("mine.toml")
SOUND = own_carrier()
PLAN = make_plan("a", 2)

LOW_BOARD = """
[[boards]]
corner_mm = [100, 400, 113]
size_mm = [50, 50, 22]
mass_kg = 0.1

[[boards]]
corner_mm = [100, 400, 0]
size_mm = [50, 50, 113]
mass_kg = 0.5
"""


def scaled(factor: float) -> Callable[[str], str]:
    """A function that multiplies all lengths in a carrier's file by a factor, as if they were given in another unit."""
    return lambda text: re.sub(
        r"\[(?=\d).*?\]", lambda match: str([value * factor for value in json.loads(match[0])]), text
    )


def changed(old: str, new: str, count: int = 1) -> Callable[[str], str]:
    return lambda text: text.replace(old, new, count)


def test_a_sound_file_is_a_carrier() -> None:
    write(FILE, SOUND)
    carrier = read_carrier(FILE)
    assert carrier.name == "half pallet"
    assert carrier.size_mm == (800, 600, 144)
    assert carrier.frictions == (0.4, 0.3, 0.4, 0.4, 0.4)
    sim = Simulation(carrier="mine.toml")
    assert sim.carrier == carrier == Simulation(carrier=FILE).carrier
    assert Simulation(carrier=tomllib.loads(SOUND)).carrier == carrier
    assert Simulation.read(json.loads(json.dumps(sim.model_dump(mode="json")))) == sim
    body = build_scene(PLAN, sim).carrier
    assert body.mass == pytest.approx(10.9)
    assert floor_z_m(sim) == -0.144
    np.testing.assert_allclose([body.low, body.high], [[0, 0, -0.144], [0.8, 0.6, 0.0]], atol=1e-12)
    np.testing.assert_allclose(body.friction[:, 0], carrier.frictions)


def test_one_mass_is_shared_out_by_volume_and_a_file_has_its_name() -> None:
    text = re.sub(r"mass_kg = .*\n", "", SOUND).replace('name = "half pallet"', "mass_kg = 12")
    carrier = read_carrier(write(FILE, text))
    assert carrier.name == "mine"
    volumes = [board.volume_mm3 for board in carrier.boards]
    assert carrier.masses_kg == pytest.approx([12 * volume / sum(volumes) for volume in volumes])


def test_a_file_may_have_walls_and_options_change_them() -> None:
    write(FILE, SOUND + '\n[walls]\nsides = ["left", "back"]\nheight_mm = 700\n')
    own = build_scene(PLAN, Simulation(carrier=FILE)).carrier
    assert own.walls == (Side.LEFT, Side.BACK)
    assert own.room.top[0, 0] == pytest.approx(0.7)
    opened = build_scene(PLAN, Simulation(carrier=FILE, walls={"open": ["left"]})).carrier
    assert opened.walls == (Side.BACK,)
    others = build_scene(PLAN, Simulation(carrier=FILE, walls=["right"])).carrier
    assert others.walls == (Side.RIGHT,)
    assert others.room.top[1, 0] == pytest.approx(0.7)
    assert build_scene(PLAN, Simulation(carrier=FILE, walls=[])).carrier.walls == ()
    write(FILE, SOUND + '\n[walls]\nsides = ["top"]\n')
    with pytest.raises(
        InputError, match=r"mine.toml: walls.sides\[0\] must be 'left', 'right', 'front' or 'back', got"
    ):
        read_carrier(FILE)
    write(FILE, SOUND + '\n[walls]\nsides = ["left"]\nopen = ["back"]\n')
    with pytest.raises(
        InputError, match=r"^mine.toml: walls.open\[0\] is back, but the carrier has no wall on this side$"
    ):
        read_carrier(FILE)


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (changed("[0, 0, 122]", "[0, 0, -1]"), "boards[0].corner_mm[2] must be ≥ 0, got -1"),
        (changed("size_mm = [800, 145, 22]", "size_mm = [800, 145]"), "boards[0].size_mm[2] is missing"),
        (changed("[800, 145, 22]", "[800, nan, 22]"), "boards[0].size_mm[1] must be a finite number, got nan"),
        (changed(" 22]", " 0]"), "boards[0].size_mm[2] must be ≥ 0.001, got 0"),
        (changed("mass_kg = 1.3", 'mass_kg = "1"'), "boards[0].mass_kg must be a finite number, got '1'"),
        (changed("mass_kg = 1.3", "mass_kg = true"), "boards[0].mass_kg must be a finite number, got True"),
        (
            changed("mass_kg = 1.3\n", ""),
            "boards[0].mass_kg is missing: give a mass to each board, or give the carrier's mass_kg",
        ),
        (
            changed("friction = 0.4", "mass_kg = 12"),
            "boards[0].mass_kg contradicts the carrier's mass_kg: drop one of them",
        ),
        (changed("friction = 0.3", "friction = -0.3"), "boards[1].friction must be ≥ 0, got -0.3"),
        (changed("corner_mm", "corner"), "boards[0].corner: unknown field; did you mean corner_mm?"),
        (changed("[[boards]]", "[[board]]", 9), "board: unknown field; did you mean boards?"),
        (
            lambda text: text.partition("[[boards]]")[0],
            "boards is missing: one table [[boards]] for each board, with corner_mm, size_mm and mass_kg",
        ),
        (
            lambda text: text + text[text.rindex("[[boards]]") :] * MOST_BOARDS,
            f"boards must have at most {MOST_BOARDS} entries, got",
        ),
        (scaled(0.001), "the boards together are 0.8 × 0.6 × 0.144 mm: is that in metres? Lengths are in mm"),
        (scaled(0.1), "the boards together are 80 × 60 × 14.4 mm: is that in inches or centimetres? Lengths are in mm"),
        (scaled(1 / 25.4), "mm: is that in inches or centimetres? Lengths are in mm"),
        (scaled(0.02), "the boards together are 16 × 12 × 2.88 mm: is that in inches? Lengths"),
        (scaled(0.005), "the boards together are 4 × 3 × 0.72 mm: no side reaches 200 mm"),
        (changed("[700, 0, 0]", "[5950, 0, 0]"), "× 600 × 144 mm: no side may be longer than 6000 mm"),
        (changed("600, 122]", "600, 1600]"), "× 600 × 1600 mm: a carrier is at most 1500 mm high"),
        (
            changed("mass_kg = 1.3", "mass_kg = 1300"),
            "boards[0] (deck left): a mass of 1300 kg means 5.09e+05 kg/m³, heavier than lead; is the mass in grams?",
        ),
        (
            changed("mass_kg = 1.3", "mass_kg = 0.0013"),
            "boards[0] (deck left): a mass of 0.0013 kg means 0.509 kg/m³, lighter than foam",
        ),
        (
            lambda text: re.sub(r"mass_kg = .*\n", "", text).replace("friction = 0.4", "mass_kg = 0.5"),
            "the boards together have 0.5 kg, but must have from 1 to 5000 kg",
        ),
        (
            changed("0, 0]", "0, 5]", 2),
            "the least z of all boards is 5 mm, but must be 0: no board is on the floor, z = 0",
        ),
        (
            lambda text: re.sub(r"corner_mm = \[(\d+)", lambda match: f"corner_mm = [{int(match[1]) + 400}", text),
            "the least x of all boards is 400 mm, but must be 0: the carrier's front-left corner is the origin",
        ),
        (
            changed("[0, 227.5,", "[0, 100,"),
            "boards[0] (deck left) and boards[1] (deck middle) overlap by 22 mm",
        ),
        (
            changed("600, 122]", "600, 121]", 2),
            "boards[1] (deck middle) is separate from boards[0] (deck left): a carrier must be in one piece",
        ),
        (
            lambda text: text + LOW_BOARD,
            "boards[5] ends 9 mm below the top: a carrier's top must be level, and the highest board ends at 144 mm",
        ),
        (
            lambda text: text.partition('[[boards]]\nname = "back"')[0],
            "the carrier tips over: its centre of mass, at x = 234.5 and y = 300 mm, is not over the boards on the ",
        ),
        (lambda text: text + "]", "not valid TOML: "),
    ],
)
def test_what_is_wrong_costs_one_line(change: Callable[[str], str], line: str) -> None:
    text = change(SOUND)
    assert text != SOUND
    write(FILE, text)
    with pytest.raises(InputError) as caught:
        Simulation(carrier="mine.toml")
    assert str(caught.value).startswith("mine.toml: ")
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_command_names_the_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("score", "--limit", "1", "--carrier", "mine.toml") == 2
    assert only_line(capsys.readouterr().err) == "petmjx: mine.toml: no such file"
    assert run("score", "--limit", "1", "--carrier", "raft") == 2
    assert only_line(capsys.readouterr().err).startswith("petmjx: --carrier must be 'footprint', 'euro-pallet', ")


def test_a_run_holds_the_boards_and_notices_others() -> None:
    write(FILE, SOUND)
    results = petmjx.score([PLAN], engine="mujoco", threads=1, carrier="mine.toml", out="run")
    held = json.loads(Path("run/run.json").read_text())["config"]["simulation"]["carrier"]
    assert held["boards"][1]["corner_mm"] == [0, 227.5, 122]
    assert results.carrier == read_carrier(FILE)
    write(FILE, SOUND.replace("227.5", "227"))
    with pytest.raises(InputError, match=r"carrier.boards\[1\].corner_mm is \[0.0, 227.0, 122.0\], was \[0.0, 227.5"):
        petmjx.score([PLAN], engine="mujoco", threads=1, carrier="mine.toml", out="run", resume=True)
    FILE.unlink()  # the run can be read and shown without the carrier's file
    story = petmjx.tell("a", [PLAN], carrier=results.carrier)
    assert story.scene.carrier.half_size.shape == (5, 3)
    petmjx.score([PLAN], engine="mujoco", threads=1, carrier=results.carrier, out="run", resume=True)


def test_a_sweep_finds_the_file_beside_its_own() -> None:
    Path("there").mkdir()
    write(Path("there/mine.toml"), SOUND)
    text = '[axes]\nfriction_factor = [1.0, 0.5]\n[simulation]\ncarrier = "mine.toml"\n'
    sweep = write(Path("there/sweep.toml"), text)
    results = petmjx.sweep(sweep, [PLAN], engine="mujoco", threads=1, out="run")
    assert results.carrier == read_carrier(Path("there/mine.toml"))
    assert len(results.worlds) == 2
    Path("there/mine.toml").unlink()
    assert run("export", "a", "run", "-o", "a.xml", "--variant", "1") == 0  # the run stores its plans
    with pytest.raises(InputError, match=re.escape("there/sweep.toml: there/mine.toml: no such file")):
        petmjx.sweep(sweep, [PLAN], engine="mujoco")


def test_what_does_not_count_is_told() -> None:
    carrier = OwnCarrier.read(tomllib.loads(SOUND))
    physics = PHYSICS["pallet"].changed(floor_z_m=-0.2, carrier_mass_kg=30)
    assert notes_about(Simulation(physics=physics), []) == []
    notes = notes_about(Simulation(carrier="epal-1", physics=physics), [])
    assert notes == [
        "physics.floor_z_m and physics.carrier_mass_kg have no effect: epal-1 is made of boards, which have their own "
        "height and mass"
    ]
    assert notes_about(Simulation(carrier=carrier), []) == []
    slippery = "friction 0.3 of boards of half pallet has no effect with pyramidal cones: "
    options = {"engine": "mujoco", "threads": 1, "carrier": carrier, "physics": "reference"}
    assert (
        f"{slippery}a contact has the larger coefficient of its two bodies, and boxes have 0.5"
        in petmjx.score([PLAN], **options).info["warnings"]
    )


def test_criteria_are_asked_on_the_carrier_of_the_run() -> None:
    pytest.importorskip("scipy")
    pytest.importorskip("shapely")
    # the box's centre is 4 mm beyond the edge of a board
    post = make_plan("post", (((60.0, 60.0, 200.0), (600.0, 119.0, 0.0), 3.0),))
    results = petmjx.score([post], engine="mujoco", threads=1, carrier="epal-1")
    answers = petmjx.criteria([post], run=results, only=("centre",))
    assert answers.plans.centre.tolist() == [False]
    assert answers.plans.centre_slack[0] == pytest.approx(-4)
    assert answers.judged is not None
    assert petmjx.criteria([post], run=results, only=("centre",), carrier="footprint").plans.centre.tolist() == [True]
