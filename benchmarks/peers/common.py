"""What all programs solve, and how their work is timed; needs only NumPy."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Case:
    """An incompressible bar along x, clamped where x = 0, that bends.

    Attributes
    ----------
    size : (3,) tuple of float
        In mm.
    """

    size: tuple[float, float, float]

    @property
    def tip(self) -> tuple[float, float, float]:
        """The place whose displacement in z is compared: the middle of the end's upper edge."""
        return self.size[0], 0.5 * self.size[1], self.size[2]


CASES = {
    # Problem 1 of Land et al. (2015): Guccione's law, fibres along x, a pressure that follows
    # the lower face.
    "land": Case((10.0, 1.0, 1.0)),
    # A bar of fat, W = C10 (I1 - 3), the lower half of which is traversed by muscle fibres along
    # x with a constant second Piola stress: the energy TENSION/2 |F e_x|^2.
    "muscle": Case((10.0, 2.0, 2.0)),
}
C = 2.0
#: 8 along the fibre, 2 across, 4 between the two.
B = np.array([[8.0, 4.0, 4.0], [4.0, 2.0, 2.0], [4.0, 2.0, 2.0]])
PRESSURE = 0.004
C10 = 0.42
TENSION = 0.5
#: Of KAPPA/2 (J - 1)^2 beside the pressure, nothing where J = 1: without it Newton's method
#: fails on fine meshes in every program, at the edges of the clamp.
KAPPA = {"land": 0.0, "muscle": 2.0}
#: Pressure that balances the stress at rest of the energies as they are written here.
PRESSURE_AT_REST = {"land": 0.0, "muscle": -2.0 * C10}

#: First step of the load.
STEP = {"land": 0.5, "muscle": 0.25}
#: Of Newton's method in a step, before it is halved.
MOST_ITERATIONS = 12
#: Greatest correction of an unknown at which a step ends, and at which it is given up.
TOLERANCE, ASTRAY = 1e-6, 1e3

#: Elements along each axis, and the growth along x.
Mesh = tuple[tuple[int, int, int], float]


def ticks(case: str, counts: Sequence[int], growth: float) -> list[Array]:
    """Return where the planes between the elements lie along each axis.

    The last element along x is up to ``growth`` times as long as the first: the edges of the
    clamp are singular.
    """
    even = np.linspace(0.0, 1.0, counts[0] + 1)
    rate = np.log(growth)
    steps = np.expm1(rate * even) / np.expm1(rate) if rate else even
    size = CASES[case].size
    return [
        size[0] * steps,
        *(s * np.linspace(0.0, 1.0, n + 1) for s, n in zip(size[1:], counts[1:], strict=True)),
    ]


def first_piola(case: str, f: Array, tension: Array) -> Array:
    """Return the stress without the pressure of deformation gradients (3, 3, ...)."""
    if case == "muscle":
        stress = 2.0 * C10 * f
        stress[:, 0] += tension * f[:, 0]
        return stress
    strain, b, scale = _strain(f)
    return np.einsum("ik...,kj...->ij...", f, scale * b * strain)


def stiffness(case: str, f: Array, tension: Array) -> Array:
    """Return the derivative (i, J, k, L, ...) of `first_piola` by the gradients."""
    out = np.zeros((3, 3, 3, 3, *f.shape[2:]))
    if case == "muscle":
        for i in range(3):
            for j in range(3):
                out[i, j, i, j] = 2.0 * C10
            out[i, 0, i, 0] += tension
        return out
    strain, b, scale = _strain(f)
    weighted = b * strain
    first = np.einsum("ik...,kj...->ij...", f, weighted)
    out = 2.0 * np.einsum("ij...,kl...->ijkl...", first, first)
    for i in range(3):
        for j in range(3):
            for k in range(3):
                for m in range(3):
                    out[i, j, k, m] += 0.5 * B[j, m] * f[i, m] * f[k, j]
                out[i, j, k, j] += 0.5 * (
                    B[j, 0] * f[i, 0] * f[k, 0]
                    + B[j, 1] * f[i, 1] * f[k, 1]
                    + B[j, 2] * f[i, 2] * f[k, 2]
                )
            for m in range(3):
                out[i, j, i, m] += weighted[j, m]
    return scale * out


def _strain(f: Array) -> tuple[Array, Array, Array]:
    strain = 0.5 * np.einsum("ki...,kj...->ij...", f, f)
    for i in range(3):
        strain[i, i] -= 0.5
    b = B.reshape(3, 3, *[1] * (f.ndim - 2))
    return strain, b, C * np.exp((b * strain**2).sum(axis=(0, 1)))


def cofactor(f: Array) -> Array:
    """Return the derivative of the determinant by gradients (3, 3, ...)."""
    return np.stack([np.cross(f[(i + 1) % 3], f[(i + 2) % 3], axis=0) for i in range(3)])


def cofactor_slope(f: Array) -> Array:
    """Return the derivative (i, J, k, L, ...) of `cofactor`."""
    out = np.zeros((3, 3, 3, 3, *f.shape[2:]))
    for i in range(3):
        for j in range(3):
            for a, k, m in ((1, (i + 1) % 3, (i + 2) % 3), (-1, (i + 2) % 3, (i + 1) % 3)):
                out[i, j, k, (j + 1) % 3] += a * f[m, (j + 2) % 3]
                out[i, j, k, (j + 2) % 3] -= a * f[m, (j + 1) % 3]
    return out


@dataclass(frozen=True)
class Answer:
    """What one solution gave.

    Attributes
    ----------
    cells : int
        Elements.
    unknowns : int
        Free displacements, and pressures.
    iterations : int
        Of Newton's method, all load steps together.
    tip : float
        Displacement in mm.
    """

    cells: int
    unknowns: int
    iterations: int
    tip: float


class DivergedError(Exception):
    """Newton's method went astray."""


def climb(
    settle: Callable[[float, Array], tuple[Array, int]], state: Array, step: float
) -> tuple[Array, int]:
    """Raise the load from 0 to 1 in steps; return the last state and all iterations.

    Every step begins on the straight line through the last two states; one that fails is halved.

    Parameters
    ----------
    settle : callable
        Takes a fraction of the load and a guess; returns the equilibrium and its iterations, or
        raises `DivergedError`.
    state : (n,) array
        At rest.
    step : float
        The first.
    """
    slope, reached, iterations = np.zeros_like(state), 0.0, 0
    while reached < 1.0 - 1e-9:
        step = min(step, 1.0 - reached)
        try:
            found, more = settle(reached + step, state + step * slope)
        except DivergedError:
            if step < 1e-3:
                raise
            step *= 0.5
            iterations += MOST_ITERATIONS
            continue
        iterations += more
        slope, state, reached = (found - state) / step, found, reached + step
    return state, iterations


#: Displacement of the tip on fine meshes: 3.1646 mm on 24 x 3 x 3 quadratic elements and 3.167 on
#: 20 x 4 x 4 tricubic ones, both still growing; -4.6655 on 16 x 3 x 4 quadratic elements.
CONVERGED = {"land": 3.168, "muscle": -4.667}

#: Every program solves on all of these, so that each can show the mesh that suits it best.
MESHES: dict[str, list[Mesh]] = {
    "land": [((n, 1, 1), g) for g in (5.0, 10.0) for n in (3, 4, 5, 6)] + [((8, 2, 2), 10.0)],
    "muscle": [((n, 1, 2), 5.0) for n in (2, 3, 4, 5, 6)] + [((8, 2, 2), 5.0)],
}


def measure(
    solve: Callable[[str, Mesh], Answer], versions: dict[str, str], speak: bool = True
) -> None:
    """Solve a case on every mesh and print one JSON object a line.

    What is compiled or read only once is left out: the first mesh is solved once before. The
    best of three times counts.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("case", choices=CASES)
    case = parser.parse_args().case
    solve(case, MESHES[case][0])
    for mesh in MESHES[case]:
        record: dict[str, object] = {"mesh": mesh[0], "growth": mesh[1], "versions": versions}
        seconds, processor = [], []
        try:
            for _ in range(3):
                began, busy = time.perf_counter(), time.process_time()
                answer = solve(case, mesh)
                seconds.append(time.perf_counter() - began)
                processor.append(time.process_time() - busy)
            record |= asdict(answer) | {"seconds": min(seconds), "processor": min(processor)}
        except DivergedError:
            record |= {"tip": None}
        if speak:
            print(json.dumps(record), flush=True)
