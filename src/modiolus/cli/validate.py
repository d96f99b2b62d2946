"""``modiolus validate``: the table of expressions against measured faces."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from modiolus.cli.app import Json, Out, Quiet, app, examples, show
from modiolus.cli.compare import Landmarks, Unit, text_table
from modiolus.cli.identify import Further, expression_toml, identified, listed
from modiolus.cli.outputs import own_heads, whole_folder, write_report
from modiolus.errors import InputError, SolveError, unknown_name
from modiolus.files import folder_name
from modiolus.progress import Progress

if TYPE_CHECKING:
    from modiolus.face.head import Head
    from modiolus.scans.compare import Comparison
    from modiolus.scans.scan import Scan
    from modiolus.scans.skin import Skin

#: Root mean square errors that Wu et al. (2013) report, with activations set by hand (mm).
PAPER = {"smile-closed": 0.88, "smile-open": 0.93, "sad": 1.43, "terror": 1.40}
#: Ways to choose the activations.
WAYS = ("hand", "table2", "all")


@app.command(epilog=examples("modiolus validate scans/anna --activations hand --out out"))
def validate(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", help="Holds neutral.ply and a surface for every expression."
        ),
    ],
    activations: Annotated[
        str,
        typer.Option(
            "--activations",
            metavar="hand,table2,all",
            help="The shipped ones; identified for the muscles of Wu et al. (2013); for all.",
        ),
    ] = "hand,table2,all",
    expressions: Annotated[
        str,
        typer.Option("--expressions", metavar="NAME,…", help="Some of the surfaces only."),
    ] = "",
    landmarks: Landmarks = None,
    unit: Unit = "",
    head: Annotated[
        str,
        typer.Option(
            "--head",
            metavar="NAME|DIR",
            help="The person's own head; by default taro is morphed to the neutral surface.",
        ),
    ] = "",
    unknown: Further = "",
    posed: Annotated[
        bool,
        typer.Option("--posed", help="The scans are in one frame and the skull has not moved."),
    ] = False,
    out: Out = Path("out"),
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compute expressions that were measured, and their errors.

    Writes OUT/validate-<folder>/ with a picture and an expression file for every row,
    validate.html and report.json.
    """
    from modiolus.face.head import Head
    from modiolus.scans.scan import known_unit
    from modiolus.scans.unknown import unknowns

    known_unit(unit)
    ways, further = _ways(activations), listed(unknown)
    neutral, scans = _scans(folder, expressions)
    rows = [(name, way) for name in scans for way in ways if _applies(way, name)]
    if not rows:
        raise InputError(
            f"{folder}: none of {', '.join(scans)} is an expression of {' or '.join(ways)}; "
            "let activations of all muscles be found"
        )
    subject = folder_name("FOLDER", folder.resolve().name)
    target = out / f"validate-{subject}"
    chosen = Head.load(head or "taro")
    # What is not known is told before anything is computed.
    unknowns(chosen, None, (), further)
    with whole_folder(target, "report.json", sources=(folder, *own_heads(head))) as draft:
        from modiolus.face.landmarks import read_landmarks
        from modiolus.face.subject import Structures, build_subject
        from modiolus.scans.align import Alignment, align_to_neutral, register_scan
        from modiolus.scans.skin import Skin

        quality = None
        pairs = None if landmarks is None else read_landmarks(landmarks, chosen)
        if not head:
            with Progress("morphing the head", quiet=quiet) as progress:
                chosen, quality = build_subject(
                    chosen, Structures(neutral.surface), pairs, progress.update, subject
                )
            (draft / "head").mkdir()
            chosen.save(draft / "head")
        skin = Skin(chosen)
        pairs = None if landmarks is None else read_landmarks(landmarks, chosen)
        with Progress("aligning the scans", total=len(scans) + 1, quiet=quiet) as progress:
            pose = register_scan(neutral, skin, unit or None, pairs)
            alignments = dict.fromkeys(scans, Alignment(pose, float("nan"), {}))
            for count, (name, scan) in enumerate(scans.items(), 1):
                progress.update(count, name)
                if not posed:
                    alignments[name] = align_to_neutral(scan, neutral, skin, pose)
        table = _Table(chosen, skin, neutral.placed(pose), further, draft, target, quiet)
        for name, way in rows:
            table.add(name, scans[name].placed(alignments[name].pose), way)
        record: dict[str, Any] = {
            "head": chosen.name,
            "morph": quality,
            "paper_rms_mm": {name: PAPER.get(name) for name in scans},
            "table": table.rows,
            "alignments": {name: item.as_dict() for name, item in alignments.items()},
            "files": {
                "page": str(target / "validate.html"),
                "report": str(target / "report.json"),
            },
        }
        text = table.write_page(draft / "validate.html")
        write_report(draft, record)
    page = record["files"]["page"]
    show(record, f"{text}\n\nPage: {page}", as_json, quiet)
    failed = [row["expression"] for row in table.rows if row["rms_mm"] is None]
    if failed:
        raise SolveError(f"validate: {', '.join(failed)} did not converge; see {page}")


def _ways(text: str) -> list[str]:
    """Return the ways of `WAYS` to choose activations that were asked for."""
    ways = list(dict.fromkeys(listed(text)))
    for way in ways:
        if way not in WAYS:
            raise unknown_name("way", way, WAYS)
    if not ways:
        raise InputError(f"--activations: none given; choose from {', '.join(WAYS)}")
    return ways


def _scans(folder: Path, expressions: str) -> tuple[Scan, dict[str, Scan]]:
    """Read the neutral scan of a folder and those of expressions, the paper's first."""
    from modiolus.scans.scan import read_scan, scan_files

    files = scan_files(folder)
    if "neutral" not in files:
        raise InputError(f"{folder}: no neutral surface; put neutral.ply into it")
    neutral = read_scan(files.pop("neutral"))
    wanted = [name.replace("_", "-") for name in listed(expressions)]
    for name in wanted:
        if name not in files:
            raise unknown_name("expression", name, files)
    order = sorted(files, key=lambda name: [*PAPER, name].index(name))
    scans = {name: read_scan(files[name]) for name in order if not wanted or name in wanted}
    if not scans:
        raise InputError(f"{folder}: only the neutral surface; add one for every expression")
    return neutral, scans


def _applies(way: str, name: str) -> bool:
    """Tell whether there is such a way to choose the activations of an expression."""
    from modiolus.face.expression import expression_names
    from modiolus.scans.unknown import TABLE_2

    return way == "all" or name in (expression_names() if way == "hand" else TABLE_2)


class _Table:
    """The rows of the table, and the files that go with them."""

    def __init__(
        self,
        head: Head,
        skin: Skin,
        neutral: Scan,
        further: list[str],
        draft: Path,
        target: Path,
        quiet: bool,
    ) -> None:
        from modiolus.export.scene import FaceScene
        from modiolus.mechanics.face import Face

        self.head, self.skin, self.neutral, self.further = head, skin, neutral, further
        self.draft, self.target, self.quiet = draft, target, quiet
        self.face, self.scene = Face(head), FaceScene(head)
        self.rows: list[dict[str, Any]] = []
        self._pictures: list[tuple[str, Path]] = []

    def add(self, name: str, scan: Scan, way: str) -> None:
        """Compute one expression in one way."""
        began = time.perf_counter()
        title = f"{name}, {way}"
        try:
            with Progress(title, quiet=self.quiet) as progress:
                found, moved, jaw, extra = self._solve(name, scan, way, progress)
                error = found.distances.of(found.distances.error, found.distances.covered)
                progress.update(
                    1.0, f"{error.rms:.3f} mm, explained {found.distances.explained:.0%}"
                )
        except SolveError as error:
            self.rows.append(self._row(name, way, None, began) | {"fault": str(error)})
            return
        self.rows.append(self._row(name, way, found, began) | extra)
        from modiolus.view.compare import draw_comparison

        picture = self.draft / f"{name}-{way}.png"
        rest = self.head.tissue.parameters
        draw_comparison(self.scene, rest, moved, found, title, picture, jaw)
        self._pictures.append((title, picture))
        self.rows[-1]["picture"] = str(self.target / picture.name)

    def _solve(
        self, name: str, scan: Scan, way: str, progress: Progress
    ) -> tuple[Comparison, np.ndarray, float, dict[str, Any]]:
        """Return comparison, parameters, angle of the jaw, and further figures of a row."""
        from modiolus.face.expression import Expression, resolve
        from modiolus.face.jaw import opening
        from modiolus.scans.compare import compare
        from modiolus.scans.identify import identify
        from modiolus.scans.target import ScanTarget
        from modiolus.scans.unknown import TABLE_2, unknowns

        if way == "hand":
            expression = Expression.shipped(name)
            jaw = opening(expression.jaw_open)
            values = resolve(expression.activations, self.head.muscles)
            state = self.face.solve(values, jaw, report=progress.update)
            found = compare(self.skin, state.parameters, scan, self.neutral)
            return found, state.parameters, jaw, {"values": values}
        known = [name] if name in TABLE_2 else []
        free = unknowns(self.head, known if way == "table2" else None, known, self.further)
        target = ScanTarget(self.skin, scan, self.neutral)
        # All from rest: the muscles of the paper alone may have come to where there is no way on.
        result = identify(self.face, target, free, report=progress.update)
        placed = scan.placed(result.pose)
        found = compare(self.skin, result.state.parameters, placed, self.neutral)
        text = expression_toml(f"{name}-{way}", scan.name, result)
        (self.draft / f"{name}-{way}.toml").write_text(text, encoding="utf-8")
        facts = identified(result)
        shift = result.pose.apply(scan.points) - scan.points
        facts["pose_shift_mm"] = round(float(np.sqrt((shift**2).sum(axis=1).mean())), 3)
        jaw = result.state.load.jaw
        return found, result.state.parameters, jaw, {"values": facts.pop("activations"), **facts}

    def _row(self, name: str, way: str, found: Comparison | None, began: float) -> dict[str, Any]:
        seconds = round(time.perf_counter() - began, 1)
        row: dict[str, Any] = {"expression": name, "activations": way}
        keys = ("rms_mm", "moved_rms_mm", "still_rms_mm", "explained", "p95_mm", "max_mm")
        if found is None:
            return row | dict.fromkeys(keys) | {"seconds": seconds}
        facts = found.as_dict()
        return row | {
            **_figures(facts),
            "p95_mm": facts["error"]["p95_mm"],
            "max_mm": facts["error"]["max_mm"],
            "seconds": seconds,
            "shape_rms_mm": facts["rest"]["rms_mm"],
            "reverse_rms_mm": facts["reverse"]["rms_mm"],
            "coverage": facts["coverage"],
            "regions": {
                region: values["error"]["rms_mm"] for region, values in facts["regions"].items()
            },
            "matched": None if facts["matched"] is None else _figures(facts["matched"]),
        }

    def write_page(self, path: Path) -> str:
        """Write the page with all pictures, and return the table as text."""
        from modiolus.view.compare import write_page

        headings = (
            *("expression", "activations", "rms", "paper", "moved", "not moving", "explained"),
            *("95 %", "max", "matched rms", "not moving", "explained", "seconds"),
        )
        lines: list[list[object]] = []
        for row in self.rows:
            matched = row.get("matched") or {}
            lines.append(
                [
                    *(row["expression"], row["activations"], row["rms_mm"]),
                    *(PAPER.get(row["expression"]), row["moved_rms_mm"], row["still_rms_mm"]),
                    *(row["explained"], row["p95_mm"], row["max_mm"], matched.get("rms_mm")),
                    *(matched.get("still_rms_mm"), matched.get("explained"), row["seconds"]),
                ]
            )
        notes = [
            "Distances in mm from the points of the scan to the skin, weighted by area, over the "
            "face that the model covers; 'moved' is where the scan is more than 1 mm from the "
            "neutral one. 'Not moving' is the same for the model at rest. 'Explained' is 1 - rms "
            "error / rms of not moving, both over the moved region.",
            "'Matched' compares the displacements of the same points, where the scans are one "
            "mesh in several states; it also sees what slides along the surface.",
            "Paper: Wu et al. 2013, activations set by hand.",
        ]
        title = f"{self.head.name}: computed against measured expressions"
        write_page(path, title, notes, [("Table", headings, lines)], self._pictures)
        return text_table(headings, lines)


def _figures(facts: Mapping[str, Any]) -> dict[str, float | None]:
    """Return what the table tells of one way to measure the distance."""
    return {
        "rms_mm": facts["error"]["rms_mm"],
        "moved_rms_mm": facts["moved"]["rms_mm"],
        "still_rms_mm": facts["still"]["rms_mm"],
        "still_moved_rms_mm": facts["still_moved"]["rms_mm"],
        "explained": facts["explained"],
    }
