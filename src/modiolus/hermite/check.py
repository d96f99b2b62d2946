"""Arrays that a caller gives, checked at the door."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError

__all__ = ["numbers", "whole"]


def numbers(name: str, values: ArrayLike, *shape: int | None) -> NDArray[np.float64]:
    """Return an array of finite numbers.

    Parameters
    ----------
    name : str
        What the caller calls it.
    values : array
        Not copied when it is a float array already.
    *shape : int or None
        The length along each axis; None for any.

    Raises
    ------
    InputError
        Its shape is another, or it has a NaN or an infinity.
    """
    array = np.asarray(values, dtype=float)
    if array.ndim != len(shape) or any(
        n is not None and n != m for n, m in zip(shape, array.shape, strict=True)
    ):
        wanted = ", ".join("n" if n is None else str(n) for n in shape)
        raise InputError(
            f"{name}: shape {array.shape} is not ({wanted}{',' * (len(shape) == 1)}); reshape it"
        )
    if not np.isfinite(array).all():
        raise InputError(f"{name}: there is a NaN or an infinity; leave it out")
    return array


def whole(name: str, values: ArrayLike, stop: int, ndim: int = 1) -> NDArray[np.int64]:
    """Return an array of whole numbers from 0 to ``stop - 1``.

    Parameters
    ----------
    name : str
        What the caller calls it.
    values : array of int
    stop : int
    ndim : int
        Number of axes.

    Raises
    ------
    InputError
        It has other axes, other numbers (a mask is none), or one out of range.
    """
    array = np.asarray(values)
    if array.ndim != ndim:
        raise InputError(f"{name}: shape {array.shape} has not {ndim} axes; reshape it")
    if array.size and array.dtype.kind not in "iu":
        raise InputError(f"{name}: {array.dtype} is no type of whole numbers; give indices")
    if array.size and not 0 <= array.min() <= array.max() < stop:
        out = array.min() if array.min() < 0 else array.max()
        raise InputError(f"{name}: {out} is not within 0 to {stop - 1}; mend it")
    return array.astype(np.int64, copy=False)
