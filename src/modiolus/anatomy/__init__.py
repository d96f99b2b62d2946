"""Anatomy: surfaces, named structures, signed distances."""

from modiolus.anatomy.bodyparts3d import DEEP_STRUCTURES, STRUCTURES, BodyParts3D
from modiolus.anatomy.distance import (
    DistanceGrid,
    DistanceSample,
    MirroredDistance,
    deep_distances,
)
from modiolus.anatomy.surface import MIDPLANE, Closest, Surface, read_surface

__all__ = [
    "DEEP_STRUCTURES",
    "MIDPLANE",
    "STRUCTURES",
    "BodyParts3D",
    "Closest",
    "DistanceGrid",
    "DistanceSample",
    "MirroredDistance",
    "Surface",
    "deep_distances",
    "read_surface",
]
