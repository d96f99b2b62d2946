"""Paths that turn back, followed by their length instead of the load."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError, SolveError
from ..progress import Report
from .laws import Array
from .linear import LinearSolver, best_solver
from .problem import Evaluation, Problem, State
from .terms import Load

__all__ = ["Stride", "trace"]


@dataclass(frozen=True)
class Stride:
    """How a path is followed.

    Attributes
    ----------
    length : float
        Root mean square of the displacement from one state to the next in mm, at first.
    least, most : float
        Bounds of it, in terms of the first.
    states : int
        After which the path ends in any case.
    tolerance : float
        Root mean square of the last correction in mm.
    iterations : int
        Corrections of one state before a shorter stride is taken.
    """

    length: float = 0.2
    least: float = 1e-3
    most: float = 4.0
    states: int = 200
    tolerance: float = 1e-6
    iterations: int = 10


def trace(
    problem: Problem,
    load: Load,
    state: State | None = None,
    stride: Stride | None = None,
    solver: LinearSolver | None = None,
    report: Report | None = None,
) -> Iterator[tuple[float, State]]:
    """Follow the equilibrium towards a load and beyond the points where the load turns back.

    Between two such points equilibrium is unstable; there `Continuation` jumps. A state is
    sought in the plane across the last tangent of the path (Riks 1979, Int. J. Solids Struct.
    15:529-551), at a distance measured in displacements alone (Crisfield 1981, Comput. Struct.
    13:55-62).

    Parameters
    ----------
    problem : Problem
    load : Load
    state : State, optional
        Where the path begins, an equilibrium; rest by default.
    stride : Stride, optional
    solver : LinearSolver, optional
    report : callable, optional
        Called with ``(fraction, message)`` after each state.

    Yields
    ------
    share : float
        Fraction of the load between that of the first state (0) and the given one (1); on a path
        that turns back it falls for a while.
    state : State
        ``statistics.wrong_pivots`` tells whether it is stable (0). The last state is the first
        beyond the load.

    Raises
    ------
    InputError
        The load moves the jaw or what is fixed, or changes nothing: a path leads through
        activations and forces.
    SolveError
        No stride, however short, leads on.
    """
    stride = Stride() if stride is None else stride
    state = problem.rest() if state is None else state
    start = state.load
    if start.offsets and not load.offsets:
        # Contacts stay pressed apart as they are.
        load = replace(load, offsets=start.offsets)
    if not replace(load, activations=start.activations, forces=start.forces).drives_like(start):
        raise InputError("load: a path leads through activations and forces; keep what is held")
    problem.check_load(load)
    path = _Path(problem, start, load, best_solver(single=False) if solver is None else solver)
    here, length = _Place(state.parameters, state.pressure, 0.0), stride.length
    before: Array | None = None
    for number in range(stride.states):
        path.factorise(here)
        rate = path.rate(here)
        size = problem.size(rate)
        if not size > 0.0:
            raise InputError("load: it changes nothing; name one that differs from the state's")
        # The way goes on as the displacements have it, also where the load turns.
        onward = 1.0 if before is None or problem.product(rate, before) > 0.0 else -1.0
        before = rate * (onward / size)
        while True:
            predicted = path.moved(here, length * before, onward * length / size)
            found = path.across(predicted, before, stride)
            if found is not None:
                break
            length *= 0.5
            if length < stride.least * stride.length:
                raise SolveError(
                    f"path: no stride leads on from {here.share:.1%} of the load, after {number} "
                    "states; look at the last one, where tissue is crushed or contacts switch"
                )
        here, corrections = found
        length = float(np.clip(3.0 / corrections, 0.5, 2.0)) * length
        length = min(length, stride.most * stride.length)
        yield here.share, path.state(here, state)
        if report is not None:
            report(min(max(here.share, 0.0), 1.0), f"load {here.share:.0%}, state {number + 1}")
        if here.share >= 1.0:
            return


@dataclass(frozen=True)
class _Place:
    """A place on the path or beside it."""

    parameters: Array
    pressure: Array
    share: float


class _Path:
    """The equilibrium between two loads."""

    def __init__(self, problem: Problem, start: Load, end: Load, solver: LinearSolver) -> None:
        self.problem = problem
        self.ends = start, end
        self.solver = solver

    def load(self, share: float) -> Load:
        return self.ends[0].towards(self.ends[1], share)

    def factorise(self, at: _Place) -> Evaluation:
        """Evaluate a place and keep the factors of its tangent."""
        found = self.problem.evaluate(at.parameters, at.pressure, self.load(at.share), tangent=True)
        self.solver.factorise(self.problem.tangent())
        return found

    def rate(self, at: _Place) -> Array:
        """Return the change of the unknowns by the share, (n,), with the factors at hand."""
        # At fixed deformation the residual is linear in the share.
        less, more = (
            self.problem.evaluate(at.parameters, at.pressure, end).residual for end in self.ends
        )
        return -self.solver.solve(more - less)

    def moved(self, at: _Place, change: Array, share: float) -> _Place:
        return _Place(*self.problem.add(at.parameters, at.pressure, change), at.share + share)

    def across(self, at: _Place, along: Array, stride: Stride) -> tuple[_Place, int] | None:
        """Return the place of the path in the plane across a direction, and the corrections."""
        last = np.inf
        for done in range(1, stride.iterations + 1):
            found = self.factorise(at)
            if not found.volume_ratio.min() > 0.05:
                return None
            change, rate = -self.solver.solve(found.residual), self.rate(at)
            share = -self.problem.product(along, change) / self.problem.product(along, rate)
            change += share * rate
            at, size = self.moved(at, change, share), self.problem.size(change)
            if size < stride.tolerance:
                return at, done
            if not size < 2.0 * last:
                return None
            last = size
        return None

    def state(self, at: _Place, first: State) -> State:
        """Return the place as a state with its figures."""
        found, load = self.factorise(at), self.load(at.share)
        pivots = self.solver.negative_pivots
        statistics = replace(
            self.problem.check(found.volume_ratio),
            max_penetration_mm=self.problem.penetration(at.parameters, load),
            wrong_pivots=None if pivots is None else pivots - self.problem.assembly.n_pressures,
        )
        return replace(
            first,
            parameters=at.parameters,
            pressure=at.pressure,
            load=load,
            statistics=statistics,
        )
