"""``modiolus compare``: a computed face against a measured one."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modiolus.cli.app import Json, Quiet, app, examples, show
from modiolus.cli.outputs import own_heads, whole_folder, write_report
from modiolus.progress import Progress

if TYPE_CHECKING:
    from modiolus.scans.compare import Comparison

Unit = Annotated[
    str, typer.Option("--unit", metavar="um|mm|cm|in|m", help="Of the scans; found by default.")
]
Landmarks = Annotated[
    Path | None,
    typer.Option("--landmarks", metavar="CSV", help="Places on the scan, to align it by."),
]


@app.command(
    epilog=examples("modiolus compare out/smile-closed --scan smile.ply --neutral neutral.ply")
)
def compare(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="A folder that modiolus simulate wrote.")
    ],
    scan: Annotated[Path, typer.Option("--scan", metavar="FILE", help="The measured face.")],
    neutral: Annotated[
        Path | None,
        typer.Option("--neutral", metavar="FILE", help="The same person at rest."),
    ] = None,
    landmarks: Landmarks = None,
    unit: Unit = "",
    head: Annotated[
        str, typer.Option("--head", metavar="NAME|DIR", help="Where the result's head is now.")
    ] = "",
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder for the page; RESULT/compare-<scan>."),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compare a computed face with a scan, region by region.

    Writes compare.png, compare.html and report.json.
    """
    began = time.perf_counter()
    from modiolus.scans.result import load_result
    from modiolus.scans.scan import known_unit, read_scan

    known_unit(unit)
    computed = load_result(result, head or None)
    measured = read_scan(scan)
    resting = None if neutral is None else read_scan(neutral)
    target = out or result / f"compare-{scan.stem}"
    title = f"{computed.expression} on {computed.head.name} against {scan.name}"
    with whole_folder(target, "compare.html", sources=(result, scan, *own_heads(head))) as folder:
        from modiolus.export.scene import FaceScene
        from modiolus.face.landmarks import read_landmarks
        from modiolus.scans.align import place
        from modiolus.scans.compare import compare as measure
        from modiolus.scans.skin import Skin
        from modiolus.view.compare import draw_comparison

        skin, picture = Skin(computed.head), folder / "compare.png"
        with Progress(f"aligning {scan.name}", quiet=quiet) as progress:
            pairs = None if landmarks is None else read_landmarks(landmarks, computed.head)
            placed, at_rest, alignment = place(measured, skin, resting, unit or None, pairs)
            progress.update(0.7, "measuring")
            found = measure(skin, computed.parameters, placed, at_rest)
            progress.update(0.8, "drawing")
            scene, rest = FaceScene(computed.head), computed.head.tissue.parameters
            draw_comparison(scene, rest, computed.parameters, found, title, picture, computed.jaw)
            progress.update(1.0)
        names = {"picture": "compare.png", "page": "compare.html", "report": "report.json"}
        record: dict[str, Any] = {
            "expression": computed.expression,
            "head": computed.head.name,
            "scan": str(scan),
            "neutral": None if neutral is None else str(neutral),
            "alignment": alignment.as_dict(),
            **found.as_dict(),
            "seconds": round(time.perf_counter() - began, 3),
            "files": {kind: str(target / name) for kind, name in names.items()},
        }
        text = _write_page(folder, title, found, record)
        write_report(folder, record)
    show(record, f"{text}\nPage: {record['files']['page']}", as_json, quiet)


def _write_page(folder: Path, title: str, found: Comparison, record: Mapping[str, Any]) -> str:
    """Write ``compare.html`` and return what it says, as text."""
    from modiolus.view.compare import MEASURE_HEADINGS, measure_rows, write_page

    rows = measure_rows(found.distances)
    tables = [("Distance of the scan to the model", MEASURE_HEADINGS, rows)]
    if found.matched is not None:
        matched = measure_rows(found.matched)
        tables.append(("Difference of the displacements", MEASURE_HEADINGS, matched))
    notes = [describe_alignment(record["alignment"]), describe_measures(record)]
    pictures = [("error maps", folder / "compare.png")]
    write_page(folder / "compare.html", title, notes, tables, pictures)
    return f"{title}\n\n{text_table(MEASURE_HEADINGS, rows)}\n\n{' '.join(notes)}"


def text_table(headings: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a table as plain text, numbers to the right and words to the left."""
    from modiolus.view.compare import cell

    cells = [list(headings), *[[cell(value) for value in row] for row in rows]]
    widths = [max(len(row[k]) for row in cells) for k in range(len(headings))]
    words = [any(isinstance(row[k], str) for row in rows) for k in range(len(headings))]
    return "\n".join(
        "  ".join(
            text.ljust(width) if words[k] else text.rjust(width)
            for k, (text, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in cells
    )


def describe_alignment(record: Mapping[str, Any]) -> str:
    """Say in a sentence how the scan was aligned."""
    zones = ", ".join(
        f"{name.replace('_', ' ')} {value:.2f} mm" for name, value in record["zones"].items()
    )
    if not zones:
        return (
            "Aligned by the whole face: of the parts that keep still too little is in the scan, or "
            "they are too unlike the head's."
        )
    return (
        "Aligned on the parts that keep still; left out one at a time, they move the face by "
        f"{zones}."
    )


def describe_measures(record: Mapping[str, Any]) -> str:
    """Say in a few sentences how far the model explains the scan."""
    text = f"{record['coverage']:.0%} of the scan's area has a counterpart on the model."
    if record["explained"] is not None and record["neutral"] is not None:
        text += (
            f" Where the scan moved by more than 1 mm, the model explains "
            f"{record['explained']:.0%} of the distance that is left without moving"
        )
        if record["matched"] is not None:
            text += f", and {record['matched']['explained']:.0%} of the displacement of its points"
        text += "."
    return text
