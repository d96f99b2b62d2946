"""Activations found from what was measured: bounded Gauss-Newton with exact sensitivities.

Minimised over the unknowns ``p`` is, in mm²::

    E(p) = mean r² + m (ALPHA Σ c_k p_k / s_k + BETA Σ ((p_k - u_k) / s_k)² + γ d²)

with ``l_k <= p_k <= h_k``, the distances ``r`` of `modiolus.scans.target`, the distance ``d`` by
which the face is moved off its pose, and the mean square ``m`` of ``r`` at the last iterate, so
that the prior counts less where the measurement is explained well. Change that shows ``s_k``,
usual value ``u_k``, cost ``c_k`` and bounds are those of `modiolus.scans.unknown.Unknown`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

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
from .target import Target
from .unknown import FURTHER, Driven, Unknown

__all__ = ["Identification", "identify"]

Array = NDArray[np.float64]

#: Weights of the sum of the activations and of the squares.
ALPHA, BETA = 5e-3, 1e-3
#: First and largest change of the unknowns in an iteration, in units of their scales.
_FIRST_STEP, _LARGEST_STEP = 0.35, 0.6
#: The iterations end when no unknown changes by more than the first (of its scale) and the pose by
#: no more than the second (mm), or the error falls by less than the third, a share.
_SMALL_STEP, _SMALL_SHIFT, _SMALL_GAIN = 0.01, 0.02, 1e-4
#: Solves from a state nearby; contacts stay as far pressed apart as they are there.
_WARM = Settings(first_step=1.0, tolerance=1e-3, passing=1e-2, augmentations=0)
#: Weight of the squared distance (mm) by which the face is moved off the pose that it was given,
#: and the same where that pose is known. Were it free, it would take over motion of the skin.
_POSE_COST, _KNOWN_POSE_COST = 0.2, 2.0
#: Two unknowns whose estimates correlate more than this can hardly be told apart.
_CORRELATED = 0.8
#: An unknown is not identifiable where two standard deviations exceed this (of its scale).
_UNSURE = 0.1
#: Spacing (mm) below which the errors of a measurement and of the model's shape are alike.
_CORRELATION_LENGTH = 10.0


@dataclass(frozen=True)
class Identification:
    """Values of the unknowns that explain a measurement.

    Attributes
    ----------
    values : dict of str to float
        By the name of the unknown, see `modiolus.scans.unknown.unknowns`.
    state : State
        The face in equilibrium with them.
    pose : Registration
        By which the measurement was moved further, from where it was given.
    history : tuple of float
        Root mean square of the distances (mm) before every iteration and at the end.
    deviations : dict of str to float
        Standard deviation of each value, from the distances that are left.
    correlated : tuple of (str, str, float)
        Pairs of unknowns whose estimates are strongly correlated.
    unsure : tuple of str
        Unknowns of which this measurement does not tell.
    solves : int
    """

    values: dict[str, float]
    state: State
    pose: Registration
    history: tuple[float, ...]
    deviations: dict[str, float]
    correlated: tuple[tuple[str, str, float], ...]
    unsure: tuple[str, ...]
    solves: int

    @property
    def activations(self) -> dict[str, float]:
        """Of the muscles that were free."""
        return {name: value for name, value in self.values.items() if name not in FURTHER}


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
    driven = Driven(face, unknowns)
    begun = {} if start is None else start.values
    values = np.array([begun.get(item.name, item.usual) for item in unknowns])
    search = _Search(driven, target, values, None if start is None else start.state)
    search.descend(iterations, report)
    search.press()
    search.descend(iterations, report)
    search.history.append(search.reached.rms)
    if report is not None:
        report(1.0, f"{search.reached.rms:.3f} mm")
    reached = search.reached
    deviations, correlated = _certainty(search.slopes(), reached)
    return Identification(
        values={
            item.name: float(value) for item, value in zip(unknowns, reached.values, strict=True)
        },
        state=reached.state,
        pose=reached.pose,
        history=tuple(search.history),
        deviations=deviations,
        correlated=correlated,
        unsure=tuple(
            item.name for item in unknowns if 2.0 * deviations[item.name] > _UNSURE * item.scale
        ),
        solves=search.solves,
    )


class _Search:
    """A bounded Gauss-Newton search within a trust region.

    How far contacts are pressed apart depends on the way there. So they stay as they are pressed
    while the search goes on, and its states depend on the unknowns alone.

    Attributes
    ----------
    reached : _Point
    history : list of float
        Root mean square of the distances (mm) before every iteration.
    solves : int
    """

    def __init__(self, driven: Driven, target: Target, values: Array, state: State | None) -> None:
        self.driven, self.target = driven, target
        self.history: list[float] = []
        self.solves = 0
        self._radius = _FIRST_STEP
        self._path = Continuation(driven.problem(values), state, settings=_WARM)
        self.reached = self._at(values, Registration(1.0, np.eye(3), np.zeros(3)))

    def _at(self, values: Array, pose: Registration) -> _Point:
        """Return the point of the present state, with what stands still renewed."""
        self.target.renew(self._path.state.parameters, pose)
        return self._point(values, pose)

    def _point(self, values: Array, pose: Registration) -> _Point:
        return _Point(values, pose, self._path.state, self.target, self.driven.unknowns)

    def slopes(self) -> Array:
        """Return the derivatives of the residuals by unknowns and pose, (n, k + 7)."""
        change = self.driven.slopes(self._path, self.reached.values)
        return self.reached.matches.slopes(self.target.skin, change)

    def descend(self, iterations: int, report: Report | None = None) -> None:
        """Take steps until the unknowns and the pose stand still."""
        for iteration in range(iterations):
            before = self.reached
            self.history.append(before.rms)
            if report is not None:
                text = f"iteration {len(self.history)}: {before.rms:.3f} mm"
                report(iteration / iterations, text)
            gain = self._advance(self.slopes())
            if gain < _SMALL_GAIN * before.mean:
                return

    def _advance(self, matrix: Array) -> float:
        """Take the longest step that makes things better, and return by how much; 0 for none."""
        reached, kept = self.reached, (self._path.problem, self._path.state)
        while self._radius > 1e-3:
            step, turn = _step(matrix, reached, self._radius)
            if np.abs(step).max() < _SMALL_STEP and np.abs(turn).max() < _SMALL_SHIFT:
                return 0.0
            values = np.clip(reached.values + step * reached.scales, reached.low, reached.high)
            pose = _turned(reached.pose, turn * reached.units, self.target)
            problem = self.driven.problem(values)
            if problem is not self._path.problem:
                self._path = Continuation(problem, self._path.state, settings=_WARM)
            gain = -np.inf
            with contextlib.suppress(SolveError):
                self._path.run(self.driven.load(values))
                self.solves += 1
                gain = reached.energy(reached.mean) - self._point(values, pose).energy(reached.mean)
            if gain > 0.0:
                self.reached = self._at(values, pose)
                self._radius = min(_LARGEST_STEP, 1.6 * self._radius)
                return float(gain)
            self._path = Continuation(*kept, settings=_WARM)
            self._radius *= 0.4
        return 0.0

    def press(self) -> None:
        """Press contacts apart in the present state, and keep them so in what follows."""
        pressed = Continuation(self._path.problem, self._path.state)
        with contextlib.suppress(SolveError):
            pressed.run(self._path.state.load)
            self._path = Continuation(pressed.problem, pressed.state, settings=_WARM)
            self.reached = self._at(self.reached.values, self.reached.pose)


class _Point:
    """Where the search is: values of the unknowns, pose, state, and what it costs."""

    def __init__(
        self,
        values: Array,
        pose: Registration,
        state: State,
        target: Target,
        unknowns: Sequence[Unknown],
    ) -> None:
        self.values, self.pose, self.state, self.unknowns = values, pose, state, unknowns
        self.matches = target.matches(state.parameters, pose)
        self.mean = self.matches.mean
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

    def energy(self, mean: float) -> float:
        """Return what is minimised, with the regularisation weighed by a mean square."""
        regular = ALPHA * (self.cost * self.shares).sum() + BETA * (self.shares**2).sum()
        regular += self.pose_cost * (self.moved**2).sum()
        return float(self.mean + mean * regular)

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
        slope[:k] += self.mean * (ALPHA * self.cost + 2.0 * BETA * self.shares)
        slope[k:] += 2.0 * self.mean * self.pose_cost * self.moved
        return np.asarray(slope)


def _step(matrix: Array, point: _Point, radius: float) -> tuple[Array, Array]:
    """Return the bounded Gauss-Newton step of unknowns and pose, in their units."""
    matches, scales = point.matches, point.scales
    k = len(scales)
    units = np.concatenate([scales, point.units])
    scaled = matrix * units
    hessian = scaled.T @ (matches.weight[:, None] * scaled)
    hessian[np.arange(k), np.arange(k)] += BETA * point.mean
    hessian[np.arange(k, k + 7), np.arange(k, k + 7)] += point.mean * point.pose_cost
    hessian[np.arange(k + 7), np.arange(k + 7)] += 1e-9
    root = np.linalg.cholesky(hessian)
    low = np.concatenate([np.maximum((point.low - point.values) / scales, -radius), [-2.0] * 7])
    high = np.concatenate([np.minimum((point.high - point.values) / scales, radius), [2.0] * 7])
    high = np.maximum(high, low + 1e-12)
    right = -0.5 * np.linalg.solve(root, point.gradient(matrix))
    found = lsq_linear(root.T, right, (low, high), method="bvls")
    return found.x[:k], found.x[k:]


def _turned(pose: Registration, step: Array, target: Target) -> Registration:
    """Return a pose that is turned about the middle, grown and shifted by a step."""
    turn, growth = Rotation.from_rotvec(step[:3]).as_matrix(), float(np.exp(step[6]))
    middle = pose.apply(target.middle)
    return Registration(
        growth * pose.scale,
        turn @ pose.rotation,
        growth * turn @ (pose.translation - middle) + middle + step[3:6],
    )


def _certainty(
    matrix: Array, point: _Point
) -> tuple[dict[str, float], tuple[tuple[str, str, float], ...]]:
    """Return standard deviations of the unknowns, and the pairs that are correlated.

    Errors of neighbouring points are alike; independent ones are as many as patches of
    `_CORRELATION_LENGTH` fit on the face, for each direction that is known there.
    """
    matches = point.matches
    names = [item.name for item in point.unknowns]
    k = len(names)
    units = np.concatenate([point.scales, point.units])
    scaled = matrix * units
    hessian = scaled.T @ (matches.weight[:, None] * scaled)
    hessian[np.arange(k, k + 7), np.arange(k, k + 7)] += point.mean * point.pose_cost
    hessian += 1e-12 * np.trace(hessian) * np.eye(k + 7)
    places = np.round(matches.feet.points / _CORRELATION_LENGTH).astype(np.int64)
    patches = len(np.unique(places, axis=0)) * matches.weight.sum()
    independent = max(patches - k - 7, 1)
    covariance = point.mean / independent * np.linalg.inv(hessian)[:k, :k]
    deviation = np.sqrt(np.diag(covariance))
    correlation = covariance / np.maximum(np.outer(deviation, deviation), 1e-300)
    pairs = [
        (names[i], names[j], round(float(correlation[i, j]), 3))
        for i in range(k)
        for j in range(i)
        if abs(correlation[i, j]) > _CORRELATED
    ]
    pairs.sort(key=lambda pair: -abs(pair[2]))
    known = (deviation * point.scales).tolist()
    return dict(zip(names, known, strict=True)), tuple(pairs)
