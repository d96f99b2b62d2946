"""Direct solution of the symmetric indefinite systems."""

from __future__ import annotations

import warnings
import weakref
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from ..errors import SolveError
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

    The analysis is made once for a sparsity structure and reused.
    """

    negative_pivots: int | None

    def __init__(self) -> None:
        from pypardiso import PyPardisoSolver

        self._pardiso = PyPardisoSolver(mtype=-2)
        for index, value in {
            1: 1,  # the settings below, not the defaults
            2: 2,  # nested dissection
            8: 0,  # iterative refinement only where pivots had to be perturbed
            10: 8,  # pivots are perturbed below 1e-8
            # Scaling and matching: without them the zero diagonal of the pressures makes
            # hundreds of perturbed pivots, a worse solution and twice the time.
            11: 1,
            13: 1,
            21: 1,  # Bunch-Kaufman pivots
        }.items():
            self._pardiso.set_iparm(index, value)
        self._structure: tuple[Any, Any] | None = None
        self._matrix: sp.csr_matrix | None = None
        self._finalizer: weakref.finalize[..., Pardiso] | None = None
        self.negative_pivots = None

    def _call(self, phase: int, matrix: sp.csr_matrix, right: Array) -> Array:
        from pypardiso.pardiso_wrapper import PyPardisoError

        self._pardiso.set_phase(phase)
        try:
            return np.asarray(self._pardiso._call_pardiso(matrix, right))
        except PyPardisoError as error:
            raise SolveError(f"linear solver: PARDISO phase {phase} failed; {error}") from None

    def factorise(self, upper: sp.csr_matrix) -> None:
        """Factorise a symmetric matrix from its upper triangle (with a full diagonal)."""
        nothing = np.zeros((upper.shape[0], 1), order="F")
        structure = (upper.indptr, upper.indices)
        known = self._structure is not None and all(
            a is b for a, b in zip(structure, self._structure, strict=True)
        )
        if not known:
            self.release()
            self._call(11, upper, nothing)
            self._structure = structure
            # MKL's memory is not Python's to collect.
            self._finalizer = weakref.finalize(self, self._pardiso.free_memory, everything=True)
        self._call(22, upper, nothing)
        self._matrix = upper
        self.negative_pivots = int(self._pardiso.get_iparm(23))

    def solve(self, right: Array) -> Array:
        """Solve for one (n,) or several (n, k) right-hand sides."""
        if self._matrix is None:
            raise SolveError("linear solver: no matrix has been factorised")
        return self._call(33, self._matrix, np.asfortranarray(right))

    def release(self) -> None:
        """Free the memory of the factorisation."""
        if self._finalizer is not None:
            self._finalizer()
        self._finalizer = None
        self._structure = None
        self._matrix = None


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


def best_solver() -> LinearSolver:
    """Return PARDISO, or where MKL cannot be loaded SciPy's solver with a warning."""
    try:
        return Pardiso()
    except (ImportError, OSError) as error:
        warnings.warn(
            f"MKL PARDISO cannot be loaded ({error}); SciPy's solver takes about twenty times "
            "as long",
            RuntimeWarning,
            stacklevel=2,
        )
        return SuperLU()
