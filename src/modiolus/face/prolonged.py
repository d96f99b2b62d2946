"""Levator anguli oris prolonged to the modiolus, above which the source's ends.

The source's is 14 mm long and ends in an oblique edge between the wing of the nose and the corner
of the mouth. In life it ends at the corner itself, where its fibres meet those of zygomaticus
major, depressor anguli oris and orbicularis oris (Gray's Anatomy, "Face and scalp"), and is 35 mm
long, which are 30 mm in a head of this size.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..hermite import HermiteMesh, grid
from ..hermite.basis import Array
from .malar import below
from .muscle import Muscle
from .template import COLUMNS

__all__ = ["LEVATOR", "to_modiolus"]

LEVATOR = "levator_anguli_oris"

#: Its end, from medial to lateral, in columns and rows of the template: beside and above the corner
#: of the mouth. Depth below the skin and thickness there (mm).
_END = ((4.5, 7.3), (5.2, 7.2))
_DEPTH, _THICKNESS = 8.0, 1.0
#: Elements that are added along.
_FURTHER = 4


def to_modiolus(muscle: Muscle, tissue: HermiteMesh) -> Muscle:
    """Return the muscle, as it lies in the tissue of a half, with all of its rows prolonged.

    They go straight on in the columns and rows of the template, so that they stay in the tissue,
    and rise from the bone.
    """
    rows, count = (numbers.max() + 1 for numbers in muscle.rows())
    known = muscle.mesh.parameters.reshape(2, rows + 1, count + 1, 8, 3)
    nodes = known[:, :, :, 0].transpose(2, 1, 0, 3)
    edge = np.linspace(*_END, rows + 1)
    layers = [_DEPTH + 0.5 * _THICKNESS, _DEPTH - 0.5 * _THICKNESS]
    start = _places(tissue, nodes[-1])
    end = _places(tissue, np.stack([below(tissue, edge, depth) for depth in layers], axis=1))
    along = np.linspace(0.0, 1.0, _FURTHER + 1)[1:, None, None, None]
    shares = np.concatenate([along, along, along * (2.0 - along)], axis=3)
    mesh = grid(np.concatenate([nodes, _points(tissue, start + shares * (end - start))]))
    # What the source has stays as it is, but for the direction in which it ends.
    parameters = mesh.parameters.reshape(2, rows + 1, -1, 8, 3).copy()
    parameters[:, :, :count] = known[:, :, :count]
    return replace(muscle, mesh=mesh.with_parameters(parameters.reshape(-1, 3)))


def _places(tissue: HermiteMesh, points: Array) -> Array:
    """Return column, row and height in the layer, from 0 to 1, of points (..., 3)."""
    place = tissue.locate(points.reshape(-1, 3))
    row, column = np.divmod(place.elements, COLUMNS)
    corner = np.column_stack([column, row, np.zeros(len(row))])
    return np.asarray(corner + place.xi).reshape(points.shape)


def _points(tissue: HermiteMesh, places: Array) -> Array:
    """Return the points (..., 3) at what `_places` returns."""
    flat = places.reshape(-1, 3)
    corner = np.floor(flat) * [1.0, 1.0, 0.0]
    elements = (corner[:, 0] + COLUMNS * corner[:, 1]).astype(np.int64)
    return tissue.evaluate(elements, flat - corner).reshape(places.shape)
