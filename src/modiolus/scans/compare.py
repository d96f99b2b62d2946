"""How far a computed face is from a measured one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .scan import Scan
from .skin import REGIONS, Skin, SkinState

__all__ = ["Comparison", "Figures", "compare", "figures"]

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: The scan has moved where it is farther than this from the neutral one (mm).
MOVED = 1.0
#: Spacing of the points of the model that are projected on the scan (mm).
_SPACING = 2.0


@dataclass(frozen=True)
class Figures:
    """Figures of a set of distances, in mm, weighted by the area that each point stands for.

    Attributes
    ----------
    points : int
    area_mm2 : float
    rms, mean, median, p95, max : float
        NaN where there are no points.
    """

    points: int
    area_mm2: float
    rms: float
    mean: float
    median: float
    p95: float
    max: float

    def as_dict(self) -> dict[str, float | int | None]:
        """Return the figures for a report; what is not known is None."""
        out: dict[str, float | int | None] = {"points": self.points}
        for name in ("area_mm2", "rms", "mean", "median", "p95", "max"):
            value = getattr(self, name)
            digits = 0 if name == "area_mm2" else 4
            key = name if name == "area_mm2" else f"{name}_mm"
            out[key] = round(value, digits) if np.isfinite(value) else None
        return out


def figures(distance: Array, weight: Array) -> Figures:
    """Return the figures of distances (n,) with weights (n,)."""
    total = float(weight.sum())
    if not len(distance) or total <= 0.0:
        return Figures(len(distance), 0.0, *[float("nan")] * 5)
    order = np.argsort(distance)
    below = np.cumsum(weight[order]) - 0.5 * weight[order]
    median, p95 = np.interp([0.5 * total, 0.95 * total], below, distance[order])
    return Figures(
        len(distance),
        total,
        float(np.sqrt((weight * distance**2).sum() / total)),
        float((weight * distance).sum() / total),
        float(median),
        float(p95),
        float(distance.max()),
    )


@dataclass(frozen=True, eq=False)
class Measure:
    """Errors of the model that has moved and of the one that has not, point by point.

    Attributes
    ----------
    error, still : (n,) arrays
        With the model in its state, and at rest (mm).
    covered, moved : (n,) bool arrays
        Points that are visible and have a counterpart, and those where the scan has moved.
    region : (n,) int array
        Index into `REGIONS`.
    weight : (n,) array
        Area (mm²).
    """

    error: Array
    still: Array
    covered: BoolArray
    moved: BoolArray
    region: NDArray[np.int64]
    weight: Array

    def of(self, values: Array, where: BoolArray) -> Figures:
        """Return the figures of some values on covered points."""
        rows = self.covered & where
        return figures(values[rows], self.weight[rows])

    @property
    def explained(self) -> float:
        """Share of the motion that the model explains: 1 - rms of the error / rms at rest.

        Both are taken over the region where the scan has moved.
        """
        still = self.of(self.still, self.moved).rms
        return 1.0 - self.of(self.error, self.moved).rms / still if still > 0.0 else float("nan")

    def as_dict(self) -> dict[str, Any]:
        """Return all figures for a report."""
        everywhere = np.ones(len(self.error), dtype=bool)
        regions: dict[str, Any] = {}
        for number, name in enumerate(REGIONS):
            here = self.region == number
            if (here & self.covered).any():
                regions[name] = {
                    "error": self.of(self.error, here).as_dict(),
                    "moved": self.of(self.error, here & self.moved).as_dict(),
                    "still": self.of(self.still, here).as_dict(),
                }
        explained = self.explained
        return {
            "error": self.of(self.error, everywhere).as_dict(),
            "moved": self.of(self.error, self.moved).as_dict(),
            "still": self.of(self.still, everywhere).as_dict(),
            "still_moved": self.of(self.still, self.moved).as_dict(),
            "explained": round(explained, 4) if np.isfinite(explained) else None,
            "regions": regions,
        }


@dataclass(frozen=True, eq=False)
class Comparison:
    """A scan against a computed face.

    Attributes
    ----------
    scan : Scan
        In the head's frame.
    distances : Measure
        Of the points of the scan to the skin: what can be measured of any scan.
    reverse : Figures
        Of points of the skin to the scan.
    rest : Figures or None
        Of the points of the neutral scan to the skin at rest: what is left by the shape alone.
    matched : Measure or None
        Differences between the displacements of the same points of the skin, where neutral and
        scan are one mesh in two states. These also see what slides along the surface.
    """

    scan: Scan
    distances: Measure
    reverse: Figures
    rest: Figures | None
    matched: Measure | None

    @property
    def coverage(self) -> float:
        """Share of the scan's area that has a counterpart."""
        weight = self.distances.weight
        return float(weight[self.distances.covered].sum() / weight.sum())

    def as_dict(self) -> dict[str, Any]:
        """Return all figures for a report."""
        return {
            **self.distances.as_dict(),
            "reverse": self.reverse.as_dict(),
            "rest": None if self.rest is None else self.rest.as_dict(),
            "matched": None if self.matched is None else self.matched.as_dict(),
            "coverage": round(self.coverage, 4),
        }


def compare(skin: Skin, parameters: Array, scan: Scan, neutral: Scan | None = None) -> Comparison:
    """Measure the distance between a state of a head and a scan.

    Parameters
    ----------
    skin : Skin
    parameters : (n_params, 3) array
        Of the tissue.
    scan : Scan
        In the head's frame (see `modiolus.scans.align`).
    neutral : Scan, optional
        The same person at rest, in the head's frame: tells where the scan has moved.
    """
    rest = skin.head.tissue.parameters
    state, still = skin.state(parameters), skin.state(rest)
    feet = state.feet(scan.points, scan.normals)
    unmoved = still.feet(scan.points, scan.normals)
    everywhere = np.ones(len(scan.points), dtype=bool)
    moved, shape, matched = everywhere, None, None
    if neutral is not None:
        if scan.same_order(neutral):
            motion = scan.points - neutral.points
            moved = np.linalg.norm(motion, axis=1) > MOVED
        else:
            near = neutral.nearest(scan.points)[0]
            moved = np.linalg.norm(scan.points - near, axis=1) > MOVED
        own = still.feet(neutral.points, neutral.normals)
        seen = own.covered & neutral.visible
        shape = figures(own.distance[seen], neutral.weights[seen])
        if scan.same_order(neutral):
            shift = skin.places(own, parameters) - skin.places(own, rest)
            matched = Measure(
                np.linalg.norm(shift - motion, axis=1),
                np.linalg.norm(motion, axis=1),
                seen,
                moved,
                skin.region[own.elements],
                neutral.weights,
            )
    distances = Measure(
        feet.distance,
        unmoved.distance,
        feet.covered & unmoved.covered & scan.visible,
        moved,
        skin.region[feet.elements],
        scan.weights,
    )
    return Comparison(scan, distances, _reverse(skin, state, scan), shape, matched)


def _reverse(skin: Skin, state: SkinState, scan: Scan) -> Figures:
    """Project points spread over the skin on the scan."""
    surface = skin.surface(state.parameters)
    points = surface.samples(_SPACING)
    normals = surface.normals[surface.closest(points).faces]
    near, outward, rim = scan.nearest(points)
    distance = np.linalg.norm(near - points, axis=1)
    seen = ~rim & (distance < 20.0) & ((outward * normals).sum(axis=1) > 0.2)
    return figures(distance[seen], np.full(int(seen.sum()), _SPACING**2))
