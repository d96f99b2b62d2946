"""Point location: the closest point of a Hermite mesh, vectorised."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from ..errors import InputError
from .basis import COEFFICIENTS, Array, IntArray
from .check import numbers

if TYPE_CHECKING:
    from .mesh import HermiteMesh

#: Starting points a direction from which the search in an element may begin.
SAMPLES = 4
#: A point of a volume counts as inside up to this distance (mm).
TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class Location:
    """Where points lie in a mesh.

    Attributes
    ----------
    elements : (n,) int array
    xi : (n, dim) array
        Local coordinates of the closest point.
    distance : (n,) array
        Distance to it in mm.
    inside : (n,) bool array
        Volumes: the point is in the element. Curves and surfaces: it projects into the
        element and not onto its border.
    """

    elements: IntArray
    xi: Array
    distance: Array
    inside: NDArray[np.bool_]


@njit(cache=True)
def _evaluate(dim, coefficients, local, xi, x, tangents):  # type: ignore[no-untyped-def]
    """Position and tangents of one element at one point (written into x and tangents)."""
    h = np.empty((3, 2, 2))
    g = np.empty((3, 2, 2))
    for k in range(dim):
        t = xi[k]
        for s in range(2):
            for d in range(2):
                c = coefficients[s, d]
                h[k, s, d] = c[0] + t * (c[1] + t * (c[2] + t * c[3]))
                g[k, s, d] = c[1] + t * (2.0 * c[2] + t * 3.0 * c[3])
    x[:] = 0.0
    tangents[:] = 0.0
    kinds = 1 << dim
    for corner in range(kinds):
        for kind in range(kinds):
            row = corner * kinds + kind
            value = 1.0
            for k in range(dim):
                value *= h[k, (corner >> k) & 1, (kind >> k) & 1]
            for i in range(3):
                x[i] += value * local[row, i]
            for m in range(dim):
                slope = 1.0
                for k in range(dim):
                    if k == m:
                        slope *= g[k, (corner >> k) & 1, (kind >> k) & 1]
                    else:
                        slope *= h[k, (corner >> k) & 1, (kind >> k) & 1]
                for i in range(3):
                    tangents[i, m] += slope * local[row, i]


@njit(cache=True)
def tangents_at(dim, coefficients, locals_, elements, xi):  # type: ignore[no-untyped-def]
    """Return the tangents at points of elements as columns, (n, 3, dim)."""
    x = np.empty(3)
    out = np.empty((len(xi), 3, dim))
    for point, element in enumerate(elements):
        _evaluate(dim, coefficients, locals_[element], xi[point], x, out[point])
    return out


@njit(cache=True)
def _solved(dim, matrix, right):  # type: ignore[no-untyped-def]
    """Return ``-matrix⁻¹ right`` of a positive definite matrix by elimination; both overwritten.

    Compiling NumPy's solver takes longer than all the rest of this file.
    """
    for k in range(dim):
        for m in range(k + 1, dim):
            factor = matrix[m, k] / matrix[k, k]
            right[m] -= factor * right[k]
            for n in range(k, dim):
                matrix[m, n] -= factor * matrix[k, n]
    for k in range(dim - 1, -1, -1):
        for n in range(k + 1, dim):
            right[k] += matrix[k, n] * right[n]
        right[k] /= -matrix[k, k]
    return right


@njit(cache=True)
def _closest(dim, coefficients, local, point, start, xi):  # type: ignore[no-untyped-def]
    """Projected Gauss-Newton for the closest point of one element; returns its distance."""
    x = np.empty(3)
    tangents = np.empty((3, 3))
    trial = np.empty(dim)
    xi[:] = start
    _evaluate(dim, coefficients, local, xi, x, tangents)
    best = 0.0
    for i in range(3):
        best += (x[i] - point[i]) ** 2
    for _ in range(40):
        gradient = np.zeros(dim)
        gram = np.zeros((dim, dim))
        for m in range(dim):
            for i in range(3):
                gradient[m] += tangents[i, m] * (x[i] - point[i])
                for n in range(dim):
                    gram[m, n] += tangents[i, m] * tangents[i, n]
        for m in range(dim):
            blocked = (xi[m] <= 0.0 and gradient[m] > 0.0) or (xi[m] >= 1.0 and gradient[m] < 0.0)
            if blocked:
                gradient[m] = 0.0
                for n in range(dim):
                    gram[m, n] = 0.0
                    gram[n, m] = 0.0
                gram[m, m] = 1.0
            else:
                gram[m, m] *= 1.0 + 1e-10
                gram[m, m] += 1e-14
        step = _solved(dim, gram, gradient)
        moved = 0.0
        factor = 1.0
        accepted = False
        for _ in range(12):
            for m in range(dim):
                trial[m] = min(1.0, max(0.0, xi[m] + factor * step[m]))
            _evaluate(dim, coefficients, local, trial, x, tangents)
            distance = 0.0
            for i in range(3):
                distance += (x[i] - point[i]) ** 2
            if distance <= best:
                accepted = True
                break
            factor *= 0.5
        if not accepted:
            break
        for m in range(dim):
            moved = max(moved, abs(trial[m] - xi[m]))
            xi[m] = trial[m]
        best = distance
        if moved < 1e-13:
            break
    return np.sqrt(best)


@njit(cache=True, parallel=True)
def _closest_all(  # type: ignore[no-untyped-def]
    dim, coefficients, locals_, points, elements, starts, xi, distances, chosen
):
    for p in prange(len(points)):
        best = np.inf
        trial = np.empty(dim)
        for c in range(elements.shape[1]):
            if elements[p, c] < 0:
                continue
            d = _closest(dim, coefficients, locals_[elements[p, c]], points[p], starts[p, c], trial)
            if d < best:
                best = d
                chosen[p] = elements[p, c]
                distances[p] = d
                xi[p] = trial
            if best < 1e-9:
                break


def locate(mesh: HermiteMesh, points: ArrayLike, candidates: int = 6) -> Location:
    """Find the closest point of a mesh for each of some points.

    The closest of a set of sample points of each element start a projected Gauss-Newton search.

    Parameters
    ----------
    mesh : HermiteMesh
    points : (n, 3) array
        In mm.
    candidates : int
        Greatest number of elements that are searched for a point.

    Raises
    ------
    InputError
        The points have another shape or are not finite, there are no candidates, or the mesh has
        no elements.
    """
    points = numbers("points", points, None, 3)
    if candidates < 1 or not mesh.n_elements:
        raise InputError(
            f"candidates: {candidates} of {mesh.n_elements} elements; search at least one"
        )
    dim = mesh.dim
    ticks = (np.arange(SAMPLES) + 0.5) / SAMPLES
    cell = np.stack([g.ravel() for g in np.meshgrid(*[ticks] * dim, indexing="ij")], axis=1)
    elements = np.repeat(np.arange(mesh.n_elements), len(cell))
    xi = np.tile(cell, (mesh.n_elements, 1))
    tree = cKDTree(mesh.evaluate(elements, xi))
    k = min(4 * candidates, len(elements))
    _, nearest = tree.query(points, k=k)
    nearest = nearest.reshape(len(points), k)
    hosts = elements[nearest]
    # Keep the best sample of each element only.
    for column in range(1, k):
        seen = (hosts[:, :column] == hosts[:, column, None]).any(axis=1)
        hosts[seen, column] = -1
    rank = np.cumsum(hosts >= 0, axis=1)
    hosts[rank > candidates] = -1
    out_xi = np.zeros((len(points), dim))
    distance = np.full(len(points), np.inf)
    chosen = np.zeros(len(points), dtype=np.int64)
    _closest_all(
        dim, COEFFICIENTS, mesh._local, points, hosts, xi[nearest], out_xi, distance, chosen
    )
    within = ((out_xi > 0.0) & (out_xi < 1.0)).all(axis=1)
    inside = distance < TOLERANCE if dim == 3 else within
    return Location(chosen, out_xi, distance, np.asarray(inside))


def closest_in(
    mesh: HermiteMesh, points: Array, elements: IntArray, starts: Array
) -> tuple[IntArray, Array, Array]:
    """Find the closest point of given elements for each of some points.

    Parameters
    ----------
    mesh : HermiteMesh
    points : (n, 3) array
    elements : (n, k) int array
        Where to search for each point; -1 for nowhere, at least one each.
    starts : (n, k, dim) array
        Local coordinates from which to begin.

    Returns
    -------
    elements : (n,) int array
    xi : (n, dim) array
    distance : (n,) array
        In mm.
    """
    xi = np.zeros((len(points), mesh.dim))
    distance = np.full(len(points), np.inf)
    chosen = np.zeros(len(points), dtype=np.int64)
    _closest_all(
        mesh.dim, COEFFICIENTS, mesh._local, points, elements, starts, xi, distance, chosen
    )
    return chosen, xi, distance
