"""A face as things to look at: skin, eyes, teeth, from a tissue mesh and the deep structures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from modiolus.export.layout import skin_layout
from modiolus.export.mouth import mouth
from modiolus.export.shape import Shape
from modiolus.face.head import Head
from modiolus.fitting.register import sphere
from modiolus.hermite.basis import Array, smooth_step
from modiolus.hermite.tessellate import Mirror, Tessellation, tessellate

__all__ = ["FaceScene", "eye"]


_SKIN = np.array([0.87, 0.68, 0.58])
_LIP = np.array([0.78, 0.50, 0.45])
_BROW = np.array([0.36, 0.26, 0.20])
_LINING = (0.45, 0.20, 0.19)
#: Angles about the line of sight at which the colour of an eye changes: pupil, iris, rim, white.
_EYE_RINGS = ((0.17, (0.03, 0.03, 0.03)), (0.46, (0.33, 0.22, 0.14)), (0.50, (0.17, 0.12, 0.09)))
_EYE_WHITE = (0.95, 0.94, 0.92)
_CONJUNCTIVA = (0.80, 0.56, 0.51)
#: Half the height of an eyebrow in mm, at its inner and at its outer end.
_BROW_HEIGHTS = (4.0, 1.4)


class FaceScene:
    """The drawable surfaces of a half face and its mirror image, in any state.

    Parameters
    ----------
    head : Head
        One half. Of its sides ``outer`` and those of lips and lids are drawn as skin, the others
        as lining; its deep structures give the `mouth`, and the eyes are placed in the
        ``eyeball``.
    divisions : int
        Divisions of an element each way.

    Attributes
    ----------
    skin_mirror : Mirror
        How the two halves of the skin are joined.
    colours : (n, 3) array
        Natural sRGB colour of every vertex of the skin.
    layout : (n, 2) array or None
        Texture coordinates of every vertex of the skin, where its grid is that of the template.
    """

    def __init__(self, head: Head, divisions: int = 8) -> None:
        skin = [name for name in head.sides if name.startswith(("outer", "lip", "lid"))]
        lining = [name for name in head.sides if name not in skin and name != "midplane"]
        self._head = head
        self._rest = head.tissue.parameters
        self._skin = _boundary(head, skin, divisions)
        # The lining hardly shows: half as fine will do.
        self._lining = _boundary(head, lining, max(divisions // 2, 1))
        self.skin_mirror = Mirror.of(self._skin.points(self._rest), self._skin.cells, head.midplane)
        self._lining_mirror = Mirror.of(
            self._lining.points(self._rest), self._lining.cells, head.midplane
        )
        self.colours = self._paint(head, skin)
        self.layout = self._lay_out(head, skin)
        self._eyes = _eyes(head)
        self._mouth = mouth(head)

    def skin_points(self, parameters: Array) -> Array:
        """Return the vertices (n, 3) of both halves of the skin in a state."""
        left, right = (self._skin.points(side) for side in self._head.halves(parameters))
        return self.skin_mirror.points(left, right)

    def displacement(self, parameters: Array) -> Array:
        """Return how far every vertex of the skin has moved from rest, (n,) in mm."""
        moved = self.skin_points(parameters) - self.skin_points(self._rest)
        return np.asarray(np.linalg.norm(moved, axis=1))

    def shapes(
        self, parameters: Array, colours: Array | None = None, jaw: float = 0.0
    ) -> list[Shape]:
        """Return the surfaces of both halves in a state.

        Parameters
        ----------
        parameters : (n_params, 3) array
            Of the tissue mesh of the half, or of the whole head.
        colours : (n, 3) array, optional
            sRGB colour of every vertex of the skin, in place of its natural one.
        jaw : float
            Angle in radians by which the jaw is open; the lower teeth go with it.
        """
        natural = colours is None
        skin = Shape(
            self.skin_points(parameters),
            self.skin_mirror.faces,
            self.colours if colours is None else colours,
            "skin",
            gloss=0.22 if natural else 0.08,
            glow=0.7 if natural else 0.0,
            layout=self.layout,
        )
        left, right = (self._lining.points(side) for side in self._head.halves(parameters))
        lining = Shape(
            self._lining_mirror.points(left, right),
            self._lining_mirror.faces,
            _LINING,
            "lining",
            gloss=0.05,
        )
        inside = [self._with_jaw(shape, share, jaw) for shape, share in self._mouth]
        return [skin, lining, *self._eyes, *inside]

    def targets(self, states: Mapping[str, tuple[Array, float]]) -> dict[str, dict[str, Array]]:
        """Return the vertices of everything that moves in some states, as morph targets.

        Parameters
        ----------
        states : mapping of str to ((n_params, 3) array, float)
            Parameters of the tissue, of the half or of the whole head, and angle of the jaw in
            radians, by name.

        Returns
        -------
        dict of str to dict of str to (n, 3) array
            Vertices (mm) by shape and by state. A shape that moves in one has all states.
        """
        moved = [self.shapes(parameters, jaw=jaw) for parameters, jaw in states.values()]
        targets = {}
        for still, *there in zip(self.shapes(self._rest), *moved, strict=True):
            if not all(np.array_equal(shape.vertices, still.vertices) for shape in there):
                vertices = [shape.vertices for shape in there]
                targets[still.name] = dict(zip(states, vertices, strict=True))
        return targets

    def _with_jaw(self, shape: Shape, share: Array, angle: float) -> Shape:
        """Return a shape whose vertices follow the jaw by a share (n,), where they are then."""
        if angle == 0.0 or self._head.jaw is None or not share.any():
            return shape
        moved = self._head.jaw.displacement(shape.vertices, angle, share)
        return replace(shape, vertices=shape.vertices + moved)

    def _lay_out(self, head: Head, skin: list[str]) -> Array | None:
        """Return the texture coordinates of the skin; the halves are joined where u is 1/2."""
        left = skin_layout(head, skin, self._skin)
        if left is None:
            return None
        layout = self.skin_mirror.values(left)
        image = self.skin_mirror.reflected
        layout[image, 0] = 1.0 - layout[image, 0]
        return layout

    def _paint(self, head: Head, skin: list[str]) -> Array:
        """Return the natural colour of the skin: lips redder, eyebrows dark."""
        counts = [len(head.sides[name][0]) for name in skin]
        hosts = np.concatenate([head.sides[name][0] for name in skin])
        samples = hosts[self._skin.elements]
        on_margin = np.repeat([name.startswith("lip") for name in skin], counts)
        red = on_margin[self._skin.elements].astype(float)
        outer = np.repeat([name == "outer" for name in skin], counts)[self._skin.elements]
        for name in ("lip_upper", "lip_lower"):
            elements, axis, side = head.sides[name]
            near = outer & np.isin(samples, elements)
            # From the middle (0) to the corner (1) the red narrows; on the outer surface the
            # local directions are xi1 and xi2, and the slit runs along xi1.
            column = np.searchsorted(np.sort(elements), samples[near])
            along = (column + self._skin.xi[near, 0]) / len(elements)
            height = 0.95 * (1.0 - along**3) ** 0.8
            away = np.abs(self._skin.xi[near, axis] - side)
            red[near] = 1.0 - _smooth(-0.12, 0.12, away - height)
        share = self._skin.average(red)[:, None]
        colour = _SKIN + share * (_LIP - _SKIN)

        # The eyebrow runs along a row of elements, on the line where their xi2 is 0.
        line = np.arange(head.landmarks["inner_brow"][0], head.landmarks["outer_brow"][0] + 1)
        ticks = np.tile(np.linspace(0.0, 1.0, 9), len(line))
        xi = np.column_stack([ticks, np.zeros(len(ticks)), np.ones(len(ticks))])
        brow = head.tissue.evaluate(np.repeat(line, 9), xi)
        rest = self._skin.points(self._rest)
        gap = np.linalg.norm(rest[:, None, :] - brow[None], axis=2)
        nearest = gap.argmin(axis=1)
        half = np.interp(nearest, [0, len(brow) - 1], _BROW_HEIGHTS)
        hair = 1.0 - _smooth(0.55, 1.15, gap.min(axis=1) / half)
        colour += 0.85 * hair[:, None] * (_BROW - colour)
        return self.skin_mirror.values(colour)


def eye(
    centre: Array, radius: float, name: str, gaze: tuple[float, float, float] = (0, -1, 0)
) -> Shape:
    """Return an eyeball with iris and pupil; in a texture it is a disc around the pupil.

    Parameters
    ----------
    centre : (3,) array
        In mm.
    radius : float
        In mm.
    name : str
        Such as ``"eye_left"``.
    gaze : (3,) sequence of float
        Where it looks.
    """
    axis = np.array(gaze, dtype=float)
    axis /= np.linalg.norm(axis)
    side = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    frame = np.array([side, np.cross(axis, side), axis])
    # Where the colour changes there are two rings of vertices close together, for a crisp edge.
    edges = [angle for angle, _ in _EYE_RINGS]
    rings = np.unique(np.concatenate([np.linspace(0.0, np.pi, 40), edges, np.array(edges) + 0.012]))
    colours = np.tile(np.array(_EYE_WHITE), (len(rings), 1))
    for angle, colour in reversed(_EYE_RINGS):
        colours[rings <= angle] = colour
    turns = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    ring, turn = np.meshgrid(rings, turns, indexing="ij")
    local = np.stack(
        [np.sin(ring) * np.cos(turn), np.sin(ring) * np.sin(turn), np.cos(ring)], axis=-1
    )
    here = np.arange(ring.size).reshape(ring.shape)
    beside = np.roll(here, -1, axis=1)
    quads = np.stack([here[:-1], here[1:], beside[1:], beside[:-1]], axis=-1).reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return Shape(
        centre + radius * local.reshape(-1, 3) @ frame,
        faces,
        np.repeat(colours, len(turns), axis=0),
        name,
        gloss=0.8,
        layout=0.5
        - 0.5 / np.pi * np.stack([ring * np.cos(turn), ring * np.sin(turn)], -1).reshape(-1, 2),
    )


def _boundary(head: Head, names: list[str], divisions: int) -> Tessellation:
    """Tessellate several sides of the tissue as one surface with closed seams."""
    surface, outward = head.tissue.boundary(head.sides[name] for name in names)
    return tessellate(surface, divisions, outward)


def _eyes(head: Head) -> list[Shape]:
    """Return both eyes, in the sphere that fits the deep structure ``eyeball`` best."""
    if "eyeball" not in head.deep:
        return []
    points = head.deep["eyeball"].distance.surface().vertices
    centre, radius = sphere(points)
    socket = _socket(centre, radius, head.midplane)
    return [
        eye(centre, radius, "eye_left"),
        eye(head.mirror(centre), radius, "eye_right"),
        socket,
        replace(
            socket,
            vertices=head.mirror(socket.vertices),
            faces=socket.faces[:, ::-1],
            name="socket_right",
        ),
    ]


def _socket(centre: Array, radius: float, midplane: float) -> Shape:
    """Return what shows beside the left eyeball in the corners of the lids: a collar around it.

    It runs back, less so towards the nose, where the corner lies in front of it.
    """
    turns = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    circle = np.column_stack([np.cos(turns), np.zeros(len(turns)), np.sin(turns)])
    nasal = 0.5 * (1.0 + np.sign(midplane - centre[0]) * circle[:, :1])
    back = np.array([0.0, radius, 0.0])
    inner = centre + 0.9 * radius * circle - 0.4 * back
    outer = centre + (1.5 + 0.4 * nasal) * radius * circle + (0.8 - 0.7 * nasal) * back
    here = np.arange(len(turns))
    beside = np.roll(here, -1)
    outside, next_outside = here + len(turns), beside + len(turns)
    faces = np.concatenate(
        [
            np.column_stack([here, beside, outside]),
            np.column_stack([beside, next_outside, outside]),
        ]
    )
    return Shape(np.concatenate([inner, outer]), faces, _CONJUNCTIVA, "socket_left", gloss=0.1)


def _smooth(low: float, high: float, values: Array) -> Array:
    """Return 0 below `low`, 1 above `high`, and a smooth step in between."""
    return smooth_step((values - low) / (high - low))
