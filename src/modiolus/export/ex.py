"""A head, or a computed state of it, as EX files for Zinc and CMGUI."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from modiolus.face.head import Head
from modiolus.face.moved import moved_muscles
from modiolus.face.muscle import Muscle
from modiolus.hermite import HermiteMesh, assemble
from modiolus.hermite.basis import Array, IntArray
from modiolus.hermite.check import numbers
from modiolus.hermite.ex import FIBRES, write_ex

__all__ = ["DEFORMED", "write_head_ex"]


#: Field of the position in a computed state.
DEFORMED = "deformed"


def write_head_ex(
    head: Head, folder: Path, parameters: Array | None = None, older: bool = False
) -> dict[str, Path]:
    """Write the tissue and the muscles of a head.

    Both have the field ``coordinates`` and, for a state, ``deformed``; the muscles also ``fibres``,
    the Euler angles of the fibres at the nodes, and a group for each of them. Nodes and elements
    are numbered through both files, so that one region can hold them.

    Parameters
    ----------
    head : Head
        A half, or both sides.
    folder : Path
        An existing folder.
    parameters : (n_params, 3) array, optional
        Of the head's tissue in the state (mm).
    older : bool
        Write pairs of ``.exnode`` and ``.exelem`` instead of ``.exf``.

    Returns
    -------
    dict of Path
        The files written, by what they hold.

    Raises
    ------
    InputError
        The parameters are not those of the head's tissue.
    OSError
        A file cannot be written.
    """
    suffix = ".exnode" if older else ".exf"
    muscles, corners, angles = _joined(head.muscles)
    states: list[dict[str, Array]] = [{}, {}]
    if parameters is not None:
        parameters = numbers("parameters", parameters, head.tissue.n_params, 3)
        moved = moved_muscles(head.muscles, head.tissue, parameters)
        states = [{DEFORMED: parameters}, {DEFORMED: _joined(moved)[0].parameters}]
    first = write_ex(folder / f"tissue{suffix}", head.tissue, states[0])
    write_ex(
        folder / f"muscles{suffix}",
        muscles,
        states[1],
        {FIBRES: angles[corners]},
        _groups(head.muscles),
        first,
    )
    endings = (".exnode", ".exelem") if older else (".exf",)
    return {
        f"{part}{ending if older else ''}": folder / f"{part}{ending}"
        for part in ("tissue", "muscles")
        for ending in endings
    }


def _joined(muscles: Mapping[str, Muscle]) -> tuple[HermiteMesh, IntArray, Array]:
    """Return muscles as one mesh, its corners' nodes, and the angles at the nodes."""
    corners, nodes, angles, count = [], [], [], 0
    for muscle in muscles.values():
        own = muscle.mesh.parameters.reshape(-1, 8, 3)
        corners.append(muscle.corners + count)
        nodes.append(own)
        angles.append(np.zeros((len(own), 3)) if muscle.angles is None else muscle.angles)
        count += len(own)
    joined = np.concatenate(corners)
    return assemble(joined, np.concatenate(nodes)), joined, np.concatenate(angles)


def _groups(muscles: Mapping[str, Muscle]) -> dict[str, IntArray]:
    groups, count = {}, 0
    for name, muscle in muscles.items():
        groups[name] = count + np.arange(muscle.mesh.n_elements)
        count += muscle.mesh.n_elements
    return groups
