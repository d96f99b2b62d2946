"""The finite element space: cubic Hermite meshes with extraction operators."""

from .basis import basis, basis_1d
from .grid import assemble, grid, grid_connectivity, linear
from .locate import Location
from .mesh import HermiteMesh
from .mirror import MirroredMesh
from .quadrature import Quadrature, gauss

__all__ = [
    "HermiteMesh",
    "Location",
    "MirroredMesh",
    "Quadrature",
    "assemble",
    "basis",
    "basis_1d",
    "gauss",
    "grid",
    "grid_connectivity",
    "linear",
]
