"""Hermite surfaces and volumes as triangles and hexahedra, with the seams closed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from .basis import Array, IntArray
from .mesh import HermiteMesh
from .rows import same_rows

# VTK walks round the bottom of a hexahedron and then round its top.
_VTK_HEXAHEDRON = (0, 1, 3, 2, 4, 5, 7, 6)


@dataclass(frozen=True, eq=False)
class Tessellation:
    """Vertices and cells that follow a Hermite mesh through any change of its parameters.

    Vertices that are the same functional of the parameters are one vertex, so neighbours share
    their seam, while the two sides of a slit stay apart even where they touch.

    Attributes
    ----------
    functions : CSR matrix (n_vertices, n_params)
        ``functions @ parameters`` are the vertices.
    cells : (n_cells, 3) or (n_cells, 8) int array
        Triangles of a surface, or hexahedra of a volume in the order of VTK.
    elements : (n_samples,) int array
    xi : (n_samples, dim) array
        Where the mesh was sampled, element by element.
    vertex : (n_samples,) int array
        The vertex that each sample became.
    """

    functions: sp.csr_matrix
    cells: IntArray
    elements: IntArray
    xi: Array
    vertex: IntArray

    def points(self, parameters: Array) -> Array:
        """Return the vertices (n_vertices, 3) for parameters (n_params, 3)."""
        return np.asarray(self.functions @ parameters)

    def average(self, values: Array) -> Array:
        """Return the mean at every vertex of values given at the samples, (n_samples, ...)."""
        values = np.asarray(values, dtype=float)
        total = np.zeros((self.functions.shape[0], *values.shape[1:]))
        np.add.at(total, self.vertex, values)
        count = np.bincount(self.vertex, minlength=len(total))
        return total / count.reshape(-1, *[1] * (values.ndim - 1))


def tessellate(mesh: HermiteMesh, n: int, outward: ArrayLike = 1) -> Tessellation:
    """Divide every element of a surface or a volume into ``n`` parts each way.

    Parameters
    ----------
    mesh : HermiteMesh
        Of dimension 2 or 3.
    n : int
        Divisions of an element in each direction.
    outward : int or (n_elements,) array of int, optional
        For surfaces: 1 where ``xi1 x xi2`` points outwards, -1 where it points inwards.

    Returns
    -------
    Tessellation
        Cells that have collapsed onto a point or an edge are left out of a surface.

    Raises
    ------
    InputError
        The mesh is a curve, a point of it depends on no parameter, or there is nothing to divide
        into.
    """
    if mesh.dim not in (2, 3):
        raise InputError(f"mesh: dimension {mesh.dim} cannot be tessellated; give a 2 or a 3")
    if n < 1:
        raise InputError(f"n: {n} divisions; give at least 1")
    ticks = np.linspace(0.0, 1.0, n + 1)
    lattice = np.stack(np.meshgrid(*[ticks] * mesh.dim, indexing="ij")[::-1], axis=-1)
    local = lattice.reshape(-1, mesh.dim)
    elements = np.repeat(np.arange(mesh.n_elements), len(local))
    xi = np.tile(local, (mesh.n_elements, 1))
    functions = mesh.functions(elements, xi)
    vertex, _, first = same_rows(functions)
    if (vertex < 0).any():
        raise InputError("mesh: a point depends on no parameter; mend its extraction")

    strides = (n + 1) ** np.arange(mesh.dim)
    lows = np.stack(np.meshgrid(*[np.arange(n)] * mesh.dim, indexing="ij")[::-1], axis=-1)
    bits = np.arange(2**mesh.dim)[:, None] >> np.arange(mesh.dim) & 1
    cells = (lows.reshape(-1, mesh.dim) @ strides)[:, None] + bits @ strides
    cells = np.arange(mesh.n_elements)[:, None, None] * len(local) + cells
    if mesh.dim == 3:
        cells = vertex[cells[..., _VTK_HEXAHEDRON].reshape(-1, 8)]
    else:
        turned = np.broadcast_to(np.asarray(outward) < 0, mesh.n_elements)
        cells[turned] = cells[turned][..., [0, 2, 1, 3]]
        triangles = np.concatenate([cells[..., [0, 1, 3]], cells[..., [0, 3, 2]]], axis=2)
        cells = vertex[triangles.reshape(-1, 3)]
        cells = cells[(cells != np.roll(cells, 1, axis=1)).all(axis=1)]
    return Tessellation(functions[first], cells, elements, xi, vertex)


@dataclass(frozen=True, eq=False)
class Mirror:
    """A half surface and its mirror image as one surface, joined along the mirror plane.

    Attributes
    ----------
    plane : float
        x of the mirror plane in mm.
    source : (n,) int array
        The vertex of the half from which each vertex of the whole comes.
    reflected : (n,) bool array
        Whether it is the mirror image of that vertex.
    faces : (m, 3) int array
        Triangles of the whole.
    """

    plane: float
    source: IntArray
    reflected: NDArray[np.bool_]
    faces: IntArray

    @classmethod
    def of(cls, vertices: Array, faces: IntArray, plane: float, tolerance: float = 1e-3) -> Mirror:
        """Join a half, given at rest, with its image; vertices within `tolerance` are shared."""
        n = len(vertices)
        apart = np.abs(vertices[:, 0] - plane) > tolerance
        image = np.arange(n)
        image[apart] = n + np.arange(apart.sum())
        return cls(
            plane,
            np.concatenate([np.arange(n), np.flatnonzero(apart)]),
            np.arange(n + apart.sum()) >= n,
            np.concatenate([faces, image[faces][:, ::-1]]),
        )

    def points(self, half: Array, other: Array | None = None) -> Array:
        """Return the vertices (n, 3) of the whole from those of the half.

        Where the sides differ, ``other`` has the mirror image of the other one.
        """
        whole = half[self.source]
        if other is not None:
            whole[self.reflected] = other[self.source[self.reflected]]
        whole[self.reflected, 0] = 2.0 * self.plane - whole[self.reflected, 0]
        return whole

    def values(self, half: Array) -> Array:
        """Return values (n, ...) on the whole from values on the half."""
        return half[self.source]
