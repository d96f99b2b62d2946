"""Contact: two round bodies against Hertz, even pressure between meshes that do not match."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import scipy.sparse as sp

from ..hermite import HermiteMesh, Side, bricks
from ..hermite.basis import Array, IntArray
from ..mechanics import Load, Problem, Settings, SurfaceContact, solve
from ..mechanics.facing import Patches, segments
from .case import Check
from .meshes import side

#: c10 of the bodies in kPa; the shear modulus is twice that.
STIFFNESS = 5.0
#: Radius of the round body (mm).
RADIUS = 100.0


def blocks(below: Sequence[Array], above: Sequence[Array]) -> tuple[HermiteMesh, Side, Side]:
    """Return two blocks of given ticks as one mesh, with the sides that touch at z = 0."""
    parts = [bricks(ticks) for ticks in (below, above)]
    extraction = sp.csr_matrix(sp.block_diag([part.extraction for part in parts]))
    mesh = HermiteMesh(3, np.concatenate([part.parameters for part in parts]), extraction)
    top = side(parts[0], 2, 0.0)
    bottom = side(parts[1], 2, 0.0) + parts[0].n_elements
    return mesh, (bottom, 2, 0), (top, 2, 1)


def held(mesh: HermiteMesh, axis: int, place: float) -> IntArray:
    """Return the parameters that hold the sides at a place of an axis in its direction."""
    values = mesh.parameters[::8, axis]
    nodes = 8 * np.flatnonzero(np.abs(values - place) < 1e-9)
    # Value and the derivatives along the side.
    kinds = [kind for kind in range(8) if not (kind >> axis) & 1]
    return np.asarray((nodes[:, None] + np.array(kinds)).ravel())


def even_pressure(fine: bool) -> list[Check]:
    """Press two blocks whose meshes do not match: everything stays even.

    Both are free to spread, so that the pressure is uniaxial; its value is that of the closed
    form of an incompressible cube, ``2 c10 (λ - λ⁻²)`` by the area at rest.
    """
    tall, press = 6.0, 0.6
    mesh, upper, lower = blocks(
        [np.linspace(0.0, 20.0, 3), np.linspace(0.0, 16.0, 4), np.array([-tall, 0.0])],
        [np.linspace(0.0, 20.0, 4), np.linspace(0.0, 16.0, 3), np.array([0.0, tall])],
    )
    points = segments(Patches.of(mesh, upper), Patches.of(mesh, lower))
    contact = SurfaceContact(mesh, upper, lower, stiffness=200.0, points=points)
    fixed = np.zeros((mesh.n_params, 3), dtype=bool)
    for axis, place in ((0, 0.0), (1, 0.0), (2, -tall), (2, tall)):
        fixed[held(mesh, axis, place), axis] = True
    prescribed = np.zeros(mesh.parameters.shape)
    prescribed[held(mesh, 2, tall)[::4], 2] = -press
    problem = Problem(mesh, [STIFFNESS, 0.0, 0.0], terms=[contact], fixed=fixed)
    settings = Settings(tolerance=1e-11, first_step=0.5, near=1.0)
    state = solve(problem, Load(prescribed=prescribed), settings=settings)
    _, pressure = contact.pressure(state.parameters, state.load)
    gradient = state.deformation_gradient(*Problem.gauss_points(mesh))
    stretch = gradient[:, 2, 2].mean()
    # The pressure is given by the area at rest.
    expected = 2.0 * STIFFNESS * (stretch**-2 - stretch)
    return [
        Check("mean pressure in kPa", expected, float(pressure.mean()), 1e-6, True),
        Check("spread of the pressure", 0.0, float(np.ptp(pressure) / pressure.mean()), 1e-6),
        Check("spread of the strain", 0.0, float(np.ptp(gradient, axis=0).max()), 1e-6),
    ]


def hertz(fine: bool) -> list[Check]:
    """Press a round body onto a flat one of the same stiffness, in plane strain.

    With the force ``F`` by length and ``E* = 2 G`` for two incompressible bodies the pressure is
    ``p0 √(1 - x²/a²)``, ``a² = 4 F R / (π E*)``, ``p0 = 2 F / (π a)`` (Johnson 1985, chapter 4).
    """
    checks = []
    errors = []
    for splits in (1, 2, 4) if fine else (1, 2):
        positions, pressure, force = _pressed(splits)
        modulus = 4.0 * STIFFNESS
        width = np.sqrt(4.0 * force * RADIUS / (np.pi * modulus))
        peak = 2.0 * force / (np.pi * width)
        theory = peak * np.sqrt(np.maximum(1.0 - (positions / width) ** 2, 0.0))
        near = positions < 1.5 * width
        errors.append(float(np.sqrt(np.mean((pressure - theory)[near] ** 2)) / peak))
        if splits == 2:
            middle = np.argsort(positions)[:8]
            checks.append(
                Check(
                    "pressure in the middle by p0",
                    1.0,
                    float((pressure[middle] / theory[middle]).mean()),
                    0.01,
                )
            )
    checks.append(Check("pressure, rms error by p0", 0.0, errors[-1], 0.035))
    checks.append(
        Check(
            "that error on the coarsest by the finest mesh",
            3.0,
            errors[0] / errors[-1],
            0.0,
            at_least=True,
        )
    )
    return checks


def _pressed(splits: int) -> tuple[Array, Array, float]:
    """Return places (mm), pressures (kPa) and the force by length (kPa mm) of `hertz`."""
    far = 20.0
    wide = np.array([0.0, 0.5, 1.0, 1.5, 2.25, 4.0, 8.0, far])
    deep = np.array([0.0, 0.5, 1.25, 3.0, 8.0, far])
    wide, deep = _split(wide, splits), _split(deep, splits)
    across = np.array([0.0, 1.0])
    # The upper mesh is shifted by half an element: it does not match.
    upper_wide = np.concatenate([[0.0], 0.5 * (wide[1:-1] + wide[2:]), [far]])
    mesh, upper, lower = blocks([wide, across, -deep[::-1]], [upper_wide, across, deep])
    parameters = mesh.parameters.copy()
    rows = parameters.reshape(-1, 8, 3)
    above = np.arange(len(rows)) >= len(wide) * 2 * len(deep)
    x, z = rows[above, 0, 0], rows[above, 0, 2]
    # z + x²/2R (1 - z/far): the round side below, the plane one on top.
    fade, slope = 1.0 - z / far, x / RADIUS
    bulge = x**2 / (2.0 * RADIUS)
    along, up = rows[above, 1, 0].copy(), rows[above, 4, 2].copy()
    rows[above, 0, 2] = z + bulge * fade
    rows[above, 1, 2] = slope * fade * along
    rows[above, 4, 2] = up * (1.0 - bulge / far)
    rows[above, 5, 2] = -slope / far * along * up
    fixed = np.zeros((mesh.n_params, 3), dtype=bool)
    fixed[:, 1] = True
    for axis, place in ((0, 0.0), (2, -far), (2, far)):
        fixed[held(mesh, axis, place), axis] = True
    # Approach of about a²/R (ln(2 far / a) + ...); the force is measured, not prescribed.
    prescribed = np.zeros(mesh.parameters.shape)
    prescribed[held(mesh, 2, far)[::4], 2] = -0.04
    bent = mesh.with_parameters(rows.reshape(-1, 3))
    contact = SurfaceContact(bent, upper, lower, stiffness=2000.0, onset=1e-5)
    problem = Problem(bent, [STIFFNESS, 0.0, 0.0], terms=[contact], fixed=fixed)
    settings = Settings(tolerance=1e-8, first_step=0.25, near=1.0)
    state = solve(problem, Load(prescribed=prescribed), settings=settings)
    places, pressure = contact.pressure(state.parameters, state.load)
    # One half of it is there.
    return places[:, 0], pressure, 2.0 * float(pressure @ contact.areas)


def _split(ticks: Array, n: int) -> Array:
    parts = [np.linspace(a, b, n, endpoint=False) for a, b in pairwise(ticks)]
    return np.concatenate([*parts, ticks[-1:]])
