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

__all__ = [
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
