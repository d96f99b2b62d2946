"""Continuation in the load: from rest, or a known state, to full activation.

One step predicts the next state with the tangent ``dU/ds`` and corrects it by Newton's
method. Corrections are judged by the correction that would follow with the same factors
(the natural monotonicity test of Deuflhard 2004), which does not depend on how forces,
volumes and derivatives are scaled against each other; once they contract well they go on
with the factors at hand.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..errors import SolveError
from .laws import Array
from .linear import LinearSolver, best_solver
from .problem import Evaluation, Problem, State
from .terms import Load

#: Called with the fraction of the load reached and a message.
Report = Callable[[float, str], None]


@dataclass(frozen=True)
class Settings:
    """What the continuation may do.

    Attributes
    ----------
    tolerance : float
        Root mean square of the displacement's correction in mm at which a step ends.
    first_step, least_step : float
        Fractions of the load.
    max_steps : int
        Converged and rejected steps together.
    max_iterations : int
        Factorisations in one step before it is rejected.
    least_ratio : float
        Smallest volume ratio at a Gauss point that a trial may have.
    """

    tolerance: float = 1e-4
    first_step: float = 0.2
    least_step: float = 2e-3
    max_steps: int = 80
    max_iterations: int = 12
    least_ratio: float = 0.05


class _Rejected(Exception):
    """A step that did not converge; the text says why."""


class Continuation:
    """Follow a problem's equilibrium as the load changes.

    The factors are kept, so that a small change of the load from one `run` to the next
    costs little. After an interruption or an error `state` is the last converged state.

    Parameters
    ----------
    problem : Problem
    state : State, optional
        Where to begin; rest by default.
    settings : Settings, optional
    report : callable, optional
        Called with ``(fraction, message)`` as the load grows.
    solver : LinearSolver, optional
        PARDISO where there is one.

    Attributes
    ----------
    state : State
        Last converged state.
    """

    def __init__(
        self,
        problem: Problem,
        state: State | None = None,
        *,
        settings: Settings | None = None,
        report: Report | None = None,
        solver: LinearSolver | None = None,
    ) -> None:
        self.problem = problem
        self.state = problem.rest() if state is None else state
        self.settings = Settings() if settings is None else settings
        self.report = report
        self.solver = best_solver() if solver is None else solver
        self._fresh = False
        self._factorisations = 0
        self._iterations = 0
        self._trouble = ""

    def run(self, load: Load) -> State:
        """Follow the equilibrium from the present load to ``load``.

        Returns
        -------
        State
            With the statistics of this run.

        Raises
        ------
        SolveError
            If the load cannot be reached; the message says how far it came and why.
        """
        began = time.perf_counter()
        self._factorisations = self._iterations = 0
        start, settings = self.state.load, self.settings
        reached, step, steps = 0.0, settings.first_step, 0
        while reached < 1.0:
            target = min(1.0, reached + step)
            if target > 1.0 - 0.05 * step:
                target = 1.0
            before = self._factorisations
            try:
                if steps >= settings.max_steps:
                    self._trouble = f"{steps} steps were not enough"
                    raise _Rejected
                steps += 1
                state = self._advance(start.towards(load, target))
            except _Rejected:
                step = 0.4 * (target - reached)
                self._fresh = False
                if step < settings.least_step or steps >= settings.max_steps:
                    raise SolveError(self._account(load, reached)) from None
                continue
            work = self._factorisations - before
            step = (target - reached) * (1.7 if work <= 3 else 1.25 if work <= 5 else 0.7)
            reached = target
            statistics = replace(
                state.statistics,
                steps=steps,
                newton_iterations=self._iterations,
                factorisations=self._factorisations,
                solve_s=time.perf_counter() - began,
            )
            self.state = replace(state, statistics=statistics)
            if self.report is not None:
                self.report(
                    reached,
                    f"load {reached:.0%}, J {statistics.J_min:.2f} to {statistics.J_max:.2f}",
                )
        return self.state

    def _factorise(self, parameters: Array, pressure: Array, load: Load) -> Evaluation:
        evaluation = self.problem.evaluate(parameters, pressure, load, tangent=True)
        self.solver.factorise(self.problem.tangent())
        self._factorisations += 1
        return evaluation

    def _advance(self, load: Load) -> State:
        """Return the equilibrium at ``load``, or reject the step."""
        problem, settings = self.problem, self.settings
        state = self.state
        problem.update(state.parameters)
        if not self._fresh:
            self._factorise(state.parameters, state.pressure, state.load)
            self._fresh = True
        # Predictor: the tangent of the last state against the whole change of the load.
        held = problem.prescribe(load) - state.parameters
        held[~problem.fixed] = 0.0
        right = problem.evaluate(state.parameters, state.pressure, load).residual
        if held.any():
            right = right + problem.assembly.multiply(held)
        change = -self.solver.solve(right)
        moved = replace(state, parameters=state.parameters + held)
        factor = 1.0
        while True:
            parameters, pressure = problem.add(moved, change, factor)
            evaluation = problem.evaluate(parameters, pressure, load)
            if evaluation.volume_ratio.min() > settings.least_ratio:
                break
            factor *= 0.5
            if factor < 0.1:
                self._reject("the prediction crushes the tissue", evaluation)
        for _ in range(settings.max_iterations):
            evaluation = self._factorise(parameters, pressure, load)
            change = -self.solver.solve(evaluation.residual)
            size = problem.size(change)
            self._iterations += 1
            if not np.isfinite(size):
                self._reject("the tangent is singular", evaluation)
            current = replace(state, parameters=parameters, pressure=pressure)
            factor = 1.0
            while True:
                parameters, pressure = problem.add(current, change, factor)
                evaluation = problem.evaluate(parameters, pressure, load)
                if evaluation.volume_ratio.min() > settings.least_ratio:
                    following = -self.solver.solve(evaluation.residual)
                    after = problem.size(following)
                    if after <= max((1.0 - 0.25 * factor) * size, settings.tolerance):
                        break
                factor *= 0.5
                if factor < 0.04:
                    self._reject("the line search found no descent", evaluation)
            # Go on with these factors while that contracts well.
            while factor == 1.0 and (after < 0.25 * size or after < settings.tolerance):
                current = replace(state, parameters=parameters, pressure=pressure)
                tried = problem.add(current, following)
                evaluation = problem.evaluate(*tried, load)
                if not evaluation.volume_ratio.min() > settings.least_ratio:
                    break
                parameters, pressure = tried
                self._iterations += 1
                if after < settings.tolerance:
                    return self._converged(parameters, pressure, load, evaluation)
                size = after
                following = -self.solver.solve(evaluation.residual)
                after = problem.size(following)
        self._reject(f"{settings.max_iterations} iterations were not enough", evaluation)
        raise AssertionError

    def _converged(
        self, parameters: Array, pressure: Array, load: Load, evaluation: Evaluation
    ) -> State:
        wrong = self.solver.negative_pivots
        if wrong is not None:
            wrong -= self.problem.assembly.n_pressures
        statistics = replace(
            self.problem.check(parameters, evaluation.volume_ratio), wrong_pivots=wrong
        )
        return replace(
            self.state, parameters=parameters, pressure=pressure, load=load, statistics=statistics
        )

    def _reject(self, reason: str, evaluation: Evaluation) -> None:
        worst = int(np.argmin(evaluation.volume_ratio.min(axis=1)))
        energies = {k: v for k, v in evaluation.energies.items() if k != "tissue"}
        term = max(energies, key=lambda name: abs(energies[name]), default="tissue")
        self._trouble = (
            f"{reason}; smallest J {evaluation.volume_ratio.min():.3f} in "
            f"{self.problem.where(worst)}; the term with the greatest energy is {term}"
        )
        raise _Rejected

    def _account(self, load: Load, reached: float) -> str:
        names = [name for name, value in load.activations.items() if value > 0.0]
        driven = ", ".join(names) if names else "the prescribed displacement"
        return (
            f"continuation: stopped at {reached:.1%} of the load ({driven}); {self._trouble}; "
            "try lower activations, a greater volumetric stiffness or more steps"
        )


def solve(
    problem: Problem,
    load: Load,
    *,
    state: State | None = None,
    settings: Settings | None = None,
    report: Report | None = None,
) -> State:
    """Solve for the equilibrium at ``load``, from rest or a known state.

    See `Continuation`, which also keeps the factors for further loads.
    """
    return Continuation(problem, state, settings=settings, report=report).run(load)
