"""Every term against finite differences, and all of them against rigid motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..hermite import HermiteMesh
from ..hermite.basis import Array
from ..mechanics import (
    MUSCLE,
    BlemkerMuscle,
    DeadForces,
    FibreLaw,
    FibreQuadrature,
    Fibres,
    FollowerPressure,
    Formulation,
    GlidingFibres,
    GlidingQuadrature,
    Guccione,
    Law,
    Load,
    PointTerm,
    Problem,
    RigidContact,
    Sheet,
    Springs,
    SurfaceContact,
    Tension,
    Volume,
    clamp,
    face_points,
)
from .case import Check
from .contact import blocks
from .meshes import box

STEP = 1e-5
LOAD = Load({"first": 0.7, "second": 0.2}, forces={"weight": 0.6, "pressure": 2.0, "tension": 5.0})
FIBRE = (0.6, 0.0, 0.8)


@dataclass(frozen=True)
class Sphere:
    """The signed distance of a ball."""

    centre: tuple[float, float, float]
    radius: float

    def sample(self, points: Array) -> tuple[Array, Array, Array]:
        """Return distance, gradient and Hessian."""
        away = points - np.array(self.centre)
        length = np.linalg.norm(away, axis=1)
        normal = away / length[:, None]
        outer = normal[:, :, None] * normal[:, None, :]
        return length - self.radius, normal, (np.eye(3) - outer) / length[:, None, None]


def crooked() -> HermiteMesh:
    """Return four bent elements."""
    mesh = box((20.0, 16.0, 6.0), (2, 2, 1))
    noise = np.random.default_rng(3).uniform(-0.6, 0.6, mesh.parameters.shape)
    noise[7::8] *= 0.3
    return mesh.with_parameters(mesh.parameters + noise)


def terms(mesh: HermiteMesh) -> dict[str, PointTerm]:
    """Return every term that a face or a case may have, at work on the crooked mesh."""
    rng = np.random.default_rng(5)
    directions = rng.normal(size=(40, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hosts, xi, weights = rng.integers(0, 4, 40), rng.uniform(size=(40, 3)), np.linspace(5, 20, 40)
    rule = FibreQuadrature(hosts, xi, weights, directions, rng.integers(0, 2, 40))
    bundles = GlidingQuadrature(
        hosts, xi, weights, directions, np.repeat([0, 1], 20), np.repeat(range(8), 5), weights / 500
    )
    inner = face_points(mesh, np.arange(4), 2, 0, 3)
    some = rng.integers(0, 4, 12), rng.uniform(size=(12, 3)), rng.uniform(1, 50, 12)
    others = rng.integers(0, 4, 12), rng.uniform(size=(12, 3))
    return {
        "fibres": Fibres(mesh, rule, ("first", "second"), FibreLaw(optimal=1.1), {"second": 0.9}),
        "gliding fibres": GlidingFibres(mesh, bundles, ("first", "second")),
        "springs": Springs(mesh, *some),
        "bonds": Springs(mesh, *some, "bonds", to=others),
        "sheet": Sheet(mesh, hosts, xi, 1e3 * weights),
        "rigid contact": RigidContact(
            mesh, Sphere((10, 8, -30), 30.3), *inner, slide=np.full(len(inner[0]), 0.2)
        ),
        "body force": DeadForces.body(mesh, [0.3, -0.2, -1.0]),
        "tension": Tension(mesh, hosts, xi, weights, directions),
    }


def all_round(mesh: HermiteMesh) -> list[PointTerm]:
    """Return a pressure on the whole surface of the crooked mesh."""
    sides = [
        ([0, 2], 0, 0),
        ([1, 3], 0, 1),
        ([0, 1], 1, 0),
        ([2, 3], 1, 1),
        (range(4), 2, 0),
        (range(4), 2, 1),
    ]
    return [
        FollowerPressure(mesh, list(elements), axis, at, name="pressure")
        for elements, axis, at in sides
    ]


def differences(
    problem: Problem, moved: Array | None = None, *, quadratic: bool = False
) -> tuple[float, float]:
    """Compare the residual and the tangent with central differences at a random state.

    Parameters
    ----------
    problem : Problem
    moved : (n_params, 3) array, optional
        Displacement of the parameters in mm; random and squeezed by default.
    quadratic : bool
        Compare only ``d · K d``, which a symmetric part of the tangent shares.

    Returns
    -------
    gradient, tangent : float
        Greatest relative errors over three random directions.
    """
    rng = np.random.default_rng(6)
    rest = problem.rest()
    if moved is None:
        moved = rng.uniform(-0.4, 0.4, rest.parameters.shape)
        moved[:, 1] -= 0.25 * rest.parameters[:, 1]
        moved[problem.fixed] = 0.0
    rest.parameters[:] += moved
    rest.pressure[:] = rng.uniform(-3.0, 3.0, rest.pressure.shape)
    found = problem.evaluate(rest.parameters, rest.pressure, LOAD, tangent=True)
    upper = problem.tangent()
    full = upper + sp.triu(upper, 1).T
    gradient = tangent = 0.0
    for _ in range(3):
        direction = rng.normal(size=problem.n_unknowns)
        ahead, behind = (
            problem.evaluate(*problem.add(rest.parameters, rest.pressure, h * direction), LOAD)
            for h in (STEP, -STEP)
        )
        slope = (ahead.energy - behind.energy) / (2.0 * STEP)
        gradient = max(gradient, abs(float(slope / (found.residual @ direction)) - 1.0))
        rate = (ahead.residual - behind.residual) / (2.0 * STEP)
        expected = full @ direction
        if quadratic:
            wrong = abs(rate @ direction / (expected @ direction) - 1.0)
        else:
            wrong = np.abs(rate - expected).max() / np.abs(expected).max()
        tangent = max(tangent, float(wrong))
    return float(gradient), tangent


def finite_differences(fine: bool) -> list[Check]:
    """Compare all residuals and tangents with finite differences."""
    mesh = crooked()
    fixed = clamp(mesh, [0, 2], 0, 0)
    found: dict[str, tuple[float, float]] = {
        "tissue": differences(Problem(mesh, [2.0, 1.1, 0.4], kappa=20.0, fixed=fixed)),
        "tissue, plain invariants": differences(
            Problem(
                mesh,
                [2.0, 6.0, 0.0],
                kappa=20.0,
                formulation=Formulation(Law.PLAIN),
                fixed=fixed,
            )
        ),
        "tissue, Guccione": differences(
            Problem(
                mesh,
                Guccione(2.0, 8.0, 2.0, 4.0).array(FIBRE),
                kappa=20.0,
                formulation=Formulation(Law.GUCCIONE),
                fixed=fixed,
            )
        ),
        "tissue, muscle without pressure": differences(
            Problem(
                mesh,
                BlemkerMuscle(0.5, 0.7, activation=0.2).array(FIBRE),
                kappa=20.0,
                formulation=Formulation(Law.MUSCLE, Volume.LOGARITHM),
                fixed=fixed,
            )
        ),
    }
    for name, term in terms(mesh).items():
        found[name] = differences(soft(mesh, [term], fixed))
    found["surface contact"] = surfaces()
    found["surface contact, at an edge"] = edges()
    # Only a closed surface's pressure has an energy; an open one's stiffness is symmetrised.
    free = np.zeros_like(fixed)
    found["follower pressure, all round"] = differences(soft(mesh, all_round(mesh), free))
    _, part = differences(soft(mesh, all_round(mesh)[4:5], fixed), quadratic=True)
    checks = [
        Check(f"{name}: {kind}", 0.0, error, 1e-6)
        for name, errors in found.items()
        for kind, error in zip(("residual", "tangent"), errors, strict=True)
    ]
    return [*checks, Check("follower pressure, one side: symmetric part", 0.0, part, 1e-6)]


def surfaces() -> tuple[float, float]:
    """Compare the contact of two bent blocks, the lower one pushed 0.3 mm into the upper."""
    mesh, upper, lower = blocks(
        [np.linspace(0.0, 20.0, 3), np.linspace(0.0, 16.0, 4), np.array([-6.0, 0.0])],
        [np.linspace(0.0, 20.0, 4), np.linspace(0.0, 16.0, 3), np.array([0.0, 6.0])],
    )
    contact = SurfaceContact(mesh, upper, lower)
    problem = soft(mesh, [contact], np.zeros((mesh.n_params, 3), dtype=bool))
    moved = np.random.default_rng(9).uniform(-0.3, 0.3, mesh.parameters.shape)
    # The parameters of the lower block come first: 3 x 4 x 2 nodes.
    moved[: 8 * 24 : 8, 2] += 0.3
    return differences(problem, moved)


def edges() -> tuple[float, float]:
    """Compare the contact of two blocks, the end of one on the edge of the other."""
    ticks = np.array([0.0, 20.0]), np.array([0.0, 16.0]), np.array([-6.0, 0.0])
    beside = np.array([19.92, 35.0]), np.array([1.0, 15.0]), np.array([0.0, 6.0])
    mesh, upper, lower = blocks(ticks, beside)
    contact = SurfaceContact(mesh, upper, lower, flanks=((), [(lower[0], 0, 1)]))
    assert contact.edges is not None
    problem = soft(mesh, [contact, contact.edges], np.zeros((mesh.n_params, 3), dtype=bool))
    moved = np.random.default_rng(9).uniform(-0.02, 0.02, mesh.parameters.shape)
    # The parameters of the lower block come first: 2 x 2 x 2 nodes.
    moved[64::8, 2] -= 0.1
    return differences(problem, moved)


def soft(mesh: HermiteMesh, chosen: Sequence[PointTerm], fixed: NDArray[np.bool_]) -> Problem:
    """Return a problem in which the terms outweigh the tissue."""
    return Problem(mesh, [1e-3, 0.0, 0.0], kappa=1e-3, terms=chosen, fixed=fixed)


def rigid_motion(fine: bool) -> list[Check]:
    """Turn and move a deformed block: energies stay, forces turn with it."""
    mesh = crooked()
    chosen = [t for n, t in terms(mesh).items() if n in ("fibres", "tension")]
    problems = {
        "face": Problem(mesh, MUSCLE["wu2013"].array(), terms=[*chosen, *all_round(mesh)]),
        "plain invariants": Problem(
            mesh, [2.0, 6.0, 0.0], formulation=Formulation(Law.PLAIN, Volume.INVERSE)
        ),
        "Guccione": Problem(
            mesh,
            Guccione(2.0, 8.0, 2.0, 4.0).array(FIBRE),
            formulation=Formulation(Law.GUCCIONE),
        ),
        "muscle": Problem(
            mesh,
            BlemkerMuscle(0.5, 0.7, activation=0.2).array(FIBRE),
            formulation=Formulation(Law.MUSCLE, Volume.LOGARITHM),
        ),
    }
    rng = np.random.default_rng(8)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    checks = []
    for name, problem in problems.items():
        rest = problem.rest()
        here = rest.parameters + rng.uniform(-0.3, 0.3, rest.parameters.shape)
        there = here @ turn.T
        there[::8] += [30.0, -20.0, 50.0]
        pressure = rng.uniform(-3.0, 3.0, rest.pressure.shape)
        before = problem.evaluate(here, pressure, LOAD)
        forces = problem.assembly.forces()
        after = problem.evaluate(there, pressure, LOAD)
        wrong = np.abs(problem.assembly.forces() - forces @ turn.T).max() / np.abs(forces).max()
        change = abs(after.energy / before.energy - 1.0)
        checks += [
            Check(f"{name}: change of the energy", 0.0, float(change), 1e-11),
            Check(f"{name}: change of the forces", 0.0, float(wrong), 1e-11),
        ]
    return checks
