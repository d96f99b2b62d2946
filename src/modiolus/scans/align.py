"""The pose of a scan on a head: a whole fit, refined on the parts that keep still."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError, SolveError
from ..fitting.register import UNITS, Registration, icp, register
from .scan import Scan
from .skin import STILL_ZONES, Skin

__all__ = [
    *("Alignment", "align", "align_to_neutral", "believed_unit", "place", "register_scan"),
]

Array = NDArray[np.float64]

#: A whole fit worse than this (mm), or of less of the face, has found no face.
_WORST_RMS, _LEAST_MATCHED = 6.0, 0.25
#: Sizes of a head relative to ours that are believed.
_SIZES = (0.7, 1.4)
#: A still zone with fewer points says nothing.
_FEWEST = 30
#: A pose that leaving out a zone moves by more (mm) is not believed.
_UNSTABLE = 1.5
_TUKEY, _LEAST_WIDTH = 4.685, 0.3


@dataclass(frozen=True)
class Alignment:
    """The pose of a scan and how far to trust it.

    Attributes
    ----------
    pose : Registration
        From the file's unit and frame to the head's.
    still_rms_mm : float
        Distance left on the still zones, Tukey-weighted root mean square.
    zones : dict of str to float
        Still zone by zone: how far the face moves, root mean square in mm, when the pose is found
        without it. Empty where there are fewer than two zones.
    """

    pose: Registration
    still_rms_mm: float
    zones: dict[str, float]

    @property
    def scatter_mm(self) -> float:
        """The largest of `zones`: how stable the pose is."""
        return max(self.zones.values(), default=float("inf"))

    @property
    def deviation_mm(self) -> float:
        """Standard deviation of the pose by the jackknife over the zones; 0 where it has none."""
        shifts = np.array(list(self.zones.values()))
        share = (len(shifts) - 1) / max(len(shifts), 1)
        return float(np.sqrt(max(share, 0.0) * (shifts**2).sum()))

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for a report."""
        rms = self.still_rms_mm
        return {
            "scale": round(self.pose.scale, 6),
            "rotation": np.round(self.pose.rotation, 6).tolist(),
            "translation_mm": np.round(self.pose.translation, 4).tolist(),
            "still_rms_mm": round(rms, 4) if np.isfinite(rms) else None,
            "zones": {name: round(value, 3) for name, value in self.zones.items()},
        }


def place(
    scan: Scan,
    skin: Skin,
    neutral: Scan | None = None,
    unit: str | None = None,
    landmarks: tuple[ArrayLike, ArrayLike] | None = None,
) -> tuple[Scan, Scan | None, Alignment]:
    """Bring a scan, and the neutral one of the same person, into a head's frame.

    A neutral scan shows the head at rest and is aligned as a whole; the expression then follows
    on the parts that keep still. Without a neutral scan those parts are sought on the head.

    Parameters
    ----------
    scan : Scan
        As read.
    skin : Skin
    neutral : Scan, optional
    unit, landmarks
        As in `register_scan`; the landmarks are those of the neutral scan if there is one.

    Returns
    -------
    scan, neutral : Scan
        Placed.
    alignment : Alignment
        Of the scan.
    """
    if neutral is None:
        alignment = align(scan, skin, register_scan(scan, skin, unit, landmarks))
        return scan.placed(alignment.pose), None, alignment
    pose = register_scan(neutral, skin, unit, landmarks)
    alignment = align_to_neutral(scan, neutral, skin, pose)
    return scan.placed(alignment.pose), neutral.placed(pose), alignment


def register_scan(
    scan: Scan,
    skin: Skin,
    unit: str | None = None,
    landmarks: tuple[ArrayLike, ArrayLike] | None = None,
    scaled: bool = True,
) -> Registration:
    """Find a scan's pose, unit and size on a head at rest, and refuse what is no face.

    Parameters
    ----------
    scan : Scan
    skin : Skin
    unit : str, optional
        One of `UNITS`; found from the size by default.
    landmarks : ((n, 3) array, (n, 3) array), optional
        Matched points of the scan and of the head.
    scaled : bool
        Whether the head may be of another size than the person.

    Raises
    ------
    InputError
        The scan is mirrored, in another unit, or shows no face.
    """
    target = skin.surface(skin.head.tissue.parameters)
    try:
        pose = register(scan.surface, target, landmarks, scaled)
    except SolveError as error:
        raise InputError(f"{scan.name}: no face found; {error}") from None
    if pose.facing < 0.0:
        raise InputError(
            f"{scan.name}: its triangles face inward, as those of a mirrored scan do; mirror it "
            "back or turn them round"
        )
    if not pose.rms < _WORST_RMS or pose.matched < _LEAST_MATCHED:
        raise InputError(
            f"{scan.name}: no face found (it fits to {pose.rms:.1f} mm only); give a scan of the "
            "face, or landmarks"
        )
    believed_unit(scan.name, pose.scale, unit)
    return pose


def believed_unit(name: str, scale: float, unit: str | None) -> str:
    """Return the unit of what fits a head at a scale.

    Parameters
    ----------
    name : str
        Of what was measured, for messages.
    scale : float
        Millimetres of the head in a unit of what was measured.
    unit : str or None
        The one that was given; None to find it.

    Raises
    ------
    InputError
        In that unit, or in any, the face would have no size that is believed.
    """
    sizes = {key: value / scale for key, value in UNITS.items()}
    fitting = [key for key, size in sizes.items() if _SIZES[0] < size < _SIZES[1]]
    if not fitting:
        close = min(sizes, key=lambda key: abs(np.log(sizes[key])))
        raise InputError(
            f"{name}: no face of a believable size (in {close} it would be "
            f"{sizes[close]:.2g} times the head); check what was measured and its unit"
        )
    if unit is not None and unit not in fitting:
        raise InputError(
            f"{name}: wrong unit, in {unit} the face would be {sizes[unit]:.3g} times "
            f"as large as the head; it seems to be in {fitting[0]}"
        )
    return unit or fitting[0]


def align(scan: Scan, skin: Skin, start: Registration) -> Alignment:
    """Refine the pose of a scan on the head at rest, on the parts that keep still.

    Parameters
    ----------
    scan : Scan
        As read.
    skin : Skin
    start : Registration
        From `register_scan`.
    """
    found = _on_still_parts(scan, skin, start, None)
    # Another person's temples and forehead may be too unlike the head's to hold on to.
    return found if found.scatter_mm < _UNSTABLE else Alignment(start, float("nan"), {})


def align_to_neutral(
    scan: Scan, neutral: Scan, skin: Skin, neutral_pose: Registration
) -> Alignment:
    """Find the pose of an expression from the same person's neutral scan.

    Parameters
    ----------
    scan, neutral : Scan
        As read.
    skin : Skin
    neutral_pose : Registration
        Of the neutral scan on the head at rest; the expression has its unit and size.

    Raises
    ------
    InputError
        The scan shows no face, or is mirrored against the neutral one.
    """
    placed = neutral.placed(neutral_pose)
    start = None
    try:
        # Often both are in one frame already.
        start = icp(scan.surface, placed.surface, neutral_pose)
        if not (start.rms < 3.0 and start.facing > 0.5 and start.matched > 0.5):
            start = None
    except SolveError:
        pass
    if start is None:
        sized = Registration(neutral_pose.scale)
        moved = scan.placed(sized)
        try:
            whole = register(moved.surface, placed.surface, scaled=False)
        except SolveError as error:
            raise InputError(f"{scan.name}: no face found; {error}") from None
        if whole.facing < 0.0:
            raise InputError(f"{scan.name}: mirrored against {neutral.name}; mirror it back")
        if not whole.rms < _WORST_RMS or abs(np.log(whole.scale)) > 0.3:
            raise InputError(
                f"{scan.name}: not the face of {neutral.name} in the same unit; give both alike"
            )
        start = whole.after(sized)
    found = _on_still_parts(scan, skin, start, placed)
    # Where the still parts cannot tell the pose from that of the neutral scan, it is that: both
    # were taken in one frame. A raised brow moves the forehead more than a still head does.
    feet = skin.state(skin.head.tissue.parameters).feet(placed.points, placed.normals)
    face = neutral.points[feet.covered]
    apart = found.pose.apply(face) - neutral_pose.apply(face)
    if np.sqrt((apart**2).sum(axis=1).mean()) < found.deviation_mm:
        return replace(found, pose=neutral_pose)
    return found


def _on_still_parts(scan: Scan, skin: Skin, start: Registration, neutral: Scan | None) -> Alignment:
    state = skin.state(skin.head.tissue.parameters)
    placed = scan.placed(start)
    feet = state.feet(placed.points, placed.normals)
    zone = np.where(feet.covered, skin.zones(feet), -1)
    used = [k for k in range(len(STILL_ZONES)) if (zone == k).sum() >= _FEWEST]
    if not used:
        return Alignment(start, float("nan"), {})

    def nearest(points: Array, normals: Array) -> tuple[Array, Array, Array]:
        if neutral is None:
            found = state.feet(points, normals)
            return found.points, found.normals, found.covered.astype(float)
        near, outward, rim = neutral.nearest(points)
        return near, outward, (~rim & ((outward * normals).sum(axis=1) > 0.3)).astype(float)

    def fit(zones: list[int]) -> tuple[Registration, float]:
        rows = np.isin(zone, zones)
        # Every zone counts alike, however finely it was measured.
        share = np.zeros(len(zone))
        for k in zones:
            share[zone == k] = 1.0 / (zone == k).sum()
        points, normals, base = placed.points[rows], placed.normals[rows], share[rows]
        pose, rms = Registration(), float("nan")
        for _ in range(40):
            moved = pose.apply(points)
            near, outward, good = nearest(moved, normals @ pose.rotation.T)
            gap = ((near - moved) * outward).sum(axis=1)
            width = max(_TUKEY * 1.4826 * float(np.median(np.abs(gap))), _LEAST_WIDTH)
            weight = base * good * np.clip(1.0 - (gap / width) ** 2, 0.0, None) ** 2
            total = weight.sum()
            if total <= 0.0:
                break
            rms = float(np.sqrt((weight * gap**2).sum() / total))
            centre = moved.mean(axis=0)
            matrix = np.hstack([np.cross(moved - centre, outward), outward])
            normal = matrix.T @ (weight[:, None] * matrix)
            # Directions that the zones hardly determine stay where the whole fit put them.
            normal += 1e-4 * np.diag(np.diag(normal))
            step = np.linalg.solve(normal, matrix.T @ (weight * gap))
            pose = pose.stepped(step, centre)
            if np.abs(step[3:]).max() < 1e-4 and np.abs(step[:3]).max() < 1e-6:
                break
        return pose, rms

    best, rms = fit(used)
    face = placed.points[feet.covered]
    scatter = {}
    if len(used) > 1:
        for left_out in used:
            other, _ = fit([k for k in used if k != left_out])
            moved = other.apply(face) - best.apply(face)
            scatter[STILL_ZONES[left_out]] = float(np.sqrt((moved**2).sum(axis=1).mean()))
    return Alignment(best.after(start), rms, scatter)
