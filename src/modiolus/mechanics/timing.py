"""Where the time of a solution goes: one measurement of each of its parts."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from .laws import Array
from .linear import Pardiso, best_solver
from .problem import Problem
from .terms import Load

#: How often a part is measured; the least time counts.
REPEATS = 5


def least(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the least wall time of some work in seconds."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return min(times)


def parts(problem: Problem, parameters: Array, pressure: Array, load: Load) -> dict[str, float]:
    """Measure the parts of one Newton iteration at a state.

    Returns
    -------
    dict of str to float
        Wall times in seconds: ``residual`` and ``tangent`` of all terms and of the passive
        tissue alone (the difference is that of fibres, springs and contact), ``gather`` of
        the matrix, ``analysis``, ``factorisation`` and ``solve`` of the linear system. Beside
        them the floor: ``unknowns``, ``matrix_entries`` and, with PARDISO, ``factor_entries``
        and ``factor_gflop``, the operations of a factorisation.
    """
    bare = problem.without_terms()

    def evaluate(which: Problem, tangent: bool) -> Callable[[], object]:
        return lambda: which.evaluate(parameters, pressure, load, tangent=tangent)

    out: dict[str, float] = {}
    for name, tangent in (("residual", False), ("tangent", True)):
        evaluate(problem, tangent)()
        out[name] = least(evaluate(problem, tangent))
        evaluate(bare, tangent)()
        out[f"{name} of the tissue"] = least(evaluate(bare, tangent))
    problem.evaluate(parameters, pressure, load, tangent=True)
    out["gather"] = least(problem.tangent)
    matrix = problem.tangent()
    solver = best_solver()
    began = time.perf_counter()
    solver.factorise(matrix)
    first = time.perf_counter() - began
    out["factorisation"] = least(lambda: solver.factorise(matrix))
    out["analysis"] = first - out["factorisation"]
    right = np.ones(problem.n_unknowns)
    out["solve"] = least(lambda: solver.solve(right))
    out["unknowns"] = problem.n_unknowns
    out["matrix_entries"] = matrix.nnz
    if isinstance(solver, Pardiso):
        out["factor_entries"], out["factor_gflop"] = solver.size
    return out
