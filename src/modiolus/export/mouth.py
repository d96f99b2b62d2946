"""What shows in an open mouth: teeth, gums, and the cavity between the arches."""

from __future__ import annotations

import numpy as np

from modiolus.export.shape import Shape
from modiolus.face.head import Head
from modiolus.face.jaw import FOLLOWERS
from modiolus.hermite.basis import Array, IntArray, smooth_step
from modiolus.hermite.tessellate import Mirror

__all__ = ["mouth"]


_COLOURS = {"teeth": (0.94, 0.91, 0.84), "gums": (0.78, 0.45, 0.45)}
#: The cavity between the front teeth and at its end, and the tongue at its tip.
_MUCOSA, _DARK = np.array([0.46, 0.20, 0.19]), np.array([0.13, 0.045, 0.04])
_TONGUE = np.array([0.70, 0.36, 0.35])
#: Share of the light that does not reach the hindmost teeth.
_SHADE = 0.4
#: Points of roof, floor and tongue from front to back, and from side to side.
_ALONG, _ACROSS = 16, 13
#: Points around the wall behind them.
_ROUND = 24
#: From the front teeth's foremost point to where they end behind (mm).
_INCISORS = 6.0
#: By how much roof and floor are higher at the mid-plane than between the teeth (mm).
_RISE = 5.0
#: By how much the tongue is higher than the teeth beside it, and the length of its tip (mm).
_OVER, _TIP = 1.5, 10.0


def mouth(head: Head) -> list[tuple[Shape, Array]]:
    """Return what shows in the mouth at rest, and by which share its vertices follow the jaw.

    Parameters
    ----------
    head : Head
        One half. Its deep structures that are called teeth and gums are drawn with their mirror
        image; where both arches have both, there are a cavity between them and a tongue in it.

    Returns
    -------
    list of (Shape, (n,) array)
    """
    halves = {
        name: head.distance(name).surface()
        for name in head.deep
        if name.partition("_")[0] in _COLOURS
    }
    out = []
    for name, half in halves.items():
        mirror = Mirror.of(half.vertices, half.faces, head.midplane)
        vertices = mirror.points(half.vertices)
        light = 1.0 - _SHADE * _depth(vertices)
        colour = light * np.array(_COLOURS[name.partition("_")[0]])
        shape = Shape(vertices, mirror.faces, colour, name, gloss=0.6, glow=0.2)
        out.append((shape, np.full(len(vertices), FOLLOWERS.get(name, 0.0))))
    if not {f"{what}_{arch}" for what in _COLOURS for arch in ("upper", "lower")} <= set(halves):
        return out
    roof, floor = (
        _between(halves[f"teeth_{arch}"].vertices, halves[f"gums_{arch}"].vertices, head.midplane)
        for arch in ("upper", "lower")
    )
    return [*out, _cavity(roof, floor), _tongue(floor, halves["teeth_lower"].vertices)]


def _depth(points: Array) -> Array:
    """Return how far points (n, 3) are from the foremost (0) to the hindmost one (1), (n, 1)."""
    front, back = points[:, 1].min(), points[:, 1].max()
    return smooth_step((points[:, 1:2] - front) / (back - front))


def _between(teeth: Array, gums: Array, midplane: float) -> Array:
    """Return points of the surface that spans an arch from side to side, (along, across, 3).

    Parameters
    ----------
    teeth, gums : (n, 3) arrays
        Points of the left half (mm).
    midplane : float
        Its x (mm).
    """
    ends = np.linspace(teeth[:, 1].min() + _INCISORS, teeth[:, 1].max(), _ALONG + 1)
    place = np.digitize(teeth[:, 1], ends[1:-1])
    count = np.maximum(np.bincount(place, minlength=_ALONG), 1)
    width = np.bincount(place, teeth[:, 0] - midplane, minlength=_ALONG) / count
    # At the back the lower gums climb the ramus.
    height = gums[gums[:, 1] < 0.5 * (ends[0] + ends[-1]), 2].mean()
    across = np.linspace(-1.0, 1.0, _ACROSS)
    x, y, z = np.broadcast_arrays(
        midplane + width[:, None] * across,
        0.5 * (ends[1:] + ends[:-1])[:, None],
        height + _RISE * (1.0 - across**2),
    )
    return np.stack([x, y, z], axis=-1)


def _cells() -> IntArray:
    """Return the triangles (m, 3) of a surface from `_between`, seen from above."""
    number = np.arange(_ALONG * _ACROSS).reshape(_ALONG, _ACROSS)
    quads = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1)
    return np.concatenate([quads[..., [0, 1, 2]], quads[..., [0, 2, 3]]]).reshape(-1, 3)


def _cavity(roof: Array, floor: Array) -> tuple[Shape, Array]:
    """Return roof, floor and the wall behind them, and what of it follows the jaw."""
    corners = np.stack([floor[-1, 0], floor[-1, -1], roof[-1, -1], roof[-1, 0]])
    # Wider and higher than the arches: the corners of an open mouth must not show the way out. Not
    # as wide in its own corners, where a slim face has no room.
    angle = np.linspace(0.0, 2.0 * np.pi, _ROUND, endpoint=False)[:, None]
    reach = 0.5 * np.ptp(corners, axis=0) * [1.45, 0.0, 1.4]
    wall = corners.mean(axis=0) + reach * np.hstack([np.cos(angle), 0.0 * angle, np.sin(angle)])
    wall[:, 1] = corners[:, 1].min()
    vertices = np.concatenate([roof.reshape(-1, 3), floor.reshape(-1, 3), wall])
    count = _ALONG * _ACROSS
    fan = 2 * count + np.stack(
        [np.zeros(_ROUND - 2, dtype=int), np.arange(1, _ROUND - 1), np.arange(2, _ROUND)], axis=1
    )
    faces = np.concatenate([_cells()[:, ::-1], _cells() + count, fan])
    follows = np.repeat([0.0, 1.0], count)
    follows = np.concatenate([follows, wall[:, 2] < corners[:, 2].mean()])
    return Shape(vertices, faces, _darkened(_MUCOSA, vertices), "mouth", gloss=0.0), follows


def _tongue(floor: Array, teeth: Array) -> tuple[Shape, Array]:
    """Return a tongue that lies between the lower teeth, and what of it follows the jaw: all.

    It rests on the floor (along, across, 3) and fills the arch to above its teeth (n, 3): what
    shows between the arches when they all but meet is the tongue.
    """
    points = floor.copy()
    back = points[..., 1] - points[0, 0, 1]
    # Round at the tip and at both sides, like an ellipse.
    tip = np.sqrt(1.0 - (1.0 - np.minimum(back / _TIP, 1.0)) ** 2)
    side = np.sqrt(1.0 - np.abs(np.linspace(-1.0, 1.0, _ACROSS)) ** 3)
    points[..., 2] += tip * side * (teeth[:, 2].max() + _OVER - points[..., 2])
    vertices = points.reshape(-1, 3)
    colour = _darkened(_TONGUE, vertices)
    return Shape(vertices, _cells(), colour, "tongue", gloss=0.1, glow=0.3), np.ones(len(vertices))


def _darkened(colour: Array, points: Array) -> Array:
    """Return the colour (n, 3) of points (n, 3), dark from two thirds of the way to the back."""
    return colour + np.minimum(1.5 * _depth(points), 1.0) * (_DARK - colour)
