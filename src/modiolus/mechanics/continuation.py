"""Continuation in the load: from rest, or a known state, to full activation.

One step predicts the next state with the tangent ``dU/ds`` and corrects it by Newton's
method. Corrections are judged by the correction that would follow with the same factors
(the natural monotonicity test of Deuflhard 2004), which does not depend on how forces,
volumes and derivatives are scaled against each other; as long as they contract well they go on
with the factors at hand, to which each adds what it has taught (Broyden's method).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
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
#: Times that the last step may fail before its end need not be told so finely.
LAST_STEPS = 2
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
    rough : float
        The same for a load where contacts do not let corrections become as short as `tolerance`;
        the statistics tell.
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
    rough: float = 2e-2
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
class _Goal:
    """The equilibrium that is sought, and how finely.

    Attributes
    ----------
    load : Load
    tolerance : float
        Of the last correction, see `Settings`.
    overlap : float
        Where contacts overlap by more than this (mm), `Settings.pressing` will do.
    """

    load: Load
    tolerance: float
    overlap: float = math.inf


@dataclass(frozen=True)
class _Iterate:
    """A point on the way to an equilibrium, and the terms evaluated there."""

    parameters: Array
    pressure: Array
    evaluation: Evaluation


@dataclass(frozen=True)
class _Correction:
    """A correction that has been accepted.

    Attributes
    ----------
    there : _Iterate
        Where it leads.
    size : float
        Its own, before it was lengthened or shortened.
    full : bool
        Whether it was taken as it is.
    following : (n,) array
        The correction that would follow with the same factors.
    after : float
        The size of that.
    """

    there: _Iterate
    size: float
    full: bool
    following: Array
    after: float


@dataclass
class _Caution:
    """What the corrections of a step have taught of its tangents.

    Attributes
    ----------
    damping : float
        Multiple of the first diagonal that is added.
    wary : int
        Iterations for which what can be unstable is left out, near equilibrium, too.
    unstable : bool
        Whether the exact tangent is: then its corrections come from the factors of another.
    """

    damping: float = 0.0
    wary: int = 0
    unstable: bool = False

    def learn(self, found: _Correction, tolerance: float, patient: bool) -> None:
        """Become more or less careful after a correction."""
        self.wary = max(self.wary - 1, 0)
        if found.after < tolerance:
            # Whether they are as short as that only corrections without damping tell.
            self.damping = 0.0
        elif found.full or patient:
            self.damping = 0.0 if self.damping < LEAST_DAMPING else 0.2 * self.damping
        else:
            # Contacts stand in the way of one correction after the other: slide round them.
            self.damping = max(3.0 * self.damping, LEAST_DAMPING)


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
        # Of the factors at hand.
        self._damping = 0.0
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
        finest, failed = settings.tolerance, 0

        def goal(target: float) -> _Goal:
            if target < 1.0:
                return _Goal(start.towards(load, target), settings.passing)
            # What will be pressed apart need not be told so finely.
            limit = settings.penetration if settings.augmentations else math.inf
            return _Goal(load, finest, limit)

        while reached < 1.0:
            target = min(1.0, reached + step)
            if target > 1.0 - 0.05 * step:
                target = 1.0
            before = self._factorisations
            steps += 1
            try:
                state = self._advance(goal(target))
            except SolveError as error:
                self._at_hand = False
                fault = str(error)
                failed += target == 1.0
                if failed == LAST_STEPS and finest < settings.rough and steps < settings.max_steps:
                    # Where a contact point comes and goes, corrections go to and fro for ever.
                    finest = settings.rough
                    continue
                step = 0.3 * (target - reached)
                if moves and step >= settings.least_step and steps < settings.max_steps:
                    continue
                target = min(1.0, reached + settings.first_step) if moves else 1.0
                try:
                    if steps >= settings.max_steps or self._jumps >= settings.max_jumps:
                        raise
                    state = self._relax(goal(target))
                except SolveError:
                    raise self._stopped(load, reached, fault, steps) from None
                self._jumps += 1
            work = max(self._factorisations - before, 1)
            step = (target - reached) * float(np.clip(EASY / work, *CHANGE))
            self._reached = reached = target
            self._keep(state, steps, began)
            if reached < 1.0 and steps >= settings.max_steps:
                fault = f"the last step that failed: {fault}" if fault else "no step failed"
                raise self._stopped(load, reached, fault, steps)
            if self.report is not None:
                statistics = self.state.statistics
                self.report(reached, f"J {statistics.J_min:.2f} to {statistics.J_max:.2f}")
        self._press(steps, began, kept, finest)
        self._judge(steps, began)
        return self._told()

    def _press(self, steps: int, began: float, kept: bool, finest: float) -> None:
        """Press contacts apart as long as they overlap (Uzawa's method).

        Where they are pressed as they were in an earlier state, once at least. Where a correction
        fails the last state remains, an equilibrium all the same, and its statistics tell so.
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
                goal = _Goal(pressed, finest, settings.penetration)
                self._keep(self._advance(goal), steps, began)
            if self.state.statistics.correction_mm > settings.tolerance:
                goal = _Goal(self.state.load, settings.tolerance)
                self._keep(self._advance(goal), steps, began)
        except SolveError:
            self._at_hand = False
            self._keep(self.state, steps, began)
            told = self._told().statistics
            apart = told.max_penetration_mm <= settings.penetration
            self.state = replace(self.state, statistics=replace(told, pressed=apart))

    def _judge(self, steps: int, began: float) -> None:
        """Tell whether the last state is stable, by its exact tangent.

        The factors that led there are of a point nearby, damped or without what is unstable. Those
        made here serve the next step.
        """
        try:
            self._factorise(self.state, self.state.load)
        except SolveError:
            return
        if self.solver.negative_pivots is not None:
            known = replace(self.state.statistics, wrong_pivots=self._wrong_pivots())
            self._keep(replace(self.state, statistics=known), steps, began)

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
        self._factorise(state, state.load)
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
        self, here: State | _Iterate, load: Load, *, convex: bool = False, damping: float = 0.0
    ) -> None:
        """Factorise the tangent at a point, or one without what can make it unstable."""
        if self._diagonal is None:
            self.solver.expect(self.problem.assembly.structure)
        self.problem.evaluate(here.parameters, here.pressure, load, tangent=True, convex=convex)
        self._refactorise(damping)

    def _refactorise(self, damping: float) -> None:
        """Factorise the element tangents at hand, with a multiple of the first diagonal added."""
        # Should the solver fail, or be interrupted, there are none.
        self._at_hand = False
        extra = None if self._diagonal is None or damping == 0.0 else damping * self._diagonal
        matrix = self.problem.tangent(extra)
        if self._diagonal is None:
            self._diagonal = matrix.diagonal()[: self.problem.assembly.n_displacements]
        self.solver.factorise(matrix)
        self._factorisations += 1
        self._damping = damping
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

    def _evaluate(self, parameters: Array, pressure: Array, load: Load) -> _Iterate:
        return _Iterate(parameters, pressure, self.problem.evaluate(parameters, pressure, load))

    def _trial(
        self, here: State | _Iterate, change: Array, factor: float, load: Load
    ) -> _Iterate | None:
        """Return where a change leads to, None where it would crush the tissue."""
        moved = self.problem.add(here.parameters, here.pressure, factor * change)
        there = self._evaluate(*moved, load)
        if not there.evaluation.volume_ratio.min() > self.settings.least_ratio:
            return None
        return there

    def _held(self, load: Load) -> Array:
        """Return how far a load moves the fixed parameters from the last state, (n_params, 3)."""
        held = self.problem.prescribe(load) - self.state.parameters
        held[~self.problem.fixed] = 0.0
        return held

    def _onset(self, load: Load) -> Array:
        """Return the forces on the last state as a load begins to act, at the rate of its onset.

        A body that moves as far as the step would go into tissue that does not yet follow, or
        leave it.
        """
        state = self.state

        def forces(at: Load) -> Array:
            return self.problem.evaluate(state.parameters, state.pressure, at).residual

        still, pushed = forces(state.load), forces(state.load.towards(load, ONSET))
        return np.asarray(still + (pushed - still) / ONSET)

    def _predict(self, load: Load) -> _Iterate:
        """Move along the tangent against the whole change of the load.

        The factors at hand will do: they stem from a point within a correction or two of the
        last state.
        """
        state, held = self.state, self._held(load)
        if held.any() or not self._at_hand:
            self._factorise(state, state.load)
        moved = replace(state, parameters=state.parameters + held)
        if held.any():
            right = self._onset(load) + self.problem.assembly.multiply(held)
        else:
            right = self.problem.evaluate(state.parameters, state.pressure, load).residual
        change = -self.solver.solve(right)
        factor = 1.0
        while factor > 0.1:
            there = self._trial(moved, change, factor, load)
            if there is not None:
                return there
            factor *= 0.5
        # Near a limit point the tangent leads nowhere; the corrections begin at rest.
        return self._evaluate(moved.parameters, moved.pressure, load)

    def _advance(self, goal: _Goal) -> State:
        """Predict and correct an equilibrium, or reject the step."""
        return self._correct(self._predict(goal.load), goal)

    def _correct(self, here: _Iterate, goal: _Goal) -> State:
        """Return the equilibrium that is near a point, or reject the step.

        The factors at hand correct as long as they serve; where they no longer do, new ones.
        """
        settings, tolerance = self.settings, goal.tolerance
        caution = _Caution()
        size, settled = math.inf, False
        if self._damping == 0.0:
            change = -self.solver.solve(here.evaluation.residual)
            here, size, settled = self._settle(here, change, goal)
        done = 0
        while not settled:
            if done == settings.max_iterations:
                raise self._fault(f"{done} iterations were not enough", here)
            done += 1
            near = size <= settings.near
            found: _Correction | None
            if caution.wary > 0 or not near:
                found = self._convex(here, goal, caution)
            elif caution.unstable:
                found = self._unstable(here, goal, caution)
            else:
                found = self._exact(here, size, goal, caution)
            if found is None:
                continue
            exact = near and caution.wary == 0 and self._damping == 0.0
            here, size = found.there, found.after
            if exact and found.size < tolerance and self._enough(found.following, here, goal):
                # Where contacts switch, corrections need not shrink any more.
                return self._converged(here, goal.load, max(found.size, size))
            # Corrections that are damped, or hardly shrink, are small far from equilibrium too.
            contracts = size < (GOOD if size > tolerance else FAIR) * found.size
            if found.full and self._damping == 0.0 and contracts:
                here, size, settled = self._settle(here, found.following, goal)
            caution.learn(found, tolerance, done <= settings.patience)
        return self._converged(here, goal.load, size)

    def _enough(self, change: Array, there: _Iterate, goal: _Goal) -> bool:
        """Tell whether an equilibrium is as near as it has to be after a change."""
        size = max(self.problem.size(change), self._lag(change, there))
        if size < goal.tolerance:
            return True
        if size >= self.settings.pressing:
            return False
        return self.problem.overlap(there.parameters, goal.load) > goal.overlap

    def _exact(
        self, here: _Iterate, size: float, goal: _Goal, caution: _Caution
    ) -> _Correction | None:
        """Correct by the exact tangent, or else by the convex one.

        None where the exact tangent is unstable near equilibrium: factors of the convex one, as far
        damped as it takes to be stable, remain.
        """
        self._factorise(here, goal.load, damping=caution.damping)
        found = self._newton(here, goal)
        if found is not None:
            return found
        # A negative pivot too many means that the tissue would buckle away from here.
        buckles = self._wrong_pivots() > 0
        self._factorise(here, goal.load, convex=True, damping=caution.damping)
        if not buckles or size >= self.settings.passing:
            caution.wary = WARY
            return self._damped(here, goal, caution)
        while self._wrong_pivots() > 0:
            self._damp(here, caution)
        caution.unstable = True
        return None

    def _unstable(self, here: _Iterate, goal: _Goal, caution: _Caution) -> _Correction | None:
        """Correct by an unstable tangent with stable factors; None where that leads astray."""
        self.problem.evaluate(here.parameters, here.pressure, goal.load, tangent=True)
        change = self._conjugate(here.evaluation.residual)
        found = self._search(here, change, goal, far=True)
        # Where such corrections do not contract, the exact tangent may serve again.
        caution.unstable = found is not None and found.after < GOOD * found.size
        if found is None:
            caution.wary = WARY
        return found

    def _convex(self, here: _Iterate, goal: _Goal, caution: _Caution) -> _Correction:
        """Correct by a tangent without what can make it unstable."""
        self._factorise(here, goal.load, convex=True, damping=caution.damping)
        return self._damped(here, goal, caution)

    def _damped(self, here: _Iterate, goal: _Goal, caution: _Caution) -> _Correction:
        """Correct with the factors at hand, or as far damped as it takes."""
        while (found := self._newton(here, goal, far=caution.wary > 0)) is None:
            self._damp(here, caution)
        return found

    def _damp(self, here: _Iterate, caution: _Caution) -> None:
        """Damp the tangent at hand more."""
        caution.damping = max(10.0 * caution.damping, FIRST_DAMPING)
        if caution.damping > MOST_DAMPING:
            raise self._fault("no damping makes the corrections descend", here)
        self._refactorise(caution.damping)

    def _relax(self, goal: _Goal) -> State:
        """Let the tissue flow from the last state to an equilibrium that may be far.

        Where the path ends or turns back there is no equilibrium nearby. The tissue moves as if
        in a viscous bath, by implicit steps in a time that does not matter: each adds a multiple
        of the first diagonal to a tangent without what is unstable. The multiple falls as long
        as the steps do not go astray; once they shrink without it Newton's method takes over.
        """
        state, load = self.state, goal.load
        here = self._evaluate(state.parameters + self._held(load), state.pressure, load)
        viscosity = 1.0
        for _ in range(self.settings.max_relaxations):
            self._factorise(here, load, convex=True, damping=viscosity)
            while (found := self._newton(here, goal)) is None:
                viscosity *= 4.0
                if viscosity > MOST_VISCOSITY:
                    raise self._fault("no viscosity keeps the tissue whole", here)
                self._refactorise(viscosity)
            here = found.there
            if viscosity < LEAST_DAMPING and found.full and found.after < 0.5 * found.size:
                break
            viscosity *= 0.3
        else:
            raise self._fault("the tissue does not come to rest", here)
        self._at_hand = False
        return self._correct(here, goal)

    def _newton(self, here: _Iterate, goal: _Goal, far: bool = False) -> _Correction | None:
        """Correct with the factors at hand, which are of this point; None where they do not serve.

        A negative pivot too many means that the tangent is unstable, an empty search that it leads
        astray.
        """
        if self._wrong_pivots() > 0:
            return None
        return self._search(here, -self.solver.solve(here.evaluation.residual), goal, far=far)

    def _settle(self, here: _Iterate, change: Array, goal: _Goal) -> tuple[_Iterate, float, bool]:
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
            there = self._trial(here, past[-1], 1.0, goal.load)
            if there is None:
                return here, size, False
            self._iterations += 1
            if self._enough(past[-1], there, goal):
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
        self, here: _Iterate, change: Array, goal: _Goal, *, far: bool
    ) -> _Correction | None:
        """Return the first trial along ``change`` that neither crushes nor diverges.

        The correction that would follow may be up to three times as long: with contacts
        and fibres that switch, insisting on descent takes more iterations than it saves. But a
        trial that goes far past the point where the forces do no work along the way is taken
        back to there: where contacts close and open, corrections would go to and fro for ever.
        One after which the forces still do half their work goes on, up to eight times as far,
        where an equilibrium may be ``far``, as it is above the tolerance: where tissue gives way,
        every correction alone is far too short.
        """

        def work(at: _Iterate) -> float:
            return self.problem.work(at.evaluation.residual, change)

        size = self.problem.size(change)
        far = far or size > goal.tolerance
        self._iterations += 1
        start = work(here)
        factor, shortened = 1.0, False
        while factor > 0.04:
            there = self._trial(here, change, factor, goal.load)
            if there is not None:
                if start < 0.0 and work(there) > -0.5 * start and factor > 0.2:
                    factor *= max(start / (start - work(there)), 0.2)
                    shortened = True
                    continue
                while far and not shortened and factor < 8.0:
                    if not work(there) < 0.5 * start < 0.0:
                        break
                    farther = self._trial(here, change, 2.0 * factor, goal.load)
                    if farther is None or work(farther) > -0.5 * start:
                        break
                    there, factor = farther, 2.0 * factor
                following = -self.solver.solve(there.evaluation.residual)
                after = self.problem.size(following)
                if after <= max(3.0 * max(factor, 1.0) * size, goal.tolerance):
                    return _Correction(there, size, factor == 1.0, following, after)
            factor, shortened = 0.5 * factor, True
        return None

    def _converged(self, here: _Iterate, load: Load, size: float) -> State:
        statistics = replace(
            self.problem.check(here.evaluation.volume_ratio),
            max_penetration_mm=math.nan,
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

    def _fault(self, reason: str, here: _Iterate) -> SolveError:
        """Return why a step is rejected, and where the tissue suffers most."""
        problem, evaluation = self.problem, here.evaluation
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

    def _stopped(self, load: Load, reached: float, fault: str, steps: int) -> LoadNotReached:
        """Return how far the load went, why not farther and what to try."""
        names = [name for name, value in load.activations.items() if value > 0.0]
        if load.jaw > 0.0:
            names.append(f"jaw open by {np.degrees(load.jaw):.3g}°")
        names += [name for name, factor in load.forces.items() if factor != 0.0]
        advice = []
        if names:
            blamed = self._blamed or sorted(names, key=lambda n: -load.activations.get(n, 0.0))[:1]
            advice.append(f"less of {_several(blamed)}")
        elif load.prescribed is not None:
            names, advice = ["the prescribed displacement"], ["a smaller displacement"]
        if steps >= self.settings.max_steps:
            advice.append(f"more than {steps} steps")
        kappa = self.problem.kappa
        advice.append(f"a volumetric stiffness above {kappa:g} kPa (--set kappa=VALUE)")
        text = (
            f"continuation: stopped at {reached:.1%} of the load "
            f"({_several(names) if names else 'the way back to rest'}) after {steps} "
            f"steps; {fault}; try {' or '.join(advice)}"
        )
        return LoadNotReached(text, reached, self._told())


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
