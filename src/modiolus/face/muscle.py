"""Muscles as Hermite volumes of their own, with fibres along ξ1."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from modiolus.errors import InputError
from modiolus.hermite import HermiteMesh, assemble, gauss
from modiolus.hermite.basis import smooth_step

__all__ = ["KINDS", "Muscle", "MusclePoints"]

#: Greatest distance (mm) between points across a muscle, on average over an element: less than the
#: elements of a tissue are wide. Farther apart a broad muscle is a few ropes, that draw streaks.
ACROSS = 4.0

#: What a muscle can be: a ribbon, a broad sheet, or part of a sphincter.
KINDS = ("strap", "sheet", "ring")

Map = Callable[[np.ndarray], np.ndarray]


class MusclePoints(NamedTuple):
    """Integration points of a muscle."""

    points: np.ndarray
    """(q, 3) positions (mm)."""
    weights: np.ndarray
    """(q,) volumes for which they stand (mm³)."""
    directions: np.ndarray
    """(q, 3) unit fibre directions."""
    elements: np.ndarray
    """(q,) elements of the muscle's mesh."""
    xi: np.ndarray
    """(q, 3) local coordinates in them."""


@dataclass(frozen=True, eq=False)
class Muscle:
    """A muscle of one side.

    Parameters
    ----------
    name : str
        Anatomical name without side, in snake_case.
    mesh : HermiteMesh
        Volume mesh with eight parameters a node. ξ1 runs along the fibres from origin (0) to
        insertion (1), in rings along the ring; ξ2 across the width; ξ3 from the deep (0) to the
        superficial face (1).
    kind : {'strap', 'sheet', 'ring'}
        What it is.
    angles : (n_nodes, 3) array, optional
        Euler angles (radians) by which the fibres leave ξ1: fibre, imbrication and sheet angle
        at the nodes, interpolated linearly in each direction. Without them the fibres run
        along ξ1.
    slack : float
        Stretch at which the passive fibres become taut.
    glide : float
        Share of the length, from the origin, over which it glides in the tissue, see `pulls`; a
        muscle with 0 moves with the tissue throughout.
    loose : float
        Share of the length, from the origin, over which one that glides is bound to the tissue
        there, too, and to no bone.
    fading : float
        Share of the length, from the origin, from which on fewer and fewer fibres go on, see
        `faded`; a muscle with 1 is even throughout.

    Raises
    ------
    InputError
        The kind is none of the three, or an array has another shape.

    Notes
    -----
    The frame at a point is f = dx/dξ1, s = dx/dξ2 made orthogonal to f, and n = f × s, all of
    unit length. The angles turn it about n by the fibre angle, then about the new s by the
    imbrication angle, then about the new f by the sheet angle.
    """

    name: str
    mesh: HermiteMesh
    kind: str
    angles: np.ndarray | None = None
    slack: float = 1.0
    glide: float = 0.0
    loose: float = 0.0
    fading: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"{self.name}: kind {self.kind!r}; choose from {', '.join(KINDS)}")
        if self.mesh.dim != 3 or self.mesh.n_params % 8:
            raise InputError(f"{self.name}: not a volume mesh with eight parameters a node")
        if self.angles is not None and self.angles.shape != (self.mesh.n_params // 8, 3):
            raise InputError(
                f"{self.name}: angles of shape {self.angles.shape}; give three for each of the "
                f"{self.mesh.n_params // 8} nodes"
            )
        if not 0.0 <= self.glide < 1.0:
            raise InputError(
                f"{self.name}: glide {self.glide}; give a share of the length, below 1"
            )
        if not 0.0 <= self.loose <= self.glide:
            raise InputError(
                f"{self.name}: loose {self.loose}; give a share of the length that glides"
            )
        if not 0.0 <= self.fading <= 1.0:
            raise InputError(f"{self.name}: fading {self.fading}; give a share of the length")

    @property
    def corners(self) -> np.ndarray:
        """(n_elements, 8) nodes of the elements."""
        values = self.mesh.extraction[::8].indices.reshape(-1, 8) // 8
        return np.asarray(values, dtype=np.int64)

    @property
    def volume(self) -> float:
        """Volume (mm³)."""
        return float(self.mesh.measures().sum())

    def frame(self, elements: np.ndarray, xi: np.ndarray) -> np.ndarray:
        """Return the unit fibre, sheet and normal direction at points, (n, 3, 3) by rows.

        Parameters
        ----------
        elements : (n,) int array
            Elements of the muscle's mesh.
        xi : (n, 3) array
            Local coordinates in them.
        """
        tangents = self.mesh.jacobian(elements, xi)
        f = tangents[:, :, 0] / np.linalg.norm(tangents[:, :, 0], axis=1, keepdims=True)
        s = tangents[:, :, 1] - f * (tangents[:, :, 1] * f).sum(axis=1, keepdims=True)
        s = s / np.linalg.norm(s, axis=1, keepdims=True)
        n = np.cross(f, s)
        if self.angles is not None:
            weights = np.ones((len(xi), 8))
            for corner in range(8):
                for k in range(3):
                    weights[:, corner] *= xi[:, k] if corner >> k & 1 else 1.0 - xi[:, k]
            turns = np.einsum("nc,nck->nk", weights, self.angles[self.corners[elements]])
            f, s = _turned(f, s, turns[:, 0])
            n, f = _turned(n, f, turns[:, 1])
            s, n = _turned(s, n, turns[:, 2])
        return np.stack([f, s, n], axis=1)

    def directions(self, elements: np.ndarray, xi: np.ndarray) -> np.ndarray:
        """Return the unit fibre direction at points, (n, 3): see `frame`."""
        return self.frame(elements, xi)[:, 0]

    def bounds(self) -> np.ndarray:
        """Return the (2, 3) lowest and highest corner of a box around the muscle (mm)."""
        ticks = np.linspace(0.0, 1.0, 5)
        xi = np.stack(np.meshgrid(ticks, ticks, ticks), axis=-1).reshape(-1, 3)
        elements = np.repeat(np.arange(self.mesh.n_elements), len(xi))
        points = self.mesh.evaluate(elements, np.tile(xi, (self.mesh.n_elements, 1)))
        # Between the samples the surface bulges a little further.
        return np.stack([points.min(axis=0) - 0.5, points.max(axis=0) + 0.5])

    def quadrature(self, counts: tuple[int, int, int] = (4, 2, 2)) -> MusclePoints:
        """Return Gauss points of the muscle's volume.

        Parameters
        ----------
        counts : three int
            Points an element along, across and through the muscle.
        """
        rules = [gauss(1, count) for count in counts]
        xi = np.stack(
            [g.ravel(order="F") for g in np.meshgrid(*(r[0][:, 0] for r in rules), indexing="ij")],
            axis=1,
        )
        cell = np.einsum("i,j,k->kji", *(r[1] for r in rules)).ravel()
        elements = np.repeat(np.arange(self.mesh.n_elements), len(xi))
        xi = np.tile(xi, (self.mesh.n_elements, 1))
        volumes = np.linalg.det(self.mesh.jacobian(elements, xi))
        return MusclePoints(
            self.mesh.evaluate(elements, xi),
            np.tile(cell, self.mesh.n_elements) * volumes,
            self.directions(elements, xi),
            elements,
            xi,
        )

    def fibre_points(self, fineness: int = 1) -> MusclePoints:
        """Return the points at which the stress of its fibres is integrated.

        Parameters
        ----------
        fineness : int
            How many times as many along and across as in a head that has not been refined.
        """
        return self.faded(self.quadrature((4 * fineness, self.across(fineness), 2)))

    def faded(self, rule: MusclePoints) -> MusclePoints:
        """Return points whose volumes fade towards the insertion and both sides; their sum stays.

        They do beyond `fading`, where that is within the muscle.
        """
        if self.fading == 1.0:
            return rule
        row = self.rows()[0]
        across = (row[rule.elements] + rule.xi[:, 1]) / (row.max() + 1)
        late = (self.along(rule)[0] - self.fading) / (1.0 - self.fading)
        share = np.sin(np.pi * across) ** 2 * smooth_step(1.0 - late)
        weights = rule.weights * share
        return rule._replace(weights=weights * (rule.weights.sum() / weights.sum()))

    def across(self, fineness: int = 1) -> int:
        """Return how many Gauss points an element has across: two, or more if it is broad.

        Parameters
        ----------
        fineness : int
            How many times as close together as `ACROSS` they are.
        """
        xi, weights = gauss(3, 2)
        elements = np.repeat(np.arange(self.mesh.n_elements), len(xi))
        tangents = self.mesh.jacobian(elements, np.tile(xi, (self.mesh.n_elements, 1)))
        widths = np.linalg.norm(tangents[:, :, 1], axis=1).reshape(-1, len(xi)) @ weights
        return max(2, int(np.ceil(fineness * widths.max() / ACROSS)))

    def end(self, side: int, n: int = 3) -> tuple[np.ndarray, np.ndarray]:
        """Return points spread over the origin (side 0) or the insertion (side 1).

        Parameters
        ----------
        side : {0, 1}
            Which end.
        n : int
            Gauss points a direction in every element of the end.

        Returns
        -------
        points : (q, 3) array
            Positions (mm).
        areas : (q,) array
            Areas for which they stand (mm²).
        """
        face = self.mesh.face(self._end_elements(side), 0, side)
        rule = face.quadrature(n)
        return face.evaluate(rule.elements, rule.xi), rule.weights

    def insertion(self) -> np.ndarray:
        """Return the middle of the insertion, (3,) (mm)."""
        points, areas = self.end(1)
        return np.asarray(areas @ points / areas.sum())

    def end_points(
        self, share: float, insertion: bool = False, fineness: int = 1
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return integration points of the part next to the origin, or to the insertion.

        Parameters
        ----------
        share : float
            Which part of the muscle, in terms of its length along the fibres.
        insertion : bool
            Of the other end.
        fineness : int
            See `fibre_points`.

        Returns
        -------
        points : (q, 3) array
            Positions (mm).
        volumes : (q,) array
            Volumes for which they stand (mm³).
        """
        rule = self.quadrature((8 * fineness, self.across(fineness), 1))
        along, _ = self.along(rule)
        near = along > 1.0 - share if insertion else along < share
        return rule.points[near], rule.weights[near]

    def pulls(self, rule: MusclePoints, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tell on which fibre the points of a muscle that glides lie, and how they stretch it.

        Its fibres are at their bone where they begin, whatever the tissue does, or, where that end
        is `loose`, go along with the tissue there; and they go along with the tissue to which they
        are bound beyond the share `glide` of the length: with the mean of its displacement, by
        volume.

        Parameters
        ----------
        rule : MusclePoints
        held : (q,) bool array
            Which points the tissue holds.

        Returns
        -------
        fibres : (q,) int array
            Number of the fibre of each point, from 0 up.
        pulls : (q,) array
            Stretch of the whole fibre for each mm by which the tissue at the point moves along it
            (1/mm); 0 on a fibre that no tissue holds.
        """
        along, length = self.along(rule)
        lines = np.column_stack([self.rows()[0][rule.elements], np.round(rule.xi[:, 1:], 9)])
        fibres = np.unique(lines, axis=0, return_inverse=True)[1].ravel()
        far = self._shared(fibres, np.where(held & (along > self.glide), rule.weights, 0.0))
        near = self._shared(fibres, np.where(held & (along < self.loose), rule.weights, 0.0))
        # How far apart the means of the bound points are; those of bone are at the origin.
        reach = np.bincount(fibres, (far - near) * along)[fibres] * length
        sound = np.bincount(fibres, far)[fibres] > 0.0
        return fibres, np.divide(far - near, reach, out=np.zeros_like(far), where=sound)

    @staticmethod
    def _shared(fibres: np.ndarray, volumes: np.ndarray) -> np.ndarray:
        """Return the shares of points in the volume of their fibre, 0 where it has none."""
        total = np.bincount(fibres, volumes)[fibres]
        return np.asarray(np.divide(volumes, total, out=np.zeros_like(volumes), where=total > 0.0))

    def along(self, rule: MusclePoints) -> tuple[np.ndarray, np.ndarray]:
        """Return the share of the length before points, and the length (mm), both (q,)."""
        lengths = self._row_lengths()
        row, place = self.rows()
        before = (np.cumsum(lengths, axis=1) - lengths)[row, place][rule.elements]
        total = lengths.sum(axis=1)[row[rule.elements]]
        along = before + rule.xi[:, 0] * lengths[row, place][rule.elements]
        return along / total, total

    def span(self, moved: Map | None = None) -> float:
        """Distance from the middle of the origin to the middle of the insertion (mm).

        Parameters
        ----------
        moved : callable, optional
            Where points (q, 3) have gone; the ratio of the span with and without it is the
            end-to-end shortening.
        """
        middle = []
        for side in (0, 1):
            points, areas = self.end(side)
            points = points if moved is None else moved(points)
            middle.append(areas @ points / areas.sum())
        return float(np.linalg.norm(middle[1] - middle[0]))

    def length(self) -> float:
        """Mean length along ξ1 from end to end, in a closed ring all round (mm)."""
        return float(self._row_lengths().sum(axis=1).mean())

    @property
    def _is_closed(self) -> bool:
        fronts, backs = (set(map(tuple, self.corners[:, k::2].tolist())) for k in (0, 1))
        return fronts == backs

    def _end_elements(self, side: int) -> np.ndarray:
        if self._is_closed:
            raise InputError(f"{self.name}: a closed ring has no ends; ask for no end of it")
        place = self.rows()[1]
        return np.flatnonzero(place == (place.max() if side else 0))

    def rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Tell in which row of elements along ξ1 every element lies.

        Returns
        -------
        row, place : (n_elements,) int arrays
            The row, and the place in it from the origin.
        """
        corners = self.corners
        ahead = {tuple(front): i for i, front in enumerate(corners[:, ::2].tolist())}
        following = [ahead.get(tuple(back), -1) for back in corners[:, 1::2].tolist()]
        row, place = np.full(len(corners), -1), np.zeros(len(corners), dtype=np.int64)
        starts = sorted(set(range(len(corners))) - set(following)) or list(range(len(corners)))
        number = 0
        for start in starts:
            if row[start] >= 0:
                continue
            here, count = start, 0
            while here >= 0 and row[here] < 0:
                row[here], place[here] = number, count
                here, count = following[here], count + 1
            number += 1
        return row, place

    def _row_lengths(self) -> np.ndarray:
        """Return the mean length along ξ1 of the elements, by row and place."""
        xi, weights = gauss(3, 4)
        elements = np.repeat(np.arange(self.mesh.n_elements), len(xi))
        tangents = self.mesh.jacobian(elements, np.tile(xi, (self.mesh.n_elements, 1)))
        lengths = np.linalg.norm(tangents[:, :, 0], axis=1).reshape(-1, len(xi)) @ weights
        row, place = self.rows()
        table = np.zeros((row.max() + 1, place.max() + 1))
        table[row, place] = lengths
        return table

    def transformed(self, mapping: Map) -> Muscle:
        """Move the muscle by a smooth map, nodal values and derivatives alike.

        Parameters
        ----------
        mapping : callable
            Takes positions (n, 3) to new ones (n, 3), smoothly.

        Returns
        -------
        Muscle
            Its nodal derivatives are those of the map composed with the old mesh, found by
            central differences.
        """
        nodes = self.mesh.parameters.reshape(-1, 8, 3)
        step = 1e-2
        bits = (np.arange(8)[:, None] >> np.arange(3)) & 1
        around = np.stack(np.meshgrid(*[step * np.arange(-1.0, 2.0)] * 3, indexing="ij"), axis=-1)
        powers = np.prod(around[..., None, :] ** bits, axis=-1)
        points = np.einsum("abck,nkd->abcnd", powers, nodes)
        moved = np.asarray(mapping(points.reshape(-1, 3)), dtype=float).reshape(points.shape)
        parameters = np.empty_like(nodes)
        for kind in range(8):
            axes = [k for k in range(3) if bits[kind, k]]
            total = np.zeros((len(nodes), 3))
            for signs in np.ndindex(*[2] * len(axes)):
                at = [1, 1, 1]
                for k, sign in zip(axes, signs, strict=True):
                    at[k] = 2 * sign
                total += (-1.0) ** (len(axes) - sum(signs)) * moved[at[0], at[1], at[2]]
            parameters[:, kind] = total / (2.0 * step) ** len(axes)
        return replace(self, mesh=self.mesh.with_parameters(parameters.reshape(-1, 3)))

    def mirrored(self, x: float) -> Muscle:
        """Return the muscle of the other side, mirrored in the plane of constant `x`.

        Its ξ2 runs the other way, so that volumes stay positive.
        """
        nodes = self.mesh.parameters.reshape(-1, 8, 3).copy()
        nodes[:, :, 0] *= -1.0
        nodes[:, 0, 0] += 2.0 * x
        nodes[:, [k for k in range(8) if k & 2]] *= -1.0
        corners = self.corners[:, [c ^ 2 for c in range(8)]]
        angles = None if self.angles is None else self.angles * [-1.0, 1.0, -1.0]
        return replace(self, mesh=assemble(corners, nodes), angles=angles)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the muscle as plain arrays: see `from_arrays`."""
        arrays = {
            "parameters": self.mesh.parameters,
            "corners": self.corners,
            "kind": np.array(KINDS.index(self.kind)),
            "slack": np.array(self.slack),
            "glide": np.array(self.glide),
            "loose": np.array(self.loose),
            "fading": np.array(self.fading),
        }
        if self.angles is not None:
            arrays["angles"] = self.angles
        return arrays

    @classmethod
    def from_arrays(cls, name: str, arrays: Mapping[str, np.ndarray]) -> Muscle:
        """Make the muscle from what `arrays` returned.

        Raises
        ------
        InputError
            An array is missing or does not fit the others.
        """
        try:
            corners = np.asarray(arrays["corners"], dtype=np.int64)
            nodes = np.asarray(arrays["parameters"], dtype=np.float64).reshape(-1, 8, 3)
            kind, slack = KINDS[int(arrays["kind"])], float(arrays["slack"])
            glide, loose = (float(arrays.get(key, 0.0)) for key in ("glide", "loose"))
            fading = float(arrays.get("fading", 1.0))
            sound = corners.ndim == 2 and corners.shape[1] == 8 and np.isfinite(nodes).all()
            if not sound or corners.min() < 0 or corners.max() >= len(nodes):
                raise ValueError("parameters")
        except (KeyError, IndexError, TypeError, ValueError) as error:
            raise InputError(f"{name}: no sound muscle ({error}); build the head anew") from error
        angles = arrays.get("angles")
        angles = None if angles is None else np.asarray(angles, dtype=np.float64)
        return cls(name, assemble(corners, nodes), kind, angles, slack, glide, loose, fading)


def _turned(a: np.ndarray, b: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn two orthogonal unit vectors in their plane, `a` towards `b`."""
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return cosine * a + sine * b, cosine * b - sine * a
