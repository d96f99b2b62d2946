"""The jaw: the mandible and what moves with it.

The jaw is a rigid body that turns about the axis through both condyles while the condyles glide
forward and down. At its widest the mouth of 259 adults was open by 32.2° when the condyles had
gone 14.8 mm [Kordass2014]_, that is 0.46 mm a degree; the glide begins with the opening
[Mapelli2009]_. The path of the condyle falls by 32° from the horizontal [Johnson1997]_.

References
----------
.. [Kordass2014] B. Kordaß et al., "Standard and limit values of mandibular condylar and incisal
   movement capacity", Int. J. Comput. Dent. 17 (2014) 9-20.
.. [Mapelli2009] A. Mapelli et al., "Translation and rotation movements of the mandible during
   mouth opening and closing", Clin. Anat. 22 (2009) 311-318.
.. [Johnson1997] A. Johnson, R. B. Winstanley, "Recording sagittal condylar angles using a
   mandibular facebow", J. Oral Rehabil. 24 (1997) 904-908.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from ..anatomy.distance import QUANTUM, DistanceGrid
from ..errors import InputError
from ..hermite.basis import Array, smooth_step

__all__ = ["WIDEST", "Jaw", "opening"]

#: Glide of the condyles in mm a radian, and the slope of their path below the horizontal.
GLIDE = 14.8 / math.radians(32.2)
SLOPE = math.radians(32.0)
#: Widest opening (degrees).
WIDEST = 30.0

#: Deep structures that move with the jaw, and by which share of its angle. Masseter spans from
#: the cheekbone, which stands still, to the mandible: it goes half way.
FOLLOWERS: dict[str, float] = {
    "mandible": 1.0,
    "teeth_lower": 1.0,
    "gums_lower": 1.0,
    "lower_arch": 1.0,
    "masseter": 0.5,
}
_STANDING = ("skull", "teeth_upper", "gums_upper")

#: Height of the condyle (mm) and depth of the hindmost part of the mandible it is sought in.
_CONDYLE = (8.0, 20.0)
#: What is tied belongs to the jaw when its distance to the still bones exceeds this share of its
#: distances to both, and to the still bones below; in between it follows in part.
_BETWEEN = (0.25, 0.75)
#: Tissue follows the jaw wholly up to the first distance (mm) and not at all from the second.
_FADE = (5.0, 75.0)


@dataclass(frozen=True, eq=False)
class Jaw:
    """The jaw of a head.

    Attributes
    ----------
    hinge : (3,) array
        Middle between the condyles at rest (mm); the axis runs along x.
    """

    hinge: Array
    _plane: float
    _deep: Mapping[str, DistanceGrid]

    @classmethod
    def of(cls, deep: Mapping[str, DistanceGrid], plane: float) -> Jaw | None:
        """Find the jaw in the deep structures of a head's left half.

        The condyle is the uppermost part of the mandible's hind end; its centre is that of the
        grid points inside it.

        Parameters
        ----------
        deep : mapping of DistanceGrid
            By name.
        plane : float
            x of the mid-plane (mm).

        Returns
        -------
        Jaw or None
            None where there is no skull or no mandible.
        """
        if not {"skull", "mandible"} <= set(deep):
            return None
        bone = _points(deep["mandible"], -math.inf, 0.0)
        hind = bone[bone[:, 1] > bone[:, 1].max() - _CONDYLE[1]]
        condyle = hind[hind[:, 2] > hind[:, 2].max() - _CONDYLE[0]].mean(axis=0)
        hinge = np.array([plane, condyle[1], condyle[2]])
        return cls(hinge, plane, deep)

    @cached_property
    def _clouds(self) -> list[cKDTree]:
        """Points on what moves with the jaw, and on what stands still."""
        deep, clouds = self._deep, []
        for names in ([n for n, share in FOLLOWERS.items() if share == 1.0], _STANDING):
            parts = [_points(deep[n], 0.0, deep[n].spacing) for n in names if n in deep]
            clouds.append(cKDTree(np.vstack(parts)))
        return clouds

    def pose(self, angle: float) -> tuple[Array, Array]:
        """Return the rotation (3, 3) and the shift (3,) of the jaw open by an angle (radians).

        A point ``x`` of the jaw at rest goes to ``rotation @ x + shift``.
        """
        c, s = math.cos(angle), math.sin(angle)
        rotation = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        glide = GLIDE * angle * np.array([0.0, -math.cos(SLOPE), -math.sin(SLOPE)])
        return rotation, self.hinge + glide - rotation @ self.hinge

    def displacement(self, points: Array, angle: float, share: Array) -> Array:
        """Return how far points (n, 3) go that follow the jaw by a share (n,); (n, 3) in mm."""
        rotation, shift = self.pose(angle)
        return np.asarray(share[:, None] * (points @ rotation.T + shift - points))

    def share(self, points: Array) -> Array:
        """Return by which share tied tissue at points (n, 3) follows the jaw, (n,).

        It is 1 where the mandible, its teeth or gums are nearer than the still bones, 0 where
        those are nearer, and fades with the distance from the jaw.
        """
        folded = np.array(points, dtype=float)
        folded[:, 0] = self._plane + np.abs(folded[:, 0] - self._plane)
        moving, standing = (cloud.query(folded)[0] for cloud in self._clouds)
        low, high = _BETWEEN
        near = (standing / (standing + moving) - low) / (high - low)
        return smooth_step(near) * smooth_step((_FADE[1] - moving) / (_FADE[1] - _FADE[0]))


def opening(degrees: float, where: str = "--jaw-open") -> float:
    """Check an opening of the jaw and return it in radians.

    Raises
    ------
    InputError
        If it is not within 0 to 30 degrees.
    """
    if not 0.0 <= degrees <= WIDEST:
        raise InputError(
            f"{where} {degrees:g}: the jaw opens by 0 to {WIDEST:g} degrees; give a number in there"
        )
    return math.radians(degrees)


def _points(grid: DistanceGrid, low: float, high: float) -> Array:
    """Return the points (n, 3) of a grid whose distance is within some bounds."""
    distance = QUANTUM * grid.values
    return np.asarray(
        grid.origin + grid.spacing * np.argwhere((distance >= low) & (distance <= high))
    )
