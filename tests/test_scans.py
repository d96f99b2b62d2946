"""Scans: what is read and refused, alignment, distances, and activations found from them."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from modiolus import hermite
from modiolus.anatomy.surface import Surface
from modiolus.cli import main
from modiolus.cli.compare import text_table
from modiolus.errors import InputError, SolveError
from modiolus.face.expression import Expression
from modiolus.face.landmarks import read_landmarks
from modiolus.fitting.register import Registration
from modiolus.mechanics import (
    Continuation,
    FibreQuadrature,
    Fibres,
    Problem,
    Settings,
    clamp,
)
from modiolus.mechanics.face import Face
from modiolus.scans import read_scan
from modiolus.scans.align import align_to_neutral, place, register_scan
from modiolus.scans.compare import compare, figures
from modiolus.scans.result import STATE_FILE, load_result, save_state
from modiolus.scans.scan import Scan
from modiolus.scans.skin import REGIONS


def write_ply(path, surface):
    rows = [" ".join(f"{x:.6f}" for x in point) for point in surface.vertices]
    rows += [f"3 {a} {b} {c}" for a, b, c in surface.faces]
    path.write_text(
        f"ply\nformat ascii 1.0\nelement vertex {len(surface.vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(surface.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
        + "\n".join(rows)
        + "\n"
    )


def assert_one_line(error, *words):
    text = str(error.value)
    assert "\n" not in text and ";" in text
    for word in words:
        assert word in text


# --- reading


@pytest.mark.parametrize("kind", [".ply", ".obj", ".stl", ".vtp"])
def test_surfaces_are_read_alike(kind, skin, taro, tmp_path):
    import pyvista as pv

    surface = skin.surface(taro.tissue.parameters)
    path = tmp_path / f"face{kind}"
    pv.PolyData.from_regular_faces(surface.vertices, surface.faces).save(path)
    scan = read_scan(path)
    assert scan.surface.area == pytest.approx(surface.area, rel=1e-4)
    assert scan.weights.sum() == pytest.approx(surface.area, rel=1e-4)
    near = skin.state(taro.tissue.parameters).feet(scan.points, scan.normals)
    # At the sharp edges of the margins the normal of a vertex is that of neither side.
    assert (near.distance < 0.01).mean() > 0.99


def test_a_cloud_gets_outward_normals_and_a_surface(skin, taro, tmp_path):
    surface = skin.surface(taro.tissue.parameters)
    rng = np.random.default_rng(0)
    exact = surface.samples(1.5)
    # A hole in the cheek, as where a light glared.
    gap = exact[np.argmin(np.linalg.norm(exact - taro.landmark_points()["cheek_left"], axis=1))]
    exact = exact[np.linalg.norm(exact - gap, axis=1) > 10.0]
    outward = surface.normals[surface.closest(exact).faces]
    turn = Rotation.from_euler("xyz", [0.3, 2.0, -1.0]).as_matrix()
    turned = (exact + 0.3 * rng.standard_normal((len(exact), 1)) * outward) @ turn.T + 500.0
    heading = "# made by a scanner\n"
    stray = turned.mean(axis=0) + 300.0 * rng.standard_normal((20, 3))
    rows = "\n".join(f"{x:.4f}, {y:.4f}, {z:.4f}" for x, y, z in [*turned, *stray])
    (tmp_path / "face.xyz").write_text(heading + rows + "\n")
    scan = read_scan(tmp_path / "face.xyz")
    # Points that fly about, as scanners leave them, are gone.
    assert scan.cloud and len(scan.points) == len(np.unique(np.round(turned, 4), axis=0))
    order = np.lexsort(np.round(turned, 4).T[::-1])
    assert np.mean((outward[order] * (scan.normals @ turn)).sum(axis=1) > 0.7) > 0.97
    assert scan.surface.area == pytest.approx(surface.area - 100.0 * np.pi, rel=0.05)
    away = surface.closest((scan.surface.vertices - 500.0) @ turn).distance
    assert np.sqrt((away**2).mean()) < 0.25
    hole = scan.surface.closest((gap @ turn.T + 500.0)[None]).distance
    assert hole[0] == pytest.approx(10.0, abs=2.0)


HEADER = "ply\nformat ascii 1.0\nelement vertex 1\n"
COORDINATES = "property float x\nproperty float y\nproperty float z\nend_header\n"
HOSTILE = (
    '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "c"><!ENTITY d "&b;&b;&b;&b;">]>'
    '<VTKFile type="PolyData"><PolyData>&d;<Piece/></PolyData></VTKFile>'
)
FLAT = "\n".join(f"{x:.3f} {x * x % 1:.3f} 0" for x in np.linspace(0.0, 7.0, 2000))


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("missing.ply", None, ["no such file"]),
        ("face.png", "x", [".ply"]),
        ("empty.ply", "", ["empty.ply"]),
        ("short.ply", HEADER + COORDINATES + "0 0 0\n", ["too few"]),
        ("lying.ply", HEADER.replace("x 1", "x 4000000000") + COORDINATES + "0", ["lying.ply"]),
        ("gone.obj", "v 1 2 3\nv 1 2\nf 1 2 99\n", ["gone.obj"]),
        ("hostile.vtp", HOSTILE, ["cannot be read as a surface"]),
        ("single.xyz", "1 2 3\n", ["1 points", "too few"]),
        ("words.xyz", "the quick brown fox\njumps over\n", ["no line of it holds three numbers"]),
        ("pairs.xyz", "1 2 3\n4 5 6\n7 8\n" * 400, ["line 3"]),
        ("nan.xyz", "nan 1 2\n" + FLAT, ["1 points are not finite"]),
        ("flat.xyz", FLAT, ["plane"]),
    ],
)
def test_bad_scans_are_refused_in_one_line(tmp_path, capfd, name, content, words):
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(InputError) as error:
        read_scan(tmp_path / name)
    assert_one_line(error, name, *words)
    # Libraries say nothing beside it.
    assert capfd.readouterr() == ("", "")


def test_half_a_scan_and_a_folder_are_refused(skin, taro, tmp_path):
    whole, cut = tmp_path / "whole.ply", tmp_path / "cut.ply"
    write_ply(whole, skin.surface(taro.tissue.parameters))
    content = whole.read_bytes()
    cut.write_bytes(content[: len(content) // 2])
    for path, word in ((cut, "cut.ply"), (tmp_path, "a folder")):
        with pytest.raises(InputError) as error:
            read_scan(path)
        assert_one_line(error, word)


# --- projection


def test_projection_is_exact_on_the_hermite_surface(skin, taro):
    rng = np.random.default_rng(1)
    elements, xi = rng.integers(0, 252, 400), rng.uniform(0.05, 0.95, (400, 2))
    points = skin.mesh.evaluate(elements, xi)
    normals = skin.outward_normals(skin.mesh, elements, xi)
    feet = skin.state(taro.tissue.parameters).feet(points + 0.4 * normals, normals)
    # At sharp concave places another point of the skin is nearer.
    assert (np.abs(feet.distance - 0.4) < 1e-9).mean() > 0.99
    assert feet.covered.mean() > 0.99
    mirrored = skin.state(taro.tissue.parameters).feet(taro.mirror(points + 0.4 * normals))
    assert mirrored.mirrored[points[:, 0] > taro.midplane + 1.0].all()
    np.testing.assert_allclose(mirrored.distance, feet.distance, atol=1e-6)


def test_an_upper_lip_never_projects_to_the_lower_one(skin, taro):
    margin = np.flatnonzero(skin.side == 1)
    rng = np.random.default_rng(2)
    elements = rng.choice(margin[margin >= 252], 200)
    xi = rng.uniform(0.1, 0.9, (200, 2))
    points = skin.mesh.evaluate(elements, xi)
    normals = skin.outward_normals(skin.mesh, elements, xi)
    # An upper lip that a scan has 1.5 mm lower: the lower lip of the head is nearer by far.
    low = points - [0.0, 0.0, 1.5]
    state = skin.state(taro.tissue.parameters)
    feet = state.feet(low, normals)
    assert np.isin(skin.side[feet.elements], [1, 0]).all()
    blind = state.feet(low)
    assert (skin.side[blind.elements] == 2).mean() > 0.5


def test_regions_cover_the_face_and_lie_where_they_should(skin, taro):
    centre = skin.mesh.evaluate(
        np.arange(skin.mesh.n_elements), np.full((skin.mesh.n_elements, 2), 0.5)
    )
    heights = {name: centre[skin.region == number, 2].mean() for number, name in enumerate(REGIONS)}
    order = ["neck", "chin", "lower_lip", "upper_lip", "nose", "lids", "brow", "forehead"]
    assert sorted(order, key=heights.get) == order
    corner = taro.landmark_points()["mouth_corner_left"]
    feet = skin.state(taro.tissue.parameters).feet(corner[None])
    assert REGIONS[skin.region[feet.elements[0]]] == "corners"


# --- alignment


def test_unknown_pose_and_unit_are_recovered(skin, taro):
    rng = np.random.default_rng(3)
    surface = skin.surface(taro.tissue.parameters)
    noisy = surface.vertices + 0.3 * rng.standard_normal((len(surface.vertices), 3))
    turn = Rotation.random(rng=rng).as_matrix()
    moved = (noisy @ turn.T + [300.0, -80.0, 1000.0]) / 1000.0
    scan = Scan.of(Surface(moved, surface.faces, "metres"))
    placed, _, alignment = place(scan, skin)
    error = np.linalg.norm(placed.points - noisy, axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.25
    assert alignment.pose.scale == pytest.approx(1000.0, rel=2e-3)
    assert alignment.scatter_mm < 1.0


def test_a_raised_forehead_does_not_move_a_pose_that_is_known(skin, taro):
    surface = skin.surface(taro.tissue.parameters)
    feet = skin.state(taro.tissue.parameters).feet(surface.vertices)
    height = 1.5 * (skin.zones(feet) == 0)
    raised = surface.vertices + height[:, None] * surface.vertex_normals
    neutral, scan = Scan.of(surface), Scan.of(Surface(raised, surface.faces, "raised"))
    known = Registration()
    found = align_to_neutral(scan, neutral, skin, known)
    assert found.pose is known
    assert found.deviation_mm > 0.5
    # The forehead that moved is no reason to leave a head unturned.
    turn = Rotation.from_euler("x", 4.0, degrees=True).as_matrix()
    turned = align_to_neutral(
        Scan.of(Surface(raised @ turn.T, surface.faces, "turned")), neutral, skin, known
    )
    assert Rotation.from_matrix(turned.pose.rotation @ turn).magnitude() < np.radians(1.0)


def test_landmarks_align_too_and_are_checked(skin, taro, tmp_path):
    surface = skin.surface(taro.tissue.parameters)
    turn = Rotation.from_euler("xyz", [170.0, 20.0, 130.0], degrees=True).as_matrix()
    scan = Scan.of(Surface(surface.vertices @ turn.T, surface.faces, "turned"))
    path = tmp_path / "landmarks.csv"
    names = ["mouth_corner_left", "mouth_corner_right", "chin", "inner_brow_left", "ala_left"]
    rows = ["name, x, y, z, by"]
    for name in names:
        point = turn @ taro.landmark_points()[name]
        rows.append(f"{name}, {point[0]}, {point[1]}, {point[2]}, hand")
    path.write_text("\n".join(rows) + "\n")
    placed, _, _ = place(scan, skin, landmarks=read_landmarks(path, taro))
    assert np.linalg.norm(placed.points - surface.vertices, axis=1).max() < 0.2
    path.write_text("\n".join(rows[:3]) + "\n")
    with pytest.raises(InputError) as error:
        read_landmarks(path, taro)
    assert_one_line(error, "at least three")
    path.write_text(rows[0] + "\nchin, 1, two, 3, hand\n")
    with pytest.raises(InputError) as error:
        read_landmarks(path, taro)
    assert_one_line(error, "line 2")


def test_what_is_no_face_is_refused(skin, taro):
    surface = skin.surface(taro.tissue.parameters)
    points = np.array(list(taro.landmark_points().values()))
    known = (points, points)
    mirrored = Surface(surface.vertices * [-1.0, 1.0, 1.0], surface.faces, "mirrored.ply")
    with pytest.raises(InputError) as error:
        register_scan(Scan.of(mirrored), skin)
    assert_one_line(error, "mirror")

    # Whoever says centimetres of a scan in millimetres has a giant.
    with pytest.raises(InputError) as error:
        register_scan(Scan.of(surface), skin, unit="cm", landmarks=known)
    assert_one_line(error, surface.name, "wrong unit", "seems to be in mm")

    # A rough sheet of paper.
    ticks = np.linspace(0.0, 200.0, 60)
    x, y = (grid.ravel() for grid in np.meshgrid(ticks, ticks))
    z = 15.0 * np.sin(x / 9.0) * np.cos(y / 7.0)
    corner = (np.arange(59)[:, None] * 60 + np.arange(59)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + 61], axis=1),
            np.stack([corner, corner + 61, corner + 60], axis=1),
        ]
    )
    sheet = Surface(np.column_stack([x, y, z]), faces, "sheet.ply")
    with pytest.raises(InputError) as error:
        register_scan(Scan.of(sheet), skin)
    assert_one_line(error, "sheet.ply", "no face")


# --- comparison


def test_figures_weigh_by_area():
    found = figures(np.array([1.0, 3.0]), np.array([3.0, 1.0]))
    assert found.mean == pytest.approx(1.5)
    assert found.rms == pytest.approx(np.sqrt(3.0))
    assert found.max == 3.0
    assert figures(np.zeros(0), np.zeros(0)).as_dict()["rms_mm"] is None


def test_a_known_displacement_gives_its_own_figures(skin, taro):
    rest = taro.tissue.parameters
    moved = rest.copy()
    # Two millimetres forward everywhere.
    moved[:, 1] -= 2.0 * taro.both.ones
    neutral = Scan.of(skin.surface(rest))
    scan = Scan.of(skin.surface(moved))
    right = compare(skin, moved, scan, neutral)
    assert right.distances.error[right.distances.covered].max() < 1e-6
    assert right.matched.explained == pytest.approx(1.0, abs=1e-6)
    assert right.distances.explained > 0.999
    wrong = compare(skin, rest, scan, neutral)
    everywhere = np.ones(len(scan.points), dtype=bool)
    assert wrong.matched.of(wrong.matched.error, everywhere).rms == pytest.approx(2.0)
    assert wrong.matched.explained == pytest.approx(0.0)
    assert wrong.distances.explained == pytest.approx(0.0)
    # Along the normal, two millimetres forward are less wherever the face turns away.
    assert 1.0 < wrong.distances.of(wrong.distances.error, everywhere).rms < 2.0
    half = rest.copy()
    half[:, 1] -= taro.both.ones
    assert compare(skin, half, scan, neutral).matched.explained == pytest.approx(0.5)
    report = json.loads(json.dumps(right.as_dict(), allow_nan=False))
    assert {"nose", "chin", "cheek", "corners"} <= set(report["regions"])
    assert 0.8 < report["coverage"] <= 1.0


def test_without_a_common_order_distances_still_tell(skin, taro):
    rest = taro.tissue.parameters
    moved = rest.copy()
    moved[:, 1] -= 2.0 * taro.both.ones
    scan = Scan.of(skin.surface(moved))
    coarse = Surface(skin.surface(rest).vertices, skin.surface(rest).faces[::-1], "other")
    found = compare(skin, moved, scan, Scan.of(coarse))
    assert found.matched is None
    assert found.distances.explained > 0.99


# --- states


def test_a_state_is_kept_exactly_and_knows_its_head(taro, tmp_path):
    moved = taro.tissue.parameters + 0.125
    save_state(
        tmp_path / STATE_FILE, "x", taro, "taro", moved, np.zeros(8), {"mentalis": 0.25}, 0.1
    )
    found = load_result(tmp_path)
    assert np.array_equal(found.parameters, moved)
    assert (found.expression, found.activations, found.jaw) == ("x", {"mentalis": 0.25}, 0.1)

    assert found.offsets == {}

    offsets = {"skull": np.array([0.0, 0.125]), "lip": np.array([0.5])}
    save_state(
        *(tmp_path / STATE_FILE, "x", taro, "taro", moved, np.zeros(8), {}, 0.0), offsets=offsets
    )
    kept = load_result(tmp_path).offsets
    assert kept.keys() == offsets.keys()
    assert all(np.array_equal(kept[name], values) for name, values in offsets.items())

    whole = taro.both.whole(moved)
    save_state(tmp_path / STATE_FILE, "x", taro, "taro", whole, np.zeros(8), {}, 0.0)
    assert np.array_equal(load_result(tmp_path).parameters, whole)

    save_state(tmp_path / STATE_FILE, "x", taro, "taro", moved[:-1], np.zeros(8), {}, 0.0)
    with pytest.raises(InputError) as error:
        load_result(tmp_path)
    assert_one_line(error, "no state of the head taro")
    for fault, activations, jaw in [
        ("mentalis", {"mentalis": 7.0}, 0.0),
        ("mentalus", {"mentalus": 0.5}, 0.0),
        ("jaw", {}, 99.0),
    ]:
        save_state(tmp_path / STATE_FILE, "x", taro, "taro", moved, np.zeros(8), activations, jaw)
        with pytest.raises(InputError) as error:
            load_result(tmp_path)
        assert_one_line(error, fault)
    (tmp_path / STATE_FILE).write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(InputError) as error:
        load_result(tmp_path)
    assert_one_line(error, STATE_FILE)
    (tmp_path / STATE_FILE).unlink()
    with pytest.raises(InputError) as error:
        load_result(tmp_path)
    assert_one_line(error, "simulate")


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [
        ("muscles", None, "muscles"),
        ("muscles", np.array(0.5), "pair"),
        ("muscles", np.array([["mentalis"]]), "pair"),
        ("muscles", np.array([7.0]), "7.0"),
        ("activations", np.array([[0.25]]), "pair"),
        ("activations", np.array([np.nan]), "finite"),
        ("activations", np.array(["much"]), "much"),
        ("expression", np.array("../x"), "expression"),
        ("jaw", np.array([0.1, 0.2]), "state"),
        ("pressure", np.array([np.inf]), "finite"),
        ("pressure", np.array([1e300]), "large"),
        ("settings", np.array("[1"), "state"),
        ("settings", np.array("[1]"), "settings"),
        ("settings", np.array('{"skin": "thick"}'), "settings"),
        ("head", np.array("../../nowhere"), "nowhere"),
        ("contacts", None, "contacts"),
        ("contacts", np.array(["lip", "lid"]), "pair"),
        ("points", np.array([2.0]), "pair"),
        ("points", np.array([3]), "each point"),
        ("offsets", np.array([0.1, -0.1]), "each point"),
        ("offsets", np.array([0.1, np.nan]), "finite"),
        ("offsets", np.array([0.1, 1e9]), "large"),
        ("offsets", np.array(["deep"]), "deep"),
    ],
)
def test_arrays_that_make_no_state_are_refused(taro, tmp_path, name, value, word):
    path = tmp_path / STATE_FILE
    parameters = taro.tissue.parameters
    save_state(
        *(path, "x", taro, "taro", parameters, np.zeros(8), {"mentalis": 0.25}, 0.1),
        offsets={"lip": np.array([0.0, 0.1])},
    )
    with np.load(path) as archive:
        arrays = dict(archive)
    del arrays[name]
    np.savez(path, **arrays, **({} if value is None else {name: value}))
    with pytest.raises(InputError) as error:
        load_result(tmp_path)
    assert_one_line(error, word)


def test_a_state_without_offsets_is_read(taro, tmp_path):
    path = tmp_path / STATE_FILE
    save_state(path, "x", taro, "taro", taro.tissue.parameters, np.zeros(8), {}, 0.0)
    with np.load(path) as archive:
        arrays = dict(archive)
    for name in ("contacts", "points", "offsets"):
        del arrays[name]
    np.savez(path, **arrays)
    assert load_result(tmp_path).offsets == {}


def test_a_state_that_no_face_can_be_in_is_refused(taro, tmp_path):
    parameters = taro.tissue.parameters.copy()
    parameters[7, 1] = -1e300
    save_state(tmp_path / STATE_FILE, "x", taro, "taro", parameters, np.zeros(8), {}, 0.0)
    with pytest.raises(InputError) as error:
        load_result(tmp_path)
    assert_one_line(error, "large")


# --- identification


def two_muscles():
    """A block held at one end, with a muscle along each of two diagonals."""
    ticks = [np.linspace(0.0, s, n + 1) for n, s in zip((3, 1, 1), (30.0, 10.0, 10.0), strict=True)]
    mesh = hermite.grid(np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1))
    elements, xi, weights = mesh.gauss_points(4)
    directions = np.where((xi[:, 2] > 0.5)[:, None], [0.8, 0.6, 0.0], [0.8, -0.6, 0.0])
    rule = FibreQuadrature(elements, xi, weights, directions, (xi[:, 2] > 0.5).astype(np.int64))
    return Problem(
        mesh,
        [2.0, 0.5, 0.0],
        kappa=50.0,
        terms=[Fibres(mesh, rule, ["low", "high"])],
        fixed=clamp(mesh, [0], 0, 0, slope=True),
    )


def test_sensitivities_agree_with_finite_differences():
    problem = two_muscles()
    fine = Settings(tolerance=1e-12, passing=1e-6)
    continuation = Continuation(problem, settings=fine)
    base = {"low": 0.03, "high": 0.05}
    continuation.run(problem.load(base))
    found = continuation.sensitivities(["low", "high"])
    size = np.abs(found).max()
    for k, name in enumerate(("low", "high")):
        ends = []
        for step in (1e-5, -1e-5):
            trial = Continuation(problem, continuation.state, settings=fine)
            ends.append(trial.run(problem.load({**base, name: base[name] + step})).parameters)
        slope = (ends[0] - ends[1]) / 2e-5
        assert np.abs(slope - found[:, :, k]).max() < 1e-6 * size


# --- the command line


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as left:
        main([str(argument) for argument in arguments])
    printed = capsys.readouterr()
    return left.value.code, printed.out, printed.err


def test_compare_writes_page_picture_and_report(capsys, taro, skin, tmp_path):
    rest = taro.tissue.parameters
    moved = rest.copy()
    moved[:, 1] -= 2.0 * taro.both.ones
    (tmp_path / "result").mkdir()
    save_state(tmp_path / "result" / STATE_FILE, "x", taro, "taro", moved, np.zeros(8), {}, 0.0)
    write_ply(tmp_path / "scan.ply", skin.surface(moved))
    write_ply(tmp_path / "neutral.ply", skin.surface(rest))
    code, out, error = run(
        capsys,
        *("compare", tmp_path / "result", "--scan", tmp_path / "scan.ply"),
        *("--neutral", tmp_path / "neutral.ply", "--json"),
    )
    assert code == 0, error
    record = json.loads(out)
    # Moved as a whole, the scan is aligned back on its still parts: the model is what is off.
    assert record["still"]["rms_mm"] < 0.05
    assert record["error"]["rms_mm"] > 1.0
    page = (tmp_path / "result" / "compare-scan" / "compare.html").read_text()
    assert page.count("data:image/png;base64,") == 1


def test_validate_computes_expressions_and_tells_those_that_fail(
    capsys, taro, skin, tmp_path, monkeypatch
):
    rest = taro.tissue.parameters
    moved = rest.copy()
    moved[:, 1] -= 2.0 * taro.both.ones
    folder = tmp_path / "anna"
    folder.mkdir()
    for name, parameters in (("neutral", rest), ("sad", moved), ("terror", moved), ("mine", rest)):
        write_ply(folder / f"{name}.ply", skin.surface(parameters))

    def solve(face, activations, jaw_open=0.0, start=None, report=None):
        if "corrugator_supercilii" not in activations:
            raise SolveError("the tissue cannot follow; take less")
        return SimpleNamespace(parameters=moved)

    monkeypatch.setattr(Face, "solve", solve)
    sad = Expression.shipped("sad").activations
    monkeypatch.setattr(
        Expression,
        "shipped",
        lambda name: Expression(name, sad if name == "sad" else {"mentalis": 0.1}),
    )
    code, out, error = run(
        capsys,
        *("validate", folder, "--head", "taro", "--activations", "hand", "--posed"),
        *("--expressions", "terror,sad", "--out", tmp_path / "out", "--json", "--quiet"),
    )
    assert (code, error.count("\n")) == (1, 1) and "terror" in error
    first, second = json.loads(out)["table"]
    # The paper's order; the scans are in one frame and have not been aligned again.
    assert (first["expression"], second["expression"]) == ("sad", "terror")
    assert first["rms_mm"] < 0.05 and first["explained"] > 0.95
    assert first["matched"]["still_rms_mm"] == pytest.approx(2.0, abs=0.01)
    assert second["rms_mm"] is None and "cannot follow" in second["fault"]
    page = (tmp_path / "out" / "validate-anna" / "validate.html").read_text()
    assert page.count("data:image/png;base64,") == 1


def test_commands_refuse_in_one_line(capsys, tmp_path, taro):
    save_state(
        tmp_path / STATE_FILE, "x", taro, "taro", taro.tissue.parameters, np.zeros(8), {}, 0.0
    )
    (tmp_path / "single.xyz").write_text("0 0 0\n")
    for arguments, word in [
        (("compare", tmp_path, "--scan", tmp_path / "single.xyz"), "too few"),
        (("compare", tmp_path, "--scan", "none.ply"), "none.ply"),
        (("compare", tmp_path / "none", "--scan", "none.ply"), "simulate"),
        (("compare", tmp_path, "--scan", "none.ply", "--unit", "km"), "unit"),
        (("identify", "--scan", "none.ply", "--muscles", "biceps"), "biceps"),
        (("identify", "--scan", "none.ply"), "none.ply"),
        (("validate", tmp_path / "none"), "none"),
        (("validate", tmp_path, "--activations", "foot"), "foot"),
        (("validate", tmp_path), "neutral"),
    ]:
        code, out, error = run(capsys, *arguments)
        assert (code, out, error.count("\n")) == (2, "", 1), error
        assert word in error


def test_a_table_has_words_to_the_left_and_numbers_to_the_right():
    text = text_table(
        ("frame", "rms", "most active"), [["f1", 0.126, "–"], ["f10", None, "nasalis"]]
    )
    assert text.splitlines() == [
        "frame   rms  most active",
        "f1     0.13  –",
        "f10       –  nasalis",
    ]
