"""Closest points between the sides of elements that face each other.

A side of an element is a bicubic Hermite patch of 16 local functions. Points of one set of
patches, the slave, are projected onto another, the master: samples of the master's patches
find the one to begin with, Newton's method its closest point. Where that lies beyond the
border of the patch, the neighbours are asked; beyond the border of the whole surface the
patch goes on straight for its own width.

The body behind a master may end at flanks as well, as a lip does at the skin and at the mouth.
A point is inside it when it lies below the master and below all of its flanks; its distance is
the greatest of those to the sides. Where two of them are nearly alike, at an edge, they are
blended, as if the edge were round: a lip that slides out over the edge of the other is let go
there, and one that lies before the other meets its flank, however far it has slid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numba import njit, prange
from numpy.typing import ArrayLike, NDArray

from ..hermite import HermiteMesh, Side, gauss
from .assembly import Pattern
from .laws import Array

IntArray = NDArray[np.int64]

#: Samples a direction of a master patch that decide where a search begins.
SAMPLES = 4
#: Widths of a patch for which it goes on straight beyond the surface's border.
BEYOND = 1.0
#: Overlaps greater than this (mm) are those of the far side of a body, not contact.
DEEPEST = 3.0
#: Points farther than this (mm) from the master are not followed.
FREE = 0.5
#: Difference (mm) of the distances to two sides of a body below which they are blended. A quarter
#: of it is cut off at an edge, which overlaps by that much unseen.
EDGE = 0.16
#: Widths of a patch beyond the master's border at which points far from all flanks are before them.
ROOM = 0.1
#: Length of Newton's last step in local coordinates: what it leaves is about its square.
SETTLED = 1e-5
#: Parts of a patch's diagonal that its points are away from the nearest sample at most.
SPACING = 0.25
#: How many times a width beyond an edge to a neighbour counts, which is there to be met instead.
ASIDE = 4.0


@njit(cache=True)
def _cubic(t: Any, out: Any) -> None:
    """Write the four cubic Hermite functions of one variable, (3 derivatives, 4).

    Outside [0, 1] they go on straight.
    """
    at = min(1.0, max(0.0, t))
    out[0, 0] = 1.0 + at * at * (2.0 * at - 3.0)
    out[0, 1] = at * (1.0 + at * (at - 2.0))
    out[0, 2] = at * at * (3.0 - 2.0 * at)
    out[0, 3] = at * at * (at - 1.0)
    out[1, 0] = 6.0 * at * (at - 1.0)
    out[1, 1] = 1.0 + at * (3.0 * at - 4.0)
    out[1, 2] = -out[1, 0]
    out[1, 3] = at * (3.0 * at - 2.0)
    if t == at:
        out[2, 0] = 12.0 * at - 6.0
        out[2, 1] = 6.0 * at - 4.0
        out[2, 2] = -out[2, 0]
        out[2, 3] = 6.0 * at - 2.0
    else:
        for k in range(4):
            out[0, k] += (t - at) * out[1, k]
            out[2, k] = 0.0


@njit(cache=True)
def patch_functions(s: Any, t: Any, out: Any) -> None:
    """Write the 16 functions of a patch and their derivatives 1, 2, 11, 12, 22; (6, 16)."""
    a = np.empty((3, 4))
    b = np.empty((3, 4))
    _cubic(s, a)
    _cubic(t, b)
    for corner in range(4):
        for kind in range(4):
            i = 2 * (corner & 1) + (kind & 1)
            j = 2 * (corner >> 1) + (kind >> 1)
            k = 4 * corner + kind
            out[0, k] = a[0, i] * b[0, j]
            out[1, k] = a[1, i] * b[0, j]
            out[2, k] = a[0, i] * b[1, j]
            out[3, k] = a[2, i] * b[0, j]
            out[4, k] = a[1, i] * b[1, j]
            out[5, k] = a[0, i] * b[2, j]


@njit(cache=True)
def _place(local: Any, s: Any, t: Any, a: Any, b: Any, values: Any) -> None:
    """Write a point of a patch and its derivatives 1, 2, 11, 12, 22; (6, 3).

    Both directions are summed one after the other; ``a`` and ``b`` (3, 4) are for their functions.
    """
    _cubic(s, a)
    _cubic(t, b)
    values[:] = 0.0
    for p in range(4):
        for i in range(3):
            along = first = second = 0.0
            for q in range(4):
                x = local[4 * (p // 2 + 2 * (q // 2)) + p % 2 + 2 * (q % 2), i]
                along += b[0, q] * x
                first += b[1, q] * x
                second += b[2, q] * x
            values[0, i] += a[0, p] * along
            values[1, i] += a[1, p] * along
            values[2, i] += a[0, p] * first
            values[3, i] += a[2, p] * along
            values[4, i] += a[1, p] * first
            values[5, i] += a[0, p] * second


@njit(cache=True)
def closest_of(local: Any, point: Any, xi: Any, values: Any) -> Any:
    """Newton's method for the closest point of a patch, from ``xi`` on, which is overwritten.

    ``values`` (6, 3) are left as they were before the last step, which is shorter than `SETTLED`.
    Returns whether the search has settled.
    """
    a, b = np.empty((3, 4)), np.empty((3, 4))
    for _ in range(40):
        _place(local, xi[0], xi[1], a, b, values)
        r0 = r1 = a00 = a01 = a11 = k00 = k01 = k11 = 0.0
        for i in range(3):
            w = point[i] - values[0, i]
            r0 += w * values[1, i]
            r1 += w * values[2, i]
            a00 += values[1, i] * values[1, i]
            a01 += values[1, i] * values[2, i]
            a11 += values[2, i] * values[2, i]
            k00 += w * values[3, i]
            k01 += w * values[4, i]
            k11 += w * values[5, i]
        m00, m01, m11 = a00 - k00, a01 - k01, a11 - k11
        det = m00 * m11 - m01 * m01
        if not (m00 > 0.05 * a00 and det > 0.05 * (a00 * a11 - a01 * a01)):
            m00, m01, m11 = a00, a01, a11
            det = m00 * m11 - m01 * m01
        if not det > 1e-12 * a00 * a11:
            return False
        d0 = (m11 * r0 - m01 * r1) / det
        d1 = (m00 * r1 - m01 * r0) / det
        length = max(abs(d0), abs(d1))
        factor = 0.5 / max(length, 0.5)
        before0, before1 = xi[0], xi[1]
        xi[0] = min(1.0 + BEYOND, max(-BEYOND, before0 + factor * d0))
        xi[1] = min(1.0 + BEYOND, max(-BEYOND, before1 + factor * d1))
        if length < SETTLED:
            return True
        # What leads on where the patch ends leads nowhere.
        if max(abs(xi[0] - before0), abs(xi[1] - before1)) < 0.1 * factor * length:
            return False
    return False


@njit(cache=True)
def _sampled(parameters: Any, patches: Any, extraction: Any) -> Any:
    """Return the local parameters of patches (f, 16, 3), samples of them and their widths in mm."""
    n_patches, m = patches.shape
    local = np.zeros((n_patches, 16, 3))
    samples = np.zeros((n_patches, SAMPLES * SAMPLES, 3))
    size = np.zeros(n_patches)
    functions = np.empty((6, 16))
    for f in range(n_patches):
        for k in range(16):
            for a in range(m):
                e = extraction[f, k, a]
                if e != 0.0:
                    for i in range(3):
                        local[f, k, i] += e * parameters[patches[f, a], i]
        for c in range(SAMPLES * SAMPLES):
            patch_functions(
                (c % SAMPLES + 0.5) / SAMPLES, (c // SAMPLES + 0.5) / SAMPLES, functions
            )
            for k in range(16):
                for i in range(3):
                    samples[f, c, i] += functions[0, k] * local[f, k, i]
        for one, other in ((0, SAMPLES * SAMPLES - 1), (SAMPLES - 1, SAMPLES * (SAMPLES - 1))):
            diagonal = 0.0
            for i in range(3):
                diagonal += (samples[f, one, i] - samples[f, other, i]) ** 2
            size[f] = max(size[f], np.sqrt(diagonal))
    return local, samples, size


@njit(cache=True)
def _nearest(samples: Any, point: Any) -> Any:
    """Return the squared distance of the nearest sample of a patch, and its number."""
    least, nearest = np.inf, 0
    for q in range(SAMPLES * SAMPLES):
        d = 0.0
        for i in range(3):
            d += (point[i] - samples[q, i]) ** 2
        if d < least:
            least, nearest = d, q
    return least, nearest


@njit(cache=True)
def _overhang(xi: Any, inner: Any) -> Any:
    """Return how far local coordinates are outside a patch.

    Beyond the surface's border the patch that ends there goes on, not its neighbours.
    """
    out = 0.0
    for edge in range(4):
        over = xi[edge // 2] - 1.0 if edge % 2 else -xi[edge // 2]
        out += max(over, 0.0) * (ASIDE if inner[edge] else 1.0)
    return out


@njit(cache=True)
def _height(values: Any, point: Any) -> Any:
    """Return how far a point is along the normal of the tangents ``values[1:3]``."""
    n0 = values[1, 1] * values[2, 2] - values[1, 2] * values[2, 1]
    n1 = values[1, 2] * values[2, 0] - values[1, 0] * values[2, 2]
    n2 = values[1, 0] * values[2, 1] - values[1, 1] * values[2, 0]
    along = n0 * (point[0] - values[0, 0])
    along += n1 * (point[1] - values[0, 1]) + n2 * (point[2] - values[0, 2])
    return along / np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)


@njit(cache=True)
def _distances(samples: Any, size: Any, point: Any, side: Any, near: Any, seed: Any) -> Any:
    """Write each patch's nearest sample and its squared distance, and tell whether one is close."""
    close = False
    for c in range(len(side)):
        f = side[c]
        near[c], seed[c] = _nearest(samples[f], point)
        close = close or near[c] < (size[f] + DEEPEST) ** 2
    return close


@njit(cache=True)
def _closest_patch(
    local: Any,
    size: Any,
    sign: Any,
    inner: Any,
    point: Any,
    side: Any,
    near: Any,
    seed: Any,
    xi: Any,
) -> Any:
    """Return the patch of a side that a point faces, its gap and how far outside the foot is.

    The patches are tried in the order of their nearest sample, until none can be closer. The
    foot is written to ``xi``; ``near`` is used up.
    """
    values, trial = np.empty((6, 3)), np.empty(2)
    patch = -1
    least = over = np.inf
    for _ in range(len(side)):
        first = np.argmin(near)
        f = side[first]
        reach = abs(least) + SPACING * size[f]
        if near[first] == np.inf or (over <= 1e-9 and near[first] > reach**2):
            break
        near[first] = np.inf
        trial[0] = (seed[first] % SAMPLES + 0.5) / SAMPLES
        trial[1] = (seed[first] // SAMPLES + 0.5) / SAMPLES
        if not closest_of(local[f], point, trial, values):
            continue
        out = _overhang(trial, inner[f])
        if out > BEYOND:
            continue
        gap = sign[f] * _height(values, point)
        if out < over - 1e-9 or (out <= 1e-9 and abs(gap) < abs(least)):
            patch, least, over = f, gap, out
            xi[:] = trial
    return patch, least, over


@njit(cache=True, parallel=True)
def project(
    parameters: Any,
    patches: Any,
    extraction: Any,
    sign: Any,
    part: Any,
    inner: Any,
    points: Any,
    candidates: Any,
    host: Any,
    xi: Any,
    gap: Any,
    outside: Any,
) -> None:
    """Project points onto the patches of a master.

    Parameters
    ----------
    parameters : (n_params, 3) array
    patches : (f, m) int array
        Global parameters of each patch.
    extraction : (f, 16, m) array
        Local parameters of a patch from its global ones.
    sign : (f,) array
        1 where the cross product of a patch's tangents points out of the body, else -1.
    part : (f,) int array
        0 for patches of the master itself, then the number of their flank.
    inner : (f, 4) bool array
        See `Patches.inner`.
    points : (n, 3) array
    candidates : (n, c) int array
        Patches that may meet a point, padded with -1.
    host : (n, parts) int array, written
        Patch, or -1 where none faces the point, or it is deeper than `DEEPEST`. The flanks are
        not asked about points that the master itself has before it by more than `FREE`.
    xi : (n, parts, 2) array, written
    gap : (n, parts) array, written
        Signed distance along the outward normal in mm; infinite where none is near.
    outside : (n, parts) array, written
        How far the projection lies outside its patch, in local coordinates, added up; beyond edges
        to a neighbour it counts `ASIDE` times. Infinite for points beside the surface, 0 for those
        that are far away.
    """
    local, samples, size = _sampled(parameters, patches, extraction)
    width = candidates.shape[1]
    host[:] = -1
    gap[:] = np.inf
    outside[:] = 0.0
    for p in prange(len(points)):
        side, near, seed = np.empty(width, np.int64), np.empty(width), np.empty(width, np.int64)
        for s in range(host.shape[1]):
            count = 0
            for f in candidates[p]:
                if f >= 0 and part[f] == s:
                    side[count] = f
                    count += 1
            these, gaps, seeds = side[:count], near[:count], seed[:count]
            if _distances(samples, size, points[p], these, gaps, seeds):
                chosen, least, over = _closest_patch(
                    local, size, sign, inner, points[p], these, gaps, seeds, xi[p, s]
                )
                if chosen >= 0:
                    gap[p, s], outside[p, s] = least, over
                    host[p, s] = chosen if least > -DEEPEST else -1
                else:
                    outside[p, s] = np.inf
            if FREE < gap[p, 0] < np.inf:
                break


@njit(cache=True)
def relate(places: Any, xi: Any, pairs: Any, slave: Any, master: Any, functions: Any) -> None:
    """Write the functionals of points: ``x_slave - x_master`` and the master's derivatives.

    Parameters
    ----------
    places : (k, 2) array
        Local coordinates of the points on the slave's patches.
    xi : (k, 2) array
        Local coordinates of their projections.
    pairs : (k,) int array
        Patches that meet there.
    slave, master : (g, 16, m) arrays
        Local parameters of the two patches from the parameters of those that meet.
    functions : (k, 6, m) array, written
        For each point the difference of the positions and the derivatives 1, 2, 11, 12, 22 of
        the master's.
    """
    here = np.empty((6, 16))
    there = np.empty((6, 16))
    for k in range(len(pairs)):
        patch_functions(places[k, 0], places[k, 1], here)
        patch_functions(xi[k, 0], xi[k, 1], there)
        for a in range(functions.shape[2]):
            for d in range(6):
                total = 0.0
                for c in range(16):
                    total += there[d, c] * master[pairs[k], c, a]
                functions[k, d, a] = total
            total = 0.0
            for c in range(16):
                total += here[0, c] * slave[pairs[k], c, a]
            functions[k, 0, a] = total - functions[k, 0, a]


@dataclass(frozen=True)
class Patches:
    """Sides of elements as bicubic patches.

    Attributes
    ----------
    surface : HermiteMesh
        The sides, of dimension 2.
    sign : (f,) array
        1 where the cross product of the tangents points out of the body, else -1.
    part : (f,) int array
        0 for the first of the sides, and so on.
    pattern : Pattern
        Global parameters of each patch.
    extraction : (f, 16, m) array
        Local parameters of a patch from its global ones.
    """

    surface: HermiteMesh
    sign: Array
    part: IntArray
    pattern: Pattern
    extraction: Array

    @classmethod
    def of(cls, mesh: HermiteMesh, *sides: Side) -> Patches:
        """Take sides of elements of a volume mesh; see `HermiteMesh.face`."""
        surface, outward = mesh.boundary(sides)
        hosts = np.repeat(np.arange(surface.n_elements), 16)
        pattern = Pattern.from_functions(surface.extraction, hosts, surface.n_elements)
        return cls(
            surface,
            outward.astype(float),
            np.repeat(np.arange(len(sides)), [len(elements) for elements, _, _ in sides]),
            pattern,
            pattern.dense(surface.extraction, hosts).reshape(len(pattern.params), 16, -1),
        )

    def points(self, unit: Array, weights: Array) -> tuple[IntArray, Array, Array]:
        """Return the points of a rule on [0, 1]²: patches (q,), xi (q, 2) and areas (q,) in mm²."""
        count = self.surface.n_elements
        patches, xi = np.repeat(np.arange(count), len(unit)), np.tile(unit, (count, 1))
        return patches, xi, np.tile(weights, count) * self.stretch(patches, xi)

    def stretch(self, patches: IntArray, xi: Array) -> Array:
        """Return mm² by unit of local coordinates at points of the patches at rest, (n,)."""
        tangents = self.surface.jacobian(patches, xi)
        return np.asarray(np.linalg.norm(np.cross(tangents[:, :, 0], tangents[:, :, 1]), axis=1))

    @cached_property
    def inner(self) -> NDArray[np.bool_]:
        """Which edges a patch shares with another of its side, (f, 4): ξ1 = 0, 1, ξ2 = 0, 1."""
        corners, _ = self.surface.corner_nodes()
        edges = np.sort(corners[:, [[0, 2], [1, 3], [0, 1], [2, 3]]], axis=2)
        keys = np.dstack([np.broadcast_to(self.part[:, None], edges.shape[:2]), edges])
        _, which, counts = np.unique(
            keys.reshape(-1, 3), axis=0, return_inverse=True, return_counts=True
        )
        return np.asarray(counts[which].reshape(-1, 4) > 1)

    def neighbours(self) -> NDArray[np.bool_]:
        """Tell which patches share a corner, (f, f)."""
        corners, _ = self.surface.corner_nodes()
        used = sp.csr_matrix(
            (
                np.ones(corners.size),
                (np.repeat(np.arange(len(corners)), corners.shape[1]), corners.ravel()),
            )
        )
        return np.asarray((used @ used.T).toarray() > 0)


@dataclass(frozen=True)
class Projection:
    """Where points lie before the body of a master.

    Attributes
    ----------
    host : (n, 2) int array
        The patch that is nearest to the surface of the body, and the one that is blended with it;
        -1 where there is none.
    xi : (n, 2, 2) array
        Places on these.
    distance : (n,) array
        To the rounded body in mm, negative inside; infinite where nothing faces the point.
    """

    host: IntArray
    xi: Array
    distance: Array


def blended(first: Any, second: Any) -> tuple[Any, Any]:
    """Return the greater of two distances (n,), rounded where they are nearly alike.

    With the difference ``δ`` and ``r`` = `EDGE` it is ``(a + b)/2 + δ²/4r + r/4``, which for
    ``|δ| = r`` is the greater one, with its slope.

    Returns
    -------
    distance : (n,) array
    share : (n,) array
        Its derivative by the first; that by the second is the rest to 1.
    """
    apart = np.clip(first - second, -EDGE, EDGE)
    distance = 0.5 * (first + second) + apart**2 / (4.0 * EDGE) + 0.25 * EDGE
    return np.where(abs(first - second) < EDGE, distance, np.maximum(first, second)), (
        0.5 + 0.5 * apart / EDGE
    )


def segments(slave: Patches, master: Patches, n: int = 4) -> tuple[IntArray, Array, Array]:
    """Return points of a slave that integrate exactly where the master's patches end.

    The borders of the master's patches are projected onto those of the slave, as straight
    lines in their local coordinates, and cut these into polygons; each polygon is integrated
    over the triangles from its middle. On plane sides with straight edges an even pressure
    is handed on exactly, whether the meshes match or not.

    Parameters
    ----------
    slave, master : Patches
        Surfaces that touch or nearly do.
    n : int
        Gauss points a direction of each triangle.

    Returns
    -------
    patches : (q,) int array
    xi : (q, 2) array
    areas : (q,) array
        In mm².
    """
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    unit, unit_weights = gauss(2, n)
    values, xi = np.empty((6, 3)), np.empty(2)
    rest = slave.surface.local()
    patches: list[int] = []
    places: list[Array] = []
    shares: list[Array] = []
    for f in range(master.surface.n_elements):
        points = master.surface.evaluate([f] * 4, corners)
        for e in range(slave.surface.n_elements):
            polygon = []
            for point in points:
                xi[:] = 0.5
                closest_of(rest[e], point, xi, values)
                polygon.append(xi.copy())
            cut = _clipped(polygon)
            middle = np.mean(cut, axis=0) if len(cut) > 2 else None
            for k in range(len(cut)):
                if middle is None:
                    break
                one, other = cut[k - 1] - middle, cut[k] - middle
                area = abs(one[0] * other[1] - one[1] * other[0])
                if area < 1e-12:
                    continue
                # The square collapsed onto the triangle.
                u, v = unit[:, :1], unit[:, 1:]
                places.append(middle + u * ((1.0 - v) * one + v * other))
                shares.append(unit_weights * unit[:, 0] * area)
                patches += [e] * len(unit)
    at = np.asarray(patches, dtype=np.int64)
    where = np.concatenate(places) if places else np.empty((0, 2))
    return at, where, np.concatenate([*shares, np.empty(0)]) * slave.stretch(at, where)


def _clipped(polygon: list[Array]) -> list[Array]:
    """Cut a polygon to the unit square, border after border (Sutherland and Hodgman 1974)."""
    for axis, side in ((0, 0.0), (0, 1.0), (1, 0.0), (1, 1.0)):
        kept: list[Array] = []
        for k, end in enumerate(polygon):
            begin = polygon[k - 1]
            a, b = ((1.0 if side == 0.0 else -1.0) * (p[axis] - side) for p in (begin, end))
            if (a > 0.0) != (b > 0.0):
                kept.append(begin + a / (a - b) * (end - begin))
            if b > 0.0:
                kept.append(end)
        polygon = kept
    return polygon


class Facing:
    """Points of a slave surface before a master surface.

    Parameters
    ----------
    slave, master : Patches
        Of one mesh. Sides of the master but the first are its flanks.
    patches : (n,) int array
        Slave patch of each point.
    xi : (n, 2) array

    Attributes
    ----------
    least : (n,) array
        Distance (mm) from which on a point is pushed: 0, or less where it is deeper at rest.
    """

    def __init__(self, slave: Patches, master: Patches, patches: ArrayLike, xi: ArrayLike) -> None:
        self.slave, self.master = slave, master
        self.patches = np.asarray(patches, dtype=np.int64)
        self.xi = np.asarray(xi, dtype=float)
        self.functions = slave.surface.functions(self.patches, self.xi)
        # Who may meet whom: the patches found at rest and those around them, flanks included.
        rest = slave.surface.parameters
        own = HermiteMesh(2, rest, master.surface.extraction[: 16 * int((master.part == 0).sum())])
        found = own.locate(np.asarray(self.functions @ rest)).elements
        met = np.zeros((slave.surface.n_elements, master.surface.n_elements), dtype=bool)
        met[self.patches, found] = True
        #: Which patches of the master a patch of the slave may meet, (slaves, masters).
        self.allowed = (met @ master.neighbours()) > 0
        width = int(self.allowed.sum(axis=1).max(initial=1))
        table = np.full((len(self.allowed), width), -1)
        for row, may in enumerate(self.allowed):
            table[row, : may.sum()] = np.flatnonzero(may)
        self._candidates = np.ascontiguousarray(table[self.patches])
        parts = master.part[:, None] != master.part
        #: Which patches of the master end its body along one edge, (masters, masters).
        self.adjacent = master.neighbours() & parts
        self._known: tuple[Array, Projection] | None = None
        self.least = np.minimum(self.project(rest).distance, 0.0)

    def points(self, parameters: Array) -> Array:
        """Return the points of the slave (n, 3)."""
        return np.asarray(self.functions @ parameters)

    def project(self, parameters: Array) -> Projection:
        """Find the closest points of the sides that end the body next to each point."""
        if self._known is None or not np.array_equal(self._known[0], parameters):
            self._known = parameters.copy(), self._project(parameters)
        return self._known[1]

    def _project(self, parameters: Array) -> Projection:
        master = self.master
        n, parts = len(self.patches), int(master.part.max()) + 1
        host, xi = np.empty((n, parts), np.int64), np.empty((n, parts, 2))
        gap, outside = np.empty((n, parts)), np.empty((n, parts))
        project(
            parameters,
            master.pattern.params,
            master.extraction,
            master.sign,
            master.part,
            master.inner,
            np.ascontiguousarray(self.points(parameters)),
            self._candidates,
            host,
            xi,
            gap,
            outside,
        )
        each = np.arange(n)[:, None]
        # Far below the master itself, or beside it, flanks tell alone who is inside; beside it only
        # where they have the foot of the point.
        host[:, 1:][np.isinf(gap[:, :1]) & (outside[:, 1:] > 1e-9)] = -1
        # Flanks that do not face a point are far away: on this side of it where it is beyond the
        # master's border, else on the other.
        if parts > 1:
            host[(outside[:, 0] > ROOM) & (host[:, 1:] < 0).all(axis=1), 0] = -1
        gap = np.where(host >= 0, gap, -np.inf)
        order = np.argsort(-gap, axis=1, kind="stable")[:, :2]
        gap, host, xi = gap[each, order], host[each, order], xi[each, order]
        distance = np.where(host[:, 0] >= 0, gap[:, 0], np.inf)
        if parts == 1:
            host = np.insert(host, 1, -1, axis=1)
        else:
            near = (host[:, 1] >= 0) & (gap[:, 1] > gap[:, 0] - EDGE)
            near[near] = self.adjacent[host[near, 0], host[near, 1]]
            distance[near] = blended(gap[near, 0], gap[near, 1])[0]
            host[~near, 1] = -1
        return Projection(host, xi, distance)


class Immersion:
    """How deep the boundary of one body is inside another.

    Parameters
    ----------
    mesh : HermiteMesh
        Of dimension 3.
    sides : sequence of (elements, axis, side)
        Boundary of the body that may sink in.
    around : sequence of (elements, axis, side)
        Boundary of the other; the first of them names all of its elements.
    n : int
        Samples a direction of each side.
    """

    def __init__(
        self, mesh: HermiteMesh, sides: Sequence[Side], around: Sequence[Side], n: int = 6
    ) -> None:
        ticks = np.linspace(0.0, 1.0, n)
        cell = np.stack(np.meshgrid(ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 2)

        def samples(surface: HermiteMesh) -> sp.csr_matrix:
            patches = np.repeat(np.arange(surface.n_elements), len(cell))
            return surface.functions(patches, np.tile(cell, (surface.n_elements, 1)))

        rows = np.asarray(around[0][0])[:, None] * 64 + np.arange(64)
        self._body = HermiteMesh(3, mesh.parameters, mesh.extraction[rows.ravel()])
        self._boundary = Patches.of(mesh, *around).surface
        self._samples = samples(Patches.of(mesh, *sides).surface)
        self._corners = samples(self._boundary)
        self.least = self._depth(mesh.parameters)

    def _depth(self, parameters: Array) -> Array:
        points = np.asarray(self._samples @ parameters)
        depth = np.zeros(len(points))
        box = np.asarray(self._corners @ parameters)
        near = ((points > box.min(axis=0) - 0.5) & (points < box.max(axis=0) + 0.5)).all(axis=1)
        if near.any():
            near[near] = self._body.with_parameters(parameters).locate(points[near]).inside
        if near.any():
            place = self._boundary.with_parameters(parameters).locate(points[near])
            depth[near] = place.distance
        return depth

    def depth(self, parameters: Array) -> Array:
        """Return how much deeper than at rest each sample is inside the other body, in mm."""
        return np.maximum(self._depth(parameters) - self.least, 0.0)


class Meetings:
    """Patches that may meet, the parameters that they share, and the functionals of points there.

    Parameters
    ----------
    facing : Facing
    slaves : (g,) int array
        Patch of the slave in every meeting.
    masters : (g, c) int array
        Patches of the master in it, in ascending order.
    """

    def __init__(self, facing: Facing, slaves: IntArray, masters: IntArray) -> None:
        self.facing = facing
        count = len(slaves)
        sides = [(facing.slave, slaves), *((facing.master, column) for column in masters.T)]
        rows = sp.csr_matrix(
            sp.vstack(
                [
                    side.surface.extraction[(16 * patches[:, None] + np.arange(16)).ravel()]
                    for side, patches in sides
                ]
            )
        )
        hosts = np.tile(np.repeat(np.arange(count), 16), len(sides))
        self.pattern = Pattern.from_functions(rows, hosts, count)
        dense = self.pattern.dense(rows, hosts)
        self._local = np.ascontiguousarray(dense.reshape(len(sides), count, 16, dense.shape[1]))
        shape = (facing.allowed.shape[0], *[facing.allowed.shape[1]] * masters.shape[1])
        self._number = np.full(shape, -1)
        self._number[(slaves, *masters.T)] = np.arange(count)

    @classmethod
    def sides(cls, facing: Facing) -> Meetings:
        """Return the meetings of a patch of the slave with one of the master."""
        slaves, masters = np.nonzero(facing.allowed)
        return cls(facing, slaves, masters[:, None])

    @classmethod
    def edges(cls, facing: Facing) -> Meetings:
        """Return the meetings of a patch of the slave with two of the master that share an edge."""
        both = facing.allowed[:, :, None] & facing.allowed[:, None, :] & np.triu(facing.adjacent)
        slaves, *masters = np.nonzero(both)
        return cls(facing, slaves, np.stack(masters, axis=1))

    def functionals(
        self, points: IntArray, hosts: IntArray, xi: Array
    ) -> tuple[Array, IntArray, IntArray]:
        """Return the functionals of some points that face the master.

        Parameters
        ----------
        points : (k,) int array
        hosts : (k, c) int array
            Patches of the master that each of them faces, in ascending order.
        xi : (k, c, 2) array
            Where.

        Returns
        -------
        functions : (6 c k, m) array
            See `relate`; of one point for one patch after the other.
        starts : (g + 1,) int array
            Rows of each meeting.
        order : (k,) int array
            Places in ``points``, sorted by their meeting.
        """
        number = self._number[(self.facing.patches[points], *hosts.T)]
        order = np.argsort(number, kind="stable")
        number, at = number[order], self.facing.xi[points[order]]
        count = hosts.shape[1]
        functions = np.empty((len(order), 6 * count, self.pattern.params.shape[1]))
        for k in range(count):
            part = functions[:, 6 * k : 6 * k + 6]
            relate(at, xi[order, k], number, self._local[0], self._local[1 + k], part)
        counts = np.bincount(number, minlength=len(self._local[0]))
        starts = np.concatenate([[0], np.cumsum(counts)])
        return functions.reshape(-1, functions.shape[2]), 6 * count * starts, order
