"""DOLFINx: quadratic hexahedra with a linear continuous pressure, compiled forms, MUMPS.

Runs as it is, or on several processes under ``mpirun``.
"""

from __future__ import annotations

import common
import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

#: Of the polynomials that are integrated exactly.
DEGREE = 4


def solve(case: str, mesh: common.Mesh) -> common.Answer:
    """Solve a case."""
    counts, growth = mesh
    size = common.CASES[case].size
    domain = dolfinx.mesh.create_box(
        MPI.COMM_WORLD, [np.zeros(3), np.array(size)], counts, dolfinx.mesh.CellType.hexahedron
    )
    x = domain.geometry.x
    x[:, 0] = np.interp(
        x[:, 0], np.linspace(0.0, size[0], counts[0] + 1), common.ticks(case, counts, growth)[0]
    )
    element = ufl.MixedElement(
        ufl.VectorElement("Lagrange", domain.ufl_cell(), 2),
        ufl.FiniteElement("Lagrange", domain.ufl_cell(), 1),
    )
    space = fem.FunctionSpace(domain, element)
    unknown = fem.Function(space)
    u, p = ufl.split(unknown)
    load = fem.Constant(domain, PETSc.ScalarType(0.0))
    f = ufl.Identity(3) + ufl.grad(u)
    j = ufl.det(f)
    dx = ufl.dx(metadata={"quadrature_degree": DEGREE})
    if case == "land":
        strain = 0.5 * (f.T * f - ufl.Identity(3))
        q = sum(common.B[a, b] * strain[a, b] ** 2 for a in range(3) for b in range(3))
        energy = 0.5 * common.C * (ufl.exp(q) - 1.0)
    else:
        low = fem.Function(fem.FunctionSpace(domain, ("DG", 0)))
        low.interpolate(lambda x: (x[2] < 0.5 * size[2]).astype(float))
        energy = common.C10 * ufl.inner(f, f) + 0.5 * load * common.TENSION * low * ufl.dot(
            f[:, 0], f[:, 0]
        )
    energy += p * (j - 1.0) + 0.5 * common.KAPPA[case] * (j - 1.0) ** 2
    residual = ufl.derivative(energy * dx, unknown, ufl.TestFunction(space))
    if case == "land":
        facets = dolfinx.mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[2], 0.0))
        tags = dolfinx.mesh.meshtags(domain, 2, np.sort(facets), np.ones(len(facets), np.int32))
        ds = ufl.Measure("ds", domain, subdomain_data=tags, metadata={"quadrature_degree": DEGREE})
        v, _ = ufl.TestFunctions(space)
        normal = j * ufl.inv(f).T * ufl.FacetNormal(domain)
        residual += load * common.PRESSURE * ufl.inner(normal, v) * ds(1)
    tangent = fem.form(ufl.derivative(residual, unknown))
    residual = fem.form(residual)

    clamped = dolfinx.mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[0], 0.0))
    sub, _ = space.sub(0).collapse()
    dofs = fem.locate_dofs_topological((space.sub(0), sub), 2, clamped)
    held = fem.dirichletbc(fem.Function(sub), dofs, space.sub(0))
    pressures = space.sub(1).collapse()[1]
    unknown.x.array[pressures] = common.PRESSURE_AT_REST[case]

    a = fem.petsc.create_matrix(tangent)
    b = fem.petsc.create_vector(residual)
    step = b.duplicate()
    solver = PETSc.KSP().create(domain.comm)
    solver.setOperators(a)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    solver.getPC().setFactorSolverType("mumps")

    def settle(factor: float, guess: np.ndarray) -> tuple[np.ndarray, int]:
        load.value = factor
        unknown.x.array[:] = guess
        for iteration in range(common.MOST_ITERATIONS):
            with b.localForm() as local:
                local.set(0.0)
            fem.petsc.assemble_vector(b, residual)
            b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
            fem.petsc.set_bc(b, [held], x0=unknown.vector, scale=1.0)
            a.zeroEntries()
            fem.petsc.assemble_matrix(a, tangent, bcs=[held])
            a.assemble()
            solver.solve(b, step)
            unknown.vector.axpy(-1.0, step)
            unknown.x.scatter_forward()
            change = step.norm(PETSc.NormType.NORM_INFINITY)
            if change < common.TOLERANCE:
                return unknown.x.array.copy(), iteration + 1
            if not change < common.ASTRAY:
                break
        raise common.DivergedError

    _, iterations = common.climb(settle, unknown.x.array.copy(), common.STEP[case])
    n = space.dofmap.index_map.size_global * space.dofmap.index_map_bs
    clamped_dofs = domain.comm.allreduce(len(dofs[0]), MPI.SUM)
    for item in (a, b, step, solver):
        item.destroy()
    moved = unknown.sub(0).collapse()
    points = np.abs(sub.tabulate_dof_coordinates() - common.CASES[case].tip).max(axis=1) < 1e-9
    owned = sub.dofmap.index_map.size_local
    values = moved.x.array.reshape(-1, 3)[:owned][points[:owned], 2]
    tip = domain.comm.allreduce(float(values.sum()), MPI.SUM)
    return common.Answer(int(np.prod(counts)), n - clamped_dofs, iterations, tip)


if __name__ == "__main__":
    common.measure(solve, {"DOLFINx": dolfinx.__version__}, MPI.COMM_WORLD.rank == 0)
