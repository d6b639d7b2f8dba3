"""Runs programs of documents and scripts of examples, each in a process of its own.

The processes are forked from one process in which petmjx and the libraries of most programs are imported, but nothing
was run. A new interpreter would import all of these first, which takes longer than most programs.
"""

from __future__ import annotations

import atexit
import functools
import gc
import multiprocessing
import multiprocessing.forkserver
import os
import runpy
import subprocess
import sys
import traceback
from multiprocessing.context import ForkServerContext
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parents[1]

IMPORTED = (
    "support.programs",
    "gymnasium",
    "jax",
    "matplotlib.pyplot",
    "mujoco",
    "pandas",
    "petmjx.cli.score",
    "petmjx.engines.mujoco.engine",
    "petmjx.runs.simulate",
    "petmjx.show.run_tables",
    "pyarrow.parquet",
    "scipy.optimize",
)
"""Modules that are imported before the processes are forked. None of these modules starts JAX's threads. Modules that
are not installed are left out. ``petmjx.gym`` and ``petmjx.jax`` are not among them, since programs must import
them."""


@functools.cache
def _forking() -> ForkServerContext:
    """Start the process from which the others are forked. The forked processes have the environment of the first
    process, in which petmjx is that of this repository."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(IMPORTED))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join((str(TESTS.parent), str(TESTS), os.environ.get("PYTHONPATH", ""))))
        multiprocessing.forkserver.ensure_running()
    return context


def run_program(program: str | Path, *arguments: str, folder: Path) -> str:
    """Run a program in a folder, and return what it prints.

    Args:
        program: the text of a program, as for ``python -c``, or the path of a script.
        arguments: ``sys.argv[1:]`` of the program.

    Raises:
        AssertionError: the program ended with an error. The message is what it printed to stderr.
    """
    done = ended_program(program, *arguments, folder=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout


def ended_program(
    program: str | Path, *arguments: str, folder: Path, timeout_s: float | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a program in a folder, and return how it ended and what it printed. Arguments: see ``run_program``."""
    printed, errors = folder / ".printed", folder / ".errors"
    process = _forking().Process(target=_run, args=(program, arguments, folder, printed, errors))
    process.start()
    process.join(timeout_s)
    if process.is_alive():
        process.kill()
        process.join()
    code = process.exitcode
    process.close()
    assert code is not None
    texts = (path.read_text(encoding="utf-8") for path in (printed, errors))
    return subprocess.CompletedProcess([str(program), *arguments], code, *texts)


def _run(program: str | Path, arguments: tuple[str, ...], folder: Path, printed: Path, errors: Path) -> None:
    """The new process. The standard output and the errors of the new process are written to files."""
    gc.freeze()  # no search for garbage among the imported objects
    os.chdir(folder)
    for descriptor, path in ((1, printed), (2, errors)):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), descriptor)
    try:
        if isinstance(program, Path):
            sys.argv = [str(program), *arguments]
            sys.path.insert(0, str(program.parent))
            runpy.run_path(str(program), run_name="__main__")
        else:
            sys.argv = ["-c", *arguments]
            sys.path.insert(0, "")
            exec(compile(program, "<string>", "exec"), {"__name__": "__main__"})
    except Exception:
        traceback.print_exc()
        sys.exit(1)
    finally:
        atexit._run_exitfuncs()  # a forked process ends without them
