"""The compilation of kernels: it takes half a minute, once after an installation.

It is told while it goes on, and is no part of the time that a computation takes.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from numba.core import event

__all__ = ["compiler", "working_time"]


class _Compiler(event.Listener):  # type: ignore[misc]
    """Watches Numba compile, which it does one function within another.

    Attributes
    ----------
    seconds : float
        For which it has compiled so far.
    tell : callable or None
        Called when it begins.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self.tell: Callable[[], None] | None = None
        self._depth = 0
        self._began = 0.0

    def on_start(self, event: object) -> None:
        if self._depth == 0:
            self._began = time.perf_counter()
            if self.tell is not None:
                self.tell()
        self._depth += 1

    def on_end(self, event: object) -> None:
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._began


compiler = _Compiler()
event.register("numba:compile", compiler)


def working_time() -> float:
    """Return seconds of a clock that stands still while kernels are compiled."""
    return time.perf_counter() - compiler.seconds
