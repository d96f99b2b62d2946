"""The finite element space: cubic Hermite meshes with extraction operators."""

from .basis import basis, basis_1d
from .grid import assemble, bricks, grid, grid_connectivity, linear
from .locate import Location
from .mesh import HermiteMesh, Side, outward
from .mirror import MirroredMesh, symmetry_plane
from .quadrature import Quadrature, gauss, trapezoidal

__all__ = [
    "HermiteMesh",
    "Location",
    "MirroredMesh",
    "Quadrature",
    "Side",
    "assemble",
    "basis",
    "basis_1d",
    "bricks",
    "gauss",
    "grid",
    "grid_connectivity",
    "linear",
    "outward",
    "symmetry_plane",
    "trapezoidal",
]
