"""``modiolus identify``: activations from a scan, from markers, or from a sequence of either."""

from __future__ import annotations

import csv
import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from modiolus.cli.app import HeadName, Json, Out, Quiet, app, examples, show
from modiolus.cli.compare import (
    Landmarks,
    Unit,
    describe_alignment,
    describe_measures,
    text_table,
)
from modiolus.cli.outputs import whole_folder, write_report
from modiolus.errors import InputError, SolveError
from modiolus.files import folder_name
from modiolus.progress import Progress

if TYPE_CHECKING:
    from modiolus.face.head import Head
    from modiolus.fitting.register import Registration
    from modiolus.scans.align import Alignment
    from modiolus.scans.identify import Identification
    from modiolus.scans.scan import Scan
    from modiolus.scans.skin import Skin
    from modiolus.scans.target import Target

    Pairs = tuple[np.ndarray, np.ndarray] | None

Further = Annotated[
    str,
    typer.Option(
        "--unknown",
        metavar="NAME,…",
        help="What else is to be found: jaw (its opening), sigma_max, fat, passive, skin (how "
        "strong muscles are, how stiff fat, muscles and skin).",
    ),
]


@app.command(
    epilog=examples(
        "modiolus identify --head heads/anna --scan smile.ply --neutral neutral.ply",
        "modiolus identify --head heads/anna --markers take.csv --rate 120",
    )
)
def identify(
    scan: Annotated[
        Path | None,
        typer.Option(
            "--scan", metavar="FILE|DIR", help="The measured face, or a folder with one a frame."
        ),
    ] = None,
    markers: Annotated[
        Path | None,
        typer.Option(
            "--markers", metavar="CSV", help="Points of the face: time or frame, marker, x, y, z."
        ),
    ] = None,
    neutral: Annotated[
        Path | None,
        typer.Option(
            "--neutral",
            metavar="FILE",
            help="The same person at rest; of markers the first of several frames by default.",
        ),
    ] = None,
    muscles: Annotated[
        str,
        typer.Option(
            "--muscles",
            metavar="NAME,…",
            help="Those that may contract: muscles, or an expression of Wu et al. (2013), table 2.",
        ),
    ] = "all",
    prior: Annotated[
        str,
        typer.Option(
            "--prior", metavar="NAME,…", help="Those that are expected; the others cost more."
        ),
    ] = "",
    unknown: Further = "",
    sides: Annotated[
        bool, typer.Option("--sides", help="Let the muscles of both sides differ.")
    ] = False,
    rate: Annotated[
        float,
        typer.Option("--rate", metavar="HZ", help="Frames a second, where they have no time."),
    ] = 30.0,
    smooth: Annotated[
        float,
        typer.Option(
            "--smooth",
            metavar="SECONDS",
            help="Smooth a sequence: the time in which a muscle is thought to go from rest to "
            "where it shows; the longer, the smoother.",
        ),
    ] = 0.0,
    landmarks: Landmarks = None,
    unit: Unit = "",
    head: HeadName = "taro",
    out: Out = Path("out"),
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find the activations that explain a scan or markers.

    The head should be that of the person (see modiolus morph). Writes OUT/identify-<name>/ with
    <name>.toml, an expression for modiolus simulate, state.npz, pictures and report.json; of a
    sequence activations.csv, and a folder for each frame in frames/ for modiolus export.
    """
    began = time.perf_counter()
    from modiolus.face.head import Head, lasting_name
    from modiolus.face.landmarks import read_landmarks
    from modiolus.scans.scan import known_unit
    from modiolus.scans.unknown import unknowns

    known_unit(unit)
    chosen = Head.load(head)
    working = chosen.whole if sides else chosen
    free = None if muscles == "all" else listed(muscles)
    if free == []:
        raise InputError("--muscles: none given; name some, an expression, or all")
    wanted = unknowns(working, free, listed(prior), listed(unknown))
    pairs = None if landmarks is None else read_landmarks(landmarks, chosen)
    measured = _measured(scan, markers, neutral, rate, unit or None, pairs)
    single = measured.count == 1
    if not 0.0 <= smooth <= 1000.0:
        raise InputError(f"--smooth {smooth:g}: not within 0 to 1000 s; give a time in there")
    if single and smooth:
        raise InputError(f"--smooth: {measured.path.name} is a single frame; leave it out")
    target = out / f"identify-{measured.name}"
    source = lasting_name(head)
    with whole_folder(target, marker="report.json") as folder:
        from modiolus.mechanics.face import Face
        from modiolus.scans.identify import Identification
        from modiolus.scans.sequence import follow
        from modiolus.scans.skin import Skin

        rows: list[dict[str, Any]] = []
        last: tuple[_Frame, Identification] | None = None
        with Progress(f"identifying {measured.path.name}", quiet=quiet) as progress:
            skin = Skin(chosen)
            frames = follow(Face(chosen), measured.frames(skin), wanted, smooth, progress.update)
            for frame, found in frames:
                facts: dict[str, Any] = {"frame": frame.name, "time": frame.time}
                if not isinstance(found, Identification):
                    if single:
                        raise found
                    rows.append(facts | {"fault": str(found)})
                    continue
                last = frame, found
                place = folder if single else folder / "frames" / frame.name
                place.mkdir(parents=True, exist_ok=True)
                _write_frame(place, frame, measured.path.name, found, chosen, source, single)
                rows.append(facts | {"rms_mm": found.history[-1]} | identified(found))
        if last is None:
            raise SolveError(f"{measured.path}: no frame was met; the first: {rows[0]['fault']}")
        record: dict[str, Any] = {
            "head": chosen.name,
            "neutral": None if neutral is None else str(neutral),
            **measured.facts(),
        }
        if single:
            files, text = _write_single(folder, target, skin, measured, *last, record)
        else:
            files, text = _write_sequence(folder, target, rows, record)
        record["seconds"] = round(time.perf_counter() - began, 3)
        record["files"] = files | {"report": str(target / "report.json")}
        write_report(folder, record)
    show(record, text, as_json, quiet)


def _measured(
    scan: Path | None,
    markers: Path | None,
    neutral: Path | None,
    rate: float,
    unit: str | None,
    pairs: Pairs,
) -> _Scans | _Markers:
    """Read what was measured, of which there is one kind."""
    if not 0.0 < rate <= 10_000.0:
        raise InputError(f"--rate {rate:g}: not within 0 to 10000 Hz; give a number in there")
    if scan is not None and markers is None:
        return _Scans(scan, neutral, rate, unit, pairs)
    if markers is not None and scan is None:
        return _Markers(markers, neutral, rate, unit, pairs)
    raise InputError("--scan, --markers: give one of them, such as --scan smile.ply")


@dataclass(frozen=True)
class _Frame:
    """One frame of what was measured, which is only made ready to be matched when it comes."""

    name: str
    time: float
    target: Callable[[], Target]


class _Scans:
    """A scan, or those of a folder in the order of their names.

    `placed` is the latest that was matched, in the head's frame, and `at_rest` the neutral one.
    """

    def __init__(
        self, path: Path, neutral: Path | None, rate: float, unit: str | None, pairs: Pairs
    ) -> None:
        from modiolus.scans.scan import read_scan, scan_files

        self.path, self._rate, self._unit, self._pairs = path, rate, unit, pairs
        if path.is_dir():
            files = scan_files(path)
            own = None if neutral is None else neutral.resolve()
            self._files = {name: file for name, file in files.items() if file.resolve() != own}
            if not self._files:
                raise InputError(f"{path}: no scan in it; put in one for each frame")
        else:
            self._files = {path.stem: path}
        self._neutral = None if neutral is None else read_scan(neutral)
        # A scan that cannot be read is told before anything is computed.
        self._first = read_scan(next(iter(self._files.values())))
        self.name = folder_name(str(path), path.resolve().stem)
        self.count = len(self._files)
        self.placed: Scan | None = None
        self.at_rest: Scan | None = None
        self._pose: Registration | None = None
        self._alignment: Alignment | None = None

    def frames(self, skin: Skin) -> list[_Frame]:
        from modiolus.scans.align import register_scan

        if self._neutral is not None:
            self._pose = register_scan(self._neutral, skin, self._unit, self._pairs)
            self.at_rest = self._neutral.placed(self._pose)
        return [
            _Frame(
                folder_name(str(file), name), number / self._rate, partial(self._target, skin, file)
            )
            for number, (name, file) in enumerate(self._files.items())
        ]

    def _target(self, skin: Skin, file: Path) -> Target:
        from modiolus.scans.align import align_to_neutral, place
        from modiolus.scans.scan import read_scan
        from modiolus.scans.target import ScanTarget

        scan = self._first if self.count == 1 else read_scan(file)
        if self._neutral is None or self._pose is None:
            self.placed, _, self._alignment = place(scan, skin, None, self._unit, self._pairs)
        else:
            self._alignment = align_to_neutral(scan, self._neutral, skin, self._pose)
            self.placed = scan.placed(self._alignment.pose)
        return ScanTarget(skin, self.placed, self.at_rest)

    def facts(self) -> dict[str, Any]:
        if self.count > 1:
            return {"scans": str(self.path)}
        assert self._alignment is not None
        return {"scan": str(self.path), "alignment": self._alignment.as_dict()}


class _Markers:
    """Markers, of one frame or several."""

    placed: Scan | None = None
    at_rest: Scan | None = None

    def __init__(
        self, path: Path, neutral: Path | None, rate: float, unit: str | None, pairs: Pairs
    ) -> None:
        from modiolus.scans.markers import read_markers

        self.path, self._unit, self._pairs = path, unit, pairs
        self._frames = read_markers(path, rate)
        self.count = len(self._frames)
        self._rest = self._frames[0] if self.count > 1 else None
        if neutral is not None:
            self._rest = read_markers(neutral, rate)[0]
        self.name = folder_name(str(path), path.stem)
        self._facts: dict[str, Any] = {}

    def frames(self, skin: Skin) -> list[_Frame]:
        from modiolus.scans.markers import bind

        first = self._frames[0]
        marked = bind(skin, self._rest, first, self._pairs, self._unit, str(self.path))
        self._facts = {
            "markers": marked.names,
            "left_out": marked.left_out,
            "scale": round(marked.pose.scale, 6),
        }
        width = len(str(self.count))
        return [
            _Frame(
                self.name if self.count == 1 else f"{self.name}-{number:0{width}d}",
                frame.time,
                partial(marked.target, frame),
            )
            for number, frame in enumerate(self._frames, 1)
        ]

    def facts(self) -> dict[str, Any]:
        return self._facts


def _write_frame(
    folder: Path,
    frame: _Frame,
    source: str,
    found: Identification,
    head: Head,
    head_source: str,
    single: bool,
) -> None:
    """Write what was found of a frame: an expression, and the state."""
    from modiolus.mechanics.face import FaceSettings
    from modiolus.scans.result import STATE_FILE, save_state
    from modiolus.scans.unknown import FURTHER, JAW

    tissue: dict[str, Any] = {
        name: found.values[name] for name in FURTHER if name in found.values and name != JAW
    }
    (folder / f"{frame.name}.toml").write_text(
        expression_toml(frame.name, source, found), encoding="utf-8"
    )
    save_state(
        folder / STATE_FILE,
        frame.name,
        head,
        head_source,
        found.state.parameters,
        found.state.pressure,
        found.state.activations,
        found.state.load.jaw,
        None if single else frame.time,
        FaceSettings(**tissue),
        found.state.load.offsets,
    )


def _write_single(
    folder: Path,
    target: Path,
    skin: Skin,
    measured: _Scans | _Markers,
    frame: _Frame,
    found: Identification,
    record: dict[str, Any],
) -> tuple[dict[str, str], str]:
    """Write picture and page of one frame, and complete its record."""
    from modiolus.export.scene import FaceScene
    from modiolus.scans.compare import compare
    from modiolus.scans.result import STATE_FILE
    from modiolus.view.compare import MEASURE_HEADINGS, draw_comparison, measure_rows, write_page
    from modiolus.view.face import draw_face

    head, scene = skin.head, FaceScene(skin.head)
    rest, moved, jaw = head.tissue.parameters, found.state.parameters, found.state.load.jaw
    title = f"{frame.name} on {head.name}, activations identified"
    record |= identified(found)
    rows = activation_rows(record)
    tables: list[tuple[str, Sequence[str], list[list[object]]]] = [
        ("What was found", ACTIVATION_HEADINGS, rows)
    ]
    notes = [describe_certainty(record)]
    rms = found.history[-1]
    if measured.placed is None:
        draw_face(scene, rest, moved, title, folder / "face.png", jaw)
        picture = "face.png"
        record["rms_mm"] = round(rms, 4)
    else:
        result = compare(skin, moved, measured.placed.placed(found.pose), measured.at_rest)
        picture = "compare.png"
        draw_comparison(scene, rest, moved, result, title, folder / picture, jaw)
        record |= result.as_dict()
        rms = record["error"]["rms_mm"]
        notes = [describe_alignment(record["alignment"]), describe_measures(record), *notes]
        caption = "Distance of the scan to the model"
        tables.append((caption, MEASURE_HEADINGS, measure_rows(result.distances)))
    write_page(
        folder / "compare.html",
        title,
        notes,
        tables,
        [("computed and measured face", folder / picture)],
    )
    names = {"expression": f"{frame.name}.toml", "state": STATE_FILE, "picture": picture}
    files = {key: str(target / name) for key, name in (names | {"page": "compare.html"}).items()}
    text = (
        f"{title}: {rms:.2f} mm rms after {found.solves} solves\n\n"
        f"{text_table(ACTIVATION_HEADINGS, rows)}\n\n{' '.join(notes)}\n"
        f"Expression: {files['expression']}\nPage:       {files['page']}"
    )
    return files, text


def _write_sequence(
    folder: Path, target: Path, rows: list[dict[str, Any]], record: dict[str, Any]
) -> tuple[dict[str, str], str]:
    """Write the table of a sequence, and complete its record."""
    record["frames"] = rows
    found = [row for row in rows if "fault" not in row]
    names = list(found[0]["activations"] | found[0]["further"])
    with (folder / "activations.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["frame", "time", "rms_mm", *names])
        for row in found:
            values = row["activations"] | row["further"]
            writer.writerow(
                [row["frame"], row["time"], round(row["rms_mm"], 4), *map(values.get, names)]
            )
    unsure = [name for name in names if all(name in row["not_identifiable"] for row in found)]
    headings = ("frame", "time (s)", "rms (mm)", "solves", "most active")
    lines = [
        [row["frame"], row["time"], row["rms_mm"], row["solves"], _most(row["activations"])]
        for row in found
    ]
    text = text_table(headings, lines)
    for row in rows:
        if "fault" in row:
            text += f"\n{row['frame']}: {row['fault']}"
    if unsure:
        text += f"\n\nIn no frame told: {', '.join(unsure)}.".replace("_", " ")
    files = {"table": str(target / "activations.csv"), "frames": str(target / "frames")}
    text += (
        f"\n\nActivations: {files['table']}\n"
        f"Animate it with: modiolus export {files['frames']}/* --glb DIR"
    )
    return files, text


def _most(activations: dict[str, float]) -> str:
    """Tell the three greatest activations that two decimals show."""
    names = sorted(activations, key=lambda name: -activations[name])[:3]
    shown = [f"{name} {activations[name]:.2f}" for name in names if activations[name] >= 0.005]
    return ", ".join(shown).replace("_", " ") or "–"


#: Headings of `activation_rows`.
ACTIVATION_HEADINGS = ("unknown", "value", "standard deviation")


def listed(text: str) -> list[str]:
    """Return the names in a list with commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def _shown(values: dict[str, float]) -> dict[str, float]:
    """Return values by the names and in the units that a person knows, rounded."""
    known = {
        "jaw_open" if name == "jaw" else name: math.degrees(value) if name == "jaw" else value
        for name, value in values.items()
    }
    return {name: round(value, 5) for name, value in known.items()}


def identified(found: Identification) -> dict[str, Any]:
    """Return what an identification found, for a report; the opening of the jaw in degrees."""
    muscles = found.activations
    return {
        "activations": _shown(muscles),
        "further": _shown({k: v for k, v in found.values.items() if k not in muscles}),
        "deviations": _shown(found.deviations),
        "correlated": [list(pair) for pair in found.correlated],
        "not_identifiable": list(found.unsure),
        "history_mm": [round(value, 4) for value in found.history],
        "solves": found.solves,
    }


def activation_rows(record: dict[str, Any]) -> list[list[object]]:
    """Return the rows of a table of what was found, the greatest activations first."""
    found = record["activations"]
    order = [*sorted(found, key=lambda name: -found[name]), *record["further"]]
    values = found | record["further"]
    return [[name.replace("_", " "), values[name], record["deviations"][name]] for name in order]


def describe_certainty(record: dict[str, Any]) -> str:
    """Say of what the measurement does not tell."""
    parts = []
    if record["not_identifiable"]:
        parts.append(f"Not told by it: {', '.join(record['not_identifiable'])}.")
    if record["correlated"]:
        pairs = ", ".join(f"{a} and {b} ({c:+.2f})" for a, b, c in record["correlated"][:5])
        parts.append(f"Hardly to be told apart: {pairs}.")
    return " ".join(parts).replace("_", " ")


def expression_toml(name: str, source: str, found: Identification) -> str:
    """Return identified activations as an expression for ``modiolus simulate``."""
    lines = [f"title = {json.dumps(name)}", f"source = {json.dumps('identified from ' + source)}"]
    shown = identified(found)
    for key, value in shown["further"].items():
        # What the tissue is like is no part of an expression.
        is_part = key == "jaw_open"
        lines.append(f"{key} = {value!r}" if is_part else f"# simulate: --set {key}={value!r}")
    lines += ["", "[activations]"]
    active = {name: a for name, a in shown["activations"].items() if a >= 5e-6}
    if not active and shown["activations"]:
        active = {next(iter(shown["activations"])): 0.0}
    lines += [f"{name} = {value!r}" for name, value in active.items()]
    return "\n".join(lines) + "\n"
