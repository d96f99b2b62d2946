"""The direct solver of Intel's Math Kernel Library (MKL), where it is installed."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

__all__ = ["pardiso"]


def pardiso(kind: int) -> Any:
    """Return a binding of MKL PARDISO.

    Parameters
    ----------
    kind : int
        Type of the matrices: 2 for symmetric positive definite ones, -2 for indefinite ones.

    Raises
    ------
    ImportError, OSError
        It cannot be loaded here.
    """
    # Otherwise the binding asks the system's linker and searches the whole environment.
    for library in sorted(Path(sys.prefix).glob("lib/libmkl_rt*")):
        os.environ.setdefault("PYPARDISO_MKL_RT", str(library))
    from pypardiso import PyPardisoSolver

    return PyPardisoSolver(mtype=kind)
