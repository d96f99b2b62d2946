"""How much of a result the mesh, the quadrature, the penalties and the steps decide."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..errors import SolveError
from ..face.head import Head
from ..face.refine import child_points, parent_points, refined
from ..progress import Report
from .contact import face_points
from .continuation import Continuation, Settings
from .face import FaceSettings, face_load, face_problem
from .laws import Array
from .problem import Problem, State
from .terms import Load

__all__ = [
    "DISCRETISATION",
    "Study",
    "Variant",
    "discretisation_error",
    "inherited",
    "variants",
]

#: Kinds of variants that belong to the discretisation; the others change the model.
DISCRETISATION = ("mesh", "layers", "quadrature", "step")


@dataclass(frozen=True)
class Variant:
    """One row of the table.

    Attributes
    ----------
    kind, name : str
    counts : tuple of 3 int
        Parts of every element.
    face : FaceSettings
    path : Settings
    """

    kind: str
    name: str
    counts: tuple[int, int, int] = (1, 1, 1)
    face: FaceSettings = field(default_factory=FaceSettings)
    path: Settings = field(default_factory=Settings)

    @property
    def effort(self) -> float:
        """Roughly how many times as long it takes to solve as on the default mesh."""
        return math.pow(math.prod(self.counts), 1.5)


def variants(finest: int = 1) -> Iterator[Variant]:
    """Yield the default and everything it is compared with, one change at a time.

    Parameters
    ----------
    finest : int
        How often the mesh is refined along the face; with 0 it is not, nor through its thickness.
    """
    yield Variant("default", "default")
    face, path = FaceSettings(), Settings()
    yield Variant("step", "first step halved", path=replace(path, first_step=path.first_step / 2))
    order = face.gauss_order + 1
    yield Variant("quadrature", f"{order} Gauss points", face=replace(face, gauss_order=order))
    for kappa in (face.kappa / 2, face.kappa * 2):
        yield Variant("kappa", f"kappa {kappa:g} kPa", face=replace(face, kappa=kappa))
    for contact in (face.contact / 2, face.contact * 2):
        yield Variant("contact", f"contact {contact:g} kPa/mm", face=replace(face, contact=contact))
    if finest:
        yield Variant("layers", "two layers", (1, 1, 2))
    for parts in (2**times for times in range(1, finest + 1)):
        yield Variant("mesh", f"refined {parts} x {parts}", (parts, parts, 1))


def discretisation_error(rows: list[dict[str, Any]]) -> float | None:
    """Return the error of the discretisation over the skin in mm, root mean square.

    The sum of what refining each part of the discretisation changes at most: what they change
    together where the changes add up. None where a part could not be refined, as not one of its
    rows has converged.
    """
    total = 0.0
    for kind in DISCRETISATION:
        part = [row["rms_change_mm"] for row in rows if row["kind"] == kind]
        changes = [change for change in part if change is not None]
        if part and not changes:
            return None
        total += max(changes, default=0.0)
    return total


def inherited(problem: Problem, known: State, counts: tuple[int, int, int]) -> State:
    """Return a state on the mesh whose elements have been split into ``counts`` parts.

    The children take over the parents' field exactly, and their pressure.

    Parameters
    ----------
    problem : Problem
        Of the refined mesh.
    known : State
        Of the mesh before.
    counts : tuple of 3 int
    """
    rest = problem.rest()
    corners = np.array([[(c >> k) & 1 for k in range(3)] for c in range(8)], dtype=float)
    children = np.repeat(np.arange(problem.mesh.n_elements), 8)
    at = np.tile(corners, (problem.mesh.n_elements, 1))
    pressure = np.empty(len(rest.pressure))
    pressure[rest.vertices.ravel()] = known.pressure_at(*parent_points(children, at, counts))
    return replace(
        rest,
        parameters=known.mesh.refine(counts).parameters,
        pressure=pressure,
        load=replace(known.load, offsets={}),
    )


class Study:
    """One expression of a head under several settings.

    Parameters
    ----------
    head : Head
        A half.
    activations : mapping of str to float
        As `modiolus.face.expression.resolve` returns them.
    jaw : float
        Angle in radians.
    """

    def __init__(self, head: Head, activations: Mapping[str, float], jaw: float) -> None:
        self.half = head
        self.activations = activations
        self.jaw = jaw
        self.both = not set(activations) <= set(head.muscles)
        self.points = face_points(head.tissue, *head.sides["outer"])
        self._default: tuple[State, Array, Array] | None = None

    def row(self, variant: Variant, report: Report | None = None) -> dict[str, Any]:
        """Solve a variant and compare it with the first one, the default.

        Parameters
        ----------
        variant : Variant
        report : callable, optional
            Told the share that is done and what goes on.
        """
        half = self.half if variant.counts == (1, 1, 1) else refined(self.half, variant.counts)
        head = half.whole if self.both else half
        problem = face_problem(head, variant.face)
        load = face_load(problem, head, self.activations, self.jaw)
        row: dict[str, Any] = {
            "kind": variant.kind,
            "name": variant.name,
            "elements": problem.mesh.n_elements,
            "unknowns": problem.n_unknowns,
            "converged": True,
        }
        try:
            state = self._solve(problem, load, variant, report)
        except SolveError as error:
            if self._default is None:
                raise
            empty = ("corner_mm", "corner_change_mm", "rms_change_mm", "max_change_mm", "solve_s")
            return {**row, "converged": False, **dict.fromkeys(empty), "why": str(error)}
        skin = self._skin(half, state, variant)
        landmarks = half.landmark_points(state.parameters)
        corner = landmarks["mouth_corner_left"] - self.half.landmark_points()["mouth_corner_left"]
        if self._default is None:
            self._default = state, skin, corner
        change = np.linalg.norm(skin - self._default[1], axis=1)
        weight = np.tile(self.points[2], len(change) // len(self.points[2]))
        return {
            **row,
            "corner_mm": float(np.linalg.norm(corner)),
            "corner_change_mm": float(np.linalg.norm(corner - self._default[2])),
            "rms_change_mm": float(np.sqrt((weight * change**2).sum() / weight.sum())),
            "max_change_mm": float(change.max()),
            "solve_s": round(state.statistics.solve_s, 2),
            "why": "",
        }

    def _solve(
        self, problem: Problem, load: Load, variant: Variant, report: Report | None
    ) -> State:
        """Solve from the default's state where that serves, otherwise from rest."""
        start = self._start(problem, load, variant)
        if start is not None:
            try:
                return Continuation(problem, start, settings=variant.path, report=report).run(load)
            except SolveError:
                pass
        return Continuation(problem, settings=variant.path, report=report).run(load)

    def _start(self, problem: Problem, load: Load, variant: Variant) -> State | None:
        refines = variant.counts != (1, 1, 1)
        if self._default is None or variant.kind == "step" or (refines and self.both):
            return None
        # With what presses contacts apart: without it the state is no equilibrium, and the way back
        # to one may end at another. Contact points of a refined mesh are others.
        offsets = self._default[0].load.offsets
        known = replace(self._default[0], load=replace(load, offsets=offsets))
        if refines:
            return inherited(problem, known, variant.counts)
        return replace(
            problem.rest(), parameters=known.parameters, pressure=known.pressure, load=known.load
        )

    def _skin(self, half: Head, state: State, variant: Variant) -> Array:
        """Return the place of the skin's points, those of the left half before the right's."""
        at = child_points(self.points[0], self.points[1], variant.counts)
        sides = half.halves(state.parameters) if self.both else (state.parameters,)
        return np.vstack([half.tissue.with_parameters(side).evaluate(*at) for side in sides])
