"""``modiolus identify``: activations from a scan."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from modiolus.cli.app import HeadName, Json, Out, Quiet, app, show
from modiolus.cli.compare import (
    Landmarks,
    Unit,
    describe_alignment,
    describe_measures,
    text_table,
)
from modiolus.cli.outputs import whole_folder, write_report
from modiolus.errors import InputError
from modiolus.progress import Progress


@app.command(
    epilog="Example: modiolus identify --head heads/anna --scan smile.ply --neutral neutral.ply "
    "--muscles smile-closed"
)
def identify(
    scan: Annotated[Path, typer.Option("--scan", metavar="FILE", help="The measured face.")],
    neutral: Annotated[
        Path | None,
        typer.Option("--neutral", metavar="FILE", help="The same person at rest."),
    ] = None,
    muscles: Annotated[
        str,
        typer.Option(
            "--muscles",
            metavar="NAME,…",
            help="Those that may contract: muscles, or an expression of the paper's table 2.",
        ),
    ] = "all",
    prior: Annotated[
        str,
        typer.Option(
            "--prior", metavar="NAME,…", help="Those that are expected; the others cost more."
        ),
    ] = "",
    landmarks: Landmarks = None,
    unit: Unit = "",
    head: HeadName = "taro",
    out: Out = Path("out"),
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find the activations with which a head looks like a scan.

    The head should be that of the person (see modiolus morph). Writes OUT/identify-<scan>/ with
    <scan>.toml, an expression for modiolus simulate, compare.png, compare.html and report.json.
    """
    began = time.perf_counter()
    from modiolus.face.head import Head
    from modiolus.scans.identify import muscle_set
    from modiolus.scans.scan import known_unit, read_scan

    known_unit(unit)
    chosen = Head.load(head)
    free = list(chosen.muscles) if muscles == "all" else muscle_set(_names(muscles), chosen)
    if not free:
        raise InputError("--muscles: none given; name some, an expression, or all")
    expected = muscle_set(_names(prior), chosen) if prior else []
    measured = read_scan(scan)
    resting = None if neutral is None else read_scan(neutral)
    target = out / f"identify-{scan.stem}"
    with whole_folder(target, marker="report.json") as folder:
        from modiolus.export.scene import FaceScene
        from modiolus.face.landmarks import read_landmarks
        from modiolus.mechanics.face import face_problem
        from modiolus.scans.align import place
        from modiolus.scans.compare import compare as measure
        from modiolus.scans.identify import identify as search
        from modiolus.scans.result import STATE_FILE, save_state
        from modiolus.scans.skin import Skin
        from modiolus.view.compare import (
            MEASURE_HEADINGS,
            draw_comparison,
            measure_rows,
            write_page,
        )

        skin = Skin(chosen)
        with Progress(f"identifying {scan.name}", quiet=quiet) as progress:
            pairs = None if landmarks is None else read_landmarks(landmarks, chosen)
            placed, at_rest, alignment = place(measured, skin, resting, unit or None, pairs)
            found = search(
                face_problem(chosen),
                chosen,
                placed,
                skin=skin,
                muscles=free,
                prior=expected,
                neutral=at_rest,
                report=progress.update,
            )
        result = measure(skin, found.state.parameters, placed.placed(found.pose), at_rest)
        title = f"{scan.stem} on {chosen.name}, activations identified"
        draw_comparison(
            FaceScene(chosen),
            chosen.tissue.parameters,
            found.state.parameters,
            result,
            title,
            folder / "compare.png",
        )
        expression = folder / f"{scan.stem}.toml"
        expression.write_text(expression_toml(scan.stem, scan.name, found), encoding="utf-8")
        save_state(
            folder / STATE_FILE,
            scan.stem,
            chosen,
            str(Path(head).resolve()) if Path(head, "head.toml").is_file() else head,
            found.state.parameters,
            found.state.pressure,
            found.state.activations,
            0.0,
        )
        record: dict[str, Any] = {
            "scan": str(scan),
            "neutral": None if neutral is None else str(neutral),
            "head": chosen.name,
            **identified(found),
            "alignment": alignment.as_dict(),
            **result.as_dict(),
            "seconds": round(time.perf_counter() - began, 3),
            "files": {
                "expression": str(target / expression.name),
                "state": str(target / STATE_FILE),
                "picture": str(target / "compare.png"),
                "page": str(target / "compare.html"),
                "report": str(target / "report.json"),
            },
        }
        rows = activation_rows(record)
        notes = [
            describe_alignment(record["alignment"]),
            describe_measures(record),
            describe_certainty(record),
        ]
        write_page(
            folder / "compare.html",
            title,
            notes,
            [
                ("Activations", ACTIVATION_HEADINGS, rows),
                (
                    "Distance of the scan to the model",
                    MEASURE_HEADINGS,
                    measure_rows(result.distances),
                ),
            ],
            [("error maps", folder / "compare.png")],
        )
        write_report(folder, record)
    files = record["files"]
    show(
        record,
        f"{title}: {record['error']['rms_mm']:.2f} mm rms after {record['solves']} solves\n\n"
        f"{text_table(ACTIVATION_HEADINGS, rows)}\n\n{' '.join(notes)}\n"
        f"Expression: {files['expression']}\nPage:       {files['page']}",
        as_json,
        quiet,
    )


#: Headings of `activation_rows`.
ACTIVATION_HEADINGS = ("muscle", "activation", "standard deviation")


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def identified(found: Any) -> dict[str, Any]:
    """Return what an identification found, for a report."""
    return {
        "activations": {name: round(a, 5) for name, a in found.activations.items()},
        "deviations": {name: round(d, 5) for name, d in found.deviations.items()},
        "correlated": [list(pair) for pair in found.correlated],
        "not_identifiable": list(found.unsure),
        "history_mm": [round(value, 4) for value in found.history],
        "solves": found.solves,
    }


def activation_rows(record: dict[str, Any]) -> list[list[object]]:
    """Return the rows of a table of activations, the greatest first."""
    order = sorted(record["activations"], key=lambda name: -record["activations"][name])
    return [
        [name.replace("_", " "), record["activations"][name], record["deviations"][name]]
        for name in order
    ]


def describe_certainty(record: dict[str, Any]) -> str:
    """Say which activations the scan does not tell."""
    parts = []
    if record["not_identifiable"]:
        parts.append(f"The scan does not tell those of {', '.join(record['not_identifiable'])}.")
    if record["correlated"]:
        pairs = ", ".join(f"{a} and {b} ({c:+.2f})" for a, b, c in record["correlated"][:5])
        parts.append(f"Hardly to be told apart: {pairs}.")
    return " ".join(parts).replace("_", " ")


def expression_toml(name: str, source: str, found: Any) -> str:
    """Return identified activations as an expression for ``modiolus simulate``."""
    lines = [f"title = {json.dumps(name)}", f"source = {json.dumps('identified from ' + source)}"]
    lines += ["", "[activations]"]
    active = {name: a for name, a in found.activations.items() if a >= 5e-6}
    if not active:
        first = next(iter(found.activations))
        active = {first: 0.0}
    lines += [f"{name} = {float(np.round(a, 5))!r}" for name, a in active.items()]
    return "\n".join(lines) + "\n"
