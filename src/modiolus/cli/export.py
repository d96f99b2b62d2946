"""``modiolus export``: a head or a result for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modiolus.cli.app import Json, Quiet, app, show
from modiolus.cli.outputs import whole_folder, write_report
from modiolus.errors import InputError


@app.command(epilog="Examples: modiolus export taro --ex out/ex · modiolus export out/sad --ex ex")
def export(
    source: Annotated[
        str,
        typer.Argument(
            metavar="HEAD|RESULT",
            help="A shipped head, a folder with one, or a folder that simulate wrote.",
        ),
    ],
    ex: Annotated[
        Path | None,
        typer.Option(
            "--ex", metavar="DIR", help="Folder for EX files: tissue and muscles with their fibres."
        ),
    ] = None,
    cmgui: Annotated[
        bool,
        typer.Option("--cmgui", help="Write the older .exnode and .exelem instead of .exf."),
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write tissue and muscles of a head, at rest and as computed, as EX files.

    Zinc, its applications and CMGUI read them.
    """
    if ex is None:
        raise InputError("--ex: no folder given; name one, such as --ex out/ex")
    from modiolus.export.ex import write_head_ex
    from modiolus.face.head import Head
    from modiolus.scans.result import STATE_FILE, load_result

    parameters = None
    if (Path(source) / STATE_FILE).is_file():
        result = load_result(source)
        head, parameters = result.head, result.parameters
        if len(parameters) != head.tissue.n_params:
            head = head.whole
    else:
        head = Head.load(source)
    with whole_folder(ex, marker="report.json", option="--ex") as folder:
        files = write_head_ex(head, folder, parameters, cmgui)
        (folder / "LICENSE").write_text(head.licence_text(), encoding="utf-8")
        places = {name: str(ex / path.name) for name, path in files.items()}
        record = {
            "head": head.name,
            "elements": head.tissue.n_elements,
            "muscles": list(head.muscles),
            "fields": ["coordinates", *([] if parameters is None else ["deformed"]), "fibres"],
            "files": places,
        }
        write_report(folder, record)
    lines = [f"{head.name}: {head.tissue.n_elements} elements, {len(head.muscles)} muscles"]
    lines += [f"{name}: {path}" for name, path in places.items()]
    show(record, "\n".join(lines), as_json, quiet)
