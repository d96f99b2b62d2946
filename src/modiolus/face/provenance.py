"""What of a head was given and what was inferred.

The table ``provenance`` of `modiolus.face.head.Head.about` has a line for each part of the head
that begins with ``given`` or ``inferred`` and tells from what.
"""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import wrap
from typing import Any

__all__ = ["GIVEN", "INFERRED", "provenance_lines"]

GIVEN, INFERRED = "given", "inferred"


def provenance_lines(about: Mapping[str, Any], most: int | None = None) -> list[str]:
    """Return lines that name the parts given and those inferred; none of a head that is silent.

    Parameters
    ----------
    about : mapping
        What a head says of itself.
    most : int, optional
        More parts than this are only counted.
    """
    table = about.get("provenance")
    if not isinstance(table, Mapping):
        return []
    lines: list[str] = []
    for kind in (GIVEN, INFERRED):
        names = [key for key, text in table.items() if str(text).startswith(kind)]
        many = most is not None and len(names) > most
        listed = f"{len(names)} parts" if many else ", ".join(names)
        text = f"  {kind:8} {listed or 'nothing'}"
        lines += wrap(text, 100, subsequent_indent=" " * 11)
    return lines
