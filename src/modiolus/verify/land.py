"""The three benchmark problems of Land et al. (2015) for the mechanics of the heart.

Guccione's law, exact incompressibility, a pressure that follows the surface and, in the third,
an active tension along fibres that turn through the wall.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ..hermite import HermiteMesh, bricks
from ..hermite.basis import Array, IntArray
from ..mechanics import (
    FollowerPressure,
    Formulation,
    Guccione,
    Law,
    Load,
    Problem,
    Settings,
    State,
    Tension,
    clamp,
    solve,
)
from .case import Check
from .meshes import side

FORMULATION = Formulation(Law.GUCCIONE)
SETTINGS = Settings(tolerance=1e-7, first_step=0.1)

#: Half axes of the ellipsoid in mm, at the endocardium and at the epicardium: short, long.
AXES = ((7.0, 17.0), (10.0, 20.0))
#: Height of its base in mm.
BASE = 5.0
#: Volumetric stiffness beside the pressure in kPa. Where fibres meet at the apex the stress has
#: no bound; with the 50 kPa of the face fine meshes are crushed there at full tension.
KAPPA = 200.0
#: How much smaller than the mean the elements at the apex and at the base are.
GRADING = 0.7


def beam_tip(counts: tuple[int, int, int]) -> float:
    """Bend the beam of problem 1; return the height of the end of its top line in mm."""
    # The elements grow by a factor of twenty away from the clamp, whose edges are singular.
    steps = np.expm1(3.0 * np.linspace(0.0, 1.0, counts[0] + 1)) / np.expm1(3.0)
    mesh = bricks([10.0 * steps, *(np.linspace(0.0, 1.0, n + 1) for n in counts[1:])])
    problem = Problem(
        mesh,
        Guccione(2.0, 8.0, 2.0, 4.0).array([1.0, 0.0, 0.0]),
        formulation=FORMULATION,
        terms=[FollowerPressure(mesh, side(mesh, 2, 0.0), 2, 0)],
        fixed=clamp(mesh, side(mesh, 0, 0.0), 0, 0),
    )
    state = solve(problem, Load(forces={"pressure": 0.004}), settings=SETTINGS)
    tip = mesh.locate([[10.0, 0.5, 1.0]])
    return float(state.mesh.evaluate(tip.elements, tip.xi)[0, 2])


def ellipsoid(along: float, through: float, azimuth: float, orders: tuple[int, int, int]) -> Array:
    """Return a derivative of the position in the wall, (3,).

    Parameters
    ----------
    along : float
        From the apex to the base, 0 to 1.
    through : float
        From the endocardium to the epicardium, 0 to 1.
    azimuth : float
        In radians.
    orders : (3,) tuple of int
        Order of differentiation by each, 0 or 1.
    """
    (short, long), (short_out, long_out) = AXES
    short_rate, long_rate = short_out - short, long_out - long
    short, long = short + through * short_rate, long + through * long_rate
    # The angle from the apex; the base is a plane, so its greatest value varies in the wall.
    wide = np.arccos(-BASE / long)
    wide_rate = -BASE * long_rate / (long**2 * np.sqrt(1.0 - (BASE / long) ** 2))
    sine, cosine = np.sin(along * wide), np.cos(along * wide)
    if orders[:2] == (0, 0):
        radius, height = short * sine, -long * cosine
    elif orders[:2] == (1, 0):
        radius, height = short * wide * cosine, long * wide * sine
    elif orders[:2] == (0, 1):
        radius = short_rate * sine + short * along * wide_rate * cosine
        height = -long_rate * cosine + long * along * wide_rate * sine
    else:
        turned = along * wide * wide_rate
        radius = short_rate * wide * cosine + short * (wide_rate * cosine - turned * sine)
        height = long_rate * wide * sine + long * (wide_rate * sine + turned * cosine)
    if orders[2]:
        return np.array([-radius * np.sin(azimuth), radius * np.cos(azimuth), 0.0])
    return np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), height])


def graded(even: Array) -> tuple[Array, Array]:
    """Return how far along the meridian even steps from the apex lead, and the derivative.

    Steps are short at the apex, where fibres meet, and at the base, whose edges are held.
    """
    angle = 2.0 * np.pi * even
    return even - GRADING * np.sin(angle) / (2.0 * np.pi), 1.0 - GRADING * np.cos(angle)


@dataclass(frozen=True)
class Ventricle:
    """The truncated ellipsoid of problems 2 and 3.

    Attributes
    ----------
    mesh : HermiteMesh
        ``xi1`` from the apex to the base, ``xi2`` from the endocardium to the epicardium,
        ``xi3`` around.
    counts : (3,) tuple of int
        Elements in these directions.
    """

    mesh: HermiteMesh
    counts: tuple[int, int, int]

    @classmethod
    def build(cls, counts: tuple[int, int, int]) -> Ventricle:
        """Interpolate the ellipsoid with its exact derivatives at the nodes.

        At the apex all elements of a ring share one node, whose derivative along the meridian
        at azimuth v is ``cos v a + sin v b`` with two parameters a and b: the field on the
        collapsed face is as smooth as elsewhere.
        """
        n = counts
        turn = 2.0 * np.pi / n[2]
        places, rates = graded(np.arange(n[0] + 1) / n[0])

        def nodal(i: int, j: int, azimuth: float, kind: int) -> Array:
            orders = (kind & 1, kind >> 1 & 1, kind >> 2 & 1)
            scale = np.prod(np.array([rates[i] / n[0], 1.0 / n[1], turn]) ** np.array(orders))
            return np.asarray(scale * ellipsoid(places[i], j / n[1], azimuth, orders))

        ring = [
            nodal(i, j, k * turn, kind)
            for k in range(n[2])
            for j in range(n[1] + 1)
            for i in range(1, n[0] + 1)
            for kind in range(8)
        ]
        # At an apex: value, a and b, then the same three of the derivative through the wall.
        apex = [
            nodal(0, j, angle, kind + 2 * wall)
            for j in range(n[1] + 1)
            for wall in (0, 1)
            for kind, angle in ((0, 0.0), (1, 0.0), (1, 0.5 * np.pi))
        ]

        def row(i: int, j: int, k: int, kind: int) -> dict[int, float]:
            """Return the parameters of one derivative at a node, with their factors."""
            if i:
                return {(((k % n[2]) * (n[1] + 1) + j) * n[0] + i - 1) * 8 + kind: 1.0}
            first = len(ring) + 6 * j + 3 * (kind >> 1 & 1)
            if kind & 5 == 0:
                return {first: 1.0}
            if kind & 5 == 4:
                return {}
            cosine, sine = np.cos(k * turn), np.sin(k * turn)
            if kind & 5 == 1:
                return {first + 1: cosine, first + 2: sine}
            return {first + 1: -turn * sine, first + 2: turn * cosine}

        rows = [
            row(i + (c & 1), j + (c >> 1 & 1), k + (c >> 2 & 1), kind)
            for k in range(n[2])
            for j in range(n[1])
            for i in range(n[0])
            for c in range(8)
            for kind in range(8)
        ]
        extraction = sp.csr_matrix(
            (
                [factor for entries in rows for factor in entries.values()],
                [column for entries in rows for column in entries],
                np.concatenate([[0], np.cumsum([len(entries) for entries in rows])]),
            ),
            shape=(len(rows), len(ring) + len(apex)),
        )
        return cls(HermiteMesh(3, np.array(ring + apex), extraction), n)

    def coordinates(self, elements: IntArray, xi: Array) -> Array:
        """Return `along`, `through` and `azimuth` of points, (n, 3), as in `ellipsoid`."""
        place = np.stack(np.unravel_index(elements, self.counts[::-1])[::-1], axis=1)
        even = (place + xi) / self.counts * [1.0, 1.0, 2.0 * np.pi]
        even[:, 0], _ = graded(even[:, 0])
        return np.asarray(even)

    def elements(self, axis: int, last: bool) -> IntArray:
        """Return the elements of the first or the last layer along an axis."""
        index = np.arange(self.mesh.n_elements).reshape(self.counts[::-1])
        layer: IntArray = np.take(index, -1 if last else 0, axis=2 - axis).ravel()
        return layer

    def apices(self, state: State) -> tuple[float, float]:
        """Return the heights of the endocardial and the epicardial apex in mm."""
        inner, outer = (
            state.mesh.evaluate([self.elements(1, last)[0]], [[0.0, float(last), 0.0]])[0, 2]
            for last in (False, True)
        )
        return float(inner), float(outer)

    def fibres(self, elements: IntArray, xi: Array) -> Array:
        """Return unit directions at points, from +90° inside to -90° outside, (n, 3).

        The angle is that to the parallel, towards the base.
        """
        coordinates = self.coordinates(elements, xi)
        meridian, parallel = (
            np.array([ellipsoid(a, t, v, orders) for a, t, v in coordinates.tolist()])
            for orders in ((1, 0, 0), (0, 0, 1))
        )
        angle = np.radians(90.0 - 180.0 * coordinates[:, 1:2])
        unit = [v / np.linalg.norm(v, axis=1, keepdims=True) for v in (meridian, parallel)]
        return np.asarray(unit[0] * np.sin(angle) + unit[1] * np.cos(angle))


def inflate(
    counts: tuple[int, int, int], material: Guccione, pressure: float, tension: float
) -> tuple[float, float]:
    """Inflate the ventricle, with contracting fibres; return the heights of both apices in mm."""
    ventricle = Ventricle.build(counts)
    mesh = ventricle.mesh
    rule = mesh.quadrature()
    fibres = ventricle.fibres(rule.elements, rule.xi)
    problem = Problem(
        mesh,
        material.array(fibres).reshape(mesh.n_elements, -1, 7),
        formulation=FORMULATION,
        terms=[
            FollowerPressure(mesh, ventricle.elements(1, False), 1, 0),
            Tension(mesh, rule.elements, rule.xi, rule.weights, fibres),
        ],
        kappa=KAPPA,
        fixed=clamp(mesh, ventricle.elements(0, True), 0, 1),
    )
    load = Load(forces={"pressure": pressure, "tension": tension})
    return ventricle.apices(solve(problem, load, settings=SETTINGS))


def last_change(values: Sequence[float]) -> float:
    """Return the change from the coarser to the finest mesh, relative."""
    return abs(values[-1] / values[-2] - 1.0)


def beam(fine: bool) -> list[Check]:
    """Problem 1: the participants of the benchmark lie within 4.0 to 4.2 mm."""
    meshes = [(6, 1, 1), (10, 2, 2)] + [(16, 3, 3), (20, 4, 4)] * fine
    tips = [beam_tip(counts) for counts in meshes]
    return [
        Check("height of the tip in mm", 4.1, tips[-1], 0.1),
        Check("change with the last refinement", 0.0, last_change(tips), 0.005),
    ]


def ventricle(
    fine: bool, material: Guccione, pressure: float, tension: float
) -> dict[str, tuple[float, float]]:
    """Return the heights of both apices and how much the last refinement changed them."""
    meshes = [(6, 2, 8), (8, 3, 8)] + [(12, 4, 8)] * fine
    heights = np.array([inflate(counts, material, pressure, tension) for counts in meshes])
    return {
        name: (float(column[-1]), last_change(column))
        for name, column in zip(("endocardial", "epicardial"), heights.T, strict=True)
    }


def apices(
    found: dict[str, tuple[float, float]],
    expected: dict[str, float],
    tolerance: float,
    settled: float,
) -> list[Check]:
    """Check what `ventricle` found: each apex, and that the last refinement hardly moved it."""
    checks = []
    for name, height in expected.items():
        got, change = found[name]
        checks += [
            Check(f"{name} apex in mm", height, got, tolerance, True),
            Check(f"{name} apex, change with the last refinement", 0.0, change, settled),
        ]
    return checks


def inflated(fine: bool) -> list[Check]:
    """Problem 2: within 3 % of the reference, which has 2 x 8 x 8 trilinear elements."""
    found = ventricle(fine, Guccione(10.0, 1.0, 1.0, 1.0), 10.0, 0.0)
    return apices(found, {"endocardial": -26.728, "epicardial": -28.536}, 0.03, 0.002)


def contracting(fine: bool) -> list[Check]:
    """Problem 3: pressure and tension raised together, against our own finest mesh."""
    found = ventricle(fine, Guccione(2.0, 8.0, 2.0, 4.0), 15.0, 60.0)
    return apices(found, {"endocardial": -12.35, "epicardial": -15.47}, 0.005, 0.01)
