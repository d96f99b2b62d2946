"""Contact by penalty: tissue against rigid bodies, and tissue against itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ..errors import InputError
from ..hermite import HermiteMesh, gauss, trapezoidal
from .assembly import Pattern
from .facing import Facing, Immersion, Pairs, Patches, Side
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
        self.rest = surface.sample(np.asarray(self.functions @ mesh.parameters))[0]
        free = self.rest
        if touching is not None:
            free = surface.sample(np.asarray(self.functions @ touching.parameters))[0]
        self.least = np.minimum(free, 0.0)

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
        # A convex body pushes tissue off sideways: the curvature is the part that can be
        # negative, and on teeth it is large.
        curved = 0.0 * slope if convex else slope
        stiffness = np.stack(
            [bend * gradient[:, i] * gradient[:, j] + curved * hessian[:, i, j] for i, j in PAIRS],
            axis=1,
        )
        return Response(energies, slope[:, None] * gradient, stiffness)

    def augmented(self, parameters: Array, load: Load) -> Array:
        """Return the offsets that would keep the present forces without overlap, (n,)."""
        distance, _, _ = self.sample(np.asarray(self.functions @ parameters), load)
        return np.maximum(self.least - distance + load.offsets.get(self.name, 0.0), 0.0)

    def depth(self, vectors: Array, load: Load) -> Array:
        """Return how much deeper than at rest the points are below the surface in mm, (n,)."""
        distance, _, _ = self.sample(vectors, load)
        return np.maximum(self.least - distance, 0.0)

    def penetration(self, parameters: Array, load: Load | None = None) -> float:
        """Return the greatest depth below the body's surface beyond that at rest, in mm."""
        vectors = np.asarray(self.functions @ parameters)
        return float(self.depth(vectors, Load() if load is None else load).max(initial=0.0))


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
        by default 4 x 4 Gauss points or, with flanks, 5 x 5 points of the trapezoidal rule.
        `segments` makes those that integrate the pressure exactly between meshes that do not match.
    flanks : pair of sequences of (elements, axis, side), optional
        Other sides of the elements of slave and master. Those of the master end its body: points
        before them are outside it, and `update` chooses where a point is pushed out. Those of
        the slave are watched for overlap, not pushed. Without flanks the body has no end.
    name : str

    Attributes
    ----------
    areas : (n,) array
        Of the points at rest, in mm².
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
            # The edges of a body that has flanks are what may cut into another.
            points = first.points(*(trapezoidal(2, 5) if flanks[1] else gauss(2, 4)))
        self.onset = onset
        self.areas = np.asarray(points[2], dtype=float)
        self.stiffness = stiffness * self.areas
        self._facing = Facing(first, second, points[0], points[1])
        self._pairs = Pairs(self._facing)
        self._order = np.empty(0, dtype=np.int64)
        self._sign = np.empty(0)
        self._immersion = Immersion(mesh, [slave, *flanks[0]], [master, *flanks[1]])

    def pattern(self) -> Pattern:
        """Return the pattern of the pairs of patches that may meet."""
        return self._pairs.pattern

    def update(self, parameters: Array) -> None:
        """Choose what pushes each point out of the master, and let go those that slid off it.

        Both stand still within a load step: beyond its border the master is only its tangent
        plane, on which lips would turn each other, and points at an edge would come and go.
        """
        self._facing.settle(parameters)

    def follow(self, parameters: Array) -> tuple[Array, IntArray]:
        """Project the points anew and return their functionals."""
        found = self._facing.project(parameters)
        functions, starts, self._order = self._pairs.functionals(found)
        self._sign = self._facing.master.sign[found.host[self._order]]
        return functions, starts

    def respond(self, vectors: Array, load: Load, convex: bool = False) -> Response:
        """Evaluate the penalty of the gap at the points last projected.

        The first variation of the gap is ``δg = n · δw`` with ``w = x - x_m``; the second
        follows from ``A δξ = δw · τ + g n · δτ``, where ``A = a - g κ`` with the metric ``a`` of
        the tangents ``τ`` and the curvature ``κ = n · ∂²x_m``:
        ``Δδg = -b·Δξ - Δb·δξ - δξ·κΔξ + g (b + κδξ)·a⁻¹(Δb + κΔξ)`` with ``b = n · δτ``.
        """
        n_points = len(vectors)
        stiffness = (self._facing.share * self.stiffness)[self._order]
        least = self._facing.least[self._order]
        w, tangents = vectors[:, 0], vectors[:, 1:3]
        normal = self._sign[:, None] * np.cross(tangents[:, 0], tangents[:, 1])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        gap = (w * normal).sum(axis=1)
        depth = least - gap
        if self.name in load.offsets:
            depth += load.offsets[self.name][self._order]
        energies, slope, bend = (stiffness * part for part in penalty(depth, self.onset))
        forces = np.zeros((n_points, 6, 3))
        forces[:, 0] = -slope[:, None] * normal
        # By the vector and its component: (n, 3, 3, 3, 3) for the first three vectors.
        second = np.zeros((n_points, 6, 3, 6, 3))
        second[:, 0, :, 0] = bend[:, None, None] * normal[:, :, None] * normal[:, None, :]
        touching = slope > 0.0
        if touching.any() and not convex:
            curvature = vectors[:, [3, 4, 4, 5]] @ normal[:, :, None]
            second[touching, :3, :, :3] -= slope[touching, None, None, None, None] * bent(
                gap[touching],
                normal[touching],
                tangents[touching],
                curvature.reshape(-1, 2, 2)[touching],
            )
        pairs = [second[:, :, i, :, j] for i, j in PAIRS]
        return Response(energies, forces, np.stack(pairs, axis=1))

    def augmented(self, parameters: Array, load: Load) -> Array:
        """Return the offsets that would keep the present forces without overlap, (n,)."""
        found = self._facing.project(parameters)
        depth = self._facing.least - found.gap + load.offsets.get(self.name, 0.0)
        # Points that were let go carry no force that could be kept.
        pushed = (found.host >= 0) & (self._facing.share > 0.0)
        return np.where(pushed, np.maximum(depth, 0.0), 0.0)

    def pressure(self, parameters: Array, load: Load) -> tuple[Array, Array]:
        """Return the points (n, 3) and the pressure on them by the area at rest (n,) in kPa."""
        slope = penalty(self.augmented(parameters, load), self.onset)[1]
        return self._facing.points(
            parameters
        ), self._facing.share * self.stiffness * slope / self.areas

    def penetration(self, parameters: Array, load: Load | None = None) -> float:
        """Return how deep the slave is inside the master's elements beyond that at rest, in mm.

        Samples of the slave and its flanks, borders included, are located in the master's
        elements, wherever they have gone; their depth is the distance to its boundary.
        """
        return float(self._immersion.depth(parameters).max(initial=0.0))


def bent(gap: Array, normal: Array, tangents: Array, curvature: Array) -> Array:
    """Return the second derivative of gaps by ``(w, τ1, τ2)``, see `SurfaceContact.respond`.

    Parameters
    ----------
    gap : (n,) array
    normal : (n, 3) array
    tangents : (n, 2, 3) array
    curvature : (n, 2, 2) array

    Returns
    -------
    (n, 3, 3, 3, 3) array
        Vector, component, vector, component.
    """
    n = len(gap)
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
