"""``petmjx compare``, ``samples``, ``export`` and ``doctor``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from petmjx.cli import options as opt
from petmjx.cli.console import results_console
from petmjx.config import Carrier
from petmjx.errors import InputError
from petmjx.samples import DEFAULT_LOOSE_SHARE


def compare(
    a: Annotated[Path, typer.Argument(metavar="DIR_A", help="Folder of the run that is the yardstick.")],
    b: Annotated[Path, typer.Argument(metavar="DIR_B", help="Folder of the other run.")],
    rows: Annotated[
        int, typer.Option("--rows", metavar="N", min=1, help="Show at most so many worlds with differing verdicts.")
    ] = 40,
    as_json: opt.JsonOption = False,
) -> None:
    """Compare two runs of the same plans: verdicts that agree, and differences of each metric.

    Differences are |b - a| with median, 95th percentile and largest; the largest one with its plan and box.
    """
    from petmjx.compare import compare_runs

    comparison = compare_runs(a, b)
    if as_json:
        print(json.dumps(comparison.to_dict(), indent=2, allow_nan=False))
        return
    comparison.render(results_console(), max_rows=rows)


def samples(
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="File to write; *.gz is gzipped.")],
    n: Annotated[int, typer.Option("-n", metavar="N", help="Number of plans.")] = 100,
    seed: Annotated[
        int, typer.Option("--seed", metavar="SEED", help="Plan i depends on the seed, i and --loose-share alone.")
    ] = 0,
    loose_share: Annotated[
        float,
        typer.Option(
            "--loose-share", metavar="0…1", help="Share of plans packed with a support rule too loose to be safe."
        ),
    ] = DEFAULT_LOOSE_SHARE,
    orders: Annotated[
        Path | None,
        typer.Option("--orders", metavar="FILE", help="Pack the orders of this BED-BPP file instead of drawn ones."),
    ] = None,
) -> None:
    """Write packing plans with BED-BPP's statistics: drawn orders (43±14 boxes), packed by a baseline packer.

    With --orders it packs the orders of a file instead; -n and --loose-share then do not apply.
    """
    from petmjx.report import progress
    from petmjx.samples import pack_orders, write_plans, write_samples

    if orders is None:
        with progress(n) as bar:
            write_samples(out, n, seed, loose_share=loose_share, progress=bar.update)
        print(f"{n:,} plans in {out}")
        return
    bad: list[InputError] = []
    written = 0

    def count(done: int) -> None:
        nonlocal written
        written = done
        bar.update(done)

    with progress(None) as bar:
        write_plans(out, pack_orders(orders, seed=seed, on_bad_order=bad.append), progress=count)
    for error in bad:
        typer.echo(f"skipped: {error}", err=True)
    print(f"{written:,} plans in {out}")


def export(
    plan_id: Annotated[str, typer.Argument(metavar="PLAN_ID", help="Id of the plan to write.")],
    plans: opt.PlanPaths = None,
    physics: opt.PhysicsOption = opt.PhysicsName.PALLET,
    size_reduction_mm: opt.SizeReductionOption = 0.1,
    carrier: opt.CarrierOption = Carrier.FOOTPRINT,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="File to write.", show_default="standard output"),
    ] = None,
) -> None:
    """Write the exact MuJoCo model of one plan as MJCF, every box at its place; MuJoCo's viewer opens it."""
    from petmjx.api import gather_plans, without_vanishing_boxes
    from petmjx.config import PHYSICS
    from petmjx.model import to_mjcf
    from petmjx.scene import build_scene

    found = without_vanishing_boxes(gather_plans(plans or None, carrier=carrier), size_reduction_mm)
    plan = next((plan for plan in found.plans if plan.plan_id == plan_id), None)
    if plan is None:
        reasons = [skipped.message for skipped in found.skipped if skipped.plan_id == plan_id]
        raise InputError(reasons[0] if reasons else f"plan {plan_id} is not among the {len(found.plans)} plans read")
    world = PHYSICS[physics.value]
    mjcf = to_mjcf(build_scene(plan, world, carrier, size_reduction_mm), world)
    if out is None:
        print(mjcf)
        return
    try:
        out.write_text(mjcf, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror or error}") from error
    print(f"plan {plan_id}: {plan.n_boxes} boxes, MJCF in {out}")


def doctor(as_json: opt.JsonOption = False) -> None:
    """Show versions, devices, which engines work here and why not, and where compiled programs are cached."""
    from dataclasses import asdict

    from petmjx.doctor import examine

    report = examine()
    if as_json:
        print(json.dumps(asdict(report), indent=2))
        return
    from rich.table import Table

    table = Table(show_header=False)
    table.add_column(style="bold")
    table.add_column()
    for name, version in report.versions.items():
        table.add_row(name, version)
    table.add_section()
    for device in report.devices:
        kind, _, text = device.partition(": ")
        table.add_row(kind, text)
    table.add_section()
    for engine in report.engines:
        state = "[green]works[/green]" if engine.works else "[yellow]not here[/yellow]"
        table.add_row(f"engine {engine.name}", f"{state}: {engine.detail}")
    table.add_section()
    for name, folder in report.caches.items():
        table.add_row(f"cache: {name}", folder)
    results_console().print(table)
