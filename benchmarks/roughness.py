"""How rough the skin is in an expression: what of its displacement varies over less than 12 mm.

    python benchmarks/roughness.py [HEAD]

An element of the face is 5 to 12 mm wide. The displacement u of the skin is smoothed on the skin
at rest: with its Laplacian L and areas M, and t = (12 mm / 2π)², the smooth part v fulfils
(M + t² L M⁻¹ L) v = M u. Waves of 12 mm are halved by that. What it takes off is the roughness,
printed as root mean squares over regions of the face in µm: along the normal, which is what a
picture shows as ridges, and across it.
"""

from __future__ import annotations

import sys

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from modiolus.export.shape import vertex_normals
from modiolus.face.head import Head
from modiolus.hermite.tessellate import Mirror, tessellate
from modiolus.mechanics.face import Face
from modiolus.scans.skin import REGIONS, Skin

WAVE = 12.0


def laplacian(points, triangles):
    """Return the Laplacian of a surface by cotangents, and the areas of its vertices."""
    weights, areas = sp.csr_matrix((len(points),) * 2), np.zeros(len(points))
    for corner in range(3):
        here, first, second = np.roll(triangles, -corner, axis=1).T
        a, b = points[first] - points[here], points[second] - points[here]
        double = np.linalg.norm(np.cross(a, b), axis=1)
        cotangent = np.clip(0.5 * (a * b).sum(axis=1) / np.maximum(double, 1e-9), -5.0, 5.0)
        weights += sp.csr_matrix((cotangent, (first, second)), shape=weights.shape)
        np.add.at(areas, here, double / 6.0)
    weights = weights + weights.T
    return sp.diags(np.asarray(weights.sum(axis=1)).ravel()) - weights, areas


def main(name="taro"):
    head = Head.load(name)
    side = head.sides["outer"]
    rest = head.tissue.face(*side)
    cut = tessellate(rest, 6)
    skin = cut.points(rest.parameters)
    both = Mirror.of(skin, cut.cells, head.midplane)
    points = both.points(skin)
    stiffness, areas = laplacian(points, both.faces)
    time = (WAVE / (2.0 * np.pi)) ** 2
    mass = sp.diags(areas)
    smoother = splu((mass + time**2 * stiffness @ sp.diags(1.0 / areas) @ stiffness).tocsc())
    region = np.zeros(len(skin), dtype=int)
    # The skin of the tissue comes first in that of the head, before lips and lids.
    region[cut.vertex] = Skin(head).region[cut.elements]
    region = both.values(region)
    face = Face(head)
    print(f"{'':14s}" + "".join(f"{part:>12s}" for part in REGIONS))
    for expression in ("smile-closed", "smile-open", "sad", "terror"):
        state = face.express(expression)
        moved = both.points(cut.points(state.mesh.face(*side).parameters))
        gone = moved - points
        rough = gone - smoother.solve(areas[:, None] * gone)
        normal = (rough * vertex_normals(moved, both.faces)).sum(axis=1)
        across = (rough**2).sum(axis=1) - normal**2
        line = f"{expression:14s}"
        for number in range(len(REGIONS)):
            here = region == number
            values = [np.average(v[here], weights=areas[here]) ** 0.5 for v in (normal**2, across)]
            line += f"{'/'.join(f'{1e3 * value:.0f}' for value in values):>12s}"
        print(line, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
