"""Where the time of a solution goes: one measurement of each of its parts."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from .contact import EdgeContact, RigidContact, SurfaceContact
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


def without_contact(problem: Problem) -> Problem:
    """Return the problem as if nothing touched anything, on matrices of the same pattern."""
    contacts = RigidContact | SurfaceContact | EdgeContact
    return problem.part([term for term in problem.terms if not isinstance(term, contacts)])


def parts(problem: Problem, parameters: Array, pressure: Array, load: Load) -> dict[str, float]:
    """Measure the parts of one Newton iteration at a state.

    Returns
    -------
    dict of str to float
        Wall times in seconds: ``residual`` and ``tangent`` of all terms, of the passive tissue
        alone and of the contacts, ``gather`` of the matrix, ``analysis``, ``factorisation`` and
        ``solve`` of the linear system. Beside them what is worked on: ``unknowns``,
        ``matrix_entries`` and, with PARDISO, ``factor_entries`` and ``factor_gflop``, the
        operations of a factorisation.
    """
    bare, free = problem.part([]), without_contact(problem)

    def evaluation(which: Problem, tangent: bool) -> float:
        def work() -> object:
            return which.evaluate(parameters, pressure, load, tangent=tangent)

        work()
        return least(work)

    out: dict[str, float] = {}
    for name, tangent in (("residual", False), ("tangent", True)):
        out[name] = evaluation(problem, tangent)
        out[f"{name} of the tissue"] = evaluation(bare, tangent)
        out[f"{name} of the contacts"] = max(out[name] - evaluation(free, tangent), 0.0)
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


@dataclass(frozen=True)
class Machine:
    """What a machine can do at best, measured.

    Attributes
    ----------
    single, double : float
        Operations of a product of large matrices a second, in 1e9.
    memory : float
        Bytes that a copy of a large array moves a second, in 1e9.
    """

    single: float
    double: float
    memory: float

    @classmethod
    def measured(cls) -> Machine:
        """Multiply matrices and copy an array."""
        n = 1500
        rates = []
        for kind in (np.float32, np.float64):
            one = np.ones((n, n), dtype=kind)
            rates.append(2e-9 * n**3 / least(lambda one=one: one @ one))  # type: ignore[misc]
        source = np.ones(2**24)
        target = np.empty_like(source)
        seconds = least(lambda: np.copyto(target, source))
        return cls(rates[0], rates[1], 2e-9 * source.nbytes / seconds)


def floor(problem: Problem, found: Mapping[str, float], machine: Machine) -> dict[str, float]:
    """Return the least time in seconds in which the machine could do the parts of an iteration.

    Operations and bytes are counted, and divided by what it does of them at best: the products of
    the tissue's tangent (``6 (6 q m² + 18 q m)`` an element of ``m`` functions and ``q`` points),
    those of the factorisation, the element tangents that are read and the matrix that is written,
    and the factor that is read twice in a solve.

    Parameters
    ----------
    problem : Problem
    found : mapping of str to float
        From `parts`.
    machine : Machine
    """
    functions = problem.pattern.counts.astype(float)
    points = problem.weights.shape[1]
    tangent = 1e-9 * (36.0 * points * functions**2 + 108.0 * points * functions).sum()
    out = {"tangent of the tissue": float(tangent / machine.double)}
    read, written = problem.assembly.traffic
    out["gather"] = 8e-9 * (read + written) / machine.memory
    if "factor_gflop" in found:
        out["factorisation"] = found["factor_gflop"] / machine.single
        out["solve"] = 2.0 * 4e-9 * found["factor_entries"] / machine.memory
    return out
