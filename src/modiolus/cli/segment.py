"""``modiolus segment``: surfaces from images."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from modiolus.cli.app import Json, Quiet, app, examples, show
from modiolus.cli.outputs import whole_folder, write_report
from modiolus.errors import InputError
from modiolus.progress import Progress

if TYPE_CHECKING:
    from modiolus.anatomy.image import Image
    from modiolus.anatomy.surface import Surface
    from modiolus.scans.shown import FaceShown

#: Spacing (mm) of the points of the data cloud.
_CLOUD = 2.0


@app.command(
    epilog=examples(
        "modiolus segment t1.nii.gz --out anna",
        "modiolus segment labels.nrrd --labels names.toml --out anna --json",
    )
)
def segment(
    image: Annotated[
        Path,
        typer.Argument(
            metavar="IMAGE", help="NIfTI, NRRD or MetaImage file, or the folder of a DICOM series."
        ),
    ],
    labels: Annotated[
        Path | None,
        typer.Option(
            metavar="TOML", help="The image is a label map; this file names its structures."
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for the surfaces.")
    ] = Path("segmented"),
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find the skin in an image, or the surfaces of a label map.

    The skin is sought in a T1-weighted image. Surfaces are in mm in the image's own frame, turned
    to LPS: +x the subject's left, +y backwards, +z up. The report says which parts of the face the
    image does not show.
    """
    from modiolus.anatomy.image import read_image, simpleitk

    # Ask for what is needed before anything is read.
    simpleitk()
    if labels is None:
        _skin(image, out, as_json, quiet)
        return
    from modiolus.anatomy.labels import label_surfaces, read_label_names

    names = read_label_names(labels)
    with whole_folder(out, "report.json", sources=(image, labels)) as folder:
        surfaces = label_surfaces(read_image(image), names)
        record: dict[str, Any] = {
            "image": str(image),
            "structures": {
                name: {
                    "label": names[name],
                    "volume_mm3": round(surface.volume, 1),
                    "area_mm2": round(surface.area, 1),
                    "file": str(out / f"{name}.ply"),
                }
                for name, surface in surfaces.items()
            },
        }
        for name, surface in surfaces.items():
            _write_ply(folder / f"{name}.ply", surface)
        write_report(folder, record)
    text = "\n".join(
        f"{name}: {item['volume_mm3'] / 1000.0:.2f} cm³"
        for name, item in record["structures"].items()
    )
    show(record, f"{text}\n\nSurfaces: {out}", as_json, quiet)


def _skin(path: Path, out: Path, as_json: bool, quiet: bool) -> None:
    from modiolus.anatomy.image import read_image
    from modiolus.anatomy.segment import segment_skin
    from modiolus.face.head import Head
    from modiolus.scans.shown import find_face
    from modiolus.view.slices import draw_slices

    with (
        whole_folder(out, "skin.ply", sources=(path,)) as folder,
        Progress(f"segmenting {path.name}", quiet=quiet) as progress,
    ):
        image = read_image(path)
        found = segment_skin(image, lambda share, text: progress.update(0.7 * share, text))
        progress.update(0.7, "looking for the face")
        head = Head.load("taro")
        face = find_face(found, head)
        if face is None:
            raise InputError(
                f"{path}: no face found in it; give a T1-weighted image that shows one, the way it "
                "lies in the head's axes"
            )
        progress.update(0.9, "writing")
        surface = found.surface
        _write_ply(folder / "skin.ply", surface)
        cloud = surface.samples(_CLOUD)
        np.savetxt(folder / "cloud.xyz", cloud, fmt="%.3f", header="x y z (mm, LPS)")
        marks = head.landmark_points()
        cheeks = face.pose.apply([marks["cheek_left"], marks["cheek_right"]])
        through = cheeks.mean(axis=0)
        # Beside the mid-plane's cleft of the nose and through an eye's height is more seen.
        through[0] += 2.0
        draw_slices(
            found.image,
            surface,
            through,
            2.0 * found.tissue,
            f"{path.name}: skin in three slices",
            folder / "slices.png",
        )
        record = {
            "image": str(path),
            "voxels": list(image.values.shape),
            "spacing_mm": [round(float(step), 4) for step in image.spacing],
            "oriented": image.oriented,
            "voxels_not_finite": image.unknown,
            "air": round(found.air, 3),
            "noise": round(found.noise, 3),
            "tissue": round(found.tissue, 3),
            "volume_l": round(found.volume, 3),
            "bounds_mm": np.round(surface.bounds, 2).tolist(),
            "triangles": len(surface.faces),
            "cloud_points": len(cloud),
            "cut_mm2": found.cuts,
            "face": _face_record(face),
            "files": {
                "skin": str(out / "skin.ply"),
                "cloud": str(out / "cloud.xyz"),
                "slices": str(out / "slices.png"),
            },
        }
        write_report(folder, record)
    show(record, _text(record, image, face), as_json, quiet)


def _face_record(face: FaceShown) -> dict[str, Any]:
    return {
        "distance_mm": round(face.distance, 2),
        "size": round(face.pose.scale, 3),
        "shown": face.shown,
        "missing": face.missing,
        "cut": face.cut,
    }


def _text(record: Mapping[str, Any], image: Image, face: FaceShown) -> str:
    files = record["files"]
    lines = [
        f"Skin: {record['triangles']} triangles, {record['volume_l']:.2f} l in the field of view",
    ]
    if record["cut_mm2"]:
        sides = ", ".join(
            f"{name} {area / 100:.0f} cm²" for name, area in record["cut_mm2"].items()
        )
        lines.append(f"The head goes on beyond the image: {sides}")
    if not image.oriented:
        lines.append("The file does not say how the subject lies in it: check the slices")
    if image.unknown:
        lines.append(f"{image.unknown} voxels are not numbers and were taken for air")
    if face.missing:
        lines.append(f"Missing from the face: {', '.join(face.missing)}")
    if face.cut:
        lines.append(f"Shown in part: {', '.join(face.cut)}")
    if not (face.missing or face.cut):
        lines.append("The whole face is in the image")
    lines += ["", f"Surface: {files['skin']}", f"Slices: {files['slices']}"]
    if not face.missing:
        lines.append(f"Use it with: modiolus morph taro --to {files['skin']}")
    return "\n".join(lines)


def _write_ply(path: Path, surface: Surface) -> None:
    """Write a surface as binary PLY."""
    import pyvista as pv

    mesh = pv.PolyData.from_regular_faces(surface.vertices.astype(np.float32), surface.faces)
    mesh.save(path, binary=True)
