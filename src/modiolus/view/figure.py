"""Figures: panels of drawn scenes with titles and a colour scale, written as one picture."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from modiolus.errors import InputError
from modiolus.export.shape import Shape
from modiolus.hermite.basis import Array
from modiolus.view.raster import BACKGROUND, Camera, Curves, draw

__all__ = ["Panel", "Scale", "figure", "histogram"]


_INK = (38, 38, 42)
_PAPER = tuple(round(255 * value) for value in BACKGROUND)
_FAINT = (120, 120, 126)
# From resting skin to deep violet, evenly darker all the way, so that it also reads in grey.
_RAMP = np.array(
    [
        [0.957, 0.918, 0.867],
        [0.984, 0.800, 0.553],
        [0.973, 0.612, 0.353],
        [0.894, 0.373, 0.322],
        [0.722, 0.208, 0.400],
        [0.475, 0.129, 0.435],
        [0.220, 0.090, 0.357],
    ]
)


@dataclass(frozen=True)
class Scale:
    """A colour scale for values on a surface.

    Parameters
    ----------
    label : str
        What is shown, with its unit.
    low, high : float
        The values at the two ends; values beyond them take the colours of the ends.

    Raises
    ------
    InputError
        The ends are not finite, or not in ascending order.
    """

    label: str
    low: float
    high: float

    def __post_init__(self) -> None:
        if not -np.inf < self.low < self.high < np.inf:
            raise InputError(f"scale: {self.low:g} to {self.high:g} does not ascend; mend its ends")

    def colours(self, values: Array) -> Array:
        """Return the sRGB colours (n, 3) of values (n,)."""
        share = (np.asarray(values, dtype=float) - self.low) / (self.high - self.low)
        share = np.clip(share, 0.0, 1.0)
        knots = np.linspace(0.0, 1.0, len(_RAMP))
        return np.column_stack([np.interp(share, knots, channel) for channel in _RAMP.T])


@dataclass(frozen=True)
class Panel:
    """One picture in a figure.

    Parameters
    ----------
    camera : Camera
        The view.
    shapes : list of Shape
        Surfaces.
    curves : list of Curves
        Lines.
    title, note : str
        A line above the picture, and a fainter one beneath that.
    scale : Scale, optional
        A colour scale to draw at the foot.
    chart : callable, optional
        Draws a chart instead of a scene: called with width, height and the size of the text in
        pixels, it returns a picture.
    """

    camera: Camera
    shapes: list[Shape] = field(default_factory=list)
    curves: list[Curves] = field(default_factory=list)
    title: str = ""
    note: str = ""
    scale: Scale | None = None
    chart: Callable[[int, int, int], Image.Image] | None = None


def figure(
    panels: list[Panel],
    path: Path,
    columns: int,
    panel_size: tuple[int, int] = (520, 600),
    heading: str = "",
) -> None:
    """Draw panels, row by row, and write them as one PNG.

    Parameters
    ----------
    panels : list of Panel
        What to draw.
    path : Path
        The file to write.
    columns : int
        Panels in a row.
    panel_size : (int, int)
        Width and height of a picture in pixels, without its title and scale.
    heading : str
        A line above everything.

    Raises
    ------
    InputError
        There is nothing to draw, or no place for it.
    """
    if not panels or columns < 1 or min(panel_size) < 1:
        raise InputError(
            f"panels: {len(panels)} in {columns} columns of {panel_size} pixels; give some of each"
        )
    width, height = panel_size
    columns = min(columns, len(panels))
    gap = max(width // 60, 4)
    text = max(width // 28, 12)
    margin = text
    top = margin + 2 * text if heading else 0
    lines = sum([any(panel.title for panel in panels), any(panel.note for panel in panels)])
    head = margin + round(1.35 * text * lines) if lines else 0
    foot = 3 * text if any(panel.scale is not None for panel in panels) else 0
    rows = -(-len(panels) // columns)
    step = head + height + foot
    page = Image.new("RGB", (columns * width, top + rows * step), _PAPER)
    pen = ImageDraw.Draw(page)
    if heading:
        pen.text((margin, margin), heading, _INK, _font(round(1.35 * text)))

    def drawn(panel: Panel) -> Image.Image:
        if panel.chart is not None:
            return panel.chart(width - gap, height - gap, text)
        pixels = draw(panel.shapes, panel.curves, panel.camera, width - gap, height - gap)
        return Image.fromarray(np.round(255 * pixels).astype(np.uint8))

    # The kernels and most of NumPy leave the interpreter to other threads.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        pictures = list(pool.map(drawn, panels))
    for number, (panel, picture) in enumerate(zip(panels, pictures, strict=True)):
        left, above = width * (number % columns), top + step * (number // columns)
        page.paste(picture, (left, above + head))
        pen.text((left + margin, above + margin // 2), panel.title, _INK, _font(text))
        pen.text(
            (left + margin, above + margin // 2 + round(1.35 * text)),
            panel.note,
            _FAINT,
            _font(round(0.82 * text)),
        )
        if panel.scale is not None:
            box = (left + margin, above + head + height + text, left + width - margin)
            _draw_scale(pen, panel.scale, box, text)
    page.save(path)


def _draw_scale(
    pen: ImageDraw.ImageDraw, scale: Scale, box: tuple[int, int, int], text: int
) -> None:
    """Draw a colour bar; `box` is left, top and right in pixels."""
    left, top, right = box
    values = np.linspace(scale.low, scale.high, right - left)
    for column, colour in enumerate(scale.colours(values)):
        fill = tuple(round(255 * float(value)) for value in colour)
        pen.line([(left + column, top), (left + column, top + text // 2)], fill)
    font = _font(round(0.82 * text))
    foot = top + 0.75 * text
    pen.text((left, foot), f"{scale.low:.3g}", _FAINT, font)
    pen.text(((left + right) / 2, foot), scale.label, _FAINT, font, anchor="ma")
    pen.text((right, foot), f"{scale.high:.3g}", _FAINT, font, anchor="ra")


def histogram(
    values: Array, weights: Array, scale: Scale, marks: Sequence[tuple[str, float]] = ()
) -> Callable[[int, int, int], Image.Image]:
    """Return a chart of how values are distributed, for `Panel.chart`.

    Parameters
    ----------
    values, weights : (n,) arrays
        The height of a bar is the share of the weights in it.
    scale : Scale
        Range, label and colours; values beyond it count at its ends.
    marks : sequence of (str, float)
        Lines to draw at some values, with what they mean.
    """
    edges = np.linspace(scale.low, scale.high, 41)
    shares = np.histogram(np.clip(values, scale.low, scale.high), edges, weights=weights)[0]
    shares = shares / max(float(shares.sum()), 1e-30)

    def chart(width: int, height: int, text: int) -> Image.Image:
        picture = Image.new("RGB", (width, height), _PAPER)
        pen, font = ImageDraw.Draw(picture), _font(round(0.82 * text))
        left, right, top, foot = 2 * text, width - 2 * text, 3 * text, height - 4 * text
        tallest = max(float(shares.max()), 1e-30)

        def column(value: float) -> float:
            return left + (right - left) * (value - scale.low) / (scale.high - scale.low)

        colours = scale.colours(0.5 * (edges[1:] + edges[:-1]))
        for low, high, share, colour in zip(edges[:-1], edges[1:], shares, colours, strict=True):
            rise = (foot - top) * float(share) / tallest
            box = (column(float(low)) + 1, foot - rise, column(float(high)) - 1, foot)
            pen.rectangle(box, tuple(round(255 * float(value)) for value in colour))
        pen.line([(left, foot), (right, foot)], _FAINT)
        for value in (scale.low, 0.5 * (scale.low + scale.high), scale.high):
            pen.text((column(value), foot + 4), f"{value:.3g}", _FAINT, font, anchor="ma")
        pen.text(((left + right) / 2, foot + 1.5 * text), scale.label, _FAINT, font, anchor="ma")
        pen.text((left, top - 1.5 * text), f"share of the area, up to {tallest:.0%}", _FAINT, font)
        places = [column(min(max(value, scale.low), scale.high)) for _, value in marks]
        for at in places:
            pen.line([(at, top), (at, foot)], _INK)
        for row, (at, (name, value)) in enumerate(zip(places, marks, strict=True)):
            # On the side where there is room, with paper around it: other lines pass behind.
            to_left = at > left + 0.7 * (right - left)
            place = at - 4 if to_left else at + 4, top + 1.2 * text * row
            note, anchor = f"{name} {value:.2f}", "ra" if to_left else "la"
            pen.text(place, note, _INK, font, anchor, stroke_width=3, stroke_fill=_PAPER)
        return picture

    return chart


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)
