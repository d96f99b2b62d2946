"""Meshes that the cases share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ..hermite import HermiteMesh, bricks
from ..hermite.basis import IntArray


def box(size: Sequence[float], counts: Sequence[int]) -> HermiteMesh:
    """Return a box of equal elements with a corner at the origin."""
    return bricks([np.linspace(0.0, s, n + 1) for s, n in zip(size, counts, strict=True)])


def side(mesh: HermiteMesh, axis: int, place: float) -> IntArray:
    """Return the elements of a box one face of which lies at a place along an axis."""
    corners = mesh.extraction[::8] @ mesh.parameters
    near = np.abs(corners.reshape(mesh.n_elements, 8, 3)[:, :, axis] - place) < 1e-9
    return np.flatnonzero(near.sum(axis=1) == 4)


def scaled(mesh: HermiteMesh, factors: ArrayLike) -> HermiteMesh:
    """Return the same field with its parameters (n_params,) divided by scale factors."""
    factors = np.asarray(factors, dtype=float)
    return HermiteMesh(
        mesh.dim,
        mesh.parameters / factors[:, None],
        sp.csr_matrix(mesh.extraction @ sp.diags_array(factors)),
    )
