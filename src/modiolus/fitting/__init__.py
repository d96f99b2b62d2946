"""Fits of Hermite meshes to data clouds and surfaces."""

from .fit import (
    ClosestPoint,
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

__all__ = [
    "ClosestPoint",
    "CloudTarget",
    "FitResult",
    "GroupReport",
    "PointTarget",
    "Smoothing",
    "SurfaceTarget",
    "fit",
    "part_normals",
    "sobolev",
]
