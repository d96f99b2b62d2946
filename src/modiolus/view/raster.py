"""A small software renderer: triangles to pixels without a display and without OpenGL.

Triangles are scan-converted into a depth buffer by a compiled kernel; light, occlusion and colour
are then worked out for every pixel that shows a surface. Written because pictures must come out
the same on a laptop, in a container and in continuous integration, where OpenGL may be missing.
"""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from modiolus.errors import InputError
from modiolus.export.shape import Shape, linear_light, vertex_normals
from modiolus.hermite.basis import Array, IntArray
from modiolus.hermite.check import numbers, whole

__all__ = ["BACKGROUND", "Camera", "Curves", "draw"]


BACKGROUND = (0.955, 0.955, 0.95)
"""Colour behind everything (sRGB, 0 to 1)."""

_SUPERSAMPLING = 2


@dataclass(frozen=True)
class Camera:
    """A view of a scene.

    Parameters
    ----------
    target : (3,) sequence of float
        The point in the middle of the picture, in mm.
    height : float
        What the picture spans from top to bottom at the target, in mm.
    azimuth : float
        Where the camera stands, in degrees: 0 in front of the face (on the -y side), positive
        towards the subject's left (+x).
    elevation : float
        How high it stands, in degrees above the horizon.
    distance : float
        Distance from the target, in mm. The default is that of a portrait photograph.

    Raises
    ------
    InputError
        The height or the distance is not above 0, or a number is not finite.
    """

    target: tuple[float, float, float]
    height: float
    azimuth: float = 0.0
    elevation: float = 0.0
    distance: float = 1400.0

    def __post_init__(self) -> None:
        numbers("camera: target", self.target, 3)
        numbers("camera: angles", (self.azimuth, self.elevation), 2)
        if not (0.0 < self.height < np.inf and 0.0 < self.distance < np.inf):
            raise InputError(
                f"camera: height {self.height:g} and distance {self.distance:g} mm; give both "
                "above 0"
            )

    def axes(self) -> Array:
        """Return the unit vectors to the right, upwards and towards the viewer, as rows (3, 3)."""
        azimuth, elevation = np.radians([self.azimuth, self.elevation])
        towards = np.array(
            [
                np.sin(azimuth) * np.cos(elevation),
                -np.cos(azimuth) * np.cos(elevation),
                np.sin(elevation),
            ]
        )
        right = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        return np.array([right, np.cross(towards, right), towards])

    def project(self, points: Array, width: int, height: int) -> Array:
        """Project points to pixels.

        Parameters
        ----------
        points : (n, 3) array
            Points in mm.
        width, height : int
            Size of the picture in pixels.

        Returns
        -------
        (n, 3) array
            Column and row in pixels (row 0 at the top) and the depth in mm from the camera.
        """
        local = (points - np.asarray(self.target)) @ self.axes().T
        depth = self.distance - local[:, 2]
        scale = height / self.height * self.distance / depth
        return np.column_stack(
            [0.5 * width + scale * local[:, 0], 0.5 * height - scale * local[:, 1], depth]
        )


@dataclass(frozen=True, eq=False)
class Curves:
    """Lines to draw, such as element edges or fibres; surfaces in front hide them.

    Parameters
    ----------
    points : (n, 3) array
        Positions in mm, the lines one after another.
    lengths : (k,) array of int
        Number of points of each line; they add up to n.
    colour : (3,) or (n, 3) array
        sRGB colour, 0 to 1.
    width : float
        Width in pixels.
    lift : float
        How far the lines are moved towards the viewer, in mm, so that they show on a surface.

    Raises
    ------
    InputError
        The lengths do not add up to the points, or a point is not finite.
    """

    points: Array
    lengths: IntArray
    colour: tuple[float, float, float] | Array
    width: float = 1.0
    lift: float = 0.3

    def __post_init__(self) -> None:
        n = len(numbers("curves: points", self.points, None, 3))
        if (whole("curves: lengths", self.lengths, n + 1) < 1).any() or sum(self.lengths) != n:
            raise InputError(f"curves: lengths do not add up to the {n} points; mend them")


@numba.njit(cache=True, nogil=True)
def _scan(points, faces, depth, owner, weights):  # type: ignore[no-untyped-def]
    """Scan-convert triangles into the buffers, nearest first.

    `points` (n, 3) are column, row and depth; `depth` (h, w), `owner` (h, w) and `weights`
    (h, w, 3) are changed in place. The weights are corrected for perspective. What reaches behind
    the camera is left out.
    """
    rows, columns = depth.shape
    for face in range(faces.shape[0]):
        a, b, c = points[faces[face, 0]], points[faces[face, 1]], points[faces[face, 2]]
        twice_area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if abs(twice_area) < 1e-12 or min(a[2], b[2], c[2]) <= 0.0:
            continue
        first_row = max(int(np.ceil(min(a[1], b[1], c[1]) - 0.5)), 0)
        last_row = min(int(np.floor(max(a[1], b[1], c[1]) - 0.5)), rows - 1)
        first_column = max(int(np.ceil(min(a[0], b[0], c[0]) - 0.5)), 0)
        last_column = min(int(np.floor(max(a[0], b[0], c[0]) - 0.5)), columns - 1)
        for row in range(first_row, last_row + 1):
            y = row + 0.5
            for column in range(first_column, last_column + 1):
                x = column + 0.5
                u = ((b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)) / twice_area
                v = ((c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)) / twice_area
                w = 1.0 - u - v
                if u < 0.0 or v < 0.0 or w < 0.0:
                    continue
                inverse = u / a[2] + v / b[2] + w / c[2]
                z = 1.0 / inverse
                if z < depth[row, column]:
                    depth[row, column] = z
                    owner[row, column] = face
                    weights[row, column, 0] = u / a[2] * z
                    weights[row, column, 1] = v / b[2] * z
                    weights[row, column, 2] = w / c[2] * z


def _ribbons(curves: Curves, camera: Camera, pixel: float) -> Shape:
    """Turn lines into strips of triangles that face the camera; `pixel` is mm per pixel."""
    axes = camera.axes()
    towards = axes[2]
    starts = np.cumsum(curves.lengths) - curves.lengths
    ends = starts + curves.lengths - 1
    index = np.arange(len(curves.points))
    before = np.where(np.isin(index, starts), index, index - 1)
    after = np.where(np.isin(index, ends), index, index + 1)
    tangent = curves.points[after] - curves.points[before]
    across = np.cross(towards, tangent)
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across = np.where(length > 1e-9, across / np.maximum(length, 1e-9), axes[0])
    half = 0.5 * curves.width * pixel * across
    middle = curves.points + curves.lift * towards
    vertices = np.concatenate([middle - half, middle + half])
    here = index[~np.isin(index, ends)]
    other = len(curves.points)
    faces = np.concatenate(
        [
            np.column_stack([here, here + 1, here + other]),
            np.column_stack([here + 1, here + 1 + other, here + other]),
        ]
    )
    colour = np.broadcast_to(np.asarray(curves.colour, float), curves.points.shape)
    return Shape(vertices, faces, np.concatenate([colour, colour]))


def _srgb(light: Array) -> Array:
    """Return sRGB colours of linear light."""
    light = np.clip(light, 0.0, 1.0)
    return np.asarray(
        np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)
    )


# A warm key light high on the left, a cool fill on the right, and a faint one from behind along
# the outline: unit directions in the camera's axes (right, up, towards the viewer), linear colours.
_LIGHTS = np.array([[-0.483, 0.545, 0.685], [0.804, 0.095, 0.587], [0.533, 0.436, -0.726]])
_LIGHT_COLOURS = np.array([[0.780, 0.749, 0.702], [0.224, 0.242, 0.260], [0.220, 0.220, 0.220]])
# The light of the surroundings, from above and from below.
_SKY = np.array([0.94, 0.97, 1.00]) * 0.24
_GROUND = np.array([1.00, 0.93, 0.88]) * 0.13
# Light that comes back out of skin is red: it has wandered through blood.
_SCATTERED = 0.4 + 0.6 * np.array([1.00, 0.42, 0.30])


@numba.njit(cache=True, fastmath=True, nogil=True)
def _shade(  # type: ignore[no-untyped-def]
    vertices, faces, normals, colours, gloss, glow, lit, owner, weights, open_sky, eye, axes, image
):
    """Write the linear light of every pixel that shows a triangle into `image` (h, w, 3).

    Lambert's and Blinn's terms for each light. Where a surface glows, its diffuse light reaches
    past the terminator, most of all in red, as it does in skin. `open_sky` is what `_occlusion`
    returns. Lines keep their plain colour.
    """
    rows, columns = owner.shape
    lights = _LIGHTS @ axes
    view, normal, colour = np.empty(3), np.empty(3), np.empty(3)
    for row in range(rows):
        for column in range(columns):
            face = owner[row, column]
            if face < 0:
                continue
            i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
            u, v, w = weights[row, column, 0], weights[row, column, 1], weights[row, column, 2]
            for axis in range(3):
                view[axis] = eye[axis] - (
                    u * vertices[i, axis] + v * vertices[j, axis] + w * vertices[k, axis]
                )
                normal[axis] = u * normals[i, axis] + v * normals[j, axis] + w * normals[k, axis]
                colour[axis] = u * colours[i, axis] + v * colours[j, axis] + w * colours[k, axis]
            if not lit[i]:
                image[row, column, :] = colour
                continue
            # Seen from behind: turn the normal round. The triangle decides, not its smooth
            # normal, which may well point away at an outline.
            facing = 0.0
            for axis in range(3):
                n, m = (axis + 1) % 3, (axis + 2) % 3
                facing += view[axis] * (
                    (vertices[j, n] - vertices[i, n]) * (vertices[k, m] - vertices[i, m])
                    - (vertices[j, m] - vertices[i, m]) * (vertices[k, n] - vertices[i, n])
                )
            far = 1.0 / np.sqrt(view[0] ** 2 + view[1] ** 2 + view[2] ** 2)
            unit = 1.0 / np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2 + 1e-30)
            if facing < 0.0:
                unit = -unit
            up = 0.5
            for axis in range(3):
                view[axis] *= far
                normal[axis] *= unit
                up += 0.5 * normal[axis] * axes[1, axis]
            shiny = u * gloss[i] + v * gloss[j] + w * gloss[k]
            soft = u * glow[i] + v * glow[j] + w * glow[k]
            for axis in range(3):
                image[row, column, axis] = colour[axis] * (
                    up * _SKY[axis] + (1.0 - up) * _GROUND[axis]
                )
            for light in range(lights.shape[0]):
                cosine, mirror, length = 0.0, 0.0, 0.0
                for axis in range(3):
                    half = view[axis] + lights[light, axis]
                    cosine += normal[axis] * lights[light, axis]
                    mirror += normal[axis] * half
                    length += half * half
                hard = max(cosine, 0.0)
                wrapped = max((cosine + 0.45) / 1.45, 0.0) ** 2
                shine = 0.0
                if cosine > 0.0 and mirror > 0.0:
                    mirror /= np.sqrt(length)
                    broad = 0.45 * (1.0 - shiny) * mirror**14
                    shine = shiny * (broad + 1.6 * shiny * mirror**90)
                for axis in range(3):
                    diffuse = (1.0 - soft) * hard + soft * max(hard, wrapped * _SCATTERED[axis])
                    image[row, column, axis] += _LIGHT_COLOURS[light, axis] * (
                        1.15 * diffuse * colour[axis] + shine
                    )
            for axis in range(3):
                image[row, column, axis] *= open_sky[
                    row // _SUPERSAMPLING, column // _SUPERSAMPLING
                ]


def draw(
    shapes: list[Shape],
    curves: list[Curves],
    camera: Camera,
    width: int,
    height: int,
) -> Array:
    """Draw surfaces and lines.

    Parameters
    ----------
    shapes : list of Shape
        Surfaces, lit and shaded; seen from either side.
    curves : list of Curves
        Lines, drawn in their plain colour.
    camera : Camera
        The view.
    width, height : int
        Size of the picture in pixels.

    Returns
    -------
    (height, width, 3) array
        sRGB colours, 0 to 1.
    """
    columns, rows = width * _SUPERSAMPLING, height * _SUPERSAMPLING
    surfaces = [shape for shape in shapes if len(shape.faces)]
    ribbons = [_ribbons(line, camera, camera.height / height) for line in curves]
    solid = [*surfaces, *(ribbon for ribbon in ribbons if len(ribbon.faces))]
    image = np.empty((rows, columns, 3))
    image[:] = linear_light(np.array(BACKGROUND))
    if not solid:
        return _srgb(image[:height, :width])
    scene = _Scene.join(solid, len(surfaces))

    depth = np.full((rows, columns), np.inf)
    owner = np.full((rows, columns), -1, dtype=np.int64)
    weights = np.zeros((rows, columns, 3))
    _scan(camera.project(scene.vertices, columns, rows), scene.faces, depth, owner, weights)

    axes = camera.axes()
    eye = np.asarray(camera.target) + camera.distance * axes[2]
    _shade(
        scene.vertices,
        scene.faces,
        scene.normals,
        np.ascontiguousarray(linear_light(scene.colours)),
        scene.gloss,
        scene.glow,
        scene.lit,
        owner,
        weights,
        _occlusion(depth, rows / camera.height),
        eye,
        axes,
        image,
    )
    sampled = image.reshape(height, _SUPERSAMPLING, width, _SUPERSAMPLING, 3).mean(axis=(1, 3))
    return _srgb(sampled)


@dataclass(frozen=True)
class _Scene:
    """All shapes as one: arrays over vertices (n, ...) and triangles (m, 3)."""

    vertices: Array
    faces: IntArray
    normals: Array
    colours: Array
    gloss: Array
    glow: Array
    lit: NDArray[np.bool_]

    @classmethod
    def join(cls, shapes: list[Shape], n_lit: int) -> "_Scene":
        """Join shapes; the first `n_lit` of them are lit, the rest show their plain colour."""
        counts = np.array([len(shape.vertices) for shape in shapes])
        starts = np.cumsum(counts) - counts
        return cls(
            np.concatenate([shape.vertices for shape in shapes]),
            np.concatenate(
                [shape.faces + start for shape, start in zip(shapes, starts, strict=True)]
            ),
            np.concatenate([vertex_normals(shape.vertices, shape.faces) for shape in shapes]),
            np.concatenate([shape.colours() for shape in shapes]),
            np.repeat([shape.gloss for shape in shapes], counts),
            np.repeat([shape.glow for shape in shapes], counts),
            np.repeat(np.arange(len(shapes)) < n_lit, counts),
        )


def _occlusion(depth: Array, pixels_per_mm: float) -> Array:
    """Return how much of the light reaches each pixel of the picture, from the depth buffer.

    A pixel that lies deeper than the blurred depth around it sits in a crease and is darkened
    (unsharp masking of the depth buffer: Luft, Colditz and Deussen, ACM TOG 25:1206, 2006).
    """
    coarse = depth[::_SUPERSAMPLING, ::_SUPERSAMPLING]
    seen = np.isfinite(coarse)
    filled = np.where(seen, coarse, 0.0)
    light = np.ones_like(filled)
    for radius, reach, strength in ((4.5, 7.0, 0.42), (1.3, 2.2, 0.40)):
        sigma = radius * pixels_per_mm / _SUPERSAMPLING
        around = ndimage.gaussian_filter(seen.astype(float), sigma, truncate=2.0)
        mean = ndimage.gaussian_filter(filled, sigma, truncate=2.0) / np.maximum(around, 1e-6)
        light *= 1.0 - strength * np.where(seen, np.clip((filled - mean) / reach, 0.0, 1.0), 0.0)
    return light
