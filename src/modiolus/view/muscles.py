"""A page with every muscle of a head and its fibres."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modiolus.export.shape import Shape
from modiolus.face.head import Head
from modiolus.face.muscle import Muscle
from modiolus.hermite import HermiteMesh, outward
from modiolus.hermite.tessellate import tessellate
from modiolus.view.figure import Panel, figure
from modiolus.view.raster import Camera, Curves

__all__ = ["draw_muscles"]


_BONE = (0.90, 0.87, 0.80)
_MUSCLE = (0.72, 0.27, 0.24)
_FIBRE = (0.98, 0.86, 0.78)
#: Deep structures to show a muscle on, those that there are.
_BACKDROP = ("skull", "mandible", "teeth_upper", "teeth_lower")


def draw_muscles(head: Head, heading: str, path: Path) -> None:
    """Draw every muscle of the left side with its fibres over the bones; write a PNG."""
    backdrop = []
    for name in _BACKDROP:
        if name in head.deep:
            surface = head.deep[name].distance.surface()
            backdrop.append(Shape(surface.vertices, surface.faces, _BONE, name, gloss=0.15))
    panels = []
    for muscle in head.muscles.values():
        shapes = [_outside(muscle.mesh)]
        low, high = shapes[0].vertices.min(axis=0), shapes[0].vertices.max(axis=0)
        middle = 0.5 * (low + high)
        # Seen from where its outer side faces: the further lateral, the more from the side.
        azimuth = float(np.clip(1.1 * (middle[0] - 8.0), 10.0, 62.0))
        height = max(1.5 * float(np.linalg.norm(high - low)), 60.0)
        camera = Camera(
            (float(middle[0]), float(middle[1]), float(middle[2])), height, azimuth, 4.0
        )
        title = muscle.name.replace("_", " ")
        panels.append(Panel(camera, [*shapes, *backdrop], [fibres(muscle)], title))
    figure(panels, path, columns=6, panel_size=(340, 340), heading=heading)


def fibres(muscle: Muscle, across: int = 4) -> Curves:
    """Return short fibres on the superficial and the deep side of a muscle.

    Each follows the fibre direction from a point of a lattice for a quarter of an element either
    way, so that oblique fibres show as what they are.

    Parameters
    ----------
    muscle : Muscle
    across : int
        Fibres across an element.
    """
    mesh = muscle.mesh
    ticks = (np.arange(across) + 0.5) / across
    seeds = np.array([(u, v, w) for u in (0.25, 0.75) for v in ticks for w in (0.02, 0.98)])
    elements = np.repeat(np.arange(mesh.n_elements), len(seeds))
    xi = np.tile(seeds, (mesh.n_elements, 1))
    length = 0.25 * np.linalg.norm(mesh.jacobian(elements, xi)[:, :, 0], axis=1)
    steps = 4
    line = [np.zeros(3)] * (2 * steps + 1)
    for way in (1, -1):
        place = xi.copy()
        for step in range(steps + 1):
            line[steps + way * step] = mesh.evaluate(elements, place)
            direction = muscle.frame(elements, place)[:, 0]
            rates = np.linalg.solve(mesh.jacobian(elements, place), direction[:, :, None])[..., 0]
            place = np.clip(place + way * rates * (length / steps)[:, None], 0.0, 1.0)
    points = np.stack(line, axis=1).reshape(-1, 3)
    return Curves(points, np.full(len(elements), len(line)), _FIBRE, width=1.3, lift=0.25)


def _outside(mesh: HermiteMesh) -> Shape:
    """Return all sides of all elements; those between elements are hidden inside."""
    vertices, faces, start = [], [], 0
    every = np.arange(mesh.n_elements)
    for axis in range(3):
        for side in (0, 1):
            surface = tessellate(mesh.face(every, axis, side), 6, outward(axis, side))
            vertices.append(surface.points(mesh.parameters))
            faces.append(surface.cells + start)
            start += len(vertices[-1])
    return Shape(np.concatenate(vertices), np.concatenate(faces), _MUSCLE, "muscle", gloss=0.3)
