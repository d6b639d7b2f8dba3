"""``petmjx warm-up``."""

from __future__ import annotations

import sys
import time
from typing import Annotated

import typer

from petmjx.cli.console import results_console
from petmjx.common.errors import EngineUnavailable, InputError
from petmjx.common.text import count_text, printable


def warm_up(
    arch: Annotated[
        str | None,
        typer.Option(
            "--arch",
            metavar="NN,…",
            help="GPUs to compile for, as compute capability times ten: 80 (A100), 86 (A10), 89 (L4), 90 (H100), 100 "
            "(B200), 120 (RTX 50). The machine itself needs no GPU.",
            show_default="the GPU of this machine",
        ),
    ] = None,
) -> None:
    """Compile all kernels now, so that no run waits for them: after an installation, or when an image for containers
    is built.

    For GPUs, the command compiles two kinds of kernels: for boxes that are placed exactly, and for boxes that a
    simulated hand places. On a GPU, runs with stretch film or with compressible boxes need other kernels, and compile
    them themselves. On a CPU, one kernel serves all runs.

    Compiled kernels are kept in ~/.cache/petmjx, or in the folder that PETMJX_CACHE_DIR names.
    """
    from petmjx.common.compile_caches import cache_folder, why_not_written
    from petmjx.common.machine import why_no_warp_on_cpu
    from petmjx.engines.subprocess.kernel_builds import KernelBuilds, all_builds, gpu_here, gpu_of, note_kept
    from petmjx.engines.warp.block_sizes import FEW_BOXES, LAST, SIZES
    from petmjx.options.simulation import Simulation

    if problem := why_no_warp_on_cpu():
        raise EngineUnavailable(problem)
    if why := why_not_written("warp"):
        print(f"note: {why}; kernels are kept in {printable(str(cache_folder('warp')))}", file=sys.stderr)
    here = gpu_here()
    gpus = [gpu_of(number) for number in _numbers(arch)] if arch is not None else [here] if here is not None else []
    builds, begin, console, faults = all_builds(gpus), time.perf_counter(), results_console(), []
    if not gpus:
        console.print(
            "no GPU here, so only the kernel for CPUs is compiled; to compile for GPUs, name them with --arch"
        )
    console.print(f"{count_text(len(builds), 'kernel')} to compile; each takes some 10 to 60 s of a CPU thread")
    of_size = {
        SIZES[0]: "up to 96 boxes",
        SIZES[1]: "more boxes",
        FEW_BOXES: "few boxes, many worlds",
        LAST: "the last worlds of a run",
    }
    for number, answer in enumerate(KernelBuilds(builds).answers(), start=1):
        build = answer.build
        placing = "placing by hand" if build.hands else "exact placing"
        place = "CPU" if build.gpu is None else f"GPU sm_{build.gpu.arch}, {placing}, {of_size[build.size]}"
        state = answer.fault or f"{answer.seconds:.1f} s"
        console.print(f"{number} of {len(builds)}  {place}: {state}", highlight=False)
        faults += [answer.fault] * bool(answer.fault)
    if faults:
        raise EngineUnavailable(f"{count_text(len(faults), 'kernel')} could not be compiled: {faults[0]}")
    for gpu in gpus:
        note_kept(Simulation(), gpu)
    console.print(
        f"{count_text(len(builds), 'kernel')} in {cache_folder('warp')}, after {time.perf_counter() - begin:.0f} s",
        highlight=False,
        soft_wrap=True,
    )


def _numbers(text: str) -> list[int]:
    """The whole numbers in a text such as "90,120", without repetition.

    Raises:
        InputError: a part of the text is no number.
    """
    try:
        return list(dict.fromkeys(int(part) for part in text.split(",")))
    except ValueError:
        raise InputError(f"--arch must be numbers with commas, such as 90,120; got {text!r}") from None
