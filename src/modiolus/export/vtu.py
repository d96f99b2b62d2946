"""VTK unstructured grids, for ParaView and PyVista."""

from __future__ import annotations

import errno
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from modiolus.errors import InputError
from modiolus.hermite.basis import Array, IntArray
from modiolus.hermite.check import numbers, whole

__all__ = ["write_vtu"]


def write_vtu(
    path: Path,
    points: Array,
    hexahedra: IntArray,
    arrays: Mapping[str, Array],
) -> None:
    """Write hexahedra with values at their corners.

    Parameters
    ----------
    path : Path
        The file to write.
    points : (n, 3) array
        Positions at rest in mm; with an array ``displacement`` a viewer can warp them.
    hexahedra : (m, 8) array of int
        Corners in the order of VTK.
    arrays : mapping of str to (n,) or (n, k) array
        Values at the points.

    Raises
    ------
    InputError
        An array has another shape, a value is not finite, or a corner does not exist.
    OSError
        The file cannot be written.
    """
    points = numbers("points", points, None, 3)
    hexahedra = whole("hexahedra", hexahedra, len(points), ndim=2)
    if hexahedra.shape[1] != 8:
        raise InputError(f"hexahedra: {hexahedra.shape[1]} corners each; give 8")
    for name, values in arrays.items():
        numbers(name, values, len(points), *[None] * (np.ndim(values) == 2))
    # VTK would not say why it cannot.
    path.touch()
    # These parts of VTK need no OpenGL.
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import VTK_HEXAHEDRON, vtkCellArray, vtkUnstructuredGrid
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    grid = vtkUnstructuredGrid()
    corners = vtkPoints()
    corners.SetData(numpy_to_vtk(np.ascontiguousarray(points), deep=True))
    grid.SetPoints(corners)
    offsets = np.arange(0, 8 * len(hexahedra) + 1, 8, dtype=np.int64)
    cells = vtkCellArray()
    cells.SetData(
        numpy_to_vtkIdTypeArray(offsets, deep=True),
        numpy_to_vtkIdTypeArray(np.ascontiguousarray(hexahedra).ravel(), deep=True),
    )
    grid.SetCells(VTK_HEXAHEDRON, cells)
    for name, values in arrays.items():
        # Single precision is ample for display and halves the file.
        column = numpy_to_vtk(np.ascontiguousarray(values, dtype=np.float32), deep=True)
        column.SetName(name)
        grid.GetPointData().AddArray(column)
    writer = vtkXMLUnstructuredGridWriter()
    writer.SetFileName(str(path))
    writer.SetInputData(grid)
    writer.SetCompressorTypeToZLib()
    if writer.Write() != 1:
        raise OSError(errno.EIO, "VTK could not write the file", str(path))
