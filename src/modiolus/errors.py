"""The two ways in which modiolus says no.

`InputError` means that something given by a person cannot be used; the command line prints it as
one line and leaves with code 2. `SolveError` means that the input was sound but the computation
did not reach its end; the command line leaves with code 1.
"""

import difflib
from collections.abc import Iterable

__all__ = ["InputError", "SolveError", "Stopped", "unknown_name"]


class InputError(ValueError):
    """Something that was given cannot be used.

    The message is one line: the name of the file, option or argument, a colon, what is wrong,
    a semicolon, and what to do about it.
    """


class SolveError(RuntimeError):
    """A computation on sound input failed: not converged, or a fit too poor to use.

    The message says where it failed, which term was to blame, and what to try.
    """


class Stopped(Exception):
    """An interruption after which something was kept; the text says what and where."""


def unknown_name(kind: str, name: str, known: Iterable[str]) -> InputError:
    """Make the error for a name that is not in a list, with the nearest names that are.

    Parameters
    ----------
    kind : str
        What the name stands for, such as ``"expression"``.
    name : str
        The name that was given.
    known : iterable of str
        The names that would have been understood.

    Returns
    -------
    InputError
        The error, for the caller to raise.

    Examples
    --------
    >>> str(unknown_name("expression", "smil-open", ["smile-open", "sad"]))
    "expression 'smil-open': no such expression; did you mean smile-open?"
    """
    names = sorted(set(known))
    near = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
    if not near:
        near = [candidate for candidate in names if name and name.lower() in candidate.lower()][:3]
    if near:
        mend = f"did you mean {' or '.join(near)}?"
    elif names:
        mend = f"choose from {', '.join(names)}"
    else:
        mend = "there are none to choose from"
    return InputError(f"{kind} {name!r}: no such {kind}; {mend}")
