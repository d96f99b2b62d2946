"""Round trips: activations drawn at random, and found again from the surface they make.

Each draw takes muscles at random and an activation for each, computes the face, adds noise along
the normals, turns and shifts it at random, aligns it anew without a neutral surface and
identifies those muscles. It has come back if every activation is within 0.03 of the true one or
named as one that the surface does not tell.

    python benchmarks/round_trip.py --count 20 --seed 1
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
from scipy.spatial.transform import Rotation

from modiolus.anatomy.surface import Surface
from modiolus.errors import SolveError
from modiolus.face.head import Head
from modiolus.mechanics.face import Face
from modiolus.scans.align import place
from modiolus.scans.identify import identify
from modiolus.scans.scan import Scan
from modiolus.scans.skin import Skin
from modiolus.scans.target import ScanTarget
from modiolus.scans.unknown import SCALES, unknowns

#: Error of an activation that counts as none.
CLOSE = 0.03


def drawn(head: Head, number: int, seed: int, muscles: int) -> dict[str, float]:
    """Return the activations of a draw: up to 0.6, of sheets and rings up to 0.12."""
    rng = np.random.default_rng([seed, number])
    names = rng.choice(list(head.muscles), muscles, replace=False).tolist()
    return {
        name: round(0.6 * SCALES[head.muscles[name].kind] * float(rng.random()), 4)
        for name in names
    }


def measured(skin: Skin, parameters: np.ndarray, noise: float, rng: np.random.Generator) -> Scan:
    """Return the skin of a state as a scanner would give it."""
    surface = skin.surface(parameters)
    rough = noise * rng.standard_normal((len(surface.vertices), 1)) * surface.vertex_normals
    turn = Rotation.random(random_state=rng).as_matrix()
    points = (surface.vertices + rough) @ turn.T + 100.0 * rng.standard_normal(3)
    return Scan.of(Surface(points, surface.faces, "draw"))


def main() -> None:
    """Run the draws, print a row for each, and say how many have come back."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=20, help="draws")
    parser.add_argument("--first", type=int, default=0, help="draw to begin with")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--head", default="taro")
    parser.add_argument("--muscles", type=int, default=6, help="that may contract in a draw")
    parser.add_argument("--noise", type=float, default=0.3, help="standard deviation in mm")
    options = parser.parse_args()
    head = Head.load(options.head)
    face, skin = Face(head), Skin(head)
    good = 0
    for number in range(options.first, options.first + options.count):
        true = drawn(head, number, options.seed, options.muscles)
        began, text = time.perf_counter(), ""
        try:
            state = face.solve(true)
            rng = np.random.default_rng([options.seed, number, 1])
            scan, _, _ = place(measured(skin, state.parameters, options.noise, rng), skin)
            found = identify(face, ScanTarget(skin, scan), unknowns(head, list(true)))
        except SolveError as error:
            verdict, text = "failed", str(error)
        else:
            off = {name: found.values[name] - value for name, value in true.items()}
            bad = [name for name in true if abs(off[name]) >= CLOSE and name not in found.unsure]
            verdict = "away" if bad else "back"
            good += not bad
            text = f"rms {found.history[-1]:.3f} mm, {found.solves} solves; " + ", ".join(
                f"{name} {value:.3f} {off[name]:+.3f}{' not told' * (name in found.unsure)}"
                for name, value in true.items()
            )
        seconds = time.perf_counter() - began
        sys.stdout.write(f"{number:3d} {verdict:6s} {seconds:5.0f} s  {text}\n")
        sys.stdout.flush()
    sys.stdout.write(f"{good} of {options.count} draws came back\n")


if __name__ == "__main__":
    main()
