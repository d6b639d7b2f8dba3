"""Pictures, films and figures show boxes at known places. If a machine cannot draw them, a message gives the reason."""

from __future__ import annotations

import os
import re
import runpy
import subprocess
import threading
from collections.abc import Iterator
from dataclasses import replace
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.pictures import falling_story, needs_pictures, standing_story

import petmjx
from petmjx.analysis.story import Story
from petmjx.common.errors import InputError
from petmjx.show.pictures.animation import h264_encoder
from petmjx.show.pictures.box_colours import FIRST, colouring
from petmjx.show.pictures.camera import VIEWS, framing, view_of
from petmjx.show.pictures.draw_story import PictureStyle, framed_points
from petmjx.show.pictures.overlay import Overlay
from petmjx.show.pictures.picture_options import Colour
from petmjx.show.pictures.story_poses import poses_of_frame
from petmjx.world.history import History

STORY = falling_story()


def pixels_of(path: Path) -> np.ndarray:
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"), dtype=np.float64)


def share_of(pixel: np.ndarray, rgb: tuple[float, float, float]) -> float:
    """Brightness of a pixel as a share of the brightness of a colour; NaN if the pixel has another hue."""
    bright = pixel @ rgb / (255 * np.dot(rgb, rgb))
    return float(bright) if np.abs(pixel / 255 - bright * np.array(rgb)).max() < 0.02 else float("nan")


@needs_pictures()
@pytest.mark.parametrize("view", ["iso", "front", "top", "-140/35"])
def test_boxes_are_seen_where_the_camera_projects_them(view: str, tmp_path: Path) -> None:
    """At the projected centre of the face that is turned most towards the camera, the pixel has the hue of the box. On
    the top face, it has exactly the box's colour."""
    story = standing_story(STORY)
    petmjx.draw(story, tmp_path / "x.png", view=view, size=(400, 300), at="end")
    pixels = pixels_of(tmp_path / "x.png")
    assert pixels.shape == (300, 400, 3)
    look = PictureStyle(colouring(story, Colour.ARTICLE), view_of(view), (400, 300))
    camera = framing(framed_points(story, [20]), look.view, look.size, Overlay(look).margins)
    poses = poses_of_frame(story.history, 20)
    colours = look.colours.of(poses)
    face = np.zeros(3)
    axis = int(np.abs(camera.forward).argmax())
    face[axis] = -np.sign(camera.forward[axis])
    for box in (0, 2):
        ((x, y),) = camera.project(poses.pos[box : box + 1] + 0.1 * face)
        share = share_of(pixels[round(y), round(x)], tuple(colours[box]))
        assert share == pytest.approx(1.0, abs=0.01) if axis == 2 else 0.5 < share < 0.95
    assert (pixels[1, 1] == 255).all(), "white around"


@needs_pictures()
def test_the_first_box_is_outlined_and_ghosts_stand_where_boxes_were_planned(tmp_path: Path) -> None:
    petmjx.draw(STORY, tmp_path / "planned.png", colour="planned", at="end", size=(400, 400), view="front")
    pixels = pixels_of(tmp_path / "planned.png")
    red = np.abs(pixels - 255 * np.array(FIRST)).max(axis=2) < 40
    assert 150 < red.sum() < 4000
    look = PictureStyle(colouring(STORY, Colour.PLANNED), VIEWS["front"], (400, 400))
    camera = framing(framed_points(STORY, [20]), look.view, look.size, Overlay(look).margins)
    x, y = camera.project(np.array([[0.0, 0.0, 0.3]]))[0]
    beside = pixels[round(y), round(x) - 3 : round(x) + 4]
    assert (beside[:, 2] - beside[:, 0]).max() > 60, "a blue edge on the left of the planned place"


@needs_pictures()
def test_arrows_are_drawn_in_transparent_boxes(tmp_path: Path) -> None:
    petmjx.draw(STORY, tmp_path / "a.png", at="end", size=(300, 300), view="front")
    petmjx.draw(STORY, tmp_path / "b.png", at="end", size=(300, 300), view="front", arrows=True)
    solid, clear = pixels_of(tmp_path / "a.png"), pixels_of(tmp_path / "b.png")
    assert clear.sum() > solid.sum()
    with pytest.raises(InputError, match="no contact forces were recorded"):
        petmjx.draw(falling_story(contacts=False), tmp_path / "c.png", arrows=True)
    assert not (tmp_path / "c.png").exists()


@needs_pictures()
@pytest.mark.parametrize(
    ("colour", "lost"), [*((colour, np.nan) for colour in Colour), (Colour.SHIFT, np.inf), (Colour.SHIFT, 1e30)]
)
def test_boxes_that_are_nowhere_are_left_out(colour: Colour, lost: float, tmp_path: Path) -> None:
    """Worlds of which some boxes have no finite position can be drawn: the picture shows the other boxes."""
    pos, quat = STORY.history.pos.copy(), STORY.history.quat.copy()
    pos[10:, 2], quat[10:, 2] = lost, np.nan
    broken = replace(STORY, history=replace(STORY.history, pos=pos, quat=quat))
    petmjx.draw(broken, tmp_path / "x.png", at="end", size=(100, 100), colour=colour)
    assert (pixels_of(tmp_path / "x.png") < 100).any()


@needs_pictures()
def test_a_gif_has_its_frames_its_size_and_its_time(tmp_path: Path) -> None:
    from PIL import Image

    done: list[tuple[int, int]] = []
    petmjx.draw(STORY, tmp_path / "x.gif", size=(120, 100), fps=8, progress=lambda *counts: done.append(counts))
    with Image.open(tmp_path / "x.gif") as film:
        assert (film.n_frames, film.size, film.info["loop"]) == (17, (120, 100), 0)
        waits, pictures = [], []
        for number in range(film.n_frames):
            film.seek(number)
            waits.append(film.info["duration"])
            pictures.append(np.asarray(film.convert("RGB"), dtype=np.float64))
    assert sum(waits) == 2120 + 2000, "17 / 8 s in whole hundredths, and 2 s for the last frame"
    assert done[-1] == (17, 17)
    petmjx.draw(STORY, tmp_path / "x.png", size=(120, 100), at="end")
    assert np.abs(pictures[0] - pictures[-1]).max() > 100, "the box has come, and has fallen"
    assert np.abs(pictures[8] - pictures[7]).max() > 50
    assert (pictures[-1][99, 119] == 255).all()


@needs_pictures()
def test_an_mp4_has_its_frames_its_size_and_its_time(tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed (extra: show)")
    petmjx.draw(STORY, tmp_path / "x.mp4", size=(160, 121), fps=10, speed=2)
    frames, seconds = ffmpeg.count_frames_and_secs(str(tmp_path / "x.mp4"))
    assert (frames, seconds) == (11 + 20, pytest.approx(3.1, abs=0.05))
    process = subprocess.run([ffmpeg.get_ffmpeg_exe(), "-i", tmp_path / "x.mp4"], capture_output=True, text=True)
    assert re.search(r"Video: h264.*yuv420p.* 160x120", process.stderr), "H.264 takes even sides"


def encoded(path: Path, frames: Iterator[bytes]) -> None:
    pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed (extra: show)")
    with h264_encoder(path, (32, 16), 10) as add:
        for frame in frames:
            add(frame)


def test_ffmpeg_runs_nothing_of_python_between_fork_and_exec(tmp_path: Path) -> None:
    """Once JAX is loaded, it warns of every fork that runs Python code."""
    forks: list[int] = []
    os.register_at_fork(before=lambda: forks.append(1))
    encoded(tmp_path / "a:b.mp4", iter([bytes(32 * 16 * 3)]))
    assert (tmp_path / "a:b.mp4").stat().st_size > 0
    assert not forks


def test_an_encoder_that_gives_up_says_why(tmp_path: Path) -> None:
    endless = repeat(bytes(32 * 16 * 3), 100_000)
    with pytest.raises(RuntimeError, match="No such file or directory"):
        encoded(tmp_path / "nowhere" / "x.mp4", endless)
    assert next(endless, None) is not None, "it stops taking frames"


def test_what_fails_between_frames_ends_the_encoder(tmp_path: Path) -> None:
    def frames() -> Iterator[bytes]:
        yield bytes(32 * 16 * 3)
        raise BrokenPipeError("of a progress bar")

    with pytest.raises(BrokenPipeError, match="of a progress bar"):
        encoded(tmp_path / "x.mp4", frames())


@needs_pictures()
def test_figures_have_their_labels_as_text(tmp_path: Path) -> None:
    names = [tmp_path / f"f.{kind}" for kind in ("svg", "pdf", "png")]
    files = petmjx.draw(falling_story("a $x$ <b> & plan"), *names, size=(200, 240))
    text = files[0].read_text(encoding="utf-8")
    pairs = re.findall(r"<text[^>]*>(.*?)</text>|<tspan[^>]*>(.*?)</tspan>", text)
    labels = " | ".join(part for pair in pairs for part in pair if part)
    for label in (
        "a $x$ &lt;b&gt; &amp; plan",
        "unstable by tilt: first box 2 (tea), at 0.70 s",
        "box 2",
        "tea",
        "salt",
    ):
        assert label in labels
    for title in ("(a) before, 0.50 s", "(b) first sign, 0.70 s", "(c) end, 2.00 s"):
        assert title in labels
    assert text.count("<image") == 3
    assert files[1].read_bytes().startswith(b"%PDF")
    assert pixels_of(files[2]).shape[1] == 3 * 200


@needs_pictures()
def test_the_same_story_gives_the_same_files(tmp_path: Path) -> None:
    options: dict[str, Any] = {"size": (100, 100), "at": "end", "fps": 4}
    for name in ("x.svg", "x.pdf", "x.gif"):
        first = petmjx.draw(STORY, tmp_path / name, **options)[0].read_bytes()
        assert petmjx.draw(STORY, tmp_path / name, **options)[0].read_bytes() == first


@needs_pictures()
def test_pictures_are_drawn_in_any_thread_and_leave_the_environment_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import os

    monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)
    before = dict(os.environ)
    threads = [
        threading.Thread(target=petmjx.draw, args=(STORY, tmp_path / f"{number}.png"), kwargs={"size": (100, 100)})
        for number in range(3)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({(tmp_path / f"{number}.png").read_bytes() for number in range(3)}) == 1
    assert dict(os.environ) == before


@needs_pictures()
def test_512_boxes_with_arrows_fit_into_a_picture(tmp_path: Path) -> None:
    from support.pictures import cube_plan

    from petmjx.options.simulation import Simulation
    from petmjx.world.scene import build_scene

    places = [(200.0 * (i % 8), 200.0 * (i // 8 % 8), 200.0 * (i // 64)) for i in range(512)]
    plan = cube_plan("many", places, ["tea"] * 512)
    scene = build_scene(plan, Simulation())
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (512, 1))
    contacts = STORY.history.contacts
    assert contacts is not None
    history = History(
        np.zeros(1), np.array([512], dtype=np.int32), scene.target[None], upright[None], np.zeros((1, 512)),
        scene.carrier.pos[None], upright[None, 0], np.zeros((1, 3)), contacts=contacts,
    )  # fmt: skip
    many: Story = replace(standing_story(STORY), plan=plan, scene=scene, history=history)
    petmjx.draw(many, tmp_path / "x.png", arrows=True, size=(200, 200))
    assert (tmp_path / "x.png").stat().st_size > 1000


@pytest.mark.usefixtures("in_tmp_path")
@pytest.mark.parametrize(
    ("file", "message"),
    [
        ("x.bmp", "x.bmp: unknown ending; there are .png, .pdf, .svg, .gif, .mp4, .html, .rrd"),
        ("x", "x: unknown ending"),
        ("nowhere/x.png", "nowhere/x.png: cannot be written: nowhere is not a folder"),
        ("folder.png", "folder.png: cannot be written: is a folder"),
    ],
)
def test_files_that_cannot_be_written(file: str, message: str) -> None:
    Path("folder.png").mkdir()
    with pytest.raises(InputError, match=re.escape(message)):
        petmjx.draw(STORY, file)


@pytest.mark.usefixtures("in_tmp_path")
def test_a_file_is_there_whole_or_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    Path("x.html").write_text("before", encoding="utf-8")
    monkeypatch.setattr("petmjx.show.pages.story_page.story_page", lambda story: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        petmjx.draw(STORY, "x.html")
    assert [path.name for path in Path().iterdir()] == ["x.html"]
    assert Path("x.html").read_text(encoding="utf-8") == "before"


def test_no_opengl_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "vulkan")
    with pytest.raises(InputError, match="MUJOCO_GL=vulkan: pictures are drawn with one of egl, osmesa, glfw"):
        petmjx.draw(STORY, tmp_path / "x.png")
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setattr("petmjx.show.pictures.offscreen.importlib.import_module", lambda name: 1 / 0)
    with pytest.raises(InputError, match=r"OpenGL cannot draw without a display here \(osmesa: ZeroDivisionError"):
        petmjx.draw(STORY, tmp_path / "x.png")


def test_a_missing_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("petmjx.show.pictures.picture_files.importlib.util.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"needs rerun, not installed: pip install 'petmjx\[rerun\]'"):
        petmjx.draw(STORY, tmp_path / "x.rrd")
    with pytest.raises(InputError, match=r"needs PIL, matplotlib, OpenGL, not installed: pip install 'petmjx\[show\]'"):
        petmjx.draw(STORY, tmp_path / "x.png")


def test_a_recording_for_rerun(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed (extra: rerun)")
    (file,) = petmjx.draw(STORY, tmp_path / "x.rrd")
    assert file.read_bytes()[:3] == b"RRF"
    assert file.stat().st_size > 5000


def test_the_documents_have_the_pictures_that_the_script_makes(repository: Path) -> None:
    script = runpy.run_path(str(repository / "docs" / "pictures.py"))
    names = {path.name for path in (repository / "docs" / "pictures").iterdir()}
    assert names == set(script["files"]())
    documents = [repository / "README.md", *(repository / "docs").glob("*.md")]
    text = "".join(document.read_text(encoding="utf-8") for document in documents)
    assert [name for name in names if f"pictures/{name})" not in text] == []
    assert (repository / "docs" / "pictures" / "collapse.png").stat().st_size < 150_000
    assert all((repository / "docs" / "pictures" / name).stat().st_size < 1_000_000 for name in names)
