"""Activations found from a scan: bounded Gauss-Newton with the mechanics' exact sensitivities.

Minimised is, in mm²::

    E(a) = mean r² + m (ALPHA Σ c_k a_k / s_k + BETA Σ (a_k / s_k)²),   0 <= a_k <= 1

with the distances ``r`` of scan and skin to each other along their normals; their mean square
``m`` at the last iterate, so that the prior counts less where the scan is explained well; the
activation ``s_k`` at which a muscle shows what it does (1 for straps, 0.2 for sheets and rings,
which have many times their cross-section); and the cost ``c_k`` of a muscle: 1, or `OUTSIDER` for
one that is not in the prior set.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ..errors import SolveError, unknown_name
from ..face.expression import GROUPS
from ..face.head import Head
from ..fitting.register import Registration
from ..mechanics.continuation import Continuation, Settings
from ..mechanics.problem import Problem, State
from .scan import Scan
from .skin import Feet, Skin

__all__ = ["TABLE_2", "Identification", "identify", "muscle_set"]

Array = NDArray[np.float64]
Report = Callable[[float, str], None]

#: Muscles of the four expressions in table 2 of Wu et al. (2013), by expression.
TABLE_2: dict[str, tuple[str, ...]] = {
    "smile-closed": (
        *("buccinator", "levator_anguli_oris", "orbicularis_oculi_orbital", "risorius"),
        *("zygomaticus_major", "zygomaticus_minor"),
    ),
    "smile-open": (
        *("depressor_labii_inferioris", "levator_anguli_oris"),
        *("levator_labii_superioris_alaeque_nasi", "orbicularis_oculi_orbital"),
        *("zygomaticus_major", "zygomaticus_minor"),
    ),
    "sad": (
        *("corrugator_supercilii", "depressor_anguli_oris", "frontalis", "mentalis"),
        *("orbicularis_oris", "platysma", "risorius"),
    ),
    "terror": (
        *("depressor_anguli_oris", "depressor_labii_inferioris", "frontalis", "mentalis"),
        *("platysma", "risorius"),
    ),
}
#: Weights of the sum of the activations and of their squares.
ALPHA, BETA = 5e-3, 1e-3
#: Cost of a muscle outside the prior set.
OUTSIDER = 4.0
#: Activation at which a muscle shows what it does, by its kind.
SCALES = {"strap": 1.0, "sheet": 0.2, "ring": 0.2}
#: Points of the scan and of the skin that are matched.
_POINTS = 4000
#: First and largest change of the activations in an iteration, in units of their scales.
_FIRST_STEP, _LARGEST_STEP = 0.35, 0.6
#: The iterations end when no activation changes by more than this (of its scale), or the error
#: falls by less than this share.
_SMALL_STEP, _SMALL_GAIN = 0.01, 2e-3
#: Cost (mm²) of moving the face by a millimetre off the pose that it was given, and the same where
#: that pose came from a neutral scan. Were it free, it would take over motion of the skin.
_POSE_COST, _KNOWN_POSE_COST = 0.1, 1.0
#: Nearer than this (mm) a distance has no direction but the normal.
_TOUCHING = 1e-5
#: Two muscles whose estimates correlate more than this can hardly be told apart.
_CORRELATED = 0.8
#: An activation that is known no better than this (of its scale) is not identifiable.
_UNSURE = 0.1
#: Spacing (mm) below which the errors of a scan and of the model's shape are alike.
_CORRELATION_LENGTH = 10.0


@dataclass(frozen=True)
class Identification:
    """Activations that explain a scan.

    Attributes
    ----------
    activations : dict of str to float
        By muscle, all that were free.
    state : State
        The face in equilibrium with them.
    pose : Registration
        By which the scan was moved further, from where it was given.
    history : tuple of float
        Root mean square of the distances (mm) before every iteration and at the end.
    deviations : dict of str to float
        Standard deviation of each activation, from the distances that are left.
    correlated : tuple of (str, str, float)
        Pairs of muscles whose estimates are strongly correlated.
    unsure : tuple of str
        Muscles whose activation this scan does not tell.
    solves : int
    """

    activations: dict[str, float]
    state: State
    pose: Registration
    history: tuple[float, ...]
    deviations: dict[str, float]
    correlated: tuple[tuple[str, str, float], ...]
    unsure: tuple[str, ...]
    solves: int


@dataclass(frozen=True, eq=False)
class _Matches:
    """Distances along normals, and how they change with the skin and with the pose.

    Attributes
    ----------
    feet : Feet
        Material points of the skin.
    normals : (n, 3) array
    residual : (n,) array
        Scan minus skin along the normal.
    arms : (n, 3) array
        The points of the scan from their middle, for rotations of the pose.
    weight : (n,) array
        Sums to 1.
    """

    feet: Feet
    normals: Array
    residual: Array
    arms: Array
    weight: Array


class _Target:
    """A scan to be matched, and the distances that the shape at rest leaves.

    Parameters
    ----------
    skin : Skin
    scan : Scan
        In the head's frame.
    neutral : Scan or None
        What lies between it and the skin at rest is shape, which no muscle explains: it is
        carried along with the skin, to where the scan was matched by the last `renew`.
    """

    def __init__(self, skin: Skin, scan: Scan, neutral: Scan | None) -> None:
        self.skin = skin
        rest = skin.head.tissue.parameters
        count = min(_POINTS, len(scan.points))
        chance = scan.weights * scan.visible
        count = min(count, int((chance > 0.0).sum()))
        chance = chance / chance.sum()
        picked = np.random.default_rng(0).choice(len(scan.points), count, replace=False, p=chance)
        self.scan = scan
        self.points, self.normals = scan.points[picked], scan.normals[picked]
        self.middle = self.points.mean(axis=0)
        surface = skin.surface(rest)
        samples = surface.samples(np.sqrt(surface.area / _POINTS))
        self.own = skin.state(rest).feet(samples)
        self.known_pose = neutral is not None
        self._shape = None if neutral is None else self._shape_of(neutral)
        self._own_left = self.shape_at(self.own)
        self._left = np.zeros(count)

    def _shape_of(self, neutral: Scan) -> tuple[cKDTree, Array]:
        """Return points of the skin at rest and the distance of the neutral scan there."""
        skin = self.skin
        rest = skin.head.tissue.parameters
        state = skin.state(rest)
        feet = state.feet(skin.surface(rest).vertices)
        near, outward, rim = neutral.nearest(feet.points)
        gap = ((near - feet.points) * feet.normals).sum(axis=1)
        good = ~rim & ((outward * feet.normals).sum(axis=1) > 0.5) & (np.abs(gap) < 5.0)
        return cKDTree(feet.points), np.where(good, gap, 0.0)

    def shape_at(self, feet: Feet) -> Array:
        """Return the distance that the shape at rest leaves at material points of the skin."""
        if self._shape is None:
            return np.zeros(len(feet.elements))
        tree, gaps = self._shape
        places = self.skin.places(feet, self.skin.head.tissue.parameters)
        distance, near = tree.query(places, k=4)
        share = 1.0 / np.maximum(distance, 0.05)
        return np.asarray((share * gaps[near]).sum(axis=1) / share.sum(axis=1))

    def renew(self, parameters: Array, pose: Registration) -> None:
        """Take what the shape at rest leaves at the points of the scan from this state on.

        Between two calls it stands still, so that the distances have exact derivatives.
        """
        feet = self.skin.state(parameters).feet(
            pose.apply(self.points), self.normals @ pose.rotation.T
        )
        self._left = self.shape_at(feet)

    def matches(self, parameters: Array, pose: Registration) -> _Matches:
        """Match scan and skin both ways, in a state and a pose."""
        skin = self.skin
        points = pose.apply(self.points)
        feet = skin.state(parameters).feet(points, self.normals @ pose.rotation.T)
        seen = feet.covered
        first = Feet(*(getattr(feet, name)[seen] for name in feet.__dataclass_fields__))
        gap, along = _distances(points[seen] - first.points, first.normals)
        gap -= self._left[seen]

        # The other way: material points of the skin that have a counterpart on the scan.
        places = skin.places(self.own, parameters)
        near, outward, rim = self.scan.nearest(pose.undo(places))
        near, outward = pose.apply(near), outward @ pose.rotation.T
        facing = skin.turned(self.own, parameters)
        good = ~rim & (np.linalg.norm(near - places, axis=1) < 20.0)
        good &= (outward * facing).sum(axis=1) > 0.5
        second = Feet(*(getattr(self.own, name)[good] for name in feet.__dataclass_fields__))
        other, across = _distances((near - places)[good], outward[good])
        other -= self._own_left[good]

        joined = Feet(
            *(
                np.concatenate([getattr(first, name), getattr(second, name)])
                for name in feet.__dataclass_fields__
            )
        )
        weight = np.concatenate(
            [
                np.full(len(gap), 0.5 / max(len(gap), 1)),
                np.full(len(other), 0.5 / max(len(other), 1)),
            ]
        )
        return _Matches(
            joined,
            np.concatenate([along, across]),
            np.concatenate([gap, other]),
            np.concatenate([points[seen], near[good]]) - pose.apply(self.middle),
            weight,
        )


def _distances(gaps: Array, normals: Array) -> tuple[Array, Array]:
    """Return signed distances (n,) and their directions (n, 3) from differences (n, 3).

    That is along the normal but at edges, such as that of a lip: there the closest point is the
    same for all that lies beyond, and only the direction to it tells how to come nearer.
    """
    length = np.linalg.norm(gaps, axis=1)
    sign = np.where((gaps * normals).sum(axis=1) < 0.0, -1.0, 1.0)
    near = length < _TOUCHING
    direction = gaps * (sign / np.maximum(length, _TOUCHING))[:, None]
    along = np.where(near[:, None], normals, direction)
    return np.where(near, (gaps * normals).sum(axis=1), sign * length), along


def muscle_set(names: Sequence[str], head: Head) -> list[str]:
    """Return the muscles of a head that some names mean.

    Parameters
    ----------
    names : sequence of str
        Muscles, groups of `modiolus.face.expression.GROUPS`, or expressions of `TABLE_2`.
    head : Head

    Raises
    ------
    InputError
        A name is not known.
    """
    wanted: set[str] = set()
    groups = {**{name: (name,) for name in head.muscles}, **GROUPS}
    for name in names:
        for part in TABLE_2.get(name, (name,)):
            if part not in groups:
                raise unknown_name("muscle", part, [*groups, *TABLE_2])
            wanted.update(groups[part])
    return [name for name in head.muscles if name in wanted]


def identify(
    problem: Problem,
    head: Head,
    scan: Scan,
    *,
    skin: Skin | None = None,
    muscles: Sequence[str] | None = None,
    prior: Sequence[str] = (),
    start: State | None = None,
    neutral: Scan | None = None,
    iterations: int = 15,
    report: Report | None = None,
) -> Identification:
    """Find the activations with which a head looks like a scan.

    Parameters
    ----------
    problem : Problem
        Of the head's half.
    head : Head
    scan : Scan
        In the head's frame (see `modiolus.scans.align`).
    skin : Skin, optional
        Of the head, if it is at hand.
    muscles : sequence of str, optional
        Those that are free; all by default.
    prior : sequence of str
        Those that are expected; the others cost more. None: all cost the same.
    start : State, optional
        Where to begin, such as the frame before or the result for fewer muscles; at rest by
        default.
    neutral : Scan, optional
        The same person at rest, in the head's frame.
    iterations : int
        At most.
    report : callable, optional
        Called with the fraction done and a message after every iteration.

    Raises
    ------
    SolveError
        Not even small activations can be followed.
    """
    names = list(head.muscles) if muscles is None else list(muscles)
    skin = Skin(head) if skin is None else skin
    target = _Target(skin, scan, neutral)
    scales = np.array([SCALES[head.muscles[name].kind] for name in names])
    cost = np.array([1.0 if not prior or name in prior else OUTSIDER for name in names])
    settings = Settings(first_step=1.0, tolerance=1e-3, passing=1e-2)
    continuation = Continuation(problem, start, settings=settings)
    values = np.array([continuation.state.load.activations.get(name, 0.0) for name in names])
    pose = Registration(1.0, np.eye(3), np.zeros(3))
    solves = 0
    history: list[float] = []
    radius = _FIRST_STEP
    target.renew(continuation.state.parameters, pose)
    reached = _Point(values, pose, continuation.state, target, scales, cost)
    for iteration in range(iterations):
        history.append(reached.rms)
        if report is not None:
            report(iteration / iterations, f"iteration {iteration + 1}: {reached.rms:.3f} mm")
        matrix = _slopes(continuation, target, reached, names)
        kept = continuation.state
        step, gain = np.zeros(len(names)), 0.0
        while radius > 1e-3:
            step, turn = _step(matrix, reached, scales, cost, radius)
            if np.abs(step / scales).max() < _SMALL_STEP:
                break
            values = np.clip(reached.values + step, 0.0, 1.0)
            try:
                continuation.run(problem.load(_load(names, values)))
                solves += 1
            except SolveError:
                continuation = Continuation(problem, kept, settings=settings)
                radius *= 0.4
                continue
            trial = _Point(
                values,
                _turned(reached.pose, turn, target),
                continuation.state,
                target,
                scales,
                cost,
            )
            gain = reached.energy(reached.mean) - trial.energy(reached.mean)
            if gain > 0.0:
                target.renew(trial.state.parameters, trial.pose)
                reached = _Point(values, trial.pose, trial.state, target, scales, cost)
                radius = min(_LARGEST_STEP, 1.6 * radius)
                break
            continuation = Continuation(problem, kept, settings=settings)
            radius *= 0.4
        if gain < _SMALL_GAIN * reached.mean:
            break
    history.append(reached.rms)
    if report is not None:
        report(1.0, f"{reached.rms:.3f} mm")
    matrix = _slopes(continuation, target, reached, names)
    deviations, correlated = _certainty(matrix, reached, names)
    return Identification(
        activations={name: float(a) for name, a in zip(names, reached.values, strict=True)},
        state=replace(reached.state, statistics=continuation.state.statistics),
        pose=reached.pose,
        history=tuple(history),
        deviations=deviations,
        correlated=correlated,
        unsure=tuple(
            name
            for name, scale in zip(names, scales, strict=True)
            if deviations[name] > _UNSURE * scale
        ),
        solves=solves,
    )


class _Point:
    """Where the search is: activations, pose, state, and what it costs."""

    def __init__(
        self,
        values: Array,
        pose: Registration,
        state: State,
        target: _Target,
        scales: Array,
        cost: Array,
    ) -> None:
        self.values, self.pose, self.state = values, pose, state
        self.matches = target.matches(state.parameters, pose)
        mean = float((self.matches.weight * self.matches.residual**2).sum())
        shares = values / scales
        self.mean, self.rms = mean, float(np.sqrt(mean))
        # The same six coordinates as those of a step: turns about the middle, and shifts.
        turn = Rotation.from_matrix(pose.rotation).as_rotvec()
        shift = pose.apply(target.middle) - target.middle
        self.moved = np.concatenate([turn, shift]) / _pose_scales(self.matches)
        self.pose_cost = _KNOWN_POSE_COST if target.known_pose else _POSE_COST
        self._regular = float(ALPHA * (cost * shares).sum() + BETA * (shares**2).sum())

    def energy(self, mean: float) -> float:
        """Return what is minimised, with the regularisation weighed by a mean square."""
        return self.mean + mean * self._regular + self.pose_cost * float((self.moved**2).sum())


def _load(names: Sequence[str], values: Array) -> dict[str, float]:
    return {name: float(a) for name, a in zip(names, values, strict=True) if a > 0.0}


def _slopes(
    continuation: Continuation, target: _Target, point: _Point, names: Sequence[str]
) -> Array:
    """Return the derivatives of the residuals by activations and pose, (n, k + 6)."""
    change = continuation.sensitivities(names)
    matches = point.matches
    functions = target.skin.mesh.functions(matches.feet.elements, matches.feet.xi)
    normals = matches.normals.copy()
    normals[matches.feet.mirrored, 0] *= -1.0
    skin = -sum(
        normals[:, axis, None] * np.asarray(functions @ change[:, axis, :]) for axis in range(3)
    )
    pose = np.hstack([np.cross(matches.arms, matches.normals), matches.normals])
    return np.hstack([np.asarray(skin), pose])


def _pose_scales(matches: _Matches) -> Array:
    """Return turns (radians) and shifts (mm) that move the face by a millimetre."""
    reach = np.sqrt((matches.arms**2).sum(axis=1).mean())
    return np.array([1.0 / reach] * 3 + [1.0] * 3)


def _step(
    matrix: Array, point: _Point, scales: Array, cost: Array, radius: float
) -> tuple[Array, Array]:
    """Return the bounded Gauss-Newton step of the activations, and that of the pose."""
    matches = point.matches
    k = len(scales)
    units = np.concatenate([scales, _pose_scales(matches)])
    scaled = matrix * units
    hessian = scaled.T @ (matches.weight[:, None] * scaled)
    slope = scaled.T @ (matches.weight * matches.residual)
    shares = point.values / scales
    hessian[np.arange(k), np.arange(k)] += BETA * point.mean
    slope[:k] += point.mean * (0.5 * ALPHA * cost + BETA * shares)
    hessian[np.arange(k, k + 6), np.arange(k, k + 6)] += point.pose_cost
    slope[k:] += point.pose_cost * point.moved
    hessian[np.arange(k + 6), np.arange(k + 6)] += 1e-9
    root = np.linalg.cholesky(hessian)
    low = np.concatenate([np.maximum(-shares, -radius), np.full(6, -2.0)])
    high = np.concatenate([np.minimum(1.0 / scales - shares, radius), np.full(6, 2.0)])
    high = np.maximum(high, low + 1e-12)
    found = lsq_linear(root.T, -np.linalg.solve(root, slope), (low, high), method="bvls")
    return found.x[:k] * scales, found.x[k:] * units[k:]


def _turned(pose: Registration, step: Array, target: _Target) -> Registration:
    turn = Rotation.from_rotvec(step[:3]).as_matrix()
    middle = pose.apply(target.middle)
    return Registration(
        1.0, turn @ pose.rotation, turn @ (pose.translation - middle) + middle + step[3:]
    )


def _certainty(
    matrix: Array, point: _Point, names: Sequence[str]
) -> tuple[dict[str, float], tuple[tuple[str, str, float], ...]]:
    """Return standard deviations of the activations, and the pairs that are correlated.

    Errors of neighbouring points are alike; independent ones are as many as patches of
    `_CORRELATION_LENGTH` fit on the face.
    """
    matches = point.matches
    k = len(names)
    units = np.concatenate([np.ones(k), _pose_scales(matches)])
    scaled = matrix * units
    hessian = scaled.T @ (matches.weight[:, None] * scaled)
    hessian[np.arange(k, k + 6), np.arange(k, k + 6)] += point.pose_cost
    hessian += 1e-12 * np.trace(hessian) * np.eye(k + 6)
    places = np.round(matches.feet.points / _CORRELATION_LENGTH).astype(np.int64)
    independent = max(len(np.unique(places, axis=0)) - k - 6, 1)
    covariance = point.rms**2 / independent * np.linalg.inv(hessian)[:k, :k]
    deviation = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(deviation, deviation)
    pairs = [
        (names[i], names[j], round(float(correlation[i, j]), 3))
        for i in range(k)
        for j in range(i)
        if abs(correlation[i, j]) > _CORRELATED
    ]
    pairs.sort(key=lambda pair: -abs(pair[2]))
    return {name: float(d) for name, d in zip(names, deviation, strict=True)}, tuple(pairs)
