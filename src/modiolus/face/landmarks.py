"""Landmarks of a measured face, read from a file and paired with those of a head."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import InputError, unknown_name
from ..files import coordinates, read_table
from ..hermite.basis import Array
from .head import Head

__all__ = ["MULTI_PIE", "read_landmarks"]

#: Landmarks of a head by their number among the 68 of Multi-PIE.
MULTI_PIE = {
    **{"18": "outer_brow_right", "22": "inner_brow_right"},
    **{"23": "inner_brow_left", "27": "outer_brow_left"},
    **{"32": "ala_right", "36": "ala_left"},
    **{"49": "mouth_corner_right", "55": "mouth_corner_left"},
    **{"63": "upper_lip_mid", "67": "lower_lip_mid"},
}


def read_landmarks(path: str | Path, head: Head) -> tuple[Array, Array]:
    """Read places on a measured face and pair them with those of a head.

    Parameters
    ----------
    path : path
        A CSV file with the columns ``x, y, z`` (or ``x_mm`` and so on), and ``name`` with the
        names of `Head.landmark_points` or ``multi_pie_index`` with those of the 68 points of
        Multi-PIE, of which some are places of the head. Other columns are ignored.
    head : Head

    Returns
    -------
    measured, head : (n, 3) arrays
        In the unit and frame of the file, and in the head's.

    Raises
    ------
    InputError
        The file cannot be read, has a name that the head does not know or one twice, or fewer
        than three places of the head.
    """
    path = Path(path)
    known = head.landmark_points()
    here: list[tuple[float, float, float]] = []
    there: list[Array] = []
    for number, row in read_table(path):
        name = row.get("name", "")
        if not name:
            if "multi_pie_index" not in row:
                raise InputError(f"{path}: line {number} has no name nor multi_pie_index; add one")
            name = MULTI_PIE.get(row["multi_pie_index"], "")
            if name not in known:
                continue
        if name not in known:
            raise InputError(f"{path}: line {number}: {unknown_name('landmark', name, known)}")
        if any(known[name] is place for place in there):
            raise InputError(f"{path}: line {number}: {name} is there already; keep one of them")
        here.append(coordinates(row, f"{path}: line {number}"))
        there.append(known[name])
    if len(here) < 3:
        raise InputError(
            f"{path}: {len(here)} landmarks of the head; give at least three, such as "
            f"{', '.join(list(known)[:3])}"
        )
    return np.array(here), np.array(there)
