"""Which parameters a face holds: clamps."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..hermite import HermiteMesh

BoolArray = NDArray[np.bool_]


def clamp(
    mesh: HermiteMesh, elements: ArrayLike, axis: int, side: int, *, slope: bool = False
) -> BoolArray:
    """Return the mask that holds a face in place.

    Parameters
    ----------
    mesh, elements, axis, side
        As in `HermiteMesh.face`.
    slope : bool
        Whether the derivatives across the face are held as well.

    Returns
    -------
    (n_params, 3) bool array
        Fixed components; combine masks with ``|``.
    """
    within, across = mesh.face_parameters(elements, axis, side)
    fixed = np.zeros((mesh.n_params, 3), dtype=bool)
    fixed[within] = True
    if slope:
        fixed[across] = True
    return fixed
