"""Cubic Hermite basis functions on the unit interval, square and cube.

The local functions of an element of dimension ``d`` are numbered
``corner * 2**d + derivative``. Bit ``k`` of ``corner`` is the side (0 or 1) in
direction ``xi_k``; bit ``k`` of ``derivative`` says whether the function carries
the derivative in that direction. For ``d = 3`` a corner thus has the order value,
d1, d2, d12, d3, d13, d23, d123.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from .check import numbers

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Power-basis coefficients ``[side, derivative, power]`` of the four functions.
COEFFICIENTS: Array = np.array(
    [
        [[1.0, 0.0, -3.0, 2.0], [0.0, 1.0, -2.0, 1.0]],
        [[0.0, 0.0, 3.0, -2.0], [0.0, 0.0, -1.0, 1.0]],
    ]
)


def basis_1d(xi: ArrayLike, derivative: int = 0) -> Array:
    """Evaluate the four cubic Hermite functions of one variable.

    Parameters
    ----------
    xi : (n,) array
        Local coordinates in [0, 1].
    derivative : int
        Order of differentiation.

    Returns
    -------
    (n, 2, 2) array
        ``[point, side, derivative]``.
    """
    return np.asarray(polynomial.polyval(np.asarray(xi, dtype=float), _derived(derivative)).T)


@cache
def _derived(derivative: int) -> Array:
    """Return `COEFFICIENTS` of a derivative, by ascending power."""
    return np.asarray(polynomial.polyder(COEFFICIENTS.T, derivative))


def smooth_step(values: ArrayLike) -> Array:
    """Return 0 below 0, 1 above 1, and between them the Hermite function of the value at 1."""
    share = np.clip(values, 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))


def basis(dim: int, xi: ArrayLike, derivative: Sequence[int] | None = None) -> Array:
    """Evaluate all ``4**dim`` local functions, or a derivative of them.

    Parameters
    ----------
    dim : {1, 2, 3}
        Dimension of the element.
    xi : (n, dim) array
        Local coordinates.
    derivative : sequence of ``dim`` int, optional
        Order of differentiation in each direction; values by default.

    Returns
    -------
    (n, 4**dim) array

    Raises
    ------
    InputError
        An argument has another shape, or a coordinate is not finite.
    """
    if dim not in (1, 2, 3):
        raise InputError(f"dim: {dim} is not 1, 2 or 3; elements have one of these")
    xi = numbers("xi", xi, None, dim)
    orders = (0,) * dim if derivative is None else tuple(derivative)
    if len(orders) != dim or min(orders) < 0:
        raise InputError(
            f"derivative: {orders} does not fit; give an order for each of {dim} directions"
        )
    out = basis_1d(xi[:, 0], orders[0])
    for k in range(1, dim):
        factor = basis_1d(xi[:, k], orders[k])
        n, sides, kinds = out.shape
        out = (factor[:, :, None, :, None] * out[:, None, :, None, :]).reshape(
            n, 2 * sides, 2 * kinds
        )
    return out.reshape(len(xi), 4**dim)
