"""A muscle-driven finite element face, from anatomy to an animated head.

Lengths are in mm, stresses in kPa, forces in mN and angles in radians, in a frame with +x to the
subject's left, +y backwards and +z up. The subpackages are imported when they are needed, so that
``import modiolus`` is quick.
"""

from importlib.metadata import version

__all__ = ["__version__"]

__version__ = version("modiolus")
