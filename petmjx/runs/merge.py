"""Joins the shards (parts that were simulated separately) of a run into one run."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc

from petmjx.common.argument_checks import list_of, path_of
from petmjx.common.checked_records import option
from petmjx.common.errors import InputError
from petmjx.common.text import count_text, first_names, printable_name
from petmjx.plans.order_checks import OrderCheck
from petmjx.plans.plan_set import Skipped
from petmjx.results.run_manifest import Manifest
from petmjx.results.run_reader import RunResults, is_chain, load_run, split_warnings
from petmjx.results.run_writer import RunWriter
from petmjx.results.schema import Param, summary_table
from petmjx.results.stored_order_checks import joined_check, read_check
from petmjx.results.stored_plans import PLACEMENTS
from petmjx.results.world_counts import NO_VERDICT
from petmjx.results.world_ranks import is_ranked
from petmjx.runs.chain_summary import ChainColumns, write_chain
from petmjx.runs.confidence import write_confidence
from petmjx.runs.sweep_summary import ShareColumns, summarise_shares

_ANSWER: Final = ("plan_id", "placement", "profile", "direction_deg")
"""Columns that identify a row in the summary of a search, and by which the rows are sorted."""


def merge_runs(shards: Iterable[str | Path], out: str | Path, *, overwrite: bool = False) -> RunResults:
    """Join all shards of a run. The result has the same tables as the run would have without shards.

    Args:
        shards: folders of the N finished runs with ``shard`` 1/N to N/N, in any order.
        out: folder for the whole run.
        overwrite: whether to replace the results that ``out`` holds.

    Raises:
        InputError: a shard is missing or not finished, belongs to another run, or was compared with other orders; or
            two shards have the same world.
    """
    folders = [path_of(shard, "shards") for shard in list_of(shards, "shards", object, "folders")]
    out = path_of(out, "out")
    if any(folder.resolve() == out.resolve() for folder in folders):
        raise InputError(f"{out}: is one of the shards; name another folder with {option('--out')}")
    runs = _sorted_shards([load_run(folder) for folder in folders])
    manifests = [Manifest.read(run.parts, run.info) for run in runs]
    for run, manifest in zip(runs, manifests, strict=True):
        differs = manifest.difference_from(manifests[0], without=("shard",))
        if differs:
            raise InputError(f"{run.path}: is not of the same run as {runs[0].path} ({differs})")
    merged_manifest = Manifest({**manifests[0].settings, "shard": None}, manifests[0].plans, lambda: _placements(runs))
    _check_worlds(runs, merged_manifest)
    orders = _orders(runs)
    first = runs[0].info
    expected = [run.info["expected_worlds"] for run in runs]
    with RunWriter(
        out,
        {**first["config"], "shard": None, "shards": [_of_shard(run) for run in runs]},
        manifest=merged_manifest,
        orders=orders,
        params=[Param(**param) for param in first["params"]],
        variants=None if _is_search(runs[0].info) else _variants(runs),
        boxes=runs[0].keeps_boxes,
        versions=first["versions"],
        device=", ".join(dict.fromkeys(run.info["device"] for run in runs)),
        expected_worlds=None if None in expected else sum(expected),
        overwrite=overwrite,
    ) as writer:
        seconds: Counter[str] = Counter()
        ranked = all(is_ranked(run.parts, list(merged_manifest.plans)) for run in runs)
        for run in runs:
            writer.adopt(run.parts, ranked=ranked)
            seconds.update(run.info["timings"])
        writer.earlier_s = dict(seconds)
        _note_input(writer, [run.info for run in runs])
        for note in _other_versions(runs):
            writer.warn(note)
        if is_chain(first):
            write_chain(writer, ChainColumns(**first["config"]["chain"]))
        elif first["config"].get("confidence") is not None:
            write_confidence(writer, first["config"]["sweep"]["axes"])
        elif merged_manifest.settings["command"] == "sweep":
            _write_summary(writer, runs)
    return load_run(out)


def _sorted_shards(runs: Sequence[RunResults]) -> list[RunResults]:
    """The runs, sorted by the numbers of their shards.

    Raises:
        InputError: a run is not a shard or is not finished, or a shard is missing or given twice.
    """
    run_by_shard: dict[int, RunResults] = {}
    of: set[int] = set()
    for run in runs:
        shard = run.info.get("identity", {}).get("shard")
        if shard is None:
            raise InputError(f"{run.path}: not a shard (made without {option('--shard')})")
        if run.unfinished:
            raise InputError(
                f"{run.path}: not finished ({run.unfinished}); finish it with {option('--resume', 'True')} first"
            )
        number, total = (int(part) for part in shard.split("/"))
        of.add(total)
        if len(of) > 1:
            raise InputError(f"{run.path}: is shard {shard}, but other runs are shards of {min(of - {total})}")
        if number in run_by_shard:
            raise InputError(f"{run.path}: is shard {shard}, and so is {run_by_shard[number].path}")
        run_by_shard[number] = run
    if not run_by_shard:
        raise InputError("no shard to merge: name the folders of the shards")
    total = of.pop()
    missing = [f"{number}/{total}" for number in range(1, total + 1) if number not in run_by_shard]
    if missing:
        raise InputError(f"missing: {'shard' if len(missing) == 1 else 'shards'} {first_names(missing)}")
    return [run_by_shard[number] for number in sorted(run_by_shard)]


def _check_worlds(runs: Sequence[RunResults], manifest: Manifest) -> None:
    """Raise InputError if two shards have the same world, if a plan has no world in any shard, or if tables of boxes
    are missing."""
    home: dict[tuple[str, int], Path] = {}
    for run in runs:
        for boxes in run.parts.files("boxes"):
            run.parts.read(boxes, ())
        for keys in run.parts.table("worlds", ("plan_id", "variant")):
            for key in zip(keys["plan_id"].to_pylist(), keys["variant"].to_pylist(), strict=True):
                if key in home:
                    runs_text = f"{home[key]} and {run.path}" if home[key] != run.path else f"{run.path}"
                    raise InputError(f"plan {printable_name(key[0])}, variant {key[1]} exists twice: in {runs_text}")
                home[key] = run.path
    lacking = sorted(manifest.plans.keys() - {plan_id for plan_id, _ in home})
    if lacking:
        raise InputError(f"no shard has a world of {count_text(len(lacking), 'plan')}: {first_names(lacking)}")


def _is_search(info: Mapping[str, Any]) -> bool:
    """Whether a run is a search. In a search, plans have different numbers of worlds, and the summary has no shares."""
    shares = info["config"].get("shares") is not None or is_chain(info)
    return info["identity"]["command"] == "sweep" and not shares


def _variants(runs: Sequence[RunResults]) -> range:
    """The range of the numbers of variants that occur in the runs, from the smallest to the largest number."""
    parts = [part for run in runs for part in run.parts.table("worlds", ("variant",)) if len(part)]
    least, most = pc.min_max(pa.concat_tables(parts)["variant"]).values()
    return range(least.as_py(), most.as_py() + 1)


def _placements(runs: Sequence[RunResults]) -> pa.Table | None:
    """The table ``placements`` for the plans of all shards together; None if a shard lacks the table."""
    tables = [run.parts.table(PLACEMENTS) for run in runs]
    return pa.concat_tables(itertools.chain.from_iterable(tables)) if all(tables) else None


def _orders(runs: Sequence[RunResults]) -> OrderCheck | None:
    """The comparison of the plans of all shards with their orders; None if no shard was compared with orders.

    Raises:
        InputError: not all shards were compared with the same orders.
    """
    checks = [read_check(run.path, run.info) for run in runs]
    for run, check in zip(runs, checks, strict=True):
        if (check and check.digest) != (checks[0] and checks[0].digest):
            raise InputError(
                f"{run.path}: was checked against other orders than {runs[0].path}; resume one of the two runs with "
                f"{option('--resume', 'True')} and the other's {option('--orders')} (nothing is simulated again)"
            )
    order_checks = [check for check in checks if check is not None]
    return joined_check(order_checks) if order_checks else None


def _of_shard(run: RunResults) -> dict[str, Any]:
    """The entry about one shard in the ``run.json`` of the merged run."""
    info = run.info
    return {
        "shard": info["identity"]["shard"],
        "folder": str(run.path),
        "started": info["started"],
        "device": info["device"],
        "worlds": info["counts"]["worlds"],
        "wall_s": info["timings"].get("wall_s", 0.0),
    }


def _note_input(writer: RunWriter, infos: Sequence[Mapping[str, Any]]) -> None:
    """Copy skipped plans and warnings from the shards, in the order of first appearance. An entry that several shards
    have is copied once."""
    entries = itertools.chain.from_iterable(info["skipped"] for info in infos)
    skipped = (
        Skipped(entry["source"], entry.get("plan_id") or None, entry.get("error", ""), entry.get("number"))
        for entry in entries
    )
    for skipped_plan in dict.fromkeys(skipped):
        writer.skip(skipped_plan)
    warnings = [split_warnings(info) for info in infos]
    for warning in itertools.chain.from_iterable(about_run for about_run, _ in warnings):
        # a warning with NO_VERDICT counts worlds of one shard; a warning about all shards follows below
        if not warning.startswith(NO_VERDICT):
            writer.warn(warning)
    limit = infos[0]["config"]["simulation"].get("iteration_limit")
    if warning_of_all := writer.counts.iteration_limit_warning(limit):
        writer.warn(warning_of_all)
    writer.odd_plans += dict.fromkeys(itertools.chain.from_iterable(about_plans for _, about_plans in warnings))


def _other_versions(runs: Sequence[RunResults]) -> Iterator[str]:
    """Yield a line for each shard and package whose version differs from the version in the first shard. Results may
    depend on these versions."""
    first = runs[0].info["versions"]
    for run in runs[1:]:
        versions = run.info["versions"]
        for name in sorted({*first, *versions}):
            if first.get(name) != versions.get(name):
                had, other_version = (
                    version_by_package.get(name) or "none" for version_by_package in (versions, first)
                )
                shard, other = (shard_run.info["identity"]["shard"] for shard_run in (run, runs[0]))
                yield f"shard {shard} was simulated with {name} {had}, shard {other} with {other_version}"


def _write_summary(writer: RunWriter, runs: Sequence[RunResults]) -> None:
    """Write the table ``summary``. For a grid or a sample, the shares of standing worlds are computed again from the
    worlds of all shards. For a search, the summary has the rows of all shards, since each row is about one plan."""
    tables = [table for run in runs for table in run.parts.table("summary")]
    shares = runs[0].info["config"].get("shares")
    if shares is None:
        answers = pa.concat_tables(tables).sort_by([(name, "ascending") for name in _ANSWER])
        writer.write_summary(answers)
        return
    columns = ShareColumns(**shares)
    metadata = {field.name: field.metadata or {} for field in tables[0].schema}
    units = {name: entry.get(b"unit", b"").decode() for name, entry in metadata.items()}
    texts = {name: entry.get(b"description", b"").decode() for name, entry in metadata.items()}
    writer.write_summary(summary_table(summarise_shares(writer.parts, columns), units, texts))
