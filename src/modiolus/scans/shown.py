"""Which parts of a face an image shows: the pose of a head's skin in a segmented image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..anatomy.segment import Segmentation
from ..anatomy.surface import Surface
from ..errors import SolveError
from ..face.head import Head
from ..fitting import Registration, icp
from .skin import REGIONS, Skin

__all__ = ["FaceShown", "find_face"]

Array = NDArray[np.float64]

#: Height (mm) of the crown above the glabella at which the search begins, and further ones for
#: images that do not show the crown; pitch of the head in degrees.
_HEIGHTS, _LOWER, _PITCHES = (85.0, 110.0), (10.0, 40.0), (-12.0, 12.0)
#: Samples of each element of the skin each way.
_SAMPLES = 3
#: Distance (mm) beyond which a part of the skin has no counterpart, and of a face that is one.
_FAR, _GOOD = 12.0, 5.0
#: Parts of which less than this is in the image are missing, those with less than all are cut.
_MISSING, _WHOLE = 0.3, 0.98


@dataclass(frozen=True)
class FaceShown:
    """Where the face is in an image, and what of it.

    Attributes
    ----------
    pose : Registration
        From the head's frame to the image's.
    distance : float
        Median distance (mm) of the head's skin in the image to the surface found there.
    shown : dict of str to float
        By region the share of it that is within the field of view.
    """

    pose: Registration
    distance: float
    shown: dict[str, float]

    @property
    def missing(self) -> list[str]:
        """Parts that the image does not show."""
        return [name for name, share in self.shown.items() if share < _MISSING]

    @property
    def cut(self) -> list[str]:
        """Parts of which the image shows less than the whole."""
        return [name for name, share in self.shown.items() if _MISSING <= share < _WHOLE]


def find_face(found: Segmentation, head: Head) -> FaceShown | None:
    """Find the face in a segmented image with the help of a head's skin.

    The image says which way is up and forward; height, pitch and size are found by fitting the
    skin from several starts. A part of the skin beyond the field of view does not count, nor
    against a pose.

    Parameters
    ----------
    found : Segmentation
    head : Head

    Returns
    -------
    FaceShown or None
        None if nothing in the image looks like a face.
    """
    skin = Skin(head)
    ticks = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    xi = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
    elements = np.repeat(np.arange(skin.mesh.n_elements), len(xi))
    left = skin.mesh.evaluate(elements, np.tile(xi, (skin.mesh.n_elements, 1)))
    # Margins turn inwards, where an image sees nothing; their elements follow the others.
    outer = elements < len(head.sides["outer"][0])
    samples = np.vstack([left[outer], head.mirror(left[outer])])
    region = np.tile(skin.region[elements[outer]], 2)
    template = skin.surface(head.tissue.parameters)

    surface = found.surface
    middle = surface.bounds.mean(axis=0)
    front = surface.vertices[:, 1] < middle[1] + 20.0
    face = Surface(surface.vertices, surface.faces[front[surface.faces].all(axis=1)], surface.name)
    brow = head.landmark_points()
    glabella = 0.5 * (brow["inner_brow_left"] + brow["inner_brow_right"])
    heights = _HEIGHTS + (_LOWER if "top" in found.cuts else ())
    best: tuple[float, Registration] | None = None
    for height in heights:
        for pitch in _PITCHES:
            turn = Rotation.from_euler("x", pitch, degrees=True).as_matrix()
            there = np.array([middle[0], 0.0, surface.bounds[1, 2] - height])
            start = Registration(1.0, turn, there - turn @ glabella)
            ahead = _forward(start, samples, face)
            if ahead is None:
                continue
            try:
                pose = icp(template, face, ahead, scaled=True, both=False, iterations=25)
            except SolveError:
                continue
            score = float(np.minimum(_distances(pose, samples, found), _FAR).mean())
            if best is None or score < best[0]:
                best = score, pose
    if best is None:
        return None
    pose = best[1]
    distance = float(np.median(_distances(pose, samples, found)))
    if not distance < _GOOD:
        return None
    inside = found.image.shows(pose.apply(samples))
    shown = {
        name: round(float(inside[region == number].mean()), 3)
        for number, name in enumerate(REGIONS)
        if (region == number).any()
    }
    return FaceShown(pose, distance, shown)


def _forward(start: Registration, samples: Array, face: Surface) -> Registration | None:
    """Move a pose along y until the skin lies on the front of the surface."""
    points = start.apply(samples[:: max(len(samples) // 300, 1)])
    origins = points.copy()
    origins[:, 1] = face.bounds[0, 1] - 10.0
    hits = face.first_hits(origins, np.array([0.0, 1.0, 0.0]))[:, 1]
    seen = np.isfinite(hits)
    if seen.mean() < 0.2:
        return None
    shift = np.array([0.0, float(np.median((hits - points[:, 1])[seen])), 0.0])
    return Registration(start.scale, start.rotation, start.translation + shift)


def _distances(pose: Registration, samples: Array, found: Segmentation) -> Array:
    """Distances (mm) to the surface of the samples in the image; `_FAR` if hardly any are."""
    points = pose.apply(samples)
    inside = found.image.shows(points)
    if inside.mean() < 0.2:
        return np.full(1, _FAR)
    return found.surface.closest(points[inside]).distance
