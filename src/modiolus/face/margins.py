"""Where the lips part and the lids open on the surface of a face.

A scan says nothing of margins. They are found in its depth as seen from the front: the parting
line of the lips is the path along which the sharpest notch near the mouth runs, on both sides of
the face at once, to the corner where it fades; the opening of an eye is a patch behind a step in
depth (the eyeball, or nothing at all) that a closed contour surrounds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_smoothing_spline
from scipy.ndimage import label, maximum_filter

from ..anatomy.surface import Surface
from ..hermite.basis import Array

_FRONT = np.array([0.0, 1.0, 0.0])
#: Height (mm) in which the mouth is sought above and below where it is expected.
_SEARCH = 13.0
#: Spacing (mm) of rays up and across, and the arm over which a notch's sharpness is measured.
_UP, _ACROSS, _ARM = 0.1, 0.5, 1.5
#: Depth (mm) that stands for a ray that meets nothing, behind the deepest hit.
_NOTHING = 30.0
#: Widest half mouth (mm); the sharpness (mm) below which the notch has faded, and that from which
#: on it is a gap, of whatever depth.
_WIDEST, _FADED, _GAP = 38.0, 0.5, 3.0
#: Length (mm) over which it may fade and go on.
_LAPSE = 3.0
#: Height (mm) of a place where rays meet nothing from which on it is a hole of the scan.
_HOLE = 6.0
#: Steepest slope of the parting line, the cost of a step up or down (mm of sharpness a mm²), and
#: the weight of its bend.
_SLOPE, _STEP_COST, _BEND = 2.0, 0.3, 10.0
#: Columns in which the line must be known, and how far (mm) from the mid-plane it may begin.
_KNOWN, _CUT = 20, 6.0
#: A depth step a ray (mm) at which the surface hides what is behind.
_STEP = 0.8
#: Half width and half height (mm) of the window in which an eye is sought, its rays' spacing, and
#: the step in depth a mm that bounds an opening.
_EYE_WINDOW, _EYE_RAYS, _EYE_STEP = (24.0, 28.0), 0.25, 3.0
#: Area (mm²) of an eye's opening, and how far (mm) it is from its place in the head at most.
_EYE_AREA, _EYE_AWAY = (40.0, 500.0), 20.0


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


def find_margins(surfaces: Sequence[Surface], mouth: Array, eye: Array) -> Margins:
    """Find the margins of the left half of a face that looks to -y.

    Parameters
    ----------
    surfaces : sequence of Surface
        The face in the frame of a head (mm), and its mirror image.
    mouth : (3,) array
        About where the lips part in the mid-plane.
    eye : (3,) array
        About the middle of the left eye's opening.
    """
    shells = [surface.largest_component() for surface in surfaces]
    lids = [found for shell in shells if (found := _eye(shell, eye)) is not None]
    upper, lower = (_mean_line([pair[k] for pair in lids]) for k in (0, 1))
    return Margins(_mouth(shells, mouth), upper, lower)


def _mean_line(lines: list[Array]) -> Array | None:
    """Return the mean of lines that run along x, point by point of their length across."""
    if not lines:
        return None
    shares = np.linspace(0.0, 1.0, 101)
    resampled = []
    for line in lines:
        at = (line[:, 0] - line[0, 0]) / (line[-1, 0] - line[0, 0])
        resampled.append(np.column_stack([np.interp(shares, at, line[:, k]) for k in range(3)]))
    return np.asarray(np.mean(resampled, axis=0))


def _depths(surface: Surface, x: Array, z: Array) -> Array:
    """Return the depth y seen from the front on a raster, (len(x), len(z)); NaN for nothing."""
    places = np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1).reshape(-1, 2)
    start = np.full(len(places), surface.bounds[0, 1] - 10.0)
    hits = surface.first_hits(np.column_stack([places[:, 0], start, places[:, 1]]), _FRONT)
    return np.asarray(hits[:, 1].reshape(len(x), len(z)))


def _sharpness(depth: Array) -> Array:
    """Return how much deeper (mm) each place of profiles (m, n) is than its sides."""
    arm = round(_ARM / _UP)
    out = np.zeros(depth.shape)
    sides = 0.5 * (depth[:, 2 * arm :] + depth[:, : -2 * arm])
    # A gap between the lips must not count more than a deep notch.
    out[:, arm:-arm] = np.clip(depth[:, arm:-arm] - sides, 0.0, _GAP)
    return out


def _in_holes(seen: Array) -> NDArray[np.bool_]:
    """Return which places of a raster are in a hole of the scan, or too near to one.

    The gap between two lips is low, also where it opens into a hole or beyond the scan's edge.
    """
    runs, _ = label(np.isnan(seen), [[0, 0, 0], [1, 1, 1], [0, 0, 0]])
    high = np.bincount(runs.ravel()) * _UP > _HOLE
    high[0] = False
    around = (2 * round(_ARM / _ACROSS) + 1, 2 * round(_ARM / _UP) + 1)
    return np.asarray(maximum_filter(high[runs], around, mode="nearest"))


def _mouth(surfaces: Sequence[Surface], mouth: Array) -> Array | None:
    """Return the parting line (n, 3) from the mid-plane to the corner of the mouth."""
    x = mouth[0] + np.arange(0.0, _WIDEST, _ACROSS)
    z = mouth[2] + np.arange(-_SEARCH - _ARM, _SEARCH + _ARM, _UP)
    sharp, profiles = np.zeros((len(x), len(z))), []
    for surface in surfaces:
        seen = _depths(surface, x, z)
        if np.isnan(seen).all():
            continue
        depth = np.where(np.isnan(seen), np.nanmax(seen) + _NOTHING, seen)
        known = ~_in_holes(seen)
        sharp = np.maximum(sharp, np.where(known, _sharpness(depth), 0.0))
        profiles.append((seen, depth, known))
    likely = np.exp(-(((z - mouth[2]) / (0.8 * _SEARCH)) ** 2))
    rows = _sharpest_path(sharp * likely)
    line: list[Array] = []
    for k, row in enumerate(rows):
        if line and x[k] - line[-1][0] > _LAPSE:
            break
        parted = [
            _parting(seen[k], depth[k], z, row) for seen, depth, known in profiles if known[k, row]
        ]
        found = [place for place in parted if not np.isnan(place).any()]
        if found and sharp[k, row] > _FADED:
            line.append(np.array([x[k], *np.mean(found, axis=0)]))
    if len(line) < _KNOWN or line[0][0] - x[0] > _CUT:
        return None
    if line[0][0] > x[0]:
        # A scan of one side may end before the mid-plane, where the line is level.
        line.insert(0, np.array([x[0], *line[0][1:]]))
    # Rays fall on one lip or the other, and on the steps of the scan: the line itself is smooth.
    along, back, up = np.array(line).T
    smooth = [make_smoothing_spline(along, part, lam=_BEND)(along) for part in (back, up)]
    return np.column_stack([along, *smooth])


def _sharpest_path(gain: Array) -> NDArray[np.int64]:
    """Return the row in each column of a raster (m, n) of the path with the greatest sum.

    Steps from column to column cost their square (Bellman's dynamic programming).
    """
    most = round(_SLOPE * _ACROSS / _UP)
    shifts = np.arange(-most, most + 1)
    rows = np.arange(gain.shape[1])
    before = rows - shifts[:, None]
    outside = (before < 0) | (before >= len(rows))
    cost = np.where(outside, np.inf, _STEP_COST * (shifts[:, None] * _UP) ** 2)
    before = np.clip(before, 0, len(rows) - 1)
    best, origins = gain[0], []
    for column in gain[1:]:
        reached = best[before] - cost
        pick = reached.argmax(axis=0)
        origins.append(before[pick, rows])
        best = reached[pick, rows] + column
    path = [int(best.argmax())]
    for origin in reversed(origins):
        path.append(int(origin[path[-1]]))
    return np.array(path[::-1])


def _parting(seen: Array, depth: Array, z: Array, here: int) -> tuple[float, float]:
    """Return depth and height where two lips meet, or half way between where they stop showing.

    Where one hangs over the other they meet behind it. The depth is NaN where neither shows.
    """
    steps = np.abs(np.diff(depth)) > _STEP
    reach = round(2.0 / _UP)
    low, high = max(here - reach, 0), min(here + reach, len(steps))
    found = low + np.flatnonzero(steps[low:high])
    if not len(found):
        return float(seen[here]), float(z[here])
    edges = [int(found[0]), int(found[-1]) + 1]
    if len(found) == 1:
        edges = [max(edges, key=lambda k: float(depth[k]))]
    known = [k for k in edges if not np.isnan(seen[k])]
    if not known:
        return float(seen[here]), float(z[here])
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
        if away < min(best, _EYE_AWAY):
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
