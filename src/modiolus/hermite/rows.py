"""Rows of an operator that are one and the same functional of the parameters."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from .basis import Array, IntArray

#: Entries up to this are none.
_NOTHING = 1e-12
#: Greatest difference between the products of equal rows with a random vector.
_EQUAL = 1e-10


def same_rows(
    matrix: sp.csr_matrix, *, scaled: bool = False, apart: IntArray | None = None
) -> tuple[IntArray, Array, IntArray]:
    """Tell the different rows of a sparse matrix apart.

    They are known by their products with random vectors, which agree to round-off for equal rows
    and otherwise practically never.

    Parameters
    ----------
    matrix : CSR matrix (m, n)
    scaled : bool
        Whether rows that differ by a factor are the same.
    apart : (m,) int array, optional
        Rows with different numbers are never the same.

    Returns
    -------
    index : (m,) int array
        Number of each row, by first appearance; -1 for rows of zeros.
    factor : (m,) array
        Row = factor * first row of its number.
    first : (n_rows,) int array
        The first row of each number.
    """
    rows = sp.csr_matrix(matrix, copy=True)
    rows.sum_duplicates()
    rows.data[np.abs(rows.data) <= _NOTHING] = 0.0
    rows.eliminate_zeros()
    keys = np.asarray(rows @ np.random.default_rng(0).standard_normal((rows.shape[1], 3)))
    filled = np.flatnonzero(np.diff(rows.indptr))
    index = np.full(rows.shape[0], -1, dtype=np.int64)
    factor = np.where(np.diff(rows.indptr) > 0, 1.0, 0.0)
    if not len(filled):
        return index, factor, filled
    keys = keys[filled]
    if scaled:
        norms = np.sqrt(np.asarray(rows.multiply(rows).sum(axis=1)).ravel())[filled]
        keys = keys[:, 1:] / (np.sign(keys[:, 0]) * norms)[:, None]
    groups = np.zeros(len(filled), dtype=np.int64) if apart is None else apart[filled]

    order = np.lexsort((keys[:, 0], groups))
    steps = (np.abs(np.diff(keys[order], axis=0)) > _EQUAL).any(axis=1)
    steps |= np.diff(groups[order]) != 0
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.concatenate([[0], np.cumsum(steps)])
    # Number by first appearance, so that neighbours in space are neighbours in memory.
    _, first, number = np.unique(number, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    index[filled] = rank[number.ravel()]
    first = filled[np.sort(first)]
    if scaled:
        founders = rows[first]
        # The entry by which rows of a number are compared: the greatest of the first one.
        owner = np.repeat(np.arange(len(first)), np.diff(founders.indptr))
        greatest = np.lexsort((-np.abs(founders.data), owner))[founders.indptr[:-1]]
        lead = (greatest - founders.indptr[:-1])[index[filled]]
        factor[filled] = rows.data[rows.indptr[filled] + lead]
        factor[filled] /= founders.data[greatest][index[filled]]
    return index, factor, first
