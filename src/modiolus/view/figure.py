"""Figures: panels of drawn scenes with titles and a colour scale, written as one picture."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from modiolus.export.shape import Shape
from modiolus.view.raster import BACKGROUND, Camera, Curves, draw

__all__ = ["Panel", "Scale", "figure"]

Floats = NDArray[np.float64]

_INK = (38, 38, 42)
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
    """

    label: str
    low: float
    high: float

    def colours(self, values: Floats) -> Floats:
        """Return the sRGB colours (n, 3) of values (n,)."""
        span = max(self.high - self.low, 1e-30)
        share = np.clip((np.asarray(values, dtype=float) - self.low) / span, 0.0, 1.0)
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
    """

    camera: Camera
    shapes: list[Shape] = field(default_factory=list)
    curves: list[Curves] = field(default_factory=list)
    title: str = ""
    note: str = ""
    scale: Scale | None = None


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
    """
    width, height = panel_size
    columns = min(columns, len(panels))
    gap = max(width // 60, 4)
    text = max(width // 28, 12)
    margin = text
    top = margin + 2 * text if heading else 0
    title = sum([any(panel.title for panel in panels), any(panel.note for panel in panels)])
    head = margin + round(1.35 * text * title) if title else 0
    foot = 3 * text if any(panel.scale is not None for panel in panels) else 0
    rows = -(-len(panels) // columns)
    step = head + height + foot
    background = tuple(round(255 * value) for value in BACKGROUND)
    page = Image.new("RGB", (columns * width, top + rows * step), background)
    pen = ImageDraw.Draw(page)
    if heading:
        pen.text((margin, margin), heading, _INK, _font(round(1.35 * text)))
    for number, panel in enumerate(panels):
        left, above = width * (number % columns), top + step * (number // columns)
        pixels = draw(panel.shapes, panel.curves, panel.camera, width - gap, height - gap)
        page.paste(Image.fromarray(np.round(255 * pixels).astype(np.uint8)), (left, above + head))
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


def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)
