"""The command line, ``modiolus``: one module per command.

Every command keeps to the same rules. With ``--json`` standard output carries one JSON object and
nothing else; progress and messages go to standard error. The exit code is 0 when it is done, 1
when the computation failed, 2 when something that was given cannot be used (one line says what,
why and what to do) and 130 after an interruption. Outputs appear whole or not at all.
"""

from __future__ import annotations

import io
import os
import re
import sys
import warnings

__all__ = ["main"]

_INTERRUPTED = 130


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and leave with its exit code.

    Parameters
    ----------
    arguments : list of str, optional
        What follows the program's name; from the process by default.
    """
    sys.exit(_run(sys.argv[1:] if arguments is None else arguments))


def _run(arguments: list[str]) -> int:
    """Run one command and return its exit code; the one place where errors become messages."""
    from typer.exceptions import Abort, Exit, TyperException

    from modiolus.cli.commands import app
    from modiolus.errors import InputError, SolveError, Stopped
    from modiolus.progress import Interruption

    # A polite kill ends like Ctrl-C: everything half-written is removed on the way out.
    Interruption.listen()
    verbose = bool(os.environ.get("MODIOLUS_TRACEBACK"))
    _open_streams()
    try:
        with warnings.catch_warnings():
            if not verbose:
                # What overflows becomes an error that is told.
                warnings.simplefilter("ignore", RuntimeWarning)
            code = app(arguments, prog_name="modiolus", standalone_mode=False)
    except (KeyboardInterrupt, Abort):
        code = _INTERRUPTED
    except Stopped as error:
        return _say(_one_line(error), _INTERRUPTED)
    except Exit as error:
        code = error.exit_code
    except (InputError, TyperException) as error:
        return _say(_one_line(error), 2)
    except SolveError as error:
        return _say(_one_line(error), 1)
    except MemoryError:
        return _say("memory: there is not enough of it; close other programs", 1)
    except BrokenPipeError:
        # The reader went away: nobody is left to tell.
        sys.stderr.close()
        return 1
    except OSError as error:
        where = error.filename or "a file that was written or read"
        return _say(f"{where}: {error.strerror or error}; mend that and run it again", 1)
    except Exception as error:
        if verbose:
            raise
        if "no locator available" in str(error):
            return _say(
                "cache: compiled kernels can be kept neither beside the package nor in ~/.cache; "
                "set NUMBA_CACHE_DIR to a folder that can be written",
                2,
            )
        kind = type(error).__name__
        return _say(
            f"internal error ({kind}: {_one_line(error)}); "
            "set MODIOLUS_TRACEBACK=1 to see where, and please report it",
            1,
        )
    if code == _INTERRUPTED:
        return _say("interrupted; nothing was written", code)
    return code if isinstance(code, int) else 0


def _open_streams() -> None:
    """Print to nowhere where a stream is closed, and escape the letters that one has not."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, io.StringIO())
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _one_line(error: Exception) -> str:
    text = error.format_message() if hasattr(error, "format_message") else str(error)
    context = getattr(error, "ctx", None)
    if context is not None and not text.startswith("Invalid value"):
        text = f"{text.rstrip('.')}; see {context.command_path} --help"
    # Of a value that is of the wrong kind the option comes first, as everywhere.
    text = re.sub(
        r"^Invalid value for '(.+?)': (?:Input )?(.+?)(, unable.*)?\.?$", r"\1: \2; mend it", text
    )
    return " ".join(text.split())


def _say(message: str, code: int) -> int:
    sys.stderr.write(f"modiolus: {message}\n")
    return code
