"""Linear programmes, solved with HiGHS. SciPy contains HiGHS in a module of its own, which this file loads without the
rest of SciPy: ``import scipy.optimize`` takes 0.3 s, as long as solving a hundred programmes."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import sys
import threading
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from petmjx.common.errors import PetmjxError
from petmjx.common.units import FloatArray

_NAME: Final = "scipy.optimize._highspy._core"
"""The name that SciPy, since version 1.15, gives to its module with HiGHS. The module can be loaded only once in a
process. So petmjx loads the module under this name, and a later ``import scipy.optimize`` finds the loaded module."""

_INFEASIBLE: Final = 2
"""Status that SciPy returns if the conditions of a linear programme contradict each other."""

_USED: Final = ("HighsLp", "HighsModelStatus", "HighsOptions", "HighsStatus", "HighsVarType", "MatrixFormat", "_Highs")
"""Names in SciPy's module that petmjx uses."""

_loading = threading.Lock()


class Entries(NamedTuple):
    """The k nonzero entries of a sparse matrix, each with its row and its column. Each field of this record has the
    shape (k,). Each place of the matrix has at most one entry."""

    value: FloatArray
    row: NDArray[np.int64]
    column: NDArray[np.int64]

    @classmethod
    def of(cls, matrix: FloatArray) -> Self:
        """The entries of a matrix (m, n), most of whose numbers are 0."""
        row, column = np.nonzero(matrix)
        return cls(matrix[row, column], row, column)


Limits = tuple[FloatArray, FloatArray]
"""The smallest and the largest allowed values of several numbers."""


def minimised(cost: FloatArray, matrix: Entries, rows: Limits, bounds: Limits) -> FloatArray | None:
    """The (n,) x that minimises ``cost @ x`` among all x between the ``bounds`` for which ``matrix @ x`` is between the
    limits ``rows``. The result is None if there is no such x.

    Raises:
        PetmjxError: HiGHS found no answer.
    """
    highs = _highs()
    if highs is None:
        return _minimised_by_scipy(cost, matrix, rows, bounds)
    order = np.lexsort((matrix.row, matrix.column))
    programme = highs.HighsLp()
    programme.num_row_, programme.num_col_ = len(rows[0]), len(cost)
    programme.a_matrix_.num_row_, programme.a_matrix_.num_col_ = len(rows[0]), len(cost)
    programme.col_cost_, programme.col_lower_, programme.col_upper_ = cost, *bounds
    programme.row_lower_, programme.row_upper_ = rows
    programme.a_matrix_.format_ = highs.MatrixFormat.kColwise
    programme.a_matrix_.start_ = np.searchsorted(matrix.column[order], np.arange(len(cost) + 1)).astype(np.int32)
    programme.a_matrix_.index_, programme.a_matrix_.value_ = matrix.row[order].astype(np.int32), matrix.value[order]
    programme.integrality_ = [highs.HighsVarType.kContinuous] * len(cost)
    options, solver = highs.HighsOptions(), highs._Highs()
    options.log_to_console = False
    solver.passOptions(options)
    has_failed = highs.HighsStatus.kError in (solver.passModel(programme), solver.run())
    status = solver.getModelStatus()
    if not has_failed and status == highs.HighsModelStatus.kInfeasible:
        return None
    if has_failed or status != highs.HighsModelStatus.kOptimal:
        raise _no_answer(len(rows[0]), solver.modelStatusToString(status))
    return np.array(solver.getSolution().col_value)


def _minimised_by_scipy(cost: FloatArray, matrix: Entries, rows: Limits, bounds: Limits) -> FloatArray | None:
    """The result of :func:`minimised`, computed by SciPy's function ``milp``, which also calls HiGHS."""
    from scipy.optimize import Bounds, LinearConstraint, milp
    from scipy.sparse import csc_array

    table = csc_array((matrix.value, (matrix.row, matrix.column)), shape=(len(rows[0]), len(cost)))
    solution = milp(cost, constraints=LinearConstraint(table, *rows), bounds=Bounds(*bounds))
    if solution.status == _INFEASIBLE:
        return None
    if solution.x is None:
        raise _no_answer(len(rows[0]), solution.message)
    answer: FloatArray = solution.x
    return answer


def _no_answer(n_rows: int, reason: str) -> PetmjxError:
    return PetmjxError(f"the solver HiGHS found no answer for a linear programme with {n_rows} constraints: {reason}")


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
