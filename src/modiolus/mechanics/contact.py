"""Contact by penalty: tissue against rigid bodies, and tissue against itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ..errors import InputError
from ..hermite import HermiteMesh
from .assembly import Pattern
from .laws import PAIRS, Array
from .terms import IntArray, Load, PointTerm, Response, by_host


class SignedDistance(Protocol):
    """Anything that knows the signed distance of points, such as a `DistanceGrid`."""

    def sample(self, points: Array) -> tuple[Array, Array, Array]:
        """Return distance (n,), gradient (n, 3) and Hessian (n, 3, 3); negative inside."""


def penalty(depth: Array, onset: float) -> tuple[Array, Array, Array]:
    """Return the unit penalty of a depth (n,), its slope and its second derivative.

    Zero for negative depths and ``depth²/2 - …`` with unit stiffness beyond ``onset``; in
    between the stiffness grows linearly from zero. Resting tissue touches itself and bone at
    hundreds of points; were the stiffness to jump there, Newton's method would need three to
    seven times as many factorisations.
    """
    t = np.maximum(depth, 0.0)
    soft = t < onset
    width = max(onset, 1e-12)
    energy = np.where(soft, t**3 / (6.0 * width), t * (t - onset) / 2.0 + onset**2 / 6.0)
    slope = np.where(soft, t**2 / (2.0 * width), t - onset / 2.0)
    bend = np.where(soft, t / width, 1.0)
    return energy, slope, bend


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
        self.least = np.minimum(self.rest, 0.0)

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
        energies, slope, bend = penalty(self.least - distance, self.onset)
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

    def penetration(self, vectors: Array, load: Load | None = None) -> float:
        """Return the greatest depth below the body's surface beyond that at rest, in mm."""
        distance, _, _ = self.sample(vectors, Load() if load is None else load)
        return float(np.maximum(self.least - distance, 0.0).max(initial=0.0))


class PairContact(PointTerm):
    """Matched points of two facing surfaces: lip on lip, lid on lid.

    The gap of a pair is ``g = (x_upper - x_lower) · n``, with ``n`` the mean normal of the
    two surfaces, pointing from the lower to the upper one. It turns with the surfaces from
    one load step to the next and stands still within one. Gaps below ``min(g_rest, 0)``
    by ``t`` have the energy ``ε A penalty(t)``.

    Parameters
    ----------
    mesh : HermiteMesh
        Tissue at rest, of dimension 3.
    upper, lower : pair of (elements (n,), xi (n, 3))
        Matched points on the two surfaces.
    axis : int
        Both surfaces are faces of constant ``xi_axis``.
    areas : (n,) array
        In mm².
    stiffness : float
        ε in kPa/mm.
    onset : float
        Depth in mm over which the stiffness grows to ε.
    name : str
    """

    def __init__(
        self,
        mesh: HermiteMesh,
        upper: tuple[ArrayLike, ArrayLike],
        lower: tuple[ArrayLike, ArrayLike],
        axis: int,
        areas: ArrayLike,
        stiffness: float = 100.0,
        onset: float = 0.1,
        name: str = "pair contact",
    ) -> None:
        pairs = np.stack([np.asarray(upper[0]), np.asarray(lower[0])], axis=1)
        kinds, hosts = np.unique(pairs, axis=0, return_inverse=True)
        order = by_host(hosts.ravel())
        hosts = hosts.ravel()[order]
        if not stiffness >= 0.0:
            raise InputError(f"{name}: stiffness {stiffness} is not a number from 0 up; mend it")
        sides = [
            (np.asarray(e)[order], np.asarray(xi, dtype=float)[order]) for e, xi in (upper, lower)
        ]
        (upper_functions, lower_functions) = (mesh.functions(*side) for side in sides)
        functions = sp.csr_matrix(upper_functions - lower_functions)
        super().__init__(name, functions, hosts)
        self._n_hosts = len(kinds)
        self.stiffness = stiffness * np.asarray(areas, dtype=float)[order]
        units = [[int(k == other) for k in range(3)] for other in range(3) if other != axis]
        self.onset = onset
        self._tangents = [[mesh.functions(*side, unit) for unit in units] for side in sides]
        gap = np.asarray(functions @ mesh.parameters)
        normals = self._raw_normals(mesh.parameters)
        # Each surface's normal is turned to point from the lower to the upper surface; when
        # they touch at rest, the vector between the host elements' centres decides.
        centre = np.full((len(hosts), 3), 0.5)
        apart = mesh.evaluate(sides[0][0], centre) - mesh.evaluate(sides[1][0], centre)
        towards = np.where((gap**2).sum(axis=1, keepdims=True) > 1e-4, gap, apart)
        self._signs = [np.where((n * towards).sum(axis=1) < 0.0, -1.0, 1.0) for n in normals]
        self.normals = self._mean_normals(normals)
        self.least = np.minimum((gap * self.normals).sum(axis=1), 0.0)

    def pattern(self) -> Pattern:
        """Return the pattern of the pairs of host elements."""
        return Pattern.from_functions(self.functions, self.hosts, self._n_hosts)

    def _raw_normals(self, parameters: Array) -> list[Array]:
        out = []
        for first, second in self._tangents:
            normal = np.cross(np.asarray(first @ parameters), np.asarray(second @ parameters))
            length = np.linalg.norm(normal, axis=1, keepdims=True)
            out.append(normal / np.maximum(length, 1e-12))
        return out

    def _mean_normals(self, normals: list[Array]) -> Array:
        mean = sum(s[:, None] * n for s, n in zip(self._signs, normals, strict=True))
        return np.asarray(mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12))

    def update(self, parameters: Array) -> None:
        """Turn the normals with the surfaces."""
        self.normals = self._mean_normals(self._raw_normals(parameters))

    def respond(self, vectors: Array, load: Load, convex: bool = False) -> Response:
        """Evaluate the penalty at fixed normals."""
        n = self.normals
        energies, slope, bend = (
            self.stiffness * part
            for part in penalty(self.least - (vectors * n).sum(axis=1), self.onset)
        )
        stiffness = np.stack([bend * n[:, i] * n[:, j] for i, j in PAIRS], axis=1)
        return Response(energies, -slope[:, None] * n, stiffness)

    def penetration(self, vectors: Array, load: Load | None = None) -> float:
        """Return the greatest overlap beyond that at rest, in mm."""
        gap = (vectors * self.normals).sum(axis=1)
        return float(np.maximum(self.least - gap, 0.0).max(initial=0.0))


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
