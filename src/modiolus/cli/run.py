"""One run: a state of a head, and the files and the record that it leaves."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from modiolus.cli.outputs import write_report
from modiolus.errors import InputError
from modiolus.export import write_glb, write_vtu
from modiolus.export.scene import FaceScene
from modiolus.face.head import Head
from modiolus.face.refine import at_points
from modiolus.hermite.tessellate import tessellate
from modiolus.mechanics import Continuation, Problem, State
from modiolus.mechanics.face import face_load, face_problem
from modiolus.progress import Progress
from modiolus.scans.result import STATE_FILE, Result, save_state
from modiolus.view.face import draw_face

__all__ = ["Runner"]


#: Divisions of an element in the files for display.
_VTU_DIVISIONS = 4


class Runner:
    """Solves states of one head, and keeps what they have in common.

    Parameters
    ----------
    head : Head
    quiet : bool
        No progress.
    source : str
        Name or folder of the head, for those who read the state later.
    """

    def __init__(self, head: Head, quiet: bool = False, source: str = "") -> None:
        self.head = head
        self.source = str(Path(source).resolve()) if Path(source, "head.toml").is_file() else source
        self.quiet = quiet

    @cached_property
    def scene(self) -> FaceScene:
        """What is drawn of the head."""
        return FaceScene(self.head)

    @cached_property
    def problem(self) -> Problem:
        """The problem of the half face."""
        return face_problem(self.head)

    @cached_property
    def whole_problem(self) -> Problem:
        """The problem of both sides."""
        return face_problem(self.head.whole)

    def solve(
        self,
        name: str,
        activations: Mapping[str, float],
        jaw_open: float = 0.0,
        start: Result | None = None,
    ) -> State:
        """Follow the face to a load; on both sides where the muscles' names have one.

        Parameters
        ----------
        name : str
            Of the expression.
        activations : mapping of str to float
            0..1 by muscle, as `modiolus.face.expression.resolve` returns them.
        jaw_open : float
            Angle in radians.
        start : Result, optional
            A state of this head to begin at; rest by default. From one with both sides the way
            stays on both.

        Raises
        ------
        InputError
            `start` does not fit the head.
        LoadNotReached
            The computation stopped on the way.
        """
        half = set(self.head.muscles)
        one = set(activations) <= half
        if start is not None and len(start.parameters) != self.head.tissue.n_params:
            if one:
                activations = _on_both(activations)
            one = False
        problem = self.problem if one else self.whole_problem
        head = self.head if one else self.head.whole
        load = face_load(problem, head, activations, jaw_open)
        state = None if start is None else self._begin(start, problem, head)
        with Progress(f"solving {name}", quiet=self.quiet) as progress:
            return Continuation(problem, state, report=progress.update).run(load)

    def _begin(self, start: Result, problem: Problem, head: Head) -> State:
        """Return an earlier state as one of a problem of this head, half or whole."""
        rest, parameters, pressure = problem.rest(), start.parameters, start.pressure
        activations = start.activations
        if len(parameters) != problem.mesh.n_params:
            parameters = self.head.both.whole(parameters)
            corners = self.head.tissue.corner_nodes()[0]
            # The image of a corner lies at the other end of xi1.
            corners = np.vstack([corners, corners[:, np.arange(8) ^ 1]])
            if len(pressure) == corners.max() + 1:
                both = np.empty(len(rest.pressure))
                both[rest.vertices] = pressure[corners]
                pressure = both
            activations = _on_both(activations)
        if len(pressure) != len(rest.pressure):
            raise InputError("--from: the pressures of the state do not fit; simulate it anew")
        load = face_load(problem, head, activations, start.jaw)
        return replace(rest, parameters=parameters, pressure=pressure, load=load)

    def write(
        self, name: str, title: str, state: State, folder: Path, target: Path, began: float
    ) -> dict[str, Any]:
        """Write the files of a run and return its record.

        Parameters
        ----------
        name, title : str
            Of the expression.
        state : State
        folder : Path
            Where to write.
        target : Path
            Where the files will be found in the end.
        began : float
            `time.perf_counter` at the start of the run.
        """
        rest, moved = self.head.tissue.parameters, state.parameters
        jaw = state.load.jaw
        heading = f"{title or name} · {self.head.name}"
        draw_face(self.scene, rest, moved, heading, folder / "face.png", jaw)
        write_glb(
            folder / "face.glb",
            self.scene.shapes(rest),
            self.scene.targets({name: (moved, jaw)}),
            str(self.head.about.get("attribution", "")),
        )
        self._write_tissue(state, folder / "tissue.vtu")
        save_state(
            folder / STATE_FILE,
            name,
            self.head,
            self.source or self.head.name,
            state.parameters,
            state.pressure,
            state.activations,
            jaw,
        )
        names = {
            "picture": "face.png",
            "model": "face.glb",
            "tissue": "tissue.vtu",
            "state": STATE_FILE,
            "report": "report.json",
        }
        record = self.record(name, state)
        record["wall_s"] = round(time.perf_counter() - began, 3)
        record["files"] = {kind: str(target / file) for kind, file in names.items()}
        write_report(folder, record)
        return record

    def record(self, name: str, state: State) -> dict[str, Any]:
        """Return the figures of a state."""
        statistics = state.statistics
        problem = self.problem if self._on_half(state) else self.whole_problem
        return {
            "expression": name,
            "head": self.head.name,
            "converged": statistics.converged,
            "elements": problem.mesh.n_elements,
            "nodes": len(problem.mesh.corner_nodes()[1]),
            "unknowns": problem.n_unknowns,
            "steps": statistics.steps,
            "newton_iterations": statistics.newton_iterations,
            "solve_s": round(statistics.solve_s, 3),
            "wall_s": 0.0,
            "J_min": statistics.J_min,
            "J_max": statistics.J_max,
            "volume_change": statistics.volume_change,
            "max_penetration_mm": statistics.max_penetration_mm,
            "activations": state.activations,
            "jaw_open": round(math.degrees(state.load.jaw), 6),
            "landmarks": self.landmarks(state),
            "files": {},
        }

    def _on_half(self, state: State) -> bool:
        return len(state.parameters) == self.head.tissue.n_params

    def landmarks(self, state: State) -> dict[str, dict[str, list[float]]]:
        """Return rest and displacement in mm of the landmarks of both halves."""
        rest, moved = self.head.landmark_points(), self.head.landmark_points(state.parameters)
        return {
            name: {
                "rest": np.round(point, 4).tolist(),
                "displacement": np.round(moved[name] - point, 4).tolist(),
            }
            for name, point in rest.items()
        }

    def _write_tissue(self, state: State, path: Path) -> None:
        head = self.head if self._on_half(state) else self.head.whole
        volume = tessellate(head.tissue, _VTU_DIVISIONS)
        at = volume.elements, volume.xi
        gradient = state.deformation_gradient(*at)
        stretch = np.asarray(np.linalg.svd(gradient, compute_uv=False)[:, 0], dtype=float)
        rest = volume.points(state.reference.parameters)
        write_vtu(
            path,
            rest,
            volume.cells,
            {
                "displacement": volume.points(state.parameters) - rest,
                "J": volume.average(state.volume_ratio(*at)),
                "stretch": volume.average(stretch),
                "muscle_fraction": volume.average(at_points(head.fraction, *at)),
                "pressure": volume.average(state.pressure_at(*at)),
            },
        )


def _on_both(activations: Mapping[str, float]) -> dict[str, float]:
    return {f"{name}_{side}": a for name, a in activations.items() for side in ("left", "right")}
