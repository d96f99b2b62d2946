"""What a simulation leaves for later: the exact state, and the head it belongs to."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..face.expression import resolve
from ..face.head import Head, read_arrays
from ..face.jaw import opening
from ..files import folder_name
from ..mechanics.face import FaceSettings

__all__ = ["STATE_FILE", "Result", "load_result", "save_state"]

Array = NDArray[np.float64]

#: Name of the file in the folder of a run.
STATE_FILE = "state.npz"
#: No tissue goes so far (mm), none is under such a pressure (kPa), and no time (s) is as late.
_FARTHEST, _HIGHEST, _LATEST = 1e3, 1e6, 1e12


@dataclass(frozen=True)
class Result:
    """A computed state of a head.

    Attributes
    ----------
    expression : str
    head : Head
    parameters : (n_params, 3) array
        Of the tissue of the half, or of both sides (mm).
    pressure : (n_vertices,) array
        In kPa.
    activations : dict of str to float
        By muscle; those at rest are left out.
    jaw : float
        Angle in radians by which the jaw is open.
    time : float or None
        In seconds, of a frame of a sequence.
    settings : FaceSettings
    offsets : dict of str to (n,) array
        By which contacts are pressed apart (mm), see `modiolus.mechanics.Load`; empty where a
        file has none.
    """

    expression: str
    head: Head
    parameters: Array
    pressure: Array
    activations: dict[str, float]
    jaw: float
    time: float | None = None
    settings: FaceSettings = field(default_factory=FaceSettings)
    offsets: dict[str, Array] = field(default_factory=dict)


def _digest(head: Head) -> str:
    return hashlib.sha256(np.round(head.tissue.parameters, 6).tobytes()).hexdigest()[:16]


def save_state(
    path: Path,
    expression: str,
    head: Head,
    source: str,
    parameters: Array,
    pressure: Array,
    activations: dict[str, float],
    jaw: float,
    time: float | None = None,
    settings: FaceSettings | None = None,
    offsets: Mapping[str, Array] | None = None,
) -> None:
    """Write a state as plain arrays.

    Parameters
    ----------
    path : Path
        The file to write.
    expression : str
    head : Head
    source : str
        Name of a shipped head, or the folder it was read from.
    parameters : (n_params, 3) array
    pressure : (n_vertices,) array
        In kPa.
    activations : dict of str to float
    jaw : float
        Angle in radians by which the jaw is open.
    time : float, optional
        In seconds, of a frame of a sequence.
    settings : FaceSettings, optional
    offsets : mapping of str to (n,) array, optional
        By which contacts are pressed apart (mm).
    """
    offsets = offsets or {}
    np.savez_compressed(
        path,
        allow_pickle=False,
        expression=np.array(expression),
        head=np.array(source),
        digest=np.array(_digest(head)),
        parameters=parameters,
        pressure=pressure,
        muscles=np.array(list(activations), dtype="U64"),
        activations=np.array(list(activations.values()), dtype=float),
        jaw=np.array(jaw),
        settings=np.array(json.dumps(asdict(settings or FaceSettings()))),
        contacts=np.array(list(offsets), dtype="U64"),
        points=np.array([len(values) for values in offsets.values()], dtype=np.int64),
        offsets=np.concatenate([*offsets.values(), np.empty(0)]),
        **({} if time is None else {"time": np.array(time)}),
    )


def load_result(folder: str | Path, head: str | None = None) -> Result:
    """Read the state that ``modiolus simulate`` wrote into a folder.

    Parameters
    ----------
    folder : path
    head : str, optional
        Name or folder of the head where it is no longer where it was.

    Raises
    ------
    InputError
        The folder holds no state, it is damaged, or the head has changed since.
    """
    path = Path(folder) / STATE_FILE
    if not path.is_file():
        raise InputError(f"{folder}: no {STATE_FILE} in it; name a folder that simulate wrote")
    arrays = read_arrays(path, "simulate anew")
    try:
        source = str(arrays["head"]) if head is None else head
        chosen = Head.load(source)
        parameters = np.asarray(arrays["parameters"], dtype=float)
        pressure = np.asarray(arrays["pressure"], dtype=float).ravel()
        muscles, values = arrays["muscles"], arrays["activations"].astype(float)
        if muscles.ndim != 1 or muscles.shape != values.shape:
            raise ValueError("muscles and activations do not pair")
        same = str(arrays["digest"]) == _digest(chosen)
        expression = folder_name(f"{path}: expression", str(arrays["expression"]))
        jaw = float(arrays["jaw"])
        time = float(arrays["time"]) if "time" in arrays else None
        given = json.loads(str(arrays["settings"]))
        # Files of before have none.
        offsets = _offsets(arrays) if "offsets" in arrays else {}
    except (KeyError, ValueError, TypeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: its arrays make no state ({error}); simulate anew") from error
    rests = {mesh.n_params: mesh.parameters for mesh in (chosen.tissue, chosen.both.mesh)}
    rest = rests.get(len(parameters))
    if not same or rest is None or parameters.shape != rest.shape:
        raise InputError(f"{folder}: no state of the head {source} as it is now; simulate anew")
    for numbers, bound in (
        (parameters - rest, _FARTHEST),
        (pressure, _HIGHEST),
        ([*values, jaw, time or 0.0], _LATEST),
        (np.concatenate([*offsets.values(), np.empty(0)]), _FARTHEST),
    ):
        if not (np.abs(numbers) < bound).all():
            raise InputError(f"{path}: a number is not finite, or too large; simulate anew")
    activations = dict(zip(muscles.astype(str).tolist(), values.tolist(), strict=True))
    try:
        resolve(activations, chosen.muscles)
        opening(np.degrees(jaw), "jaw")
        settings = FaceSettings(**given)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except TypeError as error:
        raise InputError(f"{path}: settings of no face ({error}); simulate anew") from None
    return Result(
        expression, chosen, parameters, pressure, activations, jaw, time, settings, offsets
    )


def _offsets(arrays: Mapping[str, NDArray[Any]]) -> dict[str, Array]:
    """Take the offsets of contacts, which lie in one array, apart."""
    contacts, points = arrays["contacts"], arrays["points"]
    values = arrays["offsets"].astype(float)
    if contacts.ndim != 1 or points.shape != contacts.shape or points.dtype.kind not in "iu":
        raise ValueError("contacts and points do not pair")
    if values.shape != (points.sum(),) or (points < 0).any() or (values < 0.0).any():
        raise ValueError("offsets are not one from 0 up for each point")
    parts = np.split(values, np.cumsum(points)[:-1]) if len(points) else []
    return dict(zip(contacts.astype(str).tolist(), parts, strict=True))
