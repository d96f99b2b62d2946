"""Terms of the energy that live at points: fibres and springs.

Every such term is an energy of one vector a point, ``v = Σ_a s_a x_a``, linear in the
parameters ``x``: a position, a fibre vector ``F f0`` or the difference of two positions; or of
several vectors, such as a position and the tangents of its surface.
A term says what its functionals ``s`` are and returns energy, force ``∂e/∂v`` and
stiffness ``∂²e/∂v²``; the element arrays follow from these alone.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Self

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..hermite import HermiteMesh, gauss
from ..hermite.check import numbers, whole
from . import kernels
from .assembly import Pattern
from .laws import PAIRS, Array, FibreLaw

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Load:
    """What drives a problem.

    Attributes
    ----------
    activations : mapping of str to float
        0..1 by muscle; muscles that are not named rest.
    prescribed : (n_params, 3) array, optional
        Displacement of the fixed parameters in mm; zero by default.
    jaw : float
        Angle in radians by which the jaw is open.
    forces : mapping of str to float
        Factor of each term that is `PointTerm.driven` by its name, such as `DeadForces`; 0 for
        those not named.
    offsets : mapping of str to (n,) array
        Depth in mm by which the points of a contact are pressed beyond the penalty's: the
        multipliers of the augmented penalty, which `Continuation` finds.
    """

    activations: Mapping[str, float] = field(default_factory=dict)
    prescribed: Array | None = None
    jaw: float = 0.0
    forces: Mapping[str, float] = field(default_factory=dict)
    offsets: Mapping[str, Array] = field(default_factory=dict)

    def drives_like(self, other: Load) -> bool:
        """Tell whether another load differs from this one by its offsets at most."""
        return (
            dict(self.activations) == dict(other.activations)
            and self.jaw == other.jaw
            and dict(self.forces) == dict(other.forces)
            and np.array_equal(
                0.0 if self.prescribed is None else self.prescribed,
                0.0 if other.prescribed is None else other.prescribed,
            )
        )

    def towards(self, target: Load, fraction: float) -> Load:
        """Return the load a fraction of the way to ``target``."""
        prescribed: Array | None = None
        if self.prescribed is not None or target.prescribed is not None:
            start = 0.0 if self.prescribed is None else self.prescribed
            end = 0.0 if target.prescribed is None else target.prescribed
            prescribed = np.asarray((1.0 - fraction) * start + fraction * end)
        return Load(
            _between(self.activations, target.activations, fraction),
            prescribed,
            (1.0 - fraction) * self.jaw + fraction * target.jaw,
            _between(self.forces, target.forces, fraction),
            {
                name: np.asarray(
                    (1.0 - fraction) * self.offsets.get(name, 0.0)
                    + fraction * target.offsets.get(name, 0.0)
                )
                for name in sorted({*self.offsets, *target.offsets})
                if fraction < 1.0 or name in target.offsets
            },
        )


def _between(
    start: Mapping[str, float], end: Mapping[str, float], fraction: float
) -> dict[str, float]:
    return {
        name: (1.0 - fraction) * start.get(name, 0.0) + fraction * end.get(name, 0.0)
        for name in sorted({*start, *end})
    }


@dataclass(frozen=True)
class Response:
    """What a term answers at its points.

    Attributes
    ----------
    energies : (n,) array
        In mN mm.
    forces : (n, 3) or (n, width, 3) array
        Derivative by the vectors.
    stiffness : callable
        Returns the second derivatives, (n, 6) or (n, 6, width, width), component pairs 00, 01, 02,
        11, 12, 22: most trials have no use for them.
    """

    energies: Array
    forces: Array
    stiffness: Callable[[], Array]


class PointTerm(ABC):
    """A term of the energy at points.

    Parameters
    ----------
    name : str
        For messages and reports.
    functions : CSR matrix (n width, n_params)
        The functionals of each point, one point after the other.
    hosts : (n,) int array
        Element of each point, ascending.
    """

    #: Number of vectors a point.
    width: int = 1
    #: Whether the functionals depend on the configuration, see `follow`.
    follows: bool = False
    #: Whether `Load.forces` has a factor of it.
    driven: bool = False
    name: str
    functions: sp.csr_matrix
    hosts: IntArray

    def __init__(self, name: str, functions: sp.csr_matrix, hosts: ArrayLike) -> None:
        self.name = name
        self.functions = functions
        self.hosts = np.asarray(hosts, dtype=np.int64)

    def pattern(self) -> Pattern | None:
        """Return the term's own pattern, or None when its hosts are the mesh's elements."""
        return None

    def follow(self, parameters: Array, load: Load) -> tuple[Array, IntArray] | None:
        """Return the functionals of a configuration, or None when they are fixed.

        Of points on which nothing acts there are none.

        Returns
        -------
        functions : (n width, m) array
            On the functions of the term's pattern, sorted by host.
        starts : (hosts + 1,) int array
            Rows of each host.
        """
        return None

    @abstractmethod
    def respond(self, vectors: Array, load: Load, convex: bool = False) -> Response:
        """Evaluate energy, force and stiffness for the points' vectors (n, 3).

        The vectors are (n, width, 3) where a point has several.

        With ``convex`` the stiffness has no negative part: far from equilibrium that part
        leads Newton's method astray.
        """

    def depth(self, parameters: Array, load: Load) -> Array | None:
        """Return how much deeper than at rest each point is inside what it touches, in mm, (n,).

        Negative before it; None where it has no meaning.
        """
        return None

    def penetration(self, parameters: Array, load: Load | None = None) -> float:
        """Return the greatest depth of interpenetration in mm (0 where it has no meaning)."""
        depth = self.depth(parameters, Load() if load is None else load)
        return 0.0 if depth is None else float(depth.max(initial=0.0))


def by_host(hosts: ArrayLike) -> IntArray:
    """Return the order that sorts points by their host."""
    return np.argsort(np.asarray(hosts), kind="stable")


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


@dataclass(frozen=True)
class FibreQuadrature:
    """Points at which muscle stress is integrated.

    Attributes
    ----------
    elements : (n,) int array
        Host element of the tissue mesh.
    xi : (n, 3) array
    weights : (n,) array
        Reference volume in mm³.
    directions : (n, 3) array
        Unit fibre direction in the reference configuration.
    muscles : (n,) int array
        Index of the muscle.
    """

    elements: IntArray
    xi: Array
    weights: Array
    directions: Array
    muscles: IntArray

    @classmethod
    def concatenate(cls, parts: Sequence[Self]) -> Self:
        """Join quadratures whose muscle indices already agree."""
        return cls(
            *(np.concatenate([getattr(part, item.name) for part in parts]) for item in fields(cls))
        )

    def take(self, points: NDArray[np.int64] | NDArray[np.bool_]) -> Self:
        """Return some of the points, in the given order."""
        return type(self)(*(getattr(self, item.name)[points] for item in fields(self)))

    def carried(self, before: HermiteMesh, after: HermiteMesh) -> Self:
        """Return the points as they are when the tissue at rest has another shape.

        Volumes become J times and directions F times what they were, of unit length.
        """
        old = before.jacobian(self.elements, self.xi)
        gradient = after.jacobian(self.elements, self.xi) @ np.linalg.inv(old)
        directions = (gradient @ self.directions[:, :, None])[:, :, 0]
        stretch = np.linalg.norm(directions, axis=1)
        return replace(
            self,
            weights=self.weights * np.linalg.det(gradient),
            directions=directions / stretch[:, None],
            **self._stretched(stretch),
        )

    def _stretched(self, stretch: Array) -> dict[str, Any]:
        """Return what else changes where fibres are longer at rest by factors (n,)."""
        return {}


@dataclass(frozen=True)
class GlidingQuadrature(FibreQuadrature):
    """Points of muscles that glide in the tissue from their bone to where they are bound to it.

    Attributes
    ----------
    fibres : (n,) int array
        Number of the fibre on which the point lies; every fibre belongs to one muscle.
    pulls : (n,) array
        By how much its fibre stretches where the tissue at this point moves along it (1/mm); 0
        where it glides.
    """

    fibres: IntArray
    pulls: Array

    def _stretched(self, stretch: Array) -> dict[str, Any]:
        number = np.unique(self.fibres, return_inverse=True)[1]
        longer = np.bincount(number, self.weights * stretch) / np.bincount(number, self.weights)
        return {"pulls": self.pulls / longer[number]}


def fibre_functions(
    mesh: HermiteMesh, elements: ArrayLike, xi: ArrayLike, directions: ArrayLike
) -> sp.csr_matrix:
    """Return the operator (n, n_params) whose value is the fibre vector ``F f0``.

    ``s_a = ∇_X N_a · f0``, with the reference gradient of the global functions.
    """
    jacobian = mesh.jacobian(elements, xi)
    slopes = np.linalg.solve(jacobian, np.asarray(directions, dtype=float)[:, :, None])[:, :, 0]
    total: sp.csr_matrix | None = None
    for k in range(3):
        unit = [int(k == axis) for axis in range(3)]
        part = sp.diags_array(slopes[:, k]) @ mesh.functions(elements, xi, unit)
        total = part if total is None else total + part
    return sp.csr_matrix(total)


class Fibres(PointTerm):
    """Active and passive stress of muscles that move with the tissue around them.

    The fibre vector of a point is ``F f0``.

    Parameters
    ----------
    mesh : HermiteMesh
        Tissue at rest.
    quadrature : FibreQuadrature
    names : sequence of str
        Muscle of each index.
    law : FibreLaw
    slacks : mapping of str to float
        Stretch from which a muscle's passive fibres are taut; 1 for those not named.

    Raises
    ------
    InputError
        If a point names no muscle, or has no direction.
    """

    def __init__(
        self,
        mesh: HermiteMesh,
        quadrature: FibreQuadrature,
        names: Sequence[str],
        law: FibreLaw | None = None,
        slacks: Mapping[str, float] | None = None,
    ) -> None:
        quadrature = quadrature.take(by_host(quadrature.elements))
        functions = fibre_functions(mesh, quadrature.elements, quadrature.xi, quadrature.directions)
        super().__init__("fibres", functions, quadrature.elements)
        self._keep(quadrature, names, law, slacks)

    def _keep(
        self,
        quadrature: FibreQuadrature,
        names: Sequence[str],
        law: FibreLaw | None,
        slacks: Mapping[str, float] | None,
    ) -> None:
        # The kernels trust these: an index beyond the names would be read from beyond its array.
        whole("fibre muscles", quadrature.muscles, len(tuple(names)))
        directions = numbers("fibre directions", quadrature.directions, None, 3)
        if not (np.linalg.norm(directions, axis=1) > 0.0).all():
            raise InputError("fibre directions: one has no length; leave its point out")
        self.quadrature = quadrature
        self.names = tuple(names)
        self.law = FibreLaw() if law is None else law
        self.slacks = np.array([(slacks or {}).get(name, 1.0) for name in self.names])

    def respond(self, vectors: Array, load: Load, convex: bool = False) -> Response:
        """Evaluate the fibre potential ``ψ(|v|)``."""
        n = len(vectors)
        energies, forces, stiffness = np.empty(n), np.empty((n, 3)), np.empty((n, 6))
        kernels.fibres(
            vectors,
            self.quadrature.weights,
            self.quadrature.muscles,
            np.array([load.activations.get(name, 0.0) for name in self.names]),
            self.slacks,
            self.law.array(),
            convex,
            energies,
            forces,
            stiffness,
        )
        return Response(energies, forces, lambda: stiffness)


class GlidingFibres(Fibres):
    """Active and passive stress of muscles that glide from their bone to where they are bound.

    Along a fibre the muscle shortens evenly, as it does where nothing holds it on the way. Its
    point at ``X`` has the fibre vector ``f0 + Σ_j p_j u_j``, with the displacements ``u_j`` of the
    tissue at the points of the fibre and their pulls ``p_j``; where bone moves, ``u`` is relative
    to it and ``f0`` turns with it. What the tissue feels is the fibre's tension at the points
    that are bound.

    Parameters
    ----------
    mesh : HermiteMesh
        Tissue at rest.
    quadrature : GlidingQuadrature
    names, law, slacks
        See `Fibres`.
    carry : callable, optional
        Takes points at rest (n, 3) of the bones of some muscles (n,) and returns what takes a
        load to where they are; bones stay where they are by default.

    Raises
    ------
    InputError
        See `Fibres`; or fibres are of several muscles, or bound nowhere.
    """

    quadrature: GlidingQuadrature

    def __init__(
        self,
        mesh: HermiteMesh,
        quadrature: GlidingQuadrature,
        names: Sequence[str],
        law: FibreLaw | None = None,
        slacks: Mapping[str, float] | None = None,
        carry: Callable[[Array, IntArray], Callable[[Load], Array]] | None = None,
    ) -> None:
        # Points of a fibre follow each other.
        quadrature = quadrature.take(by_host(quadrature.fibres))
        self._keep(quadrature, names, law, slacks)
        _, self._starts, self._fibre = np.unique(
            quadrature.fibres, return_index=True, return_inverse=True
        )
        if (quadrature.muscles != quadrature.muscles[self._starts][self._fibre]).any():
            raise InputError("gliding fibres: a fibre is of several muscles; number them apart")
        count = len(self._starts)
        sums = sp.csr_matrix(
            (quadrature.pulls, (self._fibre, np.arange(len(self._fibre)))),
            shape=(count, len(self._fibre)),
        )
        if not (abs(sums).sum(axis=1) > 0.0).all():
            raise InputError("gliding fibres: one is bound nowhere; leave it out")
        functions = sp.csr_matrix(sums @ mesh.functions(quadrature.elements, quadrature.xi))
        hosts = self._hosts()
        PointTerm.__init__(self, "gliding fibres", functions, hosts)
        self._pattern = Pattern.from_functions(functions, hosts, int(hosts.max(initial=-1)) + 1)
        self._sums = sums
        start = mesh.evaluate(quadrature.elements, quadrature.xi)
        hold = (lambda at, _: lambda _load: at) if carry is None else carry
        ends = start, start + quadrature.directions
        self._bones = [hold(at, quadrature.muscles) for at in ends]

    def _hosts(self) -> IntArray:
        """Put fibres together of which one is bound to all the elements of the others.

        Together they couple no more unknowns than that one does, and there are fewer blocks.
        """
        bound = self.quadrature.pulls != 0.0
        pairs = np.unique(
            np.stack([self._fibre[bound], self.quadrature.elements[bound]], axis=1), axis=0
        )
        of_fibre = np.split(pairs[:, 1], np.flatnonzero(np.diff(pairs[:, 0])) + 1)
        sets = [frozenset(elements.tolist()) for elements in of_fibre]
        greatest: list[frozenset[int]] = []
        hosts = np.empty(len(sets), dtype=np.int64)
        for fibre in sorted(range(len(sets)), key=lambda number: -len(sets[number])):
            found = [host for host, whole in enumerate(greatest) if sets[fibre] <= whole]
            if not found:
                found = [len(greatest)]
                greatest.append(sets[fibre])
            hosts[fibre] = found[0]
        return hosts

    def pattern(self) -> Pattern:
        """Return the pattern of the fibres that are bound together."""
        return self._pattern

    def vectors(self, parameters: Array, load: Load) -> Array:
        """Return the fibre vectors of all points, (n, 3)."""
        return self._spread(np.asarray(self.functions @ parameters), load)

    def _spread(self, vectors: Array, load: Load) -> Array:
        start, end = (bone(load) for bone in self._bones)
        return np.asarray((vectors - self._sums @ start)[self._fibre] + end - start)

    def respond(self, vectors: Array, load: Load, convex: bool = False) -> Response:
        """Evaluate the fibre potential at the points of every fibre, and sum it up."""
        found = super().respond(self._spread(vectors, load), load, convex)
        return Response(
            np.add.reduceat(found.energies, self._starts),
            np.add.reduceat(found.forces, self._starts),
            lambda: np.add.reduceat(found.stiffness(), self._starts),
        )


class Springs(PointTerm):
    """Tissue points tied to their place at rest, or to other tissue: origins, insertions.

    Parameters
    ----------
    mesh : HermiteMesh
        Tissue at rest.
    elements, xi : (n,), (n, 3) arrays
    stiffness : (n,) array or float
        Of each point, in mN/mm.
    name : str
    carry : callable, optional
        Takes the anchors at rest (n, 3) and returns what takes a load to the anchors' places.
    to : (elements (n,), xi (n, 3)), optional
        Tissue to which the points are tied; then they keep their vector to it instead of their
        place.
    """

    def __init__(
        self,
        mesh: HermiteMesh,
        elements: ArrayLike,
        xi: ArrayLike,
        stiffness: ArrayLike,
        name: str = "springs",
        carry: Callable[[Array], Callable[[Load], Array]] | None = None,
        to: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> None:
        order = by_host(elements)
        elements = np.asarray(elements)[order]
        functions = mesh.functions(elements, np.asarray(xi, dtype=float)[order])
        self._apart = False
        if to is not None:
            there, at = np.asarray(to[0])[order], np.asarray(to[1], dtype=float)[order]
            functions = functions - mesh.functions(there, at)
            self._apart = bool((there != elements).any())
        super().__init__(name, sp.csr_matrix(functions), elements)
        stiffness = np.asarray(stiffness, dtype=float)
        if stiffness.ndim:
            numbers(f"{name}: stiffness", stiffness, len(order))
        self.stiffness = np.broadcast_to(stiffness, order.shape)[order]
        if not (self.stiffness >= 0.0).all():
            raise InputError(f"{name}: a stiffness is negative or NaN; give values from 0 up")
        self.rest = np.asarray(self.functions @ mesh.parameters)
        self.anchors = None if carry is None else carry(self.rest)
        self._n_elements = mesh.n_elements

    def pattern(self) -> Pattern | None:
        """Return a pattern of their own for springs from one element to another."""
        if not self._apart:
            return None
        return Pattern.from_functions(self.functions, self.hosts, self._n_elements)

    def respond(self, vectors: Array, load: Load, convex: bool = False) -> Response:
        """Evaluate ``k/2 |x - X|²``, with X where the load has taken the anchor."""
        moved = vectors - (self.rest if self.anchors is None else self.anchors(load))
        k = self.stiffness
        zero = np.zeros_like(k)
        return Response(
            0.5 * k * (moved**2).sum(axis=1),
            k[:, None] * moved,
            lambda: np.stack([k, zero, zero, k, zero, k], axis=1),
        )


class Sheet(PointTerm):
    """A thin sheet of connective tissue, that resists being stretched and folds without a force.

    Its fibres lie in `WAYS` directions of its plane. Those that are longer than at rest pull, by
    the stretch ``λ``, with the energy ``k A penalty(λ - 1) / WAYS``; those that are shorter are
    crimped. Their tension sets in over `TOE`.

    Parameters
    ----------
    mesh : HermiteMesh
        Tissue at rest. The sheet lies where ``xi3`` is constant.
    elements, xi : (n,), (n, 3) arrays
    stiffness : (n,) array
        ``k A`` of each point (mN mm): of the sheet (mN/mm) times the area.
    name : str
        For messages and reports.
    """

    #: Directions of fibres. With three and more a sheet that is taut is alike in all directions.
    WAYS = 4
    #: Strain over which tension sets in.
    TOE = 0.02

    def __init__(
        self,
        mesh: HermiteMesh,
        elements: ArrayLike,
        xi: ArrayLike,
        stiffness: ArrayLike,
        name: str = "sheet",
    ) -> None:
        order = np.repeat(by_host(elements), self.WAYS)
        elements, xi = np.asarray(elements)[order], np.asarray(xi, dtype=float)[order]
        first, second = np.moveaxis(mesh.jacobian(elements, xi), 2, 0)[:2]
        first /= np.linalg.norm(first, axis=1)[:, None]
        second -= (first * second).sum(axis=1)[:, None] * first
        second /= np.linalg.norm(second, axis=1)[:, None]
        angle = np.pi / self.WAYS * (np.arange(len(order)) % self.WAYS)[:, None]
        directions = np.cos(angle) * first + np.sin(angle) * second
        super().__init__(name, fibre_functions(mesh, elements, xi, directions), elements)
        self.stiffness = numbers(f"{name}: stiffness", stiffness, None)[order] / self.WAYS

    def respond(self, vectors: Array, load: Load, convex: bool = False) -> Response:
        """Evaluate the energy of the stretch ``|F f0|``."""
        stretch = np.linalg.norm(vectors, axis=1)
        along = vectors / stretch[:, None]
        energy, slope, bend = (self.stiffness * part for part in penalty(stretch - 1.0, self.TOE))
        across = slope / stretch

        def stiffness() -> Array:
            out = (bend - across)[:, None] * np.stack(
                [along[:, i] * along[:, j] for i, j in PAIRS], axis=1
            )
            out[:, [i == j for i, j in PAIRS]] += across[:, None]
            return np.asarray(out)

        return Response(energy, slope[:, None] * along, stiffness)


class DeadForces(PointTerm):
    """Forces that keep their size and direction: weight, tractions on the surface at rest.

    Parameters
    ----------
    mesh : HermiteMesh
        Tissue at rest.
    elements, xi : (n,), (n, 3) arrays
    forces : (n, 3) array
        Of each point in mN, for a factor of 1 in `Load.forces`.
    name : str
    """

    driven = True

    def __init__(
        self,
        mesh: HermiteMesh,
        elements: ArrayLike,
        xi: ArrayLike,
        forces: ArrayLike,
        name: str = "weight",
    ) -> None:
        order = by_host(elements)
        elements = np.asarray(elements)[order]
        super().__init__(name, mesh.functions(elements, np.asarray(xi)[order]), elements)
        self.forces = numbers(name, forces, len(order), 3)[order]
        self.rest = np.asarray(self.functions @ mesh.parameters)

    @classmethod
    def body(cls, mesh: HermiteMesh, density: ArrayLike, name: str = "weight") -> DeadForces:
        """Return a force per volume at rest in mN/mm³, (3,), in the whole tissue."""
        rule = mesh.quadrature()
        forces = rule.weights[:, None] * np.asarray(density, dtype=float)
        return cls(mesh, rule.elements, rule.xi, forces, name)

    def respond(self, vectors: Array, load: Load, convex: bool = False) -> Response:
        """Evaluate ``-f · (x - X)``."""
        forces = -load.forces.get(self.name, 0.0) * self.forces
        energies = (forces * (vectors - self.rest)).sum(axis=1)
        return Response(energies, forces, lambda: np.zeros((len(vectors), 6)))


class FollowerPressure(PointTerm):
    """A pressure that stays normal to a deforming surface.

    The residual is ``P ∫ N_a x,1 × x,2 dξ``. The stiffness is its symmetric part, which is all
    of it where the edge of the surface is fixed or the surface is closed; elsewhere Newton's
    method converges linearly. The energy is ``P/3 ∫ x · (x,1 × x,2) dξ``, pressure times the
    volume of the cone over the surface, of which the residual is the derivative in the same
    cases.

    Parameters
    ----------
    mesh : HermiteMesh
        Tissue at rest.
    elements : (n,) int array
    axis, side : int
        The pressure, ``Load.forces`` in kPa, pushes on the faces where ``xi_axis`` equals
        `side`.
    n : int
        Gauss points a direction.
    name : str
    """

    driven = True
    width = 3

    def __init__(
        self,
        mesh: HermiteMesh,
        elements: ArrayLike,
        axis: int,
        side: int,
        n: int = 5,
        name: str = "pressure",
    ) -> None:
        elements = np.sort(np.asarray(elements, dtype=np.int64))
        plane, weights = gauss(2, n)
        points = np.tile(np.insert(plane, axis, float(side), axis=1), (len(elements), 1))
        hosts = np.repeat(elements, len(weights))
        # The first tangent crossed with the second points outwards.
        first, second = (axis + 1) % 3, (axis + 2) % 3
        if side == 0:
            first, second = second, first
        units = np.eye(3, dtype=int)
        rows = [
            mesh.functions(hosts, points, orders)
            for orders in ((0, 0, 0), units[first], units[second])
        ]
        order = np.arange(3 * len(hosts)).reshape(3, -1).T.ravel()
        super().__init__(name, sp.csr_matrix(sp.vstack(rows, format="csr")[order]), hosts)
        self.weights = np.tile(weights, len(elements))

    def respond(self, vectors: Array, load: Load, convex: bool = False) -> Response:
        """Evaluate the force of the pressure and the symmetric part of its stiffness."""
        factors = load.forces.get(self.name, 0.0) * self.weights
        place, first, second = vectors[:, 0], vectors[:, 1], vectors[:, 2]
        area = factors[:, None] * np.cross(first, second)
        forces = np.zeros_like(vectors)
        forces[:, 0] = area

        def stiffness() -> Array:
            out = np.zeros((len(vectors), 6, 3, 3))
            for pair, k, sign in ((1, 2, 0.5), (2, 1, -0.5), (4, 0, 0.5)):
                for column, tangent in ((1, second), (2, -first)):
                    value = sign * factors * tangent[:, k]
                    out[:, pair, 0, column] = value
                    out[:, pair, column, 0] = -value
            return out

        return Response((area * place).sum(axis=1) / 3.0, forces, stiffness)


class Tension(PointTerm):
    """A constant second Piola stress ``T`` along fibres: ``ψ = T/2 |F f0|²``.

    Parameters
    ----------
    mesh : HermiteMesh
        Tissue at rest.
    elements, xi : (n,), (n, 3) arrays
    weights : (n,) array
        Reference volume of each point in mm³.
    directions : (n, 3) array
        Unit fibre directions at rest.
    name : str
        Of the tension in kPa in `Load.forces`.
    """

    driven = True

    def __init__(
        self,
        mesh: HermiteMesh,
        elements: ArrayLike,
        xi: ArrayLike,
        weights: ArrayLike,
        directions: ArrayLike,
        name: str = "tension",
    ) -> None:
        order = by_host(elements)
        elements = np.asarray(elements)[order]
        directions = np.asarray(directions, dtype=float)[order]
        functions = fibre_functions(mesh, elements, np.asarray(xi)[order], directions)
        super().__init__(name, functions, elements)
        self.weights = np.asarray(weights, dtype=float)[order]

    def respond(self, vectors: Array, load: Load, convex: bool = False) -> Response:
        """Evaluate ``T/2 |v|²``."""
        k = load.forces.get(self.name, 0.0) * self.weights
        zero = np.zeros_like(k)
        return Response(
            0.5 * k * (vectors**2).sum(axis=1),
            k[:, None] * vectors,
            lambda: np.stack([k, zero, zero, k, zero, k], axis=1),
        )
