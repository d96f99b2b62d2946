"""Direct solution of the symmetric indefinite systems."""

from __future__ import annotations

import ctypes
import warnings
import weakref
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from numpy.typing import NDArray

from ..errors import SolveError
from ..mkl import pardiso
from .laws import Array

IntArray = NDArray[np.int64]

#: Unknowns that are ordered as one at most: those of two parameters.
BLOCK = 6


class LinearSolver(Protocol):
    """A factorisation that is kept for further right-hand sides.

    Attributes
    ----------
    negative_pivots : int or None
        Number of negative pivots of the last factorisation, None when it is not known.
    """

    negative_pivots: int | None

    def expect(self, upper: sp.csr_matrix) -> None:
        """Prepare for matrices of a structure, beside what goes on meanwhile."""

    def factorise(self, upper: sp.csr_matrix) -> None:
        """Factorise a symmetric matrix from its upper triangle."""

    def solve(self, right: Array) -> Array:
        """Solve for one (n,) or several (n, k) right-hand sides."""


class Pardiso:
    """MKL PARDISO for symmetric indefinite matrices (matrix type -2).

    The analysis is made once for a sparsity structure and reused. Displacements are eliminated by
    minimum degree, and each pressure, whose diagonal is zero, after those on which it acts: then
    no pivot has to be perturbed. PARDISO's matching would see to that as well, but it takes longer
    than all the rest of the analysis, and the factor takes two fifths more operations.

    Factors are kept in single precision by default. They take 0.6 of the time and half the memory,
    and solutions are good to five digits, which Newton's method makes up for: its residuals are
    those of double precision.

    Parameters
    ----------
    single : bool
        Whether factors have single precision.
    """

    negative_pivots: int | None

    def __init__(self, single: bool = True) -> None:
        self._pardiso = pardiso(-2)
        for index, value in {
            1: 1,  # the settings below, not the defaults
            2: 0,  # minimum degree
            8: 0,  # iterative refinement only where pivots had to be perturbed
            10: 8,  # pivots are perturbed below 1e-8
            11: 0,  # no scaling
            13: 0,  # and no matching
            # Pivots of one row: Bunch-Kaufman pivots would take half as long again for the same
            # accuracy.
            21: 0,
            28: int(single),
        }.items():
            self._pardiso.set_iparm(index, value)
        self._type = np.dtype(np.float32 if single else np.float64)
        self._structure: tuple[Any, Any] | None = None
        self._pointers: tuple[Any, Any] | None = None
        self._values: Array | None = None
        self._finalizer: weakref.finalize[..., Pardiso] | None = None
        self._expected: Future[None] | None = None
        self.negative_pivots = None

    def _call(self, phase: int, values: Array, right: Array | None = None) -> Array:
        """Run one phase; ``right`` is (n, k) in Fortran's order."""
        if self._pointers is None:
            raise SolveError("linear solver: no matrix has been factorised")
        if right is None:
            right = np.zeros((len(self._pointers[0]) - 1, 1), dtype=self._type, order="F")
        solver, out, error = self._pardiso, np.zeros_like(right), ctypes.c_int32(0)
        indptr, indices = self._pointers
        index = ctypes.POINTER(ctypes.c_int32)
        real = ctypes.POINTER(ctypes.c_float if self._type == np.float32 else ctypes.c_double)

        def whole(value: int) -> Any:
            return ctypes.byref(ctypes.c_int32(value))

        solver._mkl_pardiso(
            solver.pt.ctypes.data_as(ctypes.POINTER(solver._pt_type[0])),
            whole(1),
            whole(1),
            whole(-2),
            whole(phase),
            whole(len(indptr) - 1),
            values.ctypes.data_as(real),
            indptr.ctypes.data_as(index),
            indices.ctypes.data_as(index),
            solver.perm.ctypes.data_as(index),
            whole(right.shape[1]),
            solver.iparm.ctypes.data_as(index),
            whole(0),
            right.ctypes.data_as(real),
            out.ctypes.data_as(real),
            ctypes.byref(error),
        )
        if error.value != 0:
            raise SolveError(f"linear solver: PARDISO phase {phase} failed; error {error.value}")
        return out

    @property
    def size(self) -> tuple[int, float]:
        """Entries of the last factor and the operations that it took in 1e9."""
        return int(self._pardiso.get_iparm(18)), self._pardiso.get_iparm(19) / 1e3

    def expect(self, upper: sp.csr_matrix) -> None:
        """Begin to analyse a matrix, of which only the structure and zeros on the diagonal count.

        Another thread does, and `factorise` waits for it.
        """
        if self._expected is None and not self._knows(upper):
            pool = ThreadPoolExecutor(1)
            self._expected = pool.submit(self._take, upper)
            pool.shutdown(wait=False)

    def _take(self, upper: sp.csr_matrix) -> None:
        """Analyse the structure of a matrix."""
        values = np.ascontiguousarray(upper.data, dtype=self._type)
        self._analyse(upper, values, self._order(upper))
        self._structure = (upper.indptr, upper.indices)

    def factorise(self, upper: sp.csr_matrix) -> None:
        """Factorise a symmetric matrix from its upper triangle (with a full diagonal)."""
        if self._expected is not None:
            self._expected.result()
            self._expected = None
        if not self._knows(upper):
            self._take(upper)
        values = np.ascontiguousarray(upper.data, dtype=self._type)
        self._values = values
        self._call(22, values)
        self.negative_pivots = int(self._pardiso.get_iparm(23))

    def _order(self, upper: sp.csr_matrix) -> IntArray:
        """Return the unknowns in the order in which they are eliminated.

        PARDISO finds the order of the displacements, of which one stands for every block.
        """
        moves = upper.diagonal() != 0.0
        first = moves & begins_block(upper)
        ones = np.ones(upper.nnz, dtype=self._type)
        rows = sp.csr_matrix((ones, upper.indices, upper.indptr), shape=upper.shape)[first]
        graph = rows[:, first]
        place = np.empty(graph.shape[0])
        place[self._analyse(graph, graph.data)] = np.arange(len(place))
        acting = rows[:, ~moves].tocoo()
        last = np.zeros(acting.shape[1])
        np.maximum.at(last, acting.col, place[acting.row])
        places = np.empty(len(moves))
        places[moves] = place[np.cumsum(first)[moves] - 1]
        places[~moves] = last + 0.5
        return np.argsort(places, kind="stable")

    def _analyse(
        self, upper: sp.csr_matrix, values: Array, order: IntArray | None = None
    ) -> IntArray:
        """Take another structure, and return the order in which unknowns are eliminated."""
        self.release()
        solver = self._pardiso
        # PARDISO counts from 1.
        self._pointers = upper.indptr.astype(np.int32) + 1, upper.indices.astype(np.int32) + 1
        solver.perm = np.zeros(upper.shape[0], dtype=np.int32)
        if order is not None:
            solver.perm += order + 1
        solver.set_iparm(5, 2 if order is None else 1)
        for count in (18, 19):  # entries of the factor, and operations
            solver.set_iparm(count, -1)
        self._call(11, values)
        # MKL's memory is not Python's to collect.
        self._finalizer = weakref.finalize(self, solver.free_memory, everything=True)
        return np.asarray(solver.perm - 1)

    def _knows(self, upper: sp.csr_matrix) -> bool:
        if self._structure is None:
            return False
        return all(
            a is b or np.shares_memory(a, b) or np.array_equal(a, b)
            for a, b in zip((upper.indptr, upper.indices), self._structure, strict=True)
        )

    def solve(self, right: Array) -> Array:
        """Solve for one (n,) or several (n, k) right-hand sides."""
        if self._values is None:
            raise SolveError("linear solver: no matrix has been factorised")
        columns = np.asfortranarray(right.reshape(len(right), -1), dtype=self._type)
        return self._call(33, self._values, columns).astype(float).reshape(right.shape)

    def release(self) -> None:
        """Free the memory of the factorisation."""
        if self._finalizer is not None:
            self._finalizer()
        self._finalizer = None
        self._structure = self._pointers = self._values = None


class SuperLU:
    """SciPy's sparse LU: works everywhere, about twenty times slower than PARDISO."""

    negative_pivots: int | None

    def __init__(self) -> None:
        self._factors: Any = None
        self.negative_pivots = None

    def expect(self, upper: sp.csr_matrix) -> None:
        """Prepare nothing."""

    def factorise(self, upper: sp.csr_matrix) -> None:
        """Factorise a symmetric matrix from its upper triangle."""
        full = upper + sp.triu(upper, 1).T
        try:
            self._factors = spla.splu(full.tocsc())
        except RuntimeError as error:
            raise SolveError(f"linear solver: {error}") from None

    def solve(self, right: Array) -> Array:
        """Solve for one (n,) or several (n, k) right-hand sides."""
        if self._factors is None:
            raise SolveError("linear solver: no matrix has been factorised")
        return np.asarray(self._factors.solve(right))


def begins_block(upper: sp.csr_matrix) -> NDArray[np.bool_]:
    """Tell which unknowns begin a block of up to `BLOCK` that are coupled to the same others."""
    index = np.arange(upper.shape[0])
    lengths = np.diff(upper.indptr)
    sums = np.add.reduceat(upper.indices, upper.indptr[:-1], dtype=np.int64)
    # Rows of a block differ by their diagonals; others are taken for such hardly ever, and that
    # would only make the factor greater.
    alike = (lengths[:-1] == lengths[1:] + 1) & (sums[:-1] == sums[1:] + index[:-1])
    start = np.maximum.accumulate(np.where(np.append(False, alike), 0, index))
    return np.asarray((index - start) % BLOCK == 0)


def symmetric_product(upper: sp.csr_matrix, columns: Array) -> Array:
    """Multiply a symmetric matrix, given by its upper triangle, by columns (n,) or (n, k)."""
    diagonal = upper.diagonal()
    return np.asarray(upper @ columns + upper.T @ columns - (diagonal * columns.T).T)


def best_solver(single: bool = True) -> LinearSolver:
    """Return PARDISO, or where MKL cannot be loaded SciPy's solver with a warning.

    Parameters
    ----------
    single : bool
        Whether factors may have single precision.
    """
    try:
        return Pardiso(single)
    except (ImportError, OSError) as error:
        warnings.warn(
            f"MKL PARDISO cannot be loaded ({error}); SciPy's solver takes about twenty times "
            "as long",
            RuntimeWarning,
            stacklevel=2,
        )
        return SuperLU()
