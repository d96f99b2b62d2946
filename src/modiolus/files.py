"""Files that a person gives, checked at the door."""

import csv
import io
import math
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .errors import InputError

__all__ = ["coordinates", "folder_name", "read_table", "read_toml"]

#: A table larger than this (bytes) is none that a person made.
_LARGEST_TABLE = 2**26


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
            f"{where}: {name!r} cannot be a name; use letters, digits, hyphens and dots"
        )
    return name


def _text(path: Path, encoding: str, mend: str) -> str:
    """Return the text of a file; it may be a pipe, and may have no end."""
    try:
        with path.open("rb") as file:
            content = file.read(_LARGEST_TABLE + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); {mend}") from None
    if len(content) > _LARGEST_TABLE:
        raise InputError(f"{path}: more than {_LARGEST_TABLE >> 20} MiB; {mend}")
    return content.decode(encoding)


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
        It cannot be read, is too large or is not TOML.
    """
    try:
        return tomllib.loads(_text(path, "utf-8", mend))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path}: not a TOML file ({error}); mend it") from None


def read_table(path: Path) -> list[tuple[int, dict[str, str]]]:
    """Read a CSV file whose first line names the columns.

    Returns
    -------
    list of (int, dict of str to str)
        Number of the line, and its cells by column without space around them; empty cells and
        those beyond the columns are left out.

    Raises
    ------
    InputError
        It cannot be read, is too large or is no text.
    """
    try:
        text = _text(path, "utf-8-sig", "name a CSV file")
        reader = csv.reader(io.StringIO(text, newline=""), strict=True)
        columns = [name.strip() for name in next(reader, [])]
        return [
            (
                reader.line_num,
                {
                    column: cell.strip()
                    for column, cell in zip(columns, cells, strict=False)
                    if cell.strip()
                },
            )
            for cells in reader
            if any(cell.strip() for cell in cells)
        ]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: not a table of text ({error}); write it as CSV") from None


def coordinates(row: Mapping[str, str], where: str) -> tuple[float, float, float]:
    """Return the columns x, y and z of a row, which may also be called x_mm and so on.

    Raises
    ------
    InputError
        One is missing or no finite number; the message begins with ``where``.
    """
    try:
        x, y, z = (float(row.get(axis) or row[f"{axis}_mm"]) for axis in "xyz")
    except (KeyError, ValueError):
        x = y = z = math.nan
    if not math.isfinite(x + y + z):
        raise InputError(f"{where} has no numbers x, y and z; mend it")
    return x, y, z
