"""Files for other programs: glTF for animation, VTU for analysis."""

from modiolus.export.gltf import in_turn, write_glb
from modiolus.export.shape import Shape, linear_light, vertex_normals
from modiolus.export.vtu import write_vtu

__all__ = ["Shape", "in_turn", "linear_light", "vertex_normals", "write_glb", "write_vtu"]
