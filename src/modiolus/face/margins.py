"""Where the lips part and the lids open on the surface of a face.

A scan says nothing of margins. They are found in its depth as seen from the front: the parting
line of the lips is the sharpest notch near the mouth, followed from the mid-plane to the corner
where it fades; the opening of an eye is a patch behind a step in depth (the eyeball, or nothing
at all) that a closed contour surrounds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label

from ..anatomy.surface import Surface
from ..hermite.basis import Array

_FRONT = np.array([0.0, 1.0, 0.0])
#: Height (mm) in which the mouth is sought above and below where it is expected.
_SEARCH = 13.0
#: Spacing (mm) of rays up and across, and the arm over which a notch's sharpness is measured.
_UP, _ACROSS, _ARM = 0.1, 0.5, 1.5
#: Depth (mm) that stands for a ray that meets nothing, behind the deepest hit.
_NOTHING = 30.0
#: Widest half mouth (mm); and the sharpness (mm) below which the notch has faded.
_WIDEST, _FADED = 38.0, 0.6
#: A depth step a ray (mm) at which the surface hides what is behind.
_STEP = 0.8
#: Half width and half height (mm) of the window in which an eye is sought, its rays' spacing, and
#: the step in depth a mm that bounds an opening.
_EYE_WINDOW, _EYE_RAYS, _EYE_STEP = (24.0, 14.0), 0.25, 3.0
#: Area (mm²) of an eye's opening.
_EYE_AREA = (40.0, 500.0)


@dataclass(frozen=True)
class Margins:
    """Margins of the left half of a face; None where a scan does not show them.

    Attributes
    ----------
    lips : (n, 3) array or None
        Parting line from the mid-plane to the corner of the mouth (mm).
    lid_upper, lid_lower : (n, 3) array or None
        From the inner to the outer corner of the eye.
    """

    lips: Array | None
    lid_upper: Array | None
    lid_lower: Array | None


def find_margins(surface: Surface, mouth: Array, eye: Array) -> Margins:
    """Find the margins of the left half of a face that looks to -y.

    Parameters
    ----------
    surface : Surface
        The face in the frame of a head (mm).
    mouth : (3,) array
        About where the lips part in the mid-plane.
    eye : (3,) array
        About the middle of the left eye's opening.
    """
    shell = surface.largest_component()
    lids = _eye(shell, eye)
    upper, lower = lids if lids is not None else (None, None)
    return Margins(_mouth(shell, mouth), upper, lower)


def _depths(surface: Surface, x: Array, z: Array) -> Array:
    """Return the depth y seen from the front on a raster, (len(x), len(z)); NaN for nothing."""
    places = np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1).reshape(-1, 2)
    start = np.full(len(places), surface.bounds[0, 1] - 10.0)
    hits = surface.first_hits(np.column_stack([places[:, 0], start, places[:, 1]]), _FRONT)
    return np.asarray(hits[:, 1].reshape(len(x), len(z)))


def _sharpness(depth: Array) -> Array:
    """Return how much deeper (mm) each place of profiles (m, n) is than its sides."""
    arm = round(_ARM / _UP)
    out = np.full(depth.shape, -np.inf)
    sides = 0.5 * (depth[:, 2 * arm :] + depth[:, : -2 * arm])
    # A gap between the lips must not count more than a deep notch.
    out[:, arm:-arm] = np.minimum(depth[:, arm:-arm] - sides, 6.0)
    return out


def _mouth(surface: Surface, mouth: Array) -> Array | None:
    x = mouth[0] + np.arange(0.0, _WIDEST, _ACROSS)
    z = mouth[2] + np.arange(-_SEARCH - _ARM, _SEARCH + _ARM, _UP)
    seen = _depths(surface, x, z)
    if np.isnan(seen[:12]).mean() > 0.4:
        return None
    depth = np.where(np.isnan(seen), np.nanmax(seen) + _NOTHING, seen)
    sharp = _sharpness(depth)
    likely = np.exp(-(((z - mouth[2]) / (0.8 * _SEARCH)) ** 2))
    here = int(np.argmax(np.median(np.clip(sharp[2:12], 0.0, None), axis=0) * likely))
    window = round(1.0 / _UP)
    line: list[Array] = []
    for k in range(len(x)):
        near = np.arange(max(here - window, 0), min(here + window + 1, len(z)))
        here = int(near[np.argmax(sharp[k, near])])
        if sharp[k, here] < _FADED:
            break
        line.append(np.array([x[k], *_parting(seen[k], depth[k], z, here)]))
    return np.array(line) if len(line) > 20 else None


def _parting(seen: Array, depth: Array, z: Array, here: int) -> tuple[float, float]:
    """Return depth and height where two lips meet, or half way between where they stop showing."""
    steps = np.abs(np.diff(depth)) > _STEP
    reach = round(2.0 / _UP)
    low, high = max(here - reach, 0), min(here + reach, len(steps))
    found = low + np.flatnonzero(steps[low:high])
    if not len(found):
        return float(depth[here]), float(z[here])
    edges = [int(found[0]), int(found[-1]) + 1]
    known = [k for k in edges if not np.isnan(seen[k])]
    if not known:
        return float(depth[here]), float(z[here])
    return float(np.mean(seen[known])), float(np.mean(z[edges]))


def _eye(surface: Surface, eye: Array) -> tuple[Array, Array] | None:
    x = eye[0] + np.arange(-_EYE_WINDOW[0], _EYE_WINDOW[0], _EYE_RAYS)
    z = eye[2] + np.arange(-_EYE_WINDOW[1], _EYE_WINDOW[1], _EYE_RAYS)
    seen = _depths(surface, x, z)
    if np.isnan(seen).mean() > 0.6:
        return None
    depth = np.where(np.isnan(seen), np.nanmax(seen) + _NOTHING, seen)
    step = _EYE_STEP * _EYE_RAYS
    smooth = np.ones(depth.shape, dtype=bool)
    for axis in (0, 1):
        jump = np.abs(np.diff(depth, axis=axis)) > step
        # The deeper side of a jump belongs to what is behind.
        deeper = np.diff(depth, axis=axis) > 0.0
        before, after = ([slice(None)] * 2 for _ in range(2))
        before[axis], after[axis] = slice(None, -1), slice(1, None)
        smooth[tuple(before)] &= ~(jump & deeper)
        smooth[tuple(after)] &= ~(jump & ~deeper)
    patches, count = label(smooth)
    best, found = np.inf, None
    for number in range(1, count + 1):
        patch = patches == number
        columns, rows = np.nonzero(patch)
        edge = columns.min() == 0 or rows.min() == 0
        edge |= columns.max() == len(x) - 1 or rows.max() == len(z) - 1
        area = len(columns) * _EYE_RAYS**2
        if edge or not _EYE_AREA[0] < area < _EYE_AREA[1]:
            continue
        away = np.hypot(x[columns].mean() - eye[0], z[rows].mean() - eye[2])
        if away < min(best, 15.0):
            best, found = away, patch
    if found is None:
        return None
    lower, upper = [], []
    for k in np.flatnonzero(found.any(axis=1)):
        rows = np.flatnonzero(found[k])
        low, high = rows.min(), rows.max()
        while low > 0 and not smooth[k, low - 1]:
            low -= 1
        while high < len(z) - 1 and not smooth[k, high + 1]:
            high += 1
        # Where the rim reaches the end of the window there is no margin to be seen.
        if low == 0 or high == len(z) - 1:
            return None
        lower.append([x[k], depth[k, low - 1], z[low]])
        upper.append([x[k], depth[k, high + 1], z[high]])
    return np.array(upper), np.array(lower)
