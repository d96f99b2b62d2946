"""Muscle-driven equilibrium of a soft tissue: laws, contact, assembly and continuation."""

from ..hermite import symmetry_plane
from .arclength import Stride, trace
from .constraints import clamp
from .contact import RigidContact, SignedDistance, SurfaceContact, face_points
from .continuation import Continuation, Interrupted, LoadNotReached, Settings, solve
from .laws import (
    FAT,
    MUSCLE,
    BlemkerMuscle,
    Coefficients,
    FibreLaw,
    Formulation,
    Guccione,
    Law,
    Volume,
    mix,
)
from .problem import Problem, State, Statistics
from .terms import (
    DeadForces,
    FibreQuadrature,
    Fibres,
    FollowerPressure,
    GlidingFibres,
    GlidingQuadrature,
    Load,
    PointTerm,
    Sheet,
    Springs,
    Tension,
)

__all__ = [
    "FAT",
    "MUSCLE",
    "BlemkerMuscle",
    "Coefficients",
    "Continuation",
    "DeadForces",
    "FibreLaw",
    "FibreQuadrature",
    "Fibres",
    "FollowerPressure",
    "Formulation",
    "GlidingFibres",
    "GlidingQuadrature",
    "Guccione",
    "Interrupted",
    "Law",
    "Load",
    "LoadNotReached",
    "PointTerm",
    "Problem",
    "RigidContact",
    "Settings",
    "Sheet",
    "SignedDistance",
    "Springs",
    "State",
    "Statistics",
    "Stride",
    "SurfaceContact",
    "Tension",
    "Volume",
    "clamp",
    "face_points",
    "mix",
    "solve",
    "symmetry_plane",
    "trace",
]
