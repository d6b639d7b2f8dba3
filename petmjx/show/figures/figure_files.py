"""``petmjx.figure``: draws results as a figure for a paper."""

from __future__ import annotations

import importlib.util
from os import PathLike
from pathlib import Path
from typing import Any, Final

from petmjx.analysis.criteria_run import CriteriaResults
from petmjx.analysis.packer_comparison import PackerComparison
from petmjx.common.argument_checks import path_of
from petmjx.common.atomic_write import atomic_write, check_writable
from petmjx.common.checked_records import shown_value
from petmjx.common.errors import InputError
from petmjx.common.text import printable
from petmjx.results.run_reader import RunResults
from petmjx.show.figures.comparison_figures import draw_criteria, draw_packers
from petmjx.show.figures.figure_style import kind_of, paper_style, write
from petmjx.show.figures.sweep_figures import draw_answers

KINDS: Final = ("pdf", "svg", "png")
"""Possible suffixes of the files."""


def figure(results: PackerComparison | CriteriaResults | RunResults, *files: str | PathLike[str]) -> list[Path]:
    """Draw results as a figure for a paper, as wide as the text of a page: ``.pdf``, ``.svg`` or ``.png``.

    ``petmjx.figure(petmjx.compare_packers(["A", "B"]), "packers.pdf")``

    With the same version of matplotlib, the same results give the same bytes. The figure shows

    - for a comparison of packers: shares and differences, with a sentence about each pair of packers,
    - for criteria with a run: precision, recall and correlation,
    - for a search: the share of plans that survive each level,
    - for another sweep: shares along the sweep's axes,
    - for a score with confidence: the share of worlds in which each plan stands,
    - for a chain: the share of worlds in which each plan arrives.

    Args:
        files: paths to write. The suffix determines the format. Existing files are replaced. A file appears only when
            it is complete.

    Returns:
        The paths of the files.

    Raises:
        InputError: there is no figure for these results, a suffix is unknown, a file cannot be written, or matplotlib
            is missing.
    """
    paths = [path_of(file, "files") for file in files]
    check_figures(paths)
    with paper_style():
        for path in paths:
            drawn = _drawn_figure(results)  # the figure is drawn again for each file, since writing a figure changes it
            with atomic_write(path) as temporary:
                write(drawn, temporary, kind_of(path, KINDS))
    return paths


def check_figures(paths: list[Path]) -> None:
    """Check that figures can be written. Call this function before the results are computed.

    Raises:
        InputError: a suffix is unknown, a path cannot be written, or matplotlib is missing.
    """
    for path in paths:
        kind_of(path, KINDS)
        if importlib.util.find_spec("matplotlib") is None:
            raise InputError(f"{printable(str(path))}: needs matplotlib, not installed: pip install 'petmjx[show]'")
        check_writable(path)


def _drawn_figure(results: Any) -> Any:
    if isinstance(results, PackerComparison):
        return draw_packers(results)
    if isinstance(results, CriteriaResults):
        return draw_criteria(results)
    if isinstance(results, RunResults):
        return draw_answers(results)
    raise InputError(f"results must come from compare_packers, criteria, sweep or score, {shown_value(results)}")
