"""Where the skin lies in a texture: the layout that all heads of the template share.

The columns and rows of the tissue's grid are laid out as wide and as high as they are on *taro*, so
that every head of the template has the same layout and textures can be exchanged between heads.
The mid-plane is the line u = 1/2, which joins the two halves without a seam. Where the mouth and
the eye are slits in the grid the layout opens: the margins of lips and lids lie in the openings,
as rings whose outer edges are those of the skin around them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modiolus.face.head import Head
from modiolus.face.template import (
    COLUMNS,
    COMMISSURE,
    EYE_ROW,
    LATERAL_CANTHUS,
    MEDIAL_CANTHUS,
    MOUTH_ROW,
    ROWS,
)
from modiolus.hermite.basis import Array
from modiolus.hermite.tessellate import Tessellation

__all__ = ["skin_layout"]

#: Lengths on the skin of *taro* (mm): of the columns from the mid-plane to the ear, in the mean
#: over the rows; of the rows from the neck to the scalp, in the mean over the columns; and about
#: from the mid-plane to the ear along every line between rows.
_WIDTHS = (5.7, 6.4, 7.2, 7.0, 6.8, 7.9, 9.7, 11.3, 10.8, 11.0, 11.3, 10.9)
_HEIGHTS = (
    *(17.3, 16.8, 16.5, 12.4, 9.8, 7.9, 6.4, 7.0, 6.6, 7.1, 7.9, 7.7),
    *(10.4, 11.3, 10.5, 12.2, 11.8, 12.6, 13.4, 13.9, 14.8),
)
_REACHES = (
    *(66.0, 74.0, 86.0, 100.0, 109.0, 112.0, 112.0, 113.0, 114.0, 115.0, 117.0),
    *(120.0, 120.0, 118.0, 116.0, 114.0, 114.0, 112.0, 110.0, 105.0, 98.0, 88.0),
)
#: Side of the texture (mm).
_SIDE = 256.0
_U = np.concatenate([[0.0], np.cumsum(_WIDTHS)])
_V = np.concatenate([[0.0], np.cumsum(_HEIGHTS)])


@dataclass(frozen=True)
class _Opening:
    """Where the layout opens along a slit.

    Attributes
    ----------
    row : int
        Line between rows along which the slit runs.
    columns : (int, int)
        Lines between columns at which it ends.
    centre : float
        u of its middle (mm).
    height : float
        Half the height of the opening (mm).
    spread : int
        Rows on either side that give way.
    ring : float
        Width of the ring of margins at its ends (mm).
    """

    row: int
    columns: tuple[int, int]
    centre: float
    height: float
    spread: int
    ring: float

    @property
    def half(self) -> float:
        """Half the width of the opening (mm)."""
        return float(_U[self.columns[1]] - self.centre)

    def profile(self, u: Array) -> Array:
        """Return half the height of the opening (mm) at places across."""
        away = (u - self.centre) / self.half
        return np.asarray(self.height * np.clip(1.0 - away**2, 0.0, None))

    def shift(self, u: Array, v: Array, above: NDArray[np.bool_]) -> Array:
        """Return how far (mm) the skin around gives way."""
        line = _V[self.row]
        ends = np.where(above, _V[self.row + self.spread], _V[self.row - self.spread])
        share = np.clip((ends - v) / (ends - line), 0.0, 1.0)
        return np.asarray(np.where(above, 1.0, -1.0) * share * self.profile(u))

    def margin(self, u: Array, depth: Array, above: bool) -> tuple[Array, Array]:
        """Return where (mm) a margin lies, at depths from 0 at the skin to 1 inside."""
        across = self.centre + (u - self.centre) * (1.0 - self.ring / self.half * depth)
        up = self.profile(u) * (1.0 - _HOLLOW * depth)
        return across, np.asarray(_V[self.row] + (up if above else -up))


#: Share of an opening's height that its margins take.
_HOLLOW = 0.65
_OPENINGS = {
    "lip": _Opening(MOUTH_ROW, (0, COMMISSURE), 0.0, 5.0, 3, 6.0),
    "lid": _Opening(
        EYE_ROW,
        (MEDIAL_CANTHUS, LATERAL_CANTHUS),
        float(0.5 * (_U[MEDIAL_CANTHUS] + _U[LATERAL_CANTHUS])),
        4.0,
        2,
        3.0,
    ),
}


def skin_layout(head: Head, names: list[str], pieces: Tessellation) -> Array | None:
    """Return the texture coordinates of the left half of a skin.

    Parameters
    ----------
    head : Head
    names : list of str
        Its sides that are skin, in the order of the pieces: ``outer`` and the margins.
    pieces : Tessellation
        Of these sides.

    Returns
    -------
    (n_vertices, 2) array or None
        u from 1/2 at the mid-plane towards 1, v from 0 below to 1 above; None where the skin is
        not divided as the template's.
    """
    if len(head.sides["outer"][0]) != ROWS * COLUMNS:
        return None
    counts = [len(head.sides[name][0]) for name in names]
    part = np.repeat(np.arange(len(names)), counts)[pieces.elements]
    host = np.concatenate([head.sides[name][0] for name in names])[pieces.elements]
    row, column = np.divmod(host % (ROWS * COLUMNS), COLUMNS)
    u = np.interp(column + pieces.xi[:, 0], np.arange(COLUMNS + 1), _U)
    v = np.interp(row + pieces.xi[:, 1], np.arange(ROWS + 1), _V)
    # Skin: the rows beside the slits give way.
    moved = v.copy()
    for item in _OPENINGS.values():
        moved += item.shift(u, v, row >= item.row)
    for number, name in enumerate(names):
        kind, _, which = name.partition("_")
        if kind in _OPENINGS:
            here = part == number
            # The second coordinate of a margin runs from inside to the skin.
            depth = 1.0 - pieces.xi[here, 1]
            place = _OPENINGS[kind].margin(u[here], depth, which == "upper")
            u[here], moved[here] = place
    reach = np.interp(moved, _V, _REACHES) / _U[-1]
    low = 0.5 * (1.0 - _V[-1] / _SIDE)
    return pieces.average(np.column_stack([0.5 + u * reach / _SIDE, low + moved / _SIDE]))
