"""From element arrays to the global residual and the sparse tangent.

A `Pattern` says which global parameters each element of a group touches. An `Assembly`
holds the element arrays of one or more patterns and lists the entries of the upper triangle of
the global matrix. The list is made once; every later assembly is one pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from . import kernels
from .laws import PAIRS, Array

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Pattern:
    """Global parameters of the elements of one group, padded to equal numbers.

    Attributes
    ----------
    params : (e, m) int array
        Parameter of each function of an element, ascending; padded with 0.
    counts : (e,) int array
        Number of functions before the padding.
    vertices : (e, 8) int array
        Pressure of each corner; (e, 0) in groups without pressures.
    """

    params: IntArray
    counts: IntArray
    vertices: IntArray

    @classmethod
    def from_functions(
        cls,
        functions: sp.csr_matrix,
        hosts: IntArray,
        n_hosts: int,
        vertices: IntArray | None = None,
    ) -> Pattern:
        """Collect the columns that the rows of each host touch.

        Parameters
        ----------
        functions : CSR matrix (n, n_params)
        hosts : (n,) int array
            Element of each row.
        n_hosts : int
        vertices : (n_hosts, 8) int array, optional
        """
        n_params = functions.shape[1]
        rows = np.repeat(np.asarray(hosts), np.diff(functions.indptr))
        keys = np.unique(rows * n_params + functions.indices)
        host, column = np.divmod(keys, n_params)
        counts = np.bincount(host, minlength=n_hosts)
        first = np.concatenate([[0], np.cumsum(counts)[:-1]])
        params = np.zeros((n_hosts, int(counts.max(initial=1))), dtype=np.int64)
        params[host, np.arange(len(keys)) - first[host]] = column
        if vertices is None:
            vertices = np.zeros((n_hosts, 0), dtype=np.int64)
        return cls(params, counts, vertices)

    def places(self, n_params: int) -> sp.csc_matrix:
        """Return the place from 1 of the parameters of an element, (e, n_params)."""
        hosts, places = np.nonzero(self.valid)
        params = self.params[hosts, places]
        return sp.csc_matrix((places + 1, (hosts, params)), shape=(len(self.params), n_params))

    def corners(self, n_pressures: int) -> sp.csc_matrix:
        """Return which pressures the elements touch, (e, n_pressures)."""
        hosts = np.repeat(np.arange(len(self.vertices)), self.vertices.shape[1])
        ones = np.ones(len(hosts), dtype=np.int64)
        shape = len(self.vertices), n_pressures
        return sp.csc_matrix((ones, (hosts, self.vertices.ravel())), shape=shape)

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Which places of ``params`` are not padding, (e, m)."""
        return np.arange(self.params.shape[1]) < self.counts[:, None]

    def dense(self, functions: sp.csr_matrix, hosts: IntArray) -> Array:
        """Return rows of a sparse operator on the functions of their host, (n, m)."""
        n_params = functions.shape[1]
        valid = self.valid
        keys = (np.arange(len(self.params))[:, None] * n_params + self.params)[valid]
        places = np.broadcast_to(np.arange(valid.shape[1]), valid.shape)[valid]
        rows = np.repeat(np.arange(functions.shape[0]), np.diff(functions.indptr))
        found = np.searchsorted(keys, np.asarray(hosts)[rows] * n_params + functions.indices)
        out = np.zeros((functions.shape[0], self.params.shape[1]))
        np.add.at(out, (rows, places[found]), functions.data)
        return out


class ElementArrays:
    """Residual and tangent blocks of the elements of one pattern.

    Attributes
    ----------
    residual : (e, m, 3) array
    tangent : (e, 6, m, m) array
    coupling : (e, 3, m, v) array
    pressure_residual : (e, v) array
        ``v`` is 8, or 0 in groups without pressures.
    stiff : (e,) bool array
        Which elements have a tangent; what stands there of the others means nothing.
    acts : bool
        Whether there is any residual.
    """

    def __init__(self, pattern: Pattern) -> None:
        e, m = pattern.params.shape
        v = pattern.vertices.shape[1]
        self.pattern = pattern
        self.residual = np.zeros((e, m, 3))
        self.pressure_residual = np.zeros((e, v))
        self.tangent = np.zeros((e, len(PAIRS), m, m))
        self.coupling = np.zeros((e, 3, m, v))
        self.stiff = np.ones(e, dtype=bool)
        self.acts = True
        self._rows = (pattern.params[:, :, None] * 3 + np.arange(3)).ravel()

    def summed(self, forces: Array, size: int) -> Array:
        """Return the sum of forces (e, m, 3) for every component of the parameters, (size,)."""
        return np.asarray(np.bincount(self._rows, forces.ravel(), minlength=size), float)


class Assembly:
    """Element arrays of all patterns, and their sum over the free unknowns.

    The unknowns are the free components of the displacement parameters followed by the
    pressures. A pressure all of whose elements are fixed is left out.

    Parameters
    ----------
    patterns : sequence of Pattern
    fixed : (n_params, 3) bool array
    n_pressures : int

    Attributes
    ----------
    equations : (n_params, 3) int array
        Number of each free unknown, -1 where it is fixed.
    pressure_equations : (n_pressures,) int array
    n_displacements, n_pressures, n : int
        Number of free displacement unknowns, of free pressures, of all.
    """

    def __init__(
        self, patterns: Sequence[Pattern], fixed: NDArray[np.bool_], n_pressures: int
    ) -> None:
        touched = np.zeros(len(fixed), dtype=bool)
        for pattern in patterns:
            touched[pattern.params[pattern.valid]] = True
        free = ~fixed & touched[:, None]
        self.equations = np.full(free.shape, -1)
        self.equations[free] = np.arange(free.sum())
        self.n_displacements = int(free.sum())
        active = np.zeros(n_pressures, dtype=bool)
        for pattern in patterns:
            moving = ((self.equations[pattern.params] >= 0).any(axis=2) & pattern.valid).any(axis=1)
            active[pattern.vertices[moving]] = True
        self.pressure_equations = np.full(n_pressures, -1)
        self.pressure_equations[active] = self.n_displacements + np.arange(active.sum())
        self.n_pressures = int(active.sum())
        self.n = self.n_displacements + self.n_pressures

        self.groups = [ElementArrays(pattern) for pattern in patterns]
        self._places = [pattern.places(len(fixed)) for pattern in patterns]
        corners = [pattern.corners(n_pressures) for pattern in patterns]
        self._list_entries(sp.vstack(self._places), sp.vstack(corners))

    def _list_entries(self, touched: sp.csc_matrix, corners: sp.csc_matrix) -> None:
        """List the columns of every row; the diagonals are there even without a value."""
        shared = sp.triu(touched.T @ sp.hstack([touched, corners]), format="csr")
        equations = np.full((shared.shape[1], 3), -1, dtype=np.int32)
        equations[: len(self.equations)] = self.equations
        equations[len(self.equations) :, 0] = self.pressure_equations
        near = shared[np.argwhere(self.equations >= 0)[:, 0]]
        columns = equations.take(near.indices, axis=0)
        row = np.repeat(np.arange(near.shape[0], dtype=np.int32), np.diff(near.indptr))
        upper = columns >= row[:, None]
        pressures = np.arange(self.n_displacements, self.n, dtype=np.int32)
        lengths = [
            np.add.reduceat(upper.ravel(), 3 * near.indptr[:-1], dtype=np.int64),
            np.ones(self.n_pressures),
        ]
        self._indices = np.concatenate([columns[upper], pressures])
        self._indptr = np.cumsum(np.concatenate([[0], *lengths])).astype(np.int32)

    @property
    def traffic(self) -> tuple[int, int]:
        """Values of element tangents that go into the matrix, and entries that it has."""
        read = 0
        for group in self.groups:
            pattern = group.pattern
            free = (self.equations[pattern.params] >= 0) & pattern.valid[:, :, None]
            n = free.sum(axis=(1, 2))
            pressures = (self.pressure_equations[pattern.vertices] >= 0).sum(axis=1)
            read += int((n * (n + 1) // 2 + n * pressures)[group.stiff].sum())
        return read, len(self._indices)

    def clear(self, tangents: bool) -> None:
        """Empty the element arrays but the first pattern's, which `kernels.bulk` fills.

        Parameters
        ----------
        tangents : bool
            Whether tangents too.
        """
        for group in self.groups[1:]:
            if group.acts:
                group.residual[:] = 0.0
            group.acts = False
            if tangents:
                group.stiff[:] = False

    def forces(self) -> Array:
        """Return the residual of every parameter, fixed ones included, (n_params, 3)."""
        out = np.zeros(self.equations.size)
        for group in self.groups:
            if group.acts:
                out += group.summed(group.residual, len(out))
        return out.reshape(-1, 3)

    def residual(self) -> Array:
        """Return the residual of the free unknowns, (n,)."""
        out = np.zeros(self.n)
        free = self.equations >= 0
        out[self.equations[free]] = self.forces()[free]
        for group in self.groups:
            equations = self.pressure_equations[group.pattern.vertices]
            keep = equations >= 0
            out += np.bincount(equations[keep], group.pressure_residual[keep], minlength=self.n)
        return out

    @property
    def structure(self) -> sp.csr_matrix:
        """A matrix like the tangent, with ones but for the diagonal of the pressures."""
        data = np.ones(len(self._indices), dtype=np.float32)
        data[self._indptr[self.n_displacements : -1]] = 0.0
        return sp.csr_matrix((data, self._indices, self._indptr), shape=(self.n, self.n))

    def matrix(self, extra: Array | None = None) -> sp.csr_matrix:
        """Return the upper triangle of the tangent of the free unknowns.

        Parameters
        ----------
        extra : (n_displacements,) array, optional
            Added to the diagonal of the displacements.
        """
        data = np.zeros(len(self._indices))
        for group, places in zip(self.groups, self._places, strict=True):
            kernels.gather(
                group.tangent,
                group.coupling,
                group.stiff,
                group.pattern.params,
                group.pattern.counts,
                group.pattern.vertices,
                places.indptr,
                places.indices,
                places.data,
                self.equations,
                self.pressure_equations,
                self._indptr,
                self._indices,
                data,
            )
        if extra is not None:
            data[self._indptr[: len(extra)]] += extra
        return sp.csr_matrix((data, self._indices, self._indptr), shape=(self.n, self.n))

    def multiply(self, direction: Array) -> Array:
        """Return the tangent of the free unknowns times a change of all parameters.

        Parameters
        ----------
        direction : (n_params, 3) array
            Change of the parameters, fixed ones included.

        Returns
        -------
        (n,) array
        """
        forces = np.zeros(direction.size)
        out = np.zeros(self.n)
        for group in self.groups:
            pattern = group.pattern
            d = direction[pattern.params] * (pattern.valid & group.stiff[:, None])[:, :, None]
            force = np.zeros_like(d)
            for pair, (i, j) in enumerate(PAIRS):
                block = group.tangent[:, pair]
                force[:, :, i] += np.einsum("eab,eb->ea", block, d[:, :, j])
                if i != j:
                    force[:, :, j] += np.einsum("eab,ea->eb", block, d[:, :, i])
            forces += group.summed(force, len(forces))
            equations = self.pressure_equations[pattern.vertices]
            keep = equations >= 0
            rate = np.einsum("eias,eai->es", group.coupling, d)
            out += np.bincount(equations[keep], rate[keep], minlength=self.n)
        free = self.equations >= 0
        out[self.equations[free]] += forces.reshape(-1, 3)[free]
        return out
