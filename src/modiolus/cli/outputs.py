"""What a command leaves: folders that appear whole or not at all, and reports in them."""

from __future__ import annotations

import contextlib
import json
import math
import os
import shlex
import shutil
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from modiolus.errors import InputError
from modiolus.progress import Interruption

__all__ = ["as_text", "own_heads", "use_of", "whole_folder", "write_report"]


@contextlib.contextmanager
def whole_folder(
    target: Path, marker: str, option: str = "--out", sources: Iterable[str | Path] = ()
) -> Iterator[Path]:
    """Give a folder to write into, which becomes `target` only when the block ends well.

    The folder is made beside the target before any work begins, so that a place that cannot be
    written is refused at once. After an error or an interruption nothing of it is left.

    Parameters
    ----------
    target : Path
        The folder that is to appear. One from an earlier run is replaced.
    marker : str
        A file that tells such a folder from any other, which is not touched.
    option : str
        The option that named the place, for the message.
    sources : iterable of str or Path
        What the command reads, which may not be lost by being replaced.

    Yields
    ------
    Path
        The folder to write into.

    Raises
    ------
    InputError
        If the place cannot be written, or holds something that is not ours or is being read.
    """
    made: list[Path] = []
    try:
        target = target.resolve()
        draft = target.parent / f".{target.name}.{os.getpid()}.part"
        if target.exists() and not target.is_dir():
            raise NotADirectoryError(None, "it is a file, not a folder")
        if target.is_dir() and any(target.iterdir()) and not (target / marker).is_file():
            raise InputError(
                f"{option} {target}: the folder holds other files (it has no {marker}); "
                "name a new or an empty one"
            )
        if Path.cwd().is_relative_to(target):
            raise InputError(f"{option} {target}: this is where you are; name a folder inside")
        for source in sources:
            if target.exists() and Path(source).resolve().is_relative_to(target):
                raise InputError(
                    f"{option} {target}: {source} is read and would be replaced; "
                    "name another folder"
                )
        made = [parent for parent in target.parents if not parent.exists()]
        draft.mkdir(parents=True)
    except (OSError, RuntimeError) as error:
        _remove_empty(made)
        # Links that go round in a circle are told without an error number.
        why = getattr(error, "strerror", None) or "its links go round in a circle"
        raise InputError(
            f"{option} {target}: cannot be written ({why}); name another folder"
        ) from None
    try:
        yield draft
        Interruption.check()
        _put(draft, target)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        _remove_empty(made)
        raise


def _put(draft: Path, target: Path) -> None:
    """Put a folder into its place; what was there comes back if that fails."""
    old = target.parent / f".{target.name}.{os.getpid()}.old"
    try:
        if target.exists():
            target.rename(old)
        draft.rename(target)
    except BaseException:
        if old.exists() and not target.exists():
            old.rename(target)
        raise
    finally:
        shutil.rmtree(old, ignore_errors=True)


def _remove_empty(folders: list[Path]) -> None:
    """Remove folders, innermost first, that nothing else has come to use."""
    for folder in folders:
        with contextlib.suppress(OSError):
            folder.rmdir()


def write_report(folder: Path, record: Mapping[str, Any]) -> None:
    """Write what a command found as ``report.json`` into a folder."""
    (folder / "report.json").write_text(as_text(record, indent=2) + "\n", encoding="utf-8")


def as_text(record: Mapping[str, Any], indent: int | None = None) -> str:
    """Return a record as JSON, with null for numbers that are not finite."""
    return json.dumps(_finite(record), indent=indent, allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def own_heads(*heads: str) -> list[str]:
    """Return those of some heads, given by name or folder, that are folders of one's own."""
    from modiolus.face.head import head_names

    return [head for head in heads if head and head not in head_names()]


def use_of(head: Path) -> str:
    """Return where a new head is and how to use it, as two lines."""
    from modiolus.face.head import head_names

    # A shipped head comes before a folder of the same name.
    place = f"./{head}" if str(head) in head_names() else str(head)
    return f"Head: {head}\nUse it with: modiolus simulate smile-closed --head {shlex.quote(place)}"
