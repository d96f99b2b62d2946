"""The tissue template: a regular grid of half the face with slits for mouth and eye.

Columns ``i`` run from the mid-plane to the front of the ear, rows ``j`` from the cut
through the neck to the scalp. The mouth and the eye are slits: one grid line doubled
between two shared end nodes (commissure, canthi), so that the field is C1 everywhere
but across the slits. The table below says where on the skin the grid passes; what it
leaves open is interpolated by a thin-plate spline and then fitted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..anatomy.surface import Surface
from ..hermite import HermiteMesh
from ..hermite.basis import Array

_Scalar = TypeVar("_Scalar", bound=np.generic)

#: Elements across (mid-plane to ear) and up (neck to scalp).
COLUMNS, ROWS = 12, 21
#: Row of the mouth's slit and its last column (the commissure).
MOUTH_ROW, COMMISSURE = 7, 4
#: Row of the border of the jaw: what lies below belongs to the neck.
JAW_ROW = 3
#: Row of the eye's slit, columns of its canthi.
EYE_ROW, MEDIAL_CANTHUS, LATERAL_CANTHUS = 14, 3, 7
#: Row along the brow, and column of the nasolabial fold.
BROW_ROW, FOLD_COLUMN = 16, 5
#: Height of the cut through the neck (mm).
NECK_CUT = 1412.0

_ = np.nan

#: (i, j): where the grid passes, in mm of the BodyParts3D frame. The missing coordinate
#: is found on the skin: x from the side, y from the front, z from below.
GUIDES: dict[tuple[int, int], tuple[float, float, float]] = {
    # the cut through the neck, and the floor of the mouth
    (0, 0): (-0.67, _, 1412.0),
    (4, 0): (18.0, _, 1412.0),
    (8, 0): (36.0, _, 1412.0),
    (12, 0): (_, -109.0, 1412.0),
    (0, 1): (-0.67, _, 1421.5),
    (4, 1): (19.0, _, 1423.0),
    (8, 1): (38.0, _, 1431.0),
    (12, 1): (_, -109.0, 1430.0),
    (0, 2): (-0.67, -161.0, _),
    (4, 2): (21.0, -155.0, _),
    (6, 2): (31.5, -147.0, _),
    (8, 2): (41.5, -135.0, _),
    (12, 2): (_, -110.0, 1446.0),
    # the chin and the border of the jaw
    (0, 3): (-0.67, -183.0, _),
    (4, 3): (22.0, -173.5, _),
    (6, 3): (33.0, -163.0, _),
    (8, 3): (43.0, -150.0, _),
    (12, 3): (_, -111.0, 1458.0),
    (0, 4): (-0.67, _, 1441.0),
    (4, 4): (25.0, _, 1442.0),
    (6, 4): (35.0, _, 1451.0),
    (8, 4): (_, -156.0, 1460.0),
    (12, 4): (_, -112.0, 1467.0),
    (0, 5): (-0.67, _, 1452.0),
    (4, 5): (26.0, _, 1452.0),
    (6, 5): (36.0, _, 1458.5),
    (8, 5): (_, -157.0, 1466.5),
    (12, 5): (_, -113.0, 1475.0),
    # lips: vermilion border, parting line, vermilion border
    (0, 6): (-0.67, _, 1460.2),
    (2, 6): (13.0, _, 1460.5),
    (4, 6): (25.5, _, 1461.8),
    (5, 6): (31.0, _, 1462.5),
    (6, 6): (36.5, _, 1464.0),
    (8, 6): (_, -158.0, 1472.0),
    (12, 6): (_, -113.5, 1482.0),
    (0, 7): (-0.67, _, 1467.4),
    (1, 7): (6.3, _, 1467.5),
    (2, 7): (12.8, _, 1467.7),
    (3, 7): (19.3, _, 1468.0),
    (4, 7): (25.6, _, 1468.4),
    (5, 7): (31.5, _, 1468.6),
    (6, 7): (37.5, _, 1470.0),
    (8, 7): (_, -158.0, 1477.5),
    (12, 7): (_, -114.0, 1488.5),
    (0, 8): (-0.67, _, 1475.3),
    (2, 8): (12.5, _, 1475.5),
    (4, 8): (25.0, _, 1475.0),
    (5, 8): (30.5, _, 1475.0),
    (6, 8): (37.5, _, 1476.5),
    (8, 8): (_, -158.0, 1483.0),
    (12, 8): (_, -114.0, 1494.5),
    # upper lip, base and wing of the nose
    (0, 9): (-0.67, _, 1481.8),
    (2, 9): (11.0, _, 1482.0),
    (4, 9): (22.5, _, 1481.5),
    (5, 9): (28.0, _, 1481.5),
    (6, 9): (36.5, _, 1483.0),
    (8, 9): (_, -158.0, 1489.0),
    (12, 9): (_, -114.0, 1500.5),
    (0, 10): (-0.67, _, 1487.6),
    (2, 10): (8.5, _, 1487.6),
    (3, 10): (13.0, _, 1488.0),
    (4, 10): (18.5, _, 1488.4),
    (5, 10): (24.5, _, 1488.6),
    (6, 10): (34.5, _, 1490.0),
    (8, 10): (_, -159.0, 1496.0),
    (12, 10): (_, -114.0, 1506.5),
    (0, 11): (-0.67, _, 1494.2),
    (1, 11): (5.3, _, 1493.6),
    (2, 11): (10.6, _, 1493.6),
    (3, 11): (14.6, _, 1494.8),
    (4, 11): (17.6, _, 1495.6),
    (5, 11): (22.2, _, 1496.0),
    (6, 11): (32.5, _, 1497.5),
    (8, 11): (_, -160.0, 1503.5),
    (12, 11): (_, -114.0, 1513.0),
    (0, 12): (-0.67, _, 1502.5),
    (1, 12): (5.3, _, 1502.0),
    (2, 12): (10.2, _, 1502.0),
    (3, 12): (14.2, _, 1502.8),
    (4, 12): (17.6, _, 1503.5),
    (5, 12): (22.5, _, 1504.5),
    (6, 12): (31.5, _, 1505.5),
    (7, 12): (41.0, _, 1507.5),
    (8, 12): (_, -159.5, 1511.0),
    (12, 12): (_, -114.0, 1519.5),
    # eye: lower orbit, the slit, upper orbit
    (0, 13): (-0.67, _, 1513.5),
    (2, 13): (8.5, _, 1513.5),
    (3, 13): (13.0, _, 1513.8),
    (4, 13): (18.2, _, 1514.0),
    (5, 13): (25.5, _, 1514.3),
    (6, 13): (33.5, _, 1515.0),
    (7, 13): (41.0, _, 1517.0),
    (8, 13): (_, -157.0, 1519.5),
    (12, 13): (_, -114.0, 1525.7),
    (0, 14): (-0.67, _, 1526.0),
    (2, 14): (9.8, _, 1526.0),
    (3, 14): (15.9, _, 1526.0),
    (7, 14): (42.3, _, 1526.5),
    (8, 14): (47.8, _, 1527.2),
    (9, 14): (_, -154.0, 1528.0),
    (12, 14): (_, -114.0, 1532.0),
    (0, 15): (-0.67, _, 1536.5),
    (2, 15): (9.3, _, 1537.0),
    (3, 15): (15.5, _, 1537.5),
    (5, 15): (29.5, _, 1539.5),
    (7, 15): (43.0, _, 1537.8),
    (8, 15): (49.2, _, 1537.0),
    (12, 15): (_, -114.0, 1540.0),
    # brow and forehead, over the whole of frontalis
    (0, 16): (-0.67, _, 1547.0),
    (2, 16): (9.5, _, 1547.7),
    (3, 16): (15.8, _, 1549.2),
    (5, 16): (30.0, _, 1552.0),
    (7, 16): (43.8, _, 1550.5),
    (8, 16): (_, -162.0, 1548.5),
    (12, 16): (_, -114.0, 1550.0),
    (0, 17): (-0.67, _, 1558.5),
    (3, 17): (16.0, _, 1560.5),
    (5, 17): (30.0, _, 1562.5),
    (7, 17): (43.3, _, 1561.5),
    (8, 17): (_, -163.0, 1560.0),
    (12, 17): (_, -114.0, 1562.0),
    (0, 18): (-0.67, _, 1571.0),
    (3, 18): (16.0, _, 1572.5),
    (5, 18): (30.0, _, 1574.0),
    (7, 18): (42.5, _, 1573.5),
    (8, 18): (_, -162.0, 1572.5),
    (12, 18): (_, -114.0, 1574.0),
    (0, 19): (-0.67, _, 1584.0),
    (3, 19): (15.5, _, 1585.5),
    (5, 19): (28.7, _, 1586.5),
    (7, 19): (40.5, _, 1586.5),
    (8, 19): (_, -160.0, 1585.5),
    (12, 19): (_, -114.0, 1586.0),
    (0, 20): (-0.67, _, 1598.0),
    (3, 20): (15.0, _, 1598.0),
    (5, 20): (27.5, _, 1599.0),
    (7, 20): (38.5, _, 1599.5),
    (8, 20): (_, -154.0, 1599.0),
    (12, 20): (_, -114.0, 1598.0),
    (0, 21): (-0.67, _, 1611.5),
    (3, 21): (14.5, _, 1612.0),
    (5, 21): (26.5, _, 1612.5),
    (7, 21): (36.5, _, 1612.5),
    (8, 21): (_, -147.0, 1612.0),
    (12, 21): (_, -114.0, 1609.5),
}

#: Margins of the eye's slit between the canthi: column, x, z of the lower and upper lid.
LIDS: tuple[tuple[int, float, float, float], ...] = (
    (4, 22.3, 1522.9, 1529.9),
    (5, 28.8, 1521.9, 1531.5),
    (6, 35.5, 1522.8, 1530.6),
)


@dataclass(frozen=True)
class Slit:
    """A doubled grid line: interior columns belong to an upper and a lower node."""

    row: int
    first: int
    last: int
    open_start: bool

    def interior(self) -> range:
        """Columns whose node is doubled."""
        return range(self.first if self.open_start else self.first + 1, self.last)

    def ends(self) -> tuple[int, ...]:
        """Columns of the shared nodes at its ends."""
        return (self.last,) if self.open_start else (self.first, self.last)


MOUTH = Slit(MOUTH_ROW, 0, COMMISSURE, open_start=True)
EYE = Slit(EYE_ROW, MEDIAL_CANTHUS, LATERAL_CANTHUS, open_start=False)
SLITS = (MOUTH, EYE)


@dataclass(frozen=True)
class Layout:
    """Numbering of the template.

    A version is a node that shares its place with another: at the end of a slit the
    elements above and below it have a derivative along the slit of their own, so that
    the opening has a corner there and not a cusp.

    Attributes
    ----------
    node : (COLUMNS + 1, ROWS + 1) int array
        Node of the grid point; on a slit the lower one.
    upper : dict (i, j) -> int
        Upper nodes of the slits.
    versions : dict (i, j, above) -> int
        Versions at the ends of the slits.
    corners : (COLUMNS * ROWS, 4) int array
        Nodes of every quadrilateral, columns fastest.
    index : (n_nodes, 4) int array
        Parameter of a node's value, d1, d2 and d12.
    """

    node: NDArray[np.int64]
    upper: dict[tuple[int, int], int]
    versions: dict[tuple[int, int, bool], int]
    corners: NDArray[np.int64]
    index: NDArray[np.int64]

    @property
    def n_nodes(self) -> int:
        """Number of nodes of the surface grid, versions included."""
        return len(self.index)

    @property
    def n_params(self) -> int:
        """Number of parameters of the surface grid."""
        return int(self.index.max()) + 1

    def element(self, i: int, j: int) -> int:
        """Element of column ``i`` and row ``j``."""
        return j * COLUMNS + i

    def at(self, i: int, j: int, above: bool) -> int:
        """Node of a grid point as seen from above or below the grid line."""
        return self.upper.get((i, j), int(self.node[i, j])) if above else int(self.node[i, j])

    def along(self, slit: Slit, above: bool) -> list[int]:
        """Nodes along one side of a slit, the versions of its ends included."""
        columns = range(slit.first, slit.last + 1)
        return [
            self.versions.get((i, slit.row, above), self.at(i, slit.row, above)) for i in columns
        ]

    def gather(self, parameters: Array) -> Array:
        """Return nodal derivatives (n_nodes, 4, 3) from surface parameters (n_params, 3)."""
        return np.asarray(parameters[self.index])

    def scatter(self, nodal: NDArray[_Scalar]) -> NDArray[_Scalar]:
        """Return surface parameters (n_params, ...) from nodal values (n_nodes, 4, ...)."""
        out = np.zeros((self.n_params, *nodal.shape[2:]), dtype=nodal.dtype)
        # Written backwards: where a version shares a parameter, the regular node has the word.
        out[self.index[::-1].ravel()] = nodal[::-1].reshape(-1, *nodal.shape[2:])
        return out

    def surface(self, parameters: Array) -> HermiteMesh:
        """Return the surface mesh with parameters (n_params, 3)."""
        return mesh_of(self.index[self.corners], parameters)


def mesh_of(columns: NDArray[np.int64], parameters: Array) -> HermiteMesh:
    """Build a mesh whose local parameters are picked from the global ones.

    Parameters
    ----------
    columns : (n_elements, 2**dim, 2**dim) int array
        Parameter of every corner and derivative.
    parameters : (n_params, 3) array
    """
    size = columns[0].size
    extraction = sp.csr_matrix(
        (np.ones(columns.size), columns.ravel(), np.arange(columns.size + 1)),
        shape=(columns.size, len(parameters)),
    )
    return HermiteMesh({4: 1, 16: 2, 64: 3}[size], np.asarray(parameters, dtype=float), extraction)


def layout() -> Layout:
    """Give numbers to the nodes, elements and parameters of the template."""
    node = np.arange((COLUMNS + 1) * (ROWS + 1)).reshape(ROWS + 1, COLUMNS + 1).T
    upper: dict[tuple[int, int], int] = {}
    versions: dict[tuple[int, int, bool], int] = {}
    for slit in SLITS:
        for i in slit.interior():
            upper[i, slit.row] = node.size + len(upper)
    for slit in SLITS:
        for i in slit.ends():
            for above in (False, True):
                versions[i, slit.row, above] = node.size + len(upper) + len(versions)
    corners = np.zeros((COLUMNS * ROWS, 4), dtype=np.int64)
    for j in range(ROWS):
        for i in range(COLUMNS):
            near = [upper.get((i + s, j), int(node[i + s, j])) for s in (0, 1)]
            far = [int(node[i + s, j + 1]) for s in (0, 1)]
            corners[j * COLUMNS + i] = near + far
    for (i, j, above), version in versions.items():
        for slit in SLITS:
            if j == slit.row and i in slit.ends():
                column = i if i == slit.first else i - 1
                corner = (0 if above else 2) + (0 if i == slit.first else 1)
                corners[(j if above else j - 1) * COLUMNS + column, corner] = version
    plain = node.size + len(upper)
    index = np.arange(plain * 4).reshape(plain, 4)
    shared = [index[node[i, j]].copy() for i, j, _above in versions]
    for number, row in enumerate(shared):
        row[[1, 3]] = plain * 4 + 2 * number + np.arange(2)
    return Layout(node, upper, versions, corners, np.vstack([index, *shared]))


def guide_points(skin: Surface) -> tuple[Array, Array]:
    """Complete the guides on the outer sheet of the skin.

    Returns
    -------
    grid : (n, 2) array
        Column and row.
    points : (n, 3) array
        Points on the skin (mm).
    """
    keys, points = np.array(list(GUIDES), dtype=float), np.array(list(GUIDES.values()))
    for axis, (start, direction) in enumerate(
        [(200.0, (-1.0, 0.0, 0.0)), (-400.0, (0.0, 1.0, 0.0)), (1400.0, (0.0, 0.0, 1.0))]
    ):
        rows = np.isnan(points[:, axis])
        origins = points[rows].copy()
        origins[:, axis] = start
        points[rows] = skin.first_hits(origins, np.array(direction))
    return keys, points


def place_nodes(plan: Layout, skin: Surface) -> Array:
    """Place the surface nodes: guides, thin-plate spline, closest point of the skin.

    Returns
    -------
    (n_nodes, 3) array
    """
    keys, points = guide_points(skin)
    lids = np.array([[i, EYE_ROW] for i, *_ in LIDS], dtype=float)
    middle = np.array([[x, np.nan, 0.5 * (low + high)] for _, x, low, high in LIDS])
    rims = {}
    for part, column in (("lower", 2), ("upper", 3)):
        origins = np.array([[lid[1], -400.0, lid[column]] for lid in LIDS])
        shift = np.array([0.0, 0.0, -1.2 if part == "lower" else 1.2])
        hit = skin.first_hits(origins + shift, np.array([0.0, 1.0, 0.0]))
        rims[part] = np.column_stack([origins[:, 0], hit[:, 1], origins[:, 2]])
    middle[:, 1] = 0.5 * (rims["lower"][:, 1] + rims["upper"][:, 1])
    # Slow to import, and of all commands only a build needs it.
    from scipy.interpolate import RBFInterpolator

    spline = RBFInterpolator(
        np.vstack([keys, lids]), np.vstack([points, middle]), kernel="thin_plate_spline"
    )
    out = np.zeros((plan.n_nodes, 3))
    grid = np.stack(np.meshgrid(np.arange(COLUMNS + 1), np.arange(ROWS + 1), indexing="ij"), 2)
    out[plan.node] = spline(grid.reshape(-1, 2).astype(float)).reshape(*grid.shape[:2], 3)
    for (i, j), node in plan.upper.items():
        out[node] = out[plan.node[i, j]]
    for (i, j, _above), node in plan.versions.items():
        out[node] = out[plan.node[i, j]]
    out = skin.closest(out).points
    for number, (i, *_coordinates) in enumerate(LIDS):
        out[plan.node[i, EYE_ROW]] = rims["lower"][number]
        out[plan.upper[i, EYE_ROW]] = rims["upper"][number]
    return out


def differentiate(plan: Layout, values: Array, along: int) -> Array:
    """Differentiate a nodal field along columns (0: lateral) or rows (1: up), breaking at slits.

    Parameters
    ----------
    values : (n_nodes, m) array

    Returns
    -------
    (n_nodes, m) array
        Derivatives per element; a doubled node has one on either side of its slit.
    """
    out = np.zeros_like(values)
    lines: list[list[int]] = []
    if along == 0:
        lines += [[int(n) for n in plan.node[:, j]] for j in range(ROWS + 1)]
        lines = [plan.along(slit, above) for slit in SLITS for above in (False, True)] + lines
    else:
        for i in range(COLUMNS + 1):
            line: list[int] = []
            for j in range(ROWS + 1):
                line.append(int(plan.node[i, j]))
                if (i, j) in plan.upper:
                    lines.append(line)
                    line = [plan.upper[i, j]]
            lines.append(line)
    written = np.zeros(len(values), dtype=bool)
    for line in lines:
        slope = np.gradient(values[line], axis=0, edge_order=2 if len(line) > 2 else 1)
        fresh = [k for k, n in enumerate(line) if not written[n]]
        out[np.array(line)[fresh]] = slope[fresh]
        written[line] = True
    if along == 1:
        for (i, j, _above), node in plan.versions.items():
            out[node] = out[plan.node[i, j]]
    return out
