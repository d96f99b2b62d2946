"""``modiolus morph``: a head for another face."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modiolus.cli.app import Json, Quiet, app, examples, show
from modiolus.cli.outputs import own_heads, use_of, whole_folder, write_report
from modiolus.errors import InputError, SolveError
from modiolus.files import folder_name
from modiolus.progress import Progress

if TYPE_CHECKING:
    from modiolus.face.head import Head


@app.command(
    epilog=examples(
        "modiolus morph taro --to face.ply --out heads/anna",
        "modiolus morph taro --to face.obj --landmarks points.csv --out heads/anna --json",
    )
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
    """Morph a head to the surface of a face.

    The surface may have any pose and be in mm, cm or m. The head is called what the folder is
    called. When the result fails one of its gates nothing is written and the exit code is 1.
    """
    from modiolus.anatomy.surface import read_surface
    from modiolus.face.head import Head
    from modiolus.face.landmarks import read_landmarks
    from modiolus.face.subject import Structures, build_subject

    source = Head.load(head)
    surface = replace(read_surface(to), name=to.name)
    pairs = None if landmarks is None else read_landmarks(landmarks, source)
    if notice is not None and not notice.is_file():
        raise InputError(f"--notice {notice}: no such file; check the path")
    name = folder_name("--out", out.resolve().name)
    with whole_folder(out, "head.toml", sources=(to, *own_heads(head))) as folder:
        with Progress(f"morphing {source.name}", quiet=quiet) as progress:
            morphed, quality = build_subject(
                source, Structures(surface), pairs, progress.update, name
            )
        change = f"morphed from {source.name} to the surface {to.name}"
        origin = Origin(f"surface {to.name}", change, subject or f"the face of {to.name}", notice)
        record = finish(morphed, source, quality, origin, folder, out, quiet)
    show(record, account(record, morphed, out), as_json, quiet)


@dataclass(frozen=True)
class Origin:
    """What a head was made from.

    Attributes
    ----------
    source : str
        The files.
    change : str
        What was done with them.
    subject : str
        Whose head it is.
    notice : Path or None
        The licence of the files.
    """

    source: str
    change: str
    subject: str
    notice: Path | None


def finish(
    made: Head,
    source: Head,
    quality: dict[str, Any],
    origin: Origin,
    folder: Path,
    out: Path,
    quiet: bool,
) -> dict[str, Any]:
    """Write a head that was carried over from another, if it passes its gates.

    Parameters
    ----------
    made, source : Head
        The new head, and the one that it was carried over from.
    quality : dict
        Of `modiolus.face.subject.build_subject`.
    origin : Origin
    folder, out : Path
        Where to write, and where the files will be found in the end.
    quiet : bool
        No table of what failed.

    Returns
    -------
    dict
        The record of the command, which is also in ``report.json``.

    Raises
    ------
    SolveError
        A gate is failed.
    """
    from modiolus.face.gates import gates, quality_text

    failed = [gate for gate in gates(quality) if not gate.passed]
    if failed:
        if not quiet:
            sys.stderr.write(quality_text(quality) + "\n")
        faults = ", ".join(f"{gate.name} is {gate.value:g}" for gate in failed)
        raise SolveError(
            f"{origin.source}, taken as in {quality['unit']}: the head is not sound ({faults}); "
            "nothing was written; give landmarks, or a scan that shows more of the face"
        )
    about = dict(source.about)
    about["subject"] = origin.subject
    about["source"] = f"{about.get('source', source.name)}; {origin.source}"
    about["changes"] = f"{about.get('changes', '')}; {origin.change}".lstrip("; ")
    if origin.notice is not None:
        text = origin.notice.read_text(encoding="utf-8", errors="replace")
        credit = f"The surface of the face: {_holders(text)}, under the licence in LICENSE-surface."
        about["attribution"] = f"{about.get('attribution', '')} {credit}".lstrip()
        (folder / "LICENSE-surface").write_text(text, encoding="utf-8")
    about["morphed_from"] = source.name
    about["quality"] = quality
    made.about.update({**about, "provenance": made.about["provenance"]})
    made.save(folder)
    record = {
        "head": made.name,
        "morphed_from": source.name,
        "provenance": made.about["provenance"],
        "quality": quality,
        "gates": [
            {
                "name": gate.name,
                "value": gate.value,
                "low": gate.low,
                "high": gate.high if math.isfinite(gate.high) else None,
                "passed": gate.passed,
            }
            for gate in gates(quality)
        ],
        "files": {"folder": str(out)},
    }
    write_report(folder, record)
    return record


def _holders(notice: str) -> str:
    """Return the first line of a licence, which names it, and its lines of copyright."""
    lines = [line.strip() for line in notice.splitlines() if line.strip()]
    holders = [line for line in lines if line.lower().startswith(("copyright", "(c)", "©"))]
    return ", ".join(dict.fromkeys([*lines[:1], *holders[:3]])) or "its makers"


def account(record: Mapping[str, Any], made: Head, out: Path) -> str:
    """Return the figures of a head and what of it was given, for a person to read."""
    from modiolus.face.gates import quality_text
    from modiolus.face.provenance import provenance_lines

    quality = record["quality"]
    lines = "\n".join(provenance_lines(made.about))
    return (
        f"The surface is in {quality['unit']}, as its size tells; its face is "
        f"{quality['size']:.2f} times as large as that of {record['morphed_from']}.\n\n"
        f"{quality_text(quality)}\n\n{lines}\n\n{use_of(out)}"
    )
