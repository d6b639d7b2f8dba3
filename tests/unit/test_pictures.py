"""Cameras, colours and moments in closed form; pictures, films and figures have what they should at known places."""

from __future__ import annotations

import re
import runpy
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.pictures import falling_story, needs_pictures, standing_story

import petmjx
from petmjx.errors import InputError
from petmjx.history import History
from petmjx.pages.palette import article_colours, rgb_of
from petmjx.pictures.camera import FIELD_OF_VIEW_DEG, VIEWS, Margins, View, framing, view_of
from petmjx.pictures.colours import FIRST, colouring, ramp_colours
from petmjx.pictures.draw import forces_of_pairs, framed_points, newtons_per_m
from petmjx.pictures.film import film_times, usual_speed
from petmjx.pictures.options import Colour, PictureOptions, size_of
from petmjx.pictures.overlay import Overlay, convex_hull, first_outline
from petmjx.pictures.poses import corners, moments, nearest_frame, poses_at, poses_of_frame
from petmjx.story import Story

STORY = falling_story()
CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])


@pytest.mark.parametrize("size", [(640, 480), (300, 900), (64, 64)], ids=str)
@pytest.mark.parametrize("view", [*VIEWS, "200/-40"])
def test_all_points_are_in_the_picture_and_touch_its_margins(view: str, size: tuple[int, int]) -> None:
    margins = Margins(0.05, 0.1, 0.15, 0.2)
    seen = framing(CUBE, view_of(view), size, margins).project(CUBE) / size
    low, high = seen.min(axis=0), seen.max(axis=0)
    assert (low >= np.array([margins.left, margins.top]) - 1e-9).all()
    assert (high <= 1 - np.array([margins.right, margins.bottom]) + 1e-9).all()
    # as near as it can be: in one direction both margins are touched, in the other the rest is shared out evenly
    free = [(low[0] - margins.left, 1 - margins.right - high[0]), (low[1] - margins.top, 1 - margins.bottom - high[1])]
    assert min(max(pair) for pair in free) == pytest.approx(0.0, abs=1e-9)


def test_the_front_view_in_closed_form() -> None:
    """From the front a square of 1 m that fills the height is 1 / (2 tan(half the angle)) m away."""
    square = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
    camera = framing(square, View(0, 0), (500, 500), Margins(0, 0, 0, 0))
    away = 0.5 / np.tan(np.radians(FIELD_OF_VIEW_DEG / 2))
    assert camera.pos == pytest.approx([0.5, -away, 0.5])
    assert camera.project(square) == pytest.approx(np.array([[0, 500], [500, 500], [0, 0], [500, 0]]), abs=1e-6)


@pytest.mark.parametrize(
    ("name", "nearest"),
    [("front", [0, -1, 0]), ("right", [1, 0, 0]), ("back", [0, 1, 0]), ("left", [-1, 0, 0]), ("top", [0, 0, 1])],
)
def test_views_are_from_where_their_names_say(name: str, nearest: list[int]) -> None:
    camera = framing(CUBE, VIEWS[name], (200, 200))
    assert -camera.forward @ nearest > 0.98
    assert camera.up[2] >= 0
    assert np.linalg.norm(np.cross(camera.right, camera.forward) - camera.up) < 1e-12


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("view", "isso", "view: unknown view isso; did you mean iso?"),
        ("view", "10/95", "view: 10/95: the elevation must be from -90 to 90"),
        ("at", "start,forst-sign", "at: unknown moment forst-sign; did you mean first-sign?"),
        ("at", "nan", "at: unknown moment nan"),
        ("size", "12x900", "size must be WIDTHxHEIGHT with sides from 64 to 4096 pixels, got '12x900'"),
        ("size", "big", "size must be WIDTHxHEIGHT"),
        ("colour", "blue", "colour must be 'article', 'order', 'shift', 'tilt', 'force' or 'planned', got 'blue'"),
        ("speed", 0, "speed must be from 0.01 to 1000, got 0"),
        ("fps", 1000, "fps must be from 1 to 50, got 1000"),
    ],
)
def test_options_say_what_is_wrong(option: str, value: object, message: str) -> None:
    with pytest.raises(InputError, match="^" + re.escape(message)):
        PictureOptions(**{option: value})


def test_options_of_python_may_be_numbers_and_lists() -> None:
    options = PictureOptions(at=["start", 2.5], size=(800, 600), colour="tilt")
    assert (options.at, options.size) == ("start,2.5", "800x600")
    assert size_of("800 × 600") == (800, 600)
    assert PictureOptions(at=2.5).at == "2.5"


def test_moments_are_the_frames_that_their_names_say() -> None:
    assert [(each.frame, each.name) for each in moments(STORY, None)] == [
        (5, "before"),  # the third box is placed at 0.5 s
        (7, "first-sign"),
        (20, "end"),
    ]
    assert [each.frame for each in moments(STORY, "start,0.34,0.36,99,-1")] == [0, 3, 4, 20, 0]
    calm = standing_story(STORY)
    assert [each.name for each in moments(calm, None)] == ["end"]
    with pytest.raises(InputError, match="there is no moment first-sign: nothing failed in plan tower"):
        moments(calm, "first-sign")


def test_at_takes_the_nearest_frame_and_of_equal_times_the_last() -> None:
    history = STORY.history
    twice = replace(history, time_s=np.array([0.0, 0.1, 0.1, *history.time_s[3:]]))
    assert nearest_frame(twice, 0.12) == 2
    assert nearest_frame(history, 0.149) == 1


def test_poses_between_two_frames() -> None:
    """At 0.75 s the box is half way: 150 mm to the right, and turned by 45° within the accuracy of a chord."""
    poses = poses_at(STORY.history, 0.75)
    assert poses.pos[2] == pytest.approx([0.25, 0.1, 0.3])
    assert 2 * np.degrees(np.arctan2(poses.quat[2, 2], poses.quat[2, 0])) == pytest.approx(45.0, abs=1e-6)
    assert poses_at(STORY.history, 0.45).n_placed == 2, "a box comes when it is placed, not before"
    assert poses_at(STORY.history, 0.5).n_placed == 3
    assert poses_at(STORY.history, 9.0).time_s == 2.0


def test_film_times_and_speed() -> None:
    assert film_times(STORY, 1.0, 10.0) == pytest.approx(np.arange(21) / 10)
    assert film_times(STORY, 4.0, 5.0) == pytest.approx([0.0, 0.8, 1.6, 2.0]), "the end is always seen"
    assert usual_speed(STORY) == 1.0
    long = replace(STORY, history=replace(STORY.history, time_s=STORY.history.time_s * 25))
    assert usual_speed(long) == 3.0, "50 s in 20 s at most"


def test_colours_mean_what_the_legend_says() -> None:
    tea, salt, _ = (rgb_of(colour) for colour in article_colours(STORY.plan.articles))
    end = poses_of_frame(STORY.history, 20)
    by_article = colouring(STORY, Colour.ARTICLE)
    assert by_article.names == (("tea", tea), ("salt", salt))
    assert by_article.of(end) == pytest.approx(np.array([tea, salt, tea]))
    by_shift = colouring(STORY, Colour.SHIFT)
    assert by_shift.scale is not None
    assert (by_shift.scale.low, by_shift.scale.high, by_shift.scale.label) == (0.0, 40.0, "shift, mm")
    assert by_shift.of(end) == pytest.approx(ramp_colours(np.array([0.0, 0.0, 1.0])))
    by_tilt = colouring(STORY, Colour.TILT).of(poses_at(STORY.history, 0.6))
    assert by_tilt[2] == pytest.approx(ramp_colours(np.array([18.0 / 40.0]))[0])
    by_force = colouring(STORY, Colour.FORCE)
    assert by_force.scale is not None
    assert by_force.scale.high == 20.0, "19.62 N, rounded up"
    assert by_force.of(end)[0] == pytest.approx(ramp_colours(np.array([19.62 / 20]))[0])


def test_forces_between_two_bodies_are_on_the_lower_one() -> None:
    contacts = STORY.history.contacts
    assert contacts is not None
    found = sorted(forces_of_pairs(contacts, poses_of_frame(STORY.history, 3)), key=lambda pair: pair[0][0])
    assert [place.tolist() for place, _ in found] == [[0.1, 0.1, 0.0], [0.3, 0.1, 0.0]]
    assert [force.tolist() for _, force in found] == [[0.0, 0.0, -20.0], [0.0, 0.0, -20.0]]
    with pytest.raises(InputError, match=r"plan tower: no contact forces were recorded \(engine mujoco\)"):
        newtons_per_m(falling_story(contacts=False))


def test_what_is_framed() -> None:
    """Planned places and boxes that lie near; not what has rolled away."""
    near = framed_points(STORY, [20])
    assert near[:, 0].max() == pytest.approx(0.5), "the fallen box, from 0.3 to 0.5 m"
    far = STORY.history.pos.copy()
    far[20, 2] = [9.0, 0.1, 0.1]
    rolled = replace(STORY, history=replace(STORY.history, pos=far))
    assert framed_points(rolled, [20])[:, 0].max() == pytest.approx(0.4)
    assert framed_points(STORY, [0])[:, 2].max() == pytest.approx(0.4), "planned boxes before they are placed, too"


def test_the_hull_of_points() -> None:
    square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
    hull = convex_hull(np.vstack((square, [[1.0, 1.0], [1.0, 0.5]])))
    assert {tuple(point) for point in hull} == {tuple(point) for point in square}


def test_the_outline_is_of_the_first_box_once_it_is_placed() -> None:
    camera = framing(framed_points(STORY, [20]), VIEWS["front"], (300, 300))
    assert first_outline(STORY, poses_of_frame(STORY.history, 4), camera) is None
    outline = first_outline(STORY, poses_of_frame(STORY.history, 20), camera)
    assert outline is not None
    box = slice(2, 3)
    seen = camera.project(corners(STORY.history.pos[20, box], STORY.history.quat[20, box], np.full((1, 3), 0.1))[0])
    assert outline.min(axis=0) == pytest.approx(seen.min(axis=0))
    assert first_outline(standing_story(STORY), poses_of_frame(STORY.history, 20), camera) is None


def pixels_of(path: Path) -> np.ndarray:
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"), dtype=np.float64)


def share_of(pixel: np.ndarray, rgb: tuple[float, float, float]) -> float:
    """How bright a pixel is, as a share of a colour; NaN where it is of another hue."""
    bright = pixel @ rgb / (255 * np.dot(rgb, rgb))
    return float(bright) if np.abs(pixel / 255 - bright * np.array(rgb)).max() < 0.02 else float("nan")


@needs_pictures()
@pytest.mark.parametrize("view", ["iso", "front", "top", "-140/35"])
def test_boxes_are_seen_where_the_camera_projects_them(view: str, tmp_path: Path) -> None:
    """The centre of the face that looks most towards the camera has the box's hue, and on top its very colour."""
    story = standing_story(STORY)
    petmjx.draw(story, tmp_path / "x.png", view=view, size=(400, 300), at="end")
    pixels = pixels_of(tmp_path / "x.png")
    assert pixels.shape == (300, 400, 3)
    margins = Overlay(colouring(story, Colour.ARTICLE), (400, 300)).margins
    camera = framing(framed_points(story, [20]), view_of(view), (400, 300), margins)
    poses = poses_of_frame(story.history, 20)
    colours = colouring(story, Colour.ARTICLE).of(poses)
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
    margins = Overlay(colouring(STORY, Colour.PLANNED), (400, 400)).margins
    camera = framing(framed_points(STORY, [20]), VIEWS["front"], (400, 400), margins)
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
@pytest.mark.parametrize("lost", [np.nan, np.inf, 1e30], ids=str)
@pytest.mark.parametrize("colour", list(Colour))
def test_boxes_that_are_nowhere_are_left_out(colour: Colour, lost: float, tmp_path: Path) -> None:
    """Of invalid worlds there are pictures too: of what is still somewhere."""
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
    reader = ffmpeg.read_frames(str(tmp_path / "x.mp4"))
    try:
        about = next(reader)
    finally:
        reader.close()
    assert about["size"] == (160, 120), "H.264 takes even sides"


@needs_pictures()
def test_figures_have_their_labels_as_text(tmp_path: Path) -> None:
    names = [tmp_path / f"f.{kind}" for kind in ("svg", "pdf", "png")]
    files = petmjx.draw(falling_story("a $x$ <b> & plan"), *names, size=(200, 240))
    text = files[0].read_text(encoding="utf-8")
    said = re.findall(r"<text[^>]*>(.*?)</text>|<tspan[^>]*>(.*?)</tspan>", text)
    labels = " | ".join(part for pair in said for part in pair if part)
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
    for name in ("x.svg", "x.pdf", "x.gif"):
        first = petmjx.draw(STORY, tmp_path / name, size=(100, 100))[0].read_bytes()
        assert petmjx.draw(STORY, tmp_path / name, size=(100, 100))[0].read_bytes() == first


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

    from petmjx.config import Simulation
    from petmjx.world.scene import build_scene

    places = [(200.0 * (i % 8), 200.0 * (i // 8 % 8), 200.0 * (i // 64)) for i in range(512)]
    plan = cube_plan("many", places, ["tea"] * 512)
    scene = build_scene(plan, Simulation())
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (512, 1))
    contacts = STORY.history.contacts
    assert contacts is not None
    history = History(
        np.zeros(1), np.array([512], dtype=np.int32), scene.target[None], upright[None], np.zeros((1, 512)),
        scene.carrier_pos[None], upright[None, 0], np.zeros((1, 3)), contacts=contacts,
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
    monkeypatch.setattr("petmjx.pages.story_page.story_page", lambda story: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        petmjx.draw(STORY, "x.html")
    assert [path.name for path in Path().iterdir()] == ["x.html"]
    assert Path("x.html").read_text(encoding="utf-8") == "before"


def test_no_opengl_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "vulkan")
    with pytest.raises(InputError, match="MUJOCO_GL=vulkan: pictures are drawn with one of egl, osmesa, glfw"):
        petmjx.draw(STORY, tmp_path / "x.png")
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setattr("petmjx.pictures.offscreen.importlib.import_module", lambda name: 1 / 0)
    with pytest.raises(InputError, match=r"no OpenGL that draws without a display \(osmesa: ZeroDivisionError"):
        petmjx.draw(STORY, tmp_path / "x.png")


def test_a_missing_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("petmjx.pictures.save.importlib.util.find_spec", lambda name: None)
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
    there = {path.name for path in (repository / "docs" / "pictures").iterdir()}
    assert there == set(script["files"]())
    documents = [repository / "README.md", repository / "docs" / "seeing.md"]
    text = "".join(document.read_text(encoding="utf-8") for document in documents)
    assert [name for name in there if f"pictures/{name})" not in text] == []
    assert (repository / "docs" / "pictures" / "collapse.png").stat().st_size < 150_000
    assert all((repository / "docs" / "pictures" / name).stat().st_size < 1_000_000 for name in there)
