"""``modiolus heads``, ``head`` and ``build``: what heads there are, and making one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modiolus.cli.app import HeadName, Json, Out, Quiet, app, examples, help_alone, show
from modiolus.cli.outputs import own_heads, use_of, whole_folder
from modiolus.errors import InputError
from modiolus.files import folder_name
from modiolus.progress import Progress

if TYPE_CHECKING:
    from modiolus.anatomy.surface import Surface

_head = typer.Typer(
    help="Look at a head, or at the differences of two.",
    epilog=examples("modiolus head show --head ict", "modiolus head diff taro ict"),
    rich_markup_mode=None,
    invoke_without_command=True,
    callback=help_alone,
)
app.add_typer(_head, name="head")


@app.command(epilog=examples("modiolus heads", "modiolus heads heads/ --json"))
def heads(
    folder: Annotated[
        Path | None,
        typer.Argument(
            metavar="DIR", help="List the heads in this folder too.", show_default=False
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """List the shipped heads, and those in a folder.

    Each with its subject, source, licence, and how far its skin is from the surface it was fitted
    to.
    """
    from modiolus.face.head import about_head, head_names
    from modiolus.face.provenance import provenance_lines

    names = [*head_names(), *(_local_heads(folder) if folder is not None else [])]
    found = [{"name": name, **about_head(name)} for name in names]
    fields = ("subject", "source", "licence")
    text = "\n\n".join(
        "\n".join(
            [
                str(item["name"]),
                *(f"  {key:8} {item[key]}" for key in fields if key in item),
                f"  skin     {_fit(item.get('quality', {}))}",
                *provenance_lines(item, most=5),
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
    if "lying_within_mm" in quality:
        return f"lying within {quality['lying_within_mm']:.2f} mm of the head that it was made of"
    return "fit not stated"


@_head.command("show", epilog=examples("modiolus head show --head taro --out out"))
def head_show(
    head: HeadName = "taro",
    out: Out = Path("out"),
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Draw the muscles of a head, and say what of it was given.

    Writes OUT/head-<name>/muscles.png.
    """
    from modiolus.face.head import Head
    from modiolus.face.provenance import provenance_lines
    from modiolus.view.muscles import draw_muscles

    chosen = Head.load(head)
    target = out / f"head-{chosen.name}"
    with whole_folder(target, marker="muscles.png") as folder:
        heading = f"Muscles of the left side · {chosen.name}"
        with Progress(f"drawing {len(chosen.muscles)} muscles", quiet=quiet) as progress:
            draw_muscles(chosen, heading, folder / "muscles.png")
            progress.update(1.0)
    record = {
        "head": chosen.name,
        "elements": chosen.tissue.n_elements,
        "muscles": list(chosen.muscles),
        "provenance": chosen.about.get("provenance", {}),
        "files": {"picture": str(target / "muscles.png")},
    }
    text = (
        f"{chosen.name}: {chosen.tissue.n_elements} elements, {len(chosen.muscles)} muscles a "
        f"side\nPicture: {target / 'muscles.png'}"
    )
    text = "\n".join([*provenance_lines(chosen.about), text])
    show(record, text, as_json, quiet)


@_head.command("diff", epilog=examples("modiolus head diff taro heads/mine"))
def head_diff(
    one: Annotated[str, typer.Argument(metavar="HEAD", help="A shipped head, or a folder.")],
    other: Annotated[str, typer.Argument(metavar="OTHER", help="The head to compare it with.")],
    as_json: Json = False,
) -> None:
    """Say how far two heads of one template are apart."""
    from dataclasses import asdict

    from modiolus.face.differences import differences, differences_text
    from modiolus.face.head import Head

    found = differences(Head.load(one), Head.load(other))
    rows = [
        {key: None if value == math.inf else value for key, value in asdict(item).items()}
        for item in found
    ]
    record = {"head": one, "other": other, "differences": rows}
    show(record, differences_text(found), as_json, quiet=False)


@app.command(
    epilog=examples(
        "modiolus build path/to/bodyparts3d --out heads/mine",
        "modiolus build anna --out heads/anna",
        "modiolus build anna/skin.ply labels.nii.gz --labels names.toml --out heads/anna",
    )
)
def build(
    anatomy: Annotated[
        list[Path],
        typer.Argument(
            metavar="ANATOMY",
            help="The folder of BodyParts3D; or of a subject: folders of named surfaces, surface "
            "files, and a label map.",
        ),
    ],
    labels: Annotated[
        Path | None,
        typer.Option(metavar="TOML", help="Names of the structures in the label map."),
    ] = None,
    head: Annotated[
        str,
        typer.Option(
            "--head",
            metavar="NAME|DIR",
            help="The head from which what is missing is carried over.",
        ),
    ] = "taro",
    landmarks: Annotated[
        Path | None,
        typer.Option(metavar="CSV", help="Landmarks on the skin, as for modiolus morph."),
    ] = None,
    notice: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Licence of the anatomy, to lie beside the head."),
    ] = None,
    subject: Annotated[
        str, typer.Option(metavar="TEXT", help="Who it is, for the head's description.")
    ] = "",
    out: Out = Path("head"),
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make a head from an anatomy and write it into the folder DIR.

    Of a subject the skin is required, as skin.ply, .stl, .obj or .vtp or as a label. Muscles and
    deep structures under their names, with _left, _right or without a side, are used where they
    are given; what is missing is carried over from another head, and is marked as inferred in the
    head's provenance. The head is called what the folder is called.
    """
    name = folder_name("--out", out.resolve().name)
    if len(anatomy) > 1 or not (anatomy[0] / "manifest.csv").is_file():
        _build_subject(anatomy, labels, head, landmarks, notice, subject, out, name, as_json, quiet)
        return
    from modiolus.face.build import build_head

    with whole_folder(out, "head.toml", sources=anatomy) as folder:
        with Progress(f"building {name}", quiet=quiet) as progress:
            built, table = build_head(anatomy[0], progress.update, name=name)
        built.save(folder)
    record = {
        "head": built.name,
        "elements": built.tissue.n_elements,
        "muscles": list(built.muscles),
        "quality": built.about["quality"],
        "files": {"folder": str(out)},
    }
    show(record, f"{table}\n\n{use_of(out)}", as_json, quiet)


def _build_subject(
    anatomy: list[Path],
    labels: Path | None,
    head: str,
    landmarks: Path | None,
    notice: Path | None,
    subject: str,
    out: Path,
    name: str,
    as_json: bool,
    quiet: bool,
) -> None:
    """Make a head from a subject's skin and whatever else is given."""
    from modiolus.cli.morph import Origin, account, finish
    from modiolus.face.head import Head
    from modiolus.face.landmarks import read_landmarks
    from modiolus.face.subject import build_subject, sort_structures

    source = Head.load(head)
    structures = sort_structures(_surfaces(anatomy, labels), source)
    pairs = None if landmarks is None else read_landmarks(landmarks, source)
    if notice is not None and not notice.is_file():
        raise InputError(f"--notice {notice}: no such file; check the path")
    files = ", ".join(path.name for path in anatomy)
    with whole_folder(out, "head.toml", sources=(*anatomy, *own_heads(head))) as folder:
        with Progress(f"building {name}", quiet=quiet) as progress:
            built, quality = build_subject(source, structures, pairs, progress.update, name)
        change = f"fitted to the structures in {files}; what these lack is carried over"
        origin = Origin(f"structures {files}", change, subject or f"subject of {files}", notice)
        record = finish(built, source, quality, origin, folder, out, quiet)
    record["unused"] = structures.unused
    text = account(record, built, out)
    if structures.unused:
        text = f"Not used, as the head has no such part: {', '.join(structures.unused)}\n\n{text}"
    show(record, text, as_json, quiet)


def _surfaces(anatomy: list[Path], labels: Path | None) -> dict[str, Surface]:
    """Read the surfaces of a subject, each under its name."""
    from modiolus.anatomy.surface import READABLE, read_surface

    files: list[Path] = []
    images: list[Path] = []
    for path in anatomy:
        if path.is_dir():
            found = [file for file in sorted(path.iterdir()) if file.suffix.lower() in READABLE]
            if not found:
                raise InputError(f"{path}: no surfaces in it; give {', '.join(READABLE)} files")
            files += found
        elif not path.exists():
            raise InputError(f"{path}: no such file or folder; check the path")
        else:
            (files if path.suffix.lower() in READABLE else images).append(path)
    surfaces: dict[str, Surface] = {}
    for path in files:
        if path.stem in surfaces:
            raise InputError(f"{path}: a second surface called {path.stem}; give one of them")
        surfaces[path.stem] = read_surface(path, path.name)
    if images and labels is None:
        raise InputError(
            f"{images[0]}: of a label map the names are needed; give --labels, or make surfaces of "
            "an image with `modiolus segment`"
        )
    if labels is not None:
        from modiolus.anatomy.image import read_image
        from modiolus.anatomy.labels import label_surfaces, read_label_names

        if len(images) != 1:
            raise InputError(f"--labels {labels}: {len(images)} label maps given; give one")
        for name, surface in label_surfaces(
            read_image(images[0]), read_label_names(labels)
        ).items():
            if name in surfaces:
                raise InputError(f"{labels}: {name} is given as a surface too; give one of them")
            surfaces[name] = replace(surface, name=f"{name} of {images[0].name}")
    return surfaces
