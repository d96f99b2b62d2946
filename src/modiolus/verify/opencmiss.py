"""Two examples of OpenCMISS with tricubic Hermite elements.

Plain invariants, the pressure as ``2 p C⁻¹`` and a constraint that is not its derivative
(`Volume.INVERSE`), arc-length derivatives and arithmetic-mean scale factors: the formulation
differs from that of the face in everything that can be chosen, the kernels do not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..hermite import HermiteMesh
from ..mechanics import (
    Continuation,
    DeadForces,
    Formulation,
    Law,
    Load,
    Problem,
    Settings,
    State,
    Volume,
)
from .case import Check, vector
from .meshes import box, scaled

FORMULATION = Formulation(Law.PLAIN, Volume.INVERSE)


def arc_length_box(size: tuple[float, float, float], counts: tuple[int, int, int]) -> HermiteMesh:
    """Return a box with unit nodal derivatives; the elements' lengths are scale factors."""
    mesh = box(size, counts)
    lengths = np.array(size) / counts
    factors = [
        np.prod([lengths[k] for k in range(3) if kind >> k & 1], initial=1.0) for kind in range(8)
    ]
    return scaled(mesh, np.tile(factors, mesh.n_params // 8))


def equilibrium(problem: Problem, load: Load, c10: float, c01: float) -> State:
    """Follow a load from rest, where the pressure is that of the unloaded box."""
    rest = problem.rest()
    rest = replace(rest, pressure=np.full_like(rest.pressure, -(c10 + 2.0 * c01)))
    return Continuation(problem, rest, settings=Settings(tolerance=1e-11, first_step=0.25)).run(
        load
    )


def cantilever(fine: bool) -> list[Check]:
    """Bend a cantilever under its own weight."""
    mesh = arc_length_box((60.0, 40.0, 40.0), (2, 1, 1))
    nodes = mesh.parameters[::8]
    fixed = np.zeros((len(nodes), 8, 3), dtype=bool)
    # Everything at the wall but the first derivative.
    fixed[nodes[:, 0] == 0.0] = True
    fixed[:, 1] = False
    weight = DeadForces.body(mesh, [0.0, 0.0, -9.8 * 9e-4])
    problem = Problem(
        mesh, [2.0, 6.0, 0.0], formulation=FORMULATION, terms=[weight], fixed=fixed.reshape(-1, 3)
    )
    state = equilibrium(problem, Load(forces={"weight": 1.0}), 2.0, 6.0)
    place = state.parameters[::8]
    tip = int(problem.vertices[1, 1])
    return [
        *vector(
            "node 3 in mm,",
            (59.277619075062248, 0.023277992097039926, -2.4794926551251941),
            place[2],
            1e-8,
        ),
        Check("node 3, pressure in kPa", -14.025832457492537, float(state.pressure[tip]), 1e-8),
        *vector(
            "node 8 in mm,",
            (30.580995455697160, 0.11228402882509946, 38.781108562961123),
            place[7],
            1e-8,
        ),
    ]


def extension(fine: bool) -> list[Check]:
    """Stretch a cube of one element with 3 x 3 x 3 Gauss points."""
    mesh = arc_length_box((1.0, 1.0, 1.0), (1, 1, 1))
    nodes = mesh.parameters[::8]
    fixed = np.zeros((8, 8, 3), dtype=bool)
    fixed[:, 2:] = True
    fixed[:, 0, :2] = True
    fixed[nodes[:, 0] == 0.0, 0, 2] = True
    prescribed = np.zeros((8, 8, 3))
    prescribed[nodes[:, 0] == 1.0, 0, 0] = 0.1
    problem = Problem(
        mesh,
        [2.0, 4.0, 0.0],
        formulation=FORMULATION,
        gauss_order=3,
        fixed=fixed.reshape(-1, 3),
    )
    state = equilibrium(problem, Load(prescribed=prescribed.reshape(-1, 3)), 2.0, 4.0)
    node = state.parameters.reshape(8, 8, 3)[1]
    return [
        Check("node 2 z in mm", 0.033134537802209457, float(node[0, 2]), 1e-8),
        *vector(
            "node 2 d/ds1",
            (1.0897354941351172, -0.10433870026326990, 0.038829503552476899),
            node[1],
            1e-8,
        ),
    ]
