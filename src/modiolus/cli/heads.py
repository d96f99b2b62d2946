"""``modiolus heads``, ``head`` and ``build``: what heads there are, and making one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modiolus.cli.app import HeadName, Json, Out, Quiet, app, show
from modiolus.cli.outputs import whole_folder
from modiolus.progress import Progress

_head = typer.Typer(help="Look at a head.", rich_markup_mode=None, no_args_is_help=True)
app.add_typer(_head, name="head")


@app.command(epilog="Example: modiolus heads --json")
def heads(as_json: Json = False) -> None:
    """List the heads that come with modiolus."""
    from modiolus.face.head import head_names

    names = list(head_names())
    show({"heads": names}, "\n".join(names), as_json, quiet=False)


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

    with whole_folder(out, marker="head.toml") as folder:
        with Progress(f"building {out.name}", quiet=quiet) as progress:
            built, table = build_head(anatomy, progress.update, name=out.absolute().name)
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
