"""What a state of the face is to match: pairs of places of the skin and measured points.

Every residual is a distance along a direction, ``r = n · (x - x_skin)``, between a measured point
and a material point of the skin. A scan gives one along the normal for each of its points, a
marker, of which it is known where on the skin it sits, three along the axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..errors import InputError, SolveError
from ..fitting.register import Registration
from .scan import Scan
from .skin import Feet, Skin

__all__ = ["MarkerTarget", "Matches", "ScanTarget", "Target"]

Array = NDArray[np.float64]

#: Points of the scan and of the skin that are matched.
_POINTS = 16000
#: Nearer than this (mm) a distance has no direction but the normal.
_TOUCHING = 1e-5
#: Points of a scan farther than this (mm) from the skin are no counterparts of it.
_REACH = 20.0
#: Where the neutral scan is farther than this (mm) from the skin at rest, the scan shows no skin:
#: eyes, hair, the inside of the mouth.
_SHAPE = 5.0


@dataclass(frozen=True, eq=False)
class Matches:
    """Distances along directions, and how they change with the skin and with the pose.

    Attributes
    ----------
    feet : Feet
        Material points of the skin.
    directions : (n, 3) array
    residual : (n,) array
        Measured point minus skin along the direction (mm).
    arms : (n, 3) array
        The measured points from their middle, for rotations of the pose.
    weight : (n,) array
        Those of all rows of a place sum to 1 over all places.
    """

    feet: Feet
    directions: Array
    residual: Array
    arms: Array
    weight: Array

    @property
    def mean(self) -> float:
        """Mean square of the distances in mm²."""
        return float((self.weight * self.residual**2).sum())

    def slopes(self, skin: Skin, change: Array) -> Array:
        """Return the derivatives of the residuals by parameters of the state and by the pose.

        Parameters
        ----------
        skin : Skin
        change : (n_params, 3, k) array
            Derivatives of the tissue's parameters.

        Returns
        -------
        (n, k + 7) array
            Last those by turns about the middle (radians), shifts (mm) and growth about it (1).
        """
        motion = skin.motion(self.feet, change)
        moved = -np.einsum("ni,nik->nk", self.directions, motion)
        growth = (self.arms * self.directions).sum(axis=1)
        turns = np.cross(self.arms, self.directions)
        return np.column_stack([moved, turns, self.directions, growth])


class Target(Protocol):
    """What can be matched by a state of the face in a pose of what was measured.

    Attributes
    ----------
    skin : Skin
    middle : (3,) array
        Of the measured points; the pose turns about it.
    known_pose : bool
        Whether the pose that was given comes from parts that keep still, or the same face at rest,
        which also tells the size.
    """

    skin: Skin
    middle: Array
    known_pose: bool

    def renew(self, parameters: Array, pose: Registration) -> None:
        """Refresh what stands still between two calls, so that distances have derivatives."""

    def matches(self, parameters: Array, pose: Registration) -> Matches:
        """Match in a state (n_params, 3) and a pose."""


class ScanTarget:
    """A scan to be matched, and the distances that the shape at rest leaves.

    Parameters
    ----------
    skin : Skin
    scan : Scan
        In the head's frame (see `modiolus.scans.align`).
    neutral : Scan, optional
        The same person at rest, in the head's frame. What lies between it and the skin at rest is
        shape, which no muscle explains: it is carried along with the skin, to where the scan was
        matched by the last `renew`. Where the skin at rest does not meet it, nothing is matched.

    Raises
    ------
    InputError
        No point of the scan can be seen from the front.
    """

    def __init__(self, skin: Skin, scan: Scan, neutral: Scan | None = None) -> None:
        self.skin = skin
        rest = skin.head.tissue.parameters
        chance = scan.weights * scan.visible
        count = min(_POINTS, int((chance > 0.0).sum()))
        if not count:
            raise InputError(
                f"{scan.name}: from the front none of its points is seen; check its pose, and "
                "that its triangles face outward"
            )
        picked = np.random.default_rng(0).choice(
            len(scan.points), count, replace=False, p=chance / chance.sum()
        )
        self.scan = scan
        self.points, self.normals = scan.points[picked], scan.normals[picked]
        self.middle = self.points.mean(axis=0)
        surface = skin.surface(rest)
        samples = surface.samples(np.sqrt(surface.area / _POINTS))
        self.own = skin.state(rest).feet(samples)
        self.known_pose = neutral is not None
        self._shape = None if neutral is None else self._shape_of(neutral)
        self._own_left, self._own_met = self._shape_at(self.own)
        self._left, self._met = np.zeros(count), np.ones(count, dtype=bool)

    def _shape_of(self, neutral: Scan) -> tuple[cKDTree, Array, NDArray[np.bool_]]:
        """Return points of the skin at rest, how far the neutral scan is, and where it is one."""
        skin = self.skin
        rest = skin.head.tissue.parameters
        feet = skin.state(rest).feet(skin.surface(rest).vertices)
        near, outward, rim = neutral.nearest(feet.points)
        gap = ((near - feet.points) * feet.normals).sum(axis=1)
        good = ~rim & ((outward * feet.normals).sum(axis=1) > 0.5) & (np.abs(gap) < _SHAPE)
        return cKDTree(feet.points), np.where(good, gap, 0.0), good

    def _shape_at(self, feet: Feet) -> tuple[Array, NDArray[np.bool_]]:
        """Return what the shape at rest leaves at material points, and where scan meets skin."""
        if self._shape is None:
            return np.zeros(len(feet.elements)), np.ones(len(feet.elements), dtype=bool)
        tree, gaps, good = self._shape
        places = self.skin.places(feet, self.skin.head.tissue.parameters)
        distance, near = tree.query(places, k=4)
        share = 1.0 / np.maximum(distance, 0.05)
        share /= share.sum(axis=1, keepdims=True)
        return (share * gaps[near]).sum(axis=1), (share * good[near]).sum(axis=1) > 0.5

    def renew(self, parameters: Array, pose: Registration) -> None:
        """Take what the shape at rest leaves at the points of the scan from this state on."""
        feet = self.skin.state(parameters).feet(
            pose.apply(self.points), self.normals @ pose.rotation.T
        )
        self._left, self._met = self._shape_at(feet)

    def matches(self, parameters: Array, pose: Registration) -> Matches:
        """Match scan and skin both ways, half of the weight each.

        Raises
        ------
        SolveError
            Scan and skin do not meet.
        """
        skin = self.skin
        points = pose.apply(self.points)
        feet = skin.state(parameters).feet(points, self.normals @ pose.rotation.T)
        seen = feet.covered & self._met
        first = feet.take(seen)
        gap, along = _distances(points[seen] - first.points, first.normals)
        gap -= self._left[seen]

        # The other way: material points of the skin that have a counterpart on the scan.
        places = skin.places(self.own, parameters)
        near, outward, rim = self.scan.nearest(pose.undo(places))
        near, outward = pose.apply(near), outward @ pose.rotation.T
        facing = skin.turned(self.own, parameters)
        good = self._own_met & ~rim & (np.linalg.norm(near - places, axis=1) < _REACH)
        good &= (outward * facing).sum(axis=1) > 0.5
        other, across = _distances((near - places)[good], outward[good])
        other -= self._own_left[good]
        if not (seen.any() and good.any()):
            raise SolveError(f"{self.scan.name}: it does not meet the skin; check its pose")
        return Matches(
            Feet.joined([first, self.own.take(good)]),
            np.concatenate([along, across]),
            np.concatenate([gap, other]),
            np.concatenate([points[seen], near[good]]) - pose.apply(self.middle),
            np.repeat([0.5 / len(gap), 0.5 / len(other)], [len(gap), len(other)]),
        )


class MarkerTarget:
    """Single points of which it is known where on the skin they sit.

    Parameters
    ----------
    skin : Skin
    feet : Feet
        Of every marker.
    points : (n, 3) array
        Where the markers are, in the head's frame.
    offsets : (n, 3) array
        What lay between skin and marker at rest, which stays.
    known_pose : bool
        See `Target`.
    """

    def __init__(
        self, skin: Skin, feet: Feet, points: Array, offsets: Array, known_pose: bool = False
    ) -> None:
        self.skin, self.points, self.known_pose = skin, points, known_pose
        self.middle = points.mean(axis=0)
        self._feet, self._offsets = feet, offsets
        self._rows = feet.take(np.repeat(np.arange(len(points)), 3))

    def renew(self, parameters: Array, pose: Registration) -> None:
        """Nothing changes from state to state."""

    def matches(self, parameters: Array, pose: Registration) -> Matches:
        """Match every marker along x, y and z."""
        points = pose.apply(self.points)
        gaps = points - self._offsets - self.skin.places(self._feet, parameters)
        n = len(points)
        return Matches(
            self._rows,
            np.tile(np.eye(3), (n, 1)),
            gaps.ravel(),
            np.repeat(points - pose.apply(self.middle), 3, axis=0),
            np.full(3 * n, 1.0 / n),
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
