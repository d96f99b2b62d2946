"""Single points of a face that were measured, as in motion capture, frame by frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..files import coordinates, read_table
from ..fitting.register import Registration, similarity
from .align import believed_unit
from .skin import Feet, Skin
from .target import MarkerTarget

__all__ = ["Frame", "Marked", "bind", "read_markers"]

Array = NDArray[np.float64]

#: A marker farther than this (mm) from the skin at rest is on no skin that is modelled.
_REACH = 20.0
#: Frames in a file at most.
_MOST_FRAMES = 100_000
_AXES = ("x", "y", "z", "x_mm", "y_mm", "z_mm")


@dataclass(frozen=True)
class Frame:
    """Markers at one time.

    Attributes
    ----------
    time : float
        In seconds.
    points : dict of str to (3,) array
        By marker, in the file's unit and frame; those that were not seen are left out.
    """

    time: float
    points: dict[str, Array] = field(default_factory=dict)


def read_markers(path: str | Path, rate: float = 30.0) -> list[Frame]:
    """Read markers, of one frame or of several in time.

    Parameters
    ----------
    path : path
        A CSV file with the columns ``marker`` (or ``name``) and ``x, y, z`` (or ``x_mm`` and so
        on), and where there are several frames ``time`` (s) or ``frame``. A marker that was not
        seen has no coordinates, or no row.
    rate : float
        Frames a second, for files that count them.

    Returns
    -------
    list of Frame
        In the order of time.

    Raises
    ------
    InputError
        The file cannot be read, a row is not understood, or a frame has a marker twice.
    """
    path = Path(path)
    found: dict[float, Frame] = {}
    for number, row in read_table(path):
        where = f"{path}: line {number}"
        name = row.get("marker") or row.get("name")
        if name is None:
            raise InputError(f"{where} has no marker; add a column marker with its name")
        try:
            time = float(row["time"]) if "time" in row else float(row.get("frame", 0.0)) / rate
        except ValueError:
            time = math.nan
        if not math.isfinite(time):
            raise InputError(f"{where} has a time or a frame that is no number; mend it")
        frame = found.setdefault(time, Frame(time))
        if len(found) > _MOST_FRAMES:
            raise InputError(f"{path}: more than {_MOST_FRAMES} frames; give a part of them")
        seen = [row[axis] for axis in _AXES if axis in row]
        if not seen or all(text.lower() == "nan" for text in seen):
            continue
        if name in frame.points:
            raise InputError(f"{where}: {name} is there twice at {time:g} s; leave one of them out")
        frame.points[name] = np.array(coordinates(row, where))
    frames = [found[time] for time in sorted(found) if found[time].points]
    if not frames:
        raise InputError(f"{path}: no markers in it; give a row for each")
    return frames


@dataclass(frozen=True, eq=False)
class Marked:
    """Markers bound to the skin of a head.

    Attributes
    ----------
    skin : Skin
    names : list of n str
    feet : Feet
        Where on the skin each of them sits.
    pose : Registration
        From the unit and frame of the file to the head's.
    rest : (n, 3) array or None
        Where they were at rest, in the head's frame.
    left_out : list of str
        Markers that are not on the skin.
    """

    skin: Skin
    names: list[str]
    feet: Feet
    pose: Registration
    rest: Array | None
    left_out: list[str]

    def target(self, frame: Frame) -> MarkerTarget:
        """Return what a frame shows of the skin, without the motion of the head.

        That is told by the markers on the parts that keep their place on the skull, where three
        of them are seen, or else by all markers.

        Raises
        ------
        InputError
            Fewer than three markers are seen.
        """
        seen = np.array([k for k, name in enumerate(self.names) if name in frame.points])
        if len(seen) < 3:
            raise InputError(
                f"frame at {frame.time:g} s: {len(seen)} markers that are known are seen; give at "
                "least three"
            )
        feet = self.feet.take(seen)
        points = self.pose.apply(np.array([frame.points[self.names[k]] for k in seen]))
        if self.rest is None:
            return MarkerTarget(self.skin, feet, points, np.zeros_like(points))
        rest = self.rest[seen]
        still = np.flatnonzero(self.skin.zones(feet) >= 0)
        known = _spread(rest[still])
        used = still if known else np.arange(len(seen))
        if _spread(rest[used]):
            points = similarity(points[used], rest[used], scaled=False).apply(points)
        return MarkerTarget(self.skin, feet, points, rest - feet.points, known)


def bind(
    skin: Skin,
    rest: Frame | None,
    first: Frame,
    landmarks: tuple[Array, Array] | None = None,
    unit: str | None = None,
    where: str = "markers",
) -> Marked:
    """Find where on the skin markers sit.

    Those with the name of a landmark of the head are there; the others are at the closest point
    of the skin at rest. The pose comes from the landmarks, those among the markers and others.

    Parameters
    ----------
    skin : Skin
    rest : Frame or None
        The markers of the face at rest. Without it only those that are landmarks are known, and
        are taken to lie on the skin.
    first : Frame
        What to take the pose from where there is no `rest`.
    landmarks : ((n, 3) array, (n, 3) array), optional
        Further places in the file's frame, of the face at rest, and on the head.
    unit : str, optional
        Of the file; found by default.
    where : str
        For messages.

    Raises
    ------
    InputError
        Fewer than three places of the head are known, they lie on one line, or no head has that
        size; or fewer than three markers are on the skin.
    """
    frame = first if rest is None else rest
    names, known = skin.landmarks()
    shared = [name for name in frame.points if name in names]
    here = [frame.points[name] for name in shared]
    there = [known.points[names.index(name)] for name in shared]
    if landmarks is not None:
        here, there = [*here, *landmarks[0]], [*there, *landmarks[1]]
    if len(here) < 3:
        raise InputError(
            f"{where}: {len(here)} places of the head are known; name three markers as its "
            f"landmarks, such as {', '.join(names[:3])}, or give them with --landmarks"
        )
    pose = similarity(np.array(here), np.array(there))
    believed_unit(where, pose.scale, unit)
    if rest is None:
        feet = known.take(np.array([names.index(name) for name in shared], dtype=np.int64))
        return Marked(
            skin, shared, feet, pose, None, [name for name in first.points if name not in shared]
        )
    points = pose.apply(np.array(list(rest.points.values())))
    found = skin.state(skin.head.tissue.parameters).feet(points)
    own = np.array([names.index(name) if name in names else -1 for name in rest.points])
    near = np.flatnonzero((found.distance < _REACH) | (own >= 0))
    both = Feet.joined([found, known]).take(np.where(own >= 0, len(points) + own, range(len(own))))
    if len(near) < 3:
        raise InputError(
            f"{where}: {len(near)} markers are within {_REACH:g} mm of the skin; check the "
            "landmarks, and that the markers are those of a face at rest"
        )
    labels = list(rest.points)
    return Marked(
        skin,
        [labels[k] for k in near],
        both.take(near),
        pose,
        points[near],
        [name for k, name in enumerate(labels) if k not in near],
    )


def _spread(points: Array) -> bool:
    """Tell whether points determine a rotation: three of them, not on one line."""
    if len(points) < 3:
        return False
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(extent[1] > 0.1 * extent[0] > 0.0)
