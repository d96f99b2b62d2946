"""Gauss rules, and quadratures as sets of weighted points in host elements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from ..errors import InputError
from .basis import Array, IntArray

_legendre = cache(np.polynomial.legendre.leggauss)


def gauss(dim: int, n: int) -> tuple[Array, Array]:
    """Return the tensor Gauss-Legendre rule with ``n`` points a direction on [0, 1]^dim.

    Returns
    -------
    xi : (n**dim, dim) array
        Points; the first coordinate runs fastest.
    weights : (n**dim,) array
        Weights, which sum to 1.

    Raises
    ------
    InputError
        There is no point or no direction.
    """
    if dim < 1 or n < 1:
        raise InputError(f"rule: {n} points a direction in {dim}; give at least one of each")
    nodes, weights = _legendre(n)
    return _tensor([nodes] * dim, [weights] * dim)


def trapezoidal(counts: Sequence[int]) -> tuple[Array, Array]:
    """Return the tensor trapezoidal rule with so many points along each direction of [0, 1]^dim.

    They are evenly spread and reach the borders.

    Returns
    -------
    xi : (n, dim) array
        Points; the first coordinate runs fastest.
    weights : (n,) array
        Weights, which sum to 1.

    Raises
    ------
    InputError
        There are fewer than two points along a direction, or no direction.
    """
    if not counts or min(counts) < 2:
        raise InputError(f"rule: {tuple(counts)} points; give two along each direction at least")
    weights = [np.full(n, 2.0 / (n - 1)) for n in counts]
    for along in weights:
        along[[0, -1]] *= 0.5
    return _tensor([np.linspace(-1.0, 1.0, n) for n in counts], weights)


def _tensor(nodes: Sequence[Array], weights: Sequence[Array]) -> tuple[Array, Array]:
    """Return the tensor rule on [0, 1]^dim of a rule on [-1, 1] along each direction."""
    grids = np.meshgrid(*(0.5 * (along + 1.0) for along in reversed(nodes)), indexing="ij")
    factors = np.meshgrid(*(0.5 * along for along in reversed(weights)), indexing="ij")
    xi = np.stack([g.ravel() for g in reversed(grids)], axis=1)
    return xi, np.prod([f.ravel() for f in factors], axis=0)


@dataclass(frozen=True, eq=False)
class Quadrature:
    """Points with weights in the elements of a mesh.

    Attributes
    ----------
    elements : (q,) int array
        Host element of each point.
    xi : (q, dim) array
        Local coordinates in the host element.
    weights : (q,) array
        Physical weights in mm^dim; negative where a volume is inside out.
    """

    elements: IntArray
    xi: Array
    weights: Array

    @property
    def size(self) -> int:
        """Number of points."""
        return len(self.weights)
