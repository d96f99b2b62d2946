"""From a folder of anatomy to a head: the one documented way the shipped head was made."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..anatomy import DEEP_STRUCTURES, BodyParts3D, DistanceGrid, deep_distances
from ..anatomy.distance import QUANTUM
from ..anatomy.surface import Surface
from ..hermite import HermiteMesh
from ..hermite.basis import Array
from ..progress import Report
from .embed import (
    LID_SHIFT,
    bring_inside,
    fasciae,
    in_life,
    insertions,
    inside_fraction,
    ligaments,
    modiolus_centre,
    modiolus_share,
    move_lids,
    muscle_fraction,
    origins,
    sheets,
)
from .head import Head, RigidSurface
from .malar import MALAR, malar_part
from .muscles import build_muscles, muscle_quality, muscle_table
from .prolonged import LEVATOR, to_modiolus
from .provenance import GIVEN, INFERRED
from .template import COLUMNS, EYE_ROW, MOUTH_ROW, NECK_CUT, ROWS
from .tissue import (
    BEDDED,
    EYE_CENTRE,
    EYE_RADIUS,
    Tissue,
    build_tissue,
    eyeball,
    outer_sheet,
)

#: Spacing of the eyeball's distance grid (mm).
_EYE_SPACING = 0.7

ATTRIBUTION = (
    "BodyParts3D, (c) The Database Center for Life Science, licensed under CC Attribution-Share "
    "Alike 2.1 Japan. Mitsuhashi et al. 2009, Nucleic Acids Research 37:D782-D785, "
    "doi 10.1093/nar/gkn613."
)


def build_head(
    folder: str | Path, report: Report | None = None, name: str = "taro"
) -> tuple[Head, str]:
    """Build a head from named surfaces.

    Parameters
    ----------
    folder : path
        The folder with the surfaces of BodyParts3D.
    report : callable, optional
        Told ``(fraction, message)`` as the work goes on.
    name : str
        Name of the head.

    Returns
    -------
    head : Head
        With the figures of the build in ``about["quality"]``.
    table : str
        The same figures and the muscles' quality for a person to read.

    Raises
    ------
    InputError
        A surface is missing or not sound.
    SolveError
        A part cannot be fitted.
    """
    tell = report or (lambda _fraction, _message: None)
    anatomy = BodyParts3D(folder)
    tell(0.0, "distances to the deep structures")
    deep = deep_distances(anatomy, [n for n in DEEP_STRUCTURES if n != "eyeball"])
    low, high = np.array(EYE_CENTRE) - 20.0, np.array(EYE_CENTRE) + 20.0
    deep["gums_upper"] = _bared(deep["gums_upper"], anatomy.surface("depressor_septi_nasi"))
    deep["eyeball"] = DistanceGrid.of([eyeball()], _EYE_SPACING, np.stack([low, high]))
    tell(0.15, "tissue")
    skin = anatomy.surface("skin")
    tissue = build_tissue(skin, deep, {name: anatomy.surface(name) for name in BEDDED})
    tell(0.25, "muscles")
    fitted = build_muscles(anatomy)
    tell(0.75, "muscles into the tissue")
    lids = "orbicularis_oculi_palpebral"
    lain = {**fitted, lids: move_lids(fitted[lids])}
    lain = {key: in_life(bring_inside(m, tissue.mesh, NECK_CUT)) for key, m in lain.items()}
    muscles = {
        **lain,
        LEVATOR: to_modiolus(lain[LEVATOR], tissue.mesh),
        MALAR: malar_part(tissue.mesh),
    }
    tell(0.85, "muscle fraction and attachments")
    element, xi = tissue.landmarks["mouth_corner"]
    corner = tissue.mesh.evaluate([element], [(*xi[:2], 0.5)])[0]
    attachments = origins(tissue.mesh, muscles)
    attachments.update(ligaments(tissue.mesh, tissue.sides["inner"], corner, deep))
    attachments.update(fasciae(tissue.mesh, tissue.sides["inner"]))
    head = Head(
        name=name,
        tissue=tissue.mesh,
        sides=tissue.sides,
        landmarks=tissue.landmarks,
        fraction=muscle_fraction(tissue.mesh, muscles.values()),
        firmness=modiolus_share(tissue.mesh, modiolus_centre(muscles, corner)),
        muscles=muscles,
        deep={key: RigidSurface(key, grid) for key, grid in deep.items()},
        attachments=attachments,
        insertions=insertions(tissue.mesh, muscles),
        sheets=sheets(tissue.mesh, tissue.sides["outer"]),
        about={
            "subject": "adult male",
            "source": "BodyParts3D, release 3.0 (skin: release 4.0)",
            "licence": "CC BY-SA 2.1 JP",
            "licence_url": "https://creativecommons.org/licenses/by-sa/2.1/jp/",
            "attribution": ATTRIBUTION,
            "changes": "Hermite meshes fitted to the surfaces; eyeball of "
            f"{2 * EYE_RADIUS:g} mm; skin and muscles moved to make room for each other",
            "quality": tissue_quality(tissue, outer_sheet(skin), deep),
            "provenance": provenance(muscles, deep),
        },
    )
    share = {
        key: round(inside_fraction(head.tissue, muscle, NECK_CUT), 4)
        for key, muscle in muscles.items()
    }
    head.about["quality"]["inside"] = share
    tell(0.95, "quality of the muscles")
    # The lids' muscle is compared where its source is, levator anguli oris as far as it goes.
    moved = {**lain, lids: move_lids(lain[lids], -LID_SHIFT)}
    rows = muscle_quality(moved, anatomy)
    head.about["quality"]["moved_rms_mm"] = {row.name: round(row.rms, 2) for row in rows}
    head.about["quality"]["moved_volume"] = {
        row.name: round(row.volume / row.source_volume, 3) for row in rows
    }
    table = (
        quality_text(head)
        + "\n\nas fitted\n"
        + muscle_table(muscle_quality(fitted, anatomy))
        + "\n\nmoved into the tissue\n"
        + muscle_table(rows)
    )
    tell(1.0, "done")
    return head, table


#: How far (mm) what lies before a muscle is cut away, and around the muscle.
_BEFORE, _AROUND = 6.0, 0.7


def _bared(gums: DistanceGrid, muscle: Surface) -> DistanceGrid:
    """Return the distance to gums without what of them lies around and before a muscle.

    The source's reach up to the spine of the nose, far above the vestibule of the mouth, and over
    the origin of depressor septi nasi, which is part of the tissue there.
    """
    body = DistanceGrid.of([muscle], 0.5)
    axes = [
        start + gums.spacing * np.arange(n)
        for start, n in zip(gums.origin, gums.values.shape, strict=True)
    ]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    distance = QUANTUM * gums.values.ravel().astype(np.float64)
    low, high = muscle.bounds + np.array([[-2.0, -2.0 - _BEFORE, -2.0], [2.0, 2.0, 2.0]])
    near = np.flatnonzero((points > low).all(axis=1) & (points < high).all(axis=1))
    for back in np.arange(0.0, _BEFORE + 0.1, 0.5):
        gap = body.sample(points[near] + [0.0, back, 0.0]).distance
        distance[near] = np.maximum(distance[near], _AROUND - gap)
    values = np.round(distance / QUANTUM).astype(np.int8).reshape(gums.values.shape)
    return replace(gums, values=values)


def provenance(muscles: Iterable[str], deep: Iterable[str]) -> dict[str, str]:
    """Return for each part of a head built from BodyParts3D what it comes from."""
    out = {"skin": f"{GIVEN}: moved out where muscles need room"}
    out["inner_surface"] = f"{GIVEN}: on bone, elsewhere {INFERRED}: a greatest depth by region"
    out |= dict.fromkeys(muscles, f"{GIVEN}: moved into the tissue")
    out[LEVATOR] += f", {INFERRED} from there to the modiolus"
    out[MALAR] = f"{INFERRED}: laid in the tissue, from the literature"
    out |= dict.fromkeys(deep, GIVEN)
    out["gums_upper"] = f"{GIVEN}: cut away over depressor septi nasi"
    out["eyeball"] = f"{INFERRED}: a ball of {2 * EYE_RADIUS:g} mm behind the lids"
    out["attachments"] = f"{INFERRED}: at the ends of the muscles, ligaments from the literature"
    return out


def quality_text(head: Head) -> str:
    """Return the figures of a head's build as plain text."""
    quality = head.about["quality"]
    lines = [f"{key:24} {value}" for key, value in quality.items() if not isinstance(value, dict)]
    lines += ["", "thickness (mm)           here  literature"]
    for name, value in quality["thickness_mm"].items():
        lines.append(f"{name:24} {value:4}  {THICKNESS[name][2]}")
    lines += ["", "inside the tissue        share"]
    lines += [f"{name:38} {value:.3f}" for name, value in quality["inside"].items()]
    return "\n".join(lines)


def tissue_quality(tissue: Tissue, sheet: Surface, deep: dict[str, DistanceGrid]) -> dict[str, Any]:
    """Measure the tissue mesh: fit to the skin, shape of the elements, thickness.

    The skin's fit leaves out the margins of lips and lids, the wings and base of the nose and
    the last column before the ear.

    Parameters
    ----------
    tissue : Tissue
    sheet : Surface
        Outer sheet of the skin, see `outer_sheet`.
    deep : dict of DistanceGrid
        Deep structures by name.
    """
    mesh = tissue.mesh
    elements, xi, _ = mesh.gauss_points(4)
    determinant = np.linalg.det(mesh.jacobian(elements, xi))
    error = skin_error(tissue, sheet)
    return {
        "elements": mesh.n_elements,
        "skin_rms_mm": round(float(np.sqrt(np.mean(error**2))), 3),
        "skin_p95_mm": round(float(np.percentile(error, 95)), 3),
        "skin_max_mm": round(float(error.max()), 3),
        "min_jacobian": round(float(determinant.min()), 3),
        "min_scaled_jacobian": round(float(mesh.scaled_jacobian(elements, xi).min()), 3),
        "volume_mm3": round(float(mesh.measures().sum())),
        "bone_clearance_mm": round(_clearance(mesh, tissue, deep), 3),
        "thickness_mm": thickness_table(mesh),
    }


def skin_error(tissue: Tissue, sheet: Surface) -> Array:
    """Return the distance (n,) of points of the outer surface to the skin."""
    face = tissue.mesh.face(*tissue.sides["outer"])
    elements, xi, _ = face.gauss_points(4)
    column, row = elements % COLUMNS + xi[:, 0], elements // COLUMNS + xi[:, 1]
    lips = (np.abs(row - MOUTH_ROW) < 0.5) & (column < 4.5)
    lids = (np.abs(row - EYE_ROW) < 0.5) & (column > 2.5) & (column < 7.5)
    wing = (row > 10.0) & (row < 12.5) & (column < 4.0)
    keep = ~(lips | lids | wing | (column > COLUMNS - 1))
    return np.asarray(sheet.closest(face.evaluate(elements, xi)[keep]).distance)


def _clearance(mesh: HermiteMesh, tissue: Tissue, deep: dict[str, DistanceGrid]) -> float:
    """Return the least distance of the inner surface to bone, teeth and gums (mm)."""
    face = mesh.face(*tissue.sides["inner"])
    elements, xi, _ = face.gauss_points(4)
    points = face.evaluate(elements, xi)
    bones = [grid for key, grid in deep.items() if key not in ("cartilage", "eyeball", "masseter")]
    return float(min(grid.sample(points).distance.min() for grid in bones))


#: Where thickness is told: column and row of the template, and the value of the literature
#: over bone (mm), which is for adult heads about a seventh larger than this one.
THICKNESS: dict[str, tuple[float, float, str]] = {
    "rhinion": (0, 13.0, "3.1"),
    "glabella": (0, 16.0, "5.3"),
    "forehead": (2, 18.0, "8"),
    "subnasale": (0, 10.0, "15.6"),
    "philtrum": (0, 9.0, "11"),
    "upper_lip": (0, 8.0, "8"),
    "lower_lip": (0, 6.0, "8"),
    "labiomental": (0, 5.0, "11"),
    "pogonion": (0, 4.0, "12"),
    "orbital_rim": (5, 13.0, "6-9"),
    "mid_cheek": (6, 11.0, "14-18"),
    "buccal": (7, 8.0, "20-25"),
}


def thickness_table(mesh: HermiteMesh) -> dict[str, float]:
    """Return the depth of the layer (mm) at the landmarks of `THICKNESS`."""
    out = {}
    for name, (column, row, _) in THICKNESS.items():
        i, j = min(int(column), COLUMNS - 1), min(int(row), ROWS - 1)
        place = (column - i, row - j)
        ends = mesh.evaluate([j * COLUMNS + i] * 2, [(*place, 0.0), (*place, 1.0)])
        out[name] = round(float(np.linalg.norm(ends[1] - ends[0])), 1)
    return out
