"""One run: a state of a head, and the files and the record that it leaves."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from modiolus import __version__
from modiolus.cli.outputs import write_report
from modiolus.compiling import compiler
from modiolus.face.head import Head, lasting_name
from modiolus.face.refine import at_points
from modiolus.hermite.tessellate import tessellate
from modiolus.mechanics import State
from modiolus.mechanics.face import Face, FaceSettings
from modiolus.progress import Progress

# What draws and writes a state is imported when there is one.
if TYPE_CHECKING:
    from modiolus.export.scene import FaceScene

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
    source : str, optional
        Name or folder of the head, for those who read the state later; its name by default.
    settings : FaceSettings, optional
    """

    def __init__(
        self,
        head: Head,
        quiet: bool = False,
        source: str = "",
        settings: FaceSettings | None = None,
    ) -> None:
        self.head = head
        self.face = Face(head, settings)
        self.source = lasting_name(source) if source else head.name
        self.quiet = quiet

    @cached_property
    def scene(self) -> FaceScene:
        """What is drawn of the head."""
        from modiolus.export.scene import FaceScene

        return FaceScene(self.head)

    def solve(
        self,
        title: str,
        activations: Mapping[str, float],
        jaw_open: float = 0.0,
        start: State | None = None,
    ) -> State:
        """Follow the face to a load and show how far it is; see `modiolus.mechanics.face.Face`."""
        with Progress(f"solving {title}", quiet=self.quiet) as progress:
            return self.face.solve(activations, jaw_open, start, progress.update)

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
        from modiolus.export import write_glb
        from modiolus.scans.result import STATE_FILE, save_state
        from modiolus.view.face import draw_face

        rest, moved = self.head.tissue.parameters, state.parameters
        jaw = state.load.jaw
        heading = f"{title or name} · {self.head.name}"
        with Progress(f"drawing {name}", quiet=self.quiet) as progress:
            draw_face(self.scene, rest, moved, heading, folder / "face.png", jaw)
            progress.update(0.6, "model for animation")
            write_glb(
                folder / "face.glb",
                self.scene.shapes(rest),
                self.scene.targets({name: (moved, jaw)}),
                str(self.head.about.get("attribution", "")),
            )
            progress.update(0.8, "tissue")
            self._write_tissue(state, folder / "tissue.vtu")
            progress.update(1.0)
        save_state(
            folder / STATE_FILE,
            name,
            self.head,
            self.source,
            state.parameters,
            state.pressure,
            state.activations,
            jaw,
            settings=self.face.settings,
            offsets=state.load.offsets,
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
        problem = self.face.problem(state)
        return {
            "expression": name,
            "head": self.head.name,
            "converged": statistics.converged,
            "elements": problem.mesh.n_elements,
            "nodes": len(problem.mesh.corner_nodes()[1]),
            "unknowns": problem.n_unknowns,
            "steps": statistics.steps,
            "newton_iterations": statistics.newton_iterations,
            "factorisations": statistics.factorisations,
            "jumps": statistics.jumps,
            "wrong_pivots": statistics.wrong_pivots,
            "correction_mm": statistics.correction_mm,
            "solve_s": round(statistics.solve_s, 3),
            "compile_s": round(compiler.seconds, 3),
            "wall_s": 0.0,
            "J_min": statistics.J_min,
            "J_max": statistics.J_max,
            "volume_change": statistics.volume_change,
            "max_penetration_mm": statistics.max_penetration_mm,
            "doubts": list(statistics.doubts),
            "activations": state.activations,
            "settings": asdict(self.face.settings),
            "jaw_open": round(math.degrees(state.load.jaw), 6),
            "landmarks": self.landmarks(state),
            "files": {},
            "version": __version__,
        }

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
        from modiolus.export import write_vtu

        half = self.face.problem(state) is self.face.half
        head = self.head if half else self.head.whole
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
