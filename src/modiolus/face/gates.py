"""How good a morphed head is, and what it has to keep to be written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..anatomy.surface import Surface
from ..errors import SolveError
from ..fitting import PointTarget
from ..fitting.register import Matcher, unit_name
from ..hermite.basis import Array
from .aligned import Aligned, skin_surface
from .deform import SkinPlaces, matches, outer_normals
from .head import Head
from .muscle import Muscle

#: A vertex of a scan is in a cavity when fewer of its rays than this share escape.
_ESCAPING = 0.3


def morph_quality(
    head: Head, morphed: Head, aligned: Aligned, margins: list[PointTarget]
) -> dict[str, Any]:
    """Measure a morphed head against the scan and against the head that it was made from.

    Parameters
    ----------
    head, morphed : Head
        Before and after.
    aligned : Aligned
        The scan.
    margins : list of PointTarget
        Margins of lips and lids as `modiolus.face.deform.margin_targets` found them.

    Returns
    -------
    dict
        Figures by the names that `gates` knows, and more.
    """
    mesh = morphed.tissue
    elements, xi, _ = mesh.gauss_points(4)
    error = scan_error(morphed, aligned.surface)
    seen = _seen(morphed, aligned.surface)
    old, new = (thickness(item) for item in (head, morphed))
    ratio = new / (aligned.size * old)
    was = float(head.tissue.measures().sum())
    quality: dict[str, Any] = {
        "size": round(aligned.size, 4),
        "unit": unit_name(aligned.pose.unit),
        "scan_rms_mm": round(error.rms(), 3),
        "scan_p95_mm": round(error.percentile(0.95), 3),
        "scan_max_mm": round(float(error.distance[error.outside].max()), 3),
        "scan_rms_with_nostrils_mm": round(error.rms(cavities=True), 3),
        "scan_covered": round(error.covered, 3),
        "skin_seen": round(seen, 3),
        "min_jacobian": round(float(np.linalg.det(mesh.jacobian(elements, xi)).min()), 3),
        "min_scaled_jacobian": round(float(mesh.scaled_jacobian(elements, xi).min()), 3),
        "volume_mm3": round(float(mesh.measures().sum())),
        "volume_ratio": round(float(mesh.measures().sum()) / (aligned.size**3 * was), 3),
        "least_thickness_mm": round(float(new.min()), 2),
        "least_thickness_ratio": round(float(ratio.min()), 3),
        "thickness_ratio": [round(float(v), 2) for v in np.percentile(ratio, [1, 50, 99])],
    }
    for part in ("lip", "lid"):
        gaps = [
            np.linalg.norm(mesh.evaluate(t.elements, t.xi) - t.points, axis=1)
            for t in margins
            if t.name.startswith(part)
        ]
        if gaps:
            rms = float(np.sqrt(np.mean(np.concatenate(gaps) ** 2)))
            quality[f"{part}_margins_rms_mm"] = round(rms, 3)
    before, after = inside_shares(head, morphed)
    quality["inside"] = {key: round(value, 4) for key, value in after.items()}
    quality["inside_lost"] = round(max(before[key] - after[key] for key in before), 4)
    least = min(least_volume(muscle) for muscle in morphed.muscles.values())
    quality["muscles_min_jacobian"] = round(least, 4)
    return quality


def inside_shares(head: Head, morphed: Head) -> tuple[dict[str, float], dict[str, float]]:
    """Return which share of every muscle lies in the tissue, before and after.

    What lies below the cut through the neck does not count.
    """
    cut = neck_height(head)
    shares: tuple[dict[str, float], dict[str, float]] = ({}, {})
    for name, muscle in head.muscles.items():
        elements, xi, _ = muscle.mesh.gauss_points(3)
        kept = muscle.mesh.evaluate(elements, xi)[:, 2] >= cut
        for part, share in zip((head, morphed), shares, strict=True):
            rule = part.muscles[name].mesh.quadrature(3)
            points = part.muscles[name].mesh.evaluate(elements, xi)
            within = part.tissue.locate(points[kept]).distance < 1e-3
            weights = rule.weights[kept]
            share[name] = float(weights[within].sum() / weights.sum()) if kept.any() else 1.0
    return shares


@dataclass(frozen=True)
class Gate:
    """A figure of a morphed head with the bounds that it has to keep."""

    name: str
    value: float
    low: float
    high: float

    @property
    def passed(self) -> bool:
        """Whether the figure is within its bounds."""
        return self.low <= self.value <= self.high


#: Figures of `morph_quality` with the bounds that they have to keep.
GATES: dict[str, tuple[float, float]] = {
    "scan_rms_mm": (0.0, 0.5),
    "skin_seen": (0.4, 1.0),
    "lip_margins_rms_mm": (0.0, 0.5),
    "lid_margins_rms_mm": (0.0, 0.5),
    "min_jacobian": (1e-3, np.inf),
    "min_scaled_jacobian": (0.1, 1.0),
    "least_thickness_ratio": (0.5, np.inf),
    "volume_ratio": (0.75, 1.33),
    "muscles_min_jacobian": (0.0, np.inf),
    "inside_lost": (-1.0, 0.03),
}


def gates(quality: dict[str, Any]) -> list[Gate]:
    """Return the gates of a morphed head; figures that a scan does not give are left out."""
    return [Gate(name, quality[name], *GATES[name]) for name in GATES if name in quality]


def quality_text(quality: dict[str, Any]) -> str:
    """Return figures and verdicts of a morphed head as plain text."""
    lines = [f"{'figure':26} {'value':>9}  wanted"]
    for gate in gates(quality):
        bounds = [f"from {gate.low:g}"] if gate.low > 0.0 else []
        bounds += [f"up to {gate.high:g}"] if np.isfinite(gate.high) else []
        verdict = "ok" if gate.passed else "FAILED"
        lines.append(f"{gate.name:26} {gate.value:9.3f}  {' '.join(bounds):20} {verdict}")
    for name, value in quality.items():
        if name not in GATES and not isinstance(value, dict):
            lines.append(f"{name:26} {value!s:>9}")
    return "\n".join(lines)


def thickness(head: Head) -> Array:
    """Return the depth of the tissue (mm) at 3 x 3 points of every element, (n,)."""
    elements, axis, side = head.sides["outer"]
    face = head.tissue.face(elements, axis, side)
    local, xi, _ = face.gauss_points(3)
    ends = [
        head.tissue.evaluate(elements[local], np.insert(xi, axis, float(end), axis=1))
        for end in (side, 1 - side)
    ]
    return np.asarray(np.linalg.norm(ends[0] - ends[1], axis=1))


@dataclass(frozen=True)
class ScanError:
    """How far the vertices of a scan are from the skin of a head.

    Attributes
    ----------
    distance : (n,) array
        In mm.
    area : (n,) array
        Of the scan (mm²) that the vertex stands for: scans have most of their vertices at nostrils
        and lids, and the error is one of the face.
    outside : (n,) bool array
        Which are on the outside; the others are in a cavity (nostrils).
    covered : float
        Share of the scan's area of those outside.
    """

    distance: Array
    area: Array
    outside: NDArray[np.bool_]
    covered: float

    def rms(self, cavities: bool = False) -> float:
        """Return the root mean square over the area, without cavities or with them (mm)."""
        weight = self.area * (self.outside | cavities)
        return float(np.sqrt(weight @ self.distance**2 / weight.sum()))

    def percentile(self, share: float) -> float:
        """Return the distance (mm) up to which a share of the area outside lies."""
        order = np.argsort(self.distance)
        sums = np.cumsum((self.area * self.outside)[order])
        return float(self.distance[order][np.searchsorted(sums, share * sums[-1])])


def scan_error(head: Head, surface: Surface) -> ScanError:
    """Measure how far a scan is from the skin of a head.

    Left out is what the template does not have: vertices whose closest point is on a free edge
    of the skin (ears, scalp, neck, inside of mouth and eyes) or faces another way.

    Raises
    ------
    SolveError
        Nothing of the scan lies on the face.
    """
    skin = Matcher(skin_surface(head), 4000)
    normals = surface.vertex_normals
    near, facing, good = skin.matches(surface.vertices, 10.0)
    good &= np.einsum("ni,ni->n", facing, normals) > 0.3
    points, area = surface.vertices[good], surface.vertex_areas[good]
    outside = surface.escaping(points, normals[good]) > _ESCAPING
    if not area[outside].sum() > 0.0:
        raise SolveError(
            f"{surface.name}: nothing of it lies on the face; give landmarks, or a scan of the "
            "face alone"
        )
    covered = float(area[outside].sum() / surface.area)
    return ScanError(np.linalg.norm(near[good] - points, axis=1), area, outside, covered)


def _seen(head: Head, surface: Surface) -> float:
    """Return which share of the skin the scan shows, on one side at least."""
    skin = SkinPlaces.of(head, 4)
    points = head.tissue.evaluate(skin.elements, skin.xi)
    normals = outer_normals(head, head.tissue, skin)
    scans = [Matcher(part, 1000) for part in (surface, surface.mirrored(head.midplane))]
    found = [good for good, _ in matches(scans, points, normals, 2.0)]
    return float(np.any(found, axis=0).mean())


def neck_height(head: Head) -> float:
    """Return the height (mm) of the cut through the neck."""
    neck = head.tissue.face(*head.sides["neck"])
    return float(neck.evaluate(*neck.gauss_points(4)[:2])[:, 2].max())


def least_volume(muscle: Muscle) -> float:
    """Return the least Jacobian determinant of a muscle at 3 x 3 x 3 points an element."""
    mesh = muscle.mesh
    return float(np.linalg.det(mesh.jacobian(*mesh.gauss_points(3)[:2])).min())
