"""``modiolus upright``: a head measured lying down, standing."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from modiolus.cli.app import Json, Quiet, app, examples, show
from modiolus.cli.outputs import own_heads, use_of, whole_folder, write_report
from modiolus.errors import InputError
from modiolus.files import folder_name
from modiolus.progress import Progress

if TYPE_CHECKING:
    from modiolus.face.head import Head
    from modiolus.mechanics.gravity import Upright

#: What the provenance of a head says that was turned.
_STANDING = "standing"


@app.command(epilog=examples("modiolus upright taro --out heads/taro-upright"))
def upright(
    head: Annotated[
        str,
        typer.Argument(
            metavar="HEAD", help="A shipped head or a folder with one, measured lying face up."
        ),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the head.")] = Path(
        "head"
    ),
    density: Annotated[
        float, typer.Option(metavar="KG/M3", help="Density of the tissue.")
    ] = 1040.0,
    tolerance: Annotated[
        float,
        typer.Option(
            metavar="MM", help="How near the equilibrium lying has to come to the given shape."
        ),
    ] = 0.05,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Turn a head that was measured lying face up upright.

    The shape without gravity is found whose equilibrium lying is the given shape; then it is
    loaded standing. Muscles and attachments follow. The head is called what the folder is called.
    """
    began = time.perf_counter()
    if not 0.0 < density <= 20000.0:
        raise InputError(f"--density {density:g}: not within 0 to 20000 kg/m³; give one that is")
    if not 1e-4 <= tolerance <= 1.0:
        raise InputError(f"--tolerance {tolerance:g}: not within 0.0001 to 1 mm; give one that is")
    from modiolus.export.scene import FaceScene
    from modiolus.face.head import Head
    from modiolus.mechanics.gravity import upright as turned
    from modiolus.view.face import draw_face

    source = Head.load(head)
    if _STANDING in source.about.get("provenance", {}):
        raise InputError(f"{head}: it stands already; name a head that was measured lying face up")
    name = folder_name("--out", out.resolve().name)
    with whole_folder(out, "head.toml", sources=own_heads(head)) as folder:
        with Progress(f"turning {source.name} upright", quiet=quiet) as progress:
            found = turned(source, density, tolerance, report=progress.update)
        standing = replace(found.head, name=name, about=_account(source, found, density))
        standing.save(folder)
        draw_face(
            FaceScene(source),
            source.tissue.parameters,
            standing.tissue.parameters,
            f"{source.name}, lying as measured and upright",
            folder / "upright.png",
            titles=("lying", "upright"),
        )
        landmarks = moves(source, found.free, standing)
        record: dict[str, Any] = {
            "head": name,
            "upright_of": source.name,
            "density": density,
            "rounds_mm": [round(gap, 5) for gap in found.gaps],
            "J_min": found.state.statistics.J_min,
            "J_max": found.state.statistics.J_max,
            "max_penetration_mm": found.state.statistics.max_penetration_mm,
            "greatest_move_mm": standing.about["quality"]["greatest_move_mm"],
            "landmarks": landmarks,
            "wall_s": round(time.perf_counter() - began, 3),
            "files": {
                "folder": str(out),
                "picture": str(out / "upright.png"),
                "report": str(out / "report.json"),
            },
        }
        write_report(folder, record)
    far = max(landmarks, key=lambda key: float(np.linalg.norm(landmarks[key]["upright"])))
    text = (
        f"{name}: {len(found.gaps)} rounds, equilibrium lying within {found.gaps[-1]:.3f} mm of "
        f"{source.name}; upright the skin moves {record['greatest_move_mm']:.1f} mm at most, "
        f"{far} {np.linalg.norm(landmarks[far]['upright']):.1f} mm\n"
        f"Picture: {record['files']['picture']}\n{use_of(out)}"
    )
    show(record, text, as_json, quiet)


def _account(source: Head, found: Upright, density: float) -> dict[str, Any]:
    """Return what the head upright says of itself (`Head.about`)."""
    from modiolus.face.provenance import INFERRED

    about = dict(source.about)
    change = f"turned upright from lying face up, density {density:g} kg/m³"
    about["changes"] = f"{about.get('changes', '')}; {change}".lstrip("; ")
    about["upright_of"] = source.name
    # How the source was fitted tells nothing of the new shape.
    about["quality"] = {
        "lying_within_mm": round(found.gaps[-1], 4),
        "greatest_move_mm": round(greatest(source, found.head), 4),
    }
    if "provenance" in about:
        shape = f"{INFERRED}: by mechanics from {source.name}, taken as lying"
        about["provenance"] = {**about["provenance"], _STANDING: shape}
    return about


def greatest(source: Head, standing: Head) -> float:
    """Return how far the skin moves at most (mm)."""
    elements, axis, side = source.sides["outer"]
    skin = source.tissue.face(elements, axis, side)
    places, xi, _ = skin.gauss_points(4)
    gap = skin.functions(places, xi) @ (standing.tissue.parameters - source.tissue.parameters)
    return float(np.linalg.norm(gap, axis=1).max())


def moves(source: Head, free: Head, standing: Head) -> dict[str, dict[str, list[float]]]:
    """Return how far the landmarks move from lying to no gravity, and to standing (mm)."""
    lying, loose, up = (item.landmark_points() for item in (source, free, standing))
    return {
        name: {
            "without_gravity": np.round(loose[name] - point, 4).tolist(),
            "upright": np.round(up[name] - point, 4).tolist(),
        }
        for name, point in lying.items()
    }
