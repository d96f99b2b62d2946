"""The tissue of a head, deformed until its skin lies on the surface of another face.

First a box of tricubic Hermite elements around the head is deformed, then the tissue itself is
fitted. The inner surface follows the outer one, as far below it as it was.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..fitting import Equations, PairTarget, PointTarget, Smoothing, fit
from ..fitting.register import Matcher
from ..hermite import HermiteMesh, grid, symmetry_plane
from ..hermite.basis import Array, basis
from ..hermite.quadrature import gauss
from .head import Head
from .margins import Margins

Map = Callable[[Array], Array]

#: Elements of the host box: lateral, backward, up; its room around the head (mm).
HOST, _ROOM = (4, 4, 8), 6.0
#: Weights of the host's second derivatives, from stiff to soft; one step each.
_HOST_SMOOTHING = (3e3, 3e3, 1e3, 1e3, 3e2, 3e2, 1e2, 1e2, 30.0, 30.0)
#: Weights of the first and second derivatives in the fit of the skin itself; one step each.
_SKIN_SMOOTHING = ((1e-1, 1.0), (3e-2, 0.3), (1e-2, 0.1), (3e-3, 3e-2), (1e-3, 1e-2), (1e-3, 1e-2))
#: Weight of the change of the derivatives through the tissue: the inner surface follows.
_THROUGH = 1.0
#: Weights of both when the layer is given its thickness.
_DEPTH_SMOOTHING = (1e-3, 1e-2)
#: An element folds when its volume falls below this share somewhere.
_CRUSHED = 0.3
#: Or when its scaled Jacobian falls below a share of what it was; from a first value on no element
#: need keep more, and below a second one it has to keep a larger share.
_BENT, _ENOUGH, _LITTLE = (0.5, 0.8), 0.3, 0.16
#: By how much it is then made stiffer, and how often at most in one step.
_STIFFER, _TRIES = 10.0, 15
#: Weight of a point of a margin relative to one of the skin.
_MARGIN_WEIGHT = 8.0
#: Weight of a pair of points of both lips, which part no farther than they did.
_TOGETHER_WEIGHT = 1e4
#: Weight of a point of the cuts at neck and scalp, which keep their height.
_CUT_WEIGHT = 0.3
#: Farthest match (mm) in the first and in the last step.
_REACH = (20.0, 3.0)
#: Least cosine between the normals of matched points.
_ALIGNED = 0.5


def spread(mesh: HermiteMesh, count: int = 4) -> tuple[NDArray[np.int64], Array]:
    """Return points spread over all elements of a volume mesh, their borders included."""
    ticks = np.linspace(0.0, 1.0, count)
    cell = np.stack(np.meshgrid(*[ticks] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.repeat(np.arange(mesh.n_elements), len(cell)), np.tile(cell, (mesh.n_elements, 1))


@dataclass(frozen=True)
class Host:
    """A box of tricubic elements whose deformation carries what is in it."""

    low: Array
    spacing: Array
    counts: tuple[int, int, int]
    mesh: HermiteMesh
    plane: float

    @classmethod
    def around(cls, head: Head, grown: Map) -> Host:
        """Make the box of a head that has grown; undeformed."""
        points = [head.tissue.evaluate(*spread(head.tissue, 2))]
        points += [muscle.bounds() for muscle in head.muscles.values()]
        points += [item.distance.bounds for item in head.deep.values()]
        cloud = grown(np.vstack(points))
        low, high = cloud.min(axis=0) - _ROOM, cloud.max(axis=0) + _ROOM
        low[0] = head.midplane
        ticks = [np.linspace(low[k], high[k], HOST[k] + 1) for k in range(3)]
        mesh = grid(np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1))
        return cls(low, (high - low) / HOST, HOST, mesh, head.midplane)

    def places(self, points: Array) -> tuple[NDArray[np.int64], Array, Array]:
        """Return element, local coordinates and side (1 left, -1 right) of points at rest."""
        side = np.where(points[:, 0] < self.plane, -1.0, 1.0)
        folded = points.copy()
        folded[:, 0] = self.plane + side * (points[:, 0] - self.plane)
        place = (folded - self.low) / self.spacing
        cell = np.clip(np.floor(place).astype(np.int64), 0, np.array(self.counts) - 1)
        element = cell[:, 0] + self.counts[0] * (cell[:, 1] + self.counts[1] * cell[:, 2])
        # Just outside the box the cubics go on; far outside they would run away.
        return element, np.clip(place - cell, -0.2, 1.2), side

    def __call__(self, points: Array) -> Array:
        """Return where points (n, 3) go."""
        element, xi, side = self.places(points)
        moved = self.mesh.evaluate(element, xi)
        moved[:, 0] = self.plane + side * (moved[:, 0] - self.plane)
        return moved


@dataclass(frozen=True)
class SkinPlaces:
    """Sample points of the outer surface and of the margins of lips and lids."""

    elements: NDArray[np.int64]
    xi: Array
    margins: dict[str, tuple[NDArray[np.int64], Array]]
    cuts: PointTarget

    @classmethod
    def of(cls, head: Head, samples: int = 5) -> SkinPlaces:
        """Take the samples of a head, with so many a direction in every element."""
        elements, axis, side = head.sides["outer"]
        face = head.tissue.face(elements, axis, side)
        local, xi, _ = face.gauss_points(samples)
        margins = {}
        for name in ("lip_upper", "lip_lower", "lid_upper", "lid_lower"):
            cells, along, end = head.sides[name]
            ticks = np.linspace(0.0, 1.0, 5)
            place = np.zeros((len(ticks), 3))
            place[:, 0], place[:, along], place[:, axis] = ticks, end, side
            margins[name] = (np.repeat(cells, len(ticks)), np.tile(place, (len(cells), 1)))
        parts = []
        for name in ("neck", "scalp"):
            cells, along, end = head.sides[name]
            rule = head.tissue.face(cells, along, end).gauss_points(3)
            parts.append((cells[rule[0]], np.insert(rule[1], along, float(end), axis=1)))
        cells, places = (np.concatenate(part) for part in zip(*parts, strict=True))
        rest = head.tissue.evaluate(cells, places)
        up = np.tile([0.0, 0.0, 1.0], (len(rest), 1))
        cuts = PointTarget("cuts", cells, places, rest, _CUT_WEIGHT, up)
        return cls(elements[local], np.insert(xi, axis, float(side), axis=1), margins, cuts)


def margin_targets(skin: SkinPlaces, mesh: HermiteMesh, margins: Margins) -> list[PointTarget]:
    """Return the margins of lips and lids with the points of the scan that they belong to.

    A margin is matched by its share of the way across: from the mid-plane to the corner of the
    mouth, and from corner to corner of the eye.

    Parameters
    ----------
    skin : SkinPlaces
    mesh : HermiteMesh
        Tissue of the head.
    margins : Margins
        Of the scan, in the head's frame.
    """
    out = []
    lines = {
        "lip_upper": margins.lips,
        "lip_lower": margins.lips,
        "lid_upper": margins.lid_upper,
        "lid_lower": margins.lid_lower,
    }
    for name, line in lines.items():
        if line is None:
            continue
        elements, xi = skin.margins[name]
        own = mesh.evaluate(elements, xi)[:, 0]
        share = (own - own.min()) / (own.max() - own.min())
        x = line[0, 0] + share * (line[-1, 0] - line[0, 0])
        points = np.column_stack([np.interp(x, line[:, 0], line[:, k]) for k in range(3)])
        out.append(PointTarget(name, elements, xi, points, _MARGIN_WEIGHT))
    return out


def matches(
    scans: Iterable[Matcher], points: Array, normals: Array, reach: float
) -> list[tuple[NDArray[np.bool_], Array]]:
    """Match points, with the normals there, with each of some surfaces: which, and where."""
    out = []
    for scan in scans:
        there, facing, good = scan.matches(points, reach)
        out.append((good & (np.einsum("ni,ni->n", facing, normals) > _ALIGNED), there))
    return out


def _skin_targets(
    elements: NDArray[np.int64],
    xi: Array,
    normals: Array,
    found: list[tuple[NDArray[np.bool_], Array]],
    sliding: float,
) -> list[PointTarget]:
    """Return where places of the skin should lie; they may slide across their own normals.

    The normals of a scan are not used: on its steps and noise they point anywhere, and a place
    would be pushed along the skin.
    """
    seen = np.maximum(np.sum([good for good, _ in found], axis=0), 1)
    return [
        PointTarget(
            "skin", elements[good], xi[good], there[good], 1.0 / seen[good], normals[good], sliding
        )
        for good, there in found
        if good.any()
    ]


def outer_normals(head: Head, mesh: HermiteMesh, skin: SkinPlaces) -> Array:
    """Return the normals (n, 3) of the outer surface of a mesh of the head at places of it."""
    _, axis, _ = head.sides["outer"]
    tangents = mesh.jacobian(skin.elements, skin.xi)
    first, second = (k for k in range(3) if k != axis)
    normal = np.cross(tangents[:, :, first], tangents[:, :, second])
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _reaches(count: int) -> Array:
    return np.geomspace(*_REACH, count)


def deformed(
    head: Head, host: Host, skin: SkinPlaces, scans: list[Matcher], margins: Margins
) -> Host:
    """Deform the host until the skin of the head lies on the scan.

    Parameters
    ----------
    head : Head
    host : Host
        The box around it.
    skin : SkinPlaces
        Places of the head's skin.
    scans : list of Matcher
        The scan, and its mirror image.
    margins : Margins
        Of the scan.
    """
    held = symmetry_plane(
        host.mesh, np.flatnonzero(np.arange(host.mesh.n_elements) % HOST[0] == 0), 0, 0
    )
    rest = head.tissue.evaluate(skin.elements, skin.xi)
    cells, places, _ = host.places(rest)
    edges = margin_targets(skin, head.tissue, margins)
    # The box keeps what it has come to in one step as the rest of the next one only in part:
    # smoothing always counts from the undeformed box.
    box = host.mesh
    for weight, reach in zip(_HOST_SMOOTHING, _reaches(len(_HOST_SMOOTHING)), strict=True):
        moved = host(rest)
        normals = _moved_normals(head, host, skin)
        found = matches(scans, moved, normals, reach)
        targets = _skin_targets(cells, places, normals, found, 0.1)
        for edge in [*edges, skin.cuts]:
            element, xi, _ = host.places(head.tissue.evaluate(edge.elements, edge.xi))
            targets.append(replace(edge, elements=element, xi=xi))
        smoothing = Smoothing(first=0.0, second=weight, relative=True)
        mesh = fit(box, targets, smoothing, held, iterations=1).mesh
        host = replace(host, mesh=mesh)
    return host


def _moved_normals(head: Head, host: Host, skin: SkinPlaces) -> Array:
    """Return the normals of the outer surface after the host's deformation."""
    _, axis, _ = head.sides["outer"]
    first, second = (k for k in range(3) if k != axis)
    jacobian = head.tissue.jacobian(skin.elements, skin.xi)
    points = head.tissue.evaluate(skin.elements, skin.xi)
    steps = (1e-3 * jacobian[:, :, first], 1e-3 * jacobian[:, :, second])
    along, across = (host(points + step) - host(points - step) for step in steps)
    normal = np.cross(along, across)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def fitted(
    head: Head,
    start: HermiteMesh,
    skin: SkinPlaces,
    scans: list[Matcher],
    margins: list[PointTarget],
) -> HermiteMesh:
    """Fit the outer surface of a deformed head to the scan; the tissue below follows it.

    The layer is as thick as that of the head, whatever the host has made of it. An element that
    would fold, where a scan is faulty or the closest point is not the right one, keeps for the
    moment the shape that it has come to.

    Parameters
    ----------
    head : Head
        In the size of the scan.
    start : HermiteMesh
        The tissue as the host has left it.
    skin, scans
        As in `deformed`.
    margins : list of PointTarget
        See `margin_targets`.
    """
    held = symmetry_plane(head.tissue, *head.sides["midplane"])
    together = _lips_together(head, start)
    start = _deepened(head, start, together, held)
    mesh, stiffness = start, np.ones(start.n_elements)
    for (first, second), reach in zip(_SKIN_SMOOTHING, _reaches(len(_SKIN_SMOOTHING)), strict=True):
        points = mesh.evaluate(skin.elements, skin.xi)
        normals = outer_normals(head, mesh, skin)
        found = matches(scans, points, normals, min(reach, 8.0))
        targets = _skin_targets(skin.elements, skin.xi, normals, found, 0.0)
        smoothing = Smoothing(
            first=(first, first, _THROUGH),
            second=(second, second, _THROUGH, second, _THROUGH, _THROUGH),
            relative=start,
            # What was too stiff for this step needs less of it in the next.
            stiffness=np.maximum(stiffness / _STIFFER, 1.0),
        )
        mesh, stiffness = unfolded(mesh, [*targets, together, *margins, skin.cuts], smoothing, held)
    return mesh


def _deepened(
    head: Head, mesh: HermiteMesh, together: PairTarget, held: NDArray[np.bool_]
) -> HermiteMesh:
    """Return a deformed tissue with the thickness that it has in the head, below the same skin.

    A host squeezes the layer where it moves a part of the skin back, and knows nothing of what
    lies behind.
    """
    _, axis, side = head.sides["outer"]
    elements, xi = spread(mesh)
    outer, inner = xi.copy(), xi.copy()
    outer[:, axis], inner[:, axis] = side, 1 - side
    was, now = (
        np.linalg.norm(item.evaluate(elements, outer) - item.evaluate(elements, inner), axis=1)
        for item in (head.tissue, mesh)
    )
    skin = mesh.evaluate(elements, outer)
    points = skin + (was / np.maximum(now, 1e-9))[:, None] * (mesh.evaluate(elements, xi) - skin)
    target = PointTarget("depth", elements, xi, points)
    smoothing = Smoothing(*_DEPTH_SMOOTHING, relative=mesh)
    return unfolded(mesh, [target, together], smoothing, held)[0]


def _lips_together(head: Head, mesh: HermiteMesh) -> PairTarget:
    """Return that points of both lips' margins with the same coordinates are as far apart."""
    _, axis, _ = head.sides["outer"]
    ticks = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 5)] * 2), axis=-1).reshape(-1, 2)
    places = []
    for name in ("lip_upper", "lip_lower"):
        cells, along, end = head.sides[name]
        xi = np.zeros((len(ticks), 3))
        xi[:, 3 - axis - along], xi[:, axis], xi[:, along] = *ticks.T, end
        places.append((np.repeat(cells, len(ticks)), np.tile(xi, (len(cells), 1))))
    apart = mesh.evaluate(*places[0]) - mesh.evaluate(*places[1])
    return PairTarget("lips", places[0], places[1], apart, _TOGETHER_WEIGHT)


def unfolded(
    mesh: HermiteMesh,
    targets: Sequence[PointTarget | PairTarget],
    smoothing: Smoothing,
    held: NDArray[np.bool_] | None = None,
) -> tuple[HermiteMesh, Array]:
    """Fit a mesh; the change of elements that would fold is made stiffer until they do not.

    Parameters
    ----------
    mesh : HermiteMesh
    targets : sequence of PointTarget or PairTarget
    smoothing : Smoothing
        Its change counts from ``relative``, the shape that no element may lose too much of. Its
        stiffness, above 1, is one against the change from ``mesh``.
    held : (n_params, 3) bool array, optional

    Returns
    -------
    mesh : HermiteMesh
    stiffness : (n_elements,) array
        The one that it has taken.
    """
    rest = smoothing.relative if isinstance(smoothing.relative, HermiteMesh) else mesh
    stiffness = np.broadcast_to(smoothing.stiffness, mesh.n_elements)
    shape = _volumes(rest)
    smooth = replace(smoothing, relative=rest, stiffness=1.0)
    equations = Equations.of(mesh, targets).smoothed(smooth)
    for _ in range(_TRIES):
        keeping = replace(smoothing, relative=mesh, stiffness=stiffness - 1.0)
        found = equations.smoothed(keeping).solved(held)
        folding = _folding(shape, _volumes(found))
        if not folding.any():
            break
        stiffness = np.where(folding, _STIFFER * stiffness, stiffness)
    return found, stiffness


def _volumes(mesh: HermiteMesh) -> tuple[Array, Array]:
    """Return the Jacobian (n_elements, 125) in every element, and the least scaled one of each.

    The scaled one is that at Gauss points: at the edge of a lip the skin runs on into its inner
    side, and the tangents there lie in a plane in any head.
    """
    ends, inside = np.linspace(0.0, 1.0, 5), gauss(3, 4)[0]
    corners = np.stack(np.meshgrid(ends, ends, ends, indexing="ij"), axis=-1).reshape(-1, 3)
    tangents = _tangents(mesh, inside)
    tangents /= np.linalg.norm(tangents, axis=-1, keepdims=True)
    return np.linalg.det(_tangents(mesh, corners)), np.linalg.det(tangents).min(axis=1)


def _tangents(mesh: HermiteMesh, xi: Array) -> Array:
    """Return dx/dxi_k (n_elements, q, 3, 3) at the same places (q, 3) of every element, as rows.

    The functions of one element serve all.
    """
    values = np.stack([basis(3, xi, order) for order in np.eye(3, dtype=int).tolist()], axis=1)
    local = mesh.local()
    return np.asarray((values.reshape(-1, 64) @ local).reshape(len(local), len(xi), 3, 3))


def _folding(old: tuple[Array, Array], new: tuple[Array, Array]) -> NDArray[np.bool_]:
    """Return which elements (n_elements,) have lost too much of their volume or shape."""
    crushed = (new[0] < _CRUSHED * old[0]).any(axis=1)
    little = np.minimum(_BENT[1] * old[1], _LITTLE)
    return np.asarray(crushed | (new[1] < np.clip(_BENT[0] * old[1], little, _ENOUGH)))
