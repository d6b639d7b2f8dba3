"""``petmjx show``."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from petmjx.cli import command_options as opt
from petmjx.cli.console import print_tables
from petmjx.cli.run_command import RunInterrupted
from petmjx.common.errors import InputError
from petmjx.common.text import printable
from petmjx.show.pictures.picture_options import PictureOptions

if TYPE_CHECKING:
    from petmjx.analysis.story import Story

OUTPUT_PANEL = "What is drawn"
PICTURE_PANEL = "How it looks"

_OF_RUNS = (
    "limit", "record", "record_interval_s", "record_details", "orders", "strict", "allow_large", "out", "overwrite",
    "resume", "shard", "workers", "ray",
)  # fmt: skip
"""Options of runs that this command does not have, because they have no meaning for a single simulation."""


_file = partial(opt.file_option, section=OUTPUT_PANEL)


@opt.takes(without=_OF_RUNS, more=((PictureOptions, PICTURE_PANEL),))
def show(
    plan_id: Annotated[str, typer.Argument(metavar="PLAN_ID", help="Id of the plan.")],
    source: opt.PlansOrRun = None,
    html: Annotated[
        Path | None, _file("--html", "A page that plays the simulation: one file that needs no network.")
    ] = None,
    png: Annotated[Path | None, _file("--png", "A picture, or a row of pictures.")] = None,
    pdf: Annotated[Path | None, _file("--pdf", "A row of pictures for a paper, as PDF; labels are text.")] = None,
    svg: Annotated[Path | None, _file("--svg", "A row of pictures for a paper, as SVG.")] = None,
    gif: Annotated[Path | None, _file("--gif", "A film.")] = None,
    mp4: Annotated[Path | None, _file("--mp4", "A film.")] = None,
    rrd: Annotated[Path | None, _file("--rrd", "A recording for rerun's viewer; needs the extra 'rerun'.")] = None,
    viewer: Annotated[
        bool,
        typer.Option(
            "--viewer", help="Play the simulation in MuJoCo's viewer; needs a display.", rich_help_panel=OUTPUT_PANEL
        ),
    ] = False,
    repaired: Annotated[
        bool,
        typer.Option(
            "--repair",
            help="Also repair the plan, and draw it before and after, side by side, with the changes; needs --html.",
            rich_help_panel=OUTPUT_PANEL,
        ),
    ] = False,
    variant: opt.Variant = None,
    overwrite: opt.Overwrite = False,
    **options: Any,
) -> None:
    """Show what happens to one plan: in words, as a page, in pictures, or as a film.

    If DIR, the folder of a run, is given, the plan is simulated exactly as in that run. Without DIR, the options
    determine the simulation. If you request no drawing, the command prints a text about the simulation in the terminal.
    """
    from petmjx.results.input_files import input_files
    from petmjx.show.pictures.picture_files import check_drawing

    files = opt.files_by_kind(
        overwrite, input_files(source), html=html, png=png, pdf=pdf, svg=svg, gif=gif, mp4=mp4, rrd=rrd
    )
    check_drawing(list(files.values()))
    look = {name: options.pop(name) for name in PictureOptions.model_fields if name in options}
    PictureOptions(**look)
    if repaired:
        _show_repair(plan_id, source, files, bool(look) or viewer or variant is not None, options)
        return
    if viewer:
        from petmjx.show.pictures.mujoco_viewer import check_display

        check_display()
    try:
        story = _cli_story(plan_id, source or [], variant, bool(look.get("arrows")), options)
        _show(story, list(files.values()), look, viewer)
    except KeyboardInterrupt:
        raise RunInterrupted("unfinished files were not written") from None


def _show_repair(
    plan_id: str, source: list[Path] | None, files: dict[str, Path], has_more: bool, options: dict[str, Any]
) -> None:
    """Repair a plan, and write a page that shows the plan before and after the repair.

    Args:
        has_more: whether the user has set options that cannot be combined with ``--repair``.
    """
    from petmjx.options.run_options import RunOptions
    from petmjx.options.simulation import Simulation
    from petmjx.options.sorted_options import sorted_options
    from petmjx.plans.plan_sources import find_plan, usable_plans
    from petmjx.repairs.repair import OF_READING, repair
    from petmjx.results.plan_lookup import plans_in_place
    from petmjx.show.pages.repair_page import write_repair_page
    from petmjx.show.repair_tables import repair_tables

    if "html" not in files:
        raise InputError("--repair needs --html FILE: it writes a page")
    if len(files) > 1 or has_more:
        raise InputError("--repair writes only the page --html FILE; drop films, pictures and --variant")
    of_simulation, of_run = sorted_options(options)
    reading = RunOptions(**{name: value for name, value in of_run.items() if name in OF_READING})
    plan_set = usable_plans(plans_in_place(source or None, reading.strict), Simulation(**of_simulation), reading)
    repair_options = {name: value for name, value in options.items() if name not in OF_READING}
    try:
        result = repair(find_plan(plan_set, plan_id), **repair_options)
    except KeyboardInterrupt:
        raise RunInterrupted("unfinished files were not written") from None
    write_repair_page(result, files["html"])
    print_tables([*repair_tables(result), f"page {printable(str(files['html']))}"])


def _cli_story(plan_id: str, source: list[Path], variant: int | None, forces: bool, options: dict[str, Any]) -> Story:
    """The story of a plan (its simulation, frame by frame). If ``forces`` is set, a plan of a run is simulated again,
    because the recording of the run may have no forces."""
    from petmjx.analysis.story import tell
    from petmjx.results.plan_lookup import is_run

    if source and is_run(source[0]):
        details = True if forces else None
        return tell(plan_id, source[0], plans=source[1:] or None, variant=variant, details=details, **options)
    return tell(plan_id, source or None, variant=variant, **options)


def _show(story: Story, files: list[Path], look: dict[str, Any], viewer: bool) -> None:
    from petmjx.show.story_tables import story_tables
    from petmjx.show.table_layout import line

    if not files and not viewer:
        how_to_draw = "to see it: --html, --png, --pdf, --svg, --gif, --mp4 or --rrd FILE, or --viewer"
        print_tables([*story_tables(story), "", line(how_to_draw, style="dim")])
        return
    if files:
        _draw(story, files, look)
    if viewer:
        from petmjx.show.pictures.mujoco_viewer import play

        play(story, look.get("speed") or 1.0)


def _draw(story: Story, files: list[Path], look: dict[str, Any]) -> None:
    """Draw each file, with a progress bar for films, and print the names of the written files."""
    from petmjx.analysis.story_in_words import headline, notes_in_words
    from petmjx.show.pictures.picture_files import draw
    from petmjx.show.progress import progress_when_called

    print(printable(f"plan {story.name}: {headline(story)}"))
    for note in notes_in_words(story):
        print(printable(f"note: {note}"))
    for file in files:
        # ``draw`` calls ``count`` only for films, so only films get a progress bar
        with progress_when_called("frame") as count:
            draw(story, file, progress=count, **look)
        print(printable(f"{file}  {_size(file.stat().st_size)}"))


def _size(count: int) -> str:
    return f"{count / 1000:,.0f} kB" if count < 1_000_000 else f"{count / 1_000_000:,.1f} MB"
