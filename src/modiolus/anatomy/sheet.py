"""Thin bodies as sheets: a clean skin, its rim, and conformal coordinates on it.

A muscle of the face is a thin closed body: two sheets, an inner and an outer one, that meet in a
rim. On its surface two Laplace problems give coordinates. For a strip with four corners, *along*
is 0 on the rim at one end and 1 at the other, *across* is 0 and 1 on the rim of the two sides,
and each has natural conditions on the rim of the other. The two are the harmonic conjugates that
map a quadrilateral conformally to a rectangle: lines of constant *across* are the streamlines of
*along*, the way fibres run from origin to insertion. For a ring, *along* is the harmonic angle
around the hole and *across* runs from the inner to the outer rim.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import igl
import numpy as np
from scipy import ndimage
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from modiolus.anatomy.distance import distances_in_band
from modiolus.anatomy.surface import Surface
from modiolus.errors import SolveError

__all__ = ["Sheet", "clean_skin", "ring", "strip"]


@dataclass(frozen=True, eq=False)
class Sheet:
    """A thin body with coordinates on its two sheets.

    Parameters
    ----------
    surface : Surface
        The closed surface.
    along, across : (n,) float arrays
        Coordinates of the vertices, 0 to 1; *along* of a ring is periodic.
    side : (n,) int array
        1 on the outer sheet, 0 on the inner one, -1 on the rim.
    closed : bool
        Whether this is a ring.
    """

    surface: Surface
    along: np.ndarray
    across: np.ndarray
    side: np.ndarray
    closed: bool

    def points(self, side: int, along: np.ndarray, across: np.ndarray) -> np.ndarray:
        """Find the points of one sheet that have given coordinates.

        Parameters
        ----------
        side : int
            1 for the outer, 0 for the inner sheet.
        along, across : (n,) arrays
            Coordinates.

        Returns
        -------
        (n, 3) array
            Positions; of the nearest coordinates where the sheet does not reach.
        """
        asked = np.stack([along, across], axis=1)
        linear, nearest = self._interpolators[side]
        found = linear(asked)
        lost = ~np.isfinite(found).all(axis=1)
        if lost.any():
            found[lost] = nearest(asked[lost])
        return np.asarray(found)

    @cached_property
    def _interpolators(self) -> list[tuple[LinearNDInterpolator, NearestNDInterpolator]]:
        faces = self.surface.faces
        both = []
        for side in (0, 1):
            # The sheet with the triangles that tie it to the rim, so that it reaches 0 and 1.
            of_side = (self.side[faces] == side).any(axis=1)
            used = np.unique(faces[of_side & (self.side[faces] != 1 - side).all(axis=1)])
            known = np.stack([self.along[used], self.across[used]], axis=1)
            values = self.surface.vertices[used]
            if self.closed:
                turns = [known + np.array([turn, 0.0]) for turn in (-1.0, 0.0, 1.0)]
                known = np.concatenate(turns)
                values = np.tile(values, (3, 1))
                near = np.abs(known[:, 0] - 0.5) < 0.7
                known, values = known[near], values[near]
            both.append((LinearNDInterpolator(known, values), NearestNDInterpolator(known, values)))
        return both


def clean_skin(
    surface: Surface,
    spacing: float,
    closing: float,
    handles: int = 0,
    box: np.ndarray | None = None,
) -> Surface:
    """Triangulate a thin body anew, evenly, with gaps between its fringes closed.

    Parameters
    ----------
    surface : Surface
        The body.
    spacing : float
        Size of the voxels (mm).
    closing : float
        Radius of the closing (mm): holes and gaps narrower than twice this are filled.
    handles : int
        Handles that the body has: 0 for a strip, 1 for a ring.
    box : (2, 3) array, optional
        Region to which the body is cut by planes (mm).

    Returns
    -------
    Surface
        The largest shell.

    Raises
    ------
    SolveError
        The body has other handles.
    """
    import pyvista as pv

    room = closing + 3.0 * spacing
    low, high = surface.bounds + np.array([[-room], [room]])
    if box is not None:
        low, high = np.maximum(low, box[0] - room), np.minimum(high, box[1] + room)
    shape = np.ceil((high - low) / spacing).astype(int) + 1
    distance = distances_in_band(surface, low, spacing, shape, 2.0 * closing)
    # Closing: what the dilated body keeps at the same depth. Half a voxel lies between the
    # last voxel of a set and its border.
    dilated = distance < closing
    depth = np.where(
        dilated,
        ndimage.distance_transform_edt(dilated) - 0.5,
        0.5 - ndimage.distance_transform_edt(~dilated),
    )
    closed = np.minimum(distance, closing - spacing * depth)
    if box is not None:
        axes = [low[k] + spacing * np.arange(shape[k]) for k in range(3)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        closed = np.maximum(closed, np.maximum(box[0] - points, points - box[1]).max(axis=-1))
    closed = ndimage.gaussian_filter(closed, 0.6, mode="nearest")
    image = pv.ImageData(dimensions=tuple(shape), spacing=(spacing,) * 3, origin=low)
    image["distance"] = closed.ravel(order="F")
    # Blurring wears thin places away: a level a little outside makes good for it, and one a
    # little farther out closes the holes that it left.
    for level in (0.15, 0.3, 0.45, 0.6):
        mesh = image.contour([level * spacing], scalars="distance", method="flying_edges")
        mesh = mesh.smooth_taubin(n_iter=10, pass_band=0.2)
        shells = Surface(mesh.points, mesh.regular_faces[:, ::-1], surface.name).components()
        skin = max(shells, key=lambda shell: shell.volume)
        if len(skin.vertices) - len(skin.faces) // 2 == 2 - 2 * handles:
            return skin
    raise SolveError(f"{surface.name}: not a body with {handles} handles; close wider gaps")


#: Sine of the angle between surface and sheet beyond which a vertex belongs to the rim.
_RIM = 0.7

#: A point deep in the head from which the outer sheets are seen from behind (mm).
_DEEP = np.array([-0.67, -100.0, 1490.0])


def strip(skin: Surface, spacing: float, corners: Sequence[Sequence[float]]) -> Sheet:
    """Lay coordinates on a four-sided sheet.

    Parameters
    ----------
    skin : Surface
        A closed surface without handles, evenly triangulated (`clean_skin`).
    spacing : float
        Size of its triangles (mm).
    corners : four directions
        Each corner is the vertex farthest in its direction. The first two are the corners of the
        end where *along* is 0, the third and fourth of the end where it is 1; *across* is 0 from
        the first to the fourth and 1 from the second to the third.

    Raises
    ------
    SolveError
        The rim does not part the surface into two sheets.
    """
    rim = _rim_sharpness(skin, spacing)
    n = len(skin.vertices)
    marks = [int(np.argmax(skin.vertices @ np.asarray(c, dtype=float))) for c in corners]
    links = skin.vertices[skin.faces] - np.roll(skin.vertices[skin.faces], -1, axis=1)
    pairs = np.stack([skin.faces, np.roll(skin.faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    # The way from corner to corner keeps to the rim, where it is cheaper by far; longer
    # ways are found later and keep off those already taken.
    price = np.linalg.norm(links, axis=2).ravel() * (1.2 - np.sqrt(rim[pairs]).mean(axis=1))
    chords = [
        np.linalg.norm(skin.vertices[marks[k]] - skin.vertices[marks[k - 3]]) for k in range(4)
    ]
    taken = np.zeros(n, dtype=bool)
    paths: dict[int, np.ndarray] = {}
    for k in np.argsort(chords):
        start, end = marks[k], marks[k - 3]
        others = taken.copy()
        others[marks] = True
        others[[start, end]] = False
        free = ~others[pairs].any(axis=1)
        graph = coo_array((price[free], (pairs[free, 0], pairs[free, 1])), shape=(n, n)).tocsr()
        gap, previous = dijkstra(graph, indices=start, return_predecessors=True)
        if not np.isfinite(gap[end]):
            raise SolveError(f"{skin.name}: no way along the rim; set other corners")
        path = [end]
        while path[-1] != start:
            path.append(int(previous[path[-1]]))
        paths[int(k)] = np.array(path)
        taken[path] = True
    on_path = np.zeros(n, dtype=bool)
    on_path[np.concatenate(list(paths.values()))] = True
    border = (rim > _RIM) | on_path
    gaps = np.stack(
        [_gap(skin.vertices[border], skin.vertices[paths[k]]) for k in range(4)], axis=1
    )
    number = np.flatnonzero(border)
    nearest = gaps.argmin(axis=1)
    # Creases inside the sheets are no rim.
    real = gaps.min(axis=1) < 6.0 * spacing
    edges = [np.union1d(number[real & (nearest == k)], paths[k]) for k in range(4)]
    laplacian = _laplacian(skin)
    along = _harmonic(laplacian, edges[0], edges[2])
    across = _harmonic(laplacian, edges[3], edges[1])
    border = np.zeros(n, dtype=bool)
    border[np.concatenate(edges)] = True
    return Sheet(skin, along, across, _sides(skin, border), closed=False)


def ring(skin: Surface, spacing: float, start: Sequence[float]) -> Sheet:
    """Lay coordinates on a ring-shaped sheet.

    Parameters
    ----------
    skin : Surface
        A closed surface with one handle, evenly triangulated (`clean_skin`).
    spacing : float
        Size of its triangles (mm).
    start : (3,) sequence
        Direction, seen from the middle of the ring, in which *along* is 0. It grows
        anti-clockwise for someone who looks at the face.

    Raises
    ------
    SolveError
        The rim does not part the surface into two sheets.
    """
    rim = _rim_sharpness(skin, spacing) > _RIM
    centred = skin.vertices - skin.vertices.mean(axis=0)
    axis = np.linalg.eigh(centred.T @ centred)[1][:, 0]
    axis = axis * np.sign(axis @ (skin.vertices.mean(axis=0) - _DEEP))
    first = np.asarray(start, dtype=float) - axis * (axis @ np.asarray(start, dtype=float))
    first = first / np.linalg.norm(first)
    second = np.cross(axis, first)
    angle = np.arctan2(centred @ second, centred @ first) / (2.0 * np.pi)
    laplacian = _laplacian(skin)
    # The harmonic angle differs from the plain one by a single-valued function, whose Laplacian
    # balances the divergence of the plain angle's differences.
    entries = laplacian.tocoo()
    turn = angle[entries.col] - angle[entries.row]
    turn = turn - np.round(turn)
    divergence = np.bincount(entries.row, entries.data * turn, minlength=len(angle))
    kept = np.flatnonzero(np.arange(len(angle)) > 0)
    shift = np.zeros(len(angle))
    shift[kept] = _solve(laplacian, kept, -divergence[kept])
    along = angle + shift
    shells = _labels(skin, rim)
    loops = sorted(
        (np.flatnonzero(shells == label) for label in np.unique(shells[shells >= 0])), key=len
    )[-2:]
    if len(loops) < 2:
        raise SolveError(f"{skin.name}: the rim of the ring is not two loops; clean it anew")
    loops.sort(key=lambda loop: float(np.linalg.norm(centred[loop], axis=1).mean()))
    across = _harmonic(laplacian, loops[0], loops[1])
    # Zero where asked for, on the whole.
    ahead = np.abs(np.angle(np.exp(2j * np.pi * angle))) < 0.1
    along = along - np.median(along[ahead] - angle[ahead])
    border = np.zeros(len(angle), dtype=bool)
    border[np.concatenate(loops)] = True
    return Sheet(skin, along % 1.0, across, _sides(skin, border), closed=True)


def _gap(points: np.ndarray, path: np.ndarray) -> np.ndarray:
    """Distance of points to the nearest vertex of a path."""
    return np.asarray(cKDTree(path).query(points)[0])


def _laplacian(skin: Surface) -> csr_array:
    """Return the positive Laplacian with cotangent weights.

    The weights are kept within bounds, so that slivers do no harm and the maximum principle
    holds.
    """
    n = len(skin.vertices)
    rows, columns, weights = [], [], []
    for k in range(3):
        a, b, c = (skin.vertices[skin.faces[:, (k + turn) % 3]] for turn in range(3))
        twice_area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        cotangent = ((b - a) * (c - a)).sum(axis=1) / np.maximum(twice_area, 1e-12)
        rows.append(skin.faces[:, (k + 1) % 3])
        columns.append(skin.faces[:, (k + 2) % 3])
        weights.append(0.5 * np.clip(cotangent, 0.02, 20.0))
    half = coo_array(
        (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), shape=(n, n)
    ).tocsr()
    whole = half + half.T
    return csr_array(diags_array(whole.sum(axis=1)) - whole)


def _harmonic(laplacian: csr_array, zero: np.ndarray, one: np.ndarray) -> np.ndarray:
    """Solve the Laplace equation with value 0 and 1 on some vertices."""
    value = np.zeros(laplacian.shape[0])
    value[one] = 1.0
    free = np.ones(len(value), dtype=bool)
    free[zero] = free[one] = False
    inner = np.flatnonzero(free)
    right = -(laplacian @ value)[inner]
    value[inner] = _solve(laplacian, inner, right)
    return value


def _solve(laplacian: csr_array, kept: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve the part of a Laplace system that belongs to some vertices."""
    part = laplacian[kept][:, kept].tocsc()
    factors = splu(part, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    return np.asarray(factors.solve(right))


def _labels(skin: Surface, chosen: np.ndarray) -> np.ndarray:
    """Return the number of the connected patch of chosen vertices; -1 for the others."""
    n = len(skin.vertices)
    pairs = np.stack([skin.faces, np.roll(skin.faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    pairs = pairs[chosen[pairs].all(axis=1)]
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return np.asarray(np.where(chosen, connected_components(graph, directed=False)[1], -1))


def _sides(skin: Surface, border: np.ndarray) -> np.ndarray:
    """Tell the outer (1) from the inner sheet (0); -1 on the border and on stray patches."""
    labels = _labels(skin, ~border)
    found, counts = np.unique(labels[labels >= 0], return_counts=True)
    order = np.argsort(-counts)
    if len(found) < 2 or counts[order[1]] < 0.3 * counts[order[0]]:
        raise SolveError(f"{skin.name}: its rim does not part two sheets; set other corners")
    normals = igl.per_vertex_normals(skin.vertices, skin.faces)
    out = (normals * (skin.vertices - _DEEP)).sum(axis=1)
    sheets = sorted(found[order[:2]], key=lambda label: float(out[labels == label].sum()))
    side = np.full(len(labels), -1)
    for k, label in enumerate(sheets):
        side[labels == label] = k
    return side


def _rim_sharpness(skin: Surface, spacing: float) -> np.ndarray:
    """Tell how far the surface's normal leaves the normal of the thin body, at every vertex.

    Returns
    -------
    (n,) array
        0 on a sheet, 1 on the rim: the sine of the angle between the surface's normal and the
        direction in which the body around the vertex is thinnest.
    """
    import pyvista as pv

    reach = max(1.0, 2.0 * skin.volume / skin.area)
    room = 3.0 * reach
    low, high = skin.bounds + np.array([[-room], [room]])
    shape = np.ceil((high - low) / spacing).astype(int) + 1
    image = pv.ImageData(dimensions=tuple(shape), spacing=(spacing,) * 3, origin=low)
    mesh = pv.PolyData.from_regular_faces(skin.vertices, skin.faces)
    mask = mesh.voxelize_binary_mask(reference_volume=image)["mask"]
    body = np.reshape(mask, shape, order="F").astype(np.float32)
    axes = [(spacing * np.arange(shape[k])).astype(np.float32) for k in range(3)]
    grid = np.meshgrid(*axes, indexing="ij", sparse=True)
    places = ((skin.vertices - low) / spacing).T

    def blurred(field: np.ndarray) -> np.ndarray:
        smooth = ndimage.gaussian_filter(field, reach / spacing, mode="constant", truncate=3.0)
        return np.asarray(ndimage.map_coordinates(smooth, places, order=1), dtype=np.float64)

    mass = blurred(body)
    mean = np.stack([blurred(body * grid[k]) for k in range(3)], axis=1) / mass[:, None]
    spread = np.empty((len(places[0]), 3, 3))
    for i in range(3):
        for j in range(i + 1):
            second = blurred(body * grid[i] * grid[j]) / mass
            spread[:, i, j] = spread[:, j, i] = second - mean[:, i] * mean[:, j]
    thinnest = np.linalg.eigh(spread)[1][:, :, 0]
    normals = igl.per_vertex_normals(skin.vertices, skin.faces)
    cosine = np.abs((normals * thinnest).sum(axis=1))
    return np.asarray(np.sqrt(np.maximum(1.0 - cosine**2, 0.0)))
