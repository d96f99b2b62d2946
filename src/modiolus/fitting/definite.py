"""Direct solution of the symmetric positive definite systems of a fit."""

from __future__ import annotations

import contextlib
import weakref
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from ..hermite.basis import Array
from ..mkl import pardiso


class Definite:
    """Solves symmetric positive definite systems: MKL PARDISO (matrix type 2), or SciPy.

    PARDISO's ordering takes twice as long as a factorisation. It is kept for the next matrix, when
    that has the same structure. SciPy's takes three to six times as long; it is there where MKL
    is not, and for what turns out not to be definite.
    """

    def __init__(self) -> None:
        self._structure: tuple[NDArray[np.int32], NDArray[np.int32]] | None = None
        self._pardiso: Any = None
        with contextlib.suppress(ImportError, OSError):
            self._pardiso = pardiso(2)
            # MKL's memory is not Python's to collect.
            weakref.finalize(self, self._pardiso.free_memory, everything=True)

    def solve(self, matrix: sp.csr_matrix, right: Array) -> Array:
        """Solve for one right-hand side, (n,).

        Raises
        ------
        RuntimeError
            The matrix is singular.
        """
        # PARDISO does not survive rows that are empty.
        if self._pardiso is not None and (matrix.diagonal() > 0.0).all():
            from pypardiso.pardiso_wrapper import PyPardisoError

            try:
                return self._factorised(matrix, right)
            except PyPardisoError:
                self._structure = None
        # An ordering of A + A^T and no pivoting fill less.
        factors = splu(
            matrix.tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        return np.asarray(factors.solve(right))

    def _factorised(self, matrix: sp.csr_matrix, right: Array) -> Array:
        upper = sp.triu(matrix, format="csr")
        upper.sort_indices()
        known = self._structure is not None and all(
            np.array_equal(new, old)
            for new, old in zip((upper.indptr, upper.indices), self._structure, strict=True)
        )
        self._structure = upper.indptr, upper.indices
        # Phases 2 and 3 factorise and solve; phase 1 before them orders.
        self._pardiso.set_phase(23 if known else 13)
        return np.asarray(self._pardiso._call_pardiso(upper, right))
