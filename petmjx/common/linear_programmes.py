"""Linear programmes, solved with HiGHS. SciPy contains HiGHS in a module of its own, which this file loads without the
rest of SciPy: ``import scipy.optimize`` takes 0.3 s, as long as solving a hundred programmes."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import sys
import threading
from pathlib import Path
from typing import Any, Final

import numpy as np

from petmjx.common.units import FloatArray

_NAME: Final = "scipy.optimize._highspy._core"
"""The name that SciPy, since version 1.15, gives to its module with HiGHS. The module can be loaded only once in a
process. So petmjx loads the module under this name, and a later ``import scipy.optimize`` finds the loaded module."""

_USED: Final = ("HighsLp", "HighsModelStatus", "HighsOptions", "HighsStatus", "HighsVarType", "MatrixFormat", "_Highs")
"""Names in SciPy's module that petmjx uses."""

_loading = threading.Lock()


def minimised(
    cost: FloatArray, rows: FloatArray, least: FloatArray, most: FloatArray, bound: FloatArray
) -> FloatArray | None:
    """The (n,) x that minimises ``cost @ x`` subject to least ≤ rows @ x ≤ most and 0 ≤ x ≤ bound. The result is None
    if HiGHS finds no solution.

    Args:
        rows: (m, n) matrix, most of whose entries are 0.
    """
    row, column = np.nonzero(rows)
    order = np.argsort(column, kind="stable")
    begins = np.searchsorted(column[order], np.arange(rows.shape[1] + 1)).astype(np.int32)
    numbers, values = row[order].astype(np.int32), rows[row, column][order]
    highs = _highs()
    if highs is None:
        from scipy.optimize import Bounds, LinearConstraint, milp
        from scipy.sparse import csc_array

        table = csc_array((values, numbers, begins), shape=rows.shape)
        answer: FloatArray | None = milp(
            cost, constraints=LinearConstraint(table, least, most), bounds=Bounds(0.0, bound)
        ).x
        return answer
    programme = highs.HighsLp()
    programme.num_row_, programme.num_col_ = programme.a_matrix_.num_row_, programme.a_matrix_.num_col_ = rows.shape
    programme.col_cost_, programme.col_lower_, programme.col_upper_ = cost, np.zeros(len(cost)), bound
    programme.row_lower_, programme.row_upper_ = least, most
    programme.a_matrix_.format_ = highs.MatrixFormat.kColwise
    programme.a_matrix_.start_, programme.a_matrix_.index_, programme.a_matrix_.value_ = begins, numbers, values
    programme.integrality_ = [highs.HighsVarType.kContinuous] * len(cost)
    options, solver = highs.HighsOptions(), highs._Highs()
    options.log_to_console = False
    solver.passOptions(options)
    if highs.HighsStatus.kError in (solver.passModel(programme), solver.run()):
        return None
    if solver.getModelStatus() != highs.HighsModelStatus.kOptimal:
        return None
    return np.array(solver.getSolution().col_value)


def _highs() -> Any | None:
    """SciPy's module with HiGHS. The result is None if the installed SciPy has no module of this name, if the module
    cannot be loaded, or if it lacks one of the names ``_USED``."""
    with _loading:
        if _NAME not in sys.modules and (scipy := importlib.util.find_spec("scipy")) is not None:
            folder = Path(scipy.origin or "").parent.joinpath(*_NAME.split(".")[1:-1])
            spec = importlib.machinery.PathFinder.find_spec(_NAME, [str(folder)])
            if spec is not None and spec.loader is not None:
                try:
                    module = importlib.util.module_from_spec(spec)
                    sys.modules[_NAME] = module
                    spec.loader.exec_module(module)
                except ImportError:  # HiGHS may need a library in a folder in which only SciPy itself searches
                    sys.modules.pop(_NAME, None)
    module_or_none = sys.modules.get(_NAME)
    return module_or_none if all(hasattr(module_or_none, name) for name in _USED) else None
