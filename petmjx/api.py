"""The functions that simulate plans: ``petmjx.score`` and ``petmjx.sweep``. Both call ``petmjx.runs.simulate``.

Modules that only some runs need are imported when a run needs them. For example, a plain score does not load the code
of sweeps, in which each plan has many variants.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar, Unpack

from petmjx.common.argument_checks import instance_of, path_of
from petmjx.common.checked_records import CheckedRecord
from petmjx.common.errors import InputError
from petmjx.options.confidence import Confidence
from petmjx.options.run_options import RunOptions
from petmjx.options.simulation import Simulation
from petmjx.options.sorted_options import sorted_options
from petmjx.options.transport import Transport
from petmjx.plans.plan import Plan
from petmjx.plans.plan_sources import PathArgument, PlanSource
from petmjx.results.run_reader import RunResults
from petmjx.runs.notebook_progress import watching
from petmjx.runs.option_types import ScoreOptions, SweepOptions
from petmjx.runs.simulate import RunStart, Watcher, simulate
from petmjx.runs.study import Nominal, Study

if TYPE_CHECKING:
    from petmjx.runs.forked_worlds import Batching

__all__ = ["RunStart", "Watcher", "score", "sweep"]

Function = TypeVar("Function", bound=Callable[..., Any])


def _takes_options(*records: type[CheckedRecord]) -> Callable[[Function], Function]:
    """Make a decorator for functions with ``**options``. The decorator adds the fields of the option records to the
    signature and the docstring of a function."""

    def decorate(function: Function) -> Function:
        signature = inspect.signature(function)
        parameters = [p for p in signature.parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD]
        fields = {name: info for record in records for name, info in record.model_fields.items()}
        parameters += [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=info.default, annotation=info.annotation)
            for name, info in fields.items()
        ]
        lines = [f"    {name}: {info.description}." for name, info in fields.items()]
        function.__doc__ = f"{inspect.cleandoc(function.__doc__ or '')}\n\nOptions:\n" + "\n".join(lines) + "\n"
        function.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]  # what inspect reads
        return function

    return decorate


def _run(
    ask: Callable[[Sequence[Plan], RunOptions], Study],
    sim: Simulation,
    plans: PlanSource | None,
    options: RunOptions,
    watcher: Watcher | None,
    progress: bool,
) -> RunResults:
    """Run the study (what is simulated, and how the results are summarised) that ``ask`` makes. If ``watcher`` is None,
    ``watching`` chooses how the progress of the run is shown.

    Raises:
        InputError: the input is unusable, or intervals of forces are requested and SciPy is missing.
    """
    intervals = None
    if options.force_intervals:
        from petmjx.analysis.force_intervals import intervals_at_rest, need_scipy

        need_scipy()
        intervals = intervals_at_rest
    with watching(watcher, progress) as follows:
        return simulate(ask, sim, plans, options, follows, intervals)


@_takes_options(Simulation, Confidence, Transport, RunOptions)
def score(
    plans: PlanSource | None = None,
    *,
    watcher: Watcher | None = None,
    progress: bool = False,
    **options: Unpack[ScoreOptions],
) -> RunResults:
    """Simulate each plan and report whether it stands.

    With ``confidence``, also report how certain the verdict on each plan is. With ``chain``, also report how likely
    each plan is to survive transport.

    ``petmjx.score("plans.json", schedule="fixed", thresholds={"shift_m": 0.03}, out="results")``

    Args:
        plans: files or folders, or a list of both; the folder of a run (its plans are simulated again); a data frame
            with one row per box; a plan, a list of plans or a ``PlanSet``. If ``plans`` is None, the bundled sample
            plans are simulated.
        watcher: an object whose methods are called as the run proceeds. Without a watcher, notebooks show a progress
            bar.
        progress: in a script, print the progress of the run on standard error every few seconds.
        options: ``confidence``, ``errors`` and ``chain``, and the fields of ``petmjx.Simulation`` and
            ``petmjx.RunOptions``, listed below.

    Returns:
        The results, with ``.worlds``, ``.boxes`` and ``.attempts`` as data frames, and ``.info``. A world is one
        simulation of one plan, and has one row in ``.worlds``. With ``confidence`` or ``chain``, each plan has several
        worlds with different random errors (of placement, mass, size and friction), and the world without errors has
        the number 0 in the column ``variant``. The results then also have ``.summary``, a data frame with rows about
        each plan.

    Raises:
        InputError: the plans or options are unusable.
        EngineUnavailable: the chosen engine cannot run on this machine.
    """
    of_simulation, of_run, of_confidence, of_transport = sorted_options(options, Confidence, Transport)
    run, sure, transport = RunOptions(**of_run), Confidence(**of_confidence), Transport(**of_transport)
    if transport.chain is None and sure.confidence is None:
        sim = Simulation(**of_simulation)
        return _run(partial(Nominal, sim), sim, plans, run, watcher, progress)
    from petmjx.runs.confidence import confidence_sweep
    from petmjx.runs.sweep_file import chain_sweep
    from petmjx.runs.sweep_study import SweepStudy

    if transport.chain is None:
        assert sure.confidence is not None
        definition = confidence_sweep(sure.confidence, sure.errors, of_simulation, exact_too=sure.exact_too)
    elif sure.errors is not None or sure.exact_too:
        raise InputError(f"{'errors' if sure.errors else 'exact_too'} contradicts chain, which has its own errors")
    else:
        definition = chain_sweep(transport.chain, sure.confidence, of_simulation)
    ask = partial(SweepStudy, definition, confidence=definition.replicates)
    return _run(ask, definition.simulation, plans, run, watcher, progress)


@_takes_options(Simulation, RunOptions)
def sweep(
    file: PathArgument,
    plans: PlanSource | None = None,
    *,
    watcher: Watcher | None = None,
    progress: bool = False,
    batching: Batching | None = None,
    **options: Unpack[SweepOptions],
) -> RunResults:
    """Simulate each plan in all variants that a sweep file defines.

    Args:
        file: a sweep file, or the name of a ready-made sweep such as ``eumos``.
        plans: as for :func:`score`. Plans given here replace the plans that the sweep file names. If ``plans`` is None,
            all plans that the file names are simulated.
        watcher: as for :func:`score`.
        progress: in a script, print the progress of the run on standard error every few seconds.
        batching: limits for how many settled states and how many worlds are in memory at once. A world is one
            simulation of one plan. The results do not depend on these limits.
        options: fields of ``petmjx.Simulation``, which replace the values in the sweep file, and fields of
            ``petmjx.RunOptions``.

    Returns:
        The results, with ``.worlds``, ``.boxes``, ``.attempts`` and ``.summary`` as data frames, and ``.info``.

    Raises:
        InputError: the sweep file, the plans or the options are unusable.
        EngineUnavailable: the chosen engine cannot run on this machine.
    """
    from petmjx.runs.forked_worlds import Batching
    from petmjx.runs.ready_sweeps import find_sweep
    from petmjx.runs.sweep_file import load_sweep
    from petmjx.runs.sweep_study import SweepStudy

    if batching is not None:
        instance_of(batching, "batching", Batching, "a Batching")
    of_simulation, of_run = sorted_options(options)
    definition = load_sweep(find_sweep(path_of(file, "file")), plans_given=plans is not None, simulation=of_simulation)
    if plans is None and isinstance(definition.plans, tuple):
        plans = list(definition.plans)
    ask = partial(SweepStudy, definition, batching=batching)
    return _run(ask, definition.simulation, plans, RunOptions(**of_run), watcher, progress)
