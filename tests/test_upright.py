"""Gravity: a shape without it is found from the shape under it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from modiolus.cli import main
from modiolus.cli.upright import greatest
from modiolus.face.head import Head
from modiolus.face.moved import moved_head
from modiolus.hermite import HermiteMesh, grid
from modiolus.mechanics import Continuation, Problem, Settings
from modiolus.mechanics.constraints import clamp
from modiolus.mechanics.face import FaceSettings, fibres
from modiolus.mechanics.gravity import DENSITY, LOAD, SUPINE, TIGHT, heavy_face, unloaded, weight
from modiolus.mechanics.terms import DeadForces

#: Soft fat (kPa), so that the block sags by millimetres.
FAT = (0.42, 0.0, 0.0)


def block() -> HermiteMesh:
    """A slab of 60 x 60 x 30 mm, a little bent, that stands on bone at the back."""
    axes = np.meshgrid(
        np.linspace(0, 60, 3), np.linspace(0, 60, 3), np.linspace(0, -30, 2), indexing="ij"
    )
    points = np.stack([axes[0], axes[2] + 0.002 * (axes[0] - 30) ** 2, axes[1]], axis=-1)
    return grid(points)


def build(mesh: HermiteMesh) -> Problem:
    rear = np.arange(mesh.n_elements)
    fixed = clamp(mesh, rear, 2, 0)
    # Gravity along the slab: it shears.
    load = DeadForces.body(mesh, weight((0.0, 0.6, -0.8)))
    return Problem(mesh, FAT, terms=[load], fixed=fixed)


def test_the_weight_of_a_litre_is_ten_newtons() -> None:
    assert np.allclose(weight(SUPINE) * 1e6, [0.0, 1.040 * 9.81 * 1e3, 0.0])


def test_a_shape_is_recovered_from_its_sagged_one() -> None:
    rest = block()
    sagged = Continuation(build(rest), settings=Settings(tolerance=1e-6)).run(LOAD).mesh
    elements, xi, _ = rest.gauss_points(4)
    points = rest.functions(elements, xi)

    def farthest(mesh: HermiteMesh) -> float:
        gap = points @ (mesh.parameters - rest.parameters)
        return float(np.linalg.norm(gap, axis=1).max())

    moved = farthest(sagged)
    assert moved > 2.0
    found = unloaded(build, sagged, tolerance=1e-3, settings=Settings(tolerance=1e-6))
    assert farthest(found.mesh) < 5e-3
    # Every round brings it nearer.
    assert np.all(np.diff(found.gaps) < 0.0)
    assert found.gaps[-1] < 1e-3 < found.gaps[0]


def test_a_face_is_recovered_from_lying(block_head: Head) -> None:
    """With muscles, bone behind and lips that touch, on a small head twenty times as heavy."""
    recovered(block_head, 20.0 * DENSITY, moved=0.4, within=0.05)


@pytest.mark.slow
def test_taro_is_recovered_from_lying() -> None:
    recovered(Head.load("taro"), DENSITY, moved=0.4, within=0.05)


def recovered(head: Head, density: float, moved: float, within: float) -> None:
    """Let a head without gravity lie down, and find its shape again from that."""

    def build(shape: HermiteMesh) -> Problem:
        return heavy_face(head, shape, SUPINE, density)

    lying = Continuation(build(head.tissue), settings=TIGHT).run(LOAD).mesh
    # How hard a lip rests on the teeth hardly shows in an equilibrium: shapes are off by more.
    found = unloaded(build, lying, 0.02 * within, TIGHT)
    elements, xi, _ = lying.gauss_points(4)
    points = lying.functions(elements, xi)
    sag, gap = (
        np.linalg.norm(points @ (mesh.parameters - head.tissue.parameters), axis=1).max()
        for mesh in (lying, found.mesh)
    )
    assert sag > moved
    assert gap < within


def test_fibres_turn_and_stretch_with_the_tissue(block_head: Head) -> None:
    """A new shape at rest carries points of a muscle, and the muscle itself, like the tissue."""
    mesh = block_head.tissue
    shear = np.array([[1.0, 0.2, 0.0], [0.0, 1.1, 0.0], [0.1, 0.0, 0.9]])
    other = mesh.with_parameters(mesh.parameters @ shear.T)
    (embedded,) = fibres(block_head, FaceSettings())
    before = embedded.quadrature
    after = before.carried(mesh, other)
    turned = before.directions @ shear.T
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    assert np.allclose(after.directions, turned, atol=1e-12)
    assert np.allclose(after.weights, np.linalg.det(shear) * before.weights)
    # The muscle as a mesh of its own comes to the same.
    moved = moved_head(block_head, other.parameters).muscles["strap"]
    old = block_head.muscles["strap"]
    assert np.allclose(moved.quadrature().points, old.quadrature().points @ shear.T, atol=1e-6)
    turned = old.quadrature().directions @ shear.T
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    assert np.allclose(moved.quadrature().directions, turned, atol=1e-6)


def test_the_command_writes_a_head(
    block_head: Head,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Head, "load", lambda name: block_head)
    # It has no eyes to draw.
    monkeypatch.setattr("modiolus.export.scene.FaceScene", lambda head: None)
    monkeypatch.setattr("modiolus.view.face.draw_face", lambda *args, **more: None)
    out = tmp_path / "standing"
    with pytest.raises(SystemExit) as left:
        main(["upright", "block", "--tolerance", "0.02", "--out", str(out), "--json", "--quiet"])
    assert left.value.code == 0
    record = json.loads(capsys.readouterr().out)
    assert record["rounds_mm"][-1] <= 0.02
    assert record["head"] == "standing"
    # From lying to without gravity it rises to the front, from there it sinks.
    move = record["landmarks"]["chin"]
    assert move["without_gravity"][1] < 0.0
    assert move["upright"][2] < 0.0
    with np.load(out / "tissue.npz") as arrays:
        assert not np.allclose(arrays["parameters"], block_head.tissue.parameters, atol=1e-3)
    for name in ("head.toml", "muscles.npz", "deep.npz", "LICENSE", "report.json"):
        assert (out / name).stat().st_size > 0


@pytest.mark.parametrize("option", [["--density", "-1"], ["--tolerance", "nan"]])
def test_the_command_refuses_what_cannot_be(
    option: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as left:
        main(["upright", "taro", "--out", str(tmp_path / "x"), *option])
    assert left.value.code == 2
    assert option[0] in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_the_shipped_upright_head_is_taro_standing() -> None:
    lying, standing = Head.load("taro"), Head.load("taro-upright")
    assert standing.about["upright_of"] == "taro"
    assert standing.about["licence"] == lying.about["licence"]
    assert standing.about["provenance"]["standing"].startswith("inferred")
    assert set(standing.muscles) == set(lying.muscles)
    assert set(standing.attachments) == set(lying.attachments)
    np.testing.assert_array_equal(standing.fraction, lying.fraction)
    assert 0.5 < greatest(lying, standing) < 5.0
    move = {
        name: standing.landmark_points()[name] - point
        for name, point in lying.landmark_points().items()
    }
    # It sinks where it is loose, and hardly over the forehead.
    assert move["lower_lip_mid"][2] < -0.3
    assert np.linalg.norm(move["inner_brow_left"]) < 0.5
