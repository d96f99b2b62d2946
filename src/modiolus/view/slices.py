"""Slices of an image with the contour of a surface, to judge a segmentation by eye."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image as Picture
from PIL import ImageDraw

from modiolus.anatomy.image import Image
from modiolus.anatomy.surface import Surface
from modiolus.hermite.basis import Array, IntArray

__all__ = ["draw_slices"]


_CONTOUR = (235, 96, 52)
_INK = (235, 235, 235)
_PAPER = (12, 12, 14)
#: Names of the slices across each axis, and the axes along a slice's width and height.
_SLICES = (("sagittal", 1, 2), ("coronal", 0, 2), ("axial", 0, 1))
#: Pixels of the longest side of a slice.
_SIZE = 640


def draw_slices(
    image: Image, surface: Surface, through: Array, white: float, heading: str, path: Path
) -> None:
    """Draw three slices of an image through a point, with a surface's contour; write a PNG.

    Parameters
    ----------
    image : Image
    surface : Surface
        In the image's frame (mm).
    through : (3,) array
        Where the slices meet (mm); moved into the image.
    white : float
        The value that is drawn white.
    heading : str
        A line above.
    path : Path
    """
    high = np.array(image.values.shape) - 1
    place = np.clip(np.round(image.indices(through[None])[0]), 0, high).astype(int)
    vertices = image.indices(surface.vertices)
    pixels = _SIZE / float((high * image.spacing).max())
    pictures = []
    for axis, (name, u, v) in enumerate(_SLICES):
        # The square root shows noise and ghosts, which is what the contour must not follow.
        grey = np.sqrt(np.clip(np.take(image.values, place[axis], axis) / white, 0.0, 1.0)).T
        # Front at the left and at the top; the height of a slice runs upwards.
        upwards = v == 2
        scale = pixels * image.spacing[[u, v]]
        size = np.maximum(np.round((high[[u, v]] + 1) * scale), 1).astype(int)
        raster = np.round(255.0 * (grey[::-1] if upwards else grey)).astype(np.uint8)
        picture = Picture.fromarray(raster).resize(tuple(size.tolist()), Picture.Resampling.BICUBIC)
        picture = picture.convert("RGB")
        pen = ImageDraw.Draw(picture)
        lines = (
            _section(vertices, surface.faces, axis, float(place[axis]))[..., [u, v]] + 0.5
        ) * scale
        if upwards:
            lines[..., 1] = size[1] - lines[..., 1]
        for line in lines.reshape(-1, 4).tolist():
            pen.line(line, _CONTOUR, 2)
        pen.text((8, 8), name, _INK)
        pictures.append(picture)
    gap, top = 8, 34
    page = Picture.new(
        "RGB",
        (
            sum(picture.width for picture in pictures) + gap * 4,
            max(picture.height for picture in pictures) + top + gap,
        ),
        _PAPER,
    )
    ImageDraw.Draw(page).text((gap, 10), heading, _INK)
    left = gap
    for picture in pictures:
        page.paste(picture, (left, top))
        left += picture.width + gap
    page.save(path)


def _section(vertices: Array, faces: IntArray, axis: int, at: float) -> Array:
    """Return the segments (n, 2, 3) in which triangles meet a plane across an axis."""
    # A vertex in the plane would end segments in it: none is quite there.
    height = vertices[:, axis] - at - 1e-6
    above = height > 0.0
    met = faces[(above[faces].any(axis=1)) & ~(above[faces].all(axis=1))]
    ends = []
    for a, b in ((0, 1), (1, 2), (2, 0)):
        one, two = met[:, a], met[:, b]
        crossed = above[one] != above[two]
        drop = np.where(crossed, height[one] - height[two], 1.0)
        share = (height[one] / drop)[:, None]
        point = vertices[one] + share * (vertices[two] - vertices[one])
        ends.append(np.where(crossed[:, None], point, np.nan))
    edges = np.stack(ends, axis=1)
    return np.asarray(edges[np.isfinite(edges[..., 0])].reshape(-1, 2, 3))
