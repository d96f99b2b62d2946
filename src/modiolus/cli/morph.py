"""``modiolus morph``: a head for another face."""

from __future__ import annotations

import math
import shutil
import sys
from pathlib import Path
from typing import Annotated

import typer

from modiolus.cli.app import Json, Quiet, app, show
from modiolus.cli.outputs import whole_folder, write_report
from modiolus.errors import InputError, SolveError
from modiolus.files import folder_name
from modiolus.progress import Progress


@app.command(
    epilog="Examples: modiolus morph taro --to face.ply --out heads/anna · "
    "modiolus morph taro --to face.obj --landmarks points.csv --out heads/anna --json"
)
def morph(
    head: Annotated[
        str, typer.Argument(metavar="HEAD", help="A shipped head, or a folder with one.")
    ],
    to: Annotated[
        Path, typer.Option("--to", metavar="SURFACE", help="Skin of a face: PLY, STL or OBJ.")
    ],
    landmarks: Annotated[
        Path | None,
        typer.Option(
            metavar="CSV",
            help="Landmarks on the surface: columns name (of the head's landmarks) or "
            "multi_pie_index, and x, y, z. Without them the pose is found.",
        ),
    ] = None,
    notice: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Licence of the surface, to lie beside the head."),
    ] = None,
    subject: Annotated[
        str, typer.Option(metavar="TEXT", help="Who it is, for the head's description.")
    ] = "",
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the head.")] = Path(
        "head"
    ),
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Morph a head to the surface of a face and write it into the folder DIR.

    The surface may have any pose and be in mm, cm or m. The head is called what the folder is
    called. When the result fails one of its gates nothing is written and the exit code is 1.
    """
    from modiolus.anatomy.surface import read_surface
    from modiolus.face.head import Head
    from modiolus.face.landmarks import read_landmarks
    from modiolus.face.morph import gates, morph_head, quality_text

    source = Head.load(head)
    surface = read_surface(to)
    pairs = None if landmarks is None else read_landmarks(landmarks, source)
    if notice is not None and not notice.is_file():
        raise InputError(f"--notice {notice}: no such file; check the path")
    name = folder_name("--out", out.resolve().name)
    with whole_folder(out, marker="head.toml") as folder:
        with Progress(f"morphing {source.name}", quiet=quiet) as progress:
            morphed, quality = morph_head(source, surface, pairs, progress.update, name)
        failed = [gate for gate in gates(quality) if not gate.passed]
        if failed:
            if not quiet:
                sys.stderr.write(quality_text(quality) + "\n")
            faults = ", ".join(f"{gate.name} is {gate.value:g}" for gate in failed)
            raise SolveError(
                f"{to}: the morphed head is not sound ({faults}); nothing was written; give "
                "landmarks, or a scan that shows more of the face"
            )
        about = dict(source.about)
        about["subject"] = subject or f"the face of {to.name}"
        about["source"] = f"{about.get('source', source.name)}; surface {to.name}"
        about["changes"] = (
            f"{about.get('changes', '')}; morphed from {source.name} to the surface {to.name}"
        ).lstrip("; ")
        if notice is not None:
            about["attribution"] = (
                f"{about.get('attribution', '')} The surface of the face is under the licence in "
                "LICENSE-surface."
            ).lstrip()
            shutil.copyfile(notice, folder / "LICENSE-surface")
        about["morphed_from"] = source.name
        about["quality"] = quality
        morphed.about.update(about)
        morphed.save(folder)
        verdicts = [
            {
                "name": gate.name,
                "value": gate.value,
                "low": gate.low,
                "high": gate.high if math.isfinite(gate.high) else None,
                "passed": gate.passed,
            }
            for gate in gates(quality)
        ]
        record = {
            "head": name,
            "morphed_from": source.name,
            "quality": quality,
            "gates": verdicts,
            "files": {"folder": str(out)},
        }
        write_report(folder, record)
    text = f"{quality_text(quality)}\n\nHead: {out}"
    text += f"\nUse it with: modiolus simulate smile-closed --head {out}"
    show(record, text, as_json, quiet)
