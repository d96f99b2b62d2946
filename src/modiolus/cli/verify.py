"""``modiolus verify``: computations whose results are known."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modiolus.cli.app import Json, Quiet, app, examples, show
from modiolus.errors import SolveError
from modiolus.progress import Progress

if TYPE_CHECKING:
    from modiolus.verify import Check


@app.command(epilog=examples("modiolus verify patch land-1"))
def verify(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="CASE", help="All cases by default.")
    ] = None,
    fine: Annotated[
        bool, typer.Option("--fine", help="Also on finer meshes; this takes some minutes.")
    ] = False,
    listing: Annotated[bool, typer.Option("--list", help="Say what the cases are.")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Check the mechanics against known solutions.

    These are closed forms, published results and the mechanics itself. Every case runs through
    the same code as the face. The exit code is 1 when a check fails.
    """
    from modiolus.verify import Check, choose

    cases = choose(names or [])
    if listing:
        about = [{"case": case.name, "says": case.says} for case in cases]
        text = "\n".join(f"{case.name:22s}{case.says}" for case in cases)
        show({"cases": about}, text, as_json, quiet)
        return
    rows: list[tuple[str, Check]] = []
    with Progress("verifying", total=len(cases), quiet=quiet) as progress:
        for done, case in enumerate(cases):
            progress.update(done, case.name)
            try:
                rows += [(case.name, check) for check in case.run(fine)]
            except SolveError as error:
                rows.append((case.name, Check(f"no solution: {error}", math.nan, math.nan, 0.0)))
        progress.update(len(cases), "done")
    failed = sum(not check.passed for _, check in rows)
    record = {"cases": [_record(name, check) for name, check in rows]}
    show(record, _table(rows) if not as_json and not quiet else "", as_json, quiet)
    if failed:
        raise typer.Exit(1)


def _record(name: str, check: Check) -> dict[str, Any]:
    return {
        "case": name,
        "quantity": check.quantity,
        "expected": check.expected,
        "got": check.got,
        "error": check.error,
        "tolerance": check.tolerance,
        "relative": check.relative,
        "verdict": "pass" if check.passed else "fail",
    }


def _table(rows: list[tuple[str, Check]]) -> str:
    """Lay the checks out for reading."""
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for title in ("case", "quantity"):
        table.add_column(title, overflow="fold")
    for title in ("expected", "got", "error", "tolerance"):
        table.add_column(title, justify="right", no_wrap=True)
    table.add_column("verdict")
    last = ""
    for name, check in rows:
        table.add_row(
            name if name != last else "",
            check.quantity,
            ("≥ " if check.at_least else "") + f"{check.expected:.7g}",
            f"{check.got:.7g}",
            f"{check.error:.1e}",
            f"{check.tolerance:g}" + (" rel." if check.relative else ""),
            "pass" if check.passed else "[bold red]FAIL[/]",
        )
        last = name
    console = Console(width=None if Console().is_terminal else 140)
    with console.capture() as capture:
        console.print(table)
    failed = sum(not check.passed for _, check in rows)
    return f"{capture.get()}\n{len(rows)} checks, {failed} failed"
