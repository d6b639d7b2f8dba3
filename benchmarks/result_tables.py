"""Markdown tables of results."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from benchmarks.result_fields import Result
from petmjx.common.errors import InputError
from petmjx.common.text import count_text
from petmjx.engines.verdict import Verdict

BEGIN = "<!-- tables: begin (made by python -m benchmarks table) -->"
END = "<!-- tables: end -->"

_IDENTITY = ("case", "physics", "engine", "threads", "lanes", "plans", "skip", "repetition", "way")


def tables(results: Sequence[Result]) -> str:
    """All tables for which there are results, each with a heading."""
    shown = latest(results)
    of_group = {group: [row for row in shown if row.get("group") == group] for group in SECTIONS}
    rows = {group: [row for row in some if row["way"] != "agreement"] for group, some in of_group.items()}
    rows |= {group: _quickest(rows[group], seconds) for group, seconds in _IN_TURNS.items()}
    agreements = [
        {**result, "reference": label, "found": agreement}
        for result in shown
        for label, agreement in result.get("agreement", {}).items()
    ]
    rows["agreement"] = [row for row in agreements if "same" in row["found"]]
    rows["shares"] = [row for row in agreements if "shares" in row["found"]]
    return "\n".join(_section(*section, rows[name]) for name, section in SECTIONS.items() if rows[name])


def latest(results: Iterable[Result]) -> list[Result]:
    """For each measurement on each device, its last result, in the order of the first results."""
    return list({(*(result.get(name) for name in _IDENTITY), _device(result)): result for result in results}.values())


def _quickest(rows: Sequence[Result], seconds: str) -> list[Result]:
    """The fastest run of each case of a group whose cases ran in turns, with its speed relative to the other cases."""
    best: dict[tuple[str, str], Result] = {}
    for row in rows:
        key = (row["case"], _device(row))
        if key not in best or best[key]["commit"] != row["commit"] or row[seconds] < best[key][seconds]:
            best[key] = row

    def times(row: Result, other: str) -> float | None:
        base = best.get((other, _device(row)))
        return base[seconds] / row[seconds] if base else None

    references = {name: f"one-plan-{{physics}}-{name}" for name in ("loop-air", "loop-floor")} | {"1": "threads-1"}
    return [
        {**{f"times {name}": times(row, case.format_map(row)) for name, case in references.items()}, **row}
        for row in best.values()
    ]


_IN_TURNS = {"one-plan": "cpu_s", "threads": "wall_s"}
"""Groups whose cases take turns → the time that counts. Other work on the machine can only slow a run down."""

_COLUMNS = {
    "case": "case",
    "engine": "engine",
    "on": "on",
    "": "width",
    "plans": "plans|,",
    "worlds": "plans|,",
    "boxes a plan": "mean_boxes|.1f",
    "ms/plan": "ms|.3g",
    "plans/s": "plans_per_s|.3g",
    "steps/s": "world_steps_per_s|,.0f",
    "CPU time": "cpu_s|.3f| s",
    "× loop, waiting in the air": "times loop-air|.2f",
    "× loop, waiting on the floor": "times loop-floor|.2f",
    "worlds driven": "drives|,.0f",
    "worlds/s": "drives_per_s|.3g",
    "run": "run_s|.1f| s",
    "wall time": "wall_s|.2f| s",
    "× 1 thread": "times 1|.2f",
    "a call": "call_s|.3f| s",
    "its steps alone": "steps_s|.3f| s",
    "call / steps": "ratio|.2f",
    "call / steps before": "ratio_before|.2f",
    "compile": "compile_s|.1f| s",
    "host memory": "rss_gb|.2f| GB",
    "stable / unstable / invalid": "verdicts",
    "note": "note",
    "against": "reference",
    "same verdict": "same",
    "stable here, dropped there": "dropped",
    "resting forces, median / 95 %": "force",
    "each share in the other's 95 % interval": "agree",
    "overlap": "overlap",
}
"""Heading → content of its cells: ``field|format|unit`` of a result or of ``_derived``."""

SECTIONS = {
    "W": (
        "Workload W, from file to Parquet",
        "plans; plans/s; steps/s; run; compile; stable / unstable / invalid; note",
    ),
    "agreement": ("Agreement", "against; same verdict; stable here, dropped there; resting forces, median / 95 %"),
    "scale": ("Time against the number of plans", "plans; ms/plan; plans/s; run; host memory"),
    "stacks": ("Full stacks", "worlds; steps/s; compile"),
    "plain": ("Plain Python loop", "plans; boxes a plan; plans/s; steps/s; note"),
    "one-plan": ("One plan on one thread", "CPU time; × loop, waiting in the air; × loop, waiting on the floor"),
    "threads": ("Threads of the engine mujoco", "plans; wall time; × 1 thread"),
    "warm-call": ("A call in a warm process", "plans; a call; its steps alone; call / steps; call / steps before"),
    "sweeps": ("Sweeps, from settled states", "plans; worlds driven; worlds/s; wall time; compile; note"),
    "shares": ("How often plans stand", "against; each share in the other's 95 % interval; overlap"),
}
"""Group → title of its table, and its columns after the first four."""


def _section(title: str, columns: str, rows: Sequence[Result]) -> str:
    heads = ["case", "engine", "on", "", *columns.split("; ")]
    lines = [heads, ["---"] * len(heads)]
    lines += [[_cell({**row, **_derived(row)}, _COLUMNS[head]) for head in heads] for row in rows]
    return "\n".join([f"### {title}", "", *(f"| {' | '.join(line)} |" for line in lines)]) + "\n"


def _cell(row: Result, column: str) -> str:
    name, form, unit = [*column.split("|"), "", ""][:3]
    value = row.get(name)
    return "-" if value is None else f"{value:{form}}{unit}".replace("|", "/")


def _derived(row: Result) -> Result:
    """Values made from a result's fields; None if a field is missing."""
    agreement, counts, timings = row.get("found", {}), row.get("counts", {}), row.get("timings", {})
    force, shares = agreement.get("rest_top_force", {}), agreement.get("shares", {})
    missed, plans, drives = agreement.get("stable_here_dropped_there"), row.get("plans"), timings.get("drives")
    lanes = [value for key, value in row.get("stages", {}).items() if key.endswith(" lanes")] + [row.get("lanes") or 0]
    width = count_text(row["threads"], "thread") if row.get("threads") else f"{max(lanes):,.0f} lanes"
    return {
        "on": _device(row),
        "width": width if row.get("threads") or max(lanes) else "",
        "verdicts": " / ".join(str(counts.get(verdict.value, 0)) for verdict in Verdict),
        "ms": 1000 / row["plans_per_s"] if "plans_per_s" in row else None,
        "mean_boxes": row["boxes"] / plans if plans and "boxes" in row else None,
        "rss_gb": row["peak_rss_bytes"] / 1e9 if "peak_rss_bytes" in row else None,
        "drives": drives,
        "drives_per_s": drives / timings["drive_s"] if drives else None,
        "same": f"{agreement['same']} of {agreement['common']} ({100 * agreement['share']:.2f} %)"
        if agreement.get("common")
        else None,
        "dropped": None if missed is None else len(missed),
        "force": f"{100 * force['median']:.2g} % / {100 * force['p95']:.2g} %" if force.get("boxes") else None,
        "agree": f"{shares['agree']} of {shares['plans']}" if shares else None,
        "overlap": f"{shares['intervals_overlap']} of {shares['plans']}" if shares else None,
    }


def _device(result: Result) -> str:
    return str(result.get("device", "")).removeprefix("NVIDIA ").split(",")[0]


def write_between_markers(readme: Path, text: str, begin: str = BEGIN, end: str = END) -> None:
    """Replace the text between the two markers in a file.

    Raises:
        InputError: the file lacks a marker, or cannot be read or written.
    """
    try:
        before, begun, rest = readme.read_text(encoding="utf-8").partition(begin)
        _, ended, after = rest.partition(end)
        if not (begun and ended):
            raise InputError(f"{readme}: lacks the markers {begin} and {end}")
        readme.write_text(f"{before}{begin}\n\n{text}\n{end}{after}", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{readme}: {error.strerror or error}") from error
