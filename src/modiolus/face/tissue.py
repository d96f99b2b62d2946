"""The tissue mesh of half the face: outer surface on the skin, inner one on the deep structures.

The outer surface is a bicubic Hermite surface fitted to the outer sheet of the skin. The inner
one is found by shrinking it: every point of a fine lattice travels inward until it meets the
deep structures or has gone as deep as the layer may be there, with its travel smoothed in
between, so that the envelope is free of folds. Both share one topology and span one layer of
tricubic elements.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..anatomy.distance import DistanceGrid
from ..anatomy.surface import MIDPLANE, Surface
from ..fitting import PointTarget, Smoothing, SurfaceTarget, fit
from ..hermite import HermiteMesh, Side
from ..hermite.basis import Array
from .template import (
    COLUMNS,
    COMMISSURE,
    EYE,
    EYE_ROW,
    JAW_ROW,
    LATERAL_CANTHUS,
    LIDS,
    MEDIAL_CANTHUS,
    MOUTH,
    MOUTH_ROW,
    NECK_CUT,
    ROWS,
    SLITS,
    Layout,
    differentiate,
    layout,
    mesh_of,
    place_nodes,
)

#: Centre and radius of the eyeball that the lids rest on (mm). The source's balls are 31 mm
#: across and stand 4 mm before the lids; this one has the 24 mm of an adult eye
#: (Bekerman et al. 2014) and touches the inside of the lids.
EYE_CENTRE = (27.1, -156.2, 1527.2)
EYE_RADIUS = 12.0

#: Subdivisions of an element in the lattice that is shrunk onto the deep structures.
LATTICE = 4
#: Points an element in each direction at which its clearance is checked last.
_FINE = 6
#: Distance that the inner surface keeps from the deep structures (mm).
MARGIN = 0.5

#: Greatest depth of the layer (mm) by column and row of the grid; between them linear.
DEPTHS: dict[tuple[float, float], float] = {
    (0, 0): 8, (6, 0): 9, (12, 0): 9,
    (0, 1): 9, (6, 1): 10, (12, 1): 10,
    (0, 2): 11, (4, 2): 11, (8, 2): 12, (12, 2): 11,
    (0, 3): 16, (4, 3): 16, (8, 3): 16, (12, 3): 13,
    (0, 5): 16, (4, 5): 16, (7, 5): 24, (8, 5): 20, (12, 5): 13,
    (7, 4): 22, (8, 4): 20, (7, 6): 24, (8, 6): 20,
    (0, 7): 11, (2, 7): 11, (3, 7): 6, (4, 7): 7.5, (5, 7): 12, (6, 7): 17, (7, 7): 24,
    (8, 7): 22, (10, 7): 18, (12, 7): 12,
    (0, 8): 13, (2, 8): 13, (7, 8): 20,
    (0, 9): 14, (2, 9): 14, (4, 9): 15, (6, 9): 18, (7, 9): 16, (8, 9): 16, (12, 9): 10,
    (0, 10): 16, (2, 10): 16, (3, 10): 15, (4, 10): 14, (5, 10): 16, (8, 10): 17, (12, 10): 8,
    (0, 10.5): 14, (2, 10.5): 14,
    (0, 11): 3.5, (1, 11): 3.5, (2, 11): 4, (3, 11): 4.5, (4, 11): 11, (5, 11): 16,
    (8, 11): 15, (10, 11): 7, (12, 11): 6,
    (0, 12): 3, (1, 12): 3, (2, 12): 3.5, (3, 12): 5, (4, 12): 11, (6, 12): 15, (8, 12): 12,
    (12, 12): 8,
    (0, 13): 4, (2, 13): 5, (3, 13): 7, (5, 13): 9, (7, 13): 9, (9, 13): 8, (12, 13): 7,
    (4, 13.5): 8, (5, 13.5): 8.5, (6, 13.5): 8, (5, 14.5): 6.5,
    (2, 14): 6, (3, 14): 5, (5, 14): 3, (7, 14): 5, (8, 14): 6, (9, 14): 7, (12, 14): 7,
    (0, 15): 8, (3, 15): 7, (5, 15): 6, (7, 15): 7, (9, 15): 7, (12, 15): 7,
    (0, 16): 8, (3, 16): 8, (5, 16): 8, (7, 16): 8, (9, 16): 7, (12, 16): 7,
    (0, 18): 8, (6, 18): 8, (9, 18): 7, (12, 18): 7,
    (0, 21): 8, (6, 21): 8, (9, 21): 8, (12, 21): 8,
}  # fmt: skip

#: Muscles that lie deeper than `DEPTHS`, on the bone beside the nose and under the brow, and in the
#: pocket between jaws and masseter: the layer reaches beneath them, by at most so much (mm) more.
BEDDED: dict[str, float] = {
    "levator_labii_superioris_alaeque_nasi": 3.0,
    "corrugator_supercilii": 3.0,
    "buccinator": 8.0,
}
#: Columns and rows of nodes, first and last, around the pocket. The inner surface may slide along
#: itself there, for the layer's depth to change evenly.
POCKET = ((5, 10), (3, 10))

#: Least thickness (mm) over bone where a muscle lies: the skin is moved out to make room.
LEAST = 3.2
#: Least thickness of the lids and of the nose's skin, and of the skin of the temple (mm).
LEAST_LID, LEAST_TEMPLE = 1.6, 1.5


@dataclass(frozen=True)
class Tissue:
    """The half-face tissue mesh.

    Attributes
    ----------
    mesh : HermiteMesh
        Tricubic, xi1 lateral, xi2 up, xi3 outward; element ``row * COLUMNS + column``.
    sides : dict of (elements, axis, side)
        ``outer``, ``inner``, ``midplane``, ``lip_upper``, ``lip_lower``, ``lid_upper``,
        ``lid_lower``; and the cuts, ``ear``, ``scalp``, ``neck`` across and ``neck_back`` behind.
    landmarks : dict of (element, xi (3,))
        Named places of the left half.
    """

    mesh: HermiteMesh
    sides: dict[str, Side]
    landmarks: dict[str, tuple[int, tuple[float, float, float]]]


def outer_sheet(skin: Surface, directions: int = 64) -> Surface:
    """Return the outer sheet of a double-walled skin.

    A triangle is on the outer sheet when rays from it into the half-space before it mostly
    escape; the lining and the insides see the other wall.
    """
    centres = skin.vertices[skin.faces].mean(axis=1)
    open_ = skin.escaping(centres, skin.normals, directions) > 0.3
    return skin.picked(skin.faces[open_]).largest_component()


def eyeball() -> Surface:
    """Return the left eyeball as a sphere."""
    import pyvista

    ball = pyvista.Icosphere(radius=EYE_RADIUS, center=EYE_CENTRE, nsub=4)
    return Surface(ball.points, ball.regular_faces, "eyeball")


@dataclass(frozen=True)
class _Lattice:
    """Points of a surface mesh's refinement and their neighbours."""

    elements: NDArray[np.int64]
    xi: Array
    place: Array
    points: Array
    quads: NDArray[np.int64]
    average: sp.csr_matrix

    def inward(self, points: Array) -> Array:
        """Return unit normals of the lattice that point into the head, (n, 3)."""
        diagonals = points[self.quads[:, 2]] - points[self.quads[:, 0]]
        across = points[self.quads[:, 3]] - points[self.quads[:, 1]]
        normals = np.zeros_like(points)
        for corner in range(4):
            np.add.at(normals, self.quads[:, corner], np.cross(across, diagonals))
        return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def _lattice(surface: HermiteMesh, divisions: int) -> _Lattice:
    fine = surface.refine((divisions, divisions))
    index, first = fine.corner_nodes()
    parent, child = np.divmod(first[:, 0], divisions**2)
    xi = np.stack([child % divisions, child // divisions], axis=1).astype(float)
    xi = (xi + np.stack([first[:, 1] & 1, first[:, 1] >> 1], axis=1)) / divisions
    place = xi + np.stack([parent % COLUMNS, parent // COLUMNS], axis=1)
    quads = index[:, [0, 1, 3, 2]]
    pairs = np.vstack([quads[:, [k, (k + 1) % 4]] for k in range(4)])
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    graph = sp.coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(first),) * 2)
    graph = sp.csr_matrix(graph + graph.T)
    average = sp.diags(1.0 / np.asarray(graph.sum(axis=1)).ravel()) @ graph
    return _Lattice(parent, xi, place, surface.evaluate(parent, xi), quads, sp.csr_matrix(average))


def _depth_limit(place: Array) -> Array:
    # Slow to import, and of all commands only a build needs it.
    from scipy.interpolate import RBFInterpolator

    spline = RBFInterpolator(
        np.array(list(DEPTHS), dtype=float), np.array(list(DEPTHS.values())), kernel="linear"
    )
    return np.asarray(np.clip(spline(place), 1.5, 26.0))


def _deeper(
    lattice: _Lattice,
    limit: Array,
    bedded: Mapping[str, Surface],
    hard: Mapping[str, DistanceGrid],
) -> Array:
    """Return by how much (mm) the layer exceeds its limit to lie beneath muscles, (n,)."""
    tree = cKDTree(lattice.points)
    deeper = np.zeros(len(limit))
    for name, body in bedded.items():
        points = body.samples(0.5)
        points = points[_nearest(hard, points)[0] > 0.0]
        depth, at = tree.query(points)
        np.maximum.at(deeper, at, np.minimum(depth + MARGIN - limit[at], BEDDED[name]))
    # Wider than the muscles by two points, so that smoothing leaves them their room.
    rows, columns = lattice.average.nonzero()
    for _widen in range(2):
        narrow = deeper.copy()
        np.maximum.at(deeper, rows, narrow[columns])
    for _smooth in range(6):
        deeper = 0.5 * deeper + 0.5 * (lattice.average @ deeper)
    return deeper


def _backward(place: Array) -> tuple[Array, Array]:
    """Return where the layer goes straight back (n,), from 0 to 1, and that direction (n, 3).

    Under the nose the skin turns downwards, and its normals would cross before they reach the
    maxilla and the nasal spine.
    """
    column, row = place.T
    share = np.clip((5.5 - column) / 2.0, 0.0, 1.0)
    share = share * np.clip(row - 7.0, 0.0, 1.0) * np.clip(11.5 - row, 0.0, 1.0)
    rise = 0.5 * np.clip(row - 9.0, 0.0, 1.0)
    return share, np.stack([np.zeros_like(row), np.ones_like(row), rise], axis=1)


def _nearest(deep: Mapping[str, DistanceGrid], points: Array) -> tuple[Array, Array]:
    """Return distance to and gradient of the nearest deep structure."""
    distance = np.full(len(points), np.inf)
    gradient = np.zeros((len(points), 3))
    for grid in deep.values():
        sample = grid.sample(points)
        closer = sample.distance < distance
        distance[closer] = sample.distance[closer]
        gradient[closer] = sample.gradient[closer]
    return distance, gradient


def boundary_conditions(plan: Layout, nodal: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Put nodal derivatives (n_nodes, 4, 3) on the mid-plane, the cuts and the slits.

    Returns
    -------
    nodal : (n_nodes, 4, 3) array
        The mirror condition holds at the mid-plane and the neck is cut flat.
    held : (n_nodes, 4, 3) bool array
        What a fit must keep.
    """
    nodal = nodal.copy()
    held = np.zeros(nodal.shape, dtype=bool)
    middle = [*plan.node[0], plan.upper[0, MOUTH_ROW]]
    nodal[middle, 0, 0] = MIDPLANE
    nodal[middle, 2, 0] = 0.0
    nodal[middle, 1, 1:] = nodal[middle, 3, 1:] = 0.0
    held[middle, 0, 0] = held[middle, 2, 0] = True
    held[middle, 1, 1:] = held[middle, 3, 1:] = True
    neck = plan.node[:, 0]
    nodal[neck, 0, 2], nodal[neck, 1, 2] = NECK_CUT, 0.0
    held[neck, 0, 2] = held[neck, 1, 2] = True
    ear = plan.node[COLUMNS]
    held[ear, 0, 1] = held[ear, 2, 1] = True
    for above in (False, True):
        for slit in SLITS:
            # The parting line keeps its place in the frontal plane, and the lids all of it.
            held[plan.along(slit, above), 0, 0] = held[plan.along(slit, above), 0, 2] = True
        held[plan.along(EYE, above), 0, 1] = True
    held[plan.along(MOUTH, False), 1, ::2] = held[plan.along(MOUTH, True), 1, ::2] = True
    return nodal, held


def fit_outer(plan: Layout, sheet: Surface, deep: Mapping[str, DistanceGrid]) -> HermiteMesh:
    """Fit the outer surface to the skin and lift it where bone leaves too little room."""
    points = place_nodes(plan, sheet)
    first, second = differentiate(plan, points, 0), differentiate(plan, points, 1)
    nodal = np.stack([points, first, second, differentiate(plan, first, 1)], axis=1)
    nodal, held = boundary_conditions(plan, nodal)
    start = plan.surface(plan.scatter(nodal))
    fixed = plan.scatter(held)
    smoothing = Smoothing(first=2e-4, second=5e-3, relative=True)
    target = SurfaceTarget("skin", _itself, sheet, samples=5, reject=6.0)
    surface = fit(start, [target], smoothing, fixed, iterations=6).mesh
    bones = {name: deep[name] for name in ("skull", "mandible", "eyeball")}
    for _ in range(3):
        lattice = _lattice(surface, LATTICE)
        distance, _ = _nearest(bones, lattice.points)
        over_lid = np.isclose(lattice.place[:, 1], EYE_ROW, atol=0.6)
        over_lid &= (lattice.place[:, 0] > MEDIAL_CANTHUS) & (lattice.place[:, 0] < LATERAL_CANTHUS)
        column, row = lattice.place.T
        # The nose's bridge is thin by nature, and beside the temple there is no muscle.
        least = np.interp(column, [7.5, 9.0], [LEAST, LEAST_TEMPLE]) + MARGIN
        least = np.where(over_lid, LEAST_LID + 0.2, least)
        lift = np.clip(least - distance, 0.0, 2.7)
        lift[(column < 3.0) & (np.abs(row - 12.5) < 2.0)] = 0.0
        for _smooth in range(10):
            lift = np.maximum(lift, 0.0) * 0.5 + 0.5 * (lattice.average @ lift)
        raised = lattice.points + lift[:, None] * -lattice.inward(lattice.points)
        place = PointTarget("lifted", lattice.elements, lattice.xi, raised)
        surface = fit(surface, [place], smoothing, fixed, iterations=1).mesh
    return surface


def _itself(mesh: HermiteMesh) -> HermiteMesh:
    return mesh


def shrink(
    outer: HermiteMesh,
    deep: Mapping[str, DistanceGrid],
    bedded: Mapping[str, Surface],
) -> tuple[_Lattice, Array]:
    """Shrink the outer surface onto the deep structures, beneath muscles that lie on them.

    Returns
    -------
    lattice : _Lattice
        Points of the outer surface.
    inner : (n, 3) array
        Where they arrive.
    """
    lattice = _lattice(outer, LATTICE)
    hard = {name: grid for name, grid in deep.items() if name != "cartilage"}
    column, row = lattice.place.T
    limit = _depth_limit(lattice.place)
    middle = np.abs(lattice.points[:, 0] - MIDPLANE) < 1e-6
    ear, neck = np.isclose(column, COLUMNS), np.isclose(row, 0.0)
    mouth = np.isclose(row, MOUTH_ROW) & (column <= COMMISSURE + 1e-9)
    lids = np.isclose(row, EYE_ROW) & (column >= MEDIAL_CANTHUS) & (column <= LATERAL_CANTHUS)
    limit += np.where(lids, 0.0, _deeper(lattice, limit, bedded, hard))
    travel = np.zeros_like(lattice.points)
    share, backward = _backward(lattice.place)
    stride = 0.4
    # At the free edge the normal of a shrinking sheet is not to be trusted.
    edge = lattice.inward(lattice.points)[ear]

    def hold(field: Array) -> None:
        field[middle, 0] = 0.0
        field[neck, 2] = 0.0
        field[mouth, 2] = 0.0

    for _ in range(80):
        points = lattice.points + travel
        direction = lattice.inward(points)
        direction[ear] = edge
        direction += share[:, None] * (backward - direction)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        direction[mouth, 2] = 0.0
        direction[mouth] /= np.linalg.norm(direction[mouth], axis=1, keepdims=True)
        to_eye = np.array(EYE_CENTRE) - points[lids]
        direction[lids] = to_eye / np.linalg.norm(to_eye, axis=1, keepdims=True)
        distance, gradient = _nearest(hard, points)
        gone = np.linalg.norm(travel, axis=1)
        step = np.clip(distance - MARGIN, -stride, stride)
        ahead = np.minimum(step, np.clip(limit - gone, -stride, stride))
        step = np.where(step > 0.0, ahead, step)
        travel += np.where(
            (step >= 0.0)[:, None], step[:, None] * direction, -step[:, None] * gradient
        )
        smooth = 0.65 * travel + 0.35 * (lattice.average @ travel)
        travel = np.where((mouth | lids)[:, None], travel, smooth)
        hold(travel)
    for _ in range(15):
        distance, gradient = _nearest(hard, lattice.points + travel)
        push = np.clip(MARGIN - distance, 0.0, 0.5) * ~(mouth | lids)
        travel += push[:, None] * gradient
        hold(travel)
    return lattice, lattice.points + travel


def build_tissue(
    skin: Surface, deep: Mapping[str, DistanceGrid], bedded: Mapping[str, Surface]
) -> Tissue:
    """Build the tissue mesh of the left half of the face.

    Parameters
    ----------
    skin : Surface
        Skin of the head, possibly double-walled.
    deep : mapping of DistanceGrid
        Deep structures by name.
    bedded : mapping of Surface
        Muscles that lie on them by name, of `BEDDED`.

    Returns
    -------
    Tissue
    """
    plan = layout()
    outer = fit_outer(plan, outer_sheet(skin), deep)
    lattice, arrived = shrink(outer, deep, bedded)
    nodal, held = boundary_conditions(plan, plan.gather(outer.parameters))
    nearest = _nodes_of(plan, lattice)
    nodal[:, 0] = arrived[nearest]
    held[plan.node[COLUMNS], :, 1] = False
    held[plan.along(EYE, True)] = held[plan.along(EYE, False)] = False
    for above in (True, False):
        held[plan.along(MOUTH, above), :, 0] = False
    held[[plan.node[0, MOUTH_ROW], plan.upper[0, MOUTH_ROW]], ::2, 0] = True
    start = outer.with_parameters(plan.scatter(nodal))
    fixed = plan.scatter(held)
    inner = _fit_envelope(plan, start, outer, lattice, arrived, fixed, deep)
    mesh = _layer(plan, inner.parameters, _closed(plan, outer.parameters))
    return Tissue(mesh, _sides(), _landmarks(plan))


def _fit_envelope(
    plan: Layout,
    start: HermiteMesh,
    outer: HermiteMesh,
    lattice: _Lattice,
    arrived: Array,
    fixed: NDArray[np.bool_],
    deep: Mapping[str, DistanceGrid],
) -> HermiteMesh:
    """Fit the inner surface, and fit again to targets moved off the bone that it still enters.

    Edges of bone run between the points of the lattice: the later fits are to a finer one.
    """
    hard = {name: grid for name, grid in deep.items() if name not in ("cartilage", "masseter")}
    smoothing = Smoothing(first=1e-4, second=5e-3)
    place = PointTarget("envelope", lattice.elements, lattice.xi, arrived)
    mesh = fit(start, [place], smoothing, fixed, iterations=1).mesh
    (first, last), (lowest, highest) = POCKET
    elsewhere = np.ones((plan.n_nodes, 4, 3), dtype=bool)
    elsewhere[plan.node[first : last + 1, lowest : highest + 1]] = False
    place = replace(place, normals=lattice.inward(arrived), sliding=0.02)
    evenly = replace(smoothing, second=5e-2, relative=outer)
    mesh = fit(mesh, [place], evenly, fixed | plan.scatter(elsewhere), iterations=1).mesh
    elements, xi, _ = mesh.gauss_points(_FINE)
    targets = mesh.evaluate(elements, xi)
    for _ in range(40):
        place = PointTarget("envelope", elements, xi, targets)
        mesh = fit(start, [place], smoothing, fixed, iterations=1).mesh
        mesh = mesh.with_parameters(_closed(plan, mesh.parameters))
        distance, gradient = _nearest(hard, mesh.evaluate(elements, xi))
        lack = np.clip(0.4 * MARGIN - distance, 0.0, 1.0)
        if lack.max() < 0.03:
            break
        targets += 2.0 * lack[:, None] * gradient
    return mesh


def _nodes_of(plan: Layout, lattice: _Lattice) -> NDArray[np.int64]:
    """Lattice point of every node."""
    out = np.zeros(plan.n_nodes, dtype=np.int64)
    found = {
        (int(e), round(a), round(b)): k
        for k, (e, (a, b)) in enumerate(zip(lattice.elements, lattice.xi, strict=True))
        if a in (0.0, 1.0) and b in (0.0, 1.0)
    }
    by_node = {}
    for (element, a, b), k in found.items():
        by_node[int(plan.corners[element, a + 2 * b])] = k
    for node in range(plan.n_nodes):
        if node in by_node:
            out[node] = by_node[node]
    for (i, j, _above), node in plan.versions.items():
        main = int(plan.node[i, j])
        known = [by_node[n] for n in (main, node) if n in by_node]
        others = [n for (a, b, _), n in plan.versions.items() if (a, b) == (i, j)]
        known += [by_node[n] for n in others if n in by_node]
        out[node] = out[main] = known[0]
    return out


def _closed(plan: Layout, parameters: Array) -> Array:
    """Let the lips touch: both sides of the mouth's slit get their common line."""
    nodal = plan.gather(parameters)
    lower, upper = plan.along(MOUTH, False), plan.along(MOUTH, True)
    for kind in (0, 1):
        common = 0.5 * (nodal[lower, kind] + nodal[upper, kind])
        nodal[lower, kind] = nodal[upper, kind] = common
    return plan.scatter(nodal)


def _layer(plan: Layout, inner: Array, outer: Array) -> HermiteMesh:
    """Span one layer of tricubic elements, linear in xi3, between two surfaces."""
    count = plan.n_params
    through = outer - inner
    parameters = np.vstack([inner, through, outer, through])
    surface = plan.index[plan.corners]
    layers = [np.concatenate([surface + 2 * k * count, surface + (2 * k + 1) * count], axis=2)
              for k in (0, 1)]  # fmt: skip
    return mesh_of(np.concatenate(layers, axis=1), parameters)


def _sides() -> dict[str, Side]:
    every = np.arange(COLUMNS * ROWS)
    column, row = every % COLUMNS, every // COLUMNS
    mouth = (column >= MOUTH.first) & (column < MOUTH.last)
    eye = (column >= EYE.first) & (column < EYE.last)
    return {
        "outer": (every, 2, 1),
        "inner": (every, 2, 0),
        "midplane": (every[column == 0], 0, 0),
        "ear": (every[(column == COLUMNS - 1) & (row >= JAW_ROW)], 0, 1),
        "neck": (every[row == 0], 1, 0),
        "neck_back": (every[(column == COLUMNS - 1) & (row < JAW_ROW)], 0, 1),
        "scalp": (every[row == ROWS - 1], 1, 1),
        "lip_upper": (every[mouth & (row == MOUTH_ROW)], 1, 0),
        "lip_lower": (every[mouth & (row == MOUTH_ROW - 1)], 1, 1),
        "lid_upper": (every[eye & (row == EYE_ROW)], 1, 0),
        "lid_lower": (every[eye & (row == EYE_ROW - 1)], 1, 1),
    }


def _landmarks(plan: Layout) -> dict[str, tuple[int, tuple[float, float, float]]]:
    middle_lid = LIDS[len(LIDS) // 2][0]
    return {
        "mouth_corner": (plan.element(COMMISSURE, MOUTH_ROW), (0.0, 0.0, 1.0)),
        "upper_lip_mid": (plan.element(0, MOUTH_ROW), (0.0, 0.0, 1.0)),
        "lower_lip_mid": (plan.element(0, MOUTH_ROW - 1), (0.0, 1.0, 1.0)),
        "inner_brow": (plan.element(2, 16), (0.0, 0.0, 1.0)),
        "outer_brow": (plan.element(7, 16), (0.0, 0.0, 1.0)),
        "cheek": (plan.element(6, 11), (0.5, 0.0, 1.0)),
        "ala": (plan.element(3, 11), (0.0, 0.5, 1.0)),
        "chin": (plan.element(0, 4), (0.0, 0.0, 1.0)),
        "upper_lid_mid": (plan.element(middle_lid, EYE_ROW), (0.0, 0.0, 1.0)),
        "lower_lid_mid": (plan.element(middle_lid, EYE_ROW - 1), (0.0, 1.0, 1.0)),
    }
