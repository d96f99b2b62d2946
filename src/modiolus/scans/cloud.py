"""A surface through a cloud of points, as scanners without triangles leave it.

Hoppe et al. 1992: planes through the neighbours of every point, turned to one side from neighbour
to neighbour; the surface is where the distance to the planes around is zero. Averaging over the
planes takes out noise; gaps wider than a few spacings of the points stay open.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.spatial import cKDTree

from ..anatomy.surface import Surface
from ..errors import InputError
from ..fitting.register import sphere

__all__ = ["wrapped"]

Array = NDArray[np.float64]

#: Points that make the plane at a point, and planes that make the distance at a node of the grid.
_NEIGHBOURS, _PLANES = 18, 10
#: Points that are farther than this many times the usual from their neighbours fly about.
_STRAY = 8.0
#: Nodes of the grid along the longest side, at most.
_NODES = 220
#: The surface ends at this distance from the points, in spacings of the grid.
_REACH = 1.5


def wrapped(points: Array, name: str) -> tuple[Array, Array, Surface]:
    """Find a surface through a cloud.

    Parameters
    ----------
    points : (n, 3) array
        All different.
    name : str
        Of the cloud, for the surface and messages.

    Returns
    -------
    points, normals : (m, 3) arrays
        The points without those that fly about, and outward normals there.
    surface : Surface
        It has vertices of its own.

    Raises
    ------
    InputError
        No surface passes through the points.
    """
    gaps = cKDTree(points).query(points, k=7)[0].mean(axis=1)
    points = points[gaps < _STRAY * np.median(gaps)]
    tree = cKDTree(points)
    near = tree.query(points, k=_NEIGHBOURS)[1]
    around = points[near] - points[near].mean(axis=1, keepdims=True)
    normals = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))[1][:, :, 0]
    normals = _turned(points, normals, near)
    spacing = max(float(np.median(gaps)), float(np.ptp(points, axis=0).max()) / _NODES)
    surface = _level(points, normals, tree, spacing, name)
    return points, normals, surface


def _turned(points: Array, normals: Array, near: NDArray[np.int64]) -> Array:
    """Turn normals outwards: alike between neighbours, and most of them off the middle."""
    n, k = near.shape
    start, end = np.repeat(np.arange(n), k - 1), near[:, 1:].ravel()
    apart = 1.0 + 1e-6 - np.abs((normals[start] * normals[end]).sum(axis=1))
    graph = csr_matrix((apart, (start, end)), (n, n))
    tree = minimum_spanning_tree(graph.maximum(graph.T))
    count, part = connected_components(tree, directed=False)
    out = normals.copy()
    outward = (normals * (points - sphere(points)[0])).sum(axis=1)
    for number in range(count):
        first = int(np.flatnonzero(part == number)[0])
        order, parents = breadth_first_order(tree, first, directed=False)
        alike = (normals[order[1:]] * normals[parents[order[1:]]]).sum(axis=1) >= 0.0
        sign = np.ones(n, dtype=np.int64)
        for node, parent, same in zip(
            order[1:].tolist(), parents[order[1:]].tolist(), alike.tolist(), strict=True
        ):
            sign[node] = sign[parent] if same else -sign[parent]
        if (sign[order] * outward[order]).sum() < 0.0:
            sign = -sign
        out[order] *= sign[order, None]
    return out


def _level(points: Array, normals: Array, tree: cKDTree, spacing: float, name: str) -> Surface:
    """Return the surface at distance zero from the planes, where there are points near."""
    import pyvista as pv

    origin = points.min(axis=0) - 4.0 * spacing
    shape = np.ceil(np.ptp(points, axis=0) / spacing).astype(int) + 9
    band = np.zeros(shape, dtype=bool)
    band[tuple(np.round((points - origin) / spacing).astype(int).T)] = True
    band = binary_dilation(band, np.ones((3, 3, 3)), iterations=2)
    places = origin + spacing * np.argwhere(band)
    distance, planes = tree.query(places, k=_PLANES)
    weight = np.exp(-((distance / (_REACH * spacing)) ** 2)) + 1e-12
    heights = ((places[:, None] - points[planes]) * normals[planes]).sum(axis=2)
    field = np.full(shape, 1e3 * spacing)
    field[band] = (weight * heights).sum(axis=1) / weight.sum(axis=1)
    grid = pv.ImageData(dimensions=shape, spacing=[spacing] * 3, origin=origin)
    grid["distance"] = field.ravel(order="F")
    mesh = grid.contour([0.0], scalars="distance", method="flying_edges", compute_normals=False)
    vertices = np.asarray(mesh.points, dtype=float)
    kept = np.zeros(0, dtype=bool)
    if len(vertices):
        kept = tree.query(vertices)[0] < _REACH * spacing
    faces = mesh.regular_faces if len(vertices) else np.zeros((0, 3), dtype=np.int64)
    faces = faces[kept[faces].all(axis=1)]
    if not len(faces):
        raise InputError(f"{name}: no surface passes through the points; give a denser cloud")
    surface = Surface(vertices, faces, name).picked(np.asarray(faces, dtype=np.int64))
    # Triangles face up the distance, as the normals do, or all of them the other way.
    own = surface.normals
    nearest = tree.query(surface.vertices[surface.faces].mean(axis=1))[1]
    if (own * normals[nearest]).sum() < 0.0:
        return Surface(surface.vertices, surface.faces[:, ::-1], name)
    return surface
