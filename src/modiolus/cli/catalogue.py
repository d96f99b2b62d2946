"""``modiolus catalogue``: every muscle alone."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from modiolus.cli.app import HeadName, Json, Out, Quiet, Setting, app, examples, face_settings, show
from modiolus.cli.outputs import whole_folder, write_report
from modiolus.errors import SolveError

#: Activation at which a muscle shows what it does, by its kind: a sheet or a ring has many times
#: the cross-section of a strap.
ALONE = {"strap": 1.0, "sheet": 0.2, "ring": 0.15}


@app.command(epilog=examples("modiolus catalogue --out out"))
def catalogue(
    settings: Setting = [],  # noqa: B006
    head: HeadName = "taro",
    out: Out = Path("out"),
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Contract every muscle alone and draw all of them on one page.

    Writes OUT/catalogue/ with catalogue.png, report.json and a folder for every muscle. One that
    cannot be contracted so far is shown at the last state on the way, and told at the end.
    """
    from modiolus.face.head import Head

    chosen = Head.load(head)
    parameters = face_settings(settings)
    target = out / "catalogue"
    with whole_folder(target, marker="report.json") as folder:
        from modiolus.cli.run import Runner
        from modiolus.mechanics import LoadNotReached
        from modiolus.view.face import draw_catalogue

        runner = Runner(chosen, quiet, head, parameters)
        runs, states, short = [], [], []
        for number, muscle in enumerate(chosen.muscles.values(), 1):
            began = time.perf_counter()
            activation = ALONE[muscle.kind]
            try:
                count = f"{number} of {len(chosen.muscles)}"
                state = runner.solve(f"{muscle.name}, {count}", {muscle.name: activation})
            except LoadNotReached as error:
                state = error.state.short()
                activation *= error.reached
                short.append(f"{muscle.name}: {error}")
            title = muscle.name.replace("_", " ")
            (folder / muscle.name).mkdir()
            record = runner.write(
                muscle.name, title, state, folder / muscle.name, target / muscle.name, began
            )
            farthest = float(np.max(runner.scene.displacement(state.parameters)))
            states.append(
                (title, f"activation {activation:g}, up to {farthest:.1f} mm", state.parameters)
            )
            runs.append(record)
        page = folder / "catalogue.png"
        heading = f"Every muscle alone · {chosen.name}"
        draw_catalogue(runner.scene, chosen.tissue.parameters, states, heading, page)
        record = {
            "runs": runs,
            "files": {
                "picture": str(target / "catalogue.png"),
                "report": str(target / "report.json"),
            },
        }
        write_report(folder, record)
    text = f"{len(runs)} muscles.\nPicture: {target / page.name}\nReport:  {target / 'report.json'}"
    show(record, text, as_json, quiet)
    if short:
        raise SolveError("; ".join(short))
