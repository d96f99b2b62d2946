"""Exact refinement: children reproduce the field of their parent to round-off."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from ..errors import InputError
from .basis import Array, basis
from .rows import same_rows

if TYPE_CHECKING:
    from .mesh import HermiteMesh


def child_operator(dim: int, start: Array, size: Array) -> Array:
    """Return the (4**dim, 4**dim) map from a parent's to a child's local parameters.

    The child covers ``start + size * [0, 1]^dim`` of the parent.
    """
    operator = np.zeros((4**dim, 4**dim))
    for corner in range(2**dim):
        bits = np.array([(corner >> k) & 1 for k in range(dim)])
        for kind in range(2**dim):
            orders = [(kind >> k) & 1 for k in range(dim)]
            scale = np.prod(size ** np.array(orders))
            values = basis(dim, (start + size * bits)[None], orders)[0]
            operator[corner * 2**dim + kind] = scale * values
    return operator


def refine(mesh: HermiteMesh, counts: tuple[int, ...]) -> HermiteMesh:
    """Split every element into ``counts[k]`` parts in each direction.

    The rows of the children's operators over the parent's parameters tell which of
    them are one and the same functional up to a factor; those share a new parameter.
    That covers scale factors, versions, reversed and rotated directions alike.

    Parameters
    ----------
    mesh : HermiteMesh
    counts : (dim,) tuple of int

    Returns
    -------
    HermiteMesh
        Children of element ``e`` are numbered ``e * prod(counts) + i1 + counts[0] * (i2 + ...)``.

    Raises
    ------
    InputError
        The counts are not one for each direction, from 1 up.
    """
    from .mesh import HermiteMesh

    dim = mesh.dim
    if len(counts) != dim or min(counts) < 1:
        raise InputError(
            f"counts: {counts} does not fit; give a number from 1 for each of {dim} axes"
        )
    size = 1.0 / np.array(counts, dtype=float)
    children = [
        child_operator(dim, size * np.array(place[::-1]), size)
        for place in np.ndindex(*counts[::-1])
    ]
    stacked = sp.csr_matrix(np.vstack(children))
    rows = sp.kron(sp.identity(mesh.n_elements), stacked, format="csr") @ mesh.extraction
    rows = sp.csr_matrix(rows)
    rows.data[np.abs(rows.data) < 1e-13] = 0.0
    rows.eliminate_zeros()

    # A parameter belongs to a node, so the node's position functional is part of its identity.
    kinds = 2**dim
    node, _, _ = same_rows(rows[::kinds])
    index, factor, first = same_rows(rows, scaled=True, apart=np.repeat(node, kinds))
    used = index >= 0
    extraction = sp.csr_matrix(
        (factor[used], (np.flatnonzero(used), index[used])), shape=(len(index), len(first))
    )
    founders = rows[first]
    founders.sort_indices()
    return HermiteMesh(dim, np.asarray(founders @ mesh.parameters), extraction)
