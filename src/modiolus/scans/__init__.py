"""Measured faces: reading, aligning, comparing, and finding activations from them."""

from .scan import Scan, read_scan

__all__ = ["Scan", "read_scan"]
