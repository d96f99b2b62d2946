"""A head from a subject's own structures: what is given is used, the rest is carried over."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from modiolus.anatomy import Surface
from modiolus.cli import _run
from modiolus.errors import InputError
from modiolus.face.head import Head
from modiolus.face.muscles import least_jacobian, outer_surface
from modiolus.face.provenance import provenance_lines
from modiolus.face.subject import (
    fit_muscle,
    lay_on,
    one_side,
    provenance,
    sort_structures,
)


@pytest.fixture(scope="module")
def taro() -> Head:
    return Head.load("taro")


def moved(surface: Surface, *shift: float, name: str = "") -> Surface:
    return Surface(surface.vertices + np.array(shift), surface.faces, name or surface.name)


def write(path: Path, surface: Surface) -> None:
    import pyvista as pv

    pv.PolyData.from_regular_faces(surface.vertices.astype("f4"), surface.faces).save(path)


def test_names_are_sorted_by_part_and_side(taro: Head) -> None:
    ball = outer_surface(taro.muscles["mentalis"])
    names = ["skin", "mentalis_left", "mentalis_right", "procerus", "mandible", "hyoid"]
    found = sort_structures(dict.fromkeys(names, ball), taro)
    assert [len(side) for side in found.muscles["mentalis"]] == [1, 1, 0]
    assert [len(side) for side in found.muscles["procerus"]] == [0, 0, 1]
    assert list(found.deep) == ["mandible"]
    assert found.unused == ["hyoid"]
    table = provenance(taro, found)
    assert table["mentalis"].startswith("given") and table["mandible"].startswith("given")
    assert table["zygomaticus_major"] == "inferred: carried over from taro by morphing"
    assert table["skull"].startswith("inferred")
    assert set(taro.muscles) | set(taro.deep) <= set(table)
    with pytest.raises(InputError, match="skin"):
        sort_structures({"mentalis": ball}, taro)


def test_a_surface_without_a_side_is_taken_from_both(taro: Head) -> None:
    left = outer_surface(taro.muscles["zygomaticus_major"])
    both = Surface.joined([left, left.mirrored(taro.midplane)])
    pieces = one_side([], [], [both], taro.midplane)
    assert len(pieces) == 2
    for piece in pieces:
        assert piece.volume == pytest.approx(left.volume, rel=1e-6)
        np.testing.assert_allclose(piece.bounds, left.bounds, atol=1e-9)
    assert len(one_side([], [left.mirrored(taro.midplane)], [], taro.midplane)) == 1


@pytest.mark.parametrize("name", ["zygomaticus_major", "orbicularis_oris_upper"])
def test_a_muscle_is_fitted_to_its_surface(taro: Head, name: str) -> None:
    muscle = taro.muscles[name]
    surface = outer_surface(muscle)
    bent = surface.vertices + np.array([0.0, 0.8, 1.0])
    bent[:, 1] += 0.5 * np.sin(bent[:, 2] / 15.0)
    there = Surface(bent, surface.faces, name)
    fitted = fit_muscle(muscle, [there], taro.midplane)
    gap = there.closest(outer_surface(fitted).samples(1.0)).distance
    assert np.sqrt(np.mean(gap**2)) < 0.15
    assert least_jacobian(fitted.mesh) > 0.05
    # It has moved as a body does: its fibres begin and end where they did on it.
    elements, xi, _ = muscle.mesh.gauss_points(2)
    points = muscle.mesh.evaluate(elements, xi) + np.array([0.0, 0.8, 1.0])
    points[:, 1] += 0.5 * np.sin(points[:, 2] / 15.0)
    off = np.linalg.norm(fitted.mesh.evaluate(elements, xi) - points, axis=1)
    assert np.sqrt(np.mean(off**2)) < 0.4


def test_the_tissue_is_laid_on_given_bones(block_head: Head) -> None:
    bones = {
        name: moved(item.distance.surface(closed=True), 0.0, -0.8, 0.0)
        for name, item in block_head.deep.items()
    }
    laid, rms = lay_on(block_head, block_head.tissue, bones, 1.0)
    assert rms < 0.2
    elements = np.arange(block_head.tissue.n_elements)
    inner, outer = (
        laid.evaluate(elements, np.tile([0.5, 0.5, end], (len(elements), 1)))
        - block_head.tissue.evaluate(elements, np.tile([0.5, 0.5, end], (len(elements), 1)))
        for end in (0.0, 1.0)
    )
    assert np.abs(outer).max() < 1e-9
    assert np.median(inner[:, 1]) == pytest.approx(-0.8, abs=0.3)


def test_what_is_wrong_with_the_structures_is_said_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], taro: Head
) -> None:
    empty, other, twice = (tmp_path / name for name in ("empty", "other", "twice"))
    for folder in (empty, other, twice):
        folder.mkdir()
    part = outer_surface(taro.muscles["mentalis"])
    write(other / "mentalis.ply", part)
    write(twice / "mentalis.stl", part)
    image = tmp_path / "labels.nii.gz"
    image.write_bytes(b"")
    cases = [
        ([empty], "no surfaces"),
        ([other], "skin"),
        ([other, twice], "second"),
        ([image], "--labels"),
        ([other, "--labels", tmp_path / "names.toml"], "label maps"),
        ([tmp_path / "missing"], "no such"),
    ]
    for given, fault in cases:
        command = ["build", *map(str, given), "--out", str(tmp_path / "head"), "-q"]
        assert _run(command) == 2, given
        message = capsys.readouterr().err
        assert message.count("\n") == 1 and fault in message, message
    assert not (tmp_path / "head").exists()


@pytest.mark.slow
def test_labels_of_a_simulated_image_make_the_head_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], taro: Head
) -> None:
    pytest.importorskip("SimpleITK", reason="the extra [images] is not installed")
    from modiolus.anatomy.labels import write_labels
    from modiolus.face.phantom import simulated_t1

    phantom = simulated_t1(taro)
    picked = ["zygomaticus_major", "orbicularis_oris_upper"]
    names = {key: n for key, n in phantom.names.items() if key.rpartition("_")[0] in picked}
    assert len(names) == 4
    write_labels(tmp_path, phantom.labels, names)
    write(tmp_path / "skin.ply", phantom.skin)
    out = tmp_path / "again"
    command = ["build", str(tmp_path / "skin.ply"), str(tmp_path / "labels.nii.gz"), "--labels"]
    command += [str(tmp_path / "labels.toml"), "--out", str(out), "--json", "--quiet"]
    assert _run(command) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["quality"]["scan_rms_mm"] < 0.3
    head = Head.load(out)
    assert record["provenance"] == head.about["provenance"]
    given = [key for key, text in record["provenance"].items() if text.startswith("given")]
    assert given == ["skin", *(key for key in taro.muscles if key in picked)]
    assert "zygomaticus_major" in provenance_lines(head.about)[0]
    for name in picked:
        # Voxels of 1 mm lose the frayed end of a strap: it is fitted to what is left.
        assert record["quality"]["given_rms_mm"][name] < 0.55
        old, new = (outer_surface(item.muscles[name]) for item in (taro, head))
        gap = np.concatenate(
            [old.closest(new.samples(1.0)).distance, new.closest(old.samples(1.0)).distance]
        )
        assert np.sqrt(np.mean(gap**2)) < 0.9
