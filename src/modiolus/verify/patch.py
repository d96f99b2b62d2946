"""Patch tests: whatever the elements look like, an even deformation is reproduced.

The elements are bent at random and their extraction operators have scale factors, turned and
reversed directions, versions and a collapsed edge. Five Gauss points a direction integrate
them exactly: the cofactor of the Jacobian of a tricubic map times the gradient of a tricubic
function is a polynomial of degree nine.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp

from ..hermite import HermiteMesh, gauss
from ..hermite.basis import Array, IntArray
from ..mechanics import DeadForces, Load, Problem, Settings, clamp, solve
from .case import Check
from .land import Ventricle
from .meshes import box, scaled, side

#: Elements and the side of them, as in `clamp`.
Face = tuple[IntArray, int, int]

#: An even deformation without change of volume: stretched, sheared and turned.
DEFORMATION = (
    np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    @ np.diag([1.2, 0.9, 1.0 / 1.08])
    @ np.array([[1.0, 0.2, -0.1], [0.0, 1.0, 0.15], [0.0, 0.0, 1.0]])
)
COEFFICIENTS = (2.0, 1.0, 0.3)
PRESSURE = 1.5


def piola(f: Array, mean: Array) -> Array:
    """Return the first Piola stress in kPa of `Law.ISOCHORIC`, from its Kirchhoff stress.

    ``J σ = dev(2 W_1 B̄ + 2 W_2 (Ī1 B̄ - B̄²)) + m I``.

    Parameters
    ----------
    f : (n, 3, 3) array
        Deformation gradients.
    mean : (n,) array
        The mean ``m`` of the stress, which the law for the volume gives; the pressure where
        ``J = 1``.
    """
    c10, c01, c20 = COEFFICIENTS
    bar = f @ np.swapaxes(f, 1, 2) * np.linalg.det(f)[:, None, None] ** (-2.0 / 3.0)
    first = np.trace(bar, axis1=1, axis2=2)[:, None, None]
    kirchhoff = 2.0 * (c10 + 2.0 * c20 * (first - 3.0)) * bar
    kirchhoff = kirchhoff + 2.0 * c01 * (first * bar - bar @ bar)
    excess = mean - np.trace(kirchhoff, axis1=1, axis2=2) / 3.0
    kirchhoff = kirchhoff + excess[:, None, None] * np.eye(3)
    return np.asarray(kirchhoff @ np.swapaxes(np.linalg.inv(f), 1, 2))


def tractions(mesh: HermiteMesh, face: Face, stress: Array) -> DeadForces:
    """Return the forces ``P N dA`` of an even stress on a face."""
    elements, axis, at = face
    plane, weights = gauss(2, 5)
    hosts = np.repeat(elements, len(weights))
    xi = np.tile(np.insert(plane, axis, float(at), axis=1), (len(elements), 1))
    tangents = mesh.jacobian(hosts, xi)
    normals = np.cross(tangents[:, :, (axis + 1) % 3], tangents[:, :, (axis + 2) % 3])
    forces = (2 * at - 1) * np.tile(weights, len(elements))[:, None] * normals @ stress.T
    return DeadForces(mesh, hosts, xi, forces, "traction")


def patch(mesh: HermiteMesh, held: Sequence[Face], free: Face) -> float:
    """Deform a mesh evenly; return the greatest error of its parameters, relative to its size.

    Parameters
    ----------
    mesh : HermiteMesh
    held : sequence of faces
        Where the displacement is prescribed.
    free : face
        Where the tractions are; all other sides must be held or touch nothing.
    """
    fixed = np.zeros((mesh.n_params, 3), dtype=bool)
    for face in held:
        fixed |= clamp(mesh, *face)
    even = mesh.parameters @ (DEFORMATION - np.eye(3)).T
    stress = piola(DEFORMATION[None], np.array([PRESSURE]))[0]
    problem = Problem(
        mesh,
        COEFFICIENTS,
        gauss_order=5,
        terms=[tractions(mesh, free, stress)],
        fixed=fixed,
    )
    load = Load(prescribed=np.where(fixed, even, 0.0), forces={"traction": 1.0})
    state = solve(problem, load, settings=Settings(tolerance=1e-11, first_step=0.2))
    wrong = np.abs(state.displacement - even).max() / np.ptp(mesh.parameters, axis=0).max()
    return float(max(wrong, np.abs(state.pressure - PRESSURE).max() / PRESSURE))


def bent() -> HermiteMesh:
    """Return eight uneven elements, all of whose parameters have been moved at random."""
    mesh = box((20.0, 16.0, 12.0), (2, 2, 2))
    noise = np.random.default_rng(2).uniform(-1.2, 1.2, mesh.parameters.shape)
    return mesh.with_parameters(mesh.parameters + noise)


def turned(
    mesh: HermiteMesh, element: int, axes: Sequence[int], reversed_: Sequence[bool]
) -> HermiteMesh:
    """Turn the directions of one element; its shape stays.

    Parameters
    ----------
    mesh : HermiteMesh
    element : int
    axes : (3,) sequence of int
        Old direction of each new one.
    reversed_ : (3,) sequence of bool
        Whether the new direction runs the other way.
    """
    extraction = mesh.extraction.tolil(copy=True)
    for corner, kind in np.ndindex(8, 8):
        old_corner = sum((corner >> a & 1 ^ reversed_[a]) << axes[a] for a in range(3))
        old_kind = sum((kind >> a & 1) << axes[a] for a in range(3))
        sign = np.prod([-1.0 if kind >> a & 1 and reversed_[a] else 1.0 for a in range(3)])
        extraction[element * 64 + corner * 8 + kind] = (
            sign * mesh.extraction[element * 64 + old_corner * 8 + old_kind]
        )
    return HermiteMesh(3, mesh.parameters, sp.csr_matrix(extraction))


def split(mesh: HermiteMesh, elements: IntArray, axis: int, at: int) -> HermiteMesh:
    """Give the derivatives across a face versions of their own in some elements.

    The field may then have a kink at the face, and the geometry gets one.
    """
    extraction = mesh.extraction.tolil(copy=True)
    rows = [
        element * 64 + corner * 8 + kind
        for element in elements
        for corner in range(8)
        if corner >> axis & 1 == at
        for kind in range(8)
        if kind >> axis & 1
    ]
    columns = np.unique([extraction.rows[row][0] for row in rows])
    n = mesh.n_params
    extraction.resize((extraction.shape[0], n + len(columns)))
    for row in rows:
        column = extraction.rows[row][0]
        extraction[row, column] = 0.0
        extraction[row, n + int(np.searchsorted(columns, column))] = 1.0
    parameters = np.concatenate([mesh.parameters, 1.3 * mesh.parameters[columns]])
    return HermiteMesh(3, parameters, sp.csr_matrix(extraction))


def awkward() -> dict[str, tuple[HermiteMesh, list[Face], Face]]:
    """Return meshes by what is awkward about them, with their held and their free sides."""
    mesh = bent()
    straight = box((20.0, 16.0, 12.0), (2, 2, 2))
    held = [
        (side(straight, axis, place), axis, at)
        for axis, size in enumerate((20.0, 16.0, 12.0))
        for at, place in ((0, 0.0), (1, size))
        if (axis, at) != (2, 1)
    ]
    free = (side(straight, 2, 12.0), 2, 1)
    rng = np.random.default_rng(3)
    factors = rng.uniform(0.2, 5.0, mesh.n_params)
    # Values keep theirs: only derivatives have scale factors.
    factors[::8] = 1.0
    # Element 0 lies at the low ends of all three directions.
    turn = turned(mesh, 0, (1, 2, 0), (False, True, True))
    elements = np.arange(8)

    def without_first(face: Face) -> list[Face]:
        """Replace the first element of a side by the side of it that is there now."""
        hosts, axis, at = face
        if 0 not in hosts:
            return [face]
        new = (1, 2, 0).index(axis)
        return [
            (hosts[hosts != 0], axis, at),
            (np.array([0]), new, at ^ int((False, True, True)[new])),
        ]

    ventricle = Ventricle.build((2, 1, 4))
    return {
        "bent elements": (mesh, held, free),
        "scale factors": (scaled(mesh, factors), held, free),
        "turned and reversed directions": (
            turn,
            [part for face in held for part in without_first(face)],
            free,
        ),
        "versions": (split(mesh, elements[elements & 1 == 1], 0, 0), held, free),
        "collapsed edge": (
            ventricle.mesh,
            [(ventricle.elements(0, True), 0, 1), (ventricle.elements(1, True), 1, 1)],
            (ventricle.elements(1, False), 1, 0),
        ),
    }


def patches(fine: bool) -> list[Check]:
    """Run the patch test on every awkward mesh."""
    return [
        Check(f"{name}: greatest relative error", 0.0, patch(*parts), 1e-8)
        for name, parts in awkward().items()
    ]
