"""modiolus: tricubic Hermite elements with a linear continuous pressure, symmetric PARDISO.

One layer of elements in height: fibres have points of their own and need no element's border.
"""

from __future__ import annotations

import common
import numba
import numpy as np
import scipy

import modiolus
from modiolus.errors import SolveError
from modiolus.hermite import bricks, gauss
from modiolus.mechanics import (
    FollowerPressure,
    Formulation,
    Guccione,
    Law,
    Load,
    Problem,
    Settings,
    Tension,
    clamp,
    solve,
)
from modiolus.verify.meshes import side

#: Volumetric stiffness in kPa beside the pressure.
KAPPA = {"land": 20.0, "muscle": 2.0}


def answer(case: str, shape: common.Mesh) -> common.Answer:
    """Solve a case."""
    counts, growth = shape
    if case == "muscle":
        counts = (*counts[:2], 1)
    mesh = bricks(common.ticks(case, counts, growth))
    fixed = clamp(mesh, side(mesh, 0, 0.0), 0, 0)
    settings = Settings(tolerance=1e-5, passing=1e-2, first_step=common.STEP[case])
    if case == "land":
        problem = Problem(
            mesh,
            Guccione(common.C, *common.B[[0, 1, 0], [0, 1, 1]]).array([1.0, 0.0, 0.0]),
            formulation=Formulation(Law.GUCCIONE),
            terms=[FollowerPressure(mesh, side(mesh, 2, 0.0), 2, 0, n=4)],
            kappa=KAPPA[case],
            fixed=fixed,
        )
        load = Load(forces={"pressure": common.PRESSURE})
    else:
        xi, weights = gauss(3, 4)
        hosts = np.repeat(np.arange(mesh.n_elements), len(weights))
        xi = np.tile(xi * [1.0, 1.0, 0.5], (mesh.n_elements, 1))
        volume = np.tile(0.5 * weights, mesh.n_elements) * np.linalg.det(mesh.jacobian(hosts, xi))
        along = np.tile([1.0, 0.0, 0.0], (len(hosts), 1))
        problem = Problem(
            mesh,
            [common.C10, 0.0, 0.0],
            terms=[Tension(mesh, hosts, xi, volume, along)],
            kappa=KAPPA[case],
            fixed=fixed,
        )
        load = Load(forces={"tension": common.TENSION})
    try:
        state = solve(problem, load, settings=settings)
    except SolveError as error:
        raise common.DivergedError from error
    tip = mesh.locate([common.CASES[case].tip])
    height = float(state.mesh.evaluate(tip.elements, tip.xi)[0, 2])
    return common.Answer(
        mesh.n_elements,
        problem.n_unknowns,
        state.statistics.newton_iterations,
        height - common.CASES[case].tip[2],
    )


if __name__ == "__main__":
    versions = {"modiolus": modiolus.__version__, "SciPy": scipy.__version__}
    common.measure(answer, versions | {"Numba": numba.__version__})
