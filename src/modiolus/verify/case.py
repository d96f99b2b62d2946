"""What a verification case is: a name, what it shows, and the figures that it checks."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Check:
    """One figure against what it should be.

    Attributes
    ----------
    quantity : str
        What was computed, with its unit.
    expected, got : float
    tolerance : float
        Greatest error that passes.
    relative : bool
        Whether the error is divided by the expected value.
    at_least : bool
        Whether any value from the expected one up is right.
    """

    quantity: str
    expected: float
    got: float
    tolerance: float
    relative: bool = False
    at_least: bool = False

    @property
    def error(self) -> float:
        """Distance from what was expected; not a number where nothing could be computed."""
        if not math.isfinite(self.got):
            return math.nan
        error = self.expected - self.got if self.at_least else abs(self.got - self.expected)
        return max(error / abs(self.expected) if self.relative else error, 0.0)

    @property
    def passed(self) -> bool:
        """Whether the error is within the tolerance."""
        return self.error <= self.tolerance


@dataclass(frozen=True)
class Case:
    """A computation whose result is known.

    Attributes
    ----------
    name : str
    says : str
        What the case shows, in one line.
    run : callable
        Takes whether finer meshes are wanted and returns the checks.
    """

    name: str
    says: str
    run: Callable[[bool], Sequence[Check]]


def vector(
    quantity: str, expected: Sequence[float], got: Sequence[float], tolerance: float
) -> list[Check]:
    """Return the checks of the components x, y and z of a vector."""
    return [
        Check(f"{quantity} {axis}", float(e), float(g), tolerance)
        for axis, e, g in zip("xyz", expected, got, strict=True)
    ]
