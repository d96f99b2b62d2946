"""How far two heads of one template are from each other, part by part."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ..anatomy.distance import DistanceGrid
from ..errors import InputError
from ..hermite import HermiteMesh
from ..hermite.basis import Array
from .head import Attachment, Head

__all__ = ["Difference", "differences", "differences_text"]


@dataclass(frozen=True)
class Difference:
    """How much a part of one head differs from that of another.

    Attributes
    ----------
    part : str
    kind : str
        ``tissue``, ``muscle``, ``deep``, ``field``, ``attachment``, ``insertion`` or ``sheet``.
    greatest, rms : float
        In `unit`; infinite where only one of the heads has the part there.
    unit : str
        ``mm``; for fields ``1``; for springs ``share``: the stiffness that is in other elements
        or of another size, relative to that of the first head.
    """

    part: str
    kind: str
    greatest: float
    rms: float
    unit: str


def differences(one: Head, other: Head) -> list[Difference]:
    """Compare two heads of one template at the same places of their meshes.

    Tissue and muscles are compared at 4 x 4 x 4 Gauss points an element, deep structures by the
    distance of the one's surface from the other's.

    Parameters
    ----------
    one, other : Head

    Raises
    ------
    InputError
        The meshes of the tissues do not have the same elements.
    """
    if one.tissue.n_elements != other.tissue.n_elements:
        raise InputError(
            f"{other.name}: {other.tissue.n_elements} elements, but {one.name} has "
            f"{one.tissue.n_elements}; compare heads of one template"
        )
    out = [_measured("tissue", "tissue", _apart(one.tissue, other.tissue), "mm")]
    for name in sorted({*one.muscles, *other.muscles}):
        mine, theirs = one.muscles.get(name), other.muscles.get(name)
        if mine is None or theirs is None or mine.mesh.n_elements != theirs.mesh.n_elements:
            out.append(Difference(name, "muscle", np.inf, np.inf, "mm"))
        else:
            out.append(_measured(name, "muscle", _apart(mine.mesh, theirs.mesh), "mm"))
    for name in sorted({*one.deep, *other.deep}):
        if name in one.deep and name in other.deep:
            gap = _off(one.deep[name].distance, other.deep[name].distance)
            out.append(_measured(name, "deep", gap, "mm"))
        else:
            out.append(Difference(name, "deep", np.inf, np.inf, "mm"))
    out.append(_measured("muscle fraction", "field", one.fraction - other.fraction, "1"))
    out.append(_measured("modiolus", "field", one.firmness - other.firmness, "1"))
    count = one.tissue.n_elements
    out += _springs("attachment", one.attachments, other.attachments, count)
    out += _springs("insertion", one.insertions, other.insertions, count)
    out += _springs("sheet", one.sheets, other.sheets, count)
    return out


def _apart(one: HermiteMesh, other: HermiteMesh) -> Array:
    elements, xi, _ = one.gauss_points(4)
    return np.asarray(
        np.linalg.norm(one.evaluate(elements, xi) - other.evaluate(elements, xi), axis=1)
    )


def _off(one: DistanceGrid, other: DistanceGrid) -> Array:
    """Return the distances from one surface to another, but at the borders of their grids."""
    points = one.surface().vertices
    rim = 2.0 * max(one.spacing, other.spacing)
    within = np.all(
        [(points > g.bounds[0] + rim) & (points < g.bounds[1] - rim) for g in (one, other)],
        axis=(0, 2),
    )
    # The vertices lie on the surface as nearly as lines between the points of the grid tell.
    points = points[within]
    return np.asarray(other.sample(points).distance - one.sample(points).distance)


def _measured(part: str, kind: str, gap: Array, unit: str) -> Difference:
    size = np.abs(gap) if len(gap) else np.array([np.inf])
    return Difference(part, kind, float(size.max()), float(np.sqrt(np.mean(size**2))), unit)


def _springs(
    kind: str, one: Mapping[str, Attachment], other: Mapping[str, Attachment], count: int
) -> Iterator[Difference]:
    """Compare how much stiffness there is in every element."""
    for name in sorted({*one, *other}):
        if name not in one or name not in other:
            yield Difference(name, kind, np.inf, np.inf, "share")
            continue
        mine, theirs = (
            np.bincount(part.elements, part.stiffness, minlength=count)
            for part in (one[name], other[name])
        )
        gap, scale = np.abs(mine - theirs), max(float(mine.sum()), 1e-300)
        yield Difference(
            name, kind, float(gap.sum()) / scale, float(np.sqrt((gap**2).sum())) / scale, "share"
        )


def differences_text(found: list[Difference]) -> str:
    """Return differences as a table of plain text; what is alike to its digits is but counted."""
    apart = [item for item in found if item.greatest >= 5e-5]
    lines = [f"{'part':40} {'kind':10} {'greatest':>9} {'rms':>9}  unit"]
    lines += [
        f"{item.part:40} {item.kind:10} {item.greatest:9.4f} {item.rms:9.4f}  {item.unit}"
        for item in apart
    ]
    return "\n".join([*lines, f"{len(found) - len(apart)} more are alike."])
