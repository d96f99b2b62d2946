"""Continuation in the load: from rest, or a known state, to full activation.

One step predicts the next state with the tangent ``dU/ds`` and corrects it by Newton's
method. Corrections are judged by the correction that would follow with the same factors
(the natural monotonicity test of Deuflhard 2004), which does not depend on how forces,
volumes and derivatives are scaled against each other; as long as they contract well they go on
with the factors at hand, to which each adds what it has taught (Broyden's method).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..compiling import working_time
from ..errors import SolveError
from ..progress import Report
from .laws import Array, Law
from .linear import LinearSolver, best_solver, symmetric_product
from .problem import Evaluation, Problem, State
from .terms import Load

#: Factorisations of a step after which the next is as long, and how much it may change at once.
EASY = 6.0
CHANGE = 0.7, 2.5
#: Share of a step in which the rate of what moves bodies is told.
ONSET = 1e-3
#: Parts of a correction that the next may have for the factors to stay: above and below tolerance.
GOOD, FAIR = 0.4, 0.7
#: Iterations without what is unstable once it has led astray.
WARY = 2
#: Conjugate directions of a correction at most, the part of it that the last may have, and how far
#: one goes in which the tangent gives way, by its own length.
CONJUGATE, ENOUGH, DOWNHILL = 10, 0.05, 4.0
#: Damping, in multiples of the first diagonal: below the least there is none; the first where the
#: tangent leads astray; beyond the most a step, or a relaxation, is given up.
LEAST_DAMPING, FIRST_DAMPING, MOST_DAMPING, MOST_VISCOSITY = 0.03, 0.1, 20.0, 1e4


@dataclass(frozen=True)
class Settings:
    """What the continuation may do.

    Attributes
    ----------
    tolerance : float
        Root mean square of the displacement's correction in mm at which a step ends. The
        pressures' is then below the same part of them, or of 1 kPa where they are less.
    passing : float
        The same for the steps before the last, whose only use is to begin the next one.
    pressing : float
        The same as long as contacts overlap that are pressed apart afterwards.
    first_step, least_step : float
        Fractions of the load.
    warm_change : float
        Greatest change of an activation in the first step from a known state.
    max_steps : int
        Converged and rejected steps together.
    max_iterations : int
        Factorisations in one step before it is rejected.
    patience : int
        Those after which corrections that have to be shortened are damped instead.
    max_jumps : int
        How often the tissue may leave a path that ends or turns back for an equilibrium elsewhere.
    max_relaxations : int
        Factorisations on the way to it.
    least_ratio : float
        Smallest volume ratio at a Gauss point that a trial may have.
    penetration : float
        Overlap in mm of contacts from which their forces are augmented at the end.
    augmentations : int
        How often at most.
    near : float
        Correction in mm, root mean square, below which the tangent is the exact one; above,
        it leaves out what can make contacts and fibres unstable.
    """

    tolerance: float = 3e-4
    passing: float = 2e-2
    pressing: float = 1e-3
    first_step: float = 0.06
    least_step: float = 2e-3
    warm_change: float = 0.1
    max_steps: int = 80
    max_iterations: int = 30
    patience: int = 8
    max_jumps: int = 5
    max_relaxations: int = 60
    least_ratio: float = 0.05
    penetration: float = 0.04
    augmentations: int = 8
    near: float = 2e-2


class LoadNotReached(SolveError):
    """The load could not be reached; the text says how far it came, where and why it stopped.

    Attributes
    ----------
    reached : float
        Fraction of the load.
    state : State
        The last converged state, at that fraction.
    """

    def __init__(self, text: str, reached: float, state: State) -> None:
        super().__init__(text)
        self.reached = reached
        self.state = state


class Interrupted(KeyboardInterrupt):
    """The way to a load was interrupted.

    Attributes
    ----------
    reached : float
        Fraction of the load.
    state : State
        The last converged state, at that fraction.
    """

    def __init__(self, reached: float, state: State) -> None:
        super().__init__(f"interrupted at {reached:.1%} of the load")
        self.reached = reached
        self.state = state


@dataclass(frozen=True)
class _Iterate:
    """A point on the way to an equilibrium, and the terms evaluated there."""

    parameters: Array
    pressure: Array
    evaluation: Evaluation


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
        # Exponential laws span more than single precision can hold, and a fine tolerance takes
        # fewer iterations in double precision.
        single = problem.formulation.law == Law.ISOCHORIC and self.settings.tolerance > 1e-6
        self.solver = best_solver(single) if solver is None else solver
        self._at_hand = False
        self._reached = 0.0
        self._diagonal: Array | None = None
        self._factorisations = 0
        self._iterations = 0
        self._jumps = 0
        self._energies: dict[str, float] = {}
        self._driven: list[str] = []
        self._blamed: list[str] = []

    def run(self, load: Load) -> State:
        """Follow the equilibrium from the present load to ``load``.

        Returns
        -------
        State
            With the statistics of this run.

        Raises
        ------
        InputError
            The load drives what the problem has not, see `Problem.check_load`.
        LoadNotReached
            A `SolveError` whose text says how far it came, what stopped it, where the tissue
            suffers most and what to try.
        Interrupted
            A `KeyboardInterrupt` that has the last converged state.
        """
        self.problem.check_load(load)
        self._reached = 0.0
        try:
            return self._follow(load)
        except KeyboardInterrupt:
            self._at_hand = False
            raise Interrupted(self._reached, self._told()) from None

    def _follow(self, load: Load) -> State:
        """Take steps to a load, and press contacts apart there."""
        began = working_time()
        self._factorisations = self._iterations = self._jumps = 0
        start, settings = self.state.load, self.settings
        # Contacts begin with what has pressed them apart in a known state.
        kept = bool(start.offsets) and not load.offsets
        if kept:
            load = replace(load, offsets=start.offsets)
        # A state of another mesh may begin at the very load, and smaller steps are no way to it.
        moves = not start.drives_like(load)
        self._driven = [name for name, value in load.activations.items() if value > 0.0]
        self._blamed = []
        reached, step, steps, fault = 0.0, self._first_step(load), 0, ""

        def goal(target: float) -> tuple[Load, float, float]:
            if target < 1.0:
                return start.towards(load, target), settings.passing, math.inf
            # What will be pressed apart need not be told so finely.
            limit = settings.penetration if settings.augmentations else math.inf
            return load, settings.tolerance, limit

        while reached < 1.0:
            target = min(1.0, reached + step)
            if target > 1.0 - 0.05 * step:
                target = 1.0
            before = self._factorisations
            steps += 1
            try:
                state = self._advance(*goal(target))
            except SolveError as error:
                step = 0.3 * (target - reached)
                self._at_hand = False
                fault = str(error)
                if moves and step >= settings.least_step and steps < settings.max_steps:
                    continue
                target = min(1.0, reached + settings.first_step)
                try:
                    if steps >= settings.max_steps or self._jumps >= settings.max_jumps:
                        raise
                    state = self._relax(*goal(target))
                except SolveError:
                    text = self._account(load, reached, fault, steps)
                    raise LoadNotReached(text, reached, self._told()) from None
                self._jumps += 1
            work = max(self._factorisations - before, 1)
            step = (target - reached) * float(np.clip(EASY / work, *CHANGE))
            self._reached = reached = target
            self._keep(state, steps, began)
            if reached < 1.0 and steps >= settings.max_steps:
                fault = f"the last step that failed: {fault}" if fault else "no step failed"
                text = self._account(load, reached, fault, steps)
                raise LoadNotReached(text, reached, self._told())
            if self.report is not None:
                statistics = self.state.statistics
                self.report(reached, f"J {statistics.J_min:.2f} to {statistics.J_max:.2f}")
        self._press(steps, began, kept)
        return self._told()

    def _press(self, steps: int, began: float, kept: bool) -> None:
        """Press contacts apart as long as they overlap (Uzawa's method).

        Where they are pressed as they were in an earlier state, once at least.
        """
        settings = self.settings
        try:
            for done in range(settings.augmentations):
                again = kept and done == 0
                if not again and self._told().statistics.max_penetration_mm <= settings.penetration:
                    break
                if self.report is not None:
                    overlap = self.problem.overlap(self.state.parameters, self.state.load)
                    self.report(1.0, f"pressing apart what overlaps by {overlap:.2f} mm")
                pressed = self.problem.augment(self.state.parameters, self.state.load)
                state = self._advance(pressed, settings.tolerance, settings.penetration)
                self._keep(state, steps, began)
            if self.state.statistics.correction_mm > settings.tolerance:
                self._keep(self._advance(self.state.load, settings.tolerance), steps, began)
        except SolveError:
            # The overlap of the penalty remains, and is told, as is the last correction.
            self._at_hand = False

    def _first_step(self, load: Load) -> float:
        """Return the first step: small at rest, and from a known state by what changes."""
        start, settings = self.state.load, self.settings
        change = [
            abs(load.activations.get(name, 0.0) - start.activations.get(name, 0.0))
            for name in {*load.activations, *start.activations}
        ]
        known = start.activations and start.jaw == load.jaw and start.forces == load.forces
        if not known:
            return settings.first_step
        return float(np.clip(settings.warm_change / max(max(change), 1e-9), settings.first_step, 1))

    def _keep(self, state: State, steps: int, began: float) -> None:
        statistics = replace(
            state.statistics,
            steps=steps,
            jumps=self._jumps,
            newton_iterations=self._iterations,
            factorisations=self._factorisations,
            solve_s=working_time() - began,
        )
        self.state = replace(state, statistics=statistics)

    def _told(self) -> State:
        """Return the last state with the overlap of its contacts.

        It takes longer to find than a correction, so that it is not sought at every step.
        """
        state = self.state
        if math.isnan(state.statistics.max_penetration_mm):
            overlap = self.problem.penetration(state.parameters, state.load)
            statistics = replace(state.statistics, max_penetration_mm=overlap)
            self.state = replace(state, statistics=statistics)
        return self.state

    def sensitivities(self, muscles: Sequence[str]) -> Array:
        """Return the derivatives of the present state's parameters by activations.

        ``dU/da = -K⁻¹ ∂R/∂a``, with the exact tangent of the present state, whose factors also
        serve the next step.

        Parameters
        ----------
        muscles : sequence of k str

        Returns
        -------
        (n_params, 3, k) array
            In mm.
        """
        return self.answers(
            self.problem.activation_slopes(self.state.parameters, muscles, self.state.load)
        )

    def answers(self, slopes: Array, held: Array | None = None) -> Array:
        """Return the derivatives of the present state's parameters by whatever changes it.

        ``dU/dp = -K⁻¹ (∂R/∂p + K dU_h/dp)`` with the fixed parameters ``U_h``.

        Parameters
        ----------
        slopes : (n, k) array
            Derivatives of the residual at fixed deformation.
        held : (n_params, 3, k) array, optional
            Derivatives of the fixed parameters, 0 at those that are free.

        Returns
        -------
        (n_params, 3, k) array
            In mm.
        """
        problem, state = self.problem, self.state
        self._factorise(state.parameters, state.pressure, state.load)
        equations = problem.assembly.equations
        out = np.zeros((*equations.shape, slopes.shape[1]))
        if held is not None:
            out += held
            moved = [problem.assembly.multiply(part) for part in np.moveaxis(held, 2, 0)]
            slopes = slopes + np.stack(moved, axis=1)
        change = -self.solver.solve(slopes)
        # Once more for what factors of single precision have left over.
        change -= self.solver.solve(slopes + symmetric_product(problem.tangent(), change))
        change = change.reshape(slopes.shape)
        out[equations >= 0] = change[equations[equations >= 0]]
        return out

    def _factorise(
        self,
        parameters: Array,
        pressure: Array,
        load: Load,
        *,
        convex: bool = False,
        damping: float = 0.0,
    ) -> Evaluation:
        evaluation = self.problem.evaluate(parameters, pressure, load, tangent=True, convex=convex)
        self._refactorise(damping)
        return evaluation

    def _refactorise(self, damping: float) -> None:
        """Factorise the element tangents at hand, with a multiple of the first diagonal added."""
        extra = None if self._diagonal is None or damping == 0.0 else damping * self._diagonal
        matrix = self.problem.tangent(extra)
        if self._diagonal is None:
            self._diagonal = matrix.diagonal()[: self.problem.assembly.n_displacements]
        self.solver.factorise(matrix)
        self._factorisations += 1
        self._at_hand = damping == 0.0 and self._wrong_pivots() <= 0

    def _conjugate(self, residual: Array) -> Array:
        """Return the correction by the last tangent with the factors of another that is stable.

        Conjugate gradients, with the factors as preconditioner. They share the volumes' rows, which
        the first solution meets, so that what follows are displacements that keep the volume.
        Along a direction in which the tangent gives way the correction goes on downhill.
        """
        matrix = self.problem.tangent()
        change = -self.solver.solve(residual)
        left = -residual - symmetric_product(matrix, change)
        direction, last = np.zeros_like(change), math.inf
        least = ENOUGH * self.problem.size(change)
        for _ in range(CONJUGATE):
            step = self.solver.solve(left)
            if self.problem.size(step) < least:
                break
            drop = float(left @ step)
            direction = step + drop / last * direction
            last = drop
            force = symmetric_product(matrix, direction)
            bend = float(direction @ force)
            if bend <= 0.0:
                return np.asarray(change + min(drop / max(-bend, 1e-30), DOWNHILL) * direction)
            change += drop / bend * direction
            left -= drop / bend * force
        return change

    def _wrong_pivots(self) -> int:
        found = self.solver.negative_pivots
        return 0 if found is None else found - self.problem.assembly.n_pressures

    def _trial(self, here: _Iterate, change: Array, factor: float, load: Load) -> _Iterate | None:
        """Return where a change leads to, None where it would crush the tissue."""
        current = replace(self.state, parameters=here.parameters, pressure=here.pressure)
        parameters, pressure = self.problem.add(current, change, factor)
        evaluation = self.problem.evaluate(parameters, pressure, load)
        if not evaluation.volume_ratio.min() > self.settings.least_ratio:
            return None
        return _Iterate(parameters, pressure, evaluation)

    def _held(self, load: Load) -> Array:
        """Return how far a load moves the fixed parameters from the last state, (n_params, 3)."""
        held = self.problem.prescribe(load) - self.state.parameters
        held[~self.problem.fixed] = 0.0
        return held

    def _onset(self, load: Load, still: Array) -> Array:
        """Return the forces on the last state as a load begins to act, at the rate of its onset.

        A body that moves as far as the step would go into tissue that does not yet follow, or
        leave it. ``still`` are the forces before.
        """
        state = self.state
        begun = state.load.towards(load, ONSET)
        pushed = self.problem.evaluate(state.parameters, state.pressure, begun).residual
        return np.asarray(still + (pushed - still) / ONSET)

    def _predict(self, load: Load) -> _Iterate:
        """Move along the tangent against the whole change of the load.

        The factors at hand will do: they stem from a point within a correction or two of the
        last state.
        """
        problem, state = self.problem, self.state
        held = self._held(load)
        moved, right = state.parameters + held, None
        if not self._at_hand or held.any():
            still = self._factorise(state.parameters, state.pressure, state.load).residual
            if held.any():
                right = self._onset(load, still) + problem.assembly.multiply(held)
        here = _Iterate(moved, state.pressure, problem.evaluate(moved, state.pressure, load))
        if right is None:
            right = here.evaluation.residual
        change = -self.solver.solve(right)
        factor = 1.0
        while factor > 0.1:
            there = self._trial(here, change, factor, load)
            if there is not None:
                return there
            factor *= 0.5
        # Near a limit point the tangent leads nowhere; the corrections begin at rest.
        return here

    def _advance(self, load: Load, tolerance: float, overlap: float = math.inf) -> State:
        """Predict and correct the equilibrium at ``load``, or reject the step."""
        return self._correct(self._predict(load), load, tolerance, overlap)

    def _correct(
        self, here: _Iterate, load: Load, tolerance: float, overlap: float = math.inf
    ) -> State:
        """Return the equilibrium at ``load`` that is near a point, or reject the step.

        Where contacts overlap by more than ``overlap`` (mm), `Settings.pressing` will do.
        """
        settings = self.settings

        def enough(change: Array, there: _Iterate) -> bool:
            size = max(self.problem.size(change), self._lag(change, there))
            if size >= settings.pressing:
                return size < tolerance
            return size < tolerance or self.problem.overlap(there.parameters, load) > overlap

        change = -self.solver.solve(here.evaluation.residual)
        here, size, settled = self._settle(here, change, load, enough)
        damping = 0.0
        wary = 0
        # Whether the exact tangent was unstable: its corrections come from the factors of another.
        unstable = False
        if settled:
            return self._converged(here, load, size)
        for done in range(settings.max_iterations):
            convex = wary > 0 or size > settings.near
            if unstable and not convex:
                evaluation = self.problem.evaluate(
                    here.parameters, here.pressure, load, tangent=True
                )
                change = self._conjugate(evaluation.residual)
                size = self.problem.size(change)
                self._iterations += 1
                found = self._search(here, change, size, load, tolerance, True)
                if found is None:
                    unstable, wary = False, WARY
                    continue
            else:
                evaluation = self._factorise(
                    here.parameters, here.pressure, load, convex=convex, damping=damping
                )
                found = None
            while found is None:
                # A negative pivot too many means that the tissue would buckle away from
                # here, an empty line search that the tangent leads astray.
                if self._wrong_pivots() <= 0:
                    change = -self.solver.solve(evaluation.residual)
                    size = self.problem.size(change)
                    self._iterations += 1
                    far = wary > 0 or size > tolerance
                    found = self._search(here, change, size, load, tolerance, far)
                    if found is not None:
                        break
                if not convex:
                    unstable, convex = self._wrong_pivots() > 0, True
                    self._factorise(
                        here.parameters, here.pressure, load, convex=True, damping=damping
                    )
                    unstable = unstable and size < settings.passing and self._wrong_pivots() <= 0
                    if unstable:
                        break
                    wary = WARY
                    continue
                damping = max(10.0 * damping, FIRST_DAMPING)
                if damping > MOST_DAMPING:
                    raise self._fault("no damping makes the corrections descend", evaluation)
                self._refactorise(damping)
            if found is None:
                continue
            here, following, full = found
            wary = max(wary - 1, 0)
            after = self.problem.size(following)
            # Where such corrections do not contract, the exact tangent may serve again.
            unstable = unstable and (convex or after < GOOD * size)
            exact = damping == 0.0 and not convex
            if exact and size < tolerance and enough(following, here):
                # Where contacts switch, corrections need not shrink any more.
                return self._converged(here, load, max(size, after))
            # Corrections that are damped, or hardly shrink, are small far from equilibrium too.
            if full and damping == 0.0 and after < (GOOD if after > tolerance else FAIR) * size:
                here, size, settled = self._settle(here, following, load, enough)
                if settled:
                    return self._converged(here, load, size)
            else:
                size = after
            if after < tolerance:
                # Whether they are as short as that only corrections without damping tell.
                damping = 0.0
            elif full or done < settings.patience:
                damping = 0.0 if damping < LEAST_DAMPING else 0.2 * damping
            else:
                # Contacts stand in the way of one correction after the other: slide round them.
                damping = max(3.0 * damping, LEAST_DAMPING)
        raise self._fault(f"{settings.max_iterations} iterations were not enough", evaluation)

    def _relax(self, load: Load, tolerance: float, overlap: float = math.inf) -> State:
        """Let the tissue flow from the last state to an equilibrium at ``load``, which may be far.

        Where the path ends or turns back there is no equilibrium nearby. The tissue moves as if
        in a viscous bath, by implicit steps in a time that does not matter: each adds a multiple
        of the first diagonal to a tangent without what is unstable. The multiple falls as long
        as the steps do not go astray; once they shrink without it Newton's method takes over.
        """
        problem, settings = self.problem, self.settings
        state = self.state
        moved = state.parameters + self._held(load)
        here = _Iterate(moved, state.pressure, problem.evaluate(moved, state.pressure, load))
        viscosity = 1.0
        for _ in range(settings.max_relaxations):
            evaluation = self._factorise(
                here.parameters, here.pressure, load, convex=True, damping=viscosity
            )
            found = None
            while found is None:
                if self._wrong_pivots() <= 0:
                    change = -self.solver.solve(evaluation.residual)
                    size = problem.size(change)
                    found = self._search(here, change, size, load, tolerance, size > tolerance)
                if found is None:
                    viscosity *= 4.0
                    if viscosity > MOST_VISCOSITY:
                        raise self._fault("no viscosity keeps the tissue whole", evaluation)
                    self._refactorise(viscosity)
            self._iterations += 1
            here, following, full = found
            if viscosity < LEAST_DAMPING and full and problem.size(following) < 0.5 * size:
                break
            viscosity *= 0.3
        self._at_hand = False
        return self._correct(here, load, tolerance, overlap)

    def _settle(
        self,
        here: _Iterate,
        change: Array,
        load: Load,
        enough: Callable[[Array, _Iterate], bool],
    ) -> tuple[_Iterate, float, bool]:
        """Correct with the factors at hand as long as the corrections shrink by half.

        Every correction adds what it has taught to the factors (Broyden's good update, in the
        form of Deuflhard 2004, algorithm QNERR).

        Returns
        -------
        here : _Iterate
        size : float
            Of the correction that would follow.
        settled : bool
            Whether the last correction was small enough.
        """
        past = [change]
        size = self.problem.size(change)
        while True:
            there = self._trial(here, past[-1], 1.0, load)
            if there is None:
                return here, size, False
            self._iterations += 1
            if enough(past[-1], there):
                return there, size, True
            change = -self.solver.solve(there.evaluation.residual)
            for one, other in pairwise(past):
                change += self._along(change, one) * other
            after = self.problem.size(change)
            if not after < 0.5 * size:
                return (there, after, False) if after < size else (here, size, False)
            change /= 1.0 - self._along(change, past[-1])
            past.append(change)
            here, size = there, self.problem.size(change)

    def _lag(self, change: Array, there: _Iterate) -> float:
        """Return the part of the pressures that a change has brought."""
        n = self.problem.assembly.n_displacements
        # Where there is hardly any pressure, less than 1 kPa of it is not worth an iteration.
        whole = max(float(np.linalg.norm(there.pressure)), float(np.sqrt(len(change) - n)), 1e-30)
        return float(np.linalg.norm(change[n:])) / whole

    def _along(self, change: Array, direction: Array) -> float:
        """Return the share of a direction that is in a change."""
        return self.problem.product(change, direction) / self.problem.product(direction, direction)

    def _search(
        self,
        here: _Iterate,
        change: Array,
        size: float,
        load: Load,
        tolerance: float,
        far: bool,
    ) -> tuple[_Iterate, Array, bool] | None:
        """Return the first trial along ``change`` that neither crushes nor diverges.

        The correction that would follow may be up to three times as long: with contacts
        and fibres that switch, insisting on descent takes more iterations than it saves. But a
        trial that goes far past the point where the forces do no work along the way is taken
        back to there: where contacts close and open, corrections would go to and fro for ever.
        One after which the forces still do half their work goes on, up to eight times as far,
        where an equilibrium may be ``far``: where tissue gives way, every correction alone is far
        too short.

        Returns
        -------
        there : _Iterate
        following : (n,) array
            The correction that would follow.
        full : bool
            Whether ``change`` was taken as it is.
        """

        def work(at: _Iterate) -> float:
            return self.problem.work(at.evaluation.residual, change)

        start = work(here)
        factor, shortened = 1.0, False
        while factor > 0.04:
            there = self._trial(here, change, factor, load)
            if there is not None:
                if start < 0.0 and work(there) > -0.5 * start and factor > 0.2:
                    factor *= max(start / (start - work(there)), 0.2)
                    shortened = True
                    continue
                while far and not shortened and factor < 8.0:
                    if not work(there) < 0.5 * start < 0.0:
                        break
                    farther = self._trial(here, change, 2.0 * factor, load)
                    if farther is None or work(farther) > -0.5 * start:
                        break
                    there, factor = farther, 2.0 * factor
                following = -self.solver.solve(there.evaluation.residual)
                if self.problem.size(following) <= max(3.0 * max(factor, 1.0) * size, tolerance):
                    return there, following, factor == 1.0
            factor, shortened = 0.5 * factor, True
        return None

    def _converged(self, here: _Iterate, load: Load, size: float) -> State:
        wrong = None if self.solver.negative_pivots is None else self._wrong_pivots()
        statistics = replace(
            self.problem.check(here.evaluation.volume_ratio),
            max_penetration_mm=math.nan,
            wrong_pivots=wrong,
            correction_mm=size,
        )
        self._energies = here.evaluation.energies
        return replace(
            self.state,
            parameters=here.parameters,
            pressure=here.pressure,
            load=load,
            statistics=statistics,
        )

    def _fault(self, reason: str, evaluation: Evaluation) -> SolveError:
        """Return why a step is rejected, and where the tissue suffers most."""
        problem = self.problem
        worst = int(np.argmin(evaluation.volume_ratio.min(axis=1)))
        parts = [
            reason,
            f"smallest J {evaluation.volume_ratio.min():.3f} in {problem.where(worst)}",
        ]
        there = [name for name in problem.muscles_in(worst) if name in self._driven]
        if there:
            parts[-1] += f", where {_several(there)} contract{'s' if len(there) == 1 else ''}"
        change = {
            name: abs(energy - self._energies.get(name, 0.0))
            for name, energy in evaluation.energies.items()
        }
        parts.append(
            "the term whose energy changed most since the last state is "
            f"{max(change, key=lambda name: change[name])}"
        )
        self._blamed = there
        return SolveError("; ".join(parts))

    def _account(self, load: Load, reached: float, fault: str, steps: int) -> str:
        """Say how far the load went, why not farther and what to try."""
        names = [name for name, value in load.activations.items() if value > 0.0]
        if load.jaw > 0.0:
            names.append(f"jaw open by {np.degrees(load.jaw):.3g}°")
        advice = []
        if names:
            blamed = self._blamed or sorted(names, key=lambda n: -load.activations.get(n, 0.0))[:1]
            advice.append(f"less of {_several(blamed)}")
        else:
            advice.append("a smaller displacement")
        if steps >= self.settings.max_steps:
            advice.append(f"more than {steps} steps")
        advice.append("a greater volumetric stiffness")
        return (
            f"continuation: stopped at {reached:.1%} of the load "
            f"({_several(names) if names else 'the prescribed displacement'}) after {steps} "
            f"steps; {fault}; try {' or '.join(advice)}"
        )


def _several(names: Sequence[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


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
