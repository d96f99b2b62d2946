"""Contact by penalty: tissue against rigid bodies, and tissue against itself."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from ..errors import InputError
from ..hermite import HermiteMesh, Side, gauss, trapezoidal
from .assembly import Pattern
from .facing import EDGE, Facing, Immersion, Meetings, Patches, blended
from .laws import PAIRS, Array
from .terms import IntArray, Load, PointTerm, Response, by_host, penalty


class SignedDistance(Protocol):
    """Anything that knows the signed distance of points, such as a `DistanceGrid`."""

    def sample(self, points: Array) -> tuple[Array, Array, Array]:
        """Return distance (n,), gradient (n, 3) and Hessian (n, 3, 3); negative inside."""


class RigidContact(PointTerm):
    """Points of the tissue's surface against a rigid body.

    A point whose distance ``d`` falls below ``min(d_rest, 0)`` by ``g`` has the energy
    ``ε A penalty(g)``, so that the tissue at rest carries no stress wherever it touches.
    Where the tissue slides on the body without leaving it, a fraction ``s`` of the stiffness
    holds its distance: ``s ε A (d - d_rest)²/2``.

    Parameters
    ----------
    mesh : HermiteMesh
        Tissue at rest.
    surface : SignedDistance
    elements, xi : (n,), (n, 3) arrays
        Points of the tissue.
    areas : (n,) array
        Area of each point in mm².
    stiffness : float
        ε in kPa/mm.
    slide : (n,) array, optional
        Fraction of the stiffness that holds the distance; 0 (free) by default.
    onset : float
        Depth in mm over which the stiffness grows to ε.
    name : str
    motion : callable, optional
        Rotation (3, 3) and shift (3,) in mm that take the body from rest to its place under a
        load; without it the body stands still.
    touching : HermiteMesh, optional
        The tissue in the shape whose distances are touched without force; at rest by default.
    """

    def __init__(
        self,
        mesh: HermiteMesh,
        surface: SignedDistance,
        elements: ArrayLike,
        xi: ArrayLike,
        areas: ArrayLike,
        stiffness: float = 100.0,
        slide: ArrayLike | None = None,
        onset: float = 0.1,
        name: str = "contact",
        motion: Callable[[Load], tuple[Array, Array]] | None = None,
        touching: HermiteMesh | None = None,
    ) -> None:
        order = by_host(elements)
        elements = np.asarray(elements)[order]
        xi = np.asarray(xi, dtype=float)[order]
        super().__init__(name, mesh.functions(elements, xi), elements)
        if not stiffness >= 0.0:
            raise InputError(f"{name}: stiffness {stiffness} is not a number from 0 up; mend it")
        self.surface = surface
        self.motion = motion
        self.stiffness = stiffness * np.asarray(areas, dtype=float)[order]
        fraction = np.zeros(len(order)) if slide is None else np.asarray(slide, dtype=float)[order]
        self.slide_stiffness = fraction * self.stiffness
        self.onset = onset
        self.rest = surface.sample(self.points(mesh.parameters))[0]
        free = self.rest
        if touching is not None:
            free = surface.sample(self.points(touching.parameters))[0]
        self.least = np.minimum(free, 0.0)

    def points(self, parameters: Array) -> Array:
        """Return the points of the tissue (n, 3)."""
        return np.asarray(self.functions @ parameters)

    def sample(self, vectors: Array, load: Load) -> tuple[Array, Array, Array]:
        """Return the body's distance (n,), gradient and Hessian where a load has taken it.

        Points are taken back to the body at rest, derivatives turned with it.
        """
        if self.motion is None:
            return self.surface.sample(vectors)
        turn, shift = self.motion(load)
        distance, gradient, hessian = self.surface.sample((vectors - shift) @ turn)
        return distance, gradient @ turn.T, turn @ hessian @ turn.T

    def respond(self, vectors: Array, load: Load, convex: bool = False) -> Response:
        """Evaluate the penalty; the stiffness holds the curvature of the body's surface."""
        distance, gradient, hessian = self.sample(vectors, load)
        depth = self.least - distance + load.offsets.get(self.name, 0.0)
        energies, slope, bend = penalty(depth, self.onset)
        moved = distance - self.rest
        energies = self.stiffness * energies + 0.5 * self.slide_stiffness * moved**2
        slope = -self.stiffness * slope + self.slide_stiffness * moved
        bend = self.stiffness * bend + self.slide_stiffness

        def stiffness() -> Array:
            # A convex body pushes tissue off sideways: the curvature is the part that can be
            # negative, and on teeth it is large.
            curved = 0.0 * slope if convex else slope
            return np.stack(
                [
                    bend * gradient[:, i] * gradient[:, j] + curved * hessian[:, i, j]
                    for i, j in PAIRS
                ],
                axis=1,
            )

        return Response(energies, slope[:, None] * gradient, stiffness)

    def depth(self, parameters: Array, load: Load) -> Array:
        """Return how much deeper than at rest the points are below the surface in mm, (n,)."""
        return np.asarray(self.least - self.sample(self.points(parameters), load)[0])


class SurfaceContact(PointTerm):
    """Two surfaces of the tissue against each other: lip on lip, lid on lid.

    Points of the slave are projected onto the master wherever it has gone, and slide along
    it. With the closest point ``x_m`` and its outward normal ``n`` the gap is
    ``g = (x - x_m) · n``. Gaps below ``min(g_rest, 0)`` by ``t`` have the energy
    ``ε A penalty(t)``. The tangent is that of the energy, with all that the closest point
    contributes to it.

    Parameters
    ----------
    mesh : HermiteMesh
        Tissue at rest, of dimension 3.
    slave, master : (elements, axis, side)
        The two surfaces, see `HermiteMesh.face`.
    stiffness : float
        ε in kPa/mm.
    onset : float
        Depth in mm over which the stiffness grows to ε.
    points : (patches (n,), xi (n, 2), areas (n,)), optional
        Points of the slave, as indices into its elements and coordinates on their side;
        by default 4 x 4 Gauss points or, with flanks, 7 x 7 points of the trapezoidal rule.
        `segments` makes those that integrate the pressure exactly between meshes that do not match.
    flanks : pair of sequences of (elements, axis, side), optional
        Other sides of the elements of slave and master. Those of the master end its body: points
        before them are outside it, and a point is pushed out by the side that it is least behind.
        Those of the slave are watched for overlap, not pushed. Without flanks the body has no end.
    name : str

    Attributes
    ----------
    areas : (n,) array
        Of the points at rest, in mm².
    edges : EdgeContact or None
        The term of the points at edges of the master's body, where it has any; a problem takes it
        beside this one.
    """

    #: Difference of the positions; tangents and second derivatives of the master.
    width = 6
    follows = True

    def __init__(
        self,
        mesh: HermiteMesh,
        slave: Side,
        master: Side,
        stiffness: float = 100.0,
        onset: float = 0.1,
        points: tuple[ArrayLike, ArrayLike, ArrayLike] | None = None,
        flanks: tuple[Sequence[Side], Sequence[Side]] = ((), ()),
        name: str = "surface contact",
    ) -> None:
        super().__init__(name, sp.csr_matrix((0, mesh.n_params)), [])
        if not stiffness >= 0.0:
            raise InputError(f"{name}: stiffness {stiffness} is not a number from 0 up; mend it")
        first, second = Patches.of(mesh, slave), Patches.of(mesh, master, *flanks[1])
        if points is None:
            # The edges of a body that has flanks are what may cut into another, between two points
            # as well.
            points = first.points(*(trapezoidal((7, 7)) if flanks[1] else gauss(2, 4)))
        self.onset = onset
        self.areas = np.asarray(points[2], dtype=float)
        self.stiffness = stiffness * self.areas
        self.facing = Facing(first, second, points[0], points[1])
        self._meetings = Meetings.sides(self.facing)
        self._points = np.empty(0, dtype=np.int64)
        self._sign = np.empty(0)
        self._immersion = Immersion(mesh, [slave, *flanks[0]], [master, *flanks[1]])
        self.edges = EdgeContact(self) if flanks[1] else None

    def pattern(self) -> Pattern:
        """Return the pattern of the pairs of patches that may meet."""
        return self._meetings.pattern

    def follow(self, parameters: Array, load: Load) -> tuple[Array, IntArray]:
        """Project the points anew and return the functionals of those pressed by one side."""
        found = self.facing.project(parameters)
        pressed = self.pressed(parameters, load) > 0.0
        points = np.flatnonzero(pressed & (found.host[:, 1] < 0))
        host, xi = found.host[points, :1], found.xi[points, :1]
        functions, starts, order = self._meetings.functionals(points, host, xi)
        self._points, self._sign = points[order], self.facing.master.sign[host[order, 0]]
        return functions, starts

    def respond(self, vectors: Array, load: Load, convex: bool = False) -> Response:
        """Evaluate the penalty of the gap at the points last projected.

        The first variation of the gap is ``δg = n · δw`` with ``w = x - x_m``; the second
        follows from ``A δξ = δw · τ + g n · δτ``, where ``A = a - g κ`` with the metric ``a`` of
        the tangents ``τ`` and the curvature ``κ = n · ∂²x_m``:
        ``Δδg = -b·Δξ - Δb·δξ - δξ·κΔξ + g (b + κδξ)·a⁻¹(Δb + κΔξ)`` with ``b = n · δτ``.
        """
        gap, normal = _gaps(vectors, self._sign)
        energies, slope, bend = self.pushes(self._points, gap, load)
        forces = np.zeros_like(vectors)
        forces[:, 0] = -slope[:, None] * normal

        def stiffness() -> Array:
            # By the vector and its component: (n, 3, 3, 3, 3) for the first three vectors.
            second = np.zeros((len(vectors), 6, 3, 6, 3))
            second[:, 0, :, 0] = bend[:, None, None] * normal[:, :, None] * normal[:, None, :]
            touching = slope > 0.0
            if touching.any() and not convex:
                second[touching, :3, :, :3] -= slope[touching, None, None, None, None] * bent(
                    gap[touching], normal[touching], vectors[touching]
                )
            return np.stack([second[:, :, i, :, j] for i, j in PAIRS], axis=1)

        return Response(energies, forces, stiffness)

    def points(self, parameters: Array) -> Array:
        """Return the points of the slave (n, 3)."""
        return self.facing.points(parameters)

    def pushes(self, points: IntArray, distance: Array, load: Load) -> tuple[Array, Array, Array]:
        """Return the penalty of some points at distances (k,), its slope and second derivative."""
        depth = self.facing.least[points] - distance
        if self.name in load.offsets:
            depth += load.offsets[self.name][points]
        energies, slope, bend = (self.stiffness[points] * p for p in penalty(depth, self.onset))
        return energies, slope, bend

    def depth(self, parameters: Array, load: Load) -> Array:
        """Return how much deeper than at rest each point is inside the master in mm, (n,)."""
        return np.asarray(self.facing.least - self.facing.project(parameters).distance)

    def pressed(self, parameters: Array, load: Load) -> Array:
        """Return the depths of all points that the penalty sees, with the offsets, (n,)."""
        return np.asarray(self.depth(parameters, load) + load.offsets.get(self.name, 0.0))

    def pressure(self, parameters: Array, load: Load) -> tuple[Array, Array]:
        """Return the points (n, 3) and the pressure on them by the area at rest (n,) in kPa."""
        slope = penalty(self.pressed(parameters, load), self.onset)[1]
        return self.points(parameters), self.stiffness * slope / self.areas

    def penetration(self, parameters: Array, load: Load | None = None) -> float:
        """Return how deep the slave is inside the master's elements beyond that at rest, in mm.

        Samples of the slave and its flanks, borders included, are located in the master's
        elements, wherever they have gone; their depth is the distance to its boundary.
        """
        return float(self._immersion.depth(parameters).max(initial=0.0))


class EdgeContact(PointTerm):
    """The points of a `SurfaceContact` at an edge of the master's body, between two of its sides.

    The energy is that of the other points, with the distance ``d`` to both sides `blended`. With
    shares ``w`` and the rounding ``r`` = `EDGE` the second variation of ``d`` is
    ``w_a Δδg_a + w_b Δδg_b + (δg_a - δg_b)(Δg_a - Δg_b)/2r``.

    Parameters
    ----------
    contact : SurfaceContact
    """

    #: Those of a `SurfaceContact` for both sides.
    width = 12
    follows = True

    def __init__(self, contact: SurfaceContact) -> None:
        super().__init__(f"{contact.name}, edges", contact.functions, [])
        self._contact = contact
        self._meetings = Meetings.edges(contact.facing)
        self._points = np.empty(0, dtype=np.int64)
        self._sign = np.empty((0, 2))

    def pattern(self) -> Pattern:
        """Return the pattern of a patch of the slave with two of the master that share an edge."""
        return self._meetings.pattern

    def follow(self, parameters: Array, load: Load) -> tuple[Array, IntArray]:
        """Return the functionals of the points pressed by two sides."""
        facing = self._contact.facing
        found = facing.project(parameters)
        pressed = self._contact.pressed(parameters, load) > 0.0
        points = np.flatnonzero(pressed & (found.host[:, 1] >= 0))
        order = np.argsort(found.host[points], axis=1)
        host = np.take_along_axis(found.host[points], order, axis=1)
        xi = np.take_along_axis(found.xi[points], order[:, :, None], axis=1)
        functions, starts, order = self._meetings.functionals(points, host, xi)
        self._points, self._sign = points[order], facing.master.sign[host[order]]
        return functions, starts

    def respond(self, vectors: Array, load: Load, convex: bool = False) -> Response:
        """Evaluate the penalty of the blended distance at the points last projected."""
        n = len(vectors)
        parts = vectors[:, :6], vectors[:, 6:]
        gaps, normals = zip(
            *(_gaps(part, self._sign[:, k]) for k, part in enumerate(parts)), strict=True
        )
        distance, share = blended(*gaps)
        shares = share, 1.0 - share
        energies, slope, bend = self._contact.pushes(self._points, distance, load)
        along, apart = np.zeros((n, 12, 3)), np.zeros((n, 12, 3))
        for k, sign in enumerate((1.0, -1.0)):
            along[:, 6 * k] = shares[k][:, None] * normals[k]
            apart[:, 6 * k] = sign * normals[k]

        def stiffness() -> Array:
            second = bend[:, None, None] * along.reshape(n, 36, 1) * along.reshape(n, 1, 36)
            second = second.reshape(n, 12, 3, 12, 3)
            touching = slope > 0.0
            if touching.any() and not convex:
                force = slope[touching, None, None, None, None]
                aside = apart[touching]
                second[touching] -= (0.5 / EDGE) * force * np.einsum("nai,nbj->naibj", aside, aside)
                for k in range(2):
                    some = slice(6 * k, 6 * k + 3)
                    turn = bent(gaps[k][touching], normals[k][touching], parts[k][touching])
                    weight = shares[k][touching, None, None, None, None]
                    second[touching, some, :, some] -= force * weight * turn
            return np.stack([second[:, :, i, :, j] for i, j in PAIRS], axis=1)

        return Response(energies, -slope[:, None, None] * along, stiffness)


def known_offsets(
    terms: Iterable[PointTerm],
    mesh: HermiteMesh,
    offsets: Mapping[str, Array],
    midplane: float,
) -> dict[str, Array]:
    """Return the `Load.offsets` of an earlier state for the contacts of a problem.

    Those of a half are taken over to both sides: to its own points, which come first, and to
    their images.

    Parameters
    ----------
    terms : iterable of PointTerm
    mesh : HermiteMesh
        The problem's tissue at rest.
    offsets : mapping of str to (n,) array
        Of the same mesh or, where that is of both sides, of its half.
    midplane : float
        x of the mirror plane in mm.

    Raises
    ------
    InputError
        If they are not of these contacts.
    """
    contacts = {t.name: t for t in terms if isinstance(t, RigidContact | SurfaceContact)}
    known = {}
    for name, values in offsets.items():
        points = contacts[name].points(mesh.parameters) if name in contacts else np.empty((0, 3))
        if 0 < len(values) == len(points) // 2:
            own, others = np.split(points, [len(values)])
            images = others * [-1.0, 1.0, 1.0] + [2.0 * midplane, 0.0, 0.0]
            values = np.concatenate([values, values[cKDTree(own).query(images)[1]]])
        if not 0 < len(values) == len(points):
            raise InputError(f"state: the offsets of {name!r} are of no contact; simulate it anew")
        known[name] = values
    return known


def _gaps(vectors: Array, sign: Array) -> tuple[Array, Array]:
    """Return gaps (n,) and outward normals (n, 3) from a point's vectors (n, 6, 3)."""
    normal = sign[:, None] * np.cross(vectors[:, 1], vectors[:, 2])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return (vectors[:, 0] * normal).sum(axis=1), normal


def bent(gap: Array, normal: Array, vectors: Array) -> Array:
    """Return the second derivative of gaps by ``(w, τ1, τ2)``, see `SurfaceContact.respond`.

    Parameters
    ----------
    gap : (n,) array
    normal : (n, 3) array
    vectors : (n, 6, 3) array
        Difference of the positions; tangents and second derivatives of the master.

    Returns
    -------
    (n, 3, 3, 3, 3) array
        Vector, component, vector, component.
    """
    n = len(gap)
    tangents = vectors[:, 1:3]
    curvature = (vectors[:, [3, 4, 4, 5]] @ normal[:, :, None]).reshape(-1, 2, 2)
    metric = tangents @ tangents.transpose(0, 2, 1)
    drive = np.zeros((n, 2, 3, 3))
    drive[:, :, 0] = tangents
    tilt = np.zeros((n, 2, 3, 3))
    for k in range(2):
        drive[:, k, k + 1] = gap[:, None] * normal
        tilt[:, k, k + 1] = normal
    tilts = tilt.reshape(n, 2, 9)
    slide = np.linalg.solve(metric - gap[:, None, None] * curvature, drive.reshape(n, 2, 9))
    turn = tilts + curvature @ slide
    back = slide.transpose(0, 2, 1)
    cross = tilts.transpose(0, 2, 1) @ slide
    out = -cross - cross.transpose(0, 2, 1) - back @ curvature @ slide
    out += gap[:, None, None] * (turn.transpose(0, 2, 1) @ np.linalg.solve(metric, turn))
    return np.asarray(out.reshape(n, 3, 3, 3, 3))


def face_points(
    mesh: HermiteMesh, elements: ArrayLike, axis: int, side: int, n: int = 4
) -> tuple[IntArray, Array, Array]:
    """Return Gauss points on one side of some elements, with their areas.

    Returns
    -------
    elements : (q,) int array
    xi : (q, 3) array
        With ``xi_axis`` equal to ``side``.
    areas : (q,) array
        In mm².
    """
    elements = np.asarray(elements, dtype=np.int64)
    rule = mesh.face(elements, axis, side).quadrature(n)
    xi = np.insert(rule.xi, axis, float(side), axis=1)
    return elements[rule.elements], xi, rule.weights
