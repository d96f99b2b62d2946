"""Pictures of a computed face against a measured one, and a page that holds them."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from modiolus.export.scene import FaceScene
from modiolus.export.shape import Shape
from modiolus.hermite.basis import Array
from modiolus.scans.compare import Comparison, Measure
from modiolus.scans.skin import REGIONS
from modiolus.view.face import face_panels
from modiolus.view.figure import Panel, Scale, figure, histogram

__all__ = ["MEASURE_HEADINGS", "cell", "draw_comparison", "measure_rows", "write_page"]


#: The colours of the maps end here (mm), so that pictures of several faces compare.
_HIGHEST = 4.0
_BESIDE = (0.80, 0.80, 0.79)


def draw_comparison(
    scene: FaceScene,
    rest: Array,
    moved: Array,
    comparison: Comparison,
    heading: str,
    path: Path,
    jaw: float = 0.0,
) -> None:
    """Draw measured and computed face, the error on the scan, and its histogram; write a PNG.

    Parameters
    ----------
    scene : FaceScene
    rest, moved : (n_params, 3) arrays
        Parameters of the tissue.
    comparison : Comparison
    heading : str
        A line above the pictures.
    path : Path
        The file to write.
    jaw : float
        Angle in radians by which the jaw is open.
    """
    measure = comparison.distances
    everywhere = np.ones(len(measure.error), dtype=bool)
    scale = Scale("distance of the scan to the model (mm)", 0.0, _HIGHEST)
    surface, shown = comparison.scan.surface, comparison.scan.shown

    def painted(values: Array) -> Shape:
        colours = scale.colours(values)
        colours[~measure.covered] = _BESIDE
        colours = colours[shown]
        return Shape(surface.vertices, surface.faces, colours, "scan", gloss=0.05)

    measured = Shape(surface.vertices, surface.faces, (0.80, 0.74, 0.68), "scan", gloss=0.15)
    maps = [("error", measure.error), ("error of not moving", measure.still)]
    looks = [
        ("measured", [measured], None),
        ("computed", scene.shapes(moved, jaw=jaw), None),
        *((name, [painted(values)], scale) for name, values in maps),
    ]
    panels = []
    for row, (name, values) in zip(
        face_panels(scene, [rest, moved], looks, 1.15), maps, strict=True
    ):
        known = measure.of(values, everywhere)
        chart = histogram(
            values[measure.covered],
            measure.weight[measure.covered],
            scale,
            [("median", known.median), ("rms", known.rms), ("95 %", known.p95)],
        )
        panels += [*row, Panel(row[0].camera, title=name, chart=chart)]
    figure(panels, path, columns=5, panel_size=(400, 470), heading=heading)


_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;color:#222}
img{max-width:100%} table{border-collapse:collapse;margin:1em 0} td,th{padding:.2em .8em;
text-align:right;border-bottom:1px solid #ddd} td:first-child,th:first-child{text-align:left}
.note{color:#666}
"""


def write_page(
    path: Path,
    title: str,
    notes: Sequence[str],
    tables: Sequence[tuple[str, Sequence[str], Sequence[Sequence[object]]]],
    pictures: Sequence[tuple[str, Path]],
) -> None:
    """Write one page of HTML with its pictures inside.

    Parameters
    ----------
    path : Path
        The file to write.
    title : str
    notes : sequence of str
        Paragraphs under the title.
    tables : sequence of (caption, headings, rows)
        Numbers are shown with two decimals, None as a dash.
    pictures : sequence of (caption, Path)
        PNG files.
    """
    parts = [f"<h1>{html.escape(title)}</h1>"]
    for caption, file in pictures:
        data = base64.b64encode(file.read_bytes()).decode("ascii")
        alt = html.escape(caption)
        parts.append(f'<figure><img alt="{alt}" src="data:image/png;base64,{data}"></figure>')
    parts += [f'<p class="note">{html.escape(note)}</p>' for note in notes]
    for caption, headings, rows in tables:
        head = "".join(f"<th>{html.escape(text)}</th>" for text in headings)
        body = "".join(
            "<tr>" + "".join(f"<td>{html.escape(cell(value))}</td>" for value in row) + "</tr>"
            for row in rows
        )
        parts.append(f"<h2>{html.escape(caption)}</h2><table><tr>{head}</tr>{body}</table>")
    path.write_text(
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}'
        f"</title><style>{_STYLE}</style></head><body>{''.join(parts)}</body></html>\n",
        encoding="utf-8",
    )


def measure_rows(measure: Measure) -> list[list[object]]:
    """Return the rows of a table: the whole, where the scan is known to move, and the regions."""
    everywhere = np.ones(len(measure.error), dtype=bool)
    places = [("whole", everywhere)]
    if not measure.moved.all():
        places.append(("where the scan moved", measure.moved))
    places += [(name.replace("_", " "), measure.region == k) for k, name in enumerate(REGIONS)]
    rows: list[list[object]] = []
    for name, where in places:
        found, still = measure.of(measure.error, where), measure.of(measure.still, where)
        if found.points:
            rows.append(
                [name, found.rms, found.mean, found.median, found.p95, found.max, still.rms]
            )
    return rows


#: Headings of `measure_rows`.
MEASURE_HEADINGS = ("mm", "rms", "mean", "median", "95 %", "max", "rms of not moving")


def cell(value: object) -> str:
    """Return a number with two decimals, and a dash for what is not known."""
    if value is None or (isinstance(value, float) and not np.isfinite(value)):
        return "–"
    return f"{value:.2f}" if isinstance(value, float) else str(value)
