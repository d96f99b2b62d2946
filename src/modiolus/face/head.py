"""The head model: tissue, muscles, deep structures and attachments in one directory.

A head is a directory with ``head.toml`` (what a person may want to read or change) and three
archives of plain arrays: ``tissue.npz``, ``muscles.npz`` and ``deep.npz``.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..anatomy.distance import DistanceGrid, MirroredDistance
from ..anatomy.surface import MIDPLANE
from ..errors import InputError, unknown_name
from ..files import folder_name, read_toml
from ..hermite import HermiteMesh, MirroredMesh, Side
from ..hermite.basis import Array
from .jaw import Jaw
from .muscle import Muscle

#: Version of the directory's layout.
FORMAT = 1
_SHIPPED = files("modiolus.face") / "data" / "heads"
#: Archives larger than this (bytes, unpacked) are not read.
_LARGEST = 512 * 2**20
#: No number of a head, of whichever unit, is as large as this.
_LARGEST_NUMBER = 1e9
#: No head is refined more often than this along an edge of its elements.
_FINEST = 16
#: What of `Head.about` goes into the LICENSE beside the data.
_LICENCE_KEYS = ("licence", "licence_url", "attribution", "source", "changes")
#: Without these sides and landmarks a head can be neither computed nor reported on.
_SIDES = (
    *("outer", "inner", "midplane", "ear", "neck", "scalp"),
    *("lip_upper", "lip_lower", "lid_upper", "lid_lower"),
)
_LANDMARKS = (
    *("mouth_corner", "upper_lip_mid", "lower_lip_mid", "inner_brow", "outer_brow"),
    *("cheek", "ala", "chin", "upper_lid_mid", "lower_lid_mid"),
)


@dataclass(frozen=True)
class RigidSurface:
    """A deep structure: it does not deform and the tissue does not enter it.

    Attributes
    ----------
    name : str
    distance : DistanceGrid
    """

    name: str
    distance: DistanceGrid


@dataclass(frozen=True)
class Attachment:
    """Tissue held by springs: to bone at an origin or ligament, to the skin at an insertion.

    Attributes
    ----------
    name : str
    elements : (n,) int array
    xi : (n, 3) array
        Where in the tissue.
    stiffness : (n,) array
        Of each point in mN/mm.
    """

    name: str
    elements: NDArray[np.int64]
    xi: Array
    stiffness: Array


@dataclass(frozen=True)
class Head:
    """A head model: the left half, mirrored in the mid-plane, or both sides.

    Attributes
    ----------
    name : str
    tissue : HermiteMesh
        Tricubic mesh; xi1 lateral, xi2 up, xi3 outward.
    sides : dict of (elements, axis, side)
        Named sides of the mesh, see `modiolus.face.tissue.Tissue`.
    landmarks : dict of (element, xi)
        Named places of the left half.
    fraction : (n_elements, 64) array
        Muscle volume fraction at the 4 x 4 x 4 Gauss points.
    firmness : (n_elements, 64) array
        Share of the modiolus, the firm knot beside the corner of the mouth.
    muscles : dict of Muscle
    deep : dict of RigidSurface
    attachments : dict of Attachment
        What holds the tissue to the bone.
    insertions : dict of Attachment
        By muscle, its end that is bound to the skin above it.
    sheets : dict of Attachment
        Fibrous sheets in the tissue; their stiffness is that of each point times its area (mN mm).
    midplane : float
        x of the mirror plane (mm).
    about : dict
        Subject, source, licence, attribution, and the figures of the build.
    half : Head or None
        Of a head with both sides, the half that it was made of; see `whole`.
    fineness : int
        How many times as densely as usual its muscles are integrated, see `Muscle.fibre_points`.
    """

    name: str
    tissue: HermiteMesh
    sides: dict[str, Side]
    landmarks: dict[str, tuple[int, tuple[float, float, float]]]
    fraction: Array
    firmness: Array
    muscles: dict[str, Muscle]
    deep: dict[str, RigidSurface]
    attachments: dict[str, Attachment]
    insertions: dict[str, Attachment]
    sheets: dict[str, Attachment] = field(default_factory=dict)
    midplane: float = MIDPLANE
    about: dict[str, Any] = field(default_factory=dict)
    half: Head | None = None
    fineness: int = 1

    @cached_property
    def skinward(self) -> NDArray[np.int64]:
        """The element at the skin above each element, (n_elements,); itself in a single layer."""
        corners = self.tissue.corner_nodes()[0]
        below = {tuple(face): element for element, face in enumerate(corners[:, :4].tolist())}
        above = np.arange(self.tissue.n_elements)
        while True:
            higher = np.array([below.get(tuple(corners[e, 4:].tolist()), e) for e in above])
            if np.array_equal(higher, above):
                return above
            above = higher

    @cached_property
    def both(self) -> MirroredMesh:
        """The tissue of this half and its mirror image as one mesh."""
        return MirroredMesh.of(self.tissue, *self.sides["midplane"], self.midplane)

    @cached_property
    def whole(self) -> Head:
        """The head with both sides: see `modiolus.face.whole`."""
        from .whole import whole_head

        return self if self.half is not None else whole_head(self)

    @cached_property
    def jaw(self) -> Jaw | None:
        """The jaw, or None where the deep structures have none."""
        return Jaw.of({name: item.distance for name, item in self.deep.items()}, self.midplane)

    def distance(self, name: str) -> MirroredDistance:
        """Return the distance to a deep structure on both sides."""
        return MirroredDistance(self.deep[name].distance, self.midplane)

    def halves(self, parameters: Array) -> tuple[Array, Array]:
        """Return a state as two of the left half: the left side, and the right one mirrored.

        Parameters
        ----------
        parameters : (n_params, 3) array
            Of this half's tissue or of the whole's.
        """
        if len(parameters) == self.tissue.n_params:
            return parameters, parameters
        return self.both.halves(parameters)

    def is_median(self, landmark: str) -> bool:
        """Tell whether a landmark lies on the mid-plane."""
        element, xi = self.landmarks[landmark]
        return bool(abs(self.tissue.evaluate([element], [xi])[0, 0] - self.midplane) < 1e-6)

    def mirror(self, points: Array) -> Array:
        """Return points (..., 3) mirrored in the mid-plane."""
        out = np.array(points, dtype=float)
        out[..., 0] = 2.0 * self.midplane - out[..., 0]
        return out

    def landmark_points(self, parameters: Array | None = None) -> dict[str, Array]:
        """Return the landmarks of both sides under some tissue parameters, each (3,).

        Those on the mid-plane keep their name; the others get ``_left`` and ``_right``. The
        parameters are those of this half's tissue or of the whole's.
        """
        if self.half is not None:
            return self.half.landmark_points(
                self.tissue.parameters if parameters is None else parameters
            )
        sides = self.halves(self.tissue.parameters if parameters is None else parameters)
        left, right = (self.tissue.with_parameters(side) for side in sides)
        out: dict[str, Array] = {}
        for name, (element, xi) in self.landmarks.items():
            point = left.evaluate([element], [xi])[0]
            if self.is_median(name):
                out[name] = point
            else:
                out[f"{name}_left"] = point
                out[f"{name}_right"] = self.mirror(right.evaluate([element], [xi])[0])
        return out

    def save(self, folder: Path) -> None:
        """Write the head into an existing, empty folder.

        Beside the arrays and ``head.toml`` goes ``LICENSE``: the terms under which the data it
        was made from may be passed on, and what was changed, as `about` has them.

        Parameters
        ----------
        folder : Path

        Raises
        ------
        OSError
            The folder cannot be written.
        InputError
            The head is not a half, or its name cannot be that of a folder.
        """
        folder_name("head", self.name)
        if self.half is not None:
            raise InputError(f"{self.name}: it has both sides; save the half, which makes them")
        folder = Path(folder)
        extraction = self.tissue.extraction
        tissue: dict[str, NDArray[Any]] = {
            "parameters": self.tissue.parameters,
            "data": extraction.data,
            "indices": extraction.indices.astype(np.int32),
            "indptr": extraction.indptr.astype(np.int32),
            "fraction": self.fraction.astype(np.float32),
            "firmness": self.firmness.astype(np.float32),
        }
        for name, (elements, axis, side) in self.sides.items():
            tissue[f"side/{name}"] = np.concatenate([[axis, side], elements]).astype(np.int32)
        held = {"attachment": self.attachments, "insertion": self.insertions}
        for kind, items in {**held, "sheet": self.sheets}.items():
            for name, item in items.items():
                values = np.column_stack([item.elements, item.xi, item.stiffness])
                tissue[f"{kind}/{name}"] = values
        _write_arrays(folder / "tissue.npz", tissue)
        muscles = {
            f"{name}/{key}": value
            for name, muscle in self.muscles.items()
            for key, value in muscle.arrays().items()
        }
        _write_arrays(folder / "muscles.npz", muscles)
        deep = {
            f"{name}/{key}": value
            for name, surface in self.deep.items()
            for key, value in surface.distance.arrays().items()
        }
        _write_arrays(folder / "deep.npz", deep)
        (folder / "head.toml").write_text(self._toml(), encoding="utf-8")
        (folder / "LICENSE").write_text(self.licence_text(), encoding="utf-8")

    def licence_text(self) -> str:
        """Return the terms under which the data may be passed on."""
        about = {key: str(self.about.get(key, "not stated")) for key in _LICENCE_KEYS}
        return (
            f"The files of the head {self.name!r} are licensed under {about['licence']}:\n"
            f"{about['licence_url']}\n\n"
            f"Attribution: {about['attribution']}\n\n"
            f"Source: {about['source']}\n"
            f"Changes to it: {about['changes']}\n"
        )

    def _toml(self) -> str:
        lines = [f"format = {FORMAT}", f"name = {json.dumps(self.name)}"]
        lines += [f"midplane = {self.midplane!r}", f"fineness = {self.fineness}", ""]
        lines += _table("about", self.about)
        lines += ["[landmarks]", "# element, xi1, xi2, xi3"]
        for name, (element, xi) in self.landmarks.items():
            lines.append(f"{name} = [{element}, {', '.join(repr(float(v)) for v in xi)}]")
        lines += ["", "# Stretch from which the passive fibres of a muscle are taut.", "[slack]"]
        lines += [f"{name} = {muscle.slack!r}" for name, muscle in self.muscles.items()]
        return "\n".join(lines) + "\n"

    @classmethod
    def load(cls, name: str | Path) -> Head:
        """Read a shipped head by its name, or one from a directory.

        Raises
        ------
        InputError
            There is no such head, or its files are not sound.
        """
        text = str(name)
        if text in head_names():
            with as_file(_SHIPPED / text) as folder:
                return cls._read(Path(folder))
        folder = Path(name)
        if (folder / "head.toml").is_file():
            return cls._read(folder)
        if folder.exists() or "/" in text:
            raise InputError(
                f"{text or repr(text)}: not a head's directory; name one that holds head.toml"
            )
        raise unknown_name("head", text, head_names())

    @classmethod
    def _read(cls, folder: Path) -> Head:
        table = _read_toml(folder / "head.toml")
        tissue, muscles, deep = (
            _grouped(read_arrays(folder / f"{part}.npz")) for part in ("tissue", "muscles", "deep")
        )
        try:
            mesh = _mesh(tissue[""])
            held = {
                kind: {
                    name: _held(name, values, mesh) for name, values in tissue.get(kind, {}).items()
                }
                for kind in ("attachment", "insertion", "sheet")
            }
            return cls(
                name=table["name"],
                tissue=mesh,
                sides=_sides(tissue["side"], mesh),
                landmarks=_landmarks(table["landmarks"], mesh),
                fraction=_shares(tissue[""]["fraction"]).reshape(mesh.n_elements, 64),
                firmness=_shares(tissue[""]["firmness"]).reshape(mesh.n_elements, 64),
                muscles=_muscles(muscles, table.get("slack", {})),
                deep={
                    key: RigidSurface(key, DistanceGrid.from_arrays(arrays))
                    for key, arrays in deep.items()
                },
                attachments=held["attachment"],
                insertions=held["insertion"],
                sheets=held["sheet"],
                midplane=float(_finite(np.array(table["midplane"]))),
                about=dict(table.get("about", {})),
                fineness=_fineness(table.get("fineness", 1)),
            )
        except InputError as error:
            raise InputError(f"{folder}: {error}") from error
        except (KeyError, ValueError, TypeError, IndexError, AttributeError) as error:
            fault = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(
                f"{folder}: its arrays do not make a head ({fault}); build or copy it anew"
            ) from error


def about_head(name: str | Path) -> dict[str, Any]:
    """Return what a shipped head, or one in a directory, says of itself: see `Head.about`.

    Raises
    ------
    InputError
        There is no such head, or its ``head.toml`` is not sound.
    """
    shipped = str(name) in head_names()
    with as_file(_SHIPPED / str(name)) if shipped else nullcontext(Path(name)) as folder:
        about = _read_toml(Path(folder) / "head.toml").get("about", {})
    if not isinstance(about, dict):
        raise InputError(f"{name}: its [about] is not a table; mend head.toml")
    return about


def lasting_name(name: str | Path) -> str:
    """Return what finds a head again from any folder: a shipped one's name, or its whole path."""
    text = str(name)
    return text if text in head_names() else str(Path(name).resolve())


def head_names() -> tuple[str, ...]:
    """Return the names of the heads that come with the package."""
    if not _SHIPPED.is_dir():
        return ()
    return tuple(sorted(e.name for e in _SHIPPED.iterdir() if (e / "head.toml").is_file()))


def _mesh(arrays: Mapping[str, NDArray[Any]]) -> HermiteMesh:
    parameters, starts = _finite(arrays["parameters"]), arrays["indptr"]
    extraction = sp.csr_matrix(
        (_finite(arrays["data"]), arrays["indices"], starts),
        shape=(len(starts) - 1, len(parameters)),
    )
    extraction.check_format(full_check=True)
    return HermiteMesh(3, parameters, extraction)


def _sides(arrays: Mapping[str, NDArray[Any]], mesh: HermiteMesh) -> dict[str, Side]:
    out: dict[str, Side] = {}
    for name, values in arrays.items():
        axis, side = int(values[0]), int(values[1])
        if axis not in (0, 1, 2) or side not in (0, 1):
            raise ValueError(f"side {name} is no side of an element")
        out[name] = (_elements(values[2:], mesh), axis, side)
    _have("side", _SIDES, out)
    return out


def _held(name: str, values: NDArray[Any], mesh: HermiteMesh) -> Attachment:
    stiffness = _finite(values[:, 4])
    if not (stiffness >= 0.0).all():
        raise ValueError(f"stiffness of {name} is not from 0 up")
    return Attachment(name, _elements(values[:, 0], mesh), _shares(values[:, 1:4]), stiffness)


def _fineness(value: Any) -> int:
    if type(value) is not int or not 1 <= value <= _FINEST:
        raise ValueError(f"fineness is {value!r}, not a whole number from 1 to {_FINEST}")
    return value


def _landmarks(
    rows: Mapping[str, list[Any]], mesh: HermiteMesh
) -> dict[str, tuple[int, tuple[float, float, float]]]:
    out = {}
    for name, row in rows.items():
        element = int(_elements(np.array([row[0]]), mesh)[0])
        a, b, c = _shares(np.array(row[1:])).tolist()
        out[name] = (element, (a, b, c))
    _have("landmark", _LANDMARKS, out)
    return out


def _muscles(
    groups: Mapping[str, Mapping[str, NDArray[Any]]], slacks: Mapping[str, Any]
) -> dict[str, Muscle]:
    if not groups:
        raise ValueError("there are no muscles")
    out = {}
    for name, arrays in groups.items():
        muscle = Muscle.from_arrays(name, arrays)
        if not name.isidentifier():
            raise ValueError(f"{name!r} is not a muscle's name")
        if muscle.angles is not None:
            _finite(muscle.angles)
        slack = float(slacks.get(name, muscle.slack))
        if not 0.5 <= slack <= 3.0:
            raise ValueError(f"slack of {name} is {slack}, not a stretch within 0.5 to 3")
        out[name] = replace(muscle, slack=slack)
    return out


def _finite(values: NDArray[Any]) -> Array:
    if values.dtype.kind not in "fiu" or not (np.abs(values) < _LARGEST_NUMBER).all():
        raise ValueError("a number is not finite, or too large")
    return values.astype(float)


def _shares(values: NDArray[Any]) -> Array:
    values = _finite(values)
    if values.size and (values.min() < -1e-6 or values.max() > 1.0 + 1e-6):
        raise ValueError("a number that has to be within 0 to 1 is not")
    return values


def _elements(values: NDArray[Any], mesh: HermiteMesh) -> NDArray[np.int64]:
    elements = _finite(values).astype(np.int64)
    if (elements < 0).any() or (elements >= mesh.n_elements).any():
        raise ValueError("an element's number is out of range")
    return elements


def _have(what: str, names: tuple[str, ...], given: Mapping[str, object]) -> None:
    missing = [name for name in names if name not in given]
    if missing:
        raise ValueError(f"there is no {what} {missing[0]}")


def _table(name: str, values: Mapping[str, Any]) -> list[str]:
    """Write a table of scalars, lists and sub-tables as TOML."""
    plain = {k: v for k, v in values.items() if not isinstance(v, Mapping)}
    lines = [f"[{name}]", *[f"{k} = {json.dumps(v)}" for k, v in plain.items()], ""]
    for key, value in values.items():
        if isinstance(value, Mapping):
            lines += _table(f"{name}.{key}", value)
    return lines


def _read_toml(path: Path) -> dict[str, Any]:
    table = read_toml(path, "name a head's directory")
    version = table.get("format")
    if version != FORMAT:
        later = isinstance(version, int) and version > FORMAT
        mend = "take a later modiolus" if later else "build the head anew"
        raise InputError(f"{path}: format is {version!r} and not {FORMAT}; {mend}")
    for key in ("name", "landmarks", "midplane"):
        if key not in table:
            raise InputError(f"{path}: it says nothing of {key!r}; build or copy the head anew")
    folder_name(str(path), table["name"])
    return table


def _write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    np.savez_compressed(path, allow_pickle=False, **arrays)


def read_arrays(path: Path, mend: str = "build or copy the head anew") -> dict[str, NDArray[Any]]:
    """Read an archive of plain arrays.

    Parameters
    ----------
    path : Path
    mend : str
        What to do when it cannot be read.

    Raises
    ------
    InputError
        It is missing, damaged or far too large.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > _LARGEST:
                raise InputError(f"{path}: it unpacks to more than {_LARGEST >> 20} MiB; {mend}")
        with np.load(path, allow_pickle=False) as archive:
            return {key: archive[key] for key in archive.files}
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; {mend}") from error
    except InputError:
        raise
    except PermissionError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); ask its owner") from error
    except Exception as error:  # zlib, zipfile and NumPy raise kinds of their own
        raise InputError(
            f"{path}: cannot be read as arrays; it may be truncated, {mend}"
        ) from error


def _grouped(arrays: Mapping[str, NDArray[Any]]) -> dict[str, dict[str, NDArray[Any]]]:
    """Put arrays that are called ``group/name`` together; those without a group are in ``""``."""
    out: dict[str, dict[str, NDArray[Any]]] = {}
    for key, value in arrays.items():
        group, _, name = key.rpartition("/")
        out.setdefault(group, {})[name] = value
    return out
