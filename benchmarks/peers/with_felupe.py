"""FElupe: quadratic hexahedra with a linear continuous pressure, PARDISO.

The material is written with its derivatives: automatic ones take longer.
"""

from __future__ import annotations

import common
import felupe as fem
import numpy as np
import pypardiso
import scipy


class Tissue:
    """The energy of a case with its pressure, for the fields of displacement and pressure."""

    def __init__(self, case: str, active: np.ndarray) -> None:
        self.case, self.active, self.kappa = case, active, common.KAPPA[case]
        self.factor = 0.0
        self.x = [np.eye(3), np.ones(1), np.zeros(0)]

    def _pressure(self, f: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, ...]:
        cof = common.cofactor(f)
        excess = (f[0] * cof[0]).sum(axis=0) - 1.0
        return cof, excess, p[0] + self.kappa * excess

    def gradient(self, x: list[np.ndarray]) -> list[np.ndarray]:
        f, p, state = x
        cof, excess, whole = self._pressure(f, p)
        stress = common.first_piola(self.case, f, self.factor * self.active) + whole * cof
        return [stress, excess[None], state]

    def hessian(self, x: list[np.ndarray]) -> list[np.ndarray | None]:
        f, p, _ = x
        cof, _, whole = self._pressure(f, p)
        a = common.stiffness(
            self.case, f, self.factor * self.active
        ) + whole * common.cofactor_slope(f)
        a += self.kappa * np.einsum("ij...,kl...->ijkl...", cof, cof)
        return [a, cof, None]


def solve(case: str, mesh: common.Mesh) -> common.Answer:
    """Solve a case."""
    size = common.CASES[case].size
    places = common.ticks(case, *mesh)
    # Cells are bricks of equal size first: the midpoints that are added follow the corners.
    corners = fem.Cube(n=tuple(len(t) for t in places))
    for axis, place in enumerate(places):
        even = np.linspace(0.0, 1.0, len(place))
        corners.points[:, axis] = np.interp(corners.points[:, axis], even, place)
    grid = corners.add_midpoints_edges().add_midpoints_faces().add_midpoints_volumes()
    region = fem.RegionTriQuadraticHexahedron(grid)
    field = fem.FieldsMixed(
        region,
        n=2,
        disconnect=False,
        npoints=corners.npoints,
        values=(0.0, common.PRESSURE_AT_REST[case]),
    )
    middle = grid.points[grid.cells].mean(axis=1)[:, 2]
    tissue = Tissue(case, common.TENSION * (middle < 0.5 * size[2])[None, :])
    body = fem.SolidBody(tissue, field)
    items = [body]
    if case == "land":
        below = fem.RegionTriQuadraticHexahedronBoundary(grid, mask=grid.points[:, 2] == 0.0)
        surface = fem.FieldContainer([fem.Field(below, dim=3)])
        pressure = fem.SolidBodyPressure(surface)
        items.append(pressure)
    held = {"clamp": fem.Boundary(field[0], fx=0.0)}
    dof0, dof1 = fem.dof.partition(field, held)
    ext0 = fem.dof.apply(field, held, dof0)
    solver = pypardiso.PyPardisoSolver()

    def accept(dx, x, f, xtol, ftol, dof1=None, dof0=None, items=None):
        largest = np.abs(dx).max()
        return largest, float(np.abs(f).max()), largest < common.TOLERANCE

    def settle(factor: float, guess: np.ndarray) -> tuple[np.ndarray, int]:
        tissue.factor = factor
        if case == "land":
            pressure.update(factor * common.PRESSURE)
        n = field[0].values.size
        field[0].values[:] = guess[:n].reshape(-1, 3)
        field[1].values[:] = guess[n:, None]
        try:
            result = fem.newtonraphson(
                field,
                items=items,
                dof0=dof0,
                dof1=dof1,
                ext0=ext0,
                solver=solver.solve,
                check=accept,
                maxiter=common.MOST_ITERATIONS,
                verbose=0,
                kwargs={"parallel": True},
            )
        except fem.tools._newton.NewtonConvergenceError as error:
            raise common.DivergedError from error
        return np.concatenate([part.values.ravel() for part in result.x.fields]), result.iterations

    start = np.concatenate([part.values.ravel() for part in field.fields])
    x, iterations = common.climb(settle, start, common.STEP[case])
    solver.free_memory(everything=True)
    tip = np.abs(grid.points - common.CASES[case].tip).max(axis=1) < 1e-9
    return common.Answer(
        grid.ncells, len(dof1), iterations, float(x[: 3 * grid.npoints].reshape(-1, 3)[tip, 2][0])
    )


if __name__ == "__main__":
    common.measure(solve, {"FElupe": fem.__version__, "SciPy": scipy.__version__})
