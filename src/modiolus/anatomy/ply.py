"""Polygon files (PLY), read with every count and every number checked.

VTK and libigl bring the process down on a file that is truncated or whose faces have corners that
there are not.
"""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

__all__ = ["read_ply"]

_KINDS = {"char": "i1", "short": "i2", "int": "i4", "float": "f4", "double": "f8"}
_KINDS |= {"uchar": "u1", "ushort": "u2", "uint": "u4", "float32": "f4", "float64": "f8"}
_KINDS |= {f"{sign}int{8 * n}": f"{sign or 'i'}{n}" for sign in ("", "u") for n in (1, 2, 4)}
#: Byte order by format; text has none.
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
#: Lists up to this long are read as columns of a table where all rows have the same number.
_SHORT = 16


class _Property(NamedTuple):
    """A column of an element: a number, or a list with its length before it."""

    name: str
    kind: str
    counted: str | None = None


class _Body:
    """The numbers of a file, taken from the front."""

    def __init__(self, content: bytes, order: str) -> None:
        self.order, self.place = order, 0
        self._data: np.ndarray = np.frombuffer(content, np.uint8)
        if order:
            return
        with warnings.catch_warnings():
            # Words among the numbers are but warned of.
            warnings.simplefilter("error", DeprecationWarning)
            try:
                self._data = np.fromstring(content, sep=" ")
            except DeprecationWarning as error:
                raise ValueError(str(error)) from None

    def rows(self, kinds: list[str], count: int) -> list[np.ndarray]:
        """Take some rows of numbers; return their columns, (count,) each."""
        row = np.dtype([(str(i), self.order + kind) for i, kind in enumerate(kinds)])
        size = row.itemsize if self.order else len(kinds)
        taken = self._data[self.place : self.place + size * count]
        if len(taken) < size * count:
            raise ValueError("too short")
        self.place += size * count
        if not self.order:
            return list(taken.reshape(count, size).T)
        return [taken.view(row)[str(i)] for i in range(len(kinds))]


def read_ply(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read points and polygons.

    Parameters
    ----------
    path : Path

    Returns
    -------
    points : (n, 3) float array
        In the unit and the precision of the file.
    polygons : (k,) int array
        Of each polygon the number of its corners, then these, as VTK has them; empty of a cloud.

    Raises
    ------
    ValueError
        The file does not hold what its header promises, or a polygon has a corner that there is
        not.
    OSError
        It cannot be read.
    """
    content = path.read_bytes()
    end = re.search(rb"\bend_header\r?\n", content)
    if end is None or not content.startswith(b"ply"):
        raise ValueError("no header")
    order, elements = _header(content[: end.start()].decode("ascii", errors="replace"))
    body = _Body(content[end.end() :], order)
    found = {name: _element(body, count, columns) for name, count, columns in elements}
    try:
        points = np.column_stack([found["vertex"][axis] for axis in "xyz"])
    except KeyError:
        raise ValueError("no coordinates") from None
    faces = found.get("face", {})
    none = np.empty((0, 2), dtype=int)
    return points, _polygons(
        faces.get("vertex_indices", faces.get("vertex_index", none)), len(points)
    )


def _header(text: str) -> tuple[str, list[tuple[str, int, list[_Property]]]]:
    """Return the byte order, and of each element its name, count and properties."""
    order = ""
    elements: list[tuple[str, int, list[_Property]]] = []
    try:
        for words in (line.split() for line in text.splitlines()):
            match words:
                case ["format", name, *_]:
                    order = _ORDERS[name]
                case ["element", name, count]:
                    elements.append((name, int(count), []))
                case ["property", "list", counted, kind, name]:
                    elements[-1][2].append(_Property(name, _KINDS[kind], _KINDS[counted]))
                case ["property", kind, name]:
                    elements[-1][2].append(_Property(name, _KINDS[kind]))
    except (KeyError, IndexError) as error:
        raise ValueError(f"header: {error}") from None
    if any(count < 0 for _, count, _ in elements):
        raise ValueError("header: a negative count")
    return order, elements


def _element(body: _Body, count: int, properties: list[_Property]) -> dict[str, np.ndarray]:
    """Take all rows of an element.

    Returns
    -------
    dict of str to array
        (count,) numbers of a property; of a list (m, 2) numbers with the row that each is of.
    """
    if not (count and properties):
        return {}
    begin = body.place
    first = _row(body, properties)
    lengths = [len(first[item.name]) for item in properties]
    if max(lengths) <= _SHORT:
        body.place = begin
        table = _table(body, count, properties, lengths)
        if table is not None:
            return table
    body.place = begin
    rows = [_row(body, properties) for _ in range(count)]
    found = {}
    for item in properties:
        values = np.concatenate([row[item.name] for row in rows])
        owner = np.repeat(np.arange(count), [len(row[item.name]) for row in rows])
        found[item.name] = values if item.counted is None else np.column_stack([owner, values])
    return found


def _row(body: _Body, properties: list[_Property]) -> dict[str, np.ndarray]:
    """Take one row of an element: the numbers of each property."""
    row = {}
    for item in properties:
        number = 1 if item.counted is None else int(body.rows([item.counted], 1)[0][0])
        if number < 0:
            raise ValueError("a list of negative length")
        row[item.name] = body.rows([item.kind], number)[0]
    return row


def _table(
    body: _Body, count: int, properties: list[_Property], lengths: list[int]
) -> dict[str, np.ndarray] | None:
    """Take all rows of an element whose lists are as long as in its first; None if they are not."""
    kinds = []
    for item, length in zip(properties, lengths, strict=True):
        kinds += [*([] if item.counted is None else [item.counted]), *[item.kind] * length]
    try:
        columns = iter(body.rows(kinds, count))
    except ValueError:
        return None
    found = {}
    for item, length in zip(properties, lengths, strict=True):
        if item.counted is not None and (next(columns) != length).any():
            return None
        values = [next(columns) for _ in range(length)]
        if item.counted is None:
            found[item.name] = values[0]
        else:
            owner = np.repeat(np.arange(count), length)
            flat = np.column_stack(values).ravel() if values else np.empty(0)
            found[item.name] = np.column_stack([owner, flat])
    return found


def _polygons(corners: np.ndarray, n: int) -> np.ndarray:
    """Return polygons as `read_ply` does; ``corners`` (m, 2) has the polygon and the vertex."""
    owner, vertex = corners.T
    with np.errstate(invalid="ignore"):
        vertex = vertex.astype(np.int64)
    if (vertex != corners[:, 1]).any() or ((vertex < 0) | (vertex >= n)).any():
        raise ValueError("a corner that there is not")
    owner = owner.astype(np.int64)
    size = np.bincount(owner)[owner]
    # What has two corners or less is no polygon.
    vertex, owner = vertex[size > 2], owner[size > 2]
    starts, sizes = np.unique(owner, return_index=True, return_counts=True)[1:]
    return np.insert(vertex, starts, sizes)
