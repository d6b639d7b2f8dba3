"""Damages thousands of run folders: each command must print the same as for the sound folder, or one line with code 2.

    PYTHONPATH=.:tests python -m support.damaged_runs --count 5000

The folders of two small runs, two shards and a sweep are damaged at random: rows and columns of a table, files, or
``run.json``. Everything that should not happen is listed with the random seed that reproduces it: tracebacks, other
exit codes, more than one line, and numbers that differ from those of the sound folder.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import random
import re
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

import petmjx
from petmjx.cli import main as command_line
from petmjx.common.errors import InputError
from petmjx.results.run_folder import OF_WORLDS, TABLES
from petmjx.results.run_writer import RunWriter
from petmjx.results.to_json import to_json
from support.damaged_files import damaged as damaged_bytes
from support.plan_files import order_for, placement, tower

PLANS: Final = {
    **{f"tower-{n}": tower(n) for n in (2, 1, 3)},
    "falls": [placement((0, 0, 0), (300, 300, 200)), placement((290, 0, 200), (300, 300, 200), article="jam")],
    "bad": [],
    "last": tower(2),
}
KPIS: Final = ("kpis", "plans.json", "--orders", "orders.json", "--run", "run", "--run", "static", "--json")
COMMANDS: Final[Mapping[str, tuple[str, ...]]] = {
    "kpis": KPIS,
    "loads": ("loads", "run", "--articles", "articles.csv", "--json"),
    "criteria": ("criteria", "plans.json", "--run", "run", "--only", "support_75", "--processes", "1", "--json"),
    "compare": ("compare", "run", "static", "--json"),
    "packers": ("compare", "--packers", "run", "static", "--json"),
    "show": ("show", "falls", "run"),
    "export": ("export", "tower-2", "run"),
    "merge": ("merge", "shard-1", "shard-2", "-o", "merged", "--overwrite"),
    "resume": ("score", "plans.json", "--engine", "mujoco", "--record", "all", "--out", "run", "--resume"),
    "report": ("report", "run", "sweep", "-o", "report.html", "--overwrite"),
}
DAMAGED: Final = ("run", "static", "shard-1", "shard-2", "sweep")


def make_sound(folder: Path) -> None:
    """Make the sound folders in ``folder``, which must be the current folder."""
    defaults = RunWriter.__init__.__kwdefaults__
    assert defaults is not None
    before = dict(defaults)
    defaults["worlds_per_part"] = 2
    try:
        (folder / "plans.json").write_text(json.dumps(PLANS))
        orders = {name: order_for(plan) for name, plan in PLANS.items() if plan}
        (folder / "orders.json").write_text(json.dumps(orders))
        (folder / "articles.csv").write_text("product_group,strength_n\nconfectionery,100\ntest,90\n")
        options: dict[str, Any] = {"engine": "mujoco", "threads": 1}
        petmjx.score("plans.json", out="run", record="all", **options)
        petmjx.score("plans.json", out="static", check="static", duration_s=0.5, orders="orders.json", **options)
        for shard in (1, 2):
            petmjx.score("plans.json", out=f"shard-{shard}", shard=f"{shard}/2", **options)
        petmjx.sweep("friction", "plans.json", out="sweep", limit=2, **options)
    finally:
        defaults.update(before)


# Kinds of damage.


def damage(run: Path, rng: random.Random) -> str:
    """Damage one thing in a run's folder. Returns a text that says what was damaged."""
    if rng.random() < 0.2:
        return _damage_info(run, rng)
    files = sorted(run.glob("*/part-*.parquet"))
    file = rng.choice(files)
    ways: tuple[Callable[[Path, random.Random], str | None], ...] = (
        _rows, _rows, _columns, _types, _values, _values, _bytes, _other_part, _other_part, _gone,
        _table_gone, _added, _no_file,
    )  # fmt: skip
    for way in rng.sample(ways, len(ways)):
        change = way(file, rng)
        if change is not None:
            return f"{run.name}/{file.parent.name}/{file.name}: {change}"
    raise AssertionError("nothing to damage")


def _rows(file: Path, rng: random.Random) -> str | None:
    table = pq.read_table(file)
    if len(table) < 1:
        return None
    rows = [*range(len(table))]
    how = rng.choice(("dropped", "doubled", "shuffled"))
    n = rng.randint(1, len(rows))
    chosen = rng.sample(rows, n)
    kept = {"dropped": [row for row in rows if row not in chosen], "doubled": rows + chosen, "shuffled": chosen}[how]
    pq.write_table(table.take(pa.array(kept, pa.int64())), file)
    return f"{how} {n} rows"


def _columns(file: Path, rng: random.Random) -> str:
    table = pq.read_table(file)
    names = rng.sample(table.column_names, rng.choice((1, 1, 2, len(table.column_names))))
    if rng.random() < 0.3:
        pq.write_table(table.rename_columns([f"{n}_" if n in names else n for n in table.column_names]), file)
        return f"renamed {names}"
    pq.write_table(table.drop_columns(names), file)
    return f"dropped {names}"


def _types(file: Path, rng: random.Random) -> str:
    table = pq.read_table(file)
    name = rng.choice(table.column_names)
    values = [
        None if value is None else rng.choice((str, lambda value: [value]))(value) for value in table[name].to_pylist()
    ]
    with contextlib.suppress(pa.ArrowException):
        table = table.set_column(table.column_names.index(name), name, [values])
        pq.write_table(table, file)
        return f"other type of {name}"
    pq.write_table(table.set_column(table.column_names.index(name), name, pa.nulls(len(table))), file)
    return f"nulls as type of {name}"


def _values(file: Path, rng: random.Random) -> str | None:
    table = pq.read_table(file)
    if not len(table):
        return None
    name = rng.choice([*table.column_names, *(["verdict"] * 6 if "verdict" in table.column_names else [])])
    values = table[name].to_pylist()
    row = rng.randrange(len(values))
    old = values[row]
    if isinstance(old, str):
        values[row] = rng.choice(
            ("stable", "unstable", "wobbly", "", None, old + "x", values[rng.randrange(len(values))])
        )
    else:
        values[row] = rng.choice((None, 0, 1, -1, 99, (old or 0) * 2))
    if values[row] == old:
        return None
    kind = table.schema.field(name)
    try:
        column = pa.array(values, kind.type)
    except (pa.ArrowException, TypeError):
        return None
    pq.write_table(table.set_column(table.column_names.index(name), kind, column), file)
    return f"{name}[{row}] {old!r} → {values[row]!r}"


def _bytes(file: Path, rng: random.Random) -> str:
    file.write_bytes(damaged_bytes(file.read_bytes(), rng))
    return "bytes"


def _other_part(file: Path, rng: random.Random) -> str | None:
    """Replace a part by a part of another table, by another part of the same table, or by a part of another run."""
    others = [
        other for other in sorted(file.parents[2].glob("*/*/part-*.parquet")) if other.read_bytes() != file.read_bytes()
    ]
    alike = [other for other in others if other.parent.name == file.parent.name]
    other = rng.choice(alike or others) if rng.random() < 0.7 else rng.choice(others)
    content = other.read_bytes()
    if rng.random() < 0.5 and other.is_relative_to(file.parents[1]):
        other.write_bytes(file.read_bytes())
    file.write_bytes(content)
    return f"is now {other.relative_to(file.parents[2])}"


def _gone(file: Path, rng: random.Random) -> str:
    file.unlink()
    return "gone"


def _table_gone(file: Path, rng: random.Random) -> str:
    shutil.rmtree(file.parent)
    return "gone with its folder"


def _added(file: Path, rng: random.Random) -> str:
    added = file.with_name(f"part-{rng.choice((7, 77)):05}.parquet")
    added.write_bytes(rng.choice((file.read_bytes(), b"PAR1")))
    return f"added as {added.name}"


def _no_file(file: Path, rng: random.Random) -> str:
    file.unlink()
    how = rng.choice(("folder", "fifo", "link", "empty"))
    if how == "folder":
        file.mkdir()
    elif how == "fifo":
        os.mkfifo(file)
    elif how == "link":
        file.symlink_to(rng.choice(("/dev/zero", "nowhere", "/etc/hostname")))
    else:
        file.write_bytes(b"")
    return f"is now: {how}"


def _damage_info(run: Path, rng: random.Random) -> str:
    file = run / "run.json"
    how = rng.choice(("bytes", "bytes", "value", "value", "key", "other", "gone"))
    if how == "bytes":
        file.write_bytes(damaged_bytes(file.read_bytes(), rng))
    elif how == "gone":
        file.unlink()
    elif how == "other":
        other = rng.choice([info_file for info_file in sorted(run.parent.glob("*/run.json")) if info_file != file])
        file.write_bytes(other.read_bytes())
    else:
        info = json.loads(file.read_text())
        inner, path = info, []
        while True:
            key = rng.choice(sorted(inner) if isinstance(inner, dict) else range(len(inner)))
            path.append(key)
            if not isinstance(inner[key], dict | list) or not inner[key] or rng.random() < 0.2:
                break
            inner = inner[key]
        if how == "key":
            del inner[key]
        else:
            inner[key] = rng.choice((None, 0, 7, -1.5, "", "x", [], {}, True))
        file.write_text(json.dumps(info))
        how = f"{how} {path}"
    return f"{run.name}/run.json: {how}"


# Commands that read damaged folders.


def read(name: str, folder: Path = Path("run")) -> tuple[int, str, str]:
    """Exit code, output (without times) and standard error of one command or function that reads runs."""
    if name in COMMANDS:
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = command_line(COMMANDS[name])
        text = re.sub(r'"wall_s": [0-9.e-]+', "", out.getvalue())
        if code == 0 and name in ("merge", "resume"):
            return read("tables", Path("merged" if name == "merge" else "run"))
        if code == 0 and name == "report":
            text = re.sub(r"\d{4}-\d\d-\d\d[T ][\d:]+\S*", "", Path("report.html").read_text())
        return code, text, err.getvalue()
    try:
        return 0, {"tables": tables_of, "tell": told}[name](folder), ""
    except InputError as error:
        return 2, "", f"petmjx: {error}\n"


def tables_of(folder: Path) -> str:
    """All tables of a run, and the counts in its ``run.json``, as text."""
    run = petmjx.load_run(folder)
    frames = {name: getattr(run, name) for name in (*TABLES, "skipped")}
    units = {name: run.units(name) for name in OF_WORLDS}
    text = {name: None if frame is None else frame.to_csv() for name, frame in frames.items() if name != "plans"}
    return json.dumps(to_json([text, units, run.info["counts"], run.plans.drop(columns="source").to_csv()]))


def told(folder: Path) -> str:
    story = petmjx.tell("falls", folder)
    return repr((story.outcome.verdict, story.outcome.margin, story.history.pos.tolist(), story.note))


READINGS: Final = (*COMMANDS, "tables", "tell")


def complaint(name: str, sound: str) -> str | None:
    """What is wrong with the result of a command on a damaged folder. None if nothing is wrong."""
    try:
        code, text, err = read(name)
    except BaseException as error:
        return f"traceback: {type(error).__name__}: {str(error)[:200]}"
    if code == 0:
        return None if text == sound else f"silent: {text[:200]}"
    lines = err.strip().splitlines()
    if code != 2:
        return f"exit code {code}: {lines[-1:]}"
    told_lines = [line for line in lines if line.startswith("petmjx: ")]
    if len(told_lines) != 1 or not told_lines[0].isprintable():
        return f"{len(told_lines)} lines: {lines}"
    return None


def fuzz(count: int, seed: int, readings: int, told: Callable[[str], None] = lambda line: None) -> Counter[str]:
    """Damage folders and read them, in a temporary folder.

    Args:
        readings: number of commands that read each damaged folder.
        told: function that is called with each line about something that should not happen.

    Returns:
        Numbers of readings that were right (same output, or refused) and wrong, and the number of folders.
    """
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="petmjx-runs-") as name, contextlib.chdir(name):
        here, kept = Path(name), Path(name) / "kept"
        make_sound(here)
        sound = {reading: read(reading) for reading in READINGS}
        for label, (code, _, err) in sound.items():
            assert code == 0, (label, err)
        for run in DAMAGED:
            shutil.copytree(run, kept / run)
        for number in range(seed, seed + count):
            rng = random.Random(number)
            run = rng.choice(("run", *DAMAGED))
            change = damage(Path(run), rng)
            of_run = {
                "shard-1": ("merge",),
                "shard-2": ("merge",),
                "sweep": ("report",),
                "static": ("kpis", "compare", "packers"),
            }
            able = of_run.get(run, READINGS)
            for label in rng.sample(able, min(readings, len(able))):
                wrong = complaint(label, sound[label][1])
                counts["readings"] += 1
                counts["wrong" if wrong else "right"] += 1
                if wrong:
                    told(f"seed {number}: {change}: {label}: {wrong}")
                if label in ("resume", "merge") and not wrong:
                    break  # this command may have repaired the folder
            counts["folders"] += 1
            for label in {run, *DAMAGED}:
                shutil.rmtree(label, ignore_errors=True)
                shutil.copytree(kept / label, label)
    return counts


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=5_000, help="damaged folders")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--readings", type=int, default=3, help="commands that read each")
    parser.add_argument("--out", type=Path, help="file of JSON lines to which the result is appended")
    options = parser.parse_args()
    begin = time.perf_counter()
    counts = fuzz(options.count, options.seed, options.readings, lambda line: print(line, flush=True))
    result = {"case": "damaged-runs", "seed": options.seed, **counts, "wall_s": time.perf_counter() - begin}
    print(json.dumps(result))
    if options.out is not None:
        from benchmarks.result_fields import append_line, environment

        append_line(options.out, {**result, **environment(), "group": "damage"})
    return 1 if counts["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
