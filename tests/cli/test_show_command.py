"""``petmjx show``: the story in words, the written files, and errors of one line."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

import pytest
from support.pictures import falling_story, needs_pictures, standing_story

import petmjx
from petmjx.analysis.story_in_words import events, headline
from petmjx.cli.main import main
from petmjx.common.errors import InputError
from petmjx.show.pictures.mujoco_viewer import Player, play, show, viewer_model

pytestmark = pytest.mark.usefixtures("in_tmp_path")


def lines_of(capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0) -> str:
    """Run a command, and return its standard output, or the line that it prints on standard error if it fails."""
    assert main(["show", *arguments]) == code
    printed = capsys.readouterr()
    if code:
        assert printed.err.count("\n") == 1
        return printed.err
    return printed.out


def test_the_story_is_told_in_the_terminal(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    printed = lines_of(capsys, "hand-falls-off", "--engine", "mujoco")
    run = petmjx.score(petmjx.tell("hand-falls-off").plan, engine="mujoco", out="run")
    world = run.worlds.iloc[0]
    assert "plan hand-falls-off, 2 boxes, 12.0 kg: unstable, a box dropped" in printed
    assert f"{world.first_sign_s:.2f} Box 1 (carton-400x300x500) failed first: at {world.first_sign_s:.2f} s" in printed
    assert f"{world.first_drop_s:.2f} Box 1 (carton-400x300x500) has dropped" in printed
    assert "first to fail" in printed
    assert "--html, --png" in printed
    tables = printed.partition("\n\n")[2]
    assert max(map(len, tables.splitlines())) <= 100


def test_the_story_of_a_plan_that_stands(capsys: pytest.CaptureFixture[str]) -> None:
    printed = lines_of(capsys, "hand-bridge", "--check", "static", "--duration", "1", "--engine", "mujoco")
    assert "3 boxes placed at once" in printed
    assert "End: stable, margin" in printed
    assert "went first" not in printed


def test_ids_with_markup_and_control_characters_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    box = json.loads(PLAN)["[red]\x1b[2J"][0]
    box["item"]["article"] = "[/] <b>🦆"
    Path("p.json").write_text(json.dumps({"[red]\x1b[2J": [box]}), encoding="utf-8")
    printed = lines_of(capsys, "[red]\x1b[2J", "p.json", "--engine", "mujoco")
    assert "plan [red]\\u001b[2J, 1 box" in printed
    assert "[/] <b>🦆" in printed
    assert "\x1b[2J" not in printed


PLAN = json.dumps(
    {
        "[red]\x1b[2J": [
            {
                "item": {
                    "article": "a", "id": "1", "sequence": 1, "length/mm": 300, "width/mm": 200, "height/mm": 100,
                    "weight/kg": 2.0,
                },
                "flb_coordinates": [0, 0, 0],
                "orientation": 0,
            }
        ]
    }
)  # fmt: skip


@needs_pictures()
def test_several_files_from_one_simulation(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    tell = petmjx.tell
    monkeypatch.setattr(
        "petmjx.analysis.story.tell", lambda *given, **named: calls.append(given) or tell(*given, **named)
    )
    size = ("--size", "120x100", "--fps", "4")
    printed = lines_of(capsys, "hand-falls-off", "--png", "a.png", "--gif", "b.gif", "--svg", "c.svg", *size)
    assert len(calls) == 1
    for name in ("a.png", "b.gif", "c.svg"):
        assert Path(name).stat().st_size > 1000
        assert name in printed
    assert "plan hand-falls-off: unstable by drop: first box 1 (carton-400x300x500)" in printed


def test_the_page_of_a_run(capsys: pytest.CaptureFixture[str]) -> None:
    """The page uses the options of the run. For a sweep, any world of a plan can be shown."""
    petmjx.score(petmjx.tell("hand-overhang-55").plan, engine="mujoco", out="run", thresholds={"tilt_deg": 5})
    Path("plans.json").write_text("{}", encoding="utf-8")
    printed = lines_of(capsys, "hand-overhang-55", "run", "--html", "x.html")
    assert "x.html" in printed
    assert "hand-overhang-55" in Path("x.html").read_text(encoding="utf-8")
    refused = lines_of(capsys, "hand-overhang-55", "run", "--check", "static", code=2)
    assert "--check: a world of a run has the run's options; drop this option" in refused


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("hand-brigde",), "plan hand-brigde is not among the 26 plans read; did you mean hand-bridge?"),
        (("hand-bridge", "nowhere.json"), "nowhere.json"),
        (("hand-bridge", "empty.json"), "empty.json"),
        (("hand-bridge", "--png", "x.jpg"), "--png x.jpg: the file's name must end in .png"),
        (("hand-bridge", "--html", "no/x.html"), "no/x.html: cannot be written: no is not a folder"),
        (("hand-bridge", "--png", "x.png", "--view", "isso"), "--view: unknown view isso; did you mean iso?"),
        (("hand-bridge", "--png", "x.png", "--size", "9"), "--size must be WIDTHxHEIGHT"),
        (("hand-bridge", "--png", "x.png", "--at", "later"), "--at: unknown moment later"),
        (("hand-bridge", "--colour", "blue"), "--colour must be 'article', 'order'"),
        (("hand-bridge", "--variant", "3"), "the arguments variant and plans select a world of a run"),
        (("hand-bridge", "--viewer"), "--viewer: no display here (DISPLAY is not set)"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_what_is_wrong_is_one_line(
    arguments: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    Path("empty.json").write_text("", encoding="utf-8")
    assert message in lines_of(capsys, *arguments, code=2)
    assert not list(Path().glob("x.*"))


def test_a_moment_that_the_story_has_not(capsys: pytest.CaptureFixture[str]) -> None:
    printed = lines_of(capsys, "hand-one-box", "--png", "x.png", "--at", "first-sign", code=2)
    assert "there is no moment 'first-sign': nothing failed in plan hand-one-box" in printed
    printed = lines_of(capsys, "hand-one-box", "--png", "x.png", "--at", "1e308", code=2)
    assert "there is no moment 1e+308 s: plan hand-one-box ends at " in printed
    assert not Path("x.png").exists()


def test_no_opengl_is_said_before_anything_is_simulated(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "vulkan")
    monkeypatch.setattr("petmjx.analysis.story.tell", lambda *given, **named: pytest.fail("simulated"))
    printed = lines_of(capsys, "hand-bridge", "--html", "x.html", "--gif", "x.gif", code=2)
    assert "x.gif: MUJOCO_GL=vulkan: pictures are drawn with one of egl, osmesa, glfw" in printed


def test_words() -> None:
    story = falling_story()
    assert headline(story) == "unstable by tilt: first box 2 (tea), at 0.70 s"
    assert headline(standing_story(story)) == "stable, margin 0.90"
    assert [event.time_s for event in events(story)] == [0.0, 0.5, 0.7, 2.0]


def test_the_viewer_shows_the_story() -> None:
    """Boxes that are placed later are out of sight. Contact forces are those of MuJoCo: at the end, when all boxes are
    at rest, the forces on the floor add up to the total weight."""
    import mujoco
    import numpy as np

    story = petmjx.tell("hand-stack-of-5", engine="mujoco")
    model, data = viewer_model(story)
    show(story, float(story.history.time_s[0]), model, data)
    assert [float(model.geom_rgba[model.body_geomadr[2 + box], 3]) for box in range(5)] == [1, 0, 0, 0, 0]
    end_s = float(story.history.time_s[-1])
    show(story, end_s, model, data)
    assert (model.geom_rgba[:, 3] == 1).all()
    assert data.qpos[7:].reshape(5, 7)[:, :3] == pytest.approx(story.outcome.boxes.pos)
    on_floor, force = 0.0, np.zeros(6)
    for number in range(data.ncon):
        if 0 in model.geom_bodyid[data.contact[number].geom]:
            mujoco.mj_contactForce(model, data, number, force)
            on_floor += force[0]
    assert on_floor == pytest.approx(story.scene.total_mass * 9.81, rel=0.05)


def test_the_keys_of_the_viewer() -> None:
    player = Player(falling_story(), speed=2.0)
    player.wait(0.5)
    assert player.time_s == pytest.approx(1.0)
    player.press(ord(" "))
    player.wait(0.5)
    assert player.time_s == pytest.approx(1.0), "paused"
    player.press(262)
    assert player.time_s == pytest.approx(1.1)
    player.press(263)
    player.press(263)
    assert player.time_s == pytest.approx(0.9)
    player.press(268)
    assert player.time_s == 0.0
    player.press(263)
    assert player.time_s == 0.0


def test_the_viewer_plays_until_its_window_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fake window replaces MuJoCo's viewer. The test checks the data that the viewer gets for each frame."""
    import mujoco.viewer

    story = falling_story()
    seen: list[float] = []

    class Window:
        """The part of the object returned by ``launch_passive`` that petmjx uses."""

        def __init__(self, model: Any, data: Any, key_callback: Any) -> None:
            self.opt, self.data, self.press = mujoco.MjvOption(), data, key_callback

        def __enter__(self) -> Window:
            return self

        def __exit__(self, *error: object) -> None: ...

        def is_running(self) -> bool:
            return len(seen) < 5

        def lock(self) -> contextlib.AbstractContextManager[None]:
            return contextlib.nullcontext()

        def sync(self) -> None:
            assert self.opt.flags[mujoco.mjtVisFlag.mjVIS_CONTACTFORCE]
            seen.append(self.data.time)
            if len(seen) == 3:
                self.press(ord(" "))

    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setattr(mujoco.viewer, "launch_passive", Window)
    play(story, speed=6.0)
    assert seen == pytest.approx([0.0, 0.1, 0.2, 0.2, 0.2])

    def refuse(*given: Any, **named: Any) -> None:
        raise RuntimeError("could not initialize GLFW")

    monkeypatch.setattr(mujoco.viewer, "launch_passive", refuse)
    with pytest.raises(InputError, match="viewer: MuJoCo's viewer cannot open its window: RuntimeError: could not"):
        play(story)
