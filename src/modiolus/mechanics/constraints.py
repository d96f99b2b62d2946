"""Which parameters a face holds: clamps and the mirror condition."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
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


def symmetry_plane(
    mesh: HermiteMesh, elements: ArrayLike, axis: int, side: int, component: int = 0
) -> BoolArray:
    """Return the mask that keeps a face in a mirror plane.

    Across the plane the normal component of the displacement is odd and the others are
    even: the normal component is fixed in the parameters of the face, the others in the
    parameters of the derivatives across it.

    Parameters
    ----------
    mesh, elements, axis, side
        As in `HermiteMesh.face`.
    component : int
        Coordinate normal to the plane.

    Returns
    -------
    (n_params, 3) bool array

    Raises
    ------
    InputError
        If a parameter governs both the face and the slope across it, or there is no such
        component.
    """
    if component not in (0, 1, 2):
        raise InputError(f"symmetry plane: component {component}; give 0, 1 or 2")
    within, across = mesh.face_parameters(elements, axis, side)
    if len(np.intersect1d(within, across)):
        raise InputError(
            "symmetry plane: the extraction mixes derivatives along and across the face; give "
            "its nodes directions in the plane and normal to it"
        )
    fixed = np.zeros((mesh.n_params, 3), dtype=bool)
    fixed[within, component] = True
    fixed[np.ix_(across, np.delete(np.arange(3), component))] = True
    return fixed
