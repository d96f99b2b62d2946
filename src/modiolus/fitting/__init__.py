"""Fits of Hermite meshes to data clouds and surfaces."""

from .fit import (
    CloudTarget,
    Equations,
    FitResult,
    GroupReport,
    PairTarget,
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
    "Equations",
    "FitResult",
    "GroupReport",
    "PairTarget",
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
