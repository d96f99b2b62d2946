"""Random sets of activations: how often the continuation reaches them, and why not.

The sets follow a scrambled Sobol sequence, so that a longer run extends a shorter one: of one
to six muscles of the half face, each to an activation between 0 and 1. The table, a CSV file
beside this one unless told otherwise, keeps one row a set; sets that it has already are not
solved again.

    python benchmarks/random_sets.py --count 20 --seed 1
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
from scipy.stats import qmc

from modiolus.errors import SolveError
from modiolus.face.head import Head
from modiolus.mechanics import Continuation
from modiolus.mechanics.face import face_problem

COLUMNS = (
    *("set", "converged", "reached", "steps", "iterations", "factorisations", "seconds"),
    *("J_min", "J_max", "penetration_mm", "wrong_pivots", "jumps", "correction_mm"),
    *("activations", "why"),
)
#: Muscles of a set at most.
MOST = 6


def random_sets(muscles: list[str], count: int, seed: int) -> list[dict[str, float]]:
    """Return sets of activations, each a dict by muscle; the first ones do not depend on count."""
    sequence = qmc.Sobol(1 + 2 * MOST, seed=seed)
    drawn = sequence.random_base2(int(np.ceil(np.log2(max(count, 2)))))[:count]
    sets = []
    for row in drawn:
        left = list(muscles)
        number = 1 + int(row[0] * MOST)
        picks, values = row[1 : 1 + number], row[1 + MOST : 1 + MOST + number]
        sets.append(
            {
                left.pop(int(pick * len(left))): round(float(value), 4)
                for pick, value in zip(picks, values, strict=True)
            }
        )
    return sets


def main() -> None:
    """Solve the sets that the table does not have, and say how it went."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=20, help="sets in all")
    parser.add_argument("--first", type=int, default=0, help="set to begin with")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--head", default="taro")
    parser.add_argument("--table", type=Path, default=Path(__file__).with_suffix(".csv"))
    options = parser.parse_args()
    head = Head.load(options.head)
    problem = face_problem(head)
    rows: dict[int, dict[str, str]] = {}
    if options.table.exists():
        with options.table.open(newline="") as file:
            rows = {int(row["set"]): row for row in csv.DictReader(file)}
    sets = random_sets(list(head.muscles), options.count, options.seed)
    for number, activations in enumerate(sets):
        if number < options.first or number in rows:
            continue
        path, began, why = Continuation(problem), time.perf_counter(), ""
        try:
            path.run(problem.load(activations))
        except SolveError as error:
            why = str(error)
        found = path.state.statistics
        share = [path.state.activations.get(k, 0.0) / v for k, v in activations.items() if v > 0.0]
        values = (
            *(number, int(not why), round(min(share), 4) if why else 1.0, found.steps),
            *(found.newton_iterations, found.factorisations),
            *(round(time.perf_counter() - began, 2), round(found.J_min, 3), round(found.J_max, 3)),
            *(round(found.max_penetration_mm, 4), found.wrong_pivots, found.jumps),
            round(found.correction_mm, 6),
            *(json.dumps(activations), why),
        )
        rows[number] = {k: str(v) for k, v in zip(COLUMNS, values, strict=True)}
        with options.table.open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows(rows[key] for key in sorted(rows))
        sys.stderr.write(f"{number}: {why or 'converged'}\n")
    done = [rows[k] for k in sorted(rows) if k < options.count]
    good = [row for row in done if row["converged"] == "1"]
    times = [float(row["seconds"]) for row in good] or [0.0]
    sys.stdout.write(
        f"{len(good)} of {len(done)} sets converged ({len(good) / max(len(done), 1):.1%}); "
        f"seconds each: median {np.median(times):.1f}, most {max(times):.1f}\n"
    )
    for why, number in Counter(row["why"] for row in done if row["why"]).most_common():
        sys.stdout.write(f"{number} x {why}\n")


if __name__ == "__main__":
    main()
