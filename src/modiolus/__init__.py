"""A muscle-driven finite element face, from anatomy to an animated head.

Lengths are in mm, stresses in kPa, forces in mN and angles in radians, in a frame with +x to the
subject's left, +y backwards and +z up. The subpackages are imported when they are needed, so that
``import modiolus`` is quick.
"""

import os
from importlib.metadata import version

__all__ = ["__version__"]

__version__ = version("modiolus")

# Read when the threads of MKL, of Numba's loops and of NumPy's products start: by default those
# that wait spin, and take the processor from the others' work.
for _name, _value in {
    "KMP_BLOCKTIME": "0",
    "OMP_WAIT_POLICY": "PASSIVE",
    "OPENBLAS_THREAD_TIMEOUT": "4",
}.items():
    os.environ.setdefault(_name, _value)
