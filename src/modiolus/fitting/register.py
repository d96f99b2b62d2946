"""Rigid and similarity registration of surfaces.

`similarity` brings matched points onto each other, `icp` refines a pose by closest points, and
`register` finds the pose of a face scan of which neither the axes nor the unit are known.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ..anatomy.surface import Surface
from ..errors import InputError, SolveError
from ..hermite.basis import Array

Bools = NDArray[np.bool_]

#: Millimetres in a unit of length that a scanner may write.
UNITS = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "in": 25.4, "m": 1000.0}
#: Those that a scan may be in without a word: half a face in cm has the size of a face in inches.
_USUAL = (UNITS["mm"], UNITS["cm"], UNITS["m"])
#: Scale between two heads that is believed (a child's and a large man's).
SCALES = (0.7, 1.45)
#: Points of each surface in the search from many starts, and in the refinement.
_COARSE, _FINE = 500, 4000
#: Length (mm) by which two opposite unit normals are apart in the search.
_TURN = 25.0
#: Radius (mm) of the surroundings whose shape tells how much a place counts in the score.
_AROUND = 15.0
#: Distance (mm) beyond which it does not matter how far a point is, in the search's score.
_FAR = 12.0
#: Poses of the search that are refined.
_BEST = 6
#: Height (mm) of the crown above the highest part of a face's skin.
_CROWN = 30.0
#: Closest points within this share of the mean edge from a free edge are no matches.
_RIM = 0.75
#: Width of Tukey's weights in robust standard deviations, and their least width (mm).
_TUKEY, _LEAST_WIDTH = 4.685, 0.2
#: A pose of which fewer points than this share find a match is none.
_LEAST_MATCHED = 0.15


@dataclass(frozen=True, eq=False)
class Registration:
    """A similarity ``x -> scale * rotation @ x + translation`` and how well it fits.

    Attributes
    ----------
    scale : float
        With an unknown unit it contains the unit: a scan in metres has one near 1000.
    rotation : (3, 3) array
        Proper: its determinant is +1.
    translation : (3,) array
        In mm.
    rms : float
        Root mean square distance (mm) between the moved surface and the target where both are.
    matched : float
        Share of the surface's points that have a counterpart on the target.
    facing : float
        Mean cosine between the normals of surface and target there. Near -1 the triangles of
        the surface run the wrong way round, as those of a mirrored scan do.
    unit : float
        Millimetres of the surface's unit: 1, 10 or 1000.
    """

    scale: float = 1.0
    rotation: Array = field(default_factory=lambda: np.eye(3))
    translation: Array = field(default_factory=lambda: np.zeros(3))
    rms: float = np.nan
    matched: float = np.nan
    facing: float = np.nan
    unit: float = 1.0

    def apply(self, points: ArrayLike) -> Array:
        """Return points (..., 3) of the surface in the target's frame."""
        return np.asarray(self.scale * np.asarray(points) @ self.rotation.T + self.translation)

    def undo(self, points: ArrayLike) -> Array:
        """Return points (..., 3) of the target's frame in the surface's."""
        return np.asarray((np.asarray(points) - self.translation) @ self.rotation / self.scale)

    def moved(self, surface: Surface) -> Surface:
        """Return the surface in the target's frame."""
        return Surface(self.apply(surface.vertices), surface.faces, surface.name)

    def after(self, first: Registration) -> Registration:
        """Return what does another one first, and then this."""
        return Registration(
            self.scale * first.scale,
            self.rotation @ first.rotation,
            self.apply(first.translation),
            unit=first.unit,
        )

    def stepped(self, step: Array, centre: Array, growth: float = 1.0) -> Registration:
        """Return this and then a small motion about a centre (3,).

        Parameters
        ----------
        step : (6,) array
            A turn (radians) and a shift (mm).
        centre : (3,) array
        growth : float
            A factor.
        """
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        shift = centre - growth * turn @ centre + step[3:6]
        return Registration(growth, turn, shift).after(self)


def similarity(source: ArrayLike, target: ArrayLike, scaled: bool = True) -> Registration:
    """Return the similarity that brings matched points together in the least-squares sense.

    Parameters
    ----------
    source, target : (n, 3) arrays
        At least three pairs, not on one line.
    scaled : bool
        Whether the scale is free; otherwise it is 1.

    Raises
    ------
    InputError
        There are too few pairs, or they lie on one line.

    Notes
    -----
    The closed form of Umeyama (1991), IEEE Trans. Pattern Anal. Mach. Intell. 13:376-380.
    """
    a, b = np.asarray(source, dtype=float), np.asarray(target, dtype=float)
    if a.shape != b.shape or a.ndim != 2 or a.shape[1] != 3 or len(a) < 3:
        raise InputError("landmarks: fewer than three pairs; give at least three")
    centre_a, centre_b = a.mean(axis=0), b.mean(axis=0)
    spread = np.linalg.svd(a - centre_a, compute_uv=False)
    if spread[1] <= 1e-6 * max(spread[0], 1e-300):
        raise InputError("landmarks: they lie on one line; give some off it")
    u, singular, vt = np.linalg.svd((b - centre_b).T @ (a - centre_a))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * signs) @ vt
    scale = float((singular * signs).sum() / (spread**2).sum()) if scaled else 1.0
    moved = scale * (a - centre_a) @ rotation.T + centre_b
    rms = float(np.sqrt(((moved - b) ** 2).sum(axis=1).mean()))
    return Registration(scale, rotation, centre_b - scale * rotation @ centre_a, rms, 1.0)


def sphere(points: Array) -> tuple[Array, float]:
    """Return centre (3,) and radius of the sphere through points (n, 3), by least squares.

    |x|² = 2 c·x + (r² - |c|²) is linear in the centre and in the rest.
    """
    system = np.column_stack([2.0 * points, np.ones(len(points))])
    solution = np.linalg.lstsq(system, (points**2).sum(axis=1), rcond=None)[0]
    centre = solution[:3]
    return centre, float(np.sqrt(solution[3] + centre @ centre))


class Matcher:
    """A surface with samples of it and its free edges, for matching by closest points.

    Parameters
    ----------
    surface : Surface
    count : int
        About how many samples.

    Attributes
    ----------
    points, normals : (n, 3) arrays
        The samples.
    """

    def __init__(self, surface: Surface, count: int) -> None:
        self.surface = surface
        self.points = surface.samples(np.sqrt(surface.area / count))
        self.normals = surface.normals[surface.closest(self.points).faces]
        rim = rim_points(surface)
        self.rim = cKDTree(rim) if len(rim) else None
        self.width = _RIM * np.sqrt(4.0 / np.sqrt(3.0) * surface.area / len(surface.faces))

    def matches(self, points: Array, reach: float = np.inf) -> tuple[Array, Array, Bools]:
        """Return closest points (n, 3), their normals, and which of them are matches.

        The closest point of what lies beyond a free edge is on that edge: no match.
        """
        found = self.surface.closest(points)
        good = found.distance < reach
        if self.rim is not None:
            good &= self.rim.query(found.points)[0] > self.width
        return found.points, self.surface.normals[found.faces], good


def rim_points(surface: Surface) -> Array:
    """Return points along the free edges of a surface, (n, 3): their ends and middles."""
    edges = np.sort(surface.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    found, count = np.unique(edges, axis=0, return_counts=True)
    ends = surface.vertices[found[count == 1]]
    return np.asarray(np.concatenate([ends.reshape(-1, 3), ends.mean(axis=1)]))


def icp(
    surface: Surface,
    target: Surface,
    start: Registration | None = None,
    scaled: bool = False,
    both: bool = True,
    iterations: int = 60,
    reach: float = 30.0,
) -> Registration:
    """Refine the pose of a surface on a target by robust point-to-plane matching.

    Closest points are sought from samples of the surface on the target and back; those on a free
    edge do not count, and Tukey's weights discount what lies far off compared with the others.

    Parameters
    ----------
    surface, target : Surface
        What is moved, and what stays (mm).
    start : Registration, optional
        Where to begin; by default in place.
    scaled : bool
        Whether the scale may change.
    both : bool
        Whether the target's samples look for the surface, too.
    iterations : int
        At most.
    reach : float
        Distance (mm) beyond which nothing is matched; it shrinks as the fit improves.

    Returns
    -------
    Registration

    Raises
    ------
    SolveError
        Surface and target do not meet.
    """
    start = start or Registration()
    return _icp(
        Matcher(surface, _FINE), Matcher(target, _FINE), start, scaled, both, iterations, reach
    )


def _icp(
    moving: Matcher,
    fixed: Matcher,
    start: Registration,
    scaled: bool,
    both: bool,
    iterations: int,
    reach: float,
) -> Registration:
    pose = start
    least, most = (start.scale * bound for bound in SCALES)
    facing = 1.0
    for _ in range(iterations):
        moved = pose.apply(moving.points)
        near, normals, good = fixed.matches(moved, reach)
        own = moving.normals @ pose.rotation.T
        cosine = np.einsum("ni,ni->n", own, normals)
        if good.mean() < _LEAST_MATCHED:
            raise SolveError(
                f"registration: {moving.surface.name} does not meet {fixed.surface.name}; give "
                "landmarks, or a scan of the face alone"
            )
        facing = float(np.sign(cosine[good].mean()) or 1.0)
        good &= facing * cosine > 0.3
        points, normals, towards = moved[good], normals[good], near[good]
        if both:
            back, turned, seen = moving.matches(pose.undo(fixed.points), reach / pose.scale)
            turned = turned @ pose.rotation.T
            seen &= facing * np.einsum("ni,ni->n", turned, fixed.normals) > 0.3
            points = np.vstack([points, pose.apply(back[seen])])
            normals = np.vstack([normals, turned[seen]])
            towards = np.vstack([towards, fixed.points[seen]])
        gap = np.einsum("ni,ni->n", towards - points, normals)
        width = max(_TUKEY * 1.4826 * float(np.median(np.abs(gap))), _LEAST_WIDTH)
        weight = np.clip(1.0 - (gap / width) ** 2, 0.0, None) ** 2
        centre = points.mean(axis=0)
        arm = points - centre
        columns = [np.cross(arm, normals), normals]
        if scaled:
            columns.append(np.einsum("ni,ni->n", arm, normals)[:, None])
        matrix = np.hstack(columns)
        normal = matrix.T @ (weight[:, None] * matrix)
        normal += 1e-9 * np.diag(np.diag(normal))
        step = np.linalg.solve(normal, matrix.T @ (weight * gap))
        grown = float(np.clip(1.0 + step[6], 0.8, 1.25)) if scaled else 1.0
        grown = float(np.clip(pose.scale * grown, least, most)) / pose.scale
        pose = pose.stepped(step[:6], centre, grown)
        reach = max(min(reach, 3.0 * width), 3.0)
        if np.abs(step[3:6]).max() < 1e-4 and np.abs(step[:3]).max() < 1e-6:
            break
    return _measured(pose, moving, fixed)


def _measured(pose: Registration, moving: Matcher, fixed: Matcher) -> Registration:
    moved = pose.apply(moving.points)
    near, normals, good = fixed.matches(moved, _FAR)
    cosine = np.einsum("ni,ni->n", moving.normals @ pose.rotation.T, normals)
    if not good.any():
        return pose
    distance = np.linalg.norm(near - moved, axis=1)[good]
    return Registration(
        pose.scale,
        pose.rotation,
        pose.translation,
        float(np.sqrt(np.mean(distance**2))),
        float(good.mean()),
        float(cosine[good].mean()),
        pose.unit,
    )


def register(
    surface: Surface,
    target: Surface,
    landmarks: tuple[ArrayLike, ArrayLike] | None = None,
    scaled: bool = True,
) -> Registration:
    """Find the pose (and unit, and size) of a face scan on a head's skin.

    Without landmarks nothing is assumed of the scan's axes: a coarse search begins from many
    rotations, matches position and normal, and the best poses are refined (`icp`). Only proper
    rotations are tried; a mirrored scan, which fits a nearly symmetric face as well, shows in
    `Registration.facing`.

    Parameters
    ----------
    surface : Surface
        The scan, in mm, cm or m, of any pose; parts of it may be missing or more than the face.
    target : Surface
        The skin of the face (mm).
    landmarks : ((n, 3) array, (n, 3) array), optional
        Matched points of the surface and of the target; then these give the first pose.
    scaled : bool
        Whether the sizes may differ. If not, the scale of the result is the unit.

    Returns
    -------
    Registration

    Raises
    ------
    InputError
        The landmarks are unusable.
    SolveError
        Surface and target do not meet.
    """
    moving, fixed = Matcher(surface, _FINE), Matcher(target, _FINE)
    if landmarks is not None:
        start = similarity(*landmarks)
        unit = min(UNITS.values(), key=lambda value: abs(np.log(start.scale / value)))
        scale = start.scale if scaled else unit
        here, there = (np.asarray(points, dtype=float).mean(axis=0) for points in landmarks)
        starts = [
            Registration(scale, start.rotation, there - scale * start.rotation @ here, unit=unit)
        ]
    else:
        starts = _search(moving, fixed, scaled)
    features = _features(fixed)
    found: list[tuple[float, Registration]] = []
    fault: SolveError | None = None
    for start in starts:
        try:
            pose = _icp(moving, fixed, start, scaled, True, 10, 30.0)
        except SolveError as error:
            fault = error
            continue
        found.append((_score(pose, moving, fixed, features), pose))
    if not found:
        assert fault is not None
        raise fault
    best = min(found, key=lambda item: item[0])[1]
    return _icp(moving, fixed, best, scaled, True, 60, 15.0)


def _features(matcher: Matcher) -> Array:
    """Return how much the surface around each sample differs from a plane, (n,), 1 in the mean.

    A forehead and the back of a head are alike; nose, lips and eyes tell which is which.
    """
    around = cKDTree(matcher.points).query_ball_point(matcher.points, _AROUND)
    bent = np.array([1.0 - np.linalg.norm(matcher.normals[k].mean(axis=0)) for k in around])
    return np.asarray(bent / bent.mean())


def _score(pose: Registration, moving: Matcher, fixed: Matcher, weights: Array) -> float:
    """Mean distance (mm) of the target to the surface, with what their normals differ by.

    Capped; of what the surface does not show half of the cap counts.
    """
    near, normals, shown = moving.matches(pose.undo(fixed.points))
    away = np.linalg.norm(pose.apply(near) - fixed.points, axis=1)
    turned = np.linalg.norm(normals @ pose.rotation.T - fixed.normals, axis=1)
    cost = np.minimum(np.hypot(away, 0.5 * _TURN * turned), _FAR)
    return float(np.mean(weights * np.where(shown, cost, 0.5 * _FAR)))


def unit_name(millimetres: float) -> str:
    """Return the name of a unit of length, from `UNITS`."""
    return next(name for name, value in UNITS.items() if value == millimetres)


def guess_unit(surface: Surface, target: Surface) -> float:
    """Return the millimetres of a surface's unit that make its size most like the target's."""
    size, wanted = (float(np.linalg.norm(np.ptp(s.bounds, axis=0))) for s in (surface, target))
    return min(_USUAL, key=lambda unit: abs(np.log(unit * size / wanted)))


def _search(moving: Matcher, fixed: Matcher, scaled: bool) -> list[Registration]:
    """Return the best poses of a coarse search from many rotations, the best first."""
    unit = guess_unit(moving.surface, fixed.surface)
    stride = max(1, len(moving.points) // _COARSE)
    points, normals = unit * moving.points[::stride], moving.normals[::stride]
    stride = max(1, len(fixed.points) // _COARSE)
    places, facings = fixed.points[::stride], fixed.normals[::stride]
    tree = cKDTree(np.hstack([places, 0.5 * _TURN * facings]))
    rotations = Rotation.concatenate([Rotation.create_group("I"), Rotation.create_group("O")])
    # Triangles may run the wrong way round: both signs of the normals are tried.
    sides = [
        (sign * normals, cKDTree(np.hstack([points, 0.5 * _TURN * sign * normals])))
        for sign in (1.0, -1.0)
    ]
    poses = [
        (0.0, side, Registration(1.0, turn, shift))
        for side in (0, 1)
        for turn in rotations.as_matrix()
        for shift in _shifts(points @ turn.T, places)
    ]
    # All of them for a few steps, then the better ones to the end.
    for steps, survivors in ((np.linspace(0.9, 0.7, 8), 40), (np.linspace(0.7, 0.5, 20), 40)):
        advanced = []
        for _, side, pose in poses:
            own = (points, *sides[side])
            for kept in steps:
                pose = _advanced(pose, *_pairs(pose, own, (places, facings, tree))[0], kept, scaled)
            score = _pairs(pose, own, (places, facings, tree))[1]
            advanced.append((score, side, pose))
        poses = sorted(advanced, key=lambda item: item[0])[:survivors]
    best: list[Registration] = []
    for _, _, pose in poses:
        # One of each set of poses that have come to the same place.
        if all(
            np.linalg.norm(pose.apply(points) - other.apply(points), axis=1).mean() > 4.0
            for other in best
        ):
            best.append(pose)
        if len(best) == _BEST:
            break
    return [
        Registration(pose.scale * unit, pose.rotation, pose.translation, unit=unit) for pose in best
    ]


def _shifts(points: Array, places: Array) -> tuple[Array, Array]:
    """Return two shifts of turned samples: centre upon centre, and top and front aligned.

    The second is for scans of a whole head, or of more, whose centre is not that of the face.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    front = np.array([0.5 * (low[0] + high[0]), low[1], high[2] - _CROWN])
    there = np.array([places[:, 0].mean(), places[:, 1].min(), places[:, 2].max()])
    return places.mean(axis=0) - points.mean(axis=0), there - front


_Samples = tuple[Array, Array, cKDTree]


def _pairs(pose: Registration, own: _Samples, fixed: _Samples) -> tuple[tuple[Array, Array], float]:
    """Match samples both ways by position and normal; return the pairs and a capped score."""
    (points, normals, own_tree), (places, facings, tree) = own, fixed
    moved, turned = pose.apply(points), normals @ pose.rotation.T
    there, index = tree.query(np.hstack([moved, 0.5 * _TURN * turned]))
    back = np.hstack([pose.undo(places), 0.5 * _TURN * facings @ pose.rotation])
    distance, other = own_tree.query(back)
    pairs = np.vstack([moved, moved[other]]), np.vstack([places[index], places])
    nearer = np.sort(there)[: len(there) // 2]
    return pairs, float(np.minimum(distance, _FAR).mean() + np.minimum(nearer, _FAR).mean())


def _advanced(
    pose: Registration, points: Array, towards: Array, kept: float, scaled: bool
) -> Registration:
    """Move a pose by the similarity of the closer share of its pairs."""
    length = np.linalg.norm(points - towards, axis=1)
    near = length <= np.quantile(length, kept)
    step = similarity(points[near], towards[near], scaled)
    ratio = float(np.clip(step.scale * pose.scale, *SCALES)) / pose.scale
    centre, there = points[near].mean(axis=0), towards[near].mean(axis=0)
    translation = ratio * step.rotation @ (pose.translation - centre) + there
    return Registration(ratio * pose.scale, step.rotation @ pose.rotation, translation)
