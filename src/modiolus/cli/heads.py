"""``modiolus heads``, ``head`` and ``build``: what heads there are, and making one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from modiolus.cli.app import HeadName, Json, Out, Quiet, app, show
from modiolus.cli.outputs import whole_folder
from modiolus.errors import InputError
from modiolus.files import folder_name
from modiolus.progress import Progress

_head = typer.Typer(help="Look at a head.", rich_markup_mode=None, no_args_is_help=True)
app.add_typer(_head, name="head")


@app.command(epilog="Examples: modiolus heads · modiolus heads heads/ --json")
def heads(
    folder: Annotated[
        Path | None,
        typer.Argument(
            metavar="[DIR]", help="List the heads in this folder too.", show_default=False
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """List the heads that come with modiolus, and those in a folder.

    Each with its subject, source, licence, and how far its skin is from the surface it was fitted
    to.
    """
    from modiolus.face.head import about_head, head_names

    names = [*head_names(), *(_local_heads(folder) if folder is not None else [])]
    found = [{"name": name, **about_head(name)} for name in names]
    fields = ("subject", "source", "licence")
    text = "\n\n".join(
        "\n".join(
            [
                str(item["name"]),
                *(f"  {key:8} {item[key]}" for key in fields if key in item),
                f"  skin     {_fit(item.get('quality', {}))}",
            ]
        )
        for item in found
    )
    show({"heads": found}, text, as_json, quiet=False)


def _local_heads(folder: Path) -> list[str]:
    """Return the heads in a folder, which may be one itself."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; name one that holds heads")
    places = [folder, *sorted(folder.iterdir())]
    return [str(place) for place in places if (place / "head.toml").is_file()]


def _fit(quality: Mapping[str, Any]) -> str:
    """Say how far the skin is from what it was fitted to."""
    for key, what in (("skin_rms_mm", "the anatomy's skin"), ("scan_rms_mm", "the scan")):
        if key in quality:
            return f"{quality[key]:.2f} mm from {what}, root mean square"
    return "fit not stated"


@_head.command("show", epilog="Example: modiolus head show --head taro --out out")
def head_show(
    head: HeadName = "taro",
    out: Out = Path("out"),
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Draw every muscle of a head with its fibres into OUT/head-<name>/."""
    from modiolus.face.head import Head
    from modiolus.view.muscles import draw_muscles

    chosen = Head.load(head)
    target = out / f"head-{chosen.name}"
    with whole_folder(target, marker="muscles.png") as folder:
        heading = f"Muscles of the left side · {chosen.name}"
        draw_muscles(chosen, heading, folder / "muscles.png")
    record = {
        "head": chosen.name,
        "elements": chosen.tissue.n_elements,
        "muscles": list(chosen.muscles),
        "files": {"picture": str(target / "muscles.png")},
    }
    text = (
        f"{chosen.name}: {chosen.tissue.n_elements} elements, {len(chosen.muscles)} muscles a "
        f"side\nPicture: {target / 'muscles.png'}"
    )
    show(record, text, as_json, quiet)


@app.command(epilog="Example: modiolus build path/to/bodyparts3d --out heads/mine")
def build(
    anatomy: Annotated[
        Path, typer.Argument(metavar="ANATOMY", help="Folder with the surfaces of BodyParts3D.")
    ],
    out: Out = Path("head"),
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Fit a head to an anatomy and write it into the folder DIR.

    Prints how well everything fits: skin, elements, thickness, muscles. The head is called what
    the folder is called.
    """
    from modiolus.face.build import build_head

    name = folder_name("--out", out.resolve().name)
    with whole_folder(out, marker="head.toml") as folder:
        with Progress(f"building {name}", quiet=quiet) as progress:
            built, table = build_head(anatomy, progress.update, name=name)
        built.save(folder)
    record = {
        "head": built.name,
        "elements": built.tissue.n_elements,
        "muscles": list(built.muscles),
        "quality": built.about["quality"],
        "files": {"folder": str(out)},
    }
    text = f"{table}\n\nHead: {out}\nUse it with: modiolus simulate smile-closed --head {out}"
    show(record, text, as_json, quiet)
