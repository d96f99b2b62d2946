"""The skin of a head in any state: what scans are projected on, and its regions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..anatomy.surface import Surface
from ..errors import InputError
from ..face.head import Head
from ..face.template import (
    BROW_ROW,
    COLUMNS,
    COMMISSURE,
    EYE_ROW,
    FOLD_COLUMN,
    LATERAL_CANTHUS,
    MEDIAL_CANTHUS,
    MOUTH_ROW,
    ROWS,
)
from ..hermite import HermiteMesh
from ..hermite.locate import closest_in
from ..hermite.tessellate import Mirror, tessellate
from .scan import barycentric

__all__ = ["REGIONS", "STILL_ZONES", "Feet", "Skin", "SkinState"]

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

#: Parts of the face, the first eight those in which errors are reported first.
REGIONS = (
    *("brow", "lids", "nose", "upper_lip", "corners", "lower_lip", "cheek", "chin"),
    *("forehead", "temple", "neck"),
)
#: Parts that keep their place on the skull: the pose of an expression is found from them.
STILL_ZONES = ("forehead", "temple_left", "temple_right", "nose_bridge")

#: Feet at a greater distance (mm), or where the two surfaces look apart, are none.
_REACH = 20.0
_FACING = 0.2
#: Near a slit a unit of difference between normals weighs as much as this distance (mm).
_TURN = 6.0
#: Squared distance of unit normals up to which they count as alike: 60 degrees, for at the edge of
#: skin and lid the normal of a vertex is between those of both.
_ALIKE = 1.0
#: Divisions of an element for the search that the exact projection begins with.
_DIVISIONS = 6


def _region_grid() -> IntArray:
    """Return the region of every element of the template, (ROWS * COLUMNS,)."""
    grid = np.full((ROWS, COLUMNS), REGIONS.index("cheek"))

    def paint(name: str, rows: tuple[int, int], columns: tuple[int, int]) -> None:
        grid[rows[0] : rows[1], columns[0] : columns[1]] = REGIONS.index(name)

    lips = MOUTH_ROW - 2, MOUTH_ROW + 2
    paint("neck", (0, 2), (0, COLUMNS))
    paint("chin", (2, lips[0]), (0, FOLD_COLUMN))
    paint("lower_lip", (lips[0], MOUTH_ROW), (0, COMMISSURE - 1))
    paint("upper_lip", (MOUTH_ROW, lips[1]), (0, COMMISSURE - 1))
    paint("corners", lips, (COMMISSURE - 1, COMMISSURE + 1))
    paint("nose", (lips[1], EYE_ROW - 1), (0, 4))
    paint("nose", (EYE_ROW - 1, EYE_ROW + 1), (0, 2))
    paint("lids", (EYE_ROW - 1, EYE_ROW + 1), (MEDIAL_CANTHUS - 1, LATERAL_CANTHUS + 1))
    paint("brow", (BROW_ROW - 1, BROW_ROW + 1), (0, 8))
    paint("forehead", (BROW_ROW + 1, ROWS), (0, 8))
    paint("temple", (EYE_ROW - 1, ROWS), (8, COLUMNS))
    return grid.ravel()


def _still_grid() -> IntArray:
    """Return the still zone of every element: forehead 0, temple 1, bridge 3, none -1."""
    grid = np.full((ROWS, COLUMNS), -1)
    grid[BROW_ROW + 2 :, :8] = 0
    grid[EYE_ROW:, 8:] = 1
    grid[EYE_ROW - 1 : EYE_ROW + 1, :2] = 3
    return grid.ravel()


@dataclass(frozen=True, eq=False)
class Feet:
    """Where points project on a skin: one row for each.

    Attributes
    ----------
    elements : (n,) int array
        Element of the skin's mesh.
    xi : (n, 2) array
    mirrored : (n,) bool array
        On the mirror image of the half that is modelled.
    points, normals : (n, 3) arrays
    distance : (n,) array
        In mm.
    covered : (n,) bool array
        The point has a counterpart: the foot is not on the border of the skin, is not too far
        off, and the surfaces face the same way.
    """

    elements: IntArray
    xi: Array
    mirrored: BoolArray
    points: Array
    normals: Array
    distance: Array
    covered: BoolArray

    def take(self, rows: IntArray | BoolArray) -> Feet:
        """Return some of the feet, in the given order."""
        return Feet(*(column[rows] for column in self.columns()))

    def columns(self) -> list[NDArray[Any]]:
        """Return the arrays in the order of the attributes."""
        return [getattr(self, item.name) for item in fields(self)]

    @classmethod
    def joined(cls, parts: Sequence[Feet]) -> Feet:
        """Return the feet of several sets, one after the other."""
        return cls(*map(np.concatenate, zip(*(part.columns() for part in parts), strict=True)))


class Skin:
    """The outer surface of a head with the margins of lips and lids.

    Parameters
    ----------
    head : Head

    Attributes
    ----------
    mesh : HermiteMesh
        Surface mesh that shares the tissue's parameters.
    side : (n_elements,) int array
        Beside a slit 1 + the index of the margin: upper lip, lower lip, upper lid, lower lid;
        0 elsewhere.
    """

    def __init__(self, head: Head) -> None:
        head = head if head.half is None else head.half
        self.head = head
        names = ["outer", "lip_upper", "lip_lower", "lid_upper", "lid_lower"]
        sides = [head.sides[name] for name in names]
        self.mesh, self.outward = head.tissue.boundary(sides)
        hosts = np.concatenate([elements for elements, _, _ in sides])
        self._hosts = hosts
        self.side = np.zeros(len(hosts), dtype=np.int64)
        margin = np.repeat(np.arange(5), [len(elements) for elements, _, _ in sides])
        corners = head.tissue.corner_nodes()[0]
        for number, name in enumerate(names[1:], 1):
            beside = head.sides[name][0]
            # One more row beyond the margin belongs to the same lip or lid: what shares the edge
            # of the skin across from it.
            axis, end = head.sides[name][1:]
            shares = [
                ((np.arange(8) >> axis) & 1 == side) & (np.arange(8) >> 2 == 1)
                for side in (1 - end, end)
            ]
            far, near_edge = (np.sort(corners[:, share], axis=1) for share in shares)
            further = np.flatnonzero((near_edge[:, None] == far[beside]).all(axis=2).any(axis=1))
            near = np.isin(hosts, np.concatenate([beside, further])) & (margin == 0)
            self.side[near | (margin == number)] = number
        self.pieces = tessellate(self.mesh, _DIVISIONS, self.outward)
        self._prepare()

    def _prepare(self) -> None:
        """Tabulate the element and local coordinates of every corner of every triangle."""
        cells = self.pieces.cells
        count = (_DIVISIONS + 1) ** 2
        lows = np.arange(_DIVISIONS)
        low = (lows[:, None] * (_DIVISIONS + 1) + lows).ravel()
        corner = low[:, None] + np.array([0, 1, _DIVISIONS + 1, _DIVISIONS + 2])
        samples = np.arange(self.mesh.n_elements)[:, None, None] * count + corner
        turned = self.outward < 0
        samples[turned] = samples[turned][..., [0, 2, 1, 3]]
        triangles = np.concatenate([samples[..., [0, 1, 3]], samples[..., [0, 3, 2]]], axis=2)
        triangles = triangles.reshape(-1, 3)
        vertices = self.pieces.vertex[triangles]
        sound = (vertices != np.roll(vertices, 1, axis=1)).all(axis=1)
        self.cell_samples = triangles[sound]
        self.cell_element = self.pieces.elements[self.cell_samples[:, 0]]
        # Border of the skin, without the mid-plane of a half face.
        edges = np.sort(cells[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        found, counts = np.unique(edges, axis=0, return_counts=True)
        rest = self.pieces.points(self.head.tissue.parameters)
        border = found[counts == 1]
        inside = np.abs(rest[border, 0] - self.head.midplane) < 1e-3
        border = border[~inside.all(axis=1)]
        self.rim = np.zeros(len(rest), dtype=bool)
        self.rim[border.ravel()] = True
        # Elements around every vertex, where a foot near a seam may lie instead.
        owners: list[set[int]] = [set() for _ in rest]
        for vertex, element in zip(self.pieces.vertex, self.pieces.elements, strict=True):
            owners[vertex].add(int(element))
        width = max(len(owner) for owner in owners)
        self.around = np.array(
            [sorted(owner) + [-1] * (width - len(owner)) for owner in owners], dtype=np.int64
        )

    @cached_property
    def region(self) -> IntArray:
        """Index into `REGIONS` for every element of the mesh, (n_elements,).

        Raises
        ------
        InputError
            The skin is not divided as that of the template.
        """
        return np.asarray(_region_grid()[self._cells()])

    @cached_property
    def zone(self) -> IntArray:
        """Index into `STILL_ZONES`, of the left side; -1 where the skin moves, (n_elements,).

        Raises
        ------
        InputError
            The skin is not divided as that of the template.
        """
        return np.asarray(_still_grid()[self._cells()])

    def _cells(self) -> IntArray:
        """Return the place of every element in the grid of the template."""
        count = len(self.head.sides["outer"][0])
        if count != ROWS * COLUMNS:
            raise InputError(
                f"{self.head.name}: its skin has {count} elements, the template's {ROWS * COLUMNS} "
                "tell the regions of a face; give the head before it was refined"
            )
        return self._hosts % (ROWS * COLUMNS)

    def landmarks(self) -> tuple[list[str], Feet]:
        """Return the names of the head's landmarks, of both sides, and their feet.

        Raises
        ------
        InputError
            A landmark is not on the skin.
        """
        points = self.head.landmark_points()
        names = list(points)
        elements, xi = [], []
        for name in names:
            element, place = (
                self.head.landmarks.get(name) or self.head.landmarks[name.rpartition("_")[0]]
            )
            found = np.flatnonzero(self._hosts[: len(self.head.sides["outer"][0])] == element)
            if not len(found) or place[2] != 1.0:
                raise InputError(f"{name}: it is not on the skin of {self.head.name}; move it")
            elements.append(int(found[0]))
            xi.append(place[:2])
        mirrored = np.array([name.endswith("_right") for name in names])
        none = np.zeros((len(names), 3))
        feet = Feet(
            np.array(elements), np.array(xi), mirrored, none, none, none[:, 0], mirrored | True
        )
        rest = self.head.tissue.parameters
        return names, replace(feet, points=self.places(feet, rest), normals=self.turned(feet, rest))

    @cached_property
    def mirror(self) -> Mirror:
        """How the two halves of the tessellated skin are joined."""
        rest = self.pieces.points(self.head.tissue.parameters)
        return Mirror.of(rest, self.pieces.cells, self.head.midplane)

    def surface(self, parameters: Array) -> Surface:
        """Return both sides as triangles.

        Parameters
        ----------
        parameters : (n_params, 3) array
            Of the tissue, one half or both.
        """
        left, right = (self.pieces.points(half) for half in self.head.halves(parameters))
        return Surface(self.mirror.points(left, right), self.mirror.faces, self.head.name)

    def state(self, parameters: Array) -> SkinState:
        """Return the skin in a state, to project on.

        Parameters
        ----------
        parameters : (n_params, 3) array
            Of the tissue, one half or both.
        """
        return SkinState(self, np.asarray(parameters, dtype=float))

    def places(self, feet: Feet, parameters: Array) -> Array:
        """Return where the material points of some feet are in another state, (n, 3)."""
        out = np.empty((len(feet.elements), 3))
        for half, rows in zip(
            self.head.halves(parameters), (~feet.mirrored, feet.mirrored), strict=True
        ):
            mesh = self.mesh.with_parameters(half)
            out[rows] = mesh.evaluate(feet.elements[rows], feet.xi[rows])
        out[feet.mirrored] = self.head.mirror(out[feet.mirrored])
        return out

    def turned(self, feet: Feet, parameters: Array) -> Array:
        """Return the outward unit normals of some feet in another state, (n, 3)."""
        out = np.empty((len(feet.elements), 3))
        for half, rows in zip(
            self.head.halves(parameters), (~feet.mirrored, feet.mirrored), strict=True
        ):
            mesh = self.mesh.with_parameters(half)
            out[rows] = self.outward_normals(mesh, feet.elements[rows], feet.xi[rows])
        out[feet.mirrored, 0] *= -1.0
        return out

    def motion(self, feet: Feet, change: Array) -> Array:
        """Return how the places of some feet change with the parameters, (n, 3, k).

        Parameters
        ----------
        feet : Feet
        change : (n_params, 3, k) array
            Of the tissue's parameters, of one half or of both.
        """
        n, k = self.head.tissue.n_params, change.shape[2]
        sides = change, change
        if len(change) != n:
            image = np.asarray(self.head.both.image @ change.reshape(len(change), -1))
            sides = change[:n], image.reshape(n, 3, k) * [[-1.0], [1.0], [1.0]]
        out = np.empty((len(feet.elements), 3, k))
        for side, rows in zip(sides, (~feet.mirrored, feet.mirrored), strict=True):
            functions = self.mesh.functions(feet.elements[rows], feet.xi[rows])
            out[rows] = np.asarray(functions @ side.reshape(n, -1)).reshape(-1, 3, k)
        out[feet.mirrored, 0] *= -1.0
        return out

    def outward_normals(self, mesh: HermiteMesh, elements: IntArray, xi: Array) -> Array:
        """Return outward unit normals of the left half, (n, 3)."""
        tangents = mesh.jacobian(elements, xi)
        normals = np.cross(tangents[:, :, 0], tangents[:, :, 1]) * self.outward[elements][:, None]
        return np.asarray(
            normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        )

    def zones(self, feet: Feet) -> IntArray:
        """Return the index into `STILL_ZONES` of every foot, -1 for none."""
        zone = self.zone[feet.elements]
        return np.asarray(np.where((zone == 1) & feet.mirrored, 2, zone))


class SkinState:
    """The skin in one state.

    Parameters
    ----------
    skin : Skin
    parameters : (n_params, 3) array
        Of the tissue, one half or both.
    """

    def __init__(self, skin: Skin, parameters: Array) -> None:
        self.skin = skin
        self.parameters = parameters
        left, right = skin.head.halves(parameters)
        self._left = _Half(skin, left)
        self._right = self._left if right is left else _Half(skin, right)

    def feet(self, points: Array, normals: Array | None = None) -> Feet:
        """Project points on the skin.

        The search on triangles begins an exact projection in the elements around. Near a slit
        the normals tell the lips, and the lids, apart: of the closest points on either side that
        counts which is near in position and in direction.

        Parameters
        ----------
        points : (n, 3) array
        normals : (n, 3) array, optional
            Outward unit normals; without them the closest point of all counts.
        """
        head = self.skin.head
        image = head.mirror(points)
        turned = None if normals is None else normals * [-1.0, 1.0, 1.0]
        if self._left is self._right:
            # Of a symmetric face the closest point is on the point's own side.
            right = points[:, 0] < head.midplane
            own = np.where(right[:, None], image, points)
            facing = None
            if normals is not None and turned is not None:
                facing = np.where(right[:, None], turned, normals)
            found = self._left.feet(own, facing)
        else:
            found = self._left.feet(points, normals)
            other = self._right.feet(image, turned)
            right = (other.distance < found.distance) & (other.covered | ~found.covered)
            found = Feet(
                *(
                    np.where(right if a.ndim == 1 else right[:, None], b, a)
                    for a, b in zip(found.columns(), other.columns(), strict=True)
                )
            )
        feet, outward = found.points.copy(), found.normals.copy()
        feet[right] = head.mirror(feet[right])
        outward[right, 0] *= -1.0
        return replace(found, mirrored=right, points=feet, normals=outward)


class _Half:
    """The left half of a skin in one state."""

    def __init__(self, skin: Skin, parameters: Array) -> None:
        self.skin = skin
        self.mesh = skin.mesh.with_parameters(parameters)
        self.half = Surface(skin.pieces.points(parameters), skin.pieces.cells, skin.head.name)
        self._without: dict[int, tuple[Surface, IntArray]] = {}

    def feet(self, points: Array, normals: Array | None) -> Feet:
        """Project points as `SkinState.feet` does, on this half alone."""
        skin = self.skin
        cells, places = self._search(points, normals)
        shares = barycentric(places, self.half.vertices[skin.pieces.cells[cells]])
        border = (shares * skin.rim[skin.pieces.cells[cells]]).sum(axis=1) > 1.0 - 1e-6
        xi = np.einsum("nk,nki->ni", shares, skin.pieces.xi[skin.cell_samples[cells]])
        nearest = skin.pieces.cells[cells, shares.argmax(axis=1)]
        own = skin.cell_element[cells]
        others = skin.around[nearest]
        # What lies across the slit is not around.
        others = np.where(skin.side[others] == skin.side[own][:, None], others, -1)
        hosts = np.concatenate([own[:, None], np.where(others == own[:, None], -1, others)], axis=1)
        starts = np.full((*hosts.shape, 2), 0.5)
        starts[:, 0] = np.clip(xi, 0.0, 1.0)
        elements, xi, distance = closest_in(self.mesh, points, hosts, starts)
        feet = self.mesh.evaluate(elements, xi)
        outward = skin.outward_normals(self.mesh, elements, xi)
        covered = ~border & (distance < _REACH)
        if normals is not None:
            covered &= (outward * normals).sum(axis=1) > _FACING
        mirrored = np.zeros(len(points), dtype=bool)
        return Feet(elements, xi, mirrored, feet, outward, distance, covered)

    def _search(self, points: Array, normals: Array | None) -> tuple[IntArray, Array]:
        """Return triangles and closest points, on the right side of the slits."""
        skin = self.skin
        found = self.half.closest(points)
        cells, places = found.faces.copy(), found.points.copy()
        if normals is None:
            return cells, places
        for side in range(1, 5):
            apart = ((normals - self.half.normals[cells]) ** 2).sum(axis=1)
            rows = np.flatnonzero((skin.side[skin.cell_element[cells]] == side) & (apart > _ALIKE))
            if not len(rows):
                continue
            other, kept = self._surface_without(side)
            second = other.closest(points[rows])
            cost = ((points[rows] - places[rows]) ** 2).sum(axis=1)
            cost += _TURN**2 * (apart[rows] - _ALIKE)
            turned = ((normals[rows] - other.normals[second.faces]) ** 2).sum(axis=1)
            rival = second.distance**2 + _TURN**2 * np.maximum(turned - _ALIKE, 0.0)
            better = rival < cost
            cells[rows[better]] = kept[second.faces[better]]
            places[rows[better]] = second.points[better]
        return cells, places

    def _surface_without(self, side: int) -> tuple[Surface, IntArray]:
        if side not in self._without:
            kept = np.flatnonzero(self.skin.side[self.skin.cell_element] != side)
            surface = Surface(self.half.vertices, self.half.faces[kept], self.half.name)
            self._without[side] = surface, kept
        return self._without[side]
