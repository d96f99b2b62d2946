"""From one head to another: a head morphed to the surface of a face.

The surface is brought into the head's frame (`modiolus.face.aligned`) and keeps its size, the head
takes that of the surface. Its tissue is deformed until the skin lies on the surface
(`modiolus.face.deform`). One map of space carries everything else: muscles and bones move along.
Elements and local coordinates stay what they are, so that the muscle fraction, the attachments and
the landmarks need no change. How good the head is the gates tell (`modiolus.face.gates`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..anatomy.distance import DistanceGrid
from ..anatomy.surface import Surface
from ..fitting import PointTarget, Smoothing, fit
from ..fitting.register import Matcher, sphere
from ..hermite import HermiteMesh, symmetry_plane
from ..hermite.basis import Array
from ..progress import Report
from .aligned import Aligned
from .deform import Host, Map, SkinPlaces, deformed, fitted, margin_targets, spread, unfolded
from .embed import bring_inside, sheets
from .gates import inside_shares, least_volume, neck_height
from .head import Head, RigidSurface
from .margins import Margins, find_margins
from .muscle import Muscle

#: Weight of the derivatives in the fit of a muscle to where its points go.
_MUSCLE_SMOOTHING = 1e-4
#: Share of a muscle that may leave the tissue; one of which more does is brought back.
_LOST = 0.01
#: Samples of the tissue and the width (mm) of the mean of corrections that moves bones.
_AROUND = (120, 4.0)
#: The inner surface lies on the eyeball up to this distance (mm).
_ON_BALL = 1.5
#: Distance (mm) over which the last correction fades outside the tissue.
_FADE = 12.0


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
    held = symmetry_plane(head.tissue, *head.sides["midplane"])
    before = _carried(head.tissue, aligned.grown, held)
    grown = replace(head, tissue=before)
    skin = SkinPlaces.of(grown, 4)
    scans = [Matcher(aligned.surface, 4000)]
    scans.append(Matcher(aligned.surface.mirrored(head.midplane), 4000))
    margins = _both_margins(grown, skin, scans)
    edges = margin_targets(skin, before, margins)
    tell(0.35, "deforming the box around the head")
    host = deformed(grown, Host.around(head, aligned.grown), skin, scans, margins)
    tell(0.5, "fitting the skin")
    start = _carried(before, host, held)
    after = fitted(grown, start, skin, scans, edges)
    whole = _Whole(aligned, host, before, after)
    tell(0.6, "muscles")
    muscles = {key: _muscle(item, whole.smooth, whole) for key, item in head.muscles.items()}
    muscles = _kept_inside(head, replace(head, tissue=after, muscles=muscles))
    tell(0.75, "deep structures")
    deep = {key: _rigid(item, whole.bone, aligned.size) for key, item in head.deep.items()}
    if "eyeball" in deep:
        deep["eyeball"] = _eyeball(head, after)
    # Fibrous sheets stand for areas of the skin, which have changed with the size.
    laid = sheets(after, head.sides["outer"]) if head.sheets else {}
    morphed = replace(
        head, name=name, tissue=after, muscles=muscles, deep=deep, sheets=laid, about={}
    )
    return morphed, edges


def _kept_inside(head: Head, morphed: Head) -> dict[str, Muscle]:
    """Return the muscles of a morphed head; those that have left the tissue are brought back."""
    before, now = inside_shares(head, morphed)
    cut = neck_height(morphed)
    out = dict(morphed.muscles)
    for name, muscle in morphed.muscles.items():
        if before[name] - now[name] > _LOST:
            back = bring_inside(muscle, morphed.tissue, cut)
            if least_volume(back) > 0.0:
                out[name] = back
    return out


def _both_margins(head: Head, skin: SkinPlaces, scans: list[Matcher]) -> Margins:
    """Find the margins of a scan, near where the head has its own."""
    places = {
        key: head.tissue.evaluate(elements, xi) for key, (elements, xi) in skin.margins.items()
    }
    lips = np.vstack([places["lip_upper"], places["lip_lower"]])
    mouth = lips[np.argmin(lips[:, 0])]
    eye = np.vstack([places["lid_upper"], places["lid_lower"]]).mean(axis=0)
    return find_margins([scan.surface for scan in scans], mouth, eye)


@dataclass(frozen=True)
class _Whole:
    """The map of space from the head to the morphed one."""

    aligned: Aligned
    host: Host
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
        near = np.flatnonzero(self._around.query(grown)[0] < 3.0 * _FADE)
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
    def _around(self) -> cKDTree:
        return cKDTree(self.before.evaluate(*spread(self.before, 3)))

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


def _carried(mesh: HermiteMesh, mapping: Map, held: NDArray[np.bool_] | None = None) -> HermiteMesh:
    """Move a volume mesh by a map: the least-squares fit to where its points go."""
    elements, xi = spread(mesh)
    target = PointTarget("there", elements, xi, mapping(mesh.evaluate(elements, xi)))
    smoothing = Smoothing(first=0.0, second=1e-6, relative=True)
    return fit(mesh, [target], smoothing, held, iterations=1).mesh


def _muscle(muscle: Muscle, smooth: Map, mapping: Map) -> Muscle:
    """Carry a muscle by a map; where that would fold it, by a smoother one."""
    elements, xi = spread(muscle.mesh)
    points = mapping(muscle.mesh.evaluate(elements, xi))
    start = _carried(muscle.mesh, smooth)
    smoothing = Smoothing(first=_MUSCLE_SMOOTHING, second=_MUSCLE_SMOOTHING, relative=True)
    there = PointTarget("there", elements, xi, points)
    return replace(muscle, mesh=unfolded(start, [there], smoothing)[0])


def _rigid(item: RigidSurface, mapping: Map, size: float) -> RigidSurface:
    """Carry the surface of a deep structure and measure the distances to it anew."""
    surface = item.distance.surface(closed=True)
    moved = Surface(mapping(surface.vertices), surface.faces, item.name)
    return RigidSurface(item.name, DistanceGrid.of([moved], item.distance.spacing * size))


def _eyeball(head: Head, after: HermiteMesh) -> RigidSurface:
    """Put a ball of the old one's radius behind the new lids, as far from them as it was.

    Adults' eyes hardly differ in size, whatever the face's.
    """
    import pyvista

    item = head.deep["eyeball"]
    old = item.distance.surface(closed=True).vertices
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
