"""``modiolus converge``: how much of an expression the mesh and the settings decide."""

from __future__ import annotations

import os
import platform
import sys
from typing import Annotated, Any

import typer

from modiolus.cli.app import HeadName, Json, Quiet, app, examples, show
from modiolus.progress import Progress


@app.command(
    epilog=examples("modiolus converge smile-closed", "modiolus converge sad --refine 0 --json")
)
def converge(
    expression: Annotated[
        str, typer.Argument(metavar="EXPRESSION|FILE.toml", help="A shipped one, or a TOML file.")
    ],
    head: HeadName = "taro",
    finest: Annotated[
        int,
        typer.Option(
            "--refine",
            min=0,
            max=2,
            metavar="N",
            help="Exact refinements along the face; 1 takes minutes, 2 half an hour and 8 GB. "
            "With 0 there are no refined meshes.",
        ),
    ] = 1,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Tell how far mesh, rules and penalties move an expression.

    Each row changes one thing, of mesh, quadrature, penalties and steps, and is compared with the
    default over the skin.
    """
    from modiolus.face.expression import Expression, resolve
    from modiolus.face.head import Head
    from modiolus.face.jaw import opening

    wanted = Expression.named(expression)
    jaw = opening(wanted.jaw_open)
    chosen = Head.load(head)
    activations = resolve(wanted.activations, chosen.muscles)
    from modiolus.mechanics.convergence import Study, discretisation_error, variants

    study = Study(chosen, activations, jaw)
    rows: list[dict[str, Any]] = []
    every = list(variants(finest))
    written = not (as_json or quiet)
    total, done = sum(variant.effort for variant in every), 0.0
    with Progress(f"comparing {wanted.name}", total=total, quiet=quiet) as progress:
        for variant in every:

            def tell(_: float, what: str, done: float = done, name: str = variant.name) -> None:
                # Most begin at the end of the path already: the share says nothing.
                progress.update(done, f"{name}: {what}")

            progress.update(done, variant.name)
            rows.append(study.row(variant, tell))
            done += variant.effort
            if written:
                # Rows stay, whatever becomes of those that take minutes.
                progress.pause()
                sys.stdout.write(("" if rows[1:] else _HEADING) + _line(rows[-1]) + "\n")
                sys.stdout.flush()
        progress.update(total, "done")
    record = {
        "expression": wanted.name,
        "head": chosen.name,
        "cores": os.cpu_count(),
        "machine": platform.machine(),
        "rows": rows,
        "discretisation_error_mm": discretisation_error(rows),
        "refinements": finest,
    }
    show(record, _summary(record), as_json, quiet)


_HEADING = (
    f"{'':22s}{'elements':>9s}{'unknowns':>9s}{'corner':>9s}{'change':>8s}"
    f"{'skin rms':>9s}{'most':>8s}{'solve':>9s}\n"
)


def _line(row: dict[str, Any]) -> str:
    """Lay out a row of the table for reading."""
    line = f"{row['name']:22s}{row['elements']:9d}{row['unknowns']:9d}"
    if not row["converged"]:
        return f"{line}   {row['why']}"
    return (
        line + f"{row['corner_mm']:9.3f}{row['corner_change_mm']:8.3f}"
        f"{row['rms_change_mm']:9.3f}{row['max_change_mm']:8.3f}{row['solve_s']:7.1f} s"
    )


def _summary(record: dict[str, Any]) -> str:
    """Say what the table comes to."""
    parts = "mesh, quadrature and steps" if record["refinements"] else "quadrature and steps alone"
    error = record["discretisation_error_mm"]
    found = "not known, as a part could not be refined" if error is None else f"{error:.3f} mm"
    return (
        f"\nLengths in mm. Discretisation error of {record['expression']} on {record['head']} by "
        f"{parts}, root mean square over the skin: {found}."
    )
