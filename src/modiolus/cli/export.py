"""``modiolus export``: a head or results for other programs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from modiolus.cli.app import Json, Quiet, app, examples, show
from modiolus.cli.outputs import own_heads, whole_folder, write_report
from modiolus.errors import InputError, SolveError

if TYPE_CHECKING:
    from modiolus.mechanics import State
    from modiolus.scans.result import Result


@app.command(
    epilog=examples(
        "modiolus export taro --ex out/ex",
        "modiolus export out/sad out/terror --glb out/faces --seconds 2 --inbetweens 1",
    )
)
def export(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="HEAD|RESULT",
            help="A shipped head, a folder with one, or folders that simulate or identify wrote.",
            show_default=False,
        ),
    ],
    ex: Annotated[
        Path | None,
        typer.Option(
            "--ex", metavar="DIR", help="Folder for EX files: tissue and muscles with their fibres."
        ),
    ] = None,
    cmgui: Annotated[
        bool,
        typer.Option("--cmgui", help="Write the older .exnode and .exelem instead of .exf."),
    ] = False,
    glb: Annotated[
        Path | None,
        typer.Option(
            "--glb", metavar="DIR", help="Folder for faces.glb: every result as a shape key."
        ),
    ] = None,
    usd: Annotated[
        Path | None,
        typer.Option("--usd", metavar="DIR", help="Folder for faces.usdc, which holds the same."),
    ] = None,
    seconds: Annotated[
        float,
        typer.Option(
            metavar="SECONDS",
            help="With --glb or --usd: let each shape key come and go for so long, in turn. Frames "
            "of a sequence play in their own time without it.",
        ),
    ] = 0.0,
    inbetweens: Annotated[
        int,
        typer.Option(
            metavar="N",
            help="With --glb or --usd: compute so many states on the way to each result, which "
            "correct its shape key where it is not at full strength.",
        ),
    ] = 0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write results as shape keys of a model, or as EX files.

    Blender and other animation programs read glb and USD; Zinc, its applications and CMGUI read EX
    files.
    """
    if sum(target is not None for target in (ex, glb, usd)) != 1:
        raise InputError("--ex, --glb, --usd: give one of them, such as --glb out/faces")
    if ex is not None and (seconds or inbetweens):
        raise InputError(
            "--seconds, --inbetweens: they are for --glb and --usd; leave them out with --ex"
        )
    if ex is None and cmgui:
        raise InputError("--cmgui: it is for --ex; leave it out")
    if not 0.0 <= seconds <= 60.0:
        raise InputError(f"--seconds {seconds:g}: not within 0 to 60; give a number in there")
    if not 0 <= inbetweens <= 9:
        raise InputError(f"--inbetweens {inbetweens}: not within 0 to 9; give a number in there")
    if ex is not None:
        if len(sources) > 1:
            raise InputError(f"{sources[1]}: EX files take one head or result; export it apart")
        record, text = _write_ex(sources[0], ex, cmgui)
    else:
        record, text = _write_model(sources, glb, usd, seconds, inbetweens, quiet)
    show(record, text, as_json, quiet)


def _write_ex(source: str, target: Path, cmgui: bool) -> tuple[dict[str, Any], str]:
    from modiolus.export.ex import write_head_ex
    from modiolus.face.head import Head
    from modiolus.scans.result import STATE_FILE, load_result

    parameters = None
    if (Path(source) / STATE_FILE).is_file():
        result = load_result(source)
        head, parameters = result.head, result.parameters
        if len(parameters) != head.tissue.n_params:
            head = head.whole
    else:
        head = Head.load(source)
    with whole_folder(target, "report.json", "--ex", own_heads(source)) as folder:
        files = write_head_ex(head, folder, parameters, cmgui)
        (folder / "LICENSE").write_text(head.licence_text(), encoding="utf-8")
        places = {name: str(target / path.name) for name, path in files.items()}
        record = {
            "head": head.name,
            "elements": head.tissue.n_elements,
            "muscles": list(head.muscles),
            "fields": ["coordinates", *([] if parameters is None else ["deformed"]), "fibres"],
            "files": places,
        }
        write_report(folder, record)
    lines = [f"{head.name}: {head.tissue.n_elements} elements, {len(head.muscles)} muscles"]
    lines += [f"{name}: {path}" for name, path in places.items()]
    return record, "\n".join(lines)


def _write_model(
    sources: Sequence[str],
    glb: Path | None,
    usd: Path | None,
    seconds: float,
    inbetweens: int,
    quiet: bool,
) -> tuple[dict[str, Any], str]:
    from modiolus.export import in_turn, write_glb
    from modiolus.export.scene import FaceScene
    from modiolus.export.usd import write_usd
    from modiolus.scans.result import load_result

    results: dict[str, Result] = {}
    for source in sources:
        result = load_result(source)
        if result.expression in results:
            raise InputError(
                f"{source}: there is a {result.expression} already; leave one of them out"
            )
        results[result.expression] = result
    first, *others = results.values()
    rest = first.head.tissue.parameters
    for other, source in zip(others, sources[1:], strict=True):
        if not np.array_equal(other.head.tissue.parameters, rest):
            raise InputError(f"{source}: it is of another head than {sources[0]}; export it apart")
    head = first.head
    keys = _in_time(list(results.values()))
    if seconds:
        # In USD a blend shape has its in-betweens within it.
        keys = in_turn(len(results), seconds, inbetweens if usd is None else 0)
    elif keys is not None and inbetweens:
        raise InputError(
            "--inbetweens: frames of a sequence blend from one to the next, not from rest; "
            "leave it out, or let them come and go with --seconds"
        )
    target, option, name, write = glb, "--glb", "faces.glb", write_glb
    if usd is not None:
        target, option, name, write = usd, "--usd", "faces.usdc", write_usd
    assert target is not None
    scene = FaceScene(head)
    with whole_folder(target, name, option, sources) as folder:
        states: dict[str, tuple[np.ndarray, float]] = {}
        between: dict[str, tuple[str, float]] = {}
        for expression, result in results.items():
            states[expression] = result.parameters, result.jaw
            for share, state in _on_the_way(result, inbetweens, quiet):
                part = f"{expression}_{100.0 * share:.0f}"
                states[part] = state.parameters, state.load.jaw
                between[part] = expression, share
        write(
            folder / name,
            scene.shapes(rest),
            scene.targets(states),
            str(head.about.get("attribution", "")),
            keys,
            between,
        )
        (folder / "LICENSE").write_text(head.licence_text(), encoding="utf-8")
        record = {
            "head": head.name,
            "shape_keys": list(states),
            "seconds": 0.0 if keys is None else float(keys[0][-1]),
            "files": {"model": str(target / name)},
        }
        write_report(folder, record)
    text = f"{head.name}: {', '.join(states)}\nModel: {target / name}"
    return record, text


def _on_the_way(result: Result, count: int, quiet: bool) -> Iterator[tuple[float, State]]:
    """Yield evenly spaced shares of the load of a result, and the states of the face there."""
    from modiolus.mechanics import LoadNotReached
    from modiolus.mechanics.face import Face
    from modiolus.progress import Progress

    face, state = Face(result.head, result.settings), None
    for step in range(1, count + 1):
        share = step / (count + 1)
        part = {name: share * value for name, value in result.activations.items()}
        try:
            with Progress(f"solving {result.expression} at {share:.0%}", quiet=quiet) as progress:
                state = face.solve(part, share * result.jaw, state, progress.update)
        except LoadNotReached as error:
            raise SolveError(f"{result.expression} at {share:.0%}: {error}") from None
        yield share, state


def _in_time(results: Sequence[Result]) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the keys of an animation that goes from frame to frame of a sequence, if they are."""
    found = [result.time for result in results if result.time is not None]
    times = np.array(found)
    if len(times) < 2 or len(times) < len(results):
        return None
    order = np.argsort(times)
    if not (np.diff(times[order]) > 0.0).all():
        raise InputError("RESULT: two frames have the same time; export one sequence at a time")
    return times[order] - times.min(), np.eye(len(times))[order]
