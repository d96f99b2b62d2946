"""Progress of long work, shown on standard error with the time left, and its interruption."""

import signal
import sys
import time
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any, Self, TextIO

__all__ = ["Interruption", "Progress", "Report"]

#: What long work tells of: the share that is done, and a few words on what goes on.
Report = Callable[[float, str], None]

_SECONDS_BETWEEN_LINES = 5.0
#: Share of the work that tells how long the rest will take; what comes before is slow to begin.
_TOLD_FROM = 0.1


class Interruption:
    """Ctrl-C, a polite kill or a closed terminal; ends work even if its exception is lost.

    Python drops an exception that is raised while a C library calls back, as compilers of kernels
    and solvers do; so the request is kept, and `check` raises it again.
    """

    _asked = False

    @classmethod
    def listen(cls) -> None:
        """Answer Ctrl-C, a polite kill and the end of the terminal from now on."""
        cls._asked = False
        numbers = [signal.SIGINT, signal.SIGTERM]
        # Terminals end so where there is POSIX.
        if hasattr(signal, "SIGHUP"):
            numbers.append(signal.SIGHUP)
        for number in numbers:
            # A shell starts what it puts into the background with SIGINT ignored, and nohup what
            # is to outlive the terminal with SIGHUP.
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, cls._answer)

    @classmethod
    def _answer(cls, number: int, frame: FrameType | None) -> None:
        cls._asked = True
        raise KeyboardInterrupt

    @classmethod
    def heed(cls) -> None:
        """Forget a request that has been answered; another one counts again."""
        cls._asked = False

    @classmethod
    def check(cls) -> None:
        """Raise `KeyboardInterrupt` if an interruption was asked for."""
        if cls._asked:
            raise KeyboardInterrupt


class Progress:
    """Show how far a piece of work has come.

    On a terminal this is one line that is redrawn; in a log it is a new line every few seconds.
    Standard output is never touched. Use it as a context manager. That kernels are compiled is
    told, and does not count as work.

    Parameters
    ----------
    title : str
        What is being done, such as ``"solving smile-closed"``.
    total : float
        The amount of work, in any unit.
    quiet : bool
        Show nothing at all.
    stream : file, optional
        Where to write; standard error by default.

    Examples
    --------
    >>> with Progress("counting", total=3, quiet=True) as progress:
    ...     for count in range(3):
    ...         progress.update(count + 1, f"at {count}")
    """

    def __init__(
        self, title: str, total: float = 1.0, quiet: bool = False, stream: TextIO | None = None
    ) -> None:
        self.title = title
        self.total = total
        self.quiet = quiet
        self._stream = sys.stderr if stream is None else stream
        self._terminal = not quiet and self._stream.isatty()
        self._started = self._shown = self._now()
        self._width = 0
        self._finished = False

    def update(self, done: float, message: str = "") -> None:
        """Say how much of the work is done.

        Parameters
        ----------
        done : float
            Work done so far, in the unit of `total`.
        message : str
            A few words on what happens now.

        Raises
        ------
        KeyboardInterrupt
            If an interruption was asked for and got lost on the way.
        """
        Interruption.check()
        now = self._now()
        pause = 0.1 if self._terminal else _SECONDS_BETWEEN_LINES
        finished = done >= self.total and not self._finished
        if self.quiet or (now - self._shown < pause and not finished):
            return
        self._finished = done >= self.total
        self._shown = now
        elapsed = now - self._started
        share = min(max(done / self.total, 0.0), 1.0) if self.total > 0 else 1.0
        parts = [f"{self.title} {share:4.0%}"]
        if message:
            parts.append(message)
        if _TOLD_FROM < share < 1.0:
            parts.append(f"{_duration(elapsed * (1.0 - share) / share)} left")
        elif share == 1.0:
            parts.append(_duration(elapsed))
        self._write(" · ".join(parts))

    def pause(self) -> None:
        """End the line that is redrawn, before something else is written to the terminal."""
        if self._width:
            self._stream.write("\n")
            self._stream.flush()
            self._width = 0

    @staticmethod
    def _now() -> float:
        compiling = _compiling()
        return time.monotonic() - (compiling.compiler.seconds if compiling else 0.0)

    def _compile(self) -> None:
        self._write(f"{self.title} · compiling, once after an installation")
        _compiling().compiler.tell = None

    def _write(self, line: str) -> None:
        if self._terminal:
            self._stream.write("\r" + line.ljust(self._width))
            self._width = len(line)
        else:
            self._stream.write(line + "\n")
        self._stream.flush()

    def __enter__(self) -> Self:
        self._started = self._shown = self._now()
        if not self.quiet and (compiling := _compiling()):
            compiling.compiler.tell = self._compile
        if self._terminal:
            self._write(self.title)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.pause()
        if compiling := _compiling():
            compiling.compiler.tell = None


def _compiling() -> Any:
    """Return `modiolus.compiling` if it is in use; Numba is too slow to import to find out."""
    return sys.modules.get("modiolus.compiling")


def _duration(seconds: float) -> str:
    if seconds < 60.0:
        return f"{seconds:.0f} s"
    return f"{int(seconds // 60)} min {int(seconds % 60):02d} s"
