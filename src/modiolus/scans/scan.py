"""A scan: a measured face as a surface or a cloud of points, read and checked."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..anatomy.ply import read_ply
from ..anatomy.surface import Surface, check_face, read_surface
from ..errors import InputError, unknown_name
from ..fitting.register import UNITS, Registration
from .cloud import wrapped

__all__ = ["Scan", "known_unit", "read_scan", "scan_files"]

Array = NDArray[np.float64]

#: Files larger than this (bytes) and scans of more points are refused: memory stays bounded.
_LARGEST_FILE = 2**30
_MOST_POINTS = 3_000_000
_MESHES = (".ply", ".obj", ".stl", ".vtp")
_CLOUDS = (".xyz", ".txt", ".csv", ".asc", ".pts")
#: Directions (azimuth, elevation in degrees) from which a face is looked at.
_CAMERAS = [(a, e) for a in (0.0, 45.0, -45.0, 80.0, -80.0) for e in (0.0, 30.0)]


@dataclass(frozen=True, eq=False)
class Scan:
    """A measured face.

    Attributes
    ----------
    name : str
        For messages; the file's name.
    points : (n, 3) array
        In the file's unit and frame, or after `placed` in mm and the head's frame.
    normals : (n, 3) array
        Outward unit normals.
    surface : Surface
        Triangles between the points; that of a cloud passes through them, with vertices of its own.
    cloud : bool
        Whether it was read as a cloud.
    """

    name: str
    points: Array
    normals: Array
    surface: Surface
    cloud: bool = False

    @classmethod
    def of(cls, surface: Surface) -> Scan:
        """Return the scan that a surface is, with its name."""
        return cls(surface.name, surface.vertices, surface.vertex_normals, surface)

    @cached_property
    def weights(self) -> Array:
        """Area that each point stands for, (n,); the same everywhere in a cloud.

        With these, dense parts of a mesh count no more than sparse ones.
        """
        if self.cloud:
            return np.full(len(self.points), self.surface.area / len(self.points))
        return self.surface.vertex_areas

    @cached_property
    def shown(self) -> NDArray[np.int64]:
        """Index of the point that every vertex of the surface shows, (m,)."""
        if not self.cloud:
            return np.arange(len(self.points))
        return np.asarray(cKDTree(self.points).query(self.surface.vertices)[1])

    @cached_property
    def _rim(self) -> NDArray[np.bool_]:
        """Whether a vertex of the surface lies on its border."""
        faces = self.surface.faces
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        found, counts = np.unique(edges, axis=0, return_counts=True)
        out = np.zeros(len(self.surface.vertices), dtype=bool)
        out[found[counts == 1].ravel()] = True
        return out

    def placed(self, pose: Registration) -> Scan:
        """Return the scan in another frame."""
        return replace(
            self,
            points=pose.apply(self.points),
            normals=self.normals @ pose.rotation.T,
            surface=pose.moved(self.surface),
        )

    def nearest(self, points: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Find the closest points of the scan.

        Parameters
        ----------
        points : (n, 3) array

        Returns
        -------
        points : (n, 3) array
        normals : (n, 3) array
        rim : (n,) bool array
            The closest point is on the border: what is asked for lies beside the scan.
        """
        surface = self.surface
        found = surface.closest(points)
        corners = surface.faces[found.faces]
        shares = barycentric(found.points, surface.vertices[corners])
        normals = np.einsum("nk,nki->ni", shares, surface.vertex_normals[corners])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        rim = (shares * self._rim[corners]).sum(axis=1) > 1.0 - 1e-6
        return found.points, normals, rim

    @cached_property
    def visible(self) -> NDArray[np.bool_]:
        """Whether a camera in front of the face would see a point, (n,).

        For a scan in the head's frame. The inside of nostrils and what lies behind the lips is
        not visible: models have no such parts, and scanners guess them.
        """
        out = np.zeros(len(self.points), dtype=bool)
        size = float(np.ptp(self.points, axis=0).max())
        # Points of a cloud lie about its surface.
        places = self.nearest(self.points)[0] if self.cloud else self.points
        starts = places + 1e-3 * size * self.normals
        for azimuth, elevation in _CAMERAS:
            a, e = np.radians([azimuth, elevation])
            towards = np.array([np.sin(a) * np.cos(e), -np.cos(a) * np.cos(e), np.sin(e)])
            rows = np.flatnonzero(~out & (self.normals @ towards > 0.1))
            if len(rows):
                out[rows] = np.isnan(self.surface.first_hits(starts[rows], towards)[:, 0])
        return out

    def same_order(self, other: Scan) -> bool:
        """Tell whether two scans are one mesh in two states, vertex by vertex."""
        return (
            not self.cloud
            and not other.cloud
            and np.array_equal(self.surface.faces, other.surface.faces)
        )


def barycentric(points: Array, corners: Array) -> Array:
    """Return the barycentric coordinates (n, 3) of points (n, 3) in triangles (n, 3, 3)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    u, v, w = b - a, c - a, points - a
    uu, uv, vv = (u * u).sum(1), (u * v).sum(1), (v * v).sum(1)
    wu, wv = (w * u).sum(1), (w * v).sum(1)
    area = np.maximum(uu * vv - uv * uv, 1e-300)
    s, t = (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area
    out = np.clip(np.stack([1.0 - s - t, s, t], axis=1), 0.0, 1.0)
    return np.asarray(out / out.sum(axis=1, keepdims=True))


def known_unit(unit: str) -> str:
    """Return a unit of length after a check; empty means that it is to be found.

    Raises
    ------
    InputError
        It is not one of `UNITS`.
    """
    if unit and unit not in UNITS:
        raise unknown_name("unit", unit, UNITS)
    return unit


def scan_files(folder: Path) -> dict[str, Path]:
    """Return the scans in a folder by their name, frame 10 after frame 9.

    Raises
    ------
    InputError
        There is no such folder, or two scans have one name.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; name one with scans in it")

    def numbered(path: Path) -> list[tuple[int, str]]:
        parts = re.split(r"(\d+)", path.stem)
        return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]

    out: dict[str, Path] = {}
    for path in sorted(folder.iterdir(), key=numbered):
        if path.suffix.lower() not in (*_MESHES, _CLOUDS[0]):
            continue
        name = path.stem.replace("_", "-")
        if name in out:
            raise InputError(f"{path}: there is also {out[name].name}; keep one of them")
        out[name] = path
    return out


def read_scan(path: str | Path) -> Scan:
    """Read a scan and check it.

    Parameters
    ----------
    path : path
        A surface (PLY, OBJ, STL, VTP) or a cloud of points (PLY without faces; XYZ, TXT, CSV,
        ASC or PTS with a point a line and perhaps its normal) in any unit and pose.

    Raises
    ------
    InputError
        The file is missing, damaged, too large, of another kind, or holds too little.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if not path.is_file():
        fault = "a folder, not a file" if path.is_dir() else "no such file"
        raise InputError(f"{path}: {fault}; check the path")
    if suffix not in _MESHES + _CLOUDS:
        kinds = ", ".join(_MESHES + _CLOUDS[:1])
        raise InputError(f"{path}: not a kind of scan that can be read; give one of {kinds}")
    size = path.stat().st_size
    if size > _LARGEST_FILE:
        raise InputError(
            f"{path}: {size >> 20} MiB are more than {_LARGEST_FILE >> 20}; decimate the scan"
        )
    if suffix in _CLOUDS:
        return _cloud(path, _read_rows(path))
    if suffix == ".ply" and _is_cloud(path):
        try:
            points, _ = read_ply(path)
        except ValueError as error:
            raise InputError(
                f"{path}: cannot be read as a cloud ({error}); it may be truncated, fetch it again"
            ) from None
        return _cloud(path, points.astype(float))
    surface = read_surface(path)
    _check(path, surface.vertices)
    surface = _tidied(surface, path.name)
    _check(path, surface.vertices)
    return Scan.of(surface)


def _check(path: Path, points: Array) -> None:
    """Refuse what cannot be a face, and what memory does not hold."""
    if len(points) > _MOST_POINTS:
        raise InputError(
            f"{path}: {len(points)} points are more than {_MOST_POINTS}; decimate the scan"
        )
    check_face(str(path), points)


def _tidied(surface: Surface, name: str) -> Surface:
    """Drop points that no triangle uses, and triangles without three different corners."""
    faces = surface.faces
    sound = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    used, packed = np.unique(faces[sound], return_inverse=True)
    return Surface(surface.vertices[used], packed.reshape(-1, 3), name)


def _is_cloud(path: Path) -> bool:
    """Tell whether a PLY file has no faces."""
    with path.open("rb") as file:
        head = file.read(1 << 16).partition(b"end_header")[0]
    found = re.search(rb"element\s+face\s+(\d+)", head)
    return b"element vertex" in head and (found is None or int(found[1]) == 0)


def _read_rows(path: Path) -> Array:
    """Read three or more numbers a line; a first line of words and lines after # are skipped."""
    try:
        text = path.read_text(encoding="utf-8", errors="strict")
    except UnicodeDecodeError:
        raise InputError(f"{path}: not text; give a point a line") from None
    rows = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").replace(";", " ").split()
        if not words:
            continue
        try:
            rows.append([float(word) for word in words[:3]])
            if len(words) < 3:
                raise ValueError
        except ValueError:
            if rows and len(rows) > 1:
                raise InputError(
                    f"{path}: line {number} does not hold three numbers; mend it"
                ) from None
            rows = []  # a heading, or the count of points in a PTS file
        if len(rows) > _MOST_POINTS:
            raise InputError(f"{path}: more than {_MOST_POINTS} points; decimate the scan")
    if not rows:
        raise InputError(f"{path}: no line of it holds three numbers; give a point a line")
    return np.array(rows, dtype=float)


def _cloud(path: Path, points: Array) -> Scan:
    _check(path, points)
    points = np.unique(points, axis=0)
    _check(path, points)
    points, normals, surface = wrapped(points, path.name)
    _check(path, points)
    return Scan(path.name, points, normals, surface, cloud=True)
