"""Pictures of a face: at rest, in a state, and every muscle alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from modiolus.errors import InputError
from modiolus.export.scene import FaceScene
from modiolus.export.shape import Shape
from modiolus.hermite.basis import Array
from modiolus.view.figure import Panel, Scale, figure
from modiolus.view.raster import Camera

__all__ = ["VIEWS", "draw_catalogue", "draw_face", "face_camera", "face_panels"]


#: Azimuth and elevation of the usual views, in degrees.
VIEWS = {"front": (0.0, 2.0), "three-quarter": (38.0, 4.0)}


def face_camera(scene: FaceScene, states: Sequence[Array], view: str, zoom: float = 1.0) -> Camera:
    """Return a camera that takes in the whole face in all of some states.

    Parameters
    ----------
    scene : FaceScene
    states : sequence of (n_params, 3) arrays
        Parameters of the tissue.
    view : str
        One of `VIEWS`.
    zoom : float
        Above 1 to come closer.
    """
    azimuth, elevation = VIEWS[view]
    axes = Camera((0.0, 0.0, 0.0), 1.0, azimuth, elevation).axes()
    seen = np.concatenate([scene.skin_points(state) for state in states]) @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    x, y, z = 0.5 * (low + high) @ axes
    return Camera((x, y, z), 1.08 * float(high[1] - low[1]) / zoom, azimuth, elevation)


def face_panels(
    scene: FaceScene,
    states: Sequence[Array],
    looks: Sequence[tuple[str, list[Shape], Scale | None]],
    zoom: float = 1.0,
) -> list[list[Panel]]:
    """Return panels of several looks beside each other, a row for each of `VIEWS`.

    Parameters
    ----------
    scene, states, zoom
        As in `face_camera`.
    looks : sequence of (title, shapes, scale)
        The scale is drawn in the last row.
    """
    last = list(VIEWS)[-1]
    return [
        [
            Panel(
                face_camera(scene, states, view, zoom),
                shapes,
                title=f"{title}, {view}",
                scale=scale if view == last else None,
            )
            for title, shapes, scale in looks
        ]
        for view in VIEWS
    ]


def draw_face(
    scene: FaceScene,
    rest: Array,
    moved: Array,
    heading: str,
    path: Path,
    jaw: float = 0.0,
    titles: tuple[str, str] = ("neutral", "contracted"),
) -> None:
    """Draw a face at rest and in a state, and how far its skin has moved; write a PNG.

    Parameters
    ----------
    scene : FaceScene
    rest, moved : (n_params, 3) arrays
        Parameters of the tissue.
    heading : str
        A line above the pictures.
    path : Path
        The file to write.
    jaw : float
        Angle in radians by which the jaw is open in the state.
    titles : (str, str)
        What the face is called at rest and in the state.
    """
    distance = scene.displacement(moved)
    scale = Scale("displacement (mm)", 0.0, _round_up(float(distance.max())))
    looks: list[tuple[str, list[Shape], Scale | None]] = [
        (titles[0], scene.shapes(rest), None),
        (titles[1], scene.shapes(moved, jaw=jaw), None),
        ("displacement", scene.shapes(moved, scale.colours(distance), jaw), scale),
    ]
    panels = [panel for row in face_panels(scene, [rest, moved], looks) for panel in row]
    figure(panels, path, columns=3, panel_size=(480, 560), heading=heading)


def draw_catalogue(
    scene: FaceScene,
    rest: Array,
    states: Sequence[tuple[str, str, Array]],
    heading: str,
    path: Path,
) -> None:
    """Draw one panel for every state on one page; write a PNG.

    Parameters
    ----------
    scene : FaceScene
    rest : (n_params, 3) array
        Parameters of the tissue at rest.
    states : sequence of (str, str, (n_params, 3) array)
        Title, note and parameters.
    heading : str
        A line above the pictures.
    path : Path
        The file to write.

    Raises
    ------
    InputError
        There are no states.
    """
    if not states:
        raise InputError("states: there are none to draw; give at least one")
    distances = [scene.displacement(moved) for _, _, moved in states]
    scale = Scale("displacement (mm)", 0.0, _round_up(float(np.max(distances))))
    camera = face_camera(scene, [rest], "front", zoom=1.2)
    panels = []
    for (title, note, moved), distance in zip(states, distances, strict=True):
        # The skin keeps its colour where it hardly moves, and shows through elsewhere.
        share = 0.6 * np.clip(distance / (0.15 * scale.high), 0.0, 1.0)[:, None]
        colours = (1.0 - share) * scene.colours + share * scale.colours(distance)
        panels.append(Panel(camera, scene.shapes(moved, colours), title=title, note=note))
    panels[-1] = replace(panels[-1], scale=scale)
    figure(panels, path, columns=6, panel_size=(300, 330), heading=heading)


def _round_up(value: float) -> float:
    """Return the next 1, 1.2, 1.5, 2, 3, 4, 5, 6 or 8 times a power of ten."""
    if value <= 0.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    steps = np.array([1.0, 1.2, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0]) * power
    return float(steps[steps >= value * (1.0 - 1e-9)][0])
