"""Signed distances on grids, sampled with continuous second derivatives.

A `DistanceGrid` holds the distance to a structure in a band around its surface, on a regular grid
that stores one byte a point. Sampling sums uniform cubic B-splines [1]_ over the 4×4×4 grid points
around a point with the stored distances as coefficients. The field, its gradient and its Hessian
are continuous; the smoothing that this implies displaces a surface of mean curvature H by about
H h²/3 with spacing h, which is 0.03 mm at a radius of 10 mm and a spacing of 1 mm, and rounds
edges sharper than the spacing, which is what contact wants.

References
----------
.. [1] M. Unser, "Splines: a perfect fit for signal and image processing", IEEE Signal Process.
   Mag. 16(6) (1999) 22-38.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numba
import numpy as np
from scipy.ndimage import gaussian_filter, zoom

from modiolus.anatomy.bodyparts3d import BodyParts3D
from modiolus.anatomy.surface import Surface
from modiolus.errors import InputError

__all__ = [
    "DistanceGrid",
    "DistanceSample",
    "MirroredDistance",
    "deep_distances",
    "distances_in_band",
]

#: Distance that one unit of the stored bytes stands for (mm).
QUANTUM = 0.05


class DistanceSample(NamedTuple):
    """A distance field at n points."""

    distance: np.ndarray
    """(n,) signed distances, negative inside (mm)."""
    gradient: np.ndarray
    """(n, 3) first derivatives; close to the outward unit normal near the surface."""
    hessian: np.ndarray
    """(n, 3, 3) second derivatives (1/mm)."""


@dataclass(frozen=True, eq=False)
class DistanceGrid:
    """Signed distance to a structure, known within a band around its surface.

    Parameters
    ----------
    origin : (3,) float array
        Position of the grid point ``values[0, 0, 0]`` (mm).
    spacing : float
        Distance between neighbouring grid points (mm).
    values : (nx, ny, nz) int8 array
        Distances in units of 0.05 mm, negative inside, clipped to ±127 of them (6.35 mm).

    Raises
    ------
    InputError
        Shapes or types are not as above, or a number is not finite.
    """

    origin: np.ndarray
    spacing: float
    values: np.ndarray

    def __post_init__(self) -> None:
        origin = np.asarray(self.origin, dtype=np.float64)
        spacing = float(self.spacing)
        if origin.shape != (3,) or not np.isfinite(origin).all():
            raise InputError("distance grid: its origin is not three finite numbers; build it anew")
        if not (np.isfinite(spacing) and spacing > 0.0):
            raise InputError("distance grid: its spacing is not positive; build it anew")
        values = np.ascontiguousarray(self.values)
        if values.dtype != np.int8 or values.ndim != 3 or min(values.shape) < 4:
            raise InputError(
                "distance grid: its values are not bytes on at least 4×4×4 points; build it anew"
            )
        object.__setattr__(self, "origin", origin)
        object.__setattr__(self, "spacing", spacing)
        object.__setattr__(self, "values", values)

    @property
    def band(self) -> float:
        """Largest distance that is told (mm)."""
        return 127 * QUANTUM

    @property
    def bounds(self) -> np.ndarray:
        """(2, 3) lowest and highest point at which the distance is known (mm)."""
        cells = np.array(self.values.shape) - 2
        return np.stack([self.origin + self.spacing, self.origin + self.spacing * cells])

    @classmethod
    def of(
        cls, surfaces: Sequence[Surface], spacing: float, box: np.ndarray | None = None
    ) -> DistanceGrid:
        """Compute the distance to the union of some surfaces.

        Parameters
        ----------
        surfaces : sequence of Surface
            At least one; they may overlap and have small holes.
        spacing : float
            Grid spacing (mm).
        box : (2, 3) array, optional
            Lowest and highest corner of the region wanted (mm). The grid is that of the surfaces
            with room for the band, cut to this box.

        Raises
        ------
        InputError
            The box does not meet the surfaces.
        """
        whole = Surface.joined(surfaces)
        room = 127 * QUANTUM + spacing
        low, high = whole.bounds + np.array([[-room], [room]])
        if box is not None:
            low, high = np.maximum(low, box[0]), np.minimum(high, box[1])
        if not (high > low).all():
            raise InputError(f"{surfaces[0].name}: nothing of it in the box; give another box")
        shape = np.maximum(np.ceil((high - low) / spacing).astype(int) + 1, 4)
        values = distances_in_band(whole, low, spacing, shape, 127 * QUANTUM)
        return cls(low, spacing, np.round(values / QUANTUM).astype(np.int8))

    @classmethod
    def rounded(cls, grids: Sequence[DistanceGrid], radius: float) -> DistanceGrid:
        """Return the distance to the union of some bodies with its edges and clefts rounded.

        Parameters
        ----------
        grids : sequence of DistanceGrid
        radius : float
            Standard deviation of the Gaussian (mm) with which the distance is smoothed.
        """
        spacing = min(grid.spacing for grid in grids)
        low = np.min([grid.bounds[0] for grid in grids], axis=0)
        high = np.max([grid.bounds[1] for grid in grids], axis=0)
        shape = np.ceil((high - low) / spacing).astype(int) + 1
        nearest = np.min([grid.resampled(low, spacing, shape) for grid in grids], axis=0)
        smooth = gaussian_filter(nearest, radius / spacing, mode="nearest", truncate=3.0)
        return cls(low, spacing, np.round(smooth / QUANTUM).astype(np.int8))

    def resampled(self, origin: np.ndarray, spacing: float, shape: np.ndarray) -> np.ndarray:
        """Return the distances at the points of another grid, as `sample` would.

        The spline is a product of three, so that on a grid it is taken along one axis at a time.

        Parameters
        ----------
        origin : (3,) array
            The grid's first point (mm).
        spacing : float
            In mm.
        shape : (3,) int array

        Returns
        -------
        array of that shape
        """
        # Single precision is finer than the quantum by far.
        values = np.float32(QUANTUM) * self.values.astype(np.float32)
        inside = []
        for axis, count in enumerate(shape):
            size = self.values.shape[axis]
            place = (origin[axis] + spacing * np.arange(count) - self.origin[axis]) / self.spacing
            inside.append((place >= 1.0) & (place <= size - 2.0))
            cell = np.clip(place.astype(int), 1, size - 3)
            # What rounding leaves of 0 has cubes that slow the products down threefold.
            t = np.round(place - cell, 12)
            weights = np.zeros((count, size), dtype=np.float32)
            for k, weight in enumerate(
                (
                    (1.0 - t) ** 3 / 6.0,
                    2.0 / 3.0 - t**2 + 0.5 * t**3,
                    2.0 / 3.0 - (1.0 - t) ** 2 + 0.5 * (1.0 - t) ** 3,
                    t**3 / 6.0,
                )
            ):
                weights[np.arange(count), cell - 1 + k] = weight
            values = np.moveaxis(np.tensordot(weights, values, (1, axis)), 0, axis)
        within = inside[0][:, None, None] & inside[1][:, None] & inside[2]
        return np.where(within, values, np.float32(127 * QUANTUM))

    def sample(self, points: np.ndarray) -> DistanceSample:
        """Sample the field with its first and second derivatives.

        Outside the grid the distance is the band's and the derivatives are zero.

        Parameters
        ----------
        points : (n, 3) array
            Query points (mm).

        Raises
        ------
        ValueError
            The points have another shape.
        """
        queries = np.ascontiguousarray(points, dtype=np.float64)
        if queries.ndim != 2 or queries.shape[1] != 3:
            raise ValueError(f"points of shape {queries.shape}, not (n, 3)")
        n = len(queries)
        sample = DistanceSample(np.empty(n), np.empty((n, 3)), np.empty((n, 3, 3)))
        _sample(self.values, self.origin, self.spacing, QUANTUM, queries, *sample)
        return sample

    def surface(self, level: float = 0.0, closed: bool = False) -> Surface:
        """Triangulate where the distance has a given value.

        Parameters
        ----------
        level : float
            Distance (mm).
        closed : bool
            Whether the surface is closed where the grid cuts it off.
        """
        rim = 2 if closed else 0
        values = np.pad(self.values, rim, constant_values=np.int8(127))
        # The stored distances are spline coefficients: what is drawn is the field that is sampled.
        smooth = QUANTUM * values.astype(np.float64)
        for axis in range(3):
            smooth = _smoothed(smooth, axis)
        return _contour(smooth, self.origin - rim * self.spacing, self.spacing, level)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the grid as plain arrays that compress well: see `from_arrays`."""
        # Differences along all three axes, modulo 256, are mostly 0 and ±1 (Lorenzo's predictor).
        deltas = self.values.view(np.uint8)
        for axis in range(3):
            deltas = np.diff(deltas, axis=axis, prepend=np.uint8(0))
        return {"origin": self.origin, "spacing": np.array(self.spacing), "deltas": deltas}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> DistanceGrid:
        """Make the grid from what `arrays` returned.

        Raises
        ------
        InputError
            An array is missing or of another kind.
        """
        try:
            values = np.asarray(arrays["deltas"])
            origin, spacing = np.asarray(arrays["origin"]), float(arrays["spacing"])
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"distance grid: {error} is missing; build it anew") from error
        if values.dtype != np.uint8:
            raise InputError("distance grid: its deltas are not bytes; build it anew")
        values = values.copy()
        for axis in range(values.ndim):
            # Plane by plane it takes half the time of `np.cumsum`.
            planes = np.moveaxis(values, axis, 0)
            for before, plane in pairwise(planes):
                plane += before
        return cls(origin, spacing, values.view(np.int8))


#: Distance from the mirror plane (mm) within which a structure and its image are blended.
_BLEND = 3.0


@dataclass(frozen=True, eq=False)
class MirroredDistance:
    """Distance to a structure and to its mirror image, given the left one.

    A structure that crosses the plane is not quite its own image. Beside the plane the distances
    to the two are blended, so that the field is exactly symmetric and C² throughout.

    Parameters
    ----------
    grid : DistanceGrid
        Of the left side, at larger x than the plane.
    plane : float
        x of the mirror plane (mm).
    """

    grid: DistanceGrid
    plane: float

    def sample(self, points: np.ndarray) -> DistanceSample:
        """Sample the field with its first and second derivatives: see `DistanceGrid.sample`."""
        away = points[:, 0] - self.plane
        out = self._one_side(points, away < 0.0)
        reach = min(_BLEND, self.plane - float(self.grid.bounds[0, 0]))
        near = np.flatnonzero(np.abs(away) < reach)
        if len(near) == 0:
            return out
        (d, g, h), (e, f, k) = (
            self._one_side(points[near], np.full(len(near), image)) for image in (False, True)
        )
        # The quintic step has no first and second derivative at its ends.
        t = 0.5 + 0.5 * away[near] / reach
        w = t**3 * (10.0 - 15.0 * t + 6.0 * t**2)
        slope = 15.0 * (t * (1.0 - t)) ** 2 / reach
        bend = 15.0 * t * (1.0 - t) * (1.0 - 2.0 * t) / reach**2
        out.distance[near] = e + w * (d - e)
        out.gradient[near] = f + w[:, None] * (g - f)
        out.gradient[near, 0] += slope * (d - e)
        hessian = k + w[:, None, None] * (h - k)
        cross = slope[:, None] * (g - f)
        hessian[:, 0] += cross
        hessian[:, :, 0] += cross
        hessian[:, 0, 0] += bend * (d - e)
        out.hessian[near] = hessian
        return out

    def surface(self) -> Surface:
        """Triangulate where the distance is 0 on the left side, with a rim on the mirror plane."""
        low, high = self.grid.bounds
        low[0] = self.plane
        shape = np.floor((high - low) / self.grid.spacing).astype(int) + 1
        distance = self.sample(_grid_points(low, self.grid.spacing, shape)).distance
        return _contour(distance.reshape(shape), low, self.grid.spacing, 0.0)

    def _one_side(self, points: np.ndarray, image: np.ndarray) -> DistanceSample:
        """Sample the structure, or at some points its image."""
        folded = np.array(points, dtype=np.float64)
        folded[image, 0] = 2.0 * self.plane - folded[image, 0]
        sample = self.grid.sample(folded)
        sample.gradient[image, 0] *= -1.0
        sample.hessian[image, 0, 1:] *= -1.0
        sample.hessian[image, 1:, 0] *= -1.0
        return sample


def distances_in_band(
    surface: Surface, origin: np.ndarray, spacing: float, shape: np.ndarray, band: float
) -> np.ndarray:
    """Compute signed distances on a grid, clipped to a band and only where they are in it.

    Parameters
    ----------
    surface : Surface
        The surface, closed but for small holes.
    origin : (3,) array
        The first grid point (mm).
    spacing : float
        Grid spacing (mm).
    shape : (3,) int array
        Grid points in each direction.
    band : float
        Largest distance wanted (mm).

    Returns
    -------
    array of that shape
    """
    step = max(1, round(0.3 * band / spacing))
    coarse_shape = -(-(shape - 1) // step) + 1
    coarse = surface.signed_distance(_grid_points(origin, spacing * step, coarse_shape))
    fine_shape = (coarse_shape - 1) * step + 1
    guess = zoom(coarse.reshape(coarse_shape), fine_shape / coarse_shape, order=1)
    guess = guess[: shape[0], : shape[1], : shape[2]].ravel()
    # A distance has slope one, so that interpolation within a cell errs by half its diagonal at
    # most: where that is less than the guess, its sign is right.
    doubt = 0.5 * np.sqrt(3.0) * spacing * step
    near = np.flatnonzero(np.abs(guess) < band + doubt)
    values = np.sign(guess) * band
    points = _grid_points(origin, spacing, shape)[near]
    sign = np.sign(guess[near])
    unsure = np.abs(guess[near]) <= doubt
    sign[unsure] = np.where(surface.contains(points[unsure]), -1.0, 1.0)
    values[near] = sign * surface.closest(points).distance
    return np.asarray(np.clip(values, -band, band).reshape(shape))


def _contour(values: np.ndarray, origin: np.ndarray, spacing: float, level: float) -> Surface:
    """Triangulate where values on the points of a grid cross a level."""
    import pyvista as pv

    grid = pv.ImageData(dimensions=values.shape, spacing=(spacing,) * 3, origin=origin)
    grid["distance"] = values.ravel(order="F")
    mesh = grid.contour([level], scalars="distance", method="flying_edges")
    # Flying edges turns its triangles towards smaller values: inwards.
    return Surface(mesh.points, mesh.regular_faces[:, ::-1])


def _grid_points(origin: np.ndarray, spacing: float, shape: np.ndarray) -> np.ndarray:
    axes = [origin[k] + spacing * np.arange(shape[k]) for k in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _smoothed(values: np.ndarray, axis: int) -> np.ndarray:
    """Value of the cubic B-spline with these coefficients at its knots, along one axis."""
    edge = [(1, 1) if k == axis else (0, 0) for k in range(values.ndim)]
    padded = np.moveaxis(np.pad(values, edge, mode="edge"), axis, 0)
    return np.moveaxis((padded[:-2] + 4.0 * padded[1:-1] + padded[2:]) / 6.0, 0, axis)


@numba.njit(cache=True)
def _sample(values, origin, spacing, quantum, points, distance, gradient, hessian):  # type: ignore[no-untyped-def]
    weights = np.empty((3, 3, 4))  # axis, derivative, grid point
    base = np.empty(3, dtype=np.int64)
    band = 127 * quantum
    for p in range(len(points)):
        inside = True
        for axis in range(3):
            place = (points[p, axis] - origin[axis]) / spacing
            if not (1.0 <= place <= values.shape[axis] - 2):
                inside = False
                break
            cell = min(int(place), values.shape[axis] - 3)
            t = place - cell
            base[axis] = cell - 1
            s = 1.0 - t
            w = weights[axis]
            w[0, 0] = s * s * s / 6.0
            w[0, 1] = 2.0 / 3.0 - t * t + 0.5 * t * t * t
            w[0, 2] = 2.0 / 3.0 - s * s + 0.5 * s * s * s
            w[0, 3] = t * t * t / 6.0
            w[1, 0] = -0.5 * s * s / spacing
            w[1, 1] = (1.5 * t * t - 2.0 * t) / spacing
            w[1, 2] = (2.0 * s - 1.5 * s * s) / spacing
            w[1, 3] = 0.5 * t * t / spacing
            w[2, 0] = s / spacing**2
            w[2, 1] = (3.0 * t - 2.0) / spacing**2
            w[2, 2] = (3.0 * s - 2.0) / spacing**2
            w[2, 3] = t / spacing**2
        gradient[p] = 0.0
        hessian[p] = 0.0
        if not inside:
            distance[p] = band
            continue
        total = 0.0
        for i in range(4):
            for j in range(4):
                v0 = 0.0
                v1 = 0.0
                v2 = 0.0
                for k in range(4):
                    value = quantum * values[base[0] + i, base[1] + j, base[2] + k]
                    v0 += weights[2, 0, k] * value
                    v1 += weights[2, 1, k] * value
                    v2 += weights[2, 2, k] * value
                x0 = weights[0, 0, i]
                x1 = weights[0, 1, i]
                y0 = weights[1, 0, j]
                y1 = weights[1, 1, j]
                total += x0 * y0 * v0
                gradient[p, 0] += x1 * y0 * v0
                gradient[p, 1] += x0 * y1 * v0
                gradient[p, 2] += x0 * y0 * v1
                hessian[p, 0, 0] += weights[0, 2, i] * y0 * v0
                hessian[p, 1, 1] += x0 * weights[1, 2, j] * v0
                hessian[p, 2, 2] += x0 * y0 * v2
                hessian[p, 0, 1] += x1 * y1 * v0
                hessian[p, 0, 2] += x1 * y0 * v1
                hessian[p, 1, 2] += x0 * y1 * v1
        distance[p] = total
        hessian[p, 1, 0] = hessian[p, 0, 1]
        hessian[p, 2, 0] = hessian[p, 0, 2]
        hessian[p, 2, 1] = hessian[p, 1, 2]


#: The part of the head in which deep structures meet the left half of the face (mm).
_FACE_BOX = np.array([[-6.0, -216.0, 1405.0], [80.0, -95.0, 1645.0]])

#: Grid spacing (mm), and that of the skull: it is large, and the thickest tissue lies on it.
_SPACING = 0.7
_SPACING_SKULL = 1.0


def deep_distances(anatomy: BodyParts3D, names: Sequence[str]) -> dict[str, DistanceGrid]:
    """Compute the distance grids of deep structures, for the left half of the face.

    Parameters
    ----------
    anatomy : BodyParts3D
        Where their surfaces come from.
    names : sequence of str
        Which of `modiolus.anatomy.bodyparts3d.DEEP_STRUCTURES`.

    Raises
    ------
    InputError
        There is no such structure, or its files are not sound.
    """
    return {
        name: DistanceGrid.of(
            anatomy.group(name), _SPACING_SKULL if name == "skull" else _SPACING, _FACE_BOX
        )
        for name in names
    }
