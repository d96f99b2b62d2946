"""Pictures of heads, muscles and states."""

from modiolus.view.figure import Panel, Scale, figure
from modiolus.view.raster import Camera, Curves, draw

__all__ = ["Camera", "Curves", "Panel", "Scale", "draw", "figure"]
