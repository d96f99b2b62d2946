"""Compare modiolus with other finite element programs: same problems, one machine, one run.

Makes an environment for each program of PyPI, runs all on two threads and prints, for each
problem, what it took to come within 1 % of the converged displacement. ``make peers`` calls it.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from common import CASES, CONVERGED

HERE = Path(__file__).parent
THREADS = 2
#: Seconds that a program may take for the meshes of a case.
LIMIT = 600.0
ACCURACY = 0.01
TITLES = {
    "land": "Problem 1 of Land et al. (2015)",
    "muscle": "Fat with a muscle in its lower half",
}


class UnavailableError(Exception):
    """A program cannot be run here; the text says why."""


@dataclass(frozen=True)
class Program:
    """A program and what runs it.

    Attributes
    ----------
    name : str
    script : str
    needs : sequence of str
        Packages of PyPI for an environment of its own; without, ``python`` has what it needs.
    module : str
        To be imported.
    processes : int
        The threads are divided among them.
    """

    name: str
    script: str
    module: str
    needs: Sequence[str] = field(default_factory=tuple)
    processes: int = 1

    def python(self, folder: Path, index: str | None, system: str) -> str:
        """Return the interpreter, after making its environment where it has one."""
        python = sys.executable if self.module == "modiolus" else system
        if self.needs:
            home = folder / self.module
            python = str(home / "bin" / "python")
            if not Path(python).exists():
                run([sys.executable, "-m", "venv", str(home)])
            source = [] if index is None else ["--index-url", index]
            run([python, "-m", "pip", "install", "--quiet", *source, *self.needs])
        run([python, "-c", f"import {self.module}"])
        return python

    def solve(self, python: str, case: str) -> list[dict[str, Any]]:
        """Return a record of each mesh."""
        threads = str(THREADS // self.processes)
        names = ("OMP", "MKL", "OPENBLAS", "NUMBA")
        environment = os.environ | {f"{name}_NUM_THREADS": threads for name in names}
        command = [python, str(HERE / self.script), case]
        if self.processes > 1:
            # Refused to an administrator otherwise, as whom containers often run.
            environment |= {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
            # A process that waits for the other must not keep others from running.
            environment["OMPI_MCA_mpi_yield_when_idle"] = "1"
            command = ["mpirun", "-n", str(self.processes), *command]
        return [json.loads(line) for line in run(command, environment).splitlines()]


PROGRAMS = (
    Program("modiolus", "with_modiolus.py", "modiolus"),
    Program("FElupe", "with_felupe.py", "felupe", ("felupe>=11.3", "pypardiso>=0.4.7")),
    Program("scikit-fem", "with_skfem.py", "skfem", ("scikit-fem>=12.0", "pypardiso>=0.4.7")),
    Program("DOLFINx", "with_dolfinx.py", "dolfinx"),
    Program("DOLFINx, 2 processes", "with_dolfinx.py", "dolfinx", processes=2),
)


def run(command: Sequence[str], environment: dict[str, str] | None = None) -> str:
    """Return what a command prints."""
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=False, timeout=LIMIT
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UnavailableError(str(error)) from None
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        raise UnavailableError(f"{Path(command[0]).name}: {lines[-1]}")
    return done.stdout


def cheapest(records: Sequence[dict[str, Any]], case: str) -> dict[str, Any] | None:
    """Return the fastest mesh that is accurate, and on which refining along x stays so."""

    def accurate(record: dict[str, Any]) -> bool:
        return record["tip"] is not None and abs(record["tip"] / CONVERGED[case] - 1.0) <= ACCURACY

    def family(record: dict[str, Any]) -> tuple[float, int]:
        return record["growth"], record["mesh"][1]

    good = [
        record
        for record in records
        if all(
            accurate(other)
            for other in records
            if family(other) == family(record) and other["mesh"][0] >= record["mesh"][0]
        )
    ]
    return min(good, key=lambda record: float(record["seconds"]), default=None)


def table(case: str, results: dict[str, Any]) -> str:
    """Return a problem's table in Markdown."""
    lines = [
        f"### {TITLES[case]}",
        "",
        "| program | elements | unknowns | iterations | seconds | processor s | error "
        "| time, of ours | unknowns, of ours |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    own = results["modiolus"]
    ours = None if isinstance(own, str) else cheapest(own[case], case)
    for name, records in results.items():
        if isinstance(records, str):
            lines.append(f"| {name} | left out: {records} | | | | | | | |")
            continue
        best = cheapest(records[case], case)
        if best is None:
            lines.append(f"| {name} | no mesh within {ACCURACY:.0%} | | | | | | | |")
            continue
        error = abs(best["tip"] / CONVERGED[case] - 1.0)
        shares = [f"{best[key] / ours[key]:.2f}" if ours else "" for key in ("seconds", "unknowns")]
        lines.append(
            f"| {name} | {best['cells']} | {best['unknowns']} | {best['iterations']} "
            f"| {best['seconds']:.3f} | {best['processor']:.3f} | {error:.2%} "
            f"| {shares[0]} | {shares[1]} |"
        )
    return "\n".join([*lines, ""])


def main() -> None:
    """Run everything, store ``results.json`` and ``table.md``, print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("build/peers"), help="of environments")
    parser.add_argument("--index", help="package index for pip; its own by default")
    parser.add_argument("--dolfinx", default="/usr/bin/python3", help="interpreter that has it")
    arguments = parser.parse_args()
    folder = arguments.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    load = os.getloadavg()[0]
    results: dict[str, Any] = {}
    versions: dict[str, str] = {}
    for program in PROGRAMS:
        print(f"{program.name} (load {os.getloadavg()[0]:.1f})", file=sys.stderr, flush=True)
        try:
            if program.processes > 1 and shutil.which("mpirun") is None:
                raise UnavailableError("there is no mpirun")
            python = program.python(folder, arguments.index, arguments.dolfinx)
            results[program.name] = {case: program.solve(python, case) for case in CASES}
            versions |= results[program.name]["land"][0]["versions"]
        except UnavailableError as error:
            results[program.name] = str(error)
    machine = f"{platform.machine()}, {os.cpu_count()} cores, {platform.python_version()}"
    (folder / "results.json").write_text(
        json.dumps(
            {"machine": machine, "load": load, "versions": versions, "results": results}, indent=1
        )
        + "\n"
    )
    text = "\n".join(
        [
            f"Machine: {machine}; load before the run {load:.1f}; {THREADS} threads each.",
            ", ".join(f"{name} {version}" for name, version in versions.items()),
            "",
            *(table(case, results) for case in CASES),
        ]
    )
    (folder / "table.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
