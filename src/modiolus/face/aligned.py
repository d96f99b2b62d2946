"""The surface of a face in the frame of a head.

The pose, the unit and the size are found (`modiolus.fitting.register`), and the surface is turned
until its own plane of symmetry is the head's mid-plane.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ..anatomy.surface import Surface
from ..errors import InputError, SolveError
from ..fitting import Registration, icp, register
from ..hermite.basis import Array
from .embed import boundary_surface
from .head import Head


@dataclass(frozen=True)
class Aligned:
    """A surface in the frame of a head.

    Attributes
    ----------
    surface : Surface
        In the head's frame, in its own size (mm).
    pose : Registration
        From the surface's own frame to this one.
    size : float
        Size of the surface's face relative to the head's.
    middle : (3,) array
        The head grows about this point.
    """

    surface: Surface
    pose: Registration
    size: float
    middle: Array

    def grown(self, points: Array) -> Array:
        """Return points (n, 3) of the head in the size of the surface."""
        return np.asarray(self.middle + self.size * (points - self.middle))


def align(
    head: Head, surface: Surface, landmarks: tuple[ArrayLike, ArrayLike] | None = None
) -> Aligned:
    """Bring a surface into the frame of a head, each in its own size.

    Parameters
    ----------
    head : Head
    surface : Surface
        Skin in mm, cm or m, in any pose.
    landmarks : ((n, 3) array, (n, 3) array), optional
        Matched points of the surface, in its own frame, and of the head.

    Raises
    ------
    InputError
        The triangles of the surface run the wrong way round, or it is mirrored.
    SolveError
        The surface does not meet the head.
    """
    skin = skin_surface(head)
    pose = register(surface, skin, landmarks)
    if pose.facing < 0.0:
        raise InputError(
            f"{surface.name}: its triangles face inwards, or the scan is mirrored; turn them over"
        )
    size = pose.unit / pose.scale
    middle = skin.bounds.mean(axis=0)
    middle[0] = head.midplane
    pose = Registration(
        pose.unit,
        pose.rotation,
        size * (pose.translation - middle) + middle,
        pose.rms,
        pose.matched,
        pose.facing,
        pose.unit,
    )
    pose = _centred(pose, surface, head.midplane)
    return Aligned(pose.moved(surface), pose, size, middle)


def skin_surface(head: Head, divisions: int = 6) -> Surface:
    """Return the skin of both sides of a head's left half as triangles."""
    half = boundary_surface(head.tissue, head.sides["outer"], divisions)
    count = len(half.vertices)
    median = np.abs(half.vertices[:, 0] - head.midplane) < 1e-6
    # In the mid-plane both sides share their vertices: it is no free edge.
    image = np.where(median, np.arange(count), count + np.arange(count))
    vertices = np.vstack([half.vertices, half.mirrored(head.midplane).vertices])
    whole = Surface(vertices, np.vstack([half.faces, image[half.faces[:, ::-1]]]), head.name)
    return whole.picked(whole.faces)


def _centred(pose: Registration, surface: Surface, plane: float) -> Registration:
    """Turn and shift a surface so that its own plane of symmetry is the head's mid-plane."""
    moved = pose.moved(surface)
    image = moved.mirrored(plane)
    try:
        onto = icp(image, moved, reach=10.0)
    except SolveError:
        return pose
    if onto.matched < 0.4:
        return pose
    # Mirror image and motion together are a reflection in the plane of symmetry.
    mirror = onto.rotation @ np.diag([-1.0, 1.0, 1.0])
    values, vectors = np.linalg.eig(mirror)
    normal = np.real(vectors[:, np.argmin(np.abs(values + 1.0))])
    normal *= np.sign(normal[0]) / np.linalg.norm(normal)
    centres = 0.5 * (moved.vertices + onto.apply(image.vertices))
    centre = centres.mean(axis=0)
    axis = np.cross(normal, [1.0, 0.0, 0.0])
    sine = float(np.linalg.norm(axis))
    if sine > 0.2:
        return pose
    turn = Rotation.from_rotvec(axis / max(sine, 1e-12) * np.arcsin(sine)).as_matrix()
    shift = centre - turn @ centre
    shift[0] += plane - centre[0]
    return replace(pose, rotation=turn @ pose.rotation, translation=turn @ pose.translation + shift)
