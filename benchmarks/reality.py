"""A gallery of measurements: measured values, petmjx's values, and the differences (docs/reality-measured.md).

The page docs/reality-measured.md shows the ``rows`` of all parts, and its text quotes the ``study`` of the tosses.
Measured figures come from the sources named beside them; no data file is part of the repository.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

from benchmarks.cube_toss_study import MUJOCO_OWN, calibration, compared, friction, spread
from benchmarks.cube_tosses import RESTITUTION, read_tosses
from benchmarks.result_fields import environment
from petmjx.results.share_statistics import wilson_interval

BEGIN: Final = "<!-- measured: begin (made by python -m benchmarks reality) -->"
END: Final = "<!-- measured: end -->"

PARTS: Final = {
    "friction": "benchmarks.real_friction",
    "landings": "benchmarks.landings",
    "rocking": "benchmarks.rocking",
    "soft columns": "benchmarks.soft_columns",
}
"""Part of the gallery → the module with its ``rows(engine)``. The part about tosses, which needs data, is not listed
here."""

TOSSES: Final = "tosses"

ALL_ENGINES: Final = "all"
"""The engine of rows that are equal on all engines."""

CASE: Final = re.compile(r"\d+(?:\.\d+)?(?: × \d+(?:\.\d+)?)?")
"""A number, or a size such as ``150 × 600``, in the name of a quantity."""


@dataclass(frozen=True)
class Row:
    """A line of the gallery.

    Attributes:
        quantity: the measured quantity.
        source: authors and publication.
        measured: the measured value, with unit.
        petmjx: petmjx's value, with unit.
        miss: by how much petmjx misses, with unit.
        engine: the engine that computed petmjx's value.
        note: an important fact about the row; "" if there is none.
        holds: whether petmjx reaches the goal; None if there is no goal.
    """

    quantity: str
    source: str
    measured: str
    petmjx: str
    miss: str
    engine: str
    note: str = ""
    holds: bool | None = None

    @classmethod
    def of(cls, row: Any) -> Row:
        """A row, also one of numbers alone: their ``quantity`` with its unit, ``source``, ``expected``, ``value`` and
        ``engine``; and a table with ``quantity``, ``source``, ``measured``, ``petmjx``, ``miss`` and ``engine``, whose
        miss is 0 if petmjx reaches the goal."""
        if isinstance(row, cls):
            return row
        if isinstance(row, Mapping):
            miss, texts = row["miss"], {name: str(value) for name, value in row.items()}
            return cls(**{**texts, "miss": f"{miss:g}"}, holds=miss == 0)
        miss = row.value - row.expected
        return cls(row.quantity, row.source, f"{row.expected:.4g}", f"{row.value:.4g}", f"{miss:+.2g}", row.engine)


def gallery(parts: list[str], engines: list[str], data: Path, limit: int | None = None) -> Iterator[dict[str, Any]]:
    """A result for each part and engine, with its rows.

    Args:
        parts: names of ``PARTS``, or ``TOSSES``.
        data: the folder of measurements, or the file of the tosses.
        limit: number of tosses.

    Raises:
        InputError: the tosses are not there.
    """
    for part in parts:
        for number, engine in enumerate(engines):
            measures: dict[str, Any] = {}
            if part == TOSSES:
                # friction and confidence of the data are computed on one engine only
                measures, rows = _tosses(data, limit, engine, complete=number == 0)
            else:
                find: Callable[[str], Iterator[Any]] = importlib.import_module(PARTS[part]).rows
                rows = [Row.of(row) for row in find(engine)]
            yield {
                "case": f"reality-{part.replace(' ', '-')}",
                "group": "reality",
                "engine": engine,
                "rows": [asdict(row) for row in rows],
                **measures,
                **environment(),
            }


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """The rows of all results as Markdown, a table for each part; missed goals are marked. Equal values of all engines
    share one row, and so do quantities that differ in one number (``merged``)."""
    words = {True: "holds", False: "**fails**", None: ""}
    parts: dict[str, dict[Row, None]] = {}
    for result in results:
        name = str(result["case"]).removeprefix("reality-").replace("-", " ").capitalize()
        parts.setdefault(name, {}).update(dict.fromkeys(Row(**values) for values in result["rows"]))
    lines = []
    for name, rows in parts.items():
        lines += [f"### {name}", "", "| quantity | measured | petmjx | misses by | engine | | source |"]
        lines += [f"| {' | '.join(['---'] * 7)} |"]
        for row in merged(list(rows)):
            note = ": ".join(filter(None, (words[row.holds], row.note)))
            engine = row.engine if row.engine == ALL_ENGINES else f"`{row.engine}`"
            cells = (row.quantity, row.measured, row.petmjx, row.miss, engine, note, row.source)
            lines.append(f"| {' | '.join(cells)} |")
        lines.append("")
    return "\n".join(lines)


def merged(rows: Sequence[Row]) -> list[Row]:
    """The rows, of which those whose quantities differ in one number (or size) become one row.

    The merged row lists the numbers and, in the same order, the values. Rows are merged only if they have the same
    source, engine and note, and all reach their goals or all miss them.
    """

    def family(row: Row, number: re.Match[str]) -> tuple[object, ...]:
        """What rows that are merged have in common."""
        others = row.quantity[: number.start()], row.quantity[number.end() :]
        return *others, row.source, row.engine, row.note, row.holds

    numbers = {row: list(CASE.finditer(row.quantity)) for row in rows}
    sizes = Counter(family(row, number) for row in rows for number in numbers[row])
    families: dict[object, list[tuple[Row, re.Match[str] | None]]] = {}
    for row in rows:
        number = max(numbers[row], key=lambda number: sizes[family(row, number)], default=None)
        families.setdefault(row if number is None else family(row, number), []).append((row, number))
    return [_joined(members) for members in families.values()]


def _joined(members: Sequence[tuple[Row, re.Match[str] | None]]) -> Row:
    """One row for rows whose quantities differ in the given number."""
    first, number = members[0]
    if len(members) == 1 or number is None:
        return first

    def values(column: str) -> str:
        texts = [getattr(row, column) for row, _ in members]
        return texts[0] if len(set(texts)) == 1 else "; ".join(texts)

    numbers = ", ".join(case[0] for _, case in members if case is not None)
    quantity = first.quantity[: number.start()] + numbers + first.quantity[number.end() :]
    return replace(first, quantity=quantity, measured=values("measured"), petmjx=values("petmjx"), miss=values("miss"))


def percent(share: float, digits: int = 1) -> str:
    """A share as documents write it."""
    return f"{100 * share:.{digits}f} %"


def present(part: str) -> bool:
    """Whether a part has rows."""
    if part == TOSSES:
        return True
    has_module = importlib.util.find_spec(PARTS[part]) is not None
    return has_module and hasattr(importlib.import_module(PARTS[part]), "rows")


_CUBE: Final = "ContactNets cube (DAIRLab, CoRL 2020)"
_RIGHT_FACE: Final = 0.835
_PLACE_MM: Final = 24.0
_PATH_MM: Final = 15.0
_FRICTION_WITHIN: Final = 0.02
"""Goals of the tosses: MuJoCo's own contacts reach 84 %, 25 mm and 15 mm on all 570."""
_LEAST_P: Final = 0.01
"""P-value of a test below which two distributions differ."""
_NAMES: Final = {
    "way_mm": ("distance moved along the ground", " mm"),
    "turn_deg": ("total rotation", "°"),
    "duration_s": ("time to rest", " s"),
}


def _tosses(data: Path, limit: int | None, engine: str, *, complete: bool) -> tuple[dict[str, Any], list[Row]]:
    tosses = read_tosses(data, limit)
    n = len(tosses)
    measures: dict[str, Any] = {"tosses": compared(tosses, engine)}
    measures["tosses_that_bounce"] = compared(tosses, engine, restitution=RESTITUTION)
    rows = list(_rows_of_errors(measures["tosses"], f"{n} tosses", n, engine))
    rows += _rows_of_errors(measures["tosses_that_bounce"], f"{n} tosses with restitution {RESTITUTION}", n, engine)
    if complete:
        measures |= {
            study.__name__: study(tosses, engine, restitution=RESTITUTION) for study in (spread, friction, calibration)
        }
        measures["mujoco_own"] = compared(tosses, engine, physics=MUJOCO_OWN)
        measures["spread_as_shipped"] = spread(tosses, engine)
        measures["spread_mujoco_own"] = spread(tosses, engine, physics=MUJOCO_OWN)
        rows += _rows_of_spread(measures["spread"], engine)
        rows.append(_row_of_faces(measures["spread_as_shipped"], "by default", engine))
        right = percent(measures["mujoco_own"]["right_face"])
        note = f"if simulated from the measured starts, {right} of tosses end with the measured face up"
        rows.append(_row_of_faces(measures["spread_mujoco_own"], "with MuJoCo's own contacts", engine, note))
        rows += _rows_of_friction(measures["friction"], engine)
        rows += _rows_of_calibration(measures["calibration"], engine)
    return measures, rows


def _rows_of_errors(measures: Mapping[str, Any], name: str, n: int, engine: str) -> Iterator[Row]:
    face, place, path = measures["right_face"], measures["place_median_mm"], measures["path_mean_mm"]
    low, high = map(float, wilson_interval(round(face * n), n))
    yield Row(
        f"{name}: share that ends with the measured face up", _CUBE, percent(1), percent(face),
        percent(1 - face), engine,
        f"the goal is {percent(_RIGHT_FACE)}; 95 % interval of petmjx's share: {percent(low)} to {percent(high)}",
        face >= _RIGHT_FACE,
    )  # fmt: skip
    yield Row(
        f"{name}: error of the place at the end", _CUBE, "by motion capture", "–",
        f"{place:.1f} mm in the median", engine,
        f"the goal is at most {_PLACE_MM:g} mm", place <= _PLACE_MM,
    )  # fmt: skip
    yield Row(
        f"{name}: error of place and orientation along the path", _CUBE, "by motion capture", "–",
        f"{path:.1f} mm, {measures['turn_mean_deg']:.1f}° in the mean", engine, f"the goal is at most {_PATH_MM:g} mm",
        path <= _PATH_MM,
    )  # fmt: skip
    for quantity, test in measures["distributions"].items():
        words, unit = _NAMES[quantity]
        ours, theirs = test["petmjx_median"], test["measured_median"]
        yield Row(
            f"{name}: distribution of {words}", _CUBE, f"median {theirs:.3g}{unit}", f"median {ours:.3g}{unit}",
            f"KS distance {test['ks']:.2f}, p = {test['p']:.2g}", engine, "two-sample Kolmogorov–Smirnov test",
            test["p"] >= _LEAST_P,
        )  # fmt: skip


def _rows_of_spread(measures: Mapping[str, Any], engine: str) -> Iterator[Row]:
    runs, sigma = measures["runs"], measures["noise"]
    uncertain = (
        f"{1000 * sigma['pos_m']:.2f} mm, {math.degrees(sigma['turn_rad']):.2f}°, {1000 * sigma['vel_m_s']:.0f} mm/s, "
        f"{sigma['angvel_rad_s']:.2f} rad/s"
    )
    yield Row(
        f"median distance of the places where {runs} simulations of a toss with uncertain starts end", _CUBE,
        f"{measures['from_measured_median_mm']:.1f} mm from the measured place",
        f"{measures['between_runs_median_mm']:.1f} mm from each other",
        f"{measures['from_measured_median_mm'] / measures['between_runs_median_mm']:.1f} times", engine,
        "with a perfect model of a perfect cube, the two distances would be equal; standard deviations of the starts: "
        f"{uncertain}",
    )  # fmt: skip
    yield _row_of_faces(measures, f"with restitution {RESTITUTION}", engine)


def _row_of_faces(measures: Mapping[str, Any], contacts: str, engine: str, note: str = "") -> Row:
    """How often a run of a toss with uncertain starts ends with the measured face up, and how often two runs of the
    same toss end with the same face up."""
    measured, runs_agree = measures["same_face_as_measured"], measures["same_face_between_runs"]
    return Row(
        f"face that is up at the end, in simulations of tosses with uncertain starts, {contacts}", _CUBE,
        f"{percent(measured)} of simulations agree with the measurement",
        f"{percent(runs_agree)} of pairs of simulations of one toss agree", percent(runs_agree - measured),
        engine, note,
    )  # fmt: skip


def _rows_of_friction(measures: Mapping[str, Any], engine: str) -> Iterator[Row]:
    for name, half in zip(("one half", "the other half"), measures["halves"], strict=True):
        other, miss = half["errors_of_other_half"], half["friction"] - measures["published"]
        yield Row(
            f"friction fitted to {name} of the tosses", _CUBE, f"{measures['published']}", f"{half['friction']}",
            f"{abs(miss):.3f}", engine,
            f"of the tosses not used for the fit, {percent(other['right_face'])} end with the measured face up; "
            f"errors: place {other['place_median_mm']:.1f} mm, path {other['path_mean_mm']:.1f} mm",
            abs(miss) <= _FRICTION_WITHIN + 1e-9,
        )  # fmt: skip


def _rows_of_calibration(measures: Mapping[str, Any], engine: str) -> Iterator[Row]:
    mu, sigma = measures["friction"]
    for region, share in measures["within"].items():
        level, error = float(region), measures["standard_error"][region]
        yield Row(
            f"share of tosses whose measured end lies in the {percent(level, 0)} region of {measures['members']} draws",
            _CUBE, percent(share), percent(level, 0), percent(abs(share - level)), engine,
            f"draws have friction {mu} ± {sigma} and the errors of measured starts; standard error {percent(error)}",
            abs(share - level) <= 3 * error,
        )  # fmt: skip
    chance, likeliest = measures["chance_of_measured_face"], measures["chance_of_members_face"]
    yield Row(
        "face that is up at the end, in draws (simulations with random errors)", _CUBE,
        f"{percent(chance)} of draws show the measured face",
        f"{percent(likeliest)} of pairs of draws of the same toss agree", percent(likeliest - chance), engine,
        "the difference of the two shares shows how overconfident petmjx is about the face",
    )  # fmt: skip
