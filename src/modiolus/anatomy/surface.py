"""Triangulated surfaces of anatomy, and their checked reader.

Everything is in millimetres in one frame: +x the subject's left, +y posterior, +z up (LPS).
Distances and closest points come from libigl's bounding volume tree, insides from its fast
winding number [1]_, which also bears surfaces with small holes and several overlapping shells.

References
----------
.. [1] G. Barill et al., "Fast winding numbers for soups and clouds", ACM Trans. Graph. 37 (2018).
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import igl
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from modiolus.anatomy.ply import read_ply
from modiolus.errors import InputError
from modiolus.hermite.check import numbers

__all__ = [
    "MIDPLANE",
    "READABLE",
    "Closest",
    "Surface",
    "check_face",
    "read_surface",
]

#: x of the reference anatomy's mid-sagittal plane (mm).
MIDPLANE = -0.67

#: Endings of the files that `read_surface` reads.
READABLE = (".ply", ".stl", ".obj", ".vtp")
#: Fewer points than this tell nothing of a face.
_FEWEST_POINTS = 500
#: A face measures more than the first and less than the second in any unit from metres to µm.
_SMALLEST, _LARGEST = 1e-2, 1e8


class Closest(NamedTuple):
    """Closest points of a surface: one row for each query point."""

    points: np.ndarray
    """(n, 3) closest points on the surface."""
    distance: np.ndarray
    """(n,) distances, not negative."""
    faces: np.ndarray
    """(n,) the triangles on which they lie."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangulated surface.

    Parameters
    ----------
    vertices : (n, 3) float array
        Vertex positions (mm).
    faces : (m, 3) int array
        Vertex indices, counter-clockwise seen from outside.
    name : str
        What the surface is, for messages.

    Raises
    ------
    InputError
        The arrays are of another shape, empty, not finite, or refer to missing vertices.
    """

    vertices: np.ndarray
    faces: np.ndarray
    name: str = "surface"

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, dtype=np.float64)
        faces = np.ascontiguousarray(self.faces, dtype=np.int64)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not len(vertices):
            raise InputError(f"{self.name}: no vertices in three dimensions; give a surface mesh")
        if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
            raise InputError(f"{self.name}: no triangles; give a triangulated surface")
        if not np.isfinite(vertices).all():
            raise InputError(f"{self.name}: vertices that are not finite; write the mesh anew")
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise InputError(f"{self.name}: triangles of missing vertices; write the mesh anew")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)

    @classmethod
    def joined(cls, surfaces: Iterable[Surface], name: str = "surface") -> Surface:
        """Put several surfaces into one, shells and all.

        Parameters
        ----------
        surfaces : iterable of Surface
            At least one.
        name : str
            Name of the whole.
        """
        parts = list(surfaces)
        starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
        return cls(
            np.concatenate([part.vertices for part in parts]),
            np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)]),
            name,
        )

    @property
    def bounds(self) -> np.ndarray:
        """(2, 3) lowest and highest corner of the box around the vertices (mm)."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @cached_property
    def _cross(self) -> np.ndarray:
        corners = self.vertices[self.faces]
        return np.asarray(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))

    @cached_property
    def areas(self) -> np.ndarray:
        """(m,) areas of the triangles (mm²)."""
        return np.asarray(0.5 * np.linalg.norm(self._cross, axis=1))

    @cached_property
    def normals(self) -> np.ndarray:
        """(m, 3) outward unit normals of the triangles (zero for degenerate ones)."""
        lengths = np.linalg.norm(self._cross, axis=1, keepdims=True)
        return np.asarray(self._cross / np.where(lengths > 0.0, lengths, 1.0))

    @cached_property
    def vertex_normals(self) -> np.ndarray:
        """(n, 3) outward unit normals of the vertices, the triangles weighted by their area."""
        out = np.zeros_like(self.vertices)
        for corner in self.faces.T:
            for axis in range(3):
                out[:, axis] += np.bincount(corner, self._cross[:, axis], minlength=len(out))
        lengths = np.linalg.norm(out, axis=1, keepdims=True)
        return np.asarray(out / np.where(lengths > 0.0, lengths, 1.0))

    @cached_property
    def vertex_areas(self) -> np.ndarray:
        """(n,) area (mm²) that every vertex stands for: a third of that of its triangles."""
        shared = np.repeat(self.areas / 3.0, 3)
        return np.bincount(self.faces.ravel(), shared, minlength=len(self.vertices))

    @property
    def area(self) -> float:
        """Total area (mm²)."""
        return float(self.areas.sum())

    @property
    def volume(self) -> float:
        """Enclosed volume by the divergence theorem (mm³)."""
        centres = self.vertices[self.faces].mean(axis=1) - self.vertices.mean(axis=0)
        return float((centres * self._cross).sum() / 6.0)

    def components(self) -> list[Surface]:
        """Split into connected shells, the one with the most triangles first."""
        n = len(self.vertices)
        rows = self.faces[:, [0, 1]].ravel()
        columns = self.faces[:, [1, 2]].ravel()
        links = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(n, n))
        labels = connected_components(links, directed=False)[1][self.faces[:, 0]]
        found, counts = np.unique(labels, return_counts=True)
        order = found[np.argsort(-counts, kind="stable")]
        return [self.picked(self.faces[labels == label]) for label in order]

    def largest_component(self) -> Surface:
        """Return the connected shell with the most triangles."""
        return self.components()[0]

    def picked(self, faces: np.ndarray) -> Surface:
        """Return the surface of some of the triangles.

        Parameters
        ----------
        faces : (k, 3) int array
            Rows of `faces`.
        """
        used, packed = np.unique(faces, return_inverse=True)
        return Surface(self.vertices[used], packed.reshape(faces.shape), self.name)

    def mirrored(self, x: float = MIDPLANE) -> Surface:
        """Return the mirror image in the plane of constant `x`, its triangles still outward."""
        vertices = self.vertices.copy()
        vertices[:, 0] = 2.0 * x - vertices[:, 0]
        return Surface(vertices, self.faces[:, ::-1], self.name)

    def closest(self, points: np.ndarray) -> Closest:
        """Find the closest points on the surface.

        Parameters
        ----------
        points : (n, 3) array
            Query points (mm).
        """
        queries = _queries(points)
        squared, faces, nearest = self._tree.squared_distance(self.vertices, self.faces, queries)
        return Closest(np.atleast_2d(nearest), np.sqrt(squared), np.atleast_1d(faces))

    def escaping(self, points: np.ndarray, normals: np.ndarray, directions: int = 64) -> np.ndarray:
        """Return which share of the rays from points of the surface into the open escapes it.

        Parameters
        ----------
        points, normals : (n, 3) arrays
            Of the surface (mm).
        directions : int
            Rays, spread evenly over the sphere; those before a point count.

        Returns
        -------
        (n,) array
        """
        k = np.arange(directions)
        height = 1.0 - (2.0 * k + 1.0) / directions
        turn = 4.0 * np.pi * k / (1.0 + np.sqrt(5.0))
        radius = np.sqrt(1.0 - height**2)
        rays = np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=1)
        starts = points + 0.05 * normals
        escaped, tried = np.zeros(len(points)), np.zeros(len(points))
        for ray in rays:
            before = normals @ ray > 0.1
            tried += before
            escaped[before] += np.isnan(self.first_hits(starts[before], ray)[:, 0])
        return np.asarray(escaped / np.maximum(tried, 1.0))

    def first_hits(self, origins: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Find where rays first meet the surface.

        Parameters
        ----------
        origins : (n, 3) array
            Starts of the rays (mm).
        direction : (3,) or (n, 3) array
            Their common direction, or that of each.

        Returns
        -------
        (n, 3) array
            The hits; NaN where a ray misses.
        """
        starts = _queries(origins)
        directions = np.array(np.broadcast_to(np.asarray(direction, dtype=float), starts.shape))
        faces, lengths, _ = self._tree.intersect_ray_first(
            self.vertices, self.faces, starts, directions
        )
        hits = starts + np.asarray(lengths)[:, None] * directions
        hits[np.asarray(faces) < 0] = np.nan
        return np.asarray(hits)

    @cached_property
    def _tree(self) -> igl.AABB:
        tree = igl.AABB()
        tree.init(self.vertices, self.faces)
        return tree

    def winding(self, points: np.ndarray) -> np.ndarray:
        """Winding number at (n, 3) points: 0 outside, 1 inside, more where shells overlap."""
        return np.asarray(igl.fast_winding_number(self.vertices, self.faces, _queries(points)))

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Tell which of (n, 3) points are inside: (n,) bool."""
        return np.asarray(self.winding(points) > 0.5)

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """Signed distance at (n, 3) points: (n,), negative inside (mm)."""
        return np.asarray(
            np.where(self.contains(points), -1.0, 1.0) * self.closest(points).distance
        )

    def samples(self, spacing: float) -> np.ndarray:
        """Spread points evenly over the surface, the same ones every time.

        Parameters
        ----------
        spacing : float
            About one point for every `spacing` squared (mm).

        Returns
        -------
        (n, 3) array
            Points in the triangles, placed by a low-discrepancy sequence.

        Raises
        ------
        InputError
            The spacing is not above 0.
        """
        if not spacing > 0.0:
            raise InputError(f"spacing {spacing:g}: no length; give one above 0")
        n = max(1, round(self.area / spacing**2))
        edges = np.concatenate([[0.0], np.cumsum(self.areas)])
        places = (np.arange(n) + 0.5) / n * edges[-1]
        faces = np.clip(np.searchsorted(edges, places, side="right") - 1, 0, len(self.faces) - 1)
        # Fractions of the plastic number: Roberts' two-dimensional low-discrepancy sequence.
        plastic = 1.3247179572447460
        u, v = (np.arange(n)[:, None] * (1.0 / plastic) ** np.array([1, 2]) % 1.0).T
        folded = u + v > 1.0
        u, v = np.where(folded, 1.0 - u, u), np.where(folded, 1.0 - v, v)
        corners = self.vertices[self.faces[faces]]
        weights = np.stack([1.0 - u - v, u, v], axis=1)
        return np.asarray(np.einsum("nk,nkd->nd", weights, corners))


def _queries(points: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(numbers("points", points, None, 3))


def read_surface(path: str | Path, name: str | None = None) -> Surface:
    """Read a triangulated surface and check it.

    Parameters
    ----------
    path : path
        A PLY, STL, OBJ or VTP file. The vertices of an STL file are merged.
    name : str, optional
        What the surface is; by default the file's name.

    Raises
    ------
    InputError
        The file is missing, of another kind, truncated, or holds no sound triangles.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; check the path")
    if path.suffix.lower() not in READABLE:
        raise InputError(f"{path}: not a surface file; give one of {', '.join(READABLE)}")
    # VTK is imported here because it takes longer than everything else together.
    import pyvista as pv
    from vtkmodules.vtkCommonCore import vtkLogger

    damaged = f"{path}: cannot be read as a surface; it may be truncated, fetch it again"
    logged = vtkLogger.GetCurrentVerbosityCutoff()
    try:
        # VTK's messages go to three places at once; one line from here is enough.
        vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
        with warnings.catch_warnings(), pv.VtkErrorCatcher(raise_errors=True):
            warnings.simplefilter("ignore")
            logging.disable(logging.ERROR)
            is_ply = path.suffix.lower() == ".ply"
            mesh = (pv.PolyData(*read_ply(path)) if is_ply else pv.read(path)).triangulate()
        surface = Surface(mesh.points, mesh.regular_faces, name or path.stem)
    except (InputError, RuntimeError, ValueError, AttributeError) as error:
        raise InputError(damaged) from error
    finally:
        logging.disable(logging.NOTSET)
        vtkLogger.SetStderrVerbosity(logged)
    if path.suffix.lower() == ".stl":
        merged, index = np.unique(surface.vertices, axis=0, return_inverse=True)
        surface = Surface(merged, index.ravel()[surface.faces], surface.name)
    # Some readers give the missing triangles of a truncated file as zeros.
    ordered = np.sort(surface.faces, axis=1)
    degenerate = (ordered[:, 0] == ordered[:, 1]) | (ordered[:, 1] == ordered[:, 2])
    if degenerate.mean() > 0.01:
        raise InputError(damaged)
    return surface


def check_face(where: str, points: np.ndarray) -> None:
    """Refuse points (n, 3) that cannot be those of a face, before anything is computed with them.

    Parameters
    ----------
    where : str
        What the points are, for the message.
    points : (n, 3) array
        In any unit and pose.

    Raises
    ------
    InputError
        They are not finite, too few, of an impossible size, or in one plane.
    """
    if not np.isfinite(points).all():
        bad = int((~np.isfinite(points)).any(axis=1).sum())
        raise InputError(f"{where}: {bad} points are not finite; remove them")
    if len(points) < _FEWEST_POINTS:
        raise InputError(
            f"{where}: {len(points)} points are too few for a face (at least {_FEWEST_POINTS}); "
            "give the whole scan"
        )
    size = float(np.ptp(points, axis=0).max())
    if not _SMALLEST < size < _LARGEST:
        raise InputError(
            f"{where}: its points span {size:g}, which is no face in mm, cm or m; remove points "
            "that are astray, or give another unit"
        )
    spread = np.linalg.svd(points - points.mean(axis=0), full_matrices=False, compute_uv=False)
    if spread[2] < 1e-3 * spread[0]:
        raise InputError(f"{where}: all points lie in a plane or on a line; give the whole scan")
