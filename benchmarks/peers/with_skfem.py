"""scikit-fem: quadratic hexahedra with a linear continuous pressure, PARDISO.

Element matrices are products of the arrays of the basis. Its forms, which are called for every
pair of functions, took about eight times as long on these small meshes.
"""

from __future__ import annotations

import common
import numpy as np
import pypardiso
import scipy
import scipy.sparse as sp
import skfem


class Shapes:
    """Functions of a basis on all elements e: values (e, q, a), slopes (e, q, 3, a)."""

    def __init__(self, basis: skfem.AbstractBasis) -> None:
        first = [pair[0] for pair in basis.basis]
        shape = basis.dx.shape
        self.values = np.stack([np.broadcast_to(f.value, shape) for f in first], axis=-1)
        self.slopes = np.stack([np.moveaxis(f.grad, 0, -1) for f in first], axis=-1)
        self.dx = basis.dx
        self.dofs = basis.element_dofs.T


def at_points(value: np.ndarray, axes: int) -> np.ndarray:
    """Move the axes of elements and points to the front."""
    return np.ascontiguousarray(np.moveaxis(value, (axes, axes + 1), (0, 1)))


def solve(case: str, mesh: common.Mesh) -> common.Answer:
    """Solve a case."""
    size = common.CASES[case].size
    grid = skfem.MeshHex.init_tensor(*common.ticks(case, *mesh))
    body = skfem.Basis(grid, skfem.ElementHex2(), intorder=4)
    pressure_basis = body.with_element(skfem.ElementHex1())
    n, n_pressure = body.N, pressure_basis.N
    where = body.global_coordinates()
    active = common.TENSION * (np.asarray(where)[2] < 0.5 * size[2])
    if case == "land":
        below = skfem.FacetBasis(
            grid,
            skfem.ElementHex2(),
            facets=grid.facets_satisfying(lambda x: x[2] == 0.0),
            intorder=4,
        )
        under = Shapes(below)
    clamped = body.get_dofs(grid.facets_satisfying(lambda x: x[0] == 0.0)).all()
    held = np.concatenate([clamped + k * n for k in range(3)])
    free = np.setdiff1d(np.arange(3 * n + n_pressure), held)
    start = np.zeros(3 * n + n_pressure)
    start[3 * n :] = common.PRESSURE_AT_REST[case]
    solver = pypardiso.PyPardisoSolver()

    inside, scalars = Shapes(body), Shapes(pressure_basis)
    e, q = body.dx.shape
    weighted = (inside.slopes * inside.dx[..., None, None]).reshape(e, 3 * q, -1)
    dofs = np.concatenate([inside.dofs + k * n for k in range(3)], axis=1)
    pressures = scalars.dofs + 3 * n

    def gradient(shapes: Shapes, x: np.ndarray) -> np.ndarray:
        local = x[: 3 * n].reshape(3, n)[:, shapes.dofs]
        slopes = np.einsum("eqja,iea->ijeq", shapes.slopes, local, optimize=True)
        return slopes + np.eye(3)[:, :, None, None]

    def system(x: np.ndarray, factor: float) -> tuple[sp.csr_matrix, np.ndarray]:
        f = gradient(inside, x)
        p = np.einsum("eqc,ec->eq", scalars.values, x[pressures])
        cof, tension = common.cofactor(f), factor * active
        excess = (f[0] * cof[0]).sum(axis=0) - 1.0
        whole = p + common.KAPPA[case] * excess
        stress = common.first_piola(case, f, tension) + whole * cof
        a = common.stiffness(case, f, tension) + whole * common.cofactor_slope(f)
        if common.KAPPA[case]:
            a += common.KAPPA[case] * np.einsum("ij...,kl...->ijkl...", cof, cof)

        flux = at_points(a, 4).reshape(e, q, 27, 3) @ inside.slopes
        flux = flux.reshape(e, q, 3, 3, 3, 27).transpose(0, 1, 3, 2, 4, 5).reshape(e, 3 * q, -1)
        square = (weighted.transpose(0, 2, 1) @ flux).reshape(e, 27, 3, 3, 27)
        square = square.transpose(0, 2, 1, 3, 4).reshape(e, 81, 81)
        pull = at_points(cof, 2) @ weighted.reshape(e, q, 3, 27)
        mixed = pull.reshape(e, q, 81).transpose(0, 2, 1) @ scalars.values
        push = (at_points(stress, 2) @ weighted.reshape(e, q, 3, 27)).sum(axis=1)
        volume = np.einsum("eqc,eq->ec", scalars.values, excess * inside.dx)
        parts = [
            (square, dofs, dofs),
            (mixed, dofs, pressures),
            (mixed.transpose(0, 2, 1), pressures, dofs),
        ]
        right = np.bincount(dofs.ravel(), push.ravel(), len(x))
        right += np.bincount(pressures.ravel(), volume.ravel(), len(x))
        if case == "land":
            f = gradient(under, x)
            area = -factor * common.PRESSURE * at_points(common.cofactor(f)[:, 2], 1)
            slope = -factor * common.PRESSURE * at_points(common.cofactor_slope(f)[:, 2], 3)
            values = under.values * under.dx[..., None]
            press = np.einsum("eqa,eqi->eia", values, area)
            square = np.einsum("eqa,eqikm,eqmb->eiakb", values, slope, under.slopes, optimize=True)
            pressed = np.concatenate([under.dofs + k * n for k in range(3)], axis=1)
            parts.append((square, pressed, pressed))
            right += np.bincount(pressed.ravel(), press.ravel(), len(x))
        entries = [
            [
                value.ravel()
                for value in np.broadcast_arrays(v.reshape(*r.shape, -1), r[:, :, None], c[:, None])
            ]
            for v, r, c in parts
        ]
        values, rows, columns = (np.concatenate(part) for part in zip(*entries, strict=True))
        return sp.csr_matrix((values, (rows, columns)), shape=(len(x), len(x))), right

    def settle(factor: float, guess: np.ndarray) -> tuple[np.ndarray, int]:
        x = guess.copy()
        for iteration in range(common.MOST_ITERATIONS):
            matrix, right = system(x, factor)
            change = solver.solve(matrix[free][:, free], right[free])
            x[free] -= change
            largest = np.abs(change).max()
            if largest < common.TOLERANCE:
                return x, iteration + 1
            if not largest < common.ASTRAY:
                break
        raise common.DivergedError

    x, iterations = common.climb(settle, start, common.STEP[case])
    solver.free_memory(everything=True)
    tip = body.probes(np.array(common.CASES[case].tip)[:, None]) @ x[2 * n : 3 * n]
    return common.Answer(e, len(free), iterations, float(tip[0]))


if __name__ == "__main__":
    common.measure(solve, {"scikit-fem": skfem.__version__, "SciPy": scipy.__version__})
