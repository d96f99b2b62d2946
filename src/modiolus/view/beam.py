"""Pictures of the beam with a slab of muscle."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modiolus.export.shape import Shape
from modiolus.hermite import HermiteMesh, outward
from modiolus.hermite.tessellate import tessellate
from modiolus.mechanics.beam import ELEMENTS, SIZE, BeamResult, fibre_direction, slab_mesh
from modiolus.view.figure import Panel, figure
from modiolus.view.raster import Camera, Curves

__all__ = ["draw_beam"]

_TISSUE = (0.93, 0.80, 0.66)
_EDGE = (0.50, 0.40, 0.33)
_FIBRE = (0.62, 0.12, 0.12)


def draw_beam(result: BeamResult, path: Path) -> None:
    """Draw the beam at rest and bent, with its elements and its fibres; write a PNG."""
    rest = result.state.reference
    panels = []
    for mesh, title in ((rest, "at rest"), (result.state.mesh, "contracted")):
        camera = Camera((0.42 * SIZE[0], SIZE[1] / 2, 20.0), 110.0, azimuth=-28.0, elevation=24.0)
        panels.append(
            Panel(camera, _shapes(mesh), [_edges(mesh), _fibres(rest, mesh, result.angle)], title)
        )
    heading = (
        f"Fibres at {result.angle:g}°: bent by {result.bend:.0f}°, twisted by {result.twist:.0f}°"
    )
    figure(panels, path, columns=2, panel_size=(640, 500), heading=heading)


def _outside(mesh: HermiteMesh) -> list[tuple[HermiteMesh, int]]:
    """Return the faces of the beam with 1 where their xi1 x xi2 points outwards, else -1."""
    index = np.arange(mesh.n_elements).reshape(ELEMENTS[::-1])
    faces = []
    for axis in range(3):
        for side in (0, 1):
            elements = np.take(index, -side, axis=2 - axis).ravel()
            faces.append((mesh.face(elements, axis, side), outward(axis, side)))
    return faces


def _shapes(mesh: HermiteMesh) -> list[Shape]:
    shapes = []
    for face, sense in _outside(mesh):
        surface = tessellate(face, 8, sense)
        shapes.append(Shape(surface.points(mesh.parameters), surface.cells, _TISSUE, gloss=0.2))
    return shapes


def _edges(mesh: HermiteMesh) -> Curves:
    """Return the edges of the elements that lie on the outside."""
    ticks = np.linspace(0.0, 1.0, 13)
    lines = []
    for face, _ in _outside(mesh):
        for axis in (0, 1):
            for side in (0, 1):
                edge = face.face(np.arange(face.n_elements), axis, side)
                hosts = np.repeat(np.arange(edge.n_elements), len(ticks))
                lines.append(edge.evaluate(hosts, np.tile(ticks, edge.n_elements)[:, None]))
    points = np.concatenate(lines)
    return Curves(points, np.full(len(points) // 13, 13), _EDGE, width=1.6)


def _fibres(rest: HermiteMesh, mesh: HermiteMesh, angle: float) -> Curves:
    """Return the fibres of the slab, drawn on the top of the beam that carries them along."""
    direction = fibre_direction(angle)
    slab = slab_mesh()
    inside = slab.evaluate(*slab.gauss_points(2)[:2])
    low, high = inside.min(axis=0), inside.max(axis=0)
    low[2] = high[2] = SIZE[2]
    middle = 0.5 * (low + high)
    across = np.array([-direction[1], direction[0], 0.0])
    along = np.linspace(-120.0, 120.0, 481)
    points, lengths = [], []
    for offset in np.arange(-100.0, 100.1, 4.0):
        line = middle + offset * across + along[:, None] * direction
        line = line[((line >= low - 1e-9) & (line <= high + 1e-9)).all(axis=1)]
        if len(line) > 3:
            points.append(line)
            lengths.append(len(line))
    place = rest.locate(np.concatenate(points))
    carried = mesh.evaluate(place.elements, place.xi)
    return Curves(carried, np.array(lengths), _FIBRE, width=2.2, lift=0.6)
