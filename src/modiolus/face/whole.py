"""The whole head: a half and its mirror image, with muscles and landmarks of either side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..hermite import Side
from .head import Attachment, Head
from .muscle import Muscle


def whole_head(half: Head) -> Head:
    """Return the head with both sides in one mesh.

    The muscles, attachments and landmarks that are not on the mid-plane have ``_left`` or
    ``_right`` after their name, and so have the sides across ``xi1``: the cut at the ear becomes
    two, and there is no mid-plane any more. The deep structures stay those of the left half, see
    `Head.distance`.

    Parameters
    ----------
    half : Head
        The left half.
    """
    both = half.both
    sides: dict[str, Side] = {}
    for name, (elements, axis, side) in half.sides.items():
        there = elements + half.tissue.n_elements
        if axis:
            sides[name] = (np.concatenate([elements, there]), axis, side)
        elif name != "midplane":
            sides[f"{name}_left"] = (elements, axis, side)
            sides[f"{name}_right"] = (there, axis, 1 - side)
    landmarks = {}
    for name, (element, xi) in half.landmarks.items():
        if half.is_median(name):
            landmarks[name] = (element, xi)
        else:
            landmarks[f"{name}_left"] = (element, xi)
            landmarks[f"{name}_right"] = (element + half.tissue.n_elements, (1.0 - xi[0], *xi[1:]))
    muscles: dict[str, Muscle] = {}
    for name, muscle in half.muscles.items():
        left, right = f"{name}_left", f"{name}_right"
        muscles[left] = replace(muscle, name=left)
        muscles[right] = replace(muscle.mirrored(half.midplane), name=right)

    def of_both(items: Mapping[str, Attachment]) -> dict[str, Attachment]:
        out = {}
        for name, item in items.items():
            left, right = f"{name}_left", f"{name}_right"
            out[left] = replace(item, name=left)
            out[right] = Attachment(right, *both.points(item.elements, item.xi), item.stiffness)
        return out

    return replace(
        half,
        tissue=both.mesh,
        sides=sides,
        landmarks=landmarks,
        fraction=_both(half.fraction),
        firmness=_both(half.firmness),
        muscles=muscles,
        attachments=of_both(half.attachments),
        insertions=of_both(half.insertions),
        sheets=of_both(half.sheets),
        half=half,
    )


def _both(values: np.ndarray) -> np.ndarray:
    """Return values at Gauss points (n_elements, 64) of both sides; xi1 runs fastest."""
    there = values.reshape(-1, 16, 4)[:, :, ::-1].reshape(values.shape)
    return np.concatenate([values, there])
