"""Verification: computations whose results are known, through the kernels of the face."""

from .case import Case, Check
from .cases import CASES, choose

__all__ = ["CASES", "Case", "Check", "choose"]
