"""Time the mechanics on a stand-in for a face: a curved shell with straps and a mouth.

Run with ``python benchmarks/assembly.py``. The shell has 240 elements one layer thick, a
slit that opens and closes, twenty straps at about a thousand points each and a sphere
behind it. Times are printed in milliseconds.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from modiolus import hermite
from modiolus.hermite import HermiteMesh
from modiolus.mechanics import (
    Continuation,
    FibreQuadrature,
    Fibres,
    PairContact,
    Problem,
    RigidContact,
    Springs,
    clamp,
    face_points,
    mix,
    symmetry_plane,
)
from modiolus.mechanics.laws import MUSCLE

COUNTS = (15, 16, 1)
SLIT_ROW, SLIT_END = 6, 3
INNER, OUTER = 70.0, 82.0
SPAN = (0.0, 1.8), (-1.2, 1.2)


class Sphere:
    """Signed distance of a sphere about the origin."""

    def __init__(self, radius: float) -> None:
        self.radius = radius

    def sample(self, points):
        """Return distance, gradient and Hessian."""
        length = np.linalg.norm(points, axis=1)
        normal = points / length[:, None]
        outer = normal[:, :, None] * normal[:, None, :]
        return length - self.radius, normal, (np.eye(3) - outer) / length[:, None, None]


def place(azimuth, elevation, radius):
    """Return Cartesian coordinates of shell coordinates."""
    return np.stack(
        [
            radius * np.cos(elevation) * np.sin(azimuth),
            -radius * np.cos(elevation) * np.cos(azimuth),
            radius * np.sin(elevation),
        ],
        axis=-1,
    )


def shell() -> HermiteMesh:
    """Return the shell with a slit from the mid-plane."""
    ticks = [np.linspace(*SPAN[k], COUNTS[k] + 1) for k in range(2)]
    grid = np.meshgrid(*ticks, [INNER, OUTER], indexing="ij")
    plain = hermite.grid(place(*grid))
    corners = hermite.grid_connectivity(COUNTS, (False, False, False))
    nodal = plain.parameters.reshape(-1, 8, 3)
    # Parallels are circles about the mid-plane's normal: exact symmetry there.
    column, row = np.arange(len(corners)) % COUNTS[0], np.arange(len(corners)) // COUNTS[0]
    copies = []
    for element in np.flatnonzero((row == SLIT_ROW) & (column < SLIT_END)):
        for corner in range(8):
            at = column[element] + (corner & 1)
            if not corner & 2 and at < SLIT_END:
                node = corners[element, corner]
                if node not in copies:
                    copies.append(node)
                corners[element, corner] = len(nodal) + copies.index(node)
    return hermite.assemble(corners, np.concatenate([nodal, nodal[copies]]))


def strap(mesh, start, end, index, width=0.12, depth=(71.0, 76.0), counts=(30, 6, 6)):
    """Return the quadrature of a strap between two places on the shell."""
    start, end = np.array(start), np.array(end)
    ticks = [(np.arange(n) + 0.5) / n for n in counts]
    t, s, r = (g.ravel() for g in np.meshgrid(*ticks, indexing="ij"))
    along = end - start
    across = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    angles = start + t[:, None] * along + (s[:, None] - 0.5) * width * across
    radius = depth[0] + r * (depth[1] - depth[0])
    points = place(angles[:, 0], angles[:, 1], radius)
    ahead = place(*(angles + 1e-4 * along).T, radius)
    directions = (ahead - points) / np.linalg.norm(ahead - points, axis=1, keepdims=True)
    cosine = np.cos(angles[:, 1])
    cell = np.linalg.norm(along) * width * (depth[1] - depth[0]) / np.prod(counts)
    where = mesh.locate(points)
    return FibreQuadrature(
        where.elements, where.xi, cell * radius**2 * cosine, directions, np.full(len(t), index)
    ).take(where.inside)


STRAPS = {
    "zygomaticus": ((1.3, 0.35), (0.42, -0.27)),
    "depressor": ((0.7, -0.9), (0.40, -0.33)),
    "levator": ((0.45, 0.5), (0.25, -0.22)),
    "risorius": ((1.3, -0.4), (0.42, -0.3)),
    "lower_lip": ((0.3, -0.9), (0.15, -0.4)),
}


def stand_in(straps: int = 20) -> Problem:
    """Return the whole problem."""
    mesh = shell()
    rng = np.random.default_rng(1)
    routes = dict(STRAPS)
    while len(routes) < straps:
        start = np.array([rng.uniform(0.3, 1.3), rng.uniform(-0.8, 0.8)])
        angle = rng.uniform(0.0, 2.0 * np.pi)
        end = start + 0.4 * np.array([np.cos(angle), np.sin(angle)])
        routes[f"extra_{len(routes)}"] = (tuple(start), tuple(end))
    parts = [strap(mesh, *route, k) for k, route in enumerate(routes.values())]
    quadrature = FibreQuadrature.concatenate(parts)
    column = np.arange(mesh.n_elements) % COUNTS[0]
    row = np.arange(mesh.n_elements) // COUNTS[0]
    middle, end = np.flatnonzero(column == 0), np.flatnonzero(column == COUNTS[0] - 1)
    fixed = symmetry_plane(mesh, middle, 0, 0)
    for held, axis, side in (
        (end, 0, 1),
        (np.flatnonzero(row == 0), 1, 0),
        (np.flatnonzero(row == COUNTS[1] - 1), 1, 1),
    ):
        fixed |= clamp(mesh, held, axis, side)
    _, xi = Problem.gauss_points(mesh)
    fraction = np.where((xi[:, 2] < 0.6), 0.5, 0.0).reshape(mesh.n_elements, -1)
    inner = face_points(mesh, np.arange(mesh.n_elements), 2, 0)
    anchors = [part.take(np.arange(len(part.weights)) < 0.12 * len(part.weights)) for part in parts]
    anchor = FibreQuadrature.concatenate(anchors)
    lips = np.flatnonzero((row == SLIT_ROW) & (column < SLIT_END))
    upper = face_points(mesh, lips, 1, 0)
    lower = (upper[0] - COUNTS[0], upper[1] * [1, 0, 1] + [0, 1, 0])
    away = column[inner[0]] > 6
    terms = [
        Fibres(mesh, quadrature, list(routes)),
        Springs(mesh, anchor.elements, anchor.xi, 2e4 * straps / len(anchor.weights), "anchors"),
        RigidContact(mesh, Sphere(69.5), *inner, slide=0.1 * away, name="sphere"),
        PairContact(mesh, upper[:2], lower, 1, upper[2], name="lips"),
    ]
    return Problem(mesh, mix(fraction, MUSCLE["wu2013"]), kappa=50.0, terms=terms, fixed=fixed)


def clock(name, work, repeat=5):
    """Print the best time of some runs, and return the last result."""
    best = np.inf
    for _ in range(repeat):
        start = time.perf_counter()
        result = work()
        best = min(best, time.perf_counter() - start)
    print(f"{name:24s} {1e3 * best:8.1f} ms")
    return result


def main() -> None:
    """Time set-up, assembly, factorisation and whole solves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--no-solve", action="store_true", help="time one assembly only")
    arguments = parser.parse_args()
    problem = clock("set-up", stand_in, 2)
    points = {term.name: len(term.hosts) for term in problem.terms}
    print(f"{problem.mesh.n_elements} elements, {problem.n_unknowns} unknowns, points {points}")
    run = Continuation(problem)
    rest = problem.rest()
    everything = (rest.parameters, rest.pressure, rest.load)
    clock("residual", lambda: problem.evaluate(*everything))
    clock("residual and tangent", lambda: problem.evaluate(*everything, tangent=True))
    matrix = clock("sum into the matrix", problem.tangent)
    clock("factorisation", lambda: run.solver.factorise(matrix))
    right = np.ones(problem.n_unknowns)
    clock("solution", lambda: run.solver.solve(right))
    if arguments.no_solve:
        return
    for activations in (
        {"zygomaticus": 1.0},
        {"zygomaticus": 1.0, "levator": 0.5, "risorius": 0.5},
        {"depressor": 1.0, "lower_lip": 0.7},
    ):
        state = Continuation(problem).run(problem.load(activations))
        corner = problem.mesh.locate(place(0.36, -0.3, OUTER)[None])
        moved = state.mesh.evaluate(corner.elements, corner.xi) - problem.mesh.evaluate(
            corner.elements, corner.xi
        )
        print(activations, state.statistics, "corner", moved.round(2))


if __name__ == "__main__":
    main()
