"""Output folders that appear whole or not at all."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from modiolus.errors import InputError
from modiolus.progress import Interruption

__all__ = ["whole_folder"]


@contextlib.contextmanager
def whole_folder(target: Path, marker: str, option: str = "--out") -> Iterator[Path]:
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

    Yields
    ------
    Path
        The folder to write into.

    Raises
    ------
    InputError
        If the place cannot be written, or holds something that is not ours.
    """
    target = target.absolute()
    if target.is_dir() and any(target.iterdir()) and not (target / marker).is_file():
        raise InputError(
            f"{option} {target}: the folder holds other files (it has no {marker}); "
            "name a new or an empty one"
        )
    made = [parent for parent in target.parents if not parent.exists()]
    draft = target.parent / f".{target.name}.{os.getpid()}.part"
    try:
        if target.exists() and not target.is_dir():
            raise NotADirectoryError(None, "it is a file, not a folder")
        draft.mkdir(parents=True)
    except OSError as error:
        _remove_empty(made)
        raise InputError(
            f"{option} {target}: cannot be written ({error.strerror}); name another folder"
        ) from None
    try:
        yield draft
        Interruption.check()
        old = target.parent / f".{target.name}.{os.getpid()}.old"
        if target.exists():
            target.rename(old)
        draft.rename(target)
        shutil.rmtree(old, ignore_errors=True)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        _remove_empty(made)
        raise


def _remove_empty(folders: list[Path]) -> None:
    """Remove folders, innermost first, that nothing else has come to use."""
    for folder in folders:
        with contextlib.suppress(OSError):
            folder.rmdir()
