"""The same head on a finer mesh, to learn how much the mesh decides."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..hermite import HermiteMesh, Side, gauss
from ..hermite.basis import Array
from .embed import insertions, origins
from .head import Attachment, Head
from .muscle import Muscle

__all__ = ["at_gauss", "at_points", "child_points", "parent_points", "refined"]

IntArray = NDArray[np.int64]
Builder = Callable[[HermiteMesh, Mapping[str, Muscle], int], dict[str, Attachment]]


def refined(head: Head, counts: Sequence[int]) -> Head:
    """Return a half head whose tissue elements are split into equal parts.

    The refinement is exact, so the head at rest has the same shape. Muscles, deep structures,
    attachments and landmarks stay where they are; they get the children they lie in. What pulls or
    holds the tissue at points does so at that many more, or a finer mesh would give way between
    them; the ends of muscles are bound anew for that, as `modiolus.face.embed` does. What the
    tissue is made of is interpolated from the Gauss points of the given head: the same material
    on a finer mesh.

    Parameters
    ----------
    head : Head
        A half.
    counts : sequence of 3 int
        Parts of every element in each direction.

    Raises
    ------
    InputError
        The head has both sides or has been refined, or a count is not a whole number from 1 up.
    """
    given = tuple(counts)
    counts = tuple(int(n) for n in given)
    if len(counts) != 3 or min(counts) < 1 or counts != given:
        raise InputError(f"counts: {given} are not three whole numbers from 1 up; mend them")
    if head.half is not None:
        raise InputError(f"{head.name}: it has both sides; refine its half")
    # The points of its sheets are those of no rule any more.
    if head.fineness > 1:
        raise InputError(f"{head.name}: it has been refined; refine the head that it was made of")

    fineness = max(counts[:2])

    def moved(items: dict[str, Attachment], anew: Builder | None = None) -> dict[str, Attachment]:
        out = {name: _spread(item, counts) for name, item in items.items()}
        if anew is not None and fineness > 1:
            made = anew(head.tissue, head.muscles, fineness)
            for name, item in ((name, made[name]) for name in items if name in made):
                held = items[name].stiffness.sum() / item.stiffness.sum()
                out[name] = replace(item, stiffness=held * item.stiffness)
        return {
            name: Attachment(name, *child_points(item.elements, item.xi, counts), item.stiffness)
            for name, item in out.items()
        }

    landmarks: dict[str, tuple[int, tuple[float, float, float]]] = {}
    for name, (element, xi) in head.landmarks.items():
        child, inside = child_points([element], [xi], counts)
        a, b, c = map(float, inside[0])
        landmarks[name] = (int(child[0]), (a, b, c))
    tissue = head.tissue.refine(counts)
    children, points, _ = tissue.gauss_points(4)
    parent, inside = parent_points(children, points, counts)
    return replace(
        head,
        tissue=tissue,
        sides={name: _side(side, counts) for name, side in head.sides.items()},
        landmarks=landmarks,
        fraction=at_points(head.fraction, parent, inside).reshape(tissue.n_elements, -1),
        firmness=at_points(head.firmness, parent, inside).reshape(tissue.n_elements, -1),
        attachments=moved(head.attachments, origins),
        insertions=moved(head.insertions, insertions),
        sheets=moved(head.sheets),
        fineness=fineness,
    )


def _spread(item: Attachment, counts: Sequence[int]) -> Attachment:
    """Share the points of a Gauss rule along the layer among equal parts of their cells.

    Points that are of no such rule stay as they are.
    """
    parts = tuple(counts[:2])
    if parts == (1, 1):
        return item
    for order in range(1, 5):
        ticks, widths = (values.ravel() for values in gauss(1, order))
        place = np.abs(item.xi[:, :2, None] - ticks).argmin(axis=2)
        if not np.allclose(ticks[place], item.xi[:, :2], atol=1e-9):
            continue
        steps = [(np.arange(n) + 0.5) / n for n in parts]
        within = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
        xi = np.repeat(item.xi, len(within), axis=0)
        starts = np.cumsum(widths) - widths
        cells = starts[place][:, None] + widths[place][:, None] * within
        xi[:, :2] = cells.reshape(-1, 2)
        share = np.repeat(item.stiffness / len(within), len(within))
        return Attachment(item.name, np.repeat(item.elements, len(within)), xi, share)
    return item


def child_points(
    elements: ArrayLike, xi: ArrayLike, counts: Sequence[int]
) -> tuple[IntArray, Array]:
    """Return the children that hold points of elements, (n,), and where in them, (n, 3)."""
    parts = np.array(counts)
    scaled = np.asarray(xi, dtype=float) * parts
    place = np.clip(np.floor(scaled + 1e-12).astype(np.int64), 0, parts - 1)
    # The first direction runs fastest, as in `HermiteMesh.refine`.
    number = place @ np.array([1, parts[0], parts[0] * parts[1]])
    children = np.asarray(elements, dtype=np.int64) * parts.prod() + number
    return children, np.clip(scaled - place, 0.0, 1.0)


def parent_points(
    elements: ArrayLike, xi: ArrayLike, counts: Sequence[int]
) -> tuple[IntArray, Array]:
    """Return the elements (n,) that were split into the given ones, and where in them, (n, 3)."""
    parts = np.array(counts)
    parent, number = np.divmod(np.asarray(elements, dtype=np.int64), parts.prod())
    place = np.stack(np.unravel_index(number, parts, order="F"), axis=1)
    return parent, (place + np.asarray(xi, dtype=float)) / parts


def at_gauss(values: Array, order: int) -> Array:
    """Return values at the 4 x 4 x 4 Gauss points, (n, 64), at those of another order, (n, q)."""
    if order**3 == values.shape[1]:
        return values
    xi = gauss(3, order)[0]
    elements = np.repeat(np.arange(len(values)), len(xi))
    return at_points(values, elements, np.tile(xi, (len(values), 1))).reshape(len(values), -1)


def at_points(values: Array, elements: IntArray, xi: Array) -> Array:
    """Interpolate values at the 4 x 4 x 4 Gauss points of elements, (n_elements, 64), linearly.

    Beyond the outermost Gauss points the value is that of the nearest one.

    Parameters
    ----------
    values : (n_elements, 64) array
    elements, xi : (n,), (n, 3) arrays
        Where they are wanted.

    Returns
    -------
    (n,) array
    """
    ticks = gauss(1, 4)[0][:, 0]
    shares = [np.stack([np.interp(x, ticks, row) for row in np.eye(4)], axis=1) for x in xi.T]
    cubes = values.reshape(-1, 4, 4, 4)[elements]
    # The first direction runs fastest.
    return np.asarray(np.einsum("nkji,ni,nj,nk->n", cubes, *shares))


def _side(side: Side, counts: Sequence[int]) -> Side:
    """Return the children along a side of some elements."""
    elements, axis, end = side
    cells = np.stack(np.unravel_index(np.arange(np.prod(counts)), counts, order="F"), axis=1)
    along = np.flatnonzero(cells[:, axis] == end * (counts[axis] - 1))
    return (elements[:, None] * int(np.prod(counts)) + along).ravel(), axis, end
