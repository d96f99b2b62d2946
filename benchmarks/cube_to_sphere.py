"""Fit a cube to a sphere like the end-to-end test of scaffoldfitter, and time both.

Run with ``python benchmarks/cube_to_sphere.py RESOURCES``, where RESOURCES is the folder
``tests/resources`` of scaffoldfitter's source, which has ``cube_to_sphere.exf`` and
``cube_to_sphere_data_regular.exf``. Needs ``pip install scaffoldfitter``.

One tricubic element without cross derivatives (32 parameters a component) is aligned to four
markers, then fitted in three rounds to 288 points by groups (bottom, sides, top) and the markers,
with a penalty of 0.01 on second derivatives with respect to the aligned cube. Both begin from the
alignment that scaffoldfitter finds. What differs:

- scaffoldfitter integrates the penalty at 3 x 3 x 3 Gauss points. It is of degree 6 in every
  direction, for which 4 x 4 x 4 are needed. Both are computed here.
- Its projections end at a tolerance of their own; here Gauss-Newton goes on to 1e-13.
- It evaluates general fields and calls an optimiser; here sparse normal equations are solved.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from modiolus.fitting import CloudTarget, PointTarget, Smoothing, fit
from modiolus.hermite import HermiteMesh
from modiolus.hermite.exread import read_ex

#: What the test of scaffoldfitter expects, to 1e-4.
AREA, VOLUME = 3.18921662820759, 0.5276212500501103
PENALTY, ROUNDS = 0.01, 3
#: Groups of data and the sides of the cube they belong to: (axis, side).
FACES = {
    "bottom": [(2, 0)],
    "sides": [(0, 0), (0, 1), (1, 0), (1, 1)],
    "top": [(2, 1)],
}
#: The markers bottom, top, left and right in the cube, in the order of the data.
MARKERS = np.array([(0.5, 0.5, 0.0), (0.5, 0.5, 1.0), (0.0, 0.0, 0.5), (1.0, 1.0, 0.5)])


def theirs(folder: Path) -> dict:
    """Run scaffoldfitter; return its figures, its alignment and its data."""
    from cmlibs.utils.zinc.field import createFieldMeshIntegral
    from scaffoldfitter.fitter import Fitter
    from scaffoldfitter.fitterstepalign import FitterStepAlign
    from scaffoldfitter.fitterstepfit import FitterStepFit

    model, data = (str(folder / f"cube_to_sphere{part}.exf") for part in ("", "_data_regular"))
    fitter = Fitter(model, data)
    fitter.setDiagnosticLevel(0)
    fitter.load()
    coordinates, module = fitter.getModelCoordinatesField(), fitter.getFieldmodule()
    area = createFieldMeshIntegral(coordinates, fitter.getMesh(2), number_of_points=4)
    volume = createFieldMeshIntegral(coordinates, fitter.getMesh(3), number_of_points=3)
    cache = module.createFieldcache()
    points = module.findNodesetByName("datapoints")
    groups = {}
    for name in (*FACES, "marker"):
        group = module.findFieldByName(name).castGroup().getNodesetGroup(points)
        field = fitter.getDataCoordinatesField()
        groups[name] = read_points(group, field, cache)
    align = FitterStepAlign()
    fitter.addFitterStep(align)
    align.setAlignMarkers(True)
    align.run()
    step = FitterStepFit()
    fitter.addFitterStep(step)
    step.setGroupDataWeight("marker", 1.0)
    step.setGroupDataSlidingFactor(None, 1.0)
    step.setGroupCurvaturePenalty(None, [PENALTY])
    step.setNumberOfIterations(ROUNDS)
    began = time.perf_counter()
    step.run()
    return {
        "seconds": time.perf_counter() - began,
        "area": area.evaluateReal(cache, 1)[1],
        "volume": volume.evaluateReal(cache, 1)[1],
        "matrix": np.array(align.getTransformationMatrix()),
        "groups": groups,
    }


def read_points(group, field, cache) -> np.ndarray:
    """Return the coordinates (n, 3) of the nodes of a group."""
    out, nodes = [], group.createNodeiterator()
    while (node := nodes.next()).isValid():
        cache.setNode(node)
        out.append(field.evaluateReal(cache, 3)[1])
    return np.array(out)


def part(faces: list[tuple[int, int]]):
    """Return what picks some sides of the cube as one surface."""

    def pick(mesh: HermiteMesh) -> HermiteMesh:
        sides = [mesh.face([0], axis, side) for axis, side in faces]
        return HermiteMesh(2, mesh.parameters, sp.vstack([s.extraction for s in sides]).tocsr())

    return pick


def ours(folder: Path, reference: dict, points: int) -> dict:
    """Fit with modiolus from the same alignment."""
    matrix, groups = reference["matrix"], reference["groups"]
    cube = read_ex(folder / "cube_to_sphere.exf").mesh
    scale = np.cbrt(np.linalg.det(matrix[:3, :3]))
    values = cube.parameters @ matrix[:3, :3].T
    is_value = np.abs(cube.functions([0] * 8, corners()).T @ np.ones(8)) > 0.5
    values[is_value] += matrix[:3, 3]
    mesh = cube.with_parameters(values)
    targets = [CloudTarget(name, part(faces), groups[name]) for name, faces in FACES.items()]
    targets.append(PointTarget("marker", np.zeros(4, int), MARKERS, groups["marker"]))
    # By the aligned cube, of edge `scale`: its volume times the fourth power of its inverse.
    # Mixed derivatives occur twice among the nine.
    weight = PENALTY / scale
    smoothing = Smoothing(second=[weight] * 3 + [2.0 * weight] * 3, points=points)
    fit(mesh, targets, smoothing, iterations=1)  # compiles
    began = time.perf_counter()
    result = fit(mesh, targets, smoothing, iterations=ROUNDS, damping=0.0)
    seconds = time.perf_counter() - began
    every = [face for faces in FACES.values() for face in faces]
    return {
        "seconds": seconds,
        "area": part(every)(result.mesh).measures(4).sum(),
        "volume": result.mesh.measures(3).sum(),
    }


def corners() -> np.ndarray:
    """Return the corners of the cube, (8, 3)."""
    return (np.arange(8)[:, None] >> np.arange(3) & 1).astype(float)


def main() -> None:
    """Print the figures of both."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("resources", type=Path)
    folder = parser.parse_args().resources
    reference = theirs(folder)
    rows = {
        "expected": {"area": AREA, "volume": VOLUME, "seconds": np.nan},
        "scaffoldfitter": reference,
        "ours, 3 points": ours(folder, reference, 3),
        "ours, 4 points": ours(folder, reference, 4),
    }
    print(f"{'':16}{'area':>20}{'volume':>20}{'fit (ms)':>10}")
    for name, row in rows.items():
        print(f"{name:16}{row['area']:20.14f}{row['volume']:20.14f}{1e3 * row['seconds']:10.1f}")


if __name__ == "__main__":
    main()
