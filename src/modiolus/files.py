"""Files that a person gives, checked at the door."""

import re
import tomllib
from pathlib import Path
from typing import Any

from .errors import InputError

__all__ = ["folder_name", "read_toml"]


def folder_name(where: str, name: object) -> str:
    """Return a name that becomes that of a folder.

    Parameters
    ----------
    where : str
        The file or option that it comes from, for the message.
    name : str

    Raises
    ------
    InputError
        It is no text, or has other characters than letters, digits and ``-._`` after the first.
    """
    if not isinstance(name, str) or not re.fullmatch(r"\w[\w.-]*", name):
        raise InputError(
            f"{where}: name {name!r}; give it letters, digits, hyphens, dots or underscores"
        )
    return name


def read_toml(path: Path, mend: str = "name a TOML file") -> dict[str, Any]:
    """Read a TOML file.

    Parameters
    ----------
    path : Path
    mend : str
        What to do when it cannot be read.

    Returns
    -------
    dict
        The table of the file.

    Raises
    ------
    InputError
        It cannot be read or is not TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); {mend}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path}: not a TOML file ({error}); mend it") from None
