"""``modiolus simulate``: one expression."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from modiolus.cli.app import (
    HeadName,
    Json,
    Out,
    Quiet,
    Setting,
    app,
    assignments,
    examples,
    face_settings,
    show,
)
from modiolus.cli.outputs import own_heads, whole_folder
from modiolus.errors import InputError, SolveError, Stopped
from modiolus.files import folder_name
from modiolus.progress import Interruption

if TYPE_CHECKING:
    from modiolus.cli.run import Runner
    from modiolus.face.expression import Expression
    from modiolus.face.head import Head
    from modiolus.mechanics import Interrupted, LoadNotReached, State
    from modiolus.scans.result import Result

#: Name of what has muscles but no expression.
CUSTOM = "custom"
#: Muscles that the heading of a picture names at most.
MOST_NAMED = 4


@app.command(
    epilog=examples(
        "modiolus simulate smile-closed",
        "modiolus simulate my.toml --json",
        "modiolus simulate --activation frontalis=0.3 --activation mentalis=0.5",
        "modiolus simulate terror --jaw-open 12 --name scream",
        "modiolus simulate smile-closed --palsy right",
        "modiolus simulate --activation risorius=1 --from out/smile-closed",
        "modiolus simulate sad --set sigma_max=250 --set skin=0",
    )
)
def simulate(
    expression: Annotated[
        str,
        typer.Argument(
            metavar="EXPRESSION|FILE.toml",
            help="smile-closed, smile-open, sad, terror, wink, smirk, or a TOML file.",
            show_default=False,
        ),
    ] = "",
    activation: Annotated[
        list[str],
        typer.Option(
            "--activation",
            metavar="MUSCLE=VALUE",
            help="Activation of a muscle, 0 to 1; repeatable; counts more than the expression.",
        ),
    ] = [],  # noqa: B006
    jaw_open: Annotated[
        float | None,
        typer.Option(
            "--jaw-open",
            metavar="DEGREES",
            help="How far the jaw is open, 0 to 30; counts more than the expression.",
            show_default=False,
        ),
    ] = None,
    palsy: Annotated[
        str,
        typer.Option(
            "--palsy",
            metavar="left|right",
            help="Let all muscles of one side rest, as in palsy of the facial nerve.",
            show_default=False,
        ),
    ] = "",
    start: Annotated[
        str,
        typer.Option(
            "--from",
            metavar="DIR",
            help="Begin at the state in a folder that simulate wrote, not at rest.",
            show_default=False,
        ),
    ] = "",
    settings: Setting = [],  # noqa: B006
    name: Annotated[
        str,
        typer.Option(
            "--name",
            metavar="NAME",
            help="What the results and their shape key are called; as the expression by default.",
            show_default=False,
        ),
    ] = "",
    head: HeadName = "taro",
    out: Out = Path("out"),
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Contract the muscles of an expression and write OUT/<name>/.

    The folder has face.png, face.glb, tissue.vtu, state.npz and report.json. Where the activations
    cannot be reached, or after Ctrl-C, OUT/<name>-stopped/ has the last state on the way.
    """
    began = time.perf_counter()
    from modiolus.face.expression import Expression, resolve
    from modiolus.face.head import Head
    from modiolus.face.jaw import opening

    given = assignments("--activation", activation, "mentalis=0.5", lambda _: float)
    if expression:
        wanted = Expression.named(expression)
    elif given or jaw_open is not None:
        wanted = Expression(CUSTOM)
    else:
        raise InputError("EXPRESSION: none given; name one, a TOML file, or use --activation")
    name = folder_name("--name", name) if name else wanted.name
    jaw = opening(wanted.jaw_open if jaw_open is None else jaw_open)
    chosen = Head.load(head)
    for named, part in ((expression, wanted.activations), ("--activation", given)):
        try:
            resolve(part, chosen.muscles)
        except InputError as error:
            raise InputError(f"{named}: {error}") from None
    activations = resolve({**wanted.activations, **given}, chosen.muscles, palsy)
    parameters = face_settings(settings)
    target = out / name
    earlier = _earlier(start, head, chosen) if start else None
    with whole_folder(target, "report.json", sources=own_heads(head)) as folder:
        from modiolus.cli.run import Runner
        from modiolus.mechanics import Interrupted, LoadNotReached

        runner = Runner(chosen, quiet, head, parameters)
        title = heading(wanted, given, jaw_open, palsy)
        begin = None if earlier is None else _begin(runner, earlier, start)
        try:
            state = runner.solve(name, activations, jaw, begin)
        except (LoadNotReached, Interrupted) as error:
            if error.reached == 0.0:
                raise
            Interruption.heed()
            place = _stopped(runner, error, name, title, target, began)
            kind = SolveError if isinstance(error, LoadNotReached) else Stopped
            raise kind(f"{error}; the state there is in {place}") from None
        record = runner.write(name, title, state, folder, target, began)
    show(record, describe(record), as_json, quiet)


def _earlier(folder: str, name: str, head: Head) -> Result:
    """Read the state to begin at; it must be one of the head in use."""
    from modiolus.scans.result import load_result

    try:
        found = load_result(folder)
        other = not np.array_equal(found.head.tissue.parameters, head.tissue.parameters)
    except InputError as error:
        raise InputError(f"--from {error}") from None
    if other:
        raise InputError(
            f"--from {folder}: a state of the head {found.head.name}, not of {name}; "
            f"name another folder, or the head with --head"
        )
    return found


def _begin(runner: Runner, earlier: Result, folder: str) -> State:
    """Return an earlier result as the state to begin at."""
    known = earlier.parameters, earlier.pressure, earlier.activations, earlier.jaw
    try:
        return runner.face.state(*known, offsets=earlier.offsets)
    except InputError as error:
        raise InputError(f"--from {folder}: {error}") from None


def _stopped(
    runner: Runner,
    error: LoadNotReached | Interrupted,
    name: str,
    title: str,
    target: Path,
    began: float,
) -> Path:
    """Write the last state on the way to a load that was not reached; return its folder."""
    place = target.with_name(f"{target.name}-stopped")
    title = f"{title}, stopped at {error.reached:.0%}"
    with whole_folder(place, marker="report.json") as folder:
        runner.write(name, title, error.state.short(), folder, place, began)
    return place


def heading(
    wanted: Expression,
    given: Mapping[str, float],
    jaw_open: float | None = None,
    palsy: str = "",
) -> str:
    """Say what a picture shows: the expression, and what was asked for on top of it."""
    parts = [wanted.title or wanted.name] if wanted.name != CUSTOM else []
    shown = [f"{name.replace('_', ' ')} {value:g}" for name, value in given.items()]
    parts += [*shown[:MOST_NAMED], *["…"] * (len(shown) > MOST_NAMED)]
    if jaw_open is not None:
        parts.append(f"jaw open by {jaw_open:g}°")
    if palsy:
        parts.append(f"{palsy} side palsied")
    return ", ".join(parts)


def describe(record: dict[str, Any]) -> str:
    """Return what a person wants to know of a run, in a few lines."""
    compiled = record["compile_s"]
    beside = f" beside {compiled:.0f} s of compiling" if compiled > 0.5 else ""
    doubts = "".join(f"Doubtful: {doubt}\n" for doubt in record["doubts"])
    return (
        f"{record['expression']} on {record['head']}: {record['steps']} steps, "
        f"{record['newton_iterations']} iterations, {record['solve_s']:.1f} s{beside}; "
        f"{_farthest(record['landmarks'])}\n{doubts}"
        f"Picture: {record['files']['picture']}\nReport:  {record['files']['report']}"
    )


def _farthest(landmarks: Mapping[str, Mapping[str, Sequence[float]]]) -> str:
    """Say which landmark moved most, and how far on both sides."""
    moved = {
        name: round(math.hypot(*place["displacement"]), 1) for name, place in landmarks.items()
    }
    most = max(moved, key=lambda name: moved[name])
    name = most.removesuffix("_left").removesuffix("_right")
    left, right = (moved.get(f"{name}_{side}", moved[most]) for side in ("left", "right"))
    both = f"{left:.1f} mm"
    if left != right:
        both += f" on the left and {right:.1f} mm on the right"
    return f"the {name.replace('_', ' ')} moved most, {both}"
