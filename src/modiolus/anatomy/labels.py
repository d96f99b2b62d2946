"""Label maps: images of whole numbers, each a structure, and a table of their names.

The table is a TOML file that names the structures, as an annotator exports them from ITK-SNAP or
3D Slicer::

    [structures]
    zygomaticus_major_left = 3
    mandible = 12

A surface encloses as much volume as its voxels do: thin sheets keep their thickness although
their voxels are blurred into a smooth surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy import ndimage

from modiolus.anatomy.image import Image, write_image
from modiolus.anatomy.segment import isosurface
from modiolus.anatomy.surface import Surface
from modiolus.errors import InputError
from modiolus.files import read_toml

__all__ = ["label_surfaces", "read_label_names", "write_labels"]

#: Standard deviation (voxels) of the Gaussian that makes stairs a slope.
_SMOOTH = 0.7
#: Levels between which that of the right volume is sought, and how often the interval is halved.
_LEVELS, _HALVINGS = (0.05, 0.95), 12
#: A structure of fewer voxels than this has no shape.
_FEWEST = 20


def read_label_names(path: str | Path) -> dict[str, int]:
    """Read the names of the structures in a label map.

    Parameters
    ----------
    path : path
        A TOML file with a table ``[structures]``: name = number.

    Raises
    ------
    InputError
        It is missing, no TOML, or names and numbers are not as they should be.
    """
    table = read_toml(Path(path), "name the TOML file that names the labels")
    names = table.get("structures")
    if not isinstance(names, dict) or not names:
        raise InputError(f"{path}: no table [structures]; write 'name = number' lines under it")
    for name, number in names.items():
        if not (name.isascii() and name.isidentifier()):
            raise InputError(f"{path}: {name!r} is no name; use letters, digits and underscores")
        if type(number) is not int or not 0 < number < 2**31:
            raise InputError(f"{path}: {name} is {number!r}; give it a whole number from 1 up")
    if len(set(names.values())) < len(names):
        raise InputError(f"{path}: two names have the same number; give each its own")
    return dict(names)


def label_surfaces(labels: Image, names: Mapping[str, int]) -> dict[str, Surface]:
    """Turn the structures of a label map into surfaces (mm, LPS).

    Parameters
    ----------
    labels : Image
        Whole numbers.
    names : mapping of str to int

    Raises
    ------
    InputError
        The image does not hold whole numbers, or a structure is not in it or of too few voxels.
    """
    values = labels.values
    if values.dtype.kind == "f":
        if not (values == np.round(values)).all() or np.abs(values).max() >= 2**31:
            raise InputError(f"{labels.name}: not a label map; give an image of whole numbers")
        values = values.astype(np.int64)
    out = {}
    for name, number in names.items():
        where = values == number
        if int(where.sum()) < _FEWEST:
            raise InputError(
                f"{labels.name}: {name} ({number}) has {int(where.sum())} voxels; "
                "label it, or take it out of the table"
            )
        room = [(max(int(at.min()) - 4, 0), int(at.max()) + 5) for at in np.nonzero(where)]
        part = where[tuple(slice(*ends) for ends in room)]
        corner = np.array([low for low, _ in room], dtype=float)
        # One layer of nothing all around closes what the field of view cuts.
        part = np.pad(part, 1)
        image = Image(part, labels.points(corner[None] - 1.0)[0], labels.axes, labels.name)
        out[name] = _closed(image, name)
    return out


def _closed(image: Image, name: str) -> Surface:
    """Return the surface around a body of voxels that has their volume."""
    soft = ndimage.gaussian_filter(image.values.astype(np.float32), _SMOOTH)
    volume = float(image.values.sum()) * image.voxel_volume
    low, high = _LEVELS[0], min(_LEVELS[1], 0.99 * float(soft.max()))
    for _ in range(_HALVINGS):
        level = 0.5 * (low + high)
        surface = isosurface(image, soft, level)
        if surface.volume > volume:
            low = level
        else:
            high = level
    return Surface(surface.vertices, surface.faces, name)


def write_labels(folder: Path, labels: Image, names: Mapping[str, int]) -> None:
    """Write a label map and its table, ``labels.nii.gz`` and ``labels.toml``.

    Parameters
    ----------
    folder : Path
        It exists.
    labels : Image
        Whole numbers.
    names : mapping of str to int
        Such as `read_label_names` takes.
    """
    write_image(folder / "labels.nii.gz", labels)
    lines = ["[structures]", *(f"{name} = {number}" for name, number in names.items())]
    (folder / "labels.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
