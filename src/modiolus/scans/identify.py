"""Activations found from what was measured: bounded Gauss-Newton with exact sensitivities.

Minimised over the unknowns ``p`` is, in mm²::

    E(p) = mean r² + v (ALPHA Σ c_k p_k / s_k + BETA Σ ((p_k - u_k) / s_k)² + γ d²)

with ``l_k <= p_k <= h_k``, the distances ``r`` of `modiolus.scans.target`, the distance ``d`` by
which the face is moved off its pose, and the variance ``v`` of the mean of ``r`` as the distances
at the last iterate scatter, so that the prior counts less the more the measurement tells: ``E / v``
is twice the negative logarithm of the probability. Change that shows ``s_k``, usual value ``u_k``,
cost ``c_k`` and bounds are those of `modiolus.scans.unknown.Unknown`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from ..errors import SolveError
from ..fitting.register import Registration
from ..mechanics.continuation import Continuation, Settings
from ..mechanics.face import Face
from ..mechanics.problem import State
from ..progress import Report
from .target import Matches, Target
from .unknown import FURTHER, Driven, Unknown

__all__ = ["Identification", "identify", "settle"]

Array = NDArray[np.float64]

#: Weights of the sum of the activations and of the squares: a priori the mean of the former is
#: twice its scale, the standard deviation of the latter about as much.
ALPHA, BETA = 1.0, 0.2
#: First and largest change of the unknowns in an iteration, in units of their scales.
_FIRST_STEP, _LARGEST_STEP = 0.35, 0.6
#: The iterations end when no unknown changes by more than the first (of its scale) and the pose by
#: no more than the second (mm), or the error falls, or is expected to, by less than the third of
#: what it scatters.
_SMALL_STEP, _SMALL_SHIFT, _SMALL_GAIN = 0.003, 0.01, 0.03
#: Solves from a state nearby, without pressing contacts apart. A trial that is hard to reach is
#: soon given up for a shorter one.
_WARM = Settings(
    first_step=1.0,
    tolerance=1e-3,
    passing=1e-2,
    rough=1e-3,
    max_steps=4,
    max_iterations=15,
    max_jumps=0,
    augmentations=0,
)
#: The same where there is no shorter one.
_SURE = replace(_WARM, max_steps=12)
#: Weight of the squared distance (mm) by which the face is moved off the pose that it was given:
#: it is believed to a millimetre, and to a tenth where it is known. Were that free, it would take
#: over motion of the skin.
_POSE_COST, _KNOWN_POSE_COST = 1.0, 100.0
#: Contacts are pressed apart this often at most, and the unknowns sought before each time. More
#: often the error goes to and fro by as much as it gains.
_PRESSES = 2
#: Two unknowns whose estimates correlate more than this can hardly be told apart.
_CORRELATED = 0.8
#: An unknown is not identifiable where two standard deviations exceed this (of its scale).
_UNSURE = 0.1
#: Distances are outliers beyond this many times their median: three standard deviations.
_OUTLYING = 3.0 * 1.4826
#: Size (mm) of the patches of the face beyond which distances are taken as independent.
_PATCH = 20.0


@dataclass(frozen=True)
class Identification:
    """Values of the unknowns that explain a measurement.

    Attributes
    ----------
    unknowns : tuple of k Unknown
    values : dict of str to float
        By the name of the unknown.
    covariance : (k, k) array
        Of the values, from the distances that are left.
    state : State
        The face in equilibrium with them, as `Face.solve` finds it.
    eased : State
        The same before contacts were pressed apart.
    pose : Registration
        By which the measurement was moved further, from where it was given.
    history : tuple of float
        Root mean square of the distances (mm) before every iteration and at the end.
    solves : int
    """

    unknowns: tuple[Unknown, ...]
    values: dict[str, float]
    covariance: Array
    state: State
    eased: State
    pose: Registration
    history: tuple[float, ...]
    solves: int

    @property
    def activations(self) -> dict[str, float]:
        """Of the muscles that were free."""
        return {name: value for name, value in self.values.items() if name not in FURTHER}

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviation of each value."""
        known = np.sqrt(np.diag(self.covariance)).tolist()
        return dict(zip(self.values, known, strict=True))

    @property
    def correlated(self) -> tuple[tuple[str, str, float], ...]:
        """Pairs of unknowns whose estimates are strongly correlated, the closest first."""
        names, deviation = list(self.values), np.sqrt(np.diag(self.covariance))
        correlation = self.covariance / np.maximum(np.outer(deviation, deviation), 1e-300)
        pairs = [
            (names[i], names[j], round(float(correlation[i, j]), 3))
            for i in range(len(names))
            for j in range(i)
            if abs(correlation[i, j]) > _CORRELATED
        ]
        return tuple(sorted(pairs, key=lambda pair: -abs(pair[2])))

    @property
    def unsure(self) -> tuple[str, ...]:
        """Unknowns of which the measurement does not tell."""
        deviations = self.deviations
        return tuple(u.name for u in self.unknowns if 2.0 * deviations[u.name] > _UNSURE * u.scale)


def identify(
    face: Face,
    target: Target,
    unknowns: Sequence[Unknown],
    *,
    start: Identification | None = None,
    iterations: int = 15,
    report: Report | None = None,
) -> Identification:
    """Find the activations, and whatever else is unknown, with which a face looks like a target.

    Parameters
    ----------
    face : Face
    target : Target
        A `ScanTarget` or a `MarkerTarget` of the face's head.
    unknowns : sequence of Unknown
        See `modiolus.scans.unknown.unknowns`.
    start : Identification, optional
        Where to begin, such as the frame before or the result for fewer muscles of the same half
        or whole head; at rest by default.
    iterations : int
        At most, before contacts are pressed apart and after.
    report : callable, optional
        Called with the fraction done and a message after every iteration.

    Raises
    ------
    SolveError
        The target does not meet the skin.
    """
    search = _Search(Driven(face, unknowns), target, start)
    for done in range(_PRESSES):
        moved = search.descend(iterations, report)
        if done and not moved:
            break
        search.press()
    if report is not None:
        report(1.0, f"{search.reached.rms:.3f} mm")
    return search.found()


def settle(
    face: Face,
    target: Target,
    unknowns: Sequence[Unknown],
    values: Array,
    pose: Registration,
    start: Identification | None = None,
) -> Identification:
    """Return what `identify` would, had it found some values and a pose.

    Parameters
    ----------
    face, target, unknowns
        As in `identify`.
    values : (k,) array
    pose : Registration
        By which what was measured is moved further.
    start : Identification, optional
        Such as the frame before; at rest by default.

    Raises
    ------
    SolveError
        The face does not reach these values, or the target does not meet the skin.
    """
    search = _Search(Driven(face, unknowns), target, start)
    search.settle(values, pose)
    return search.found()


class _Search:
    """A bounded Gauss-Newton search within a trust region.

    How contacts are pressed apart depends on the way there, the equilibrium before that does not.
    So the search follows the latter, and what pressing adds to it is found at the end, anew for
    every `descend`, in which it stays.

    Attributes
    ----------
    reached : _Point
    pressed : State
        With contacts pressed apart, where that was done last.
    history : list of float
        Root mean square of the distances (mm) before every iteration.
    solves : int
    """

    def __init__(self, driven: Driven, target: Target, start: Identification | None) -> None:
        self.driven, self.target = driven, target
        self.history: list[float] = []
        self.solves = 0
        self._radius = _FIRST_STEP
        begun = {} if start is None else start.values
        values = np.array([begun.get(u.name, u.usual) for u in driven.unknowns])
        state = None if start is None else start.eased
        self._path = Continuation(driven.problem(values), state, settings=_WARM)
        self.pressed = self.state if start is None else start.state
        self._added = self.pressed.parameters - self.state.parameters
        self.reached = self._at(values, Registration())

    @property
    def state(self) -> State:
        """The face in equilibrium, before contacts are pressed apart."""
        return self._path.state

    def _at(self, values: Array, pose: Registration) -> _Point:
        """Return the point of the present state, with what stands still renewed."""
        self.target.renew(self.state.parameters + self._added, pose)
        return self._point(values, pose)

    def _point(self, values: Array, pose: Registration) -> _Point:
        parameters = self.state.parameters + self._added
        return _Point(values, pose, parameters, self.target, self.driven.unknowns)

    def slopes(self) -> Array:
        """Return the derivatives of the residuals by unknowns and pose, (n, k + 7)."""
        change = self.driven.slopes(self._path, self.reached.values)
        return self.reached.matches.slopes(self.target.skin, change)

    def descend(self, iterations: int, report: Report | None = None) -> bool:
        """Take steps until the unknowns and the pose stand still; tell whether they have moved."""
        begun = self.reached
        for _ in range(iterations):
            before = self.reached
            self.history.append(before.rms)
            if report is not None:
                done = len(self.history)
                # How many are left is not known; mostly they are about ten in all.
                report(done / (done + 4.0), f"iteration {done}: {before.rms:.3f} mm")
            gain = self._advance(self.slopes())
            if gain < _SMALL_GAIN * before.noise:
                break
        return self.reached is not begun

    def _advance(self, matrix: Array) -> float:
        """Take the longest step that makes things better, and return by how much; 0 for none."""
        reached, kept = self.reached, (self._path.problem, self._path.state)
        while self._radius > _SMALL_STEP:
            step, turn, promise = _step(matrix, reached, self._radius)
            if np.abs(step).max() < _SMALL_STEP and np.abs(turn).max() < _SMALL_SHIFT:
                return 0.0
            if promise < _SMALL_GAIN * reached.noise:
                return 0.0
            values = np.clip(reached.values + step * reached.scales, reached.low, reached.high)
            further = turn * reached.units
            centre = reached.pose.apply(self.target.middle)
            pose = reached.pose.stepped(further[:6], centre, float(np.exp(further[6])))
            gain = -np.inf
            with contextlib.suppress(SolveError):
                self._follow(values)
                there = self._point(values, pose)
                gain = reached.energy(reached.noise) - there.energy(reached.noise)
            if gain > 0.0:
                self.reached = self._at(values, pose)
                self._radius = min(_LARGEST_STEP, 1.6 * self._radius)
                return float(gain)
            self._path = Continuation(*kept, settings=_WARM)
            self._radius *= 0.25
        return 0.0

    def _follow(self, values: Array, settings: Settings = _WARM) -> None:
        """Bring the state to some values."""
        problem = self.driven.problem(values)
        if problem is not self._path.problem or settings is not self._path.settings:
            self._path = Continuation(problem, self.state, settings=settings)
        self._path.run(self.driven.load(values))
        self.solves += 1

    def settle(self, values: Array, pose: Registration) -> None:
        """Go to some values and a pose."""
        self._follow(values, _SURE)
        self.reached = self._at(values, pose)
        self.press()

    def press(self) -> None:
        """Press contacts apart in the present state, and keep what that adds to it."""
        path = Continuation(self._path.problem, self.state)
        with contextlib.suppress(SolveError):
            path.run(self.state.load)
        self.pressed = path.state
        self._added = self.pressed.parameters - self.state.parameters
        self.reached = self._at(self.reached.values, self.reached.pose)

    def found(self) -> Identification:
        """Return what has been found."""
        reached, unknowns = self.reached, tuple(self.driven.unknowns)
        return Identification(
            unknowns,
            {u.name: float(value) for u, value in zip(unknowns, reached.values, strict=True)},
            _covariance(self.slopes(), reached),
            self.pressed,
            self.state,
            reached.pose,
            (*self.history, reached.rms),
            self.solves,
        )


class _Point:
    """Where the search is: values of the unknowns, pose, matches, and what it costs."""

    def __init__(
        self,
        values: Array,
        pose: Registration,
        parameters: Array,
        target: Target,
        unknowns: Sequence[Unknown],
    ) -> None:
        self.values, self.pose, self.unknowns = values, pose, unknowns
        self.matches = target.matches(parameters, pose)
        self.mean = self.matches.mean
        self.noise = _noise(self.matches)
        self.rms = float(np.sqrt(self.mean))
        columns = [(u.low, u.high, u.scale, u.usual, u.cost) for u in unknowns]
        self.low, self.high, self.scales, usual, self.cost = np.array(columns).T
        self.shares = (values - usual) / self.scales
        # Turns (radians), shifts and growth that move the face by a millimetre; one that is known
        # does not grow.
        reach = max(float(np.sqrt((self.matches.arms**2).sum(axis=1).mean())), 1.0)
        grows = 0.0 if target.known_pose else 1.0 / reach
        self.units = np.array([*[1.0 / reach] * 3, *[1.0] * 3, grows])
        # The same coordinates as those of a step.
        turn = Rotation.from_matrix(pose.rotation).as_rotvec()
        shift = pose.apply(target.middle) - target.middle
        self.moved = np.array([*reach * turn, *shift, reach * np.log(pose.scale)])
        self.pose_cost = _KNOWN_POSE_COST if target.known_pose else _POSE_COST

    def energy(self, noise: float) -> float:
        """Return what is minimised, with the regularisation weighed by a noise (mm²)."""
        regular = ALPHA * (self.cost * self.shares).sum() + BETA * (self.shares**2).sum()
        regular += self.pose_cost * (self.moved**2).sum()
        return float(self.mean + noise * regular)

    def gradient(self, matrix: Array) -> Array:
        """Return the derivatives of `energy` by the unknowns and the pose in their units, (k + 7,).

        Parameters
        ----------
        matrix : (n, k + 7) array
            Of `Matches.slopes`.
        """
        k = len(self.values)
        units = np.concatenate([self.scales, self.units])
        slope = 2.0 * units * (matrix.T @ (self.matches.weight * self.matches.residual))
        slope[:k] += self.noise * (ALPHA * self.cost + 2.0 * BETA * self.shares)
        slope[k:] += 2.0 * self.noise * self.pose_cost * self.moved
        return np.asarray(slope)


def _step(matrix: Array, point: _Point, radius: float) -> tuple[Array, Array, float]:
    """Return the bounded Gauss-Newton step of unknowns and pose, in their units, and its gain."""
    matches, scales = point.matches, point.scales
    k = len(scales)
    units = np.concatenate([scales, point.units])
    scaled = matrix * units
    hessian = scaled.T @ (matches.weight[:, None] * scaled)
    hessian[np.arange(k), np.arange(k)] += BETA * point.noise
    hessian[np.arange(k, k + 7), np.arange(k, k + 7)] += point.noise * point.pose_cost
    hessian[np.arange(k + 7), np.arange(k + 7)] += 1e-9
    root = np.linalg.cholesky(hessian)
    low = np.concatenate([np.maximum((point.low - point.values) / scales, -radius), [-2.0] * 7])
    high = np.concatenate([np.minimum((point.high - point.values) / scales, radius), [2.0] * 7])
    high = np.maximum(high, low + 1e-12)
    right = -0.5 * np.linalg.solve(root, point.gradient(matrix))
    found = lsq_linear(root.T, right, (low, high), method="bvls")
    return found.x[:k], found.x[k:], float(right @ right - 2.0 * found.cost)


def _noise(matches: Matches) -> float:
    """Return the variance (mm²) of the mean of distances, as their sums over patches scatter.

    So it need not be known how far errors of neighbouring points are alike: those of a scanner may
    not be at all, those of the model's shape are. The few that are far larger than most, such as
    those of hair, are no noise.
    """
    most = _OUTLYING * float(np.median(np.abs(matches.residual)))
    residual = np.clip(matches.residual, -most, most)
    places = np.round(matches.feet.points / _PATCH).astype(np.int64)
    _, patch = np.unique(places, axis=0, return_inverse=True)
    sums = np.bincount(patch.ravel(), matches.weight * residual)
    variance = (sums**2).sum() / matches.weight.sum()
    return float(max(variance, 1e-12 * matches.mean, 1e-30))


def _covariance(matrix: Array, point: _Point) -> Array:
    """Return the covariance of the unknowns (k, k) where the pose is not known either."""
    matches, k = point.matches, len(point.values)
    units = np.concatenate([point.scales, point.units])
    scaled = matrix * units
    hessian = scaled.T @ (matches.weight[:, None] * scaled)
    hessian[np.arange(k, k + 7), np.arange(k, k + 7)] += point.noise * point.pose_cost
    hessian += 1e-12 * np.trace(hessian) * np.eye(k + 7)
    # As many distances are independent as their mean would need to scatter as it does.
    independent = point.mean / point.noise
    spent = independent / max(independent - k - 7.0, 1.0)
    inverse = np.linalg.inv(hessian)[:k, :k]
    return np.asarray(point.noise * spent * inverse * np.outer(point.scales, point.scales))
