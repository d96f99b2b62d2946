"""The commands and the options that they share."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from modiolus import __version__
from modiolus.cli.outputs import as_text

__all__ = ["app", "show"]

app = typer.Typer(
    name="modiolus",
    help="Muscle-driven faces: from anatomy to an animated head.",
    epilog="Begin with: modiolus simulate smile-closed",
    invoke_without_command=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)

Out = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the results.")]
HeadName = Annotated[
    str, typer.Option("--head", metavar="NAME|DIR", help="A shipped head, or a folder with one.")
]
Json = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on standard output, nothing else.")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no messages.")]


def show(record: Mapping[str, Any], text: str, as_json: bool, quiet: bool) -> None:
    """Print what a command found: as one JSON object, as text, or not at all."""
    if as_json:
        sys.stdout.write(as_text(record) + "\n")
    elif not quiet:
        sys.stdout.write(text + "\n")


def _print_version(wanted: bool) -> None:
    if wanted:
        sys.stdout.write(f"modiolus {__version__}\n")
        raise typer.Exit


@app.callback()
def _modiolus(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and leave."
        ),
    ] = False,
) -> None:
    """Muscle-driven faces: from anatomy to an animated head."""
    if context.invoked_subcommand is None:
        sys.stdout.write(context.get_help() + "\n")


# Each module adds its command to `app`; here at the end, because they need it.
from modiolus.cli import (  # noqa: E402, F401
    beam,
    bench,
    catalogue,
    compare,
    converge,
    export,
    heads,
    identify,
    morph,
    segment,
    simulate,
    upright,
    validate,
    verify,
)
