"""``modiolus bench``: how long everything takes, and where the time goes."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from modiolus.cli.app import HeadName, Json, Quiet, app, examples, show
from modiolus.errors import InputError
from modiolus.progress import Progress

if TYPE_CHECKING:
    from modiolus.face.expression import Expression
    from modiolus.face.head import Head
    from modiolus.mechanics import Problem, State
    from modiolus.mechanics.timing import Machine

#: Change of every activation that a warm start has to follow.
WARM = 0.9


@app.command(epilog=examples("modiolus bench smile-closed --json"))
def bench(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="EXPRESSION",
            help="By default the shipped ones that are alike on both sides.",
        ),
    ] = None,
    head: HeadName = "taro",
    finest: Annotated[
        int,
        typer.Option(
            "--refine",
            metavar="N",
            min=0,
            max=2,
            help="Exact refinements on which an iteration is measured as well; 2 takes 8 GB.",
        ),
    ] = 1,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure where the time of a computation goes.

    Imports, set-up, the parts of an iteration, and whole expressions.

    An expression is solved cold, from rest, warm, from there to 0.9 times its activations, and cold
    as if nothing touched anything, on matrices of the same pattern. The parts of an iteration stand
    beside the least time in which the machine could do them.
    """
    from modiolus.face.expression import Expression, expression_names

    every = [Expression.named(name) for name in names or expression_names()]
    sided = [e.name for e in every if any(m.endswith(("_left", "_right")) for m in e.activations)]
    if names and sided:
        raise InputError(f"{sided[0]}: differs left and right; name an expression that does not")
    chosen = [expression for expression in every if expression.name not in sided]
    record: dict[str, Any] = {"machine": _machine(), "seconds": {}, "expressions": {}, "meshes": []}
    seconds = record["seconds"]
    with Progress("measuring", total=len(chosen) + 2 + finest, quiet=quiet) as progress:
        progress.update(0, "imports")
        seconds["import modiolus"] = _fresh("import modiolus")
        seconds["import of the mechanics"] = _fresh("import modiolus.mechanics.face")
        from modiolus.face.head import Head
        from modiolus.face.refine import refined
        from modiolus.mechanics.convergence import inherited
        from modiolus.mechanics.face import face_problem
        from modiolus.mechanics.timing import Machine, least

        able = Machine.measured()
        record["machine"].update(
            gflops_single=able.single, gflops_double=able.double, gb_s=able.memory
        )
        progress.update(1, "set-up")
        model = Head.load(head)
        seconds["reading the head"] = least(lambda: Head.load(head), 2)
        began = time.perf_counter()
        problem = face_problem(model)
        seconds["first set-up"] = time.perf_counter() - began
        seconds["set-up"] = least(lambda: face_problem(model), 2)
        record["points"] = _points(problem)
        for done, expression in enumerate(chosen):
            progress.update(2 + done, expression.name)
            cold, record["expressions"][expression.name] = _solved(problem, model, expression)
            if not done:
                record["meshes"].append(_mesh(problem, cold, able))
                base = cold
        for times in range(1, finest + 1):
            progress.update(1 + len(chosen) + times, f"{times} refinement{'s' * (times > 1)}")
            counts = (2**times, 2**times, 1)
            finer = face_problem(refined(model, counts))
            record["meshes"].append(_mesh(finer, inherited(finer, base, counts), able))
            del finer
        progress.update(2 + len(chosen) + finest, "done")
    # Not everywhere, and this file is read by every command.
    import resource

    record["memory_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    show(record, _text(record), as_json, quiet)


def _points(problem: Problem) -> dict[str, int]:
    """Count the points at which muscles pull and things touch."""
    from modiolus.mechanics import Fibres, RigidContact, SurfaceContact

    points = {"fibres": 0, "contact": 0}
    for term in problem.terms:
        if isinstance(term, Fibres):
            points["fibres"] += len(term.quadrature.weights)
        elif isinstance(term, RigidContact | SurfaceContact):
            points["contact"] += len(term.stiffness)
    return points


def _solved(problem: Problem, head: Head, expression: Expression) -> tuple[State, dict[str, Any]]:
    """Solve an expression cold, warm and without contact; return the first, and how it went."""
    from modiolus.face.expression import resolve
    from modiolus.face.jaw import opening
    from modiolus.mechanics import Continuation
    from modiolus.mechanics.face import face_load
    from modiolus.mechanics.timing import without_contact

    path = Continuation(problem)
    activations = resolve(expression.activations, head.muscles)
    jaw = opening(expression.jaw_open)
    load = face_load(problem, head, activations, jaw)
    cold = path.run(load)
    less = {muscle: WARM * value for muscle, value in activations.items()}
    warm = path.run(face_load(problem, head, less, jaw)).statistics
    free = Continuation(without_contact(problem)).run(load).statistics
    return cold, {
        "cold_s": cold.statistics.solve_s,
        "iterations": cold.statistics.newton_iterations,
        "factorisations": cold.statistics.factorisations,
        "warm_s": warm.solve_s,
        "warm_iterations": warm.newton_iterations,
        "warm_factorisations": warm.factorisations,
        "without_contact_s": free.solve_s,
        "without_contact_iterations": free.newton_iterations,
        "without_contact_factorisations": free.factorisations,
        "max_penetration_mm": cold.statistics.max_penetration_mm,
    }


def _mesh(problem: Problem, state: State, able: Machine) -> dict[str, Any]:
    """Measure the parts of an iteration on a mesh, and their floor."""
    from modiolus.mechanics.timing import floor, parts

    found = parts(problem, state.parameters, state.pressure, state.load)
    return {
        "elements": problem.mesh.n_elements,
        "parts": found,
        "floor": floor(problem, found, able),
    }


def _fresh(statement: str) -> float:
    """Return the wall time of a statement in a new interpreter, without the interpreter's."""
    code = f"import time; t = time.perf_counter(); {statement}; print(time.perf_counter() - t)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return float(done.stdout)


def _machine() -> dict[str, Any]:
    return {
        "system": platform.system(),
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "load": os.getloadavg()[0],
        "python": platform.python_version(),
    }


def _text(record: dict[str, Any]) -> str:
    """Lay the figures out for reading."""
    lines = [f"{name:32s}{value:9.3f} s" for name, value in record["seconds"].items()]
    lines.append("")
    meshes = record["meshes"]
    lines.append(f"{'':32s}" + "".join(f"{mesh['elements']:9d} elements" for mesh in meshes))
    for name in meshes[0]["parts"]:
        line = f"{name:32s}"
        for mesh in meshes:
            value, least = mesh["parts"][name], mesh["floor"].get(name)
            if name.endswith(("unknowns", "entries")):
                line += f"{value:9.0f}         "
            elif name == "factor_gflop":
                line += f"{value:9.2f}         "
            else:
                line += f"{value:9.4f} s" + (f" ({least:.3f})" if least else " " * 8)
        lines.append(line.rstrip())
    machine = record["machine"]
    lines.append(
        f"In brackets the floor, at {machine['gflops_single']:.0f} (single) and "
        f"{machine['gflops_double']:.0f} Gflop/s (double) and {machine['gb_s']:.0f} GB/s."
    )
    heading = f"{'expression':16s}{'cold':>8s}{'its':>5s}{'fac':>5s}{'warm':>8s}{'its':>5s}"
    lines += ["", heading + f"{'no contact':>12s}{'its':>5s}{'fac':>5s}{'overlap':>11s}"]
    for name, row in record["expressions"].items():
        lines.append(
            f"{name:16s}{row['cold_s']:7.2f}s{row['iterations']:5d}{row['factorisations']:5d}"
            f"{row['warm_s']:7.2f}s{row['warm_iterations']:5d}"
            f"{row['without_contact_s']:11.2f}s{row['without_contact_iterations']:5d}"
            f"{row['without_contact_factorisations']:5d}{row['max_penetration_mm']:8.3f} mm"
        )
    whole, free = (
        sum(row[key] for row in record["expressions"].values())
        for key in ("cold_s", "without_contact_s")
    )
    lines.append(f"All of them take {whole / free:.2f} times as long as without contact.")
    lines += [
        "",
        f"{record['memory_mb']:.0f} MB at most; {machine['cores']} cores, load "
        f"{machine['load']:.1f} at the start",
    ]
    return "\n".join(lines)
