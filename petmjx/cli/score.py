"""``petmjx score``."""

from __future__ import annotations

import json
import sys
import threading
from contextlib import AbstractContextManager
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Annotated, Any, Self

import typer

from petmjx.cli import options as opt
from petmjx.cli.console import results_console
from petmjx.config import Carrier, Check, Schedule, SimConfig, Thresholds

if TYPE_CHECKING:
    from petmjx.engines.base import Progress
    from petmjx.engines.choose import Choice
    from petmjx.engines.retry import WorldResult
    from petmjx.results.reader import RunResults
    from petmjx.show.progress import ProgressBar
    from petmjx.sweeps.run import SweptWorld

_SIM = SimConfig()
_REFRESH_S = 0.5
_SHOWN_SKIPPED = 10


def score(
    plans: opt.PlanPaths = None,
    check: opt.CheckOption = Check.ONE_BY_ONE,
    schedule: opt.ScheduleOption = Schedule.ADAPTIVE,
    engine: opt.EngineOption = opt.EngineName.AUTO,
    physics: opt.PhysicsOption = opt.PhysicsName.PALLET,
    interval: opt.IntervalOption = _SIM.interval_s,
    duration: opt.DurationOption = _SIM.duration_s,
    sample_interval: opt.SampleIntervalOption = _SIM.sample_interval_s,
    size_reduction_mm: opt.SizeReductionOption = 0.1,
    carrier: opt.CarrierOption = Carrier.FOOTPRINT,
    no_early_stop: opt.NoEarlyStopOption = False,
    shift_limit_m: Annotated[
        float,
        typer.Option("--shift-limit-m", metavar="M", help="Unstable from a final shift of a box in x, y or z, m."),
    ] = _SIM.thresholds.shift_m,
    tilt_limit_deg: Annotated[
        float, typer.Option("--tilt-limit-deg", metavar="DEG", help="Unstable from a tilt of a box, degrees.")
    ] = _SIM.thresholds.tilt_deg,
    limit: opt.LimitOption = None,
    strict: opt.StrictOption = False,
    threads: opt.ThreadsOption = None,
    lanes: opt.LanesOption = None,
    out: opt.OutOption = None,
    overwrite: opt.OverwriteOption = False,
    as_json: opt.JsonOption = False,
) -> None:
    """Simulate packing plans and say which of them stand.

    Reads the plans, places their boxes in a simulated world, and writes a verdict and metrics per plan and per
    box as Parquet. Unusable plans are skipped, counted and listed.
    """
    import petmjx.api as api

    folder = out if out is not None else default_folder()
    watcher = BarWatcher()
    try:
        with watcher:
            results = api.score(
                plans or None,
                check=check,
                schedule=schedule,
                engine=engine.value,
                physics=physics.value,
                interval_s=interval,
                duration_s=duration,
                sample_interval_s=sample_interval,
                size_reduction_mm=size_reduction_mm,
                carrier=carrier,
                early_stop=not no_early_stop,
                thresholds=_thresholds(shift_limit_m, tilt_limit_deg),
                limit=limit,
                strict=strict,
                threads=threads,
                lanes=lanes,
                out=folder,
                overwrite=overwrite,
                watcher=watcher,
            )
    except KeyboardInterrupt:
        raise Interrupted(how_far(folder, watcher.total)) from None
    _show(results, as_json)


class Interrupted(Exception):
    """Ctrl-C, with how far the run came. (A bare KeyboardInterrupt would end inside typer, without a word.)"""


class BarWatcher(AbstractContextManager["BarWatcher"]):
    """Draws the progress bar on standard error. Its message is refreshed also while no world finishes."""

    def __init__(self, what: str = "plans") -> None:
        self.total: int | None = 0
        self._what = what
        self._done = 0
        self._bar_context: AbstractContextManager[ProgressBar] | None = None
        self._stop = threading.Event()
        self._refresher: threading.Thread | None = None

    def begin(self, total: int | None, choice: Choice, progress: Progress) -> None:
        from petmjx.show.progress import progress as progress_bar

        self.total = total
        what = self._what.removesuffix("s") if total == 1 else self._what
        how_many = "" if total is None else f"{total:,} {what} "
        print(f"{how_many}on engine {choice.name} ({choice.reason})", file=sys.stderr)
        self._bar_context = progress_bar(total, self._what)
        bar = self._bar_context.__enter__()

        def refresh() -> None:
            while True:
                stopped = self._stop.wait(_REFRESH_S)
                bar.update(self._done, progress.message)
                if stopped:
                    return

        self._refresher = threading.Thread(target=refresh, name="petmjx-progress", daemon=True)
        self._refresher.start()

    def world_done(self, result: WorldResult | SweptWorld) -> None:
        self._done += 1

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stop.set()
        if self._refresher is not None:
            self._refresher.join()
        if self._bar_context is not None:
            self._bar_context.__exit__(None, None, None)


def default_folder() -> Path:
    return Path("petmjx-results") / datetime.now().strftime("%Y%m%d-%H%M%S")


def _thresholds(shift_limit_m: float, tilt_limit_deg: float) -> Thresholds:
    from pydantic import ValidationError

    from petmjx.errors import InputError

    try:
        return Thresholds(shift_m=shift_limit_m, tilt_deg=tilt_limit_deg)
    except ValidationError as error:
        problem = error.errors()[0]
        raise InputError(f"{problem['loc'][0]}: {problem['msg']}, got {problem['input']!r}") from None


def how_far(folder: Path, total: int | None, what: str = "plans") -> str:
    """What an interrupted run left behind, in words."""
    from petmjx.errors import InputError
    from petmjx.results.reader import load_run

    try:
        done = load_run(folder).info["counts"]["worlds"]
    except InputError:
        return f"before the first {what.removesuffix('s')}; nothing was written"
    of = "" if total is None else f" of {total:,}"
    return f"{done:,}{of} {what} are done and in {folder}"


def _show(results: RunResults, as_json: bool) -> None:
    if as_json:
        print(json.dumps({"out": str(results.path), **brief(results.info)}, indent=2))
        return
    from petmjx.show.tables import FEW_PLANS, summary_table, worlds_table

    console = results_console()
    if len(results.worlds) <= FEW_PLANS:
        console.print(worlds_table(results.worlds.sort_values(["plan_id", "variant"]), results.boxes))
        console.print()
    print_notes(console, results.info)
    console.print(summary_table(results.info, results.path))


def brief(info: dict[str, Any]) -> dict[str, Any]:
    return {name: info[name] for name in ("status", "counts", "timings", "device", "skipped", "warnings")}


def print_notes(console: Any, info: dict[str, Any]) -> None:
    """Skipped plans, a line each as far as there is room, and how many plans are odd."""
    skipped = info["skipped"]
    for entry in skipped[:_SHOWN_SKIPPED]:
        console.print(f"skipped: {entry['error']}", style="yellow", markup=False, highlight=False, soft_wrap=True)
    if len(skipped) > _SHOWN_SKIPPED:
        console.print(f"skipped: {len(skipped) - _SHOWN_SKIPPED} more, in run.json", style="yellow", highlight=False)
    if info["warnings"]:
        console.print(
            f"{len(info['warnings'])} plans with overlapping, floating or outside boxes, listed in run.json",
            style="yellow",
            highlight=False,
        )
