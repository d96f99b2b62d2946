"""Rates of convergence to a manufactured solution, and the stability of the pressure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from ..hermite import HermiteMesh
from ..hermite.basis import Array
from ..mechanics import (
    Continuation,
    DeadForces,
    Formulation,
    Load,
    Problem,
    Settings,
    Volume,
    clamp,
    face_points,
)
from ..mechanics.problem import trilinear
from .case import Check
from .meshes import box, side
from .patch import COEFFICIENTS, piola

KAPPA = 20.0


@dataclass(frozen=True)
class Waves:
    """A displacement whose components are products of sines.

    Attributes
    ----------
    amplitudes : (3,) tuple of float
        In mm.
    numbers, phases : (3, 3) tuples of float
        Wave number in 1/mm and phase in radians, by component and direction; a wave number of 0
        makes the component even in the direction, with the factor 1.
    """

    amplitudes: tuple[float, ...]
    numbers: tuple[tuple[float, ...], ...]
    phases: tuple[tuple[float, ...], ...]

    def displacement(self, points: Array, orders: tuple[int, int, int] = (0, 0, 0)) -> Array:
        """Return the displacement of points (n, 3), or a derivative of it, (n, 3)."""
        out = np.tile(self.amplitudes, (len(points), 1))
        for i, k in np.ndindex(3, 3):
            number = self.numbers[i][k]
            if number == 0.0:
                out[:, i] *= float(orders[k] == 0)
            else:
                turned = number * points[:, k] + self.phases[i][k] + 0.5 * np.pi * orders[k]
                out[:, i] *= number ** orders[k] * np.sin(turned)
        return out

    def gradient(self, points: Array) -> Array:
        """Return the deformation gradient at points, (n, 3, 3)."""
        units = np.eye(3, dtype=int).tolist()
        slopes = [self.displacement(points, tuple(unit)) for unit in units]
        return np.eye(3) + np.stack(slopes, axis=2)


#: Changes volume everywhere.
GENERAL = Waves(
    (0.05, 0.04, 0.06),
    ((2.0, 1.5, 1.0), (1.0, 2.0, 1.5), (1.5, 1.0, 2.0)),
    ((0.3, 0.8, 0.5), (0.6, 0.2, 0.9), (0.4, 0.7, 0.1)),
)
#: ``x(Y, Z)``, ``y(Z)``: one shear after another, ``J = 1`` everywhere.
SHEARS = Waves(
    (0.12, 0.1, 0.0),
    ((0.0, 2.0, 1.5), (0.0, 0.0, 2.5), (0.0, 0.0, 0.0)),
    ((0.0, 0.4, 0.8), (0.0, 0.0, 0.3), (0.0, 0.0, 0.0)),
)


def spherical(f: Array, pressure: Array, volume: Volume) -> Array:
    """Return the mean of the Kirchhoff stress (n,) that a law for the volume gives, ``J U'(J)``.

    Parameters
    ----------
    f : (n, 3, 3) array
        Deformation gradients.
    pressure : (n,) array
        In kPa.
    volume : Volume
    """
    det = np.linalg.det(f)
    if volume == Volume.LOGARITHM:
        return np.asarray(KAPPA * np.log(det))
    return np.asarray(det * (KAPPA * (det - 1.0) + pressure))


def no_pressure(points: Array) -> Array:
    """Return no pressure at all."""
    return np.zeros(len(points))


def even_pressure(points: Array) -> Array:
    """Return a pressure that the trilinear functions hold exactly."""
    return np.asarray(1.0 + points @ [0.8, -0.5, 0.6])


def wavy_pressure(points: Array) -> Array:
    """Return a pressure that they do not hold."""
    return np.asarray(1.0 + np.sin(2.0 * points[:, 0] + 0.3) * np.cos(1.5 * points[:, 1]))


def errors(
    n: int, waves: Waves, pressure: Callable[[Array], Array], volume: Volume
) -> tuple[float, float]:
    """Solve on a cube of n³ elements, held on five sides.

    Returns
    -------
    displacement, gradient : float
        Norms of the errors in L2.
    """
    mesh = box((1.0, 1.0, 1.0), (n, n, n))

    def stress(points: Array) -> Array:
        f = waves.gradient(points)
        return piola(f, spherical(f, pressure(points), volume))

    rule = mesh.quadrature(6)
    points = mesh.evaluate(rule.elements, rule.xi)
    # The divergence by central differences of sixth order.
    force = np.zeros_like(points)
    for k in range(3):
        for steps, share in ((1, 0.75), (2, -0.15), (3, 1.0 / 60.0)):
            shift = steps * 5e-3 * np.eye(3)[k]
            rate = (stress(points + shift) - stress(points - shift))[:, :, k]
            force -= share / 5e-3 * rate
    top = side(mesh, 2, 1.0)
    hosts, xi, areas = face_points(mesh, top, 2, 1, 6)
    traction = areas[:, None] * stress(mesh.evaluate(hosts, xi))[:, :, 2]
    forces = [
        DeadForces(mesh, rule.elements, rule.xi, rule.weights[:, None] * force, "body force"),
        DeadForces(mesh, hosts, xi, traction, "traction"),
    ]
    fixed = np.zeros((mesh.n_params, 3), dtype=bool)
    for axis, place, at in ((0, 0.0, 0), (0, 1.0, 1), (1, 0.0, 0), (1, 1.0, 1), (2, 0.0, 0)):
        fixed |= clamp(mesh, side(mesh, axis, place), axis, at)
    nodes = mesh.parameters[::8]
    known = np.zeros_like(mesh.parameters)
    for kind in range(8):
        orders = (kind & 1, kind >> 1 & 1, kind >> 2 & 1)
        known[kind::8] = waves.displacement(nodes, orders) / n ** sum(orders)
    problem = Problem(
        mesh,
        COEFFICIENTS,
        kappa=KAPPA,
        formulation=Formulation(volume=volume),
        terms=forces,
        fixed=fixed,
    )
    load = Load(prescribed=np.where(fixed, known, 0.0), forces={"body force": 1.0, "traction": 1.0})
    # The solution is near, and the path to it is not of interest.
    start = replace(problem.rest(), parameters=mesh.parameters + known, load=load)
    run = Continuation(problem, start, settings=Settings(tolerance=1e-11, first_step=1.0))
    state = run.run(load)
    inside = rule.elements, rule.xi
    wrong = state.mesh.evaluate(*inside) - points - waves.displacement(points)
    slopes = state.deformation_gradient(*inside) - waves.gradient(points)
    return (
        float(np.sqrt(rule.weights @ (wrong**2).sum(axis=1))),
        float(np.sqrt(rule.weights @ (slopes**2).sum(axis=(1, 2)))),
    )


def manufactured(fine: bool) -> list[Check]:
    """Measure the rates from the two finest of three meshes.

    A trilinear pressure can follow a curved one with an error of second order only. The energy's
    rate is then two and the displacement's three; where the pressure does not stand in the way
    the elements have their own four and three.
    """
    sizes = (3, 6) if fine else (2, 4)
    checks = []
    for name, waves, pressure, volume, least in (
        ("compressible", GENERAL, no_pressure, Volume.LOGARITHM, (3.8, 2.8)),
        ("incompressible", SHEARS, even_pressure, Volume.MULTIPLIER, (3.8, 2.8)),
        ("incompressible, curved pressure", SHEARS, wavy_pressure, Volume.MULTIPLIER, (2.8, 1.8)),
    ):
        coarse, finest = (np.array(errors(n, waves, pressure, volume)) for n in sizes)
        found = np.log(coarse / finest) / np.log(sizes[1] / sizes[0])
        checks += [
            Check(f"{name}: rate of the {norm}", least[k], float(found[k]), 0.0, at_least=True)
            for k, norm in enumerate(("displacement", "energy"))
        ]
    return checks


def stability(mesh: HermiteMesh) -> float:
    """Return the inf-sup constant of a cube that is held all round.

    The smallest β above zero with ``B A⁻¹ Bᵀ q = β² M q``: A is the inner product of the
    displacements' gradients, M that of the pressures, and B the coupling at rest, as the
    tangent has it.
    """
    fixed = np.zeros((mesh.n_params, 3), dtype=bool)
    for axis in range(3):
        for at in (0, 1):
            fixed |= clamp(mesh, side(mesh, axis, float(at)), axis, at)
    problem = Problem(mesh, [1.0, 0.0, 0.0], fixed=fixed)
    rest = problem.rest()
    problem.evaluate(rest.parameters, rest.pressure, rest.load, tangent=True)
    n = problem.assembly.n_displacements
    coupling = problem.tangent()[:n, n:].toarray()
    rule = mesh.quadrature(4)
    inverse = np.linalg.inv(mesh.jacobian(rule.elements, rule.xi))
    units = np.eye(3, dtype=int).tolist()
    local = [mesh.functions(rule.elements, rule.xi, unit) for unit in units]
    weights = sp.diags_array(rule.weights)
    norm = sp.csr_matrix((mesh.n_params, mesh.n_params))
    for k in range(3):
        slope = sum(sp.diags_array(inverse[:, j, k]) @ local[j] for j in range(3))
        norm = norm + slope.T @ weights @ slope
    params, components = np.nonzero(problem.assembly.equations >= 0)
    order = np.argsort(problem.assembly.equations[params, components])
    params, components = params[order], components[order]
    schur = np.zeros((coupling.shape[1], coupling.shape[1]))
    for i in range(3):
        mine = components == i
        block = norm[params[mine]][:, params[mine]].toarray()
        schur += coupling[mine].T @ la.solve(block, coupling[mine], assume_a="pos")
    functions = np.zeros((len(rule.weights), coupling.shape[1]))
    psi = trilinear(rule.xi)
    columns = problem.assembly.pressure_equations[problem.vertices[rule.elements]] - n
    np.add.at(functions, (np.arange(len(psi))[:, None], columns), psi)
    mass = functions.T @ weights @ functions
    # The smallest eigenvalue, zero, belongs to the even pressure.
    return float(np.sqrt(la.eigh(schur, mass, eigvals_only=True)[1]))


def inf_sup(fine: bool) -> list[Check]:
    """Refine a cube and see that the inf-sup constant settles above zero."""
    sizes = (2, 3, 4, 5, 6) if fine else (2, 3, 4)
    found = [stability(box((1.0, 1.0, 1.0), (n, n, n))) for n in sizes]
    steps = np.diff(found)
    return [
        Check(f"inf-sup constant, {sizes[-1]}³ elements", 0.3, found[-1], 0.0, at_least=True),
        Check("last change by the one before it", 0.0, float(abs(steps[-1] / steps[-2])), 0.9),
    ]
