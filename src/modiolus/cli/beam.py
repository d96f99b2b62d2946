"""``modiolus beam``: a slab of muscle bends and twists a beam."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from modiolus.cli.app import Json, Out, Quiet, app, examples, show
from modiolus.cli.outputs import whole_folder, write_report
from modiolus.errors import InputError
from modiolus.progress import Progress


@app.command(epilog=examples("modiolus beam --angle 36 --out out"))
def beam(
    angle: Annotated[
        float,
        typer.Option("--angle", metavar="DEGREES", help="Of the fibres to the axis of the beam."),
    ] = 36.0,
    activation: Annotated[
        float, typer.Option("--activation", metavar="VALUE", help="Of the muscle, 0 to 1.")
    ] = 0.02,
    out: Out = Path("out"),
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Bend and twist a beam with a slab of muscle inside it.

    Fibres along the beam (0 degrees) bend it; at 36 and 60 degrees they also twist it.
    """
    if not -90.0 <= angle <= 90.0:
        raise InputError(f"--angle {angle:g}: not within -90 to 90 degrees; mend it")
    if not 0.0 <= activation <= 1.0:
        raise InputError(f"--activation {activation:g}: not within 0 to 1; mend it")
    began = time.perf_counter()
    name = f"beam-{angle:g}"
    with whole_folder(out / name, marker="report.json") as folder:
        from modiolus.mechanics.beam import bend_beam
        from modiolus.view.beam import draw_beam

        with Progress(f"beam at {angle:g}°", quiet=quiet) as progress:
            result = bend_beam(angle, activation, progress.update)
        draw_beam(result, folder / "beam.png")
        statistics = result.state.statistics
        record = {
            "angle_deg": angle,
            "activation": activation,
            "converged": statistics.converged,
            "elements": result.state.reference.n_elements,
            "steps": statistics.steps,
            "newton_iterations": statistics.newton_iterations,
            "solve_s": round(statistics.solve_s, 3),
            "wall_s": round(time.perf_counter() - began, 3),
            "J_min": statistics.J_min,
            "J_max": statistics.J_max,
            "volume_change": statistics.volume_change,
            "tip_displacement": np.round(result.tip, 4).tolist(),
            "bend_deg": round(result.bend, 3),
            "twist_deg": round(result.twist, 3),
            "files": {
                "picture": str(out / name / "beam.png"),
                "report": str(out / name / "report.json"),
            },
        }
        write_report(folder, record)
    show(
        record,
        f"Bent by {result.bend:.1f}° and twisted by {result.twist:.1f}°.\n"
        f"Picture: {out / name / 'beam.png'}\nReport:  {out / name / 'report.json'}",
        as_json,
        quiet,
    )
