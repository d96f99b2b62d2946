"""From one head to another: a head morphed to the surface of a face.

The surface is brought into the head's frame (`modiolus.fitting.register`) and keeps its size,
the head takes that of the surface. Then a box of tricubic Hermite elements around the head is
deformed until the skin lies on the surface, and the skin is fitted once more by itself. One map
of space carries everything else: the inner surface keeps its distance from the skin, muscles and
bones move along. Elements and local coordinates stay what they are, so that the muscle fraction,
the attachments and the landmarks need no change.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ..anatomy.distance import DistanceGrid
from ..anatomy.surface import Surface
from ..errors import InputError, SolveError
from ..fitting import PointTarget, Registration, Smoothing, fit, icp, register
from ..fitting.register import Matcher, sphere
from ..hermite import HermiteMesh, grid, symmetry_plane
from ..hermite.basis import Array
from ..progress import Report
from .embed import boundary_surface, bring_inside
from .head import Head, RigidSurface
from .margins import Margins, find_margins
from .muscle import Muscle

Map = Callable[[Array], Array]

#: Elements of the host box: lateral, backward, up; its room around the head (mm).
HOST, _ROOM = (4, 4, 8), 6.0
#: Weights of the host's second derivatives, from stiff to soft; one step each.
_HOST_SMOOTHING = (3e3, 3e3, 1e3, 1e3, 3e2, 3e2, 1e2, 1e2, 30.0, 30.0)
#: Weights of the first and second derivatives in the fit of the skin itself; one step each.
_SKIN_SMOOTHING = ((1e-1, 1.0), (3e-2, 0.3), (1e-2, 0.1), (3e-3, 3e-2), (1e-3, 1e-2), (1e-3, 1e-2))
#: Weight of the change of the derivatives through the tissue: the inner surface follows.
_THROUGH = 1.0
#: An element folds when its volume falls below this share somewhere, or its scaled Jacobian below
#: a share of what it was, or below a value when that is less.
_CRUSHED, _BENT = 0.3, (0.5, 0.3)
#: By how much it is then made stiffer, and how often at most in one step.
_STIFFER, _TRIES = 10.0, 15
#: Weight of the derivatives in the fit of a muscle to where its points go.
_MUSCLE_SMOOTHING = 1e-4
#: Share of a muscle that may leave the tissue; one of which more does is brought back.
_LOST = 0.01
#: Weight of a point of a margin relative to one of the skin.
_MARGIN_WEIGHT = 8.0
#: Weight of a point of the cuts at neck and scalp, which keep their height.
_CUT_WEIGHT = 0.3
#: Farthest match (mm) in the first and in the last step.
_REACH = (20.0, 3.0)
#: Samples of the tissue and the width (mm) of the mean of corrections that moves bones.
_AROUND = (120, 4.0)
#: A vertex of a scan is in a cavity when fewer of its rays than this share escape.
_ESCAPING = 0.3
#: The inner surface lies on the eyeball up to this distance (mm).
_ON_BALL = 1.5
#: Least cosine between the normals of matched points.
_ALIGNED = 0.5
#: Distance (mm) over which the last correction fades outside the tissue.
_FADE = 12.0


@dataclass(frozen=True)
class Aligned:
    """A surface in the frame of a head.

    Attributes
    ----------
    surface : Surface
        In the head's frame, in its own size (mm).
    pose : Registration
        From the surface's own frame to this one.
    size : float
        Size of the surface's face relative to the head's.
    middle : (3,) array
        The head grows about this point.
    """

    surface: Surface
    pose: Registration
    size: float
    middle: Array

    def grown(self, points: Array) -> Array:
        """Return points (n, 3) of the head in the size of the surface."""
        return np.asarray(self.middle + self.size * (points - self.middle))


def align(
    head: Head, surface: Surface, landmarks: tuple[ArrayLike, ArrayLike] | None = None
) -> Aligned:
    """Bring a surface into the frame of a head, each in its own size.

    Raises
    ------
    InputError
        The triangles of the surface run the wrong way round, or it is mirrored.
    SolveError
        The surface does not meet the head.
    """
    skin = skin_surface(head)
    pose = register(surface, skin, landmarks)
    if pose.facing < 0.0:
        raise InputError(
            f"{surface.name}: its triangles face inwards, or the scan is mirrored; turn them over"
        )
    size = pose.unit / pose.scale
    middle = skin.bounds.mean(axis=0)
    middle[0] = head.midplane
    pose = Registration(
        pose.unit,
        pose.rotation,
        size * (pose.translation - middle) + middle,
        pose.rms,
        pose.matched,
        pose.facing,
        pose.unit,
    )
    pose = _centred(pose, surface, head.midplane)
    return Aligned(pose.moved(surface), pose, size, middle)


def skin_surface(head: Head, divisions: int = 6) -> Surface:
    """Return the skin of both sides of a head's left half as triangles."""
    half = boundary_surface(head.tissue, head.sides["outer"], divisions)
    count = len(half.vertices)
    median = np.abs(half.vertices[:, 0] - head.midplane) < 1e-6
    # In the mid-plane both sides share their vertices: it is no free edge.
    image = np.where(median, np.arange(count), count + np.arange(count))
    vertices = np.vstack([half.vertices, half.mirrored(head.midplane).vertices])
    whole = Surface(vertices, np.vstack([half.faces, image[half.faces[:, ::-1]]]), head.name)
    return whole.picked(whole.faces)


def _centred(pose: Registration, surface: Surface, plane: float) -> Registration:
    """Turn and shift a surface so that its own plane of symmetry is the head's mid-plane."""
    moved = pose.moved(surface)
    image = moved.mirrored(plane)
    try:
        onto = icp(image, moved, reach=10.0)
    except SolveError:
        return pose
    if onto.matched < 0.4:
        return pose
    # Mirror image and motion together are a reflection in the plane of symmetry.
    mirror = onto.rotation @ np.diag([-1.0, 1.0, 1.0])
    values, vectors = np.linalg.eig(mirror)
    normal = np.real(vectors[:, np.argmin(np.abs(values + 1.0))])
    normal *= np.sign(normal[0]) / np.linalg.norm(normal)
    centres = 0.5 * (moved.vertices + onto.apply(image.vertices))
    centre = centres.mean(axis=0)
    axis = np.cross(normal, [1.0, 0.0, 0.0])
    sine = float(np.linalg.norm(axis))
    if sine > 0.2:
        return pose
    turn = Rotation.from_rotvec(axis / max(sine, 1e-12) * np.arcsin(sine)).as_matrix()
    shift = centre - turn @ centre
    shift[0] += plane - centre[0]
    return replace(pose, rotation=turn @ pose.rotation, translation=turn @ pose.translation + shift)


def _plane_mask(head: Head) -> NDArray[np.bool_]:
    """Return which unknowns of the tissue the mirror condition holds, (n_params, 3)."""
    return symmetry_plane(head.tissue, *head.sides["midplane"])


def _samples(mesh: HermiteMesh, count: int = 4) -> tuple[NDArray[np.int64], Array]:
    """Return points spread over all elements of a volume mesh, their borders included."""
    ticks = np.linspace(0.0, 1.0, count)
    cell = np.stack(np.meshgrid(*[ticks] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.repeat(np.arange(mesh.n_elements), len(cell)), np.tile(cell, (mesh.n_elements, 1))


def _carried(mesh: HermiteMesh, mapping: Map, held: NDArray[np.bool_] | None = None) -> HermiteMesh:
    """Move a volume mesh by a map: the least-squares fit to where its points go."""
    elements, xi = _samples(mesh)
    return _through(mesh, elements, xi, mapping(mesh.evaluate(elements, xi)), held)


def _through(
    mesh: HermiteMesh,
    elements: NDArray[np.int64],
    xi: Array,
    points: Array,
    held: NDArray[np.bool_] | None = None,
) -> HermiteMesh:
    target = PointTarget("there", elements, xi, points)
    smoothing = Smoothing(first=0.0, second=1e-6, relative=True)
    return fit(mesh, [target], smoothing, held, iterations=1).mesh


def _muscle(muscle: Muscle, smooth: Map, mapping: Map) -> Muscle:
    """Carry a muscle by a map; where that would fold it, by a smoother one."""
    elements, xi = _samples(muscle.mesh)
    points = mapping(muscle.mesh.evaluate(elements, xi))
    start = _carried(muscle.mesh, smooth)
    smoothing = Smoothing(first=_MUSCLE_SMOOTHING, second=_MUSCLE_SMOOTHING, relative=True)
    there = PointTarget("there", elements, xi, points)
    return replace(muscle, mesh=unfolded(start, [there], smoothing)[0])


def _rigid(item: RigidSurface, mapping: Map, size: float) -> RigidSurface:
    """Carry the surface of a deep structure and measure the distances to it anew."""
    surface = closed_surface(item.distance)
    moved = Surface(mapping(surface.vertices), surface.faces, item.name)
    return RigidSurface(item.name, DistanceGrid.of([moved], item.distance.spacing * size))


def _eyeball(head: Head, after: HermiteMesh) -> RigidSurface:
    """Put a ball of the old one's radius behind the new lids, as far from them as it was.

    Adults' eyes hardly differ in size, whatever the face's.
    """
    import pyvista

    item = head.deep["eyeball"]
    old = closed_surface(item.distance).vertices
    centre, radius = sphere(old)
    elements, axis, side = head.sides["inner"]
    local, xi, _ = head.tissue.face(elements, axis, side).gauss_points(4)
    places = np.insert(xi, axis, float(side), axis=1)
    gap = item.distance.sample(head.tissue.evaluate(elements[local], places)).distance
    lids = gap < _ON_BALL
    rest = head.tissue.evaluate(elements[local][lids], places[lids])
    points = after.evaluate(elements[local][lids], places[lids])
    wanted = np.linalg.norm(rest - centre, axis=1)
    new = centre + (points - rest).mean(axis=0)
    for _ in range(20):
        away = points - new
        length = np.linalg.norm(away, axis=1)
        direction = away / length[:, None]
        # The lids say little of where the ball is sideways: there it stays in their middle.
        matrix = direction.T @ direction + 0.3 * len(points) * np.diag([1.0, 0.0, 1.0])
        pull = (points - rest).mean(axis=0) + centre - new
        right = direction.T @ (length - wanted) + 0.3 * len(points) * pull * [1.0, 0.0, 1.0]
        new = new + np.linalg.solve(matrix, right)
    ball = pyvista.Icosphere(radius=radius, center=new, nsub=4)
    surface = Surface(ball.points, ball.regular_faces, "eyeball")
    return RigidSurface("eyeball", DistanceGrid.of([surface], item.distance.spacing))


def closed_surface(distance: DistanceGrid) -> Surface:
    """Return the surface of a structure, closed where the grid cuts it off."""
    values = np.pad(distance.values, 2, constant_values=np.int8(127))
    origin = distance.origin - 2.0 * distance.spacing
    return DistanceGrid(origin, distance.spacing, values).surface()


@dataclass(frozen=True)
class _Host:
    """A box of tricubic elements whose deformation carries what is in it."""

    low: Array
    spacing: Array
    counts: tuple[int, int, int]
    mesh: HermiteMesh
    plane: float

    @classmethod
    def around(cls, head: Head, grown: Map) -> _Host:
        """Make the box of a head that has grown; undeformed."""
        points = [head.tissue.evaluate(*_samples(head.tissue, 2))]
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
class _Skin:
    """Sample points of the outer surface and of the margins of lips and lids."""

    elements: NDArray[np.int64]
    xi: Array
    margins: dict[str, tuple[NDArray[np.int64], Array]]
    cuts: PointTarget

    @classmethod
    def of(cls, head: Head, samples: int = 5) -> _Skin:
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


def margin_targets(skin: _Skin, mesh: HermiteMesh, margins: Margins) -> list[PointTarget]:
    """Return the margins of lips and lids with the points of the scan that they belong to.

    A margin is matched by its share of the way across: from the mid-plane to the corner of the
    mouth, and from corner to corner of the eye.
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


def _matches(
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


def _outer_normals(head: Head, mesh: HermiteMesh, skin: _Skin) -> Array:
    _, axis, _ = head.sides["outer"]
    tangents = mesh.jacobian(skin.elements, skin.xi)
    first, second = (k for k in range(3) if k != axis)
    normal = np.cross(tangents[:, :, first], tangents[:, :, second])
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _reaches(count: int) -> Array:
    return np.geomspace(*_REACH, count)


def _deformed(
    head: Head, host: _Host, skin: _Skin, scans: list[Matcher], margins: Margins
) -> _Host:
    """Deform the host until the skin of the head lies on the scan."""
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
        found = _matches(scans, moved, normals, reach)
        targets = _skin_targets(cells, places, normals, found, 0.1)
        for edge in [*edges, skin.cuts]:
            element, xi, _ = host.places(head.tissue.evaluate(edge.elements, edge.xi))
            targets.append(replace(edge, elements=element, xi=xi))
        smoothing = Smoothing(first=0.0, second=weight, relative=True)
        mesh = fit(box, targets, smoothing, held, iterations=1).mesh
        host = replace(host, mesh=mesh)
    return host


def _moved_normals(head: Head, host: _Host, skin: _Skin) -> Array:
    """Return the normals of the outer surface after the host's deformation."""
    _, axis, _ = head.sides["outer"]
    first, second = (k for k in range(3) if k != axis)
    jacobian = head.tissue.jacobian(skin.elements, skin.xi)
    points = head.tissue.evaluate(skin.elements, skin.xi)
    steps = (1e-3 * jacobian[:, :, first], 1e-3 * jacobian[:, :, second])
    along, across = (host(points + step) - host(points - step) for step in steps)
    normal = np.cross(along, across)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _fitted(
    head: Head, start: HermiteMesh, skin: _Skin, scans: list[Matcher], margins: list[PointTarget]
) -> HermiteMesh:
    """Fit the outer surface of a deformed head to the scan; the tissue below follows it.

    Elements that would fold, where a scan is faulty or the closest point is not the right one,
    are made stiffer until they do not.
    """
    held = _plane_mask(head)
    mesh = start
    stiffness = np.ones(start.n_elements)
    for (first, second), reach in zip(_SKIN_SMOOTHING, _reaches(len(_SKIN_SMOOTHING)), strict=True):
        points = mesh.evaluate(skin.elements, skin.xi)
        normals = _outer_normals(head, mesh, skin)
        found = _matches(scans, points, normals, min(reach, 8.0))
        targets = _skin_targets(skin.elements, skin.xi, normals, found, 0.0)
        smoothing = Smoothing(
            first=(first, first, _THROUGH),
            second=(second, second, _THROUGH, second, _THROUGH, _THROUGH),
            relative=True,
            stiffness=stiffness,
        )
        mesh, stiffness = unfolded(start, [*targets, *margins, skin.cuts], smoothing, held)
    return mesh


def unfolded(
    start: HermiteMesh,
    targets: list[PointTarget],
    smoothing: Smoothing,
    held: NDArray[np.bool_] | None = None,
) -> tuple[HermiteMesh, Array]:
    """Fit a mesh, with elements that would fold made stiffer; return it and the stiffness."""
    stiffness = np.broadcast_to(smoothing.stiffness, start.n_elements)
    shape = _volumes(start)
    for _ in range(_TRIES):
        smoothing = replace(smoothing, stiffness=stiffness)
        mesh = fit(start, targets, smoothing, held, iterations=1).mesh
        folding = _folding(shape, _volumes(mesh))
        if not folding.any():
            break
        stiffness = np.where(folding, _STIFFER * stiffness, stiffness)
    return mesh, stiffness


def _volumes(mesh: HermiteMesh) -> tuple[Array, Array]:
    """Return the Jacobian (n_elements, 125) in every element, and the least scaled one of each."""
    tangents = mesh.jacobian(*_samples(mesh, 5))
    jacobian = np.linalg.det(tangents).reshape(mesh.n_elements, -1)
    lengths = np.linalg.norm(tangents, axis=1).prod(axis=1).reshape(mesh.n_elements, -1)
    return jacobian, (jacobian / lengths).min(axis=1)


def _folding(old: tuple[Array, Array], new: tuple[Array, Array]) -> NDArray[np.bool_]:
    """Return which elements (n_elements,) have lost too much of their volume or shape."""
    crushed = (new[0] < _CRUSHED * old[0]).any(axis=1)
    return np.asarray(crushed | (new[1] < np.minimum(_BENT[0] * old[1], _BENT[1])))


@dataclass(frozen=True)
class _Whole:
    """The map of space from the head to the morphed one."""

    aligned: Aligned
    host: _Host
    before: HermiteMesh
    after: HermiteMesh

    def __call__(self, points: Array) -> Array:
        """Return where points (n, 3) of the head go.

        Inside the tissue it is the map from the old mesh to the new one, outside that of the
        host with the tissue's last correction, which fades with the distance.
        """
        plane = self.host.plane
        grown = self.aligned.grown(points)
        side = np.where(grown[:, 0] < plane, -1.0, 1.0)
        grown[:, 0] = plane + side * (grown[:, 0] - plane)
        moved = self.host(grown)
        near = np.flatnonzero(self._samples.query(grown)[0] < 3.0 * _FADE)
        if len(near):
            place = self.before.locate(grown[near])
            at = place.elements, place.xi
            shift = self.after.evaluate(*at) - self.host(self.before.evaluate(*at))
            moved[near] += np.exp(-((place.distance / _FADE) ** 2))[:, None] * shift
        moved[:, 0] = plane + side * (moved[:, 0] - plane)
        return moved

    def smooth(self, points: Array) -> Array:
        """Return where points (n, 3) go with the host alone."""
        return self.host(self.aligned.grown(points))

    @cached_property
    def _samples(self) -> cKDTree:
        return cKDTree(self.before.evaluate(*_samples(self.before, 3)))

    @cached_property
    def _shifts(self) -> tuple[cKDTree, Array]:
        """Samples of the tissue, each in one element only, and their corrections."""
        at = self.before.gauss_points(2)[:2]
        points = self.before.evaluate(*at)
        return cKDTree(points), np.asarray(self.after.evaluate(*at) - self.host(points))

    def bone(self, points: Array) -> Array:
        """Return where points (n, 3) of deep structures go.

        Behind a slit the nearest tissue changes from one lip to the other; for teeth and bone the
        correction is the mean over the tissue around, with Gaussian weights, which is smooth.
        """
        plane = self.host.plane
        grown = self.aligned.grown(points)
        side = np.where(grown[:, 0] < plane, -1.0, 1.0)
        grown[:, 0] = plane + side * (grown[:, 0] - plane)
        moved = self.host(grown)
        samples, shifts = self._shifts
        distance, index = samples.query(grown, k=_AROUND[0])
        fade = np.exp(-((distance[:, 0] / _FADE) ** 2))
        weights = np.exp(-0.5 * (distance**2 - distance[:, :1] ** 2) / _AROUND[1] ** 2)
        weights /= weights.sum(axis=1, keepdims=True)
        moved += fade[:, None] * np.einsum("nk,nkd->nd", weights, shifts[index])
        moved[:, 0] = plane + side * (moved[:, 0] - plane)
        return moved


def carried_head(
    head: Head, aligned: Aligned, report: Report | None = None, name: str = "morphed"
) -> tuple[Head, list[PointTarget]]:
    """Carry a head to a surface that has been brought into its frame.

    Parameters
    ----------
    head : Head
        A left half.
    aligned : Aligned
        From `align`.
    report : callable, optional
        Told ``(fraction, message)`` as the work goes on, from 0.3 to 0.9.
    name : str
        Name of the new head.

    Returns
    -------
    head : Head
        Without a description of itself.
    margins : list of PointTarget
        The margins of lips and lids with the points of the surface that they belong to.
    """
    tell = report or (lambda _fraction, _message: None)
    tell(0.3, "margins of lips and lids")
    before = _carried(head.tissue, aligned.grown, _plane_mask(head))
    grown = replace(head, tissue=before)
    skin = _Skin.of(grown, 4)
    scans = [Matcher(aligned.surface, 4000)]
    scans.append(Matcher(aligned.surface.mirrored(head.midplane), 4000))
    margins = _both_margins(grown, skin, scans)
    edges = margin_targets(skin, before, margins)
    tell(0.35, "deforming the box around the head")
    host = _deformed(grown, _Host.around(head, aligned.grown), skin, scans, margins)
    tell(0.5, "fitting the skin")
    start = _carried(before, host, _plane_mask(head))
    after = _fitted(grown, start, skin, scans, edges)
    whole = _Whole(aligned, host, before, after)
    tell(0.6, "muscles")
    muscles = {key: _muscle(item, whole.smooth, whole) for key, item in head.muscles.items()}
    muscles = _kept_inside(head, replace(head, tissue=after, muscles=muscles))
    tell(0.75, "deep structures")
    deep = {key: _rigid(item, whole.bone, aligned.size) for key, item in head.deep.items()}
    if "eyeball" in deep:
        deep["eyeball"] = _eyeball(head, after)
    morphed = replace(head, name=name, tissue=after, muscles=muscles, deep=deep, about={})
    return morphed, edges


def _kept_inside(head: Head, morphed: Head) -> dict[str, Muscle]:
    """Return the muscles of a morphed head; those that have left the tissue are brought back."""
    before, now = _inside(head, morphed)
    cut = neck_height(morphed)
    out = dict(morphed.muscles)
    for name, muscle in morphed.muscles.items():
        if before[name] - now[name] > _LOST:
            back = replace(bring_inside(muscle, morphed.tissue, cut), slack=muscle.slack)
            if least_volume(back) > 0.0:
                out[name] = back
    return out


def neck_height(head: Head) -> float:
    """Return the height (mm) of the cut through the neck."""
    neck = head.tissue.face(*head.sides["neck"])
    return float(neck.evaluate(*neck.gauss_points(4)[:2])[:, 2].max())


def least_volume(muscle: Muscle) -> float:
    """Return the least Jacobian determinant of a muscle at 3 x 3 x 3 points an element."""
    mesh = muscle.mesh
    return float(np.linalg.det(mesh.jacobian(*mesh.gauss_points(3)[:2])).min())


def _both_margins(head: Head, skin: _Skin, scans: list[Matcher]) -> Margins:
    """Find the margins on both sides of a scan; where both show them, their mean."""
    places = {
        key: head.tissue.evaluate(elements, xi) for key, (elements, xi) in skin.margins.items()
    }
    lips = np.vstack([places["lip_upper"], places["lip_lower"]])
    mouth = lips[np.argmin(lips[:, 0])]
    eye = np.vstack([places["lid_upper"], places["lid_lower"]]).mean(axis=0)
    found = [find_margins(scan.surface, mouth, eye) for scan in scans]
    lines = {
        key: _mean_line([getattr(margins, key) for margins in found])
        for key in ("lips", "lid_upper", "lid_lower")
    }
    return Margins(**lines)


def _mean_line(lines: list[Array | None]) -> Array | None:
    """Return the mean of lines that run along x, point by point of their length across."""
    known = [line for line in lines if line is not None]
    if not known:
        return None
    shares = np.linspace(0.0, 1.0, 101)
    resampled = []
    for line in known:
        at = (line[:, 0] - line[0, 0]) / (line[-1, 0] - line[0, 0])
        resampled.append(np.column_stack([np.interp(shares, at, line[:, k]) for k in range(3)]))
    return np.asarray(np.mean(resampled, axis=0))


def morph_quality(
    head: Head, morphed: Head, aligned: Aligned, margins: list[PointTarget]
) -> dict[str, Any]:
    """Measure a morphed head against the scan and against the head that it was made from."""
    mesh = morphed.tissue
    elements, xi, _ = mesh.gauss_points(4)
    every, outside, share = scan_error(morphed, aligned.surface)
    error = every[outside]
    if not len(error):
        raise SolveError(
            f"{aligned.surface.name}: nothing of it lies on the face; give landmarks, or a scan of "
            "the face alone"
        )
    seen = _seen(morphed, aligned.surface)
    old, new = (thickness(item) for item in (head, morphed))
    ratio = new / (aligned.size * old)
    was = float(head.tissue.measures().sum())
    quality: dict[str, Any] = {
        "size": round(aligned.size, 4),
        "scan_rms_mm": round(float(np.sqrt(np.mean(error**2))), 3),
        "scan_p95_mm": round(float(np.percentile(error, 95)), 3),
        "scan_max_mm": round(float(error.max()), 3),
        "scan_rms_with_nostrils_mm": round(float(np.sqrt(np.mean(every**2))), 3),
        "scan_covered": round(share, 3),
        "skin_seen": round(seen, 3),
        "min_jacobian": round(float(np.linalg.det(mesh.jacobian(elements, xi)).min()), 3),
        "min_scaled_jacobian": round(float(mesh.scaled_jacobian(elements, xi).min()), 3),
        "volume_mm3": round(float(mesh.measures().sum())),
        "volume_ratio": round(float(mesh.measures().sum()) / (aligned.size**3 * was), 3),
        "least_thickness_mm": round(float(new.min()), 2),
        "least_thickness_ratio": round(float(ratio.min()), 3),
        "thickness_ratio": [round(float(v), 2) for v in np.percentile(ratio, [1, 50, 99])],
    }
    for part in ("lip", "lid"):
        gaps = [
            np.linalg.norm(mesh.evaluate(t.elements, t.xi) - t.points, axis=1)
            for t in margins
            if t.name.startswith(part)
        ]
        if gaps:
            rms = float(np.sqrt(np.mean(np.concatenate(gaps) ** 2)))
            quality[f"{part}_margins_rms_mm"] = round(rms, 3)
    before, after = _inside(head, morphed)
    quality["inside"] = {key: round(value, 4) for key, value in after.items()}
    quality["inside_lost"] = round(max(before[key] - after[key] for key in before), 4)
    least = min(least_volume(muscle) for muscle in morphed.muscles.values())
    quality["muscles_min_jacobian"] = round(least, 4)
    return quality


def _inside(head: Head, morphed: Head) -> tuple[dict[str, float], dict[str, float]]:
    """Return which share of every muscle lies in the tissue, before and after.

    What lies below the cut through the neck does not count.
    """
    cut = neck_height(head)
    shares: tuple[dict[str, float], dict[str, float]] = ({}, {})
    for name, muscle in head.muscles.items():
        elements, xi, _ = muscle.mesh.gauss_points(3)
        kept = muscle.mesh.evaluate(elements, xi)[:, 2] >= cut
        for part, share in zip((head, morphed), shares, strict=True):
            rule = part.muscles[name].mesh.quadrature(3)
            points = part.muscles[name].mesh.evaluate(elements, xi)
            within = part.tissue.locate(points[kept]).distance < 1e-3
            weights = rule.weights[kept]
            share[name] = float(weights[within].sum() / weights.sum()) if kept.any() else 1.0
    return shares


@dataclass(frozen=True)
class Gate:
    """A figure of a morphed head with the bounds that it has to keep."""

    name: str
    value: float
    low: float
    high: float

    @property
    def passed(self) -> bool:
        """Whether the figure is within its bounds."""
        return self.low <= self.value <= self.high


#: Figures of `morph_quality` with the bounds that they have to keep.
GATES: dict[str, tuple[float, float]] = {
    "scan_rms_mm": (0.0, 0.5),
    "skin_seen": (0.4, 1.0),
    "lip_margins_rms_mm": (0.0, 0.5),
    "lid_margins_rms_mm": (0.0, 0.5),
    "min_jacobian": (1e-3, np.inf),
    "min_scaled_jacobian": (0.1, 1.0),
    "least_thickness_ratio": (0.5, np.inf),
    "volume_ratio": (0.75, 1.33),
    "muscles_min_jacobian": (0.0, np.inf),
    "inside_lost": (-1.0, 0.03),
}


def gates(quality: dict[str, Any]) -> list[Gate]:
    """Return the gates of a morphed head; figures that a scan does not give are left out."""
    return [Gate(name, quality[name], *GATES[name]) for name in GATES if name in quality]


def quality_text(quality: dict[str, Any]) -> str:
    """Return figures and verdicts of a morphed head as plain text."""
    lines = [f"{'figure':26} {'value':>9}  wanted"]
    for gate in gates(quality):
        bounds = [f"from {gate.low:g}"] if gate.low > 0.0 else []
        bounds += [f"up to {gate.high:g}"] if np.isfinite(gate.high) else []
        verdict = "ok" if gate.passed else "FAILED"
        lines.append(f"{gate.name:26} {gate.value:9.3f}  {' '.join(bounds):20} {verdict}")
    for name, value in quality.items():
        if name not in GATES and not isinstance(value, dict):
            lines.append(f"{name:26} {value!s:>9}")
    return "\n".join(lines)


def thickness(head: Head) -> Array:
    """Return the depth of the tissue (mm) at 3 x 3 points of every element, (n,)."""
    elements, axis, side = head.sides["outer"]
    face = head.tissue.face(elements, axis, side)
    local, xi, _ = face.gauss_points(3)
    ends = [
        head.tissue.evaluate(elements[local], np.insert(xi, axis, float(end), axis=1))
        for end in (side, 1 - side)
    ]
    return np.asarray(np.linalg.norm(ends[0] - ends[1], axis=1))


def scan_error(head: Head, surface: Surface) -> tuple[Array, NDArray[np.bool_], float]:
    """Return the distance (n,) of a scan's vertices to the skin of a head.

    Left out is what the template does not have: vertices whose closest point is on a free edge
    of the skin (ears, scalp, neck, inside of mouth and eyes) or faces another way.

    Returns
    -------
    distance : (n,) array
        In mm.
    open : (n,) bool array
        Which of these vertices are on the outside; the others are in a cavity (nostrils).
    share : float
        Share of the scan's vertices that `open` has.
    """
    skin = Matcher(skin_surface(head), 4000)
    normals = surface.vertex_normals
    near, facing, good = skin.matches(surface.vertices, 10.0)
    good &= np.einsum("ni,ni->n", facing, normals) > 0.3
    points = surface.vertices[good]
    seen = surface.escaping(points, normals[good]) > _ESCAPING
    return np.linalg.norm(near[good] - points, axis=1), seen, float(seen.sum() / len(good))


def _seen(head: Head, surface: Surface) -> float:
    """Return which share of the skin the scan shows, on one side at least."""
    skin = _Skin.of(head, 4)
    points = head.tissue.evaluate(skin.elements, skin.xi)
    normals = _outer_normals(head, head.tissue, skin)
    scans = [Matcher(part, 1000) for part in (surface, surface.mirrored(head.midplane))]
    found = [good for good, _ in _matches(scans, points, normals, 2.0)]
    return float(np.any(found, axis=0).mean())
