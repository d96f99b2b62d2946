"""Exact refinement: children reproduce the field of their parent to round-off."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..errors import InputError
from .basis import Array, basis

if TYPE_CHECKING:
    from .mesh import HermiteMesh

#: Entries of an operator's rows are compared after rounding to this many decimals.
DECIMALS = 9


def group_rows(
    matrix: sp.csr_matrix, *, scaled: bool
) -> tuple[NDArray[np.int64], Array, NDArray[np.int64]]:
    """Group equal rows of a sparse matrix.

    Parameters
    ----------
    matrix : CSR matrix (m, n)
    scaled : bool
        Whether rows that differ by a factor belong together.

    Returns
    -------
    index : (m,) int array
        Group of each row; -1 for zero rows.
    factor : (m,) array
        Row = factor * first row of its group.
    first : (n_groups,) int array
        The row that founded each group.
    """
    matrix = sp.csr_matrix(matrix)
    matrix.sum_duplicates()
    index = np.full(matrix.shape[0], -1, dtype=np.int64)
    factor = np.zeros(matrix.shape[0])
    leading: list[float] = []
    first: list[int] = []
    known: dict[bytes, int] = {}
    for row in range(matrix.shape[0]):
        span = slice(matrix.indptr[row], matrix.indptr[row + 1])
        data, columns = matrix.data[span], matrix.indices[span]
        keep = np.abs(data) > 1e-12
        data, columns = data[keep], columns[keep]
        if not len(data):
            continue
        lead = data[np.argmax(np.abs(data) > 0.999 * np.abs(data).max())] if scaled else 1.0
        key = columns.tobytes() + (np.round(data / lead, DECIMALS) + 0.0).tobytes()
        group = known.setdefault(key, len(first))
        if group == len(first):
            first.append(row)
            leading.append(lead)
        index[row], factor[row] = group, lead / leading[group]
    return index, factor, np.array(first, dtype=np.int64)


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
    values = np.arange(rows.shape[0]) // kinds * kinds
    node, _, _ = group_rows(rows[np.unique(values)], scaled=False)
    index, factor, first = _group_at_nodes(rows, np.repeat(node, kinds))
    used = index >= 0
    extraction = sp.csr_matrix(
        (factor[used], (np.flatnonzero(used), index[used])), shape=(len(index), len(first))
    )
    parameters = np.asarray(rows[first] @ mesh.parameters)
    return HermiteMesh(dim, parameters, extraction)


def _group_at_nodes(
    rows: sp.csr_matrix, node: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Array, NDArray[np.int64]]:
    """Group rows up to a factor, but only within the same node."""
    # Rows are grouped by functional first, then each group is split by node.
    index, factor, _ = group_rows(rows, scaled=True)
    used = index >= 0
    pairs = np.stack([index, node], axis=1)
    unique, first_of, inverse = np.unique(
        pairs[used], axis=0, return_index=True, return_inverse=True
    )
    origin = np.flatnonzero(used)[first_of]
    order = np.argsort(origin, kind="stable")
    rank = np.empty(len(unique), dtype=np.int64)
    rank[order] = np.arange(len(unique))
    out = np.full(len(index), -1, dtype=np.int64)
    out[used] = rank[inverse.ravel()]
    first = origin[order]
    scale = np.zeros(len(index))
    scale[used] = factor[used] / factor[first[out[used]]]
    return out, scale, first
