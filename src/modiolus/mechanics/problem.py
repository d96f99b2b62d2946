"""The mechanical problem: a tissue mesh, its terms and constraints, and its states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError, unknown_name
from ..hermite import HermiteMesh, basis, gauss
from ..hermite.check import numbers
from . import kernels
from .assembly import Assembly, Pattern
from .laws import WIDTHS, Array, FibreLaw, Formulation, Law, Volume
from .terms import Fibres, Load, PointTerm, by_host

IntArray = NDArray[np.int64]

#: Gauss points a direction; three move the tip of a beam by several per cent.
GAUSS = 4


def trilinear(xi: ArrayLike) -> Array:
    """Evaluate the eight trilinear functions at points xi (n, 3); (n, 8)."""
    xi = np.asarray(xi, dtype=float).reshape(-1, 3)
    out = np.ones((len(xi), 8))
    for corner in range(8):
        for k in range(3):
            out[:, corner] *= xi[:, k] if (corner >> k) & 1 else 1.0 - xi[:, k]
    return out


#: Overlap (mm), volume ratios at a point and last correction (mm) beyond which a state is doubtful.
OVERLAP = 0.3
VOLUMES = 0.5, 1.6
CORRECTION = 1e-3


@dataclass
class Statistics:
    """How a computation went.

    Attributes
    ----------
    converged : bool
    jumps : int
        How often the path ended or turned back and the tissue went over to an equilibrium
        elsewhere.
    steps, newton_iterations, factorisations : int
    solve_s : float
        Wall time of the solve in seconds.
    J_min, J_max : float
        Volume ratio over all Gauss points.
    volume_change : float
        Of the whole tissue, relative to rest.
    max_penetration_mm : float
    pressed : bool
        False where contacts overlap more than they have to, since a correction failed as they were
        pressed apart.
    wrong_pivots : int or None
        Negative pivots of the state's exact tangent beyond the number of pressures: directions in
        which it is not a stable equilibrium. None on the way to a load, and when the solver
        cannot tell.
    correction_mm : float
        Displacement of the last correction, root mean square.
    """

    converged: bool = True
    steps: int = 0
    newton_iterations: int = 0
    factorisations: int = 0
    solve_s: float = 0.0
    J_min: float = 1.0
    J_max: float = 1.0
    volume_change: float = 0.0
    max_penetration_mm: float = 0.0
    pressed: bool = True
    wrong_pivots: int | None = None
    jumps: int = 0
    correction_mm: float = 0.0

    def as_dict(self) -> dict[str, float | int | bool | None]:
        """Return the figures for a report."""
        return asdict(self)

    @property
    def doubts(self) -> tuple[str, ...]:
        """What a person should know before trusting a state, though it has converged."""
        found = []
        overlap = self.max_penetration_mm
        if overlap > OVERLAP or not self.pressed:
            rest = "" if self.pressed else ", and could not be pressed farther apart"
            found.append(f"parts that touch overlap by {overlap:.2g} mm{rest}")
        if self.J_min < VOLUMES[0]:
            found.append(f"tissue is pressed to {self.J_min:.0%} of its volume at a point")
        if self.J_max > VOLUMES[1]:
            found.append(f"tissue is drawn to {self.J_max:.0%} of its volume at a point")
        if self.correction_mm > CORRECTION:
            moved = f"{self.correction_mm:.3f} mm"
            found.append(f"the last correction still moved the tissue by {moved}")
        if self.wrong_pivots:
            found.append("the tissue would buckle from here: the state is not stable")
        if self.jumps:
            found.append("the path ended on the way, and the tissue went over to a state elsewhere")
        return tuple(found)


@dataclass(frozen=True)
class State:
    """A configuration of the tissue.

    Attributes
    ----------
    reference : HermiteMesh
        The tissue at rest.
    parameters : (n_params, 3) array
        Deformed parameters in mm.
    pressure : (n_vertices,) array
        Lagrange multiplier in kPa.
    vertices : (n_elements, 8) int array
        Pressure of each corner.
    load : Load
    statistics : Statistics
    """

    reference: HermiteMesh
    parameters: Array
    pressure: Array
    vertices: IntArray
    load: Load = field(default_factory=Load)
    statistics: Statistics = field(default_factory=Statistics)

    def short(self) -> State:
        """Return the state as one on the way to a load that was not reached."""
        return replace(self, statistics=replace(self.statistics, converged=False))

    @property
    def displacement(self) -> Array:
        """Displacement of the parameters, (n_params, 3)."""
        return self.parameters - self.reference.parameters

    @property
    def activations(self) -> dict[str, float]:
        """Activation of every muscle that is not at rest."""
        return {name: a for name, a in self.load.activations.items() if a != 0.0}

    @property
    def mesh(self) -> HermiteMesh:
        """The deformed mesh."""
        return self.reference.with_parameters(self.parameters)

    def deformation_gradient(self, elements: ArrayLike, xi: ArrayLike) -> Array:
        """Return ``F`` at points of the mesh, (n, 3, 3)."""
        rest = self.reference.jacobian(elements, xi)
        return np.asarray(self.mesh.jacobian(elements, xi) @ np.linalg.inv(rest))

    def volume_ratio(self, elements: ArrayLike, xi: ArrayLike) -> Array:
        """Return ``J`` at points of the mesh, (n,)."""
        return np.asarray(np.linalg.det(self.deformation_gradient(elements, xi)))

    def stretch(self, elements: ArrayLike, xi: ArrayLike, directions: ArrayLike) -> Array:
        """Return the stretch along unit reference directions (n, 3) at points, (n,)."""
        f = self.deformation_gradient(elements, xi)
        moved = np.einsum("nik,nk->ni", f, np.asarray(directions, dtype=float))
        return np.asarray(np.linalg.norm(moved, axis=1))

    def pressure_at(self, elements: ArrayLike, xi: ArrayLike) -> Array:
        """Return the Lagrange multiplier in kPa at points of the mesh, (n,)."""
        if not len(self.pressure):
            return np.zeros(len(np.asarray(elements)))
        corners = self.pressure[self.vertices[np.asarray(elements)]]
        return np.asarray((trilinear(xi) * corners).sum(axis=1))


@dataclass(frozen=True)
class Evaluation:
    """Result of one pass over all terms.

    Attributes
    ----------
    energies : dict of str to float
        By term, in mN mm.
    residual : (n,) array
        Of the free unknowns.
    volume_ratio : (n_elements, q) array
        ``J`` at the Gauss points.
    """

    energies: dict[str, float]
    residual: Array
    volume_ratio: Array

    @property
    def energy(self) -> float:
        """Sum over all terms."""
        return sum(self.energies.values())


@dataclass(frozen=True)
class _Batch:
    """Terms of one pattern whose points go through the kernels together.

    Attributes
    ----------
    group : int
        Number of the pattern.
    width : int
        Vectors a point.
    functions : (n width, m) array
        Of all points, sorted by host.
    starts : (hosts + 1,) int array
        Rows of each host.
    members : sequence of (term, its points)
    """

    group: int
    width: int
    functions: Array
    starts: IntArray
    members: Sequence[tuple[PointTerm, IntArray | slice]]

    @classmethod
    def of(cls, terms: Sequence[PointTerm], pattern: Pattern, group: int) -> _Batch:
        """Sort the points of some terms by their host."""
        width = terms[0].width
        hosts = np.concatenate([term.hosts for term in terms])
        order = by_host(hosts)
        place = np.empty(len(order), dtype=np.int64)
        place[order] = np.arange(len(order))
        ends = np.cumsum([len(term.hosts) for term in terms])
        members: list[tuple[PointTerm, IntArray | slice]] = [
            (term, place[end - len(term.hosts) : end])
            for term, end in zip(terms, ends, strict=True)
        ]
        if terms[0].follows:
            members = [(terms[0], slice(None))]
        rows = (order[:, None] * width + np.arange(width)).ravel()
        functions = sp.csr_matrix(sp.vstack([term.functions for term in terms]))[rows]
        hosts = np.repeat(hosts[order], width)
        counts = np.bincount(hosts, minlength=len(pattern.params))
        starts = np.concatenate([[0], np.cumsum(counts)])
        return cls(group, width, pattern.dense(functions, hosts), starts, members)

    def place(self, parameters: Array, load: Load) -> tuple[Array, IntArray]:
        """Return functions and starts, anew where they depend on the configuration."""
        return self.members[0][0].follow(parameters, load) or (self.functions, self.starts)


class Problem:
    """Quasi-static equilibrium of a muscle-driven tissue.

    Everything that depends on the resting shape alone is computed here, once.

    Parameters
    ----------
    mesh : HermiteMesh
        Tissue at rest, of dimension 3.
    coefficients : (3,) or (n_elements, q, 3) array
        ``(c10, c01, c20)`` in kPa, at each Gauss point of `gauss_points` or everywhere. Other
        laws have other numbers of coefficients; their classes in `laws` make the array.
    kappa : float
        Volumetric stiffness in kPa beside the pressure.
    formulation : Formulation, optional
        Law and treatment of the volume; by default those of the face.
    gauss_order : int
        Gauss points a direction.
    terms : sequence of PointTerm
    fixed : (n_params, 3) bool array, optional
        Parameters that do not move except as prescribed.
    places : mapping of str to (3,) array, optional
        Named places at rest in mm, for messages.

    Raises
    ------
    InputError
        If the mesh is inverted at a Gauss point, an array or a term does not fit it, or two
        contacts have one name.
    """

    def __init__(
        self,
        mesh: HermiteMesh,
        coefficients: ArrayLike,
        *,
        kappa: float = 50.0,
        formulation: Formulation | None = None,
        gauss_order: int = GAUSS,
        terms: Sequence[PointTerm] = (),
        fixed: NDArray[np.bool_] | None = None,
        places: Mapping[str, Array] | None = None,
    ) -> None:
        if mesh.dim != 3:
            raise InputError(f"mesh: it has dimension {mesh.dim}; give a volume mesh")
        self.mesh = mesh
        self.terms = tuple(terms)
        self.places = dict(places or {})
        self.kappa = float(kappa)
        self.formulation = Formulation() if formulation is None else formulation
        self.fixed = np.zeros((mesh.n_params, 3), dtype=bool) if fixed is None else fixed
        self._check()
        self.vertices, first = mesh.corner_nodes()
        n_vertices = len(first)
        if self.formulation.volume == Volume.LOGARITHM:
            self.vertices, n_vertices = self.vertices[:, :0], 0

        xi, weights = gauss(3, gauss_order)
        e, q = mesh.n_elements, len(weights)
        hosts = np.repeat(np.arange(e), 64)
        self.pattern = Pattern.from_functions(mesh.extraction, hosts, e, self.vertices)
        extraction = self.pattern.dense(mesh.extraction, hosts).reshape(e, 64, -1)
        slopes = np.stack([basis(3, xi, unit) for unit in ((1, 0, 0), (0, 1, 0), (0, 0, 1))])
        jacobian = np.einsum("kql,eli->eqik", slopes, mesh.local(), optimize=True)
        volume = np.linalg.det(jacobian)
        if not (volume > 0.0).all():
            worst = int(np.argmin(volume.min(axis=1)))
            raise InputError(
                f"mesh: element {worst} is inverted at {int((volume <= 0.0).sum())} Gauss points "
                "in all; mend the mesh"
            )
        inverse = np.linalg.inv(jacobian)
        m = extraction.shape[2]
        self._gradients = np.empty((e, 3 * q, m))
        for element in range(e):
            local = np.einsum("kql,qkK->qKl", slopes, inverse[element], optimize=True)
            self._gradients[element] = local.reshape(3 * q, 64) @ extraction[element]
        self._psi = np.ascontiguousarray(trilinear(xi)[:, : self.vertices.shape[1]])
        self.weights = weights * volume
        law = self.formulation.law
        self._law = None if law == Law.ISOCHORIC else int(law)
        given = np.asarray(coefficients, dtype=float)
        shape = (WIDTHS[law],) if given.ndim == 1 else (e, q, WIDTHS[law])
        self._coefficients = np.ascontiguousarray(
            np.broadcast_to(numbers("coefficients", given, *shape), (e, q, WIDTHS[law]))
        )

        patterns = [self.pattern]
        # Terms without a pattern of their own share the first one.
        self._groups: dict[PointTerm, int] = {}
        for term in self.terms:
            own = term.pattern()
            self._groups[term] = 0 if own is None else len(patterns)
            patterns += [] if own is None else [own]
        self._batches = self._batched(self.terms, patterns)
        self.assembly = Assembly(patterns, self.fixed, n_vertices)
        squares = np.einsum("eq,eqa->ea", self.weights, (basis(3, xi) @ extraction) ** 2)
        mass = np.bincount(self.pattern.params.ravel(), squares.ravel(), minlength=mesh.n_params)
        number = np.argwhere(self.assembly.equations >= 0)[:, 0]
        self._mass = mass[number] / self.weights.sum()

    def _batched(self, terms: Sequence[PointTerm], patterns: Sequence[Pattern]) -> list[_Batch]:
        """Put terms of one pattern and width into one batch."""
        shared: dict[tuple[int, int], list[PointTerm]] = {}
        for term in terms:
            # Only the first pattern is shared, so that these are alone.
            shared.setdefault((self._groups[term], term.width), []).append(term)
        return [_Batch.of(same, patterns[group], group) for (group, _), same in shared.items()]

    @staticmethod
    def gauss_points(mesh: HermiteMesh, gauss_order: int = GAUSS) -> tuple[IntArray, Array]:
        """Return the points at which coefficients are given: elements (e q,), xi (e q, 3)."""
        elements, xi, _ = mesh.gauss_points(gauss_order)
        return elements, xi

    @property
    def muscles(self) -> tuple[str, ...]:
        """Names of all muscles."""
        names: list[str] = []
        for term in self.terms:
            if isinstance(term, Fibres):
                names += term.names
        return tuple(dict.fromkeys(names))

    @property
    def n_unknowns(self) -> int:
        """Number of free displacement components and pressures."""
        return self.assembly.n

    def _check(self) -> None:
        """Refuse what would be computed wrongly without a word."""
        shape = (self.mesh.n_params, 3)
        if self.fixed.shape != shape or self.fixed.dtype != bool:
            raise InputError(
                f"fixed: {self.fixed.dtype} of shape {self.fixed.shape}; give bool of {shape}"
            )
        if not 0.0 <= self.kappa < np.inf:
            raise InputError(f"kappa: {self.kappa:g} is no stiffness; give a number from 0 up")
        keeping: set[str] = set()
        for term in self.terms:
            if term.functions.shape[1] != self.mesh.n_params:
                raise InputError(f"{term.name}: the term is of another mesh; make it of this one")
            # Contacts find their multipliers by their names.
            if type(term).depth is not PointTerm.depth:
                if term.name in keeping:
                    raise InputError(f"{term.name}: two contacts have this name; rename one")
                keeping.add(term.name)

    def load(self, activations: Mapping[str, float], prescribed: Array | None = None) -> Load:
        """Check activations and make a load of them.

        Raises
        ------
        InputError
            If a muscle is not known or an activation is not within 0..1.
        """
        load = Load(dict(activations), prescribed)
        self.check_load(load)
        return load

    def check_load(self, load: Load) -> None:
        """Refuse a load that drives what there is not, or beyond what it can be.

        Raises
        ------
        InputError
            If a muscle or a force is not known, an activation is not within 0..1, a factor is not
            finite, or the prescribed displacements do not fit the mesh.
        """
        for name, value in load.activations.items():
            if name not in self.muscles:
                raise unknown_name("muscle", name, self.muscles)
            if not 0.0 <= value <= 1.0:
                raise InputError(f"{name}: activation {value} is not within 0..1; mend it")
        driven = [term.name for term in self.terms if term.driven]
        for name, value in load.forces.items():
            if name not in driven:
                raise unknown_name("force", name, driven)
            if not np.isfinite(value):
                raise InputError(f"{name}: factor {value} of the force; give a finite number")
        if not np.isfinite(load.jaw):
            raise InputError(f"jaw: angle {load.jaw}; give a finite number")
        if load.prescribed is not None:
            numbers("prescribed", load.prescribed, self.mesh.n_params, 3)

    def rest(self) -> State:
        """Return the tissue at rest."""
        pressure = np.zeros(len(self.assembly.pressure_equations))
        return State(self.mesh, self.mesh.parameters.copy(), pressure, self.vertices)

    def prescribe(self, load: Load) -> Array:
        """Return the parameters (n_params, 3) at which a load holds the fixed ones."""
        if load.prescribed is None:
            return self.mesh.parameters.copy()
        return np.asarray(self.mesh.parameters + load.prescribed)

    def size(self, change: Array) -> float:
        """Return the size of a change of the unknowns: displacement, root mean square in mm.

        Each parameter counts with the mean square of its function over the tissue.
        """
        return float(np.sqrt(self.product(change, change)))

    def product(self, one: Array, other: Array) -> float:
        """Return the mean of the scalar product of two changes' displacements in mm²."""
        n = self.assembly.n_displacements
        return float((self._mass * one[:n]) @ other[:n])

    def work(self, residual: Array, change: Array) -> float:
        """Return the work of a residual (n,) on the displacements of a change (n,) in mN mm."""
        n = self.assembly.n_displacements
        return float(residual[:n] @ change[:n])

    def add(self, parameters: Array, pressure: Array, change: Array) -> tuple[Array, Array]:
        """Return parameters and pressures after a change of the unknowns (n,)."""
        parameters, pressure = parameters.copy(), pressure.copy()
        free = self.assembly.equations >= 0
        parameters[free] += change[self.assembly.equations[free]]
        active = self.assembly.pressure_equations >= 0
        pressure[active] += change[self.assembly.pressure_equations[active]]
        return parameters, pressure

    def evaluate(
        self,
        parameters: Array,
        pressure: Array,
        load: Load,
        *,
        tangent: bool = False,
        convex: bool = False,
    ) -> Evaluation:
        """Integrate every term.

        Parameters
        ----------
        parameters : (n_params, 3) array
            Of the deformed mesh (mm).
        pressure : (n_vertices,) array
            In kPa.
        load : Load
        tangent : bool
            Whether the element tangents are renewed too.
        convex : bool
            Whether the tangent leaves out what can make contacts and fibres unstable.
        """
        self.assembly.clear(tangents=tangent)
        energy, volume_ratio = self._tissue(parameters, pressure, tangent)
        energies = {"tissue": energy}
        for batch in self._batches:
            for name, energy in self._at_points(batch, parameters, load, tangent, convex):
                energies[name] = energies.get(name, 0.0) + energy
        return Evaluation(energies, self.assembly.residual(), volume_ratio)

    def _tissue(self, parameters: Array, pressure: Array, tangent: bool) -> tuple[float, Array]:
        """Fill the element arrays of the passive tissue; return its energy and ``J``."""
        base = self.assembly.groups[0]
        volume_ratio = np.empty(self.weights.shape)
        energy = kernels.bulk(
            parameters,
            pressure,
            base.pattern.params,
            base.pattern.vertices,
            self._gradients,
            self._psi,
            self.weights,
            self._law,
            self._coefficients,
            int(self.formulation.volume),
            self.kappa,
            tangent,
            base.residual,
            base.tangent,
            base.coupling,
            base.pressure_residual,
            volume_ratio,
        )
        return float(energy), volume_ratio

    def _at_points(
        self, batch: _Batch, parameters: Array, load: Load, tangent: bool, convex: bool
    ) -> list[tuple[str, float]]:
        """Add what terms answer to the element arrays; return their names and energies."""
        group, width = self.assembly.groups[batch.group], batch.width
        functions, starts = batch.place(parameters, load)
        if not len(functions):
            return [(term.name, 0.0) for term, _ in batch.members]
        vectors = kernels.evaluate(parameters, group.pattern.params, starts, functions)
        vectors = vectors.reshape(-1, width, 3)
        forces = np.empty(vectors.shape)
        stiffness = np.empty((len(vectors) if tangent else 0, 6, width, width))
        energies = []
        for term, points in batch.members:
            answer = term.respond(
                vectors[points] if width > 1 else vectors[points, 0], load, convex
            )
            energies.append((term.name, float(answer.energies.sum())))
            forces[points] = answer.forces.reshape(-1, width, 3)
            if tangent:
                stiffness[points] = answer.stiffness().reshape(-1, 6, width, width)
        counts, group.acts = group.pattern.counts, True
        kernels.add_forces(counts, starts, functions, forces, group.residual)
        if tangent:
            kernels.add_stiffness(counts, starts, functions, stiffness, group.tangent, group.stiff)
        return energies

    def tangent(self, extra: Array | None = None) -> sp.csr_matrix:
        """Return the upper triangle of the tangent of the last evaluation that renewed it.

        ``extra`` (n_displacements,) is added to the diagonal of the displacements.
        """
        return self.assembly.matrix(extra)

    def activation_slopes(
        self, parameters: Array, muscles: Sequence[str], load: Load | None = None
    ) -> Array:
        """Return the derivatives of the residual by activations, (n, k).

        At fixed deformation the force of a muscle is linear in its activation.

        Parameters
        ----------
        parameters : (n_params, 3) array
        muscles : sequence of k str
        load : Load, optional
            What else the state carries, such as an open jaw.
        """
        others = replace(load or Load(), activations={})
        free = self.assembly.equations >= 0
        out = np.zeros((self.assembly.n, len(muscles)))
        for term in self.terms:
            if not isinstance(term, Fibres):
                continue
            vectors = np.asarray(term.functions @ parameters)
            passive = term.respond(vectors, others).forces
            for k, name in enumerate(muscles):
                if name in term.names:
                    alone = replace(others, activations={name: 1.0})
                    active = term.respond(vectors, alone).forces - passive
                    forces = np.asarray(term.functions.T @ active)
                    out[self.assembly.equations[free], k] += forces[free]
        return out

    def penetration(self, parameters: Array, load: Load | None = None) -> float:
        """Return the greatest interpenetration of any contact in mm."""
        return max((term.penetration(parameters, load) for term in self.terms), default=0.0)

    def overlap(self, parameters: Array, load: Load) -> float:
        """Return the greatest depth of a contact's points in mm: what pressing apart can change."""
        depths = self._depths(parameters, load).values()
        return max((float(depth.max(initial=0.0)) for depth in depths), default=0.0)

    def _depths(self, parameters: Array, load: Load) -> dict[str, Array]:
        """Return the depths of the points of every contact, by its name."""
        found = {term.name: term.depth(parameters, load) for term in self.terms}
        return {name: depth for name, depth in found.items() if depth is not None}

    def varied(self, coefficients: ArrayLike, fibres: FibreLaw) -> Problem:
        """Return the problem with other coefficients and another law of its fibres.

        It shares all other arrays with this one, those that the evaluation fills as well.

        Parameters
        ----------
        coefficients : (n_elements, q, 3) array
            As in the constructor.
        fibres : FibreLaw
        """
        other = copy(self)
        given = numbers("coefficients", coefficients, *self._coefficients.shape)
        other._coefficients = np.ascontiguousarray(given)
        changed: dict[PointTerm, PointTerm] = {}
        for term in self.terms:
            changed[term] = term
            if isinstance(term, Fibres):
                changed[term] = fibre = copy(term)
                fibre.law = fibres
        other.terms = tuple(changed.values())
        other._groups = {changed[term]: group for term, group in self._groups.items()}
        other._batches = [
            replace(batch, members=[(changed[term], points) for term, points in batch.members])
            for batch in self._batches
        ]
        return other

    def part(self, terms: Sequence[PointTerm]) -> Problem:
        """Return the problem of the passive tissue and some of the terms.

        It shares all arrays with this one.
        """
        bare = copy(self)
        bare.terms = tuple(terms)
        bare._batches = self._batched(terms, [group.pattern for group in self.assembly.groups])
        return bare

    def augment(self, parameters: Array, load: Load) -> Load:
        """Return the load whose contacts keep their forces without overlap (Uzawa's step)."""
        depths = self._depths(parameters, load)
        return replace(
            load,
            offsets={
                name: np.maximum(depth + load.offsets.get(name, 0.0), 0.0)
                for name, depth in depths.items()
            },
        )

    def check(self, volume_ratio: Array) -> Statistics:
        """Return the figures of a state's volume ratio at the Gauss points."""
        return Statistics(
            J_min=float(volume_ratio.min()),
            J_max=float(volume_ratio.max()),
            volume_change=float((self.weights * volume_ratio).sum() / self.weights.sum() - 1.0),
        )

    def muscles_in(self, element: int) -> list[str]:
        """Return the names of the muscles with fibres in an element."""
        found: list[str] = []
        for term in self.terms:
            if isinstance(term, Fibres):
                here = np.unique(term.quadrature.muscles[term.quadrature.elements == element])
                found += [term.names[index] for index in here]
        return found

    def where(self, element: int) -> str:
        """Describe an element for a message: its centre at rest, and the nearest named place."""
        place = self.mesh.evaluate([element], [[0.5, 0.5, 0.5]])[0]
        text = f"element {element} at ({', '.join(f'{c:.0f}' for c in place)}) mm"
        if self.places:
            away = {name: float(np.linalg.norm(at - place)) for name, at in self.places.items()}
            nearest = min(away, key=lambda name: away[name])
            text += f", {away[nearest]:.0f} mm from {nearest}"
        return text
