"""The Hermite finite element mesh with an extraction operator."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numba import njit
from numpy.typing import ArrayLike

from ..errors import InputError
from .basis import COEFFICIENTS, Array, IntArray, basis
from .check import numbers, whole
from .locate import Location, locate, tangents_at
from .quadrature import Quadrature, gauss
from .rows import same_rows

#: Sides of some elements: which, and where ``xi_axis`` equals the side; see `HermiteMesh.face`.
Side = tuple[IntArray, int, int]


@njit(cache=True)
def _sums(functions, local, elements):  # type: ignore[no-untyped-def]
    """Return functions (n, m) times the local parameters (e, m, 3) of their elements, (n, 3)."""
    out = np.zeros((len(functions), 3))
    for point, element in enumerate(elements):
        for a in range(functions.shape[1]):
            for i in range(3):
                out[point, i] += functions[point, a] * local[element, a, i]
    return out


@dataclass(frozen=True, eq=False)
class HermiteMesh:
    """Curve, surface or volume mesh of cubic Hermite elements.

    Every element has the same ``4**dim`` local functions. The extraction operator
    turns the global parameters into the local ones; scale factors, rotated or
    reversed directions, versions and collapsed edges are entries of that operator.

    Attributes
    ----------
    dim : {1, 2, 3}
        Dimension of the elements.
    parameters : (n_params, 3) array
        Nodal values and derivatives in mm.
    extraction : CSR matrix (n_elements * 4**dim, n_params)
        Local parameters = ``extraction @ parameters``.

    Raises
    ------
    InputError
        The arrays do not fit each other, or a parameter is not finite. Every method raises it for
        elements that do not exist and for local coordinates of another shape.
    """

    dim: int
    parameters: Array
    extraction: sp.csr_matrix

    def __post_init__(self) -> None:
        if self.dim not in (1, 2, 3):
            raise InputError(f"dim: {self.dim} is not 1, 2 or 3; elements have one of these")
        numbers("parameters", self.parameters, None, 3)
        rows, columns = self.extraction.shape
        if rows % 4**self.dim or columns != len(self.parameters):
            raise InputError(
                f"extraction: shape {self.extraction.shape} does not fit "
                f"{len(self.parameters)} parameters of dimension {self.dim}; give "
                f"{4**self.dim} rows an element and a column a parameter"
            )
        if self.extraction.format != "csr":
            raise InputError(f"extraction: format {self.extraction.format}; convert it to CSR")

    @property
    def n_elements(self) -> int:
        """Number of elements."""
        return int(self.extraction.shape[0] // 4**self.dim)

    @property
    def n_params(self) -> int:
        """Number of global parameters (each with three components)."""
        return len(self.parameters)

    @cached_property
    def _local(self) -> Array:
        return np.ascontiguousarray(self.local())

    def local(self, parameters: Array | None = None) -> Array:
        """Return local parameters, (n_elements, 4**dim, components), of (n_params, components)."""
        values = self.parameters if parameters is None else parameters
        return np.asarray(self.extraction @ values).reshape(
            self.n_elements, 4**self.dim, values.shape[1]
        )

    def with_parameters(self, parameters: ArrayLike) -> HermiteMesh:
        """Return the mesh with a copy of other parameters, (n_params, 3)."""
        return replace(self, parameters=np.array(parameters, dtype=float))

    def functions(
        self, elements: ArrayLike, xi: ArrayLike, derivative: Sequence[int] | None = None
    ) -> sp.csr_matrix:
        """Return the operator that evaluates a field at points of elements.

        Parameters
        ----------
        elements : (n,) int array
        xi : (n, dim) array
        derivative : sequence of int, optional
            Order of differentiation per direction.

        Returns
        -------
        CSR matrix (n, n_params)
            ``functions @ parameters`` are the values, (n, 3).
        """
        elements, values = self._at(elements, xi, derivative)
        size = 4**self.dim
        columns = elements[:, None] * size + np.arange(size)
        local = sp.csr_matrix(
            (values.ravel(), columns.ravel(), np.arange(0, values.size + 1, size)),
            shape=(len(elements), self.n_elements * size),
        )
        return local @ self.extraction

    def evaluate(
        self, elements: ArrayLike, xi: ArrayLike, derivative: Sequence[int] | None = None
    ) -> Array:
        """Evaluate position, or a derivative of it, at points of elements; (n, 3)."""
        elements, functions = self._at(elements, xi, derivative)
        return np.asarray(_sums(functions, self._local, elements))

    def _at(
        self, elements: ArrayLike, xi: ArrayLike, derivative: Sequence[int] | None
    ) -> tuple[IntArray, Array]:
        """Return checked elements (n,) and their local functions at xi, (n, 4**dim)."""
        functions = basis(self.dim, xi, derivative)
        return self._hosts(elements, functions), functions

    def _hosts(self, elements: ArrayLike, points: Array) -> IntArray:
        """Return checked elements (n,), one for each of some points."""
        hosts = whole("elements", elements, self.n_elements)
        if len(points) != len(hosts):
            raise InputError(f"xi: {len(points)} for {len(hosts)} elements; give one each")
        return hosts

    def _rows(self, elements: ArrayLike, local: ArrayLike) -> sp.csr_matrix:
        """Return some local rows of the extraction for each of some elements."""
        hosts = whole("elements", elements, self.n_elements)
        return self.extraction[(hosts[:, None] * 4**self.dim + np.asarray(local)).ravel()]

    def _check_side(self, axis: int, side: int) -> None:
        if axis not in range(self.dim) or side not in (0, 1):
            raise InputError(
                f"axis {axis}, side {side}: no side of an element; the axis is less than "
                f"{self.dim}, the side 0 or 1"
            )

    def jacobian(self, elements: ArrayLike, xi: ArrayLike) -> Array:
        """Return the tangent vectors dx/dxi_k as columns, (n, 3, dim)."""
        # A copy in order: for every other layout the kernel would be compiled once more.
        xi = np.array(numbers("xi", xi, None, self.dim), order="C")
        hosts = self._hosts(elements, xi)
        return np.asarray(tangents_at(self.dim, COEFFICIENTS, self._local, hosts, xi))

    def scaled_jacobian(self, elements: ArrayLike, xi: ArrayLike) -> Array:
        """Return the determinant of the normalised tangent vectors of a volume mesh, (n,).

        Not a number where an edge has collapsed.
        """
        tangents = self.jacobian(elements, xi)
        unit = tangents / np.linalg.norm(tangents, axis=1, keepdims=True)
        return np.asarray(np.linalg.det(unit))

    def gauss_points(self, n: int) -> tuple[IntArray, Array, Array]:
        """Return elements (q,), xi (q, dim) and unit-cell weights (q,) of a Gauss rule."""
        xi, weights = gauss(self.dim, n)
        elements = np.repeat(np.arange(self.n_elements), len(weights))
        return elements, np.tile(xi, (self.n_elements, 1)), np.tile(weights, self.n_elements)

    def quadrature(self, n: int = 4) -> Quadrature:
        """Return a Gauss quadrature of all elements with physical weights (mm^dim)."""
        elements, xi, weights = self.gauss_points(n)
        tangents = self.jacobian(elements, xi)
        if self.dim == 3:
            measure = np.linalg.det(tangents)
        else:
            gram = np.swapaxes(tangents, 1, 2) @ tangents
            measure = np.sqrt(np.maximum(np.linalg.det(gram), 0.0))
        return Quadrature(elements, xi, weights * measure)

    def measures(self, n: int = 4) -> Array:
        """Return the length, area or volume of every element, (n_elements,)."""
        rule = self.quadrature(n)
        return np.asarray(rule.weights.reshape(self.n_elements, -1).sum(axis=1))

    def face(self, elements: ArrayLike, axis: int, side: int) -> HermiteMesh:
        """Return one side of some elements as a mesh of one dimension less.

        The face shares the parameters of this mesh, so that whatever is fitted or
        measured on it acts on the volume.

        Parameters
        ----------
        elements : (m,) int array
        axis, side : int
            The face is where ``xi_axis`` equals ``side``.
        """
        self._check_side(axis, side)
        corners = [c for c in range(2**self.dim) if (c >> axis) & 1 == side]
        kinds = [d for d in range(2**self.dim) if not (d >> axis) & 1]
        picked = [c * 2**self.dim + d for c in corners for d in kinds]
        return HermiteMesh(self.dim - 1, self.parameters, self._rows(elements, picked))

    def boundary(self, sides: Iterable[tuple[ArrayLike, int, int]]) -> tuple[HermiteMesh, IntArray]:
        """Return several sides of elements of a volume as one surface.

        Parameters
        ----------
        sides : iterable of (elements, axis, side)
            As in `face`.

        Returns
        -------
        surface : HermiteMesh
            The faces, one side after another; it shares the parameters of this mesh.
        outward : (n_faces,) int array
            1 where ``xi1 x xi2`` of a face points out of the volume, -1 where it points into it.
        """
        sides = list(sides)
        faces = [self.face(*side) for side in sides]
        rows = sp.csr_matrix(sp.vstack([face.extraction for face in faces]))
        signs = [outward(axis, side) for _, axis, side in sides]
        return (
            HermiteMesh(self.dim - 1, self.parameters, rows),
            np.repeat(signs, [face.n_elements for face in faces]),
        )

    def face_parameters(
        self, elements: ArrayLike, axis: int, side: int
    ) -> tuple[IntArray, IntArray]:
        """Return the parameters that govern a side of some elements.

        Parameters
        ----------
        elements, axis, side
            As in `face`.

        Returns
        -------
        within : int array
            Parameters of the position on the face (values and derivatives along it).
        across : int array
            Parameters of the derivatives across it.
        """
        self._check_side(axis, side)
        kinds = 2**self.dim
        found = []
        for crossing in (0, 1):
            local = [
                corner * kinds + kind
                for corner in range(kinds)
                if (corner >> axis) & 1 == side
                for kind in range(kinds)
                if (kind >> axis) & 1 == crossing
            ]
            part = self._rows(elements, local)
            found.append(np.unique(part.indices[part.data != 0.0]).astype(np.int64))
        return found[0], found[1]

    def subset(self, elements: ArrayLike) -> HermiteMesh:
        """Return the mesh of some elements with the parameters that they use."""
        picked = self._rows(elements, np.arange(4**self.dim))
        used = np.unique(picked.indices)
        return HermiteMesh(self.dim, self.parameters[used], picked[:, used])

    def corner_nodes(self) -> tuple[IntArray, IntArray]:
        """Identify the distinct corner vertices of the mesh.

        Returns
        -------
        corners : (n_elements, 2**dim) int array
            Vertex index of every corner; corners with the same position functional share it. -1
            where no parameter moves it.
        first : (n_vertices, 2) int array
            Element and corner of the first occurrence.
        """
        rows = np.arange(self.n_elements)[:, None] * 4**self.dim
        rows = (rows + np.arange(2**self.dim) * 2**self.dim).ravel()
        index, _, first = same_rows(self.extraction[rows])
        where = np.stack(np.divmod(first, 2**self.dim), axis=1)
        return index.reshape(self.n_elements, -1), where

    def locate(self, points: ArrayLike, candidates: int = 6) -> Location:
        """Find the closest point of the mesh for each of ``points`` (n, 3) in mm.

        Parameters
        ----------
        points : (n, 3) array
        candidates : int
            Elements to search for each point, at most.
        """
        return locate(self, points, candidates)

    def refine(self, counts: Sequence[int]) -> HermiteMesh:
        """Split every element into ``counts[k]`` equal parts in direction ``k``, exactly.

        See `modiolus.hermite.refine.refine`.
        """
        from .refine import refine

        return refine(self, tuple(counts))


def outward(axis: int, side: int) -> int:
    """Return 1 where ``xi1 x xi2`` of a volume's face points outwards, -1 where inwards.

    Parameters
    ----------
    axis, side : int
        As in `HermiteMesh.face`.
    """
    # The local directions of a face across xi2 are xi1 and xi3, which are left-handed about xi2.
    return (1 if side else -1) * (-1 if axis == 1 else 1)
