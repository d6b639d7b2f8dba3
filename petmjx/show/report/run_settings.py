"""The settings of a run in a report: options, versions, files, skipped plans and warnings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

from petmjx.common.text import count_text, duration, printable_name, three_digits
from petmjx.options.simulation import Simulation
from petmjx.results.run_reader import FINISHED, split_warnings
from petmjx.show.pages.markup import NOTHING, Content, Markup, element, joined_markup
from petmjx.show.report.report_runs import Kind, ReportRun

MOST_LINES: Final = 20
"""Largest number of skipped plans, of warnings and of files that are listed. Further entries are only counted."""


def about(run: ReportRun) -> Markup:
    """The settings of a run, and lists of skipped plans and warnings."""
    facts = [part for name, value in _facts(run) for part in (element("dt", name), element("dd", value))]
    warnings, odd = split_warnings(run.info)
    skipped = [str(entry.get("error") or entry.get("source")) for entry in run.info.get("skipped", [])]
    lists = (
        _lines(skipped, count_text(len(skipped), "plan or file was", "plans or files were") + " skipped"),
        _lines(warnings, count_text(len(warnings), "warning")),
        _lines(odd, count_text(len(odd), "plan has", "plans have") + " overlapping, floating or outside boxes"),
    )
    return joined_markup(element("dl", *facts, class_="facts"), *lists)


def _facts(run: ReportRun) -> Iterator[tuple[str, Content]]:
    info = run.info
    config = info.get("config", {})
    yield "folder", str(run.results.path)
    yield "command", _command(run)
    unfinished = run.results.unfinished
    status = unfinished or FINISHED
    expected, n_done = info.get("expected_worlds"), info.get("counts", {}).get("worlds", 0)
    missing = (
        f"; {count_text(expected - n_done, run.what)} not simulated"
        if expected is not None and expected > n_done
        else ""
    )
    is_partial = unfinished or missing
    yield "status", element("strong", status + missing, class_="warn") if is_partial else status
    yield "started", str(info.get("started", "")).replace("T", " ").replace("+00:00", " UTC")
    seconds = float(info.get("timings", {}).get("wall_s") or 0.0)
    if seconds > 0:
        rate = three_digits(n_done / seconds)
        yield "took", f"{duration(seconds)} ({rate} {run.what}s/s)"
    yield "engine", f"{config.get('engine', 'unknown')} on {info.get('device') or 'an unnamed device'}"
    yield "options", _options(config)
    yield "files", _files(run)
    yield "versions", ", ".join(f"{name} {version}" for name, version in info.get("versions", {}).items())


def _command(run: ReportRun) -> str:
    config = run.info.get("config", {})
    if run.kind is Kind.CONFIDENCE:
        return f"score, each plan also in {config['confidence']:,} worlds with errors"
    if run.kind.sweeps:
        sweep = config.get("sweep") or {}
        name = sweep.get("name") or "sweep"
        kind = "chain" if run.kind is Kind.CHAIN else "sweep"
        return f"{kind} “{name}”" + (f": {sweep['description']}" if sweep.get("description") else "")
    return str(config.get("command", "unknown"))


def _options(config: Mapping[str, Any]) -> Content:
    """A list of the options whose values differ from their defaults."""
    simulation = config.get("simulation")
    if not isinstance(simulation, Mapping):
        return "unknown"
    limit = "world_timeout_s"  # the only option of ``RunOptions`` that affects verdicts
    changed = [
        *changed_options(simulation, Simulation().model_dump(mode="json")),
        *changed_options({limit: config.get(limit)}, {limit: None}),
    ]
    if not changed:
        return "all at their defaults"
    items = [
        element("li", element("code", name), f" {_option_text(value)} instead of {_option_text(default)}")
        for name, value, default in changed
    ]
    return element("ul", *items)


def changed_options(
    values: Mapping[str, Any], defaults: Mapping[str, Any], path: str = ""
) -> Iterator[tuple[str, Any, Any]]:
    """Yield (option, value, default) for every option whose value differs from its default. The name of an option in a
    table has dots, such as "thresholds.tilt_deg"."""
    for name, value in values.items():
        at = f"{path}.{name}" if path else str(name)
        default = defaults.get(name)
        if isinstance(value, Mapping) and isinstance(default, Mapping):
            yield from changed_options(value, default, at)
        elif value != default:
            yield at, value, default


def _option_text(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(_option_text, value))
    if isinstance(value, Mapping):  # a carrier that the user has defined
        return printable_name(str(value.get("name")))
    return "none" if value is None else str(value)


def _files(run: ReportRun) -> Content:
    plans = run.results.plans
    if plans.empty:
        return "unknown"
    counts = plans["source"].value_counts(sort=False)
    items = [
        element("li", f"{source or 'plans given in Python'}: {count_text(int(n), 'plan')}")
        for source, n in counts.items()
    ]
    more_item = element("li", f"{len(items) - MOST_LINES:,} more files") if len(items) > MOST_LINES else NOTHING
    return element("ul", *items[:MOST_LINES], more_item)


def _lines(lines: list[str], title: str) -> Markup:
    """A list that the reader can open by a click on its title."""
    if not lines:
        return NOTHING
    items = [element("li", line) for line in lines[:MOST_LINES]]
    more_text = f"{len(lines) - MOST_LINES:,} more, in run.json"
    items += [element("li", more_text, class_="hint")] if len(lines) > MOST_LINES else []
    return element("details", element("summary", title), element("ul", *items, class_="lines"))
