"""Structured Hermite meshes: from a grid of points, or with given derivatives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ..errors import InputError
from .basis import Array, IntArray
from .check import numbers, whole
from .mesh import HermiteMesh


def differences(values: Array, axis: int, periodic: bool = False) -> Array:
    """Differentiate grid values per unit index: centred inside, second order at the ends."""
    values = np.moveaxis(np.asarray(values, dtype=float), axis, 0)
    if periodic:
        out = 0.5 * (np.roll(values, -1, axis=0) - np.roll(values, 1, axis=0))
    elif len(values) == 2:
        out = np.repeat(np.diff(values, axis=0), 2, axis=0)
    else:
        out = np.gradient(values, axis=0, edge_order=2)
    return np.moveaxis(out, 0, axis)


def grid_connectivity(counts: Sequence[int], periodic: Sequence[bool]) -> IntArray:
    """Return the node of every corner, (n_elements, 2**dim); first direction fastest.

    ``counts`` are elements per direction; a periodic direction has as many nodes as
    elements, any other one more.
    """
    dim = len(counts)
    nodes = [c if p else c + 1 for c, p in zip(counts, periodic, strict=True)]
    corners = np.zeros((int(np.prod(counts)), 2**dim), dtype=np.int64)
    for number, place in enumerate(np.ndindex(*counts[::-1])):
        cell = place[::-1]
        for corner in range(2**dim):
            node, stride = 0, 1
            for k in range(dim):
                node += stride * ((cell[k] + ((corner >> k) & 1)) % nodes[k])
                stride *= nodes[k]
            corners[number, corner] = node
    return corners


def assemble(corners: ArrayLike, derivatives: ArrayLike) -> HermiteMesh:
    """Build a mesh with unit scale factors from nodal derivatives.

    Parameters
    ----------
    corners : (n_elements, 2**dim) int array
        Node of each corner.
    derivatives : (n_nodes, 2**dim, 3) array
        Value and derivatives of each node in the order of the basis.

    Raises
    ------
    InputError
        An array has another shape, a node does not exist, or a derivative is not finite.
    """
    corners, dim = _corners("corners", corners, len(np.asarray(derivatives)))
    kinds = 2**dim
    derivatives = numbers("derivatives", derivatives, None, kinds, 3)
    columns = (corners[:, :, None] * kinds + np.arange(kinds)).ravel()
    extraction = sp.csr_matrix(
        (np.ones(len(columns)), columns, np.arange(len(columns) + 1)),
        shape=(len(columns), derivatives.shape[0] * kinds),
    )
    return HermiteMesh(dim, derivatives.reshape(-1, 3).copy(), extraction)


def grid(points: ArrayLike, periodic: Sequence[bool] | None = None) -> HermiteMesh:
    """Interpolate a structured grid of points by a C1 mesh with unit scale factors.

    Parameters
    ----------
    points : (n1, [n2, [n3,]] 3) array
        Nodal positions in mm; parameter ``node * 2**dim + derivative`` with the first
        direction's nodes fastest.
    periodic : sequence of bool, optional
        Directions in which the grid closes on itself (the first point is not repeated).

    Returns
    -------
    HermiteMesh
        Derivatives are centred differences (one-sided at ends).

    Raises
    ------
    InputError
        The points are no such grid, are not finite, or are too few in some direction: two, or
        three where it closes.
    """
    points = np.asarray(points, dtype=float)
    dim = points.ndim - 1
    if dim not in (1, 2, 3):
        raise InputError(f"points: shape {points.shape} is no grid; give 1 to 3 axes of points")
    points = numbers("points", points, *[None] * dim, 3)
    closed = [False] * dim if periodic is None else list(periodic)
    if len(closed) != dim:
        raise InputError(f"periodic: {len(closed)} directions, the grid has {dim}; give each")
    counts = [n if p else n - 1 for n, p in zip(points.shape, closed, strict=False)]
    if any(n < (3 if p else 1) for n, p in zip(counts, closed, strict=True)):
        raise InputError(
            f"points: shape {points.shape} is too small; give at least 2 points in each direction, "
            "3 where it closes"
        )
    nodal = [points]
    for k in range(dim):
        nodal += [differences(field, k, closed[k]) for field in nodal]
    stacked = np.stack(nodal, axis=dim)
    order = [*range(dim)[::-1], dim, dim + 1]
    flat = stacked.transpose(order).reshape(-1, 2**dim, 3)
    return assemble(grid_connectivity(counts, closed), flat)


def bricks(ticks: Sequence[ArrayLike]) -> HermiteMesh:
    """Return the elements between planes across the axes.

    Parameters
    ----------
    ticks : sequence of (n_k,) array
        Where the planes across each of three axes are, ascending, in mm.

    Raises
    ------
    InputError
        There are not three axes, or the planes of one do not ascend.
    """
    planes = [numbers("ticks", places, None) for places in ticks]
    if len(planes) != 3 or not all((np.diff(places) > 0.0).all() for places in planes):
        raise InputError("ticks: not ascending along each of three axes; sort them")
    return grid(np.stack(np.meshgrid(*planes, indexing="ij"), axis=-1))


def linear(vertices: ArrayLike, cells: ArrayLike) -> HermiteMesh:
    """Represent a multilinear mesh exactly in the Hermite space.

    Only the nodal positions are parameters; the extraction turns their differences into
    the local derivatives.

    Parameters
    ----------
    vertices : (n, 3) array
        In mm.
    cells : (m, 2**dim) int array
        Corners in the order of the basis.

    Raises
    ------
    InputError
        An array has another shape, a vertex does not exist, or one is not finite.
    """
    vertices = numbers("vertices", vertices, None, 3)
    cells, dim = _corners("cells", cells, len(vertices))
    kinds = 2**dim
    operator = np.zeros((kinds * kinds, kinds))
    for corner in range(kinds):
        for kind in range(kinds):
            for sides in range(kinds):
                free = sides & kind
                source = (corner & ~kind) | free
                if sides & ~kind:
                    continue
                sign = (-1.0) ** bin(kind & ~free).count("1")
                operator[corner * kinds + kind, source] += sign
    rows = np.repeat(np.arange(len(cells) * kinds * kinds), kinds)
    columns = np.repeat(cells, kinds * kinds, axis=0).ravel()
    data = np.tile(operator.ravel(), len(cells))
    extraction = sp.csr_matrix((data, (rows, columns)), shape=(rows[-1] + 1, len(vertices)))
    extraction.eliminate_zeros()
    return HermiteMesh(dim, vertices.copy(), extraction)


def _corners(name: str, values: ArrayLike, n_nodes: int) -> tuple[IntArray, int]:
    """Check the corners of elements, and tell their dimension from their number."""
    corners = whole(name, values, n_nodes, ndim=2)
    dim = {2: 1, 4: 2, 8: 3}.get(corners.shape[1])
    if dim is None:
        raise InputError(f"{name}: {corners.shape[1]} in an element; give 2, 4 or 8")
    return corners, dim
