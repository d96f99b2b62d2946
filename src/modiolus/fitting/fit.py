"""Least-squares fits of Hermite meshes to data clouds and surfaces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from ..anatomy.surface import Surface
from ..errors import InputError, SolveError
from ..hermite import HermiteMesh
from ..hermite.basis import Array, basis
from ..hermite.check import numbers
from ..hermite.quadrature import gauss
from .definite import Definite


@dataclass(frozen=True, eq=False)
class CloudTarget:
    """Data points that a part of the mesh should pass through.

    Every point is projected to the part at the start of each iteration.

    Attributes
    ----------
    name : str
    part : callable
        Picks the part (the mesh itself, faces or edges of it) from the current mesh.
    points : (n, 3) array
        Data in mm.
    weight : float or (n,) array
    sliding : float
        Weight of the tangential residual relative to the normal one (1: none slides).
        Only on surfaces; on curves and volumes nothing slides.
    reject : float
        Points farther than this (mm) are left out of the iteration.
    """

    name: str
    part: Callable[[HermiteMesh], HermiteMesh]
    points: Array
    weight: float | Array = 1.0
    sliding: float = 1.0
    reject: float = np.inf

    def __post_init__(self) -> None:
        _check(self.name, self.weight, self.sliding, len(numbers(self.name, self.points, None, 3)))


@dataclass(frozen=True, eq=False)
class SurfaceTarget:
    """A surface that sample points of a part of the mesh should lie on.

    Attributes
    ----------
    name : str
    part : callable
        Picks the part from the current mesh; it shares the mesh's parameters.
    surface : Surface
    samples : int
        Gauss points a direction in every element of the part.
    weight : float
        Of the mean sample.
    sliding, reject
        As for `CloudTarget`.
    """

    name: str
    part: Callable[[HermiteMesh], HermiteMesh]
    surface: Surface
    samples: int = 4
    weight: float = 1.0
    sliding: float = 0.0
    reject: float = np.inf

    def __post_init__(self) -> None:
        _check(self.name, self.weight, self.sliding)


@dataclass(frozen=True, eq=False)
class PointTarget:
    """Fixed places of the mesh that should lie at given points.

    Attributes
    ----------
    name : str
    elements : (n,) int array
    xi : (n, dim) array
    points : (n, 3) array
    weight : float or (n,) array
    normals : (n, 3) array, optional
        Unit directions across which the places may slide.
    sliding : float
        As for `CloudTarget`; it counts only where there are normals.
    """

    name: str
    elements: NDArray[np.int64]
    xi: Array
    points: Array
    weight: float | Array = 1.0
    normals: Array | None = None
    sliding: float = 0.0

    def __post_init__(self) -> None:
        n = len(numbers(self.name, self.points, None, 3))
        _check(self.name, self.weight, self.sliding, n)
        if self.normals is not None:
            numbers(f"{self.name}: normals", self.normals, n, 3)
        if len(self.elements) != n or len(self.xi) != n:
            raise InputError(f"{self.name}: {len(self.xi)} places, {n} points; give one each")


@dataclass(frozen=True, eq=False)
class PairTarget:
    """Pairs of fixed places of the mesh that should be so far apart.

    Attributes
    ----------
    name : str
    first, second : ((n,) int array, (n, dim) array)
        Elements and local coordinates.
    apart : (n, 3) array
        From the second place to the first (mm).
    weight : float
    """

    name: str
    first: tuple[NDArray[np.int64], Array]
    second: tuple[NDArray[np.int64], Array]
    apart: Array
    weight: float = 1.0

    def __post_init__(self) -> None:
        n = len(numbers(self.name, self.apart, None, 3))
        _check(self.name, self.weight, 1.0, n)
        if any(len(part) != n for part in (*self.first, *self.second)):
            raise InputError(f"{self.name}: not a pair of places for {n} distances; give one each")


def _check(name: str, weight: float | Array, sliding: float, n: int = 1) -> None:
    if np.shape(weight) not in ((), (n,)) or not (np.asarray(weight) >= 0.0).all():
        raise InputError(f"{name}: weights are not one, or one a point, from 0 up; mend them")
    if not 0.0 <= sliding <= 1.0:
        raise InputError(f"{name}: sliding {sliding:g} is not within 0 to 1; mend it")


Target = CloudTarget | SurfaceTarget | PointTarget | PairTarget


@dataclass(frozen=True)
class Smoothing:
    """Sobolev penalty on first and second derivatives by xi.

    Attributes
    ----------
    first : float or sequence of dim floats
        Weight of each first derivative.
    second : float or sequence of dim * (dim + 1) / 2 floats
        Weights of the second derivatives, pure ones first, then 12, 13, 23.
    relative : bool or HermiteMesh
        Penalise the change from the initial mesh, or from one given, instead of the derivative
        itself.
    points : int
        Gauss points a direction; with 4 the integrals are exact.
    stiffness : float or (n_elements,) array
        Factor of the whole penalty in each element.
    """

    first: float | Sequence[float] = 0.0
    second: float | Sequence[float] = 1e-2
    relative: bool | HermiteMesh = False
    points: int = 4
    stiffness: float | Array = 1.0


@dataclass(frozen=True)
class GroupReport:
    """Residuals after the fit: root mean square, 95th percentile, maximum (mm), and how many.

    They are the distances whose weighted squares are minimised: where a target slides, the
    tangential part counts by the root of its share. Not numbers where there are none.
    """

    rms: float
    p95: float
    maximum: float
    count: int


@dataclass(frozen=True, eq=False)
class FitResult:
    """A fitted mesh and what it was fitted to.

    Attributes
    ----------
    mesh : HermiteMesh
    targets : sequence of CloudTarget, SurfaceTarget, PointTarget or PairTarget
    """

    mesh: HermiteMesh
    targets: Sequence[Target]

    @cached_property
    def groups(self) -> dict[str, GroupReport]:
        """Residuals by target name; targets of the same name count together."""
        distances: dict[str, list[Array]] = {}
        for target in self.targets:
            found = _residual(target, self.mesh).distances(self.mesh.parameters)
            distances.setdefault(target.name, []).append(found)
        return {name: _report(np.concatenate(found)) for name, found in distances.items()}


def _derivative_orders(dim: int) -> tuple[list[tuple[int, ...]], list[tuple[int, ...]]]:
    unit = np.eye(dim, dtype=int)
    first = [tuple(u) for u in unit]
    pairs = [(k, k) for k in range(dim)]
    pairs += [(a, b) for a in range(dim) for b in range(a + 1, dim)]
    second = [tuple(unit[a] + unit[b]) for a, b in pairs]
    return first, second


def sobolev(mesh: HermiteMesh, smoothing: Smoothing) -> sp.csr_matrix:
    """Return the smoothing matrix over the parameters, (n_params, n_params).

    The penalty of Fernandez et al. 2004 (eq. 6): weighted integrals of squared first and
    second derivatives over the unit cells.

    Raises
    ------
    InputError
        There are not as many weights as derivatives (or elements), or one is below 0.
    """
    xi, weights = gauss(mesh.dim, smoothing.points)
    first, second = _derivative_orders(mesh.dim)
    factors = np.concatenate(
        [
            _weights("first", smoothing.first, len(first)),
            _weights("second", smoothing.second, len(second)),
        ]
    )
    # The unit cell is the same for all elements, and so is the penalty over local parameters.
    size = 4**mesh.dim
    cell = np.zeros((size, size))
    for orders, factor in zip([*first, *second], factors, strict=True):
        values = basis(mesh.dim, xi, orders)
        cell += values.T @ (factor * weights[:, None] * values)
    stiffness = _weights("stiffness", smoothing.stiffness, mesh.n_elements)
    every = np.arange(mesh.n_elements)
    blocks = sp.bsr_matrix(
        (stiffness[:, None, None] * cell, every, np.append(every, len(every))),
        shape=(size * len(every),) * 2,
    )
    return sp.csr_matrix(mesh.extraction.T @ (blocks.tocsr() @ mesh.extraction))


def _weights(name: str, given: float | Sequence[float] | Array, n: int) -> Array:
    weights = np.asarray(given, dtype=float)
    if weights.shape not in ((), (n,)) or not (weights >= 0.0).all():
        raise InputError(f"smoothing: {name} is not one weight or {n}, from 0 up; mend it")
    return np.broadcast_to(weights, n)


def part_normals(part: HermiteMesh, elements: NDArray[np.int64], xi: Array) -> Array:
    """Return unit normals of a surface part, (n, 3)."""
    tangents = part.jacobian(elements, xi)
    normal = np.cross(tangents[:, :, 0], tangents[:, :, 1])
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12))


@dataclass(frozen=True)
class _Residual:
    """What a target asks of the parameters: ``operator @ parameters`` should be ``points``.

    The weight counts in full along the normals, by a share of it across them.
    """

    operator: sp.csr_matrix
    points: Array
    weight: Array
    normals: Array | None
    share: float

    def distances(self, parameters: Array) -> Array:
        gap = self.points - self.operator @ parameters
        if self.normals is not None:
            tangential = gap - np.sum(gap * self.normals, axis=1, keepdims=True) * self.normals
            gap = gap - (1.0 - np.sqrt(self.share)) * tangential
        return np.asarray(np.linalg.norm(gap, axis=1))


def _residual(target: Target, mesh: HermiteMesh) -> _Residual:
    """Project a target onto the current mesh."""
    if isinstance(target, PointTarget):
        operator = mesh.functions(target.elements, target.xi)
        # On a face most functions vanish: the products below need not carry them.
        operator.eliminate_zeros()
        weight = np.broadcast_to(target.weight, len(target.points))
        return _Residual(
            operator,
            target.points,
            np.asarray(weight, dtype=float),
            target.normals,
            1.0 if target.normals is None else target.sliding,
        )
    if isinstance(target, PairTarget):
        operator = mesh.functions(*target.first) - mesh.functions(*target.second)
        operator.eliminate_zeros()
        weight = np.full(len(target.apart), target.weight)
        return _Residual(operator, target.apart, weight, None, 1.0)
    part = target.part(mesh)
    normals: Array | None = None
    if isinstance(target, CloudTarget):
        place = part.locate(target.points)
        near = place.distance <= target.reject
        elements, xi, points = place.elements[near], place.xi[near], target.points[near]
        weight = np.broadcast_to(target.weight, len(target.points))[near]
        if part.dim == 2 and target.sliding < 1.0:
            normals = part_normals(part, elements, xi)
    else:
        elements, xi, cell = part.gauss_points(target.samples)
        found = target.surface.closest(part.evaluate(elements, xi))
        points, normals = found.points, target.surface.normals[found.faces]
        near = found.distance <= target.reject
        elements, xi, points, normals = elements[near], xi[near], points[near], normals[near]
        weight = target.weight * cell[near] * target.samples**part.dim
    if part.n_params != mesh.n_params:
        raise InputError(f"{target.name}: its part has other parameters; pick faces of the mesh")
    operator = part.functions(elements, xi)
    share = 1.0 if normals is None else target.sliding
    return _Residual(operator, points, np.asarray(weight, dtype=float), normals, share)


def fit(
    mesh: HermiteMesh,
    targets: Sequence[Target],
    smoothing: Smoothing | Sequence[Smoothing] = (),
    fixed: NDArray[np.bool_] | None = None,
    constraints: tuple[sp.csr_matrix, Array] | None = None,
    iterations: int = 5,
    damping: float = 1e-8,
) -> FitResult:
    """Fit a mesh to targets; projections are renewed in every iteration.

    Parameters
    ----------
    mesh : HermiteMesh
        Initial mesh.
    targets : sequence of CloudTarget, SurfaceTarget, PointTarget or PairTarget
    smoothing : Smoothing or sequence of Smoothing, optional
        Penalties that add up; by default one of the second derivatives.
    fixed : (n_params, 3) bool array, optional
        Unknowns that keep their initial value.
    constraints : (matrix (k, 3 * n_params), values (k,)), optional
        Linear equations that the parameters (flattened, component fastest) satisfy.
    iterations : int
    damping : float
        Weight that keeps parameters seen by no datum at their present value.

    Returns
    -------
    FitResult

    Raises
    ------
    InputError
        The mask or the constraints do not fit the mesh, or there is no target at all.
    SolveError
        The equations have no unique solution.
    """
    if not targets:
        raise InputError("targets: there is nothing to fit to; give at least one")
    held = np.zeros((mesh.n_params, 3), dtype=bool) if fixed is None else np.asarray(fixed)
    if held.shape != (mesh.n_params, 3) or held.dtype != bool:
        raise InputError(
            f"fixed: {held.dtype} of shape {held.shape}; give a mask of ({mesh.n_params}, 3) bool"
        )
    if constraints is not None and (
        constraints[0].shape != (len(constraints[1]), 3 * mesh.n_params)
    ):
        raise InputError(
            f"constraints: shape {constraints[0].shape} for {len(constraints[1])} values; give a "
            f"row each of {3 * mesh.n_params} columns"
        )
    penalties = [smoothing] if isinstance(smoothing, Smoothing) else smoothing or [Smoothing()]
    rest = [replace(one, relative=mesh) if one.relative is True else one for one in penalties]
    for _ in range(iterations):
        equations = Equations.of(mesh, targets, damping)
        for one in rest:
            equations = equations.smoothed(one)
        mesh = equations.solved(held, constraints)
    return FitResult(mesh, targets)


@dataclass(frozen=True, eq=False)
class Equations:
    """Normal equations of a fit, linear in the change of a mesh's parameters.

    Attributes
    ----------
    mesh : HermiteMesh
        From whose parameters the change counts.
    alike : (n_params, n_params) CSR matrix
        What acts on each of the three components alike.
    coupled : (3 * n_params, 3 * n_params) CSR matrix
        What couples them, component fastest.
    right : (n_params, 3) array
    solver : Definite
        Kept from one set of penalties to the next.
    """

    mesh: HermiteMesh
    alike: sp.csr_matrix
    coupled: sp.csr_matrix
    right: Array
    solver: Definite = field(default_factory=Definite)

    @classmethod
    def of(cls, mesh: HermiteMesh, targets: Sequence[Target], damping: float = 1e-8) -> Equations:
        """Project targets onto a mesh and add up what they ask of it."""
        n = mesh.n_params
        alike, coupled = damping * sp.identity(n, format="csr"), sp.csr_matrix((3 * n, 3 * n))
        right = np.zeros((n, 3))
        for target in targets:
            residual = _residual(target, mesh)
            gap = residual.points - residual.operator @ mesh.parameters
            weighted = residual.operator.T @ sp.diags(residual.share * residual.weight)
            alike = alike + weighted @ residual.operator
            right += weighted @ gap
            if residual.normals is not None:
                along = _along(residual.operator, residual.normals)
                weighted = along.T @ sp.diags((1.0 - residual.share) * residual.weight)
                coupled = coupled + weighted @ along
                right += (weighted @ np.sum(gap * residual.normals, axis=1)).reshape(-1, 3)
        return cls(mesh, alike, coupled, right)

    def smoothed(self, smoothing: Smoothing) -> Equations:
        """Return the equations with a penalty added."""
        penalty = sobolev(self.mesh, smoothing)
        pull = penalty @ (_reference(self.mesh, smoothing) - self.mesh.parameters)
        return replace(self, alike=self.alike + penalty, right=self.right + pull)

    def solved(
        self,
        fixed: NDArray[np.bool_] | None = None,
        constraints: tuple[sp.csr_matrix, Array] | None = None,
    ) -> HermiteMesh:
        """Return the mesh with the parameters that solve them; see `fit`."""
        current = self.mesh.parameters
        free = np.arange(current.size) if fixed is None else np.flatnonzero(~fixed.ravel())
        matrix = sp.kron(self.alike, sp.identity(3), format="csr") + self.coupled
        matrix, right = matrix[free][:, free], self.right.ravel()[free]
        step = np.zeros(current.size)
        try:
            if constraints is None:
                step[free] = self.solver.solve(matrix, right)
            else:
                rows, values = constraints
                right = np.concatenate([right, values - rows @ current.ravel()])
                rows = rows[:, free]
                whole = splu(sp.bmat([[matrix, rows.T], [rows, None]], format="csc"))
                step[free] = whole.solve(right)[: len(free)]
        except RuntimeError as error:
            raise SolveError(
                f"fit: {error}; add smoothing or damping, and constrain nothing that is fixed"
            ) from None
        return self.mesh.with_parameters(current + step.reshape(-1, 3))


def _along(operator: sp.csr_matrix, normals: Array) -> sp.csr_matrix:
    """Return the operator (n, 3 * n_params) that gives the component along normals (n, 3)."""
    rows, columns = operator.shape
    values = operator.data[:, None] * np.repeat(normals, np.diff(operator.indptr), axis=0)
    places = 3 * operator.indices[:, None] + np.arange(3)
    return sp.csr_matrix((values.ravel(), places.ravel(), 3 * operator.indptr), (rows, 3 * columns))


def _reference(mesh: HermiteMesh, smoothing: Smoothing) -> Array:
    """Return the parameters from which a smoothing counts."""
    if isinstance(smoothing.relative, HermiteMesh):
        return smoothing.relative.parameters
    return mesh.parameters if smoothing.relative else np.zeros_like(mesh.parameters)


def _report(distances: Array) -> GroupReport:
    if not len(distances):
        return GroupReport(np.nan, np.nan, np.nan, 0)
    return GroupReport(
        float(np.sqrt(np.mean(distances**2))),
        float(np.percentile(distances, 95)),
        float(distances.max()),
        len(distances),
    )
