"""Direct solution of the symmetric indefinite systems."""

from __future__ import annotations

import ctypes
import warnings
import weakref
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from ..errors import SolveError
from ..mkl import pardiso
from .laws import Array


class LinearSolver(Protocol):
    """A factorisation that is kept for further right-hand sides.

    Attributes
    ----------
    negative_pivots : int or None
        Number of negative pivots of the last factorisation, None when it is not known.
    """

    negative_pivots: int | None

    def factorise(self, upper: sp.csr_matrix) -> None:
        """Factorise a symmetric matrix from its upper triangle."""

    def solve(self, right: Array) -> Array:
        """Solve for one (n,) or several (n, k) right-hand sides."""


class Pardiso:
    """MKL PARDISO for symmetric indefinite matrices (matrix type -2).

    The analysis (ordering, scaling and matching) is made once for a sparsity structure and
    reused: it takes three times as long as a factorisation, and the matching found at rest
    serves every later state without perturbed pivots.

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
            2: 2,  # nested dissection
            8: 0,  # iterative refinement only where pivots had to be perturbed
            10: 8,  # pivots are perturbed below 1e-8
            # Scaling and matching: without them the zero diagonal of the pressures makes
            # hundreds of perturbed pivots, a worse solution and twice the time.
            11: 1,
            13: 1,
            18: -1,  # count the entries of the factor
            19: -1,  # and the operations
            # Pivots of one row: the matching has already put pressures beside displacements, and
            # Bunch-Kaufman pivots would take half as long again for the same accuracy.
            21: 0,
            28: int(single),
        }.items():
            self._pardiso.set_iparm(index, value)
        self._type = np.dtype(np.float32 if single else np.float64)
        self._structure: tuple[Any, Any] | None = None
        self._pointers: tuple[Any, Any] | None = None
        self._values: Array | None = None
        self._finalizer: weakref.finalize[..., Pardiso] | None = None
        self.negative_pivots = None

    def _call(self, phase: int, values: Array, right: Array) -> Array:
        """Run one phase; ``right`` is (n, k) in Fortran's order."""
        if self._pointers is None:
            raise SolveError("linear solver: no matrix has been factorised")
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

    def factorise(self, upper: sp.csr_matrix) -> None:
        """Factorise a symmetric matrix from its upper triangle (with a full diagonal)."""
        nothing = np.zeros((upper.shape[0], 1), dtype=self._type, order="F")
        values = np.ascontiguousarray(upper.data, dtype=self._type)
        if not self._knows(upper):
            self.release()
            self._structure = (upper.indptr, upper.indices)
            # PARDISO counts from 1.
            self._pointers = (
                upper.indptr.astype(np.int32) + 1,
                upper.indices.astype(np.int32) + 1,
            )
            self._call(11, values, nothing)
            # MKL's memory is not Python's to collect.
            self._finalizer = weakref.finalize(self, self._pardiso.free_memory, everything=True)
        self._values = values
        self._call(22, values, nothing)
        self.negative_pivots = int(self._pardiso.get_iparm(23))

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
