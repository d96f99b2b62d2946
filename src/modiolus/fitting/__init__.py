"""Fits of Hermite meshes to data clouds and surfaces."""

from .fit import (
    CloudTarget,
    FitResult,
    GroupReport,
    PointTarget,
    Smoothing,
    SurfaceTarget,
    fit,
    part_normals,
    sobolev,
)
from .register import Registration, icp, register, similarity

__all__ = [
    "CloudTarget",
    "FitResult",
    "GroupReport",
    "PointTarget",
    "Registration",
    "Smoothing",
    "SurfaceTarget",
    "fit",
    "icp",
    "part_normals",
    "register",
    "similarity",
    "sobolev",
]
