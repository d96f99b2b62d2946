"""A head in another shape: its muscles go with the tissue in which they are embedded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..hermite import HermiteMesh
from ..hermite.basis import Array
from .head import Head
from .muscle import Muscle

__all__ = ["moved_head", "moved_muscles"]


def moved_muscles(
    muscles: Mapping[str, Muscle], tissue: HermiteMesh, parameters: Array
) -> dict[str, Muscle]:
    """Move muscles by the displacement of the tissue.

    Nodes and derivatives of a muscle follow the displacement, and so do its fibres: along ξ1 they
    become **F** times what they were, up to the muscle's own interpolation. What lies outside the
    tissue moves like the tissue's nearest point.

    Parameters
    ----------
    muscles : mapping of str to Muscle
    tissue : HermiteMesh
        At rest.
    parameters : (n_params, 3) array
        Its parameters in the other shape (mm).
    """
    shift = tissue.with_parameters(parameters - tissue.parameters)

    def mapping(points: Array) -> Array:
        place = tissue.locate(points)
        return np.asarray(points + shift.evaluate(place.elements, place.xi))

    return {name: muscle.transformed(mapping) for name, muscle in muscles.items()}


def moved_head(head: Head, parameters: Array) -> Head:
    """Return a half head whose tissue at rest has other parameters, (n_params, 3).

    The muscles follow. Attachments, landmarks, fractions and sides are given in the tissue's own
    coordinates and follow by themselves; the deep structures stay.
    """
    return replace(
        head,
        tissue=head.tissue.with_parameters(parameters),
        muscles=moved_muscles(head.muscles, head.tissue, parameters),
    )
