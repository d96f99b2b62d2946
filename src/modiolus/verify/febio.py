"""Two tests of FEBio's muscle material: trilinear elements, compressible, no multiplier."""

from __future__ import annotations

import numpy as np

from ..hermite import grid_connectivity, linear
from ..mechanics import (
    BlemkerMuscle,
    FibreLaw,
    Formulation,
    Law,
    Load,
    Problem,
    Settings,
    Volume,
    solve,
)
from .case import Check


def pulled(counts: int, material: BlemkerMuscle, shift: float) -> float:
    """Pull a row of unit cubes along its fibres; return the norm of the free displacements.

    Parameters
    ----------
    counts : int
        Number of cubes, along x.
    material : BlemkerMuscle
    shift : float
        Displacement of the end in mm.
    """
    ticks = [np.arange(n + 1.0) for n in (1, 1, counts)]
    vertices = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 3)[:, ::-1]
    mesh = linear(vertices, grid_connectivity((counts, 1, 1), (False, False, False)))
    fixed = vertices == 0.0
    end = vertices[:, 0] == counts
    fixed[end, 0] = True
    prescribed = np.zeros_like(vertices)
    prescribed[end, 0] = shift
    problem = Problem(
        mesh,
        material.array([1.0, 0.0, 0.0]),
        kappa=1e4,
        formulation=Formulation(Law.MUSCLE, Volume.LOGARITHM),
        fixed=fixed,
    )
    settings = Settings(tolerance=1e-12, first_step=0.5)
    state = solve(problem, Load(prescribed=prescribed), settings=settings)
    return float(np.linalg.norm(state.displacement[~fixed]))


def mu02(fine: bool) -> list[Check]:
    """Shorten two cubes whose fibres are slack."""
    law = FibreLaw(optimal=1.4, toe=0.0)
    got = pulled(2, BlemkerMuscle(0.5, 0.5, law, slack=1.4), -0.01)
    return [Check("norm of the free displacements in mm", 0.0132501289648, got, 1e-6, True)]


def mu03(fine: bool) -> list[Check]:
    """Stretch a cube along its taut fibres by 1.2."""
    got = pulled(1, BlemkerMuscle(0.5, 0.5, FibreLaw(toe=0.0)), 0.2)
    return [Check("norm of the free displacements in mm", 0.244325959214, got, 1e-6, True)]
