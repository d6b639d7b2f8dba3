"""Markdown tables of results, from their JSON lines:

python -m benchmarks.table benchmarks/results/*.jsonl [--readme benchmarks/README.md]
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from petmjx.errors import InputError

BEGIN = "<!-- tables: begin (made by benchmarks.table) -->"
END = "<!-- tables: end -->"

Result = Mapping[str, Any]
Cell = Callable[[Result], str]


def read_results(paths: Sequence[Path]) -> list[dict[str, Any]]:
    """All results in the files, in their order.

    Raises:
        InputError: a file that cannot be read, or a line that is no JSON object.
    """
    results = []
    for path in paths:
        try:
            lines = path.read_text(encoding="utf-8").splitlines()
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
        for number, line in enumerate(lines, start=1):
            if not line.strip():
                continue
            try:
                result = json.loads(line)
            except ValueError as error:
                raise InputError(f"{path}: line {number}: no JSON: {error}") from error
            if not isinstance(result, dict):
                raise InputError(f"{path}: line {number}: must be a JSON object")
            results.append(result)
    return results


def latest(results: Sequence[Result]) -> list[Result]:
    """Of results that measure the same on the same device, the last one; in the order of their first."""
    identity = ("benchmark", "case", "physics", "engine", "device", "threads", "lanes", "plans", "skip", "repetition")
    kept = {tuple(str(result.get(name)) for name in identity): result for result in results}
    return list(kept.values())


def tables(results: Sequence[Result]) -> str:
    """All tables for which there are results, with a heading each."""
    shown = latest(results)
    suite = [result for result in shown if "benchmark" not in result]
    parts = [
        _section("Workloads, from file to Parquet", [r for r in suite if _kind(r) == "workload"], _WORKLOAD),
        _section("Agreement", [r for r in shown if r.get("agreement")], _AGREEMENT, rows=_by_yardstick),
        _section("Time against the number of plans", [r for r in suite if _kind(r) == "scale"], _SCALE),
        _section("Full stacks", [r for r in suite if _kind(r) == "stacks"], _STACKS),
        _section("Plain Python loops", [r for r in suite if _kind(r) == "plain"], _PLAIN),
        _section("One thread, packing_plan_a", _of(shown, "single_thread"), _SINGLE_THREAD),
        _section("Threads of the engine mujoco", _of(shown, "threads"), _THREADS),
    ]
    return "\n".join(part for part in parts if part)


def _kind(result: Result) -> str:
    case = str(result.get("case", ""))
    for prefix, kind in (("scale-", "scale"), ("stacks-", "stacks"), ("plain-loop", "plain")):
        if case.startswith(prefix):
            return kind
    return "workload"


def _of(results: Sequence[Result], benchmark: str) -> list[Result]:
    return [result for result in results if result.get("benchmark") == benchmark]


def _section(
    title: str,
    results: Sequence[Result],
    columns: Mapping[str, Cell],
    rows: Callable[[Sequence[Result]], list[Result]] = list,
) -> str:
    if not results:
        return ""
    lines = [f"### {title}", "", "| " + " | ".join(columns) + " |", "| " + " | ".join("---" for _ in columns) + " |"]
    lines += ["| " + " | ".join(cell(row) for cell in columns.values()) + " |" for row in rows(results)]
    return "\n".join(lines) + "\n"


def _by_yardstick(results: Sequence[Result]) -> list[Result]:
    """A row for each yardstick that a result was compared with."""
    return [
        {**result, "yardstick": label, "found": found}
        for result in results
        for label, found in result["agreement"].items()
    ]


def _text(name: str) -> Cell:
    return lambda result: str(result.get(name) or "").replace("|", "/")


def _number(name: str, form: str = ".3g", unit: str = "") -> Cell:
    def cell(result: Result) -> str:
        value = result.get(name)
        return "-" if value is None else f"{value:{form}}{unit}"

    return cell


def _width(result: Result) -> str:
    """Threads, or worlds side by side."""
    if result.get("threads"):
        return f"{result['threads']} threads"
    lanes = [value for key, value in result.get("stages", {}).items() if key.endswith(" lanes")]
    return f"{max([*lanes, result.get('lanes') or 0]):,.0f} lanes" if lanes or result.get("lanes") else ""


def _device(result: Result) -> str:
    return str(result.get("device", "")).removeprefix("NVIDIA ").split(",")[0]


def _verdicts(result: Result) -> str:
    counts = result.get("counts", {})
    return " / ".join(str(counts.get(verdict, 0)) for verdict in ("stable", "unstable", "invalid"))


def _mean_boxes(result: Result) -> str:
    return f"{result['boxes'] / result['plans']:.1f}" if result.get("plans") else "-"


def _ms_per_plan(result: Result) -> str:
    return f"{1000 / result['plans_per_s']:.3g}" if result.get("plans_per_s") else "-"


def _same(result: Result) -> str:
    found = result["found"]
    share = found["share"]
    return f"{found['same']} of {found['common']}" + ("" if share is None else f" ({100 * share:.2f} %)")


def _force(result: Result) -> str:
    force = result["found"]["rest_top_force"]
    if not force["boxes"]:
        return "-"
    return f"{100 * force['median']:.2g} % / {100 * force['p95']:.2g} %"


_WHO: dict[str, Cell] = {"case": _text("case"), "engine": _text("engine"), "on": _device, "": _width}
_WORKLOAD: dict[str, Cell] = {
    **_WHO,
    "plans": _number("plans", ","),
    "plans/s": _number("plans_per_s"),
    "steps/s": _number("world_steps_per_s", ",.0f"),
    "run": _number("run_s", ".1f", " s"),
    "compile": _number("compile_s", ".1f", " s"),
    "stable / unstable / invalid": _verdicts,
    "note": _text("note"),
}
_AGREEMENT: dict[str, Cell] = {
    **_WHO,
    "against": _text("yardstick"),
    "same verdict": _same,
    "stable here, dropped there": lambda result: str(len(result["found"]["stable_here_dropped_there"])),
    "resting forces, median / 95 %": _force,
}
_SCALE: dict[str, Cell] = {
    **_WHO,
    "plans": _number("plans", ","),
    "ms/plan": _ms_per_plan,
    "plans/s": _number("plans_per_s"),
    "run": _number("run_s", ".1f", " s"),
    "host memory": lambda result: f"{result['peak_rss_bytes'] / 1e9:.2f} GB",
}
_STACKS: dict[str, Cell] = {
    **_WHO,
    "worlds": _number("plans", ","),
    "steps/s": _number("world_steps_per_s", ",.0f"),
    "compile": _number("compile_s", ".1f", " s"),
}
_PLAIN: dict[str, Cell] = {
    "case": _text("case"),
    "on": _device,
    "plans": _number("plans", ","),
    "boxes a plan": _mean_boxes,
    "plans/s": _number("plans_per_s"),
    "steps/s": _number("world_steps_per_s", ",.0f"),
    "note": _text("note"),
}
_SINGLE_THREAD: dict[str, Cell] = {
    "physics": _text("physics"),
    "case": _text("case"),
    "CPU time": _number("cpu_s", ".3f", " s"),
    "× loop, waiting in the air": _number("times_plain_air", ".2f"),
    "× loop, waiting on the floor": _number("times_plain_floor", ".2f"),
    "on": _device,
}
_THREADS: dict[str, Cell] = {
    "plans": _number("plans"),
    "threads": _number("threads"),
    "wall time": _number("wall_s", ".2f", " s"),
    "× 1 thread": _number("times_first", ".2f"),
    "on": _device,
}


def write_between_markers(readme: Path, text: str) -> None:
    """Replace what stands between the two markers of a file.

    Raises:
        InputError: the file lacks a marker, or cannot be read or written.
    """
    try:
        before, begin, rest = readme.read_text(encoding="utf-8").partition(BEGIN)
        _, end, after = rest.partition(END)
        if not (begin and end):
            raise InputError(f"{readme}: lacks the markers {BEGIN} and {END}")
        readme.write_text(f"{before}{BEGIN}\n\n{text}\n{END}{after}", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{readme}: {error.strerror or error}") from error


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line of the module's docstring."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path, nargs="+", help="files of JSON lines")
    parser.add_argument("--readme", type=Path, help="write the tables between this file's markers instead of printing")
    options = parser.parse_args(arguments)
    text = tables(read_results(options.results))
    if options.readme is None:
        print(text)
    else:
        write_between_markers(options.readme, text)


if __name__ == "__main__":
    main()
