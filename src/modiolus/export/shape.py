"""Surfaces with a look: what pictures and animation files are made of."""

from dataclasses import dataclass

import numpy as np

from modiolus.errors import InputError
from modiolus.hermite.basis import Array, IntArray
from modiolus.hermite.check import numbers, whole

__all__ = ["Shape", "linear_light", "vertex_normals"]


@dataclass(frozen=True, eq=False)
class Shape:
    """A triangulated surface with its look.

    Parameters
    ----------
    vertices : (n, 3) array
        Positions in mm.
    faces : (m, 3) array of int
        Triangles, counter-clockwise seen from outside.
    colour : (3,) or (n, 3) array
        sRGB colour, 0 to 1, of the whole or of every vertex.
    name : str
        What it is, such as ``"skin"``.
    gloss : float
        Strength of the highlight, 0 (matt) to 1 (wet).
    glow : float
        Share of the light that has wandered under the surface, as it does in skin.
    layout : (n, 2) array, optional
        Texture coordinates (u, v) of every vertex, from 0 at the left and below to 1.

    Raises
    ------
    InputError
        An array has another shape, a vertex is not finite, or a triangle has one that there is not.
    """

    vertices: Array
    faces: IntArray
    colour: tuple[float, float, float] | Array
    name: str = ""
    gloss: float = 0.12
    glow: float = 0.0
    layout: Array | None = None

    def __post_init__(self) -> None:
        n = len(numbers(f"{self.name or 'shape'}: vertices", self.vertices, None, 3))
        corners = whole(f"{self.name or 'shape'}: faces", self.faces, n, ndim=2)
        if corners.shape[1] != 3 or np.shape(self.colour) not in ((3,), (n, 3)):
            raise InputError(
                f"{self.name or 'shape'}: faces {corners.shape} and colour {np.shape(self.colour)} "
                "do not fit; give three corners a face and one colour, or one a vertex"
            )
        if self.layout is not None:
            numbers(f"{self.name or 'shape'}: layout", self.layout, n, 2)

    def colours(self) -> Array:
        """Return the colour of every vertex, (n, 3)."""
        return np.broadcast_to(np.asarray(self.colour, dtype=float), self.vertices.shape)


def vertex_normals(vertices: Array, faces: IntArray) -> Array:
    """Return smooth unit normals: the area-weighted mean of the triangles around each vertex.

    Parameters
    ----------
    vertices : (n, 3) array
        Positions.
    faces : (m, 3) array of int
        Triangles.

    Returns
    -------
    (n, 3) array
        Unit normals; +z where no triangle with an area tells.
    """
    corners = vertices[faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros(vertices.shape)
    for corner in range(3):
        for axis in range(3):
            normals[:, axis] += np.bincount(
                faces[:, corner], weights=areas[:, axis], minlength=len(vertices)
            )
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 0.0, normals / np.where(length > 0.0, length, 1.0), [0.0, 0.0, 1.0])


def linear_light(colour: Array) -> Array:
    """Return the linear light of sRGB colours, 0 to 1 (IEC 61966-2-1)."""
    low = colour <= 0.04045
    return np.asarray(np.where(low, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4))
