"""The commands and the options that they share."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modiolus import __version__
from modiolus.cli.outputs import as_text
from modiolus.errors import InputError, unknown_name

if TYPE_CHECKING:
    from modiolus.mechanics.face import FaceSettings

__all__ = ["app", "assignments", "examples", "face_settings", "help_alone", "show"]

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
# The names and usual values are those of `FaceSettings`, which is too slow to import for a help.
Setting = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="A parameter of the face in place of its usual value; repeatable: muscle=wu2013, "
        "passive=1, fat=1, sigma_max=300 kPa, kappa=80 kPa, modiolus=30 kPa, skin=3 kPa, "
        "contact=250 kPa/mm, slide=0.05, reach=2 mm, gauss_order=4.",
    ),
]
Json = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on standard output, nothing else.")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no messages.")]


def examples(*commands: str) -> str:
    """Return the end of a command's help: examples to copy, one a line."""
    # The first character keeps the lines as they are.
    return "\n".join(["\b", "Examples:" if len(commands) > 1 else "Example:", *commands])


def show(record: Mapping[str, Any], text: str, as_json: bool, quiet: bool) -> None:
    """Print what a command found: as one JSON object, as text, or not at all."""
    if as_json:
        sys.stdout.write(as_text(record) + "\n")
    elif not quiet:
        sys.stdout.write(text + "\n")


def assignments(
    option: str, texts: Sequence[str], example: str, kind: Callable[[str], type]
) -> dict[str, Any]:
    """Return what an option like ``name=value`` says.

    Parameters
    ----------
    option : str
        Its name, for messages.
    texts : sequence of str
        What was given.
    example : str
        A sound one.
    kind : callable
        The type of a name's value; raises `InputError` where there is no such name.

    Raises
    ------
    InputError
        A text has no name, or no value of that type.
    """
    found = {}
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals:
            raise InputError(f"{option} {text}: not of the form name=value; write, say, {example}")
        wanted = kind(name)
        try:
            found[name] = wanted(value)
        except ValueError:
            what = "whole number" if wanted is int else "number"
            raise InputError(f"{option} {text}: {value!r} is no {what}; give one") from None
    return found


def face_settings(texts: Sequence[str]) -> FaceSettings:
    """Return the parameters of the face, some of them as `Setting` says.

    Raises
    ------
    InputError
        There is no such parameter, or it cannot have that value.
    """
    from modiolus.mechanics.face import FaceSettings

    usual = {item.name: item.default for item in fields(FaceSettings)}

    def kind(name: str) -> type:
        if name not in usual:
            raise unknown_name("setting", name, usual)
        return type(usual[name])

    changed = assignments("--set", texts, "sigma_max=250", kind)
    try:
        return FaceSettings(**changed)
    except InputError as error:
        raise InputError(f"--set {error}") from None


def help_alone(context: typer.Context) -> None:
    """Print the help of a group of commands when none of them follows."""
    if context.invoked_subcommand is None:
        sys.stdout.write(context.get_help() + "\n")


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
    help_alone(context)
