"""Closed forms: a cube in plane strain, the work of a muscle, and one that gives way."""

from __future__ import annotations

import numpy as np

from ..mechanics import (
    MUSCLE,
    Continuation,
    DeadForces,
    FibreLaw,
    FibreQuadrature,
    Fibres,
    Load,
    Problem,
    Settings,
    Stride,
    clamp,
    face_points,
    solve,
    trace,
)
from ..mechanics.kernels import fibre
from .case import Check
from .meshes import box, side

STRETCH = 1.3


def plane_strain(fine: bool) -> list[Check]:
    """Stretch an incompressible cube in plane strain, with both readings of the muscle's c2.

    With the stretches ``λ, 1, 1/λ`` both invariants are ``λ² + 1 + 1/λ²``, and the force by the
    area at rest is ``2 (c10 + c01) (λ - λ⁻³)``.
    """
    checks = []
    for name in ("wu2013", "wu2013-as-printed"):
        mesh = box((1.0, 1.0, 1.0), (2, 2, 2))
        fixed = np.zeros((mesh.n_params, 3), dtype=bool)
        fixed[:, 1] = True
        for axis, place, at in ((0, 0.0, 0), (0, 1.0, 1), (2, 0.0, 0)):
            within, _ = mesh.face_parameters(side(mesh, axis, place), axis, at)
            fixed[within, axis] = True
        prescribed = np.where(fixed, mesh.parameters * [STRETCH - 1.0, 0.0, 0.0], 0.0)
        problem = Problem(mesh, MUSCLE[name].array(), fixed=fixed)
        settings = Settings(tolerance=1e-12, first_step=0.5)
        state = solve(problem, Load(prescribed=prescribed), settings=settings)
        problem.evaluate(state.parameters, state.pressure, state.load)
        pulled = np.isclose(mesh.parameters[:, 0], 1.0) & (np.arange(mesh.n_params) % 8 == 0)
        force = float(problem.assembly.forces()[pulled, 0].sum())
        moduli = MUSCLE[name].c10 + MUSCLE[name].c01
        expected = 2.0 * moduli * (STRETCH - STRETCH**-3)
        checks += [
            Check(f"{name}: force in mN", expected, force, 1e-9, True),
            Check(
                f"{name}: stretch across",
                1.0 / STRETCH,
                float(state.deformation_gradient([0], [[0.3, 0.4, 0.6]])[0, 2, 2]),
                1e-9,
                True,
            ),
        ]
    return checks


def muscle_work(fine: bool) -> list[Check]:
    """Compare the work of a muscle with the energy stored in the tissue.

    With the energy ``Π = U(x) + a Ψ(x)``, equilibrium along a path of activations a gives
    ``dU = -a dΨ``; by parts, the work is ``∫ Ψ da - a Ψ`` from rest to the end. The path is
    solved at the points of a Gauss rule in a.
    """
    mesh = box((20.0, 10.0, 10.0), (2, 1, 1))
    rule = mesh.quadrature()
    # Fibres along x in the upper part only: the block bends, and nothing is even.
    upper = rule.xi[:, 2] > 0.5
    fibres = FibreQuadrature(
        rule.elements[upper],
        rule.xi[upper],
        rule.weights[upper],
        np.tile([1.0, 0.0, 0.0], (int(upper.sum()), 1)),
        np.zeros(int(upper.sum()), dtype=np.int64),
    )
    problem = Problem(
        mesh,
        MUSCLE["wu2013"].array(),
        terms=[Fibres(mesh, fibres, ["muscle"])],
        fixed=clamp(mesh, side(mesh, 0, 0.0), 0, 0),
    )
    run = Continuation(problem, settings=Settings(tolerance=1e-9))
    greatest = 0.04

    def energies(activation: float) -> tuple[float, float]:
        """Return the stored energy U and the muscle's Ψ at an equilibrium, in mN mm."""
        state = run.run(problem.load({"muscle": activation}))
        at = state.parameters, state.pressure
        stored = problem.evaluate(*at, problem.load({})).energy
        return stored, problem.evaluate(*at, problem.load({"muscle": 1.0})).energy - stored

    nodes, shares = np.polynomial.legendre.leggauss(8)
    inside = [energies(0.5 * greatest * (node + 1.0))[1] for node in nodes]
    stored, last = energies(greatest)
    work = 0.5 * greatest * float(shares @ inside) - greatest * last
    return [Check("work of the muscle in mN mm", stored, work, 1e-4, True)]


def giving_way(fine: bool) -> list[Check]:
    """Stretch an active muscle beyond the length at which it is strongest.

    Under the force ``F`` an area at rest, ``F = 2 c10 (λ - λ⁻²) + ψ'(λ)``. It falls from where the
    active force does to where the passive one sets in, and there equilibrium is unstable.
    """
    activation, slack, c10, greatest = 0.5, 1.3, 1.0, 300.0
    mesh = box((10.0, 2.0, 2.0), (2, 1, 1))
    rule = mesh.quadrature(4)
    along = np.tile([1.0, 0.0, 0.0], (len(rule.weights), 1))
    muscle = np.zeros(len(rule.weights), dtype=np.int64)
    fibres = FibreQuadrature(rule.elements, rule.xi, rule.weights, along, muscle)
    fixed = np.zeros((mesh.n_params, 3), dtype=bool)
    for axis in range(3):
        fixed[mesh.face_parameters(side(mesh, axis, 0.0), axis, 0)[0], axis] = True
    elements, xi, areas = face_points(mesh, side(mesh, 0, 10.0), 0, 1)
    pull = DeadForces(mesh, elements, xi, areas[:, None] * [1.0, 0.0, 0.0], "pull")
    law = FibreLaw()
    problem = Problem(
        mesh,
        [c10, 0.0, 0.0],
        terms=[Fibres(mesh, fibres, ["muscle"], law, {"muscle": slack}), pull],
        fixed=fixed,
    )
    active = {"muscle": activation}
    short = solve(problem, problem.load(active), settings=Settings(tolerance=1e-9))
    path = trace(problem, Load(active, forces={"pull": greatest}), short, Stride(length=0.3))
    found = []
    for share, state in path:
        stretch = float(state.mesh.evaluate([1], [[1.0, 0.5, 0.5]])[0, 0]) / 10.0
        force = 2.0 * c10 * (stretch - stretch**-2)
        force += fibre(stretch, activation, slack, law.array())[1]
        found.append((share * greatest, force, state.statistics.wrong_pivots or 0))
    forces, expected, unstable = np.array(found).T
    falls = np.diff(forces) < 0.0
    return [
        Check(
            "error of the force along the path in kPa", 0.0, np.abs(forces - expected).max(), 1e-6
        ),
        Check("states of which the force falls", 3.0, float(falls.sum()), 0.0, at_least=True),
        Check(
            "of these, unstable", float(falls.sum()), float((unstable[1:][falls] > 0).sum()), 0.0
        ),
    ]
