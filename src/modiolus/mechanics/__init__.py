"""Muscle-driven equilibrium of a soft tissue: laws, contact, assembly and continuation."""

from .constraints import clamp, face_parameters, symmetry_plane
from .contact import PairContact, RigidContact, SignedDistance, face_points
from .continuation import Continuation, Settings, solve
from .laws import FAT, MUSCLE, Coefficients, FibreLaw, mix
from .problem import Problem, State, Statistics
from .terms import FibreQuadrature, Fibres, Load, PointTerm, Springs

__all__ = [
    "FAT",
    "MUSCLE",
    "Coefficients",
    "Continuation",
    "FibreLaw",
    "FibreQuadrature",
    "Fibres",
    "Load",
    "PairContact",
    "PointTerm",
    "Problem",
    "RigidContact",
    "Settings",
    "SignedDistance",
    "Springs",
    "State",
    "Statistics",
    "clamp",
    "face_parameters",
    "face_points",
    "mix",
    "solve",
    "symmetry_plane",
]
