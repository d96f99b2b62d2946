"""A half mesh and its mirror image: the condition in the mirror plane, and both as one mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from .basis import Array, IntArray
from .mesh import HermiteMesh


@dataclass(frozen=True, eq=False)
class MirroredMesh:
    """A volume mesh of both sides, made of one half.

    The image of element ``e`` of ``n`` is element ``e + n``. Its ``xi1`` runs the other way, so
    that its volume stays positive; that reversal, and the sign with which the two halves share
    the derivatives across the plane, are entries of the extraction operator.

    Attributes
    ----------
    plane : float
        x of the mirror plane in mm.
    mesh : HermiteMesh
        Both sides. Its first parameters are those of the half.
    image : CSR matrix (n_half, n_whole)
        ``image @ parameters`` are the parameters of the other side in the frame of that side.
    ones : (n_half,) array
        Parameters of the constant field 1.
    """

    plane: float
    mesh: HermiteMesh
    image: sp.csr_matrix
    ones: Array

    @classmethod
    def of(
        cls, half: HermiteMesh, elements: ArrayLike, axis: int, side: int, plane: float
    ) -> MirroredMesh:
        """Join a half with its mirror image.

        Parameters
        ----------
        half : HermiteMesh
            Of dimension 3.
        elements, axis, side
            The face in the plane, see `HermiteMesh.face`.
        plane : float
            x of the plane in mm.

        Raises
        ------
        InputError
            The axis is not 0, the face is not in the plane, or a parameter governs both the face
            and the slope across it.
        """
        within, across = half.face_parameters(elements, axis, side)
        if axis != 0 or len(np.intersect1d(within, across)):
            raise InputError(
                "midplane: not a face of constant xi1 with its own nodes; give such a one"
            )
        n = half.n_params
        apart = np.setdiff1d(np.arange(n), np.concatenate([within, across]))
        # The constant field tells which parameters are positions, whatever the extraction.
        rows = sp.csr_matrix(half.extraction)
        values = np.zeros(rows.shape[0])
        values[::8] = 1.0
        ones = np.round(sp.linalg.spsolve(sp.csc_matrix(rows.T @ rows), rows.T @ values), 12)
        if np.abs(rows @ ones - values).max() > 1e-9:
            raise InputError("extraction: it cannot hold a constant field; mend it")

        column = np.arange(n)
        column[apart] = n + np.arange(len(apart))
        sign = np.ones(n)
        # Across the plane the image's derivative is that of the half, turned round twice.
        sign[across] = -1.0
        image = sp.csr_matrix((sign, (np.arange(n), column)), shape=(n, n + len(apart)))
        corner, kind = np.divmod(np.arange(64), 8)
        reverse = sp.csr_matrix(
            (np.where(kind & 1, -1.0, 1.0), (np.arange(64), (corner ^ 1) * 8 + kind)),
            shape=(64, 64),
        )
        there = sp.kron(sp.identity(half.n_elements), reverse, format="csr") @ rows @ image
        here = sp.hstack([rows, sp.csr_matrix((rows.shape[0], len(apart)))], format="csr")
        extraction = sp.csr_matrix(sp.vstack([here, there]))
        extraction.sort_indices()
        joined = cls(plane, half, image, ones)
        mirrored = joined.reflect(half.parameters)
        gap = (image[:, :n] @ half.parameters - mirrored)[np.concatenate([within, across])]
        if np.abs(gap).max(initial=0.0) > 1e-9:
            raise InputError(
                f"midplane: the face is not in the mirror plane x = {plane:g} mm; move it"
            )
        parameters = np.vstack([half.parameters, mirrored[apart]])
        return cls(plane, HermiteMesh(3, parameters, extraction), image, ones)

    def reflect(self, parameters: Array) -> Array:
        """Return parameters (n_half, 3) of a half mirrored in the plane."""
        out = parameters * [-1.0, 1.0, 1.0]
        out[:, 0] += 2.0 * self.plane * self.ones
        return out

    def halves(self, parameters: Array) -> tuple[Array, Array]:
        """Return one side and the mirror image of the other, each (n_half, 3)."""
        n = len(self.ones)
        return parameters[:n], self.reflect(np.asarray(self.image @ parameters))

    def whole(self, half: Array) -> Array:
        """Return the parameters (n_whole, 3) of both sides from those of one, (n_half, 3)."""
        n = len(self.ones)
        apart = np.flatnonzero(self.image.indices >= n)
        return np.vstack([half, self.reflect(half)[apart]])

    def points(self, elements: ArrayLike, xi: ArrayLike) -> tuple[IntArray, Array]:
        """Return where the images of points of the half are: elements (n,) and xi (n, 3)."""
        there = np.array(xi, dtype=float)
        there[:, 0] = 1.0 - there[:, 0]
        return np.asarray(elements, dtype=np.int64) + self.mesh.n_elements // 2, there


def symmetry_plane(
    mesh: HermiteMesh, elements: ArrayLike, axis: int, side: int, component: int = 0
) -> NDArray[np.bool_]:
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
