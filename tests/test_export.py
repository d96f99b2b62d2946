"""Files for other programs, read back."""

import json
import shutil
import struct
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse as sp

from modiolus.cli import main
from modiolus.errors import InputError
from modiolus.export import Shape, in_turn, vertex_normals, write_glb, write_vtu
from modiolus.export.scene import FaceScene
from modiolus.export.usd import write_usd
from modiolus.face.head import Head
from modiolus.hermite import HermiteMesh, bricks, outward
from modiolus.hermite.tessellate import Mirror, tessellate
from modiolus.mechanics import Load
from modiolus.mechanics.face import Face, FaceSettings
from modiolus.scans.result import STATE_FILE, save_state

SKIN = Shape(np.eye(3), np.array([[0, 1, 2]]), (1.0, 1.0, 1.0), "skin")


def block(counts=(3, 2, 1)):
    """A straight block of 30 x 20 x 10 mm."""
    return bricks([np.linspace(0.0, 10.0 * n, n + 1) for n in counts])


def volumes(points, hexahedra):
    corners = points[hexahedra]
    edges = np.stack([corners[:, k] - corners[:, 0] for k in (1, 3, 4)], axis=1)
    return np.linalg.det(edges)


def test_volume_is_filled_by_hexahedra_with_shared_corners():
    mesh = block()
    volume = tessellate(mesh, 3)
    points = volume.points(mesh.parameters)
    assert len(points) == (3 * 3 + 1) * (2 * 3 + 1) * (3 + 1)
    assert volumes(points, volume.cells).min() > 0.0
    assert volumes(points, volume.cells).sum() == pytest.approx(6000.0)
    # Samples know their vertex, so values given at samples come back as they are.
    sampled = mesh.evaluate(volume.elements, volume.xi)
    np.testing.assert_allclose(volume.average(sampled), points, atol=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", [0, 1])
def test_faces_of_a_block_look_outwards(axis, side):
    mesh = block((1, 1, 1))
    surface = tessellate(mesh.face([0], axis, side), 4, outward(axis, side))
    triangles = surface.points(mesh.parameters)[surface.cells]
    area = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]).sum(
        axis=0
    )
    expected = np.zeros(3)
    expected[axis] = 200.0 * (1 if side else -1)
    np.testing.assert_allclose(area, expected, atol=1e-9)


def test_sides_are_one_surface_that_looks_outwards():
    mesh = block((2, 1, 1))
    sides = [([0, 1], axis, side) for axis in (1, 2) for side in (0, 1)]
    surface, signs = mesh.boundary([([0], 0, 0), ([1], 0, 1), *sides])
    closed = tessellate(surface, 2, signs)
    corners = closed.points(mesh.parameters)[closed.cells]
    assert np.linalg.det(corners).sum() / 6.0 == pytest.approx(2000.0)
    assert surface.parameters is mesh.parameters


def test_touching_sides_of_a_slit_stay_apart():
    """Two blocks that touch but share no parameters keep their own vertices."""
    lower, upper = block((1, 1, 1)), block((1, 1, 1))
    raised = upper.parameters.copy()
    raised[::8, 2] += 10.0
    both = HermiteMesh(
        3,
        np.concatenate([lower.parameters, raised]),
        sp.csr_matrix(sp.block_diag([lower.extraction, upper.extraction])),
    )
    assert tessellate(both, 2).functions.shape[0] == 2 * 27


def test_mirror_closes_the_middle():
    mesh = block((2, 1, 1))
    face = mesh.face(np.arange(2), 2, 1)
    half = tessellate(face, 2)
    points = half.points(mesh.parameters)
    whole = Mirror.of(points, half.cells, plane=0.0)
    # 5 x 3 vertices on the half, of which 3 lie in the plane.
    assert len(whole.source) == 2 * 15 - 3
    triangles = whole.points(points)[whole.faces]
    area = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]).sum(
        axis=0
    )
    np.testing.assert_allclose(area, [0.0, 0.0, 2 * 400.0], atol=1e-9)


def read_glb(path):
    """Return the JSON of a binary glTF file and a function that reads an accessor."""
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON"
    content = json.loads(data[20 : 20 + size])
    blob = data[20 + size + 8 :]

    def accessor(number):
        record = content["accessors"][number]
        view = content["bufferViews"][record["bufferView"]]
        dtype = {5126: np.float32, 5125: np.uint32}[record["componentType"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}[record["type"]]
        start = view.get("byteOffset", 0)
        array = np.frombuffer(blob, dtype, record["count"] * width, start)
        return array.reshape(-1, width)

    return content, accessor


def test_glb_holds_shapes_and_morph_targets(tmp_path):
    vertices = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 0.0, 10.0]])
    faces = np.array([[0, 1, 2]])
    skin = Shape(vertices, faces, (1.0, 0.5, 0.0), "skin")
    layout = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.25]])
    teeth = Shape(vertices + 5.0, faces, (1.0, 1.0, 1.0), "teeth", layout=layout)
    moved = vertices + np.array([1.0, 2.0, 3.0])
    path = tmp_path / "face.glb"
    write_glb(path, [skin, teeth], {"skin": {"smile": moved}}, attribution="somebody")
    content, accessor = read_glb(path)

    assert content["asset"]["copyright"] == "somebody"
    assert [node["name"] for node in content["nodes"]] == ["skin", "teeth"]
    mesh = content["meshes"][0]
    assert mesh["extras"]["targetNames"] == ["smile"]
    assert mesh["weights"] == [0.0]
    primitive = mesh["primitives"][0]
    # +x stays, +z of the head points up (+y), the front of the face (-y) to +z; in metres.
    np.testing.assert_allclose(
        accessor(primitive["attributes"]["POSITION"]),
        [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 0.01, 0.0]],
        atol=1e-9,
    )
    np.testing.assert_allclose(
        accessor(primitive["targets"][0]["POSITION"]),
        np.tile([0.001, 0.003, -0.002], (3, 1)),
        atol=1e-9,
    )
    normals = accessor(primitive["attributes"]["NORMAL"])
    np.testing.assert_allclose(normals, np.tile([0.0, 0.0, 1.0], (3, 1)), atol=1e-6)
    np.testing.assert_array_equal(accessor(primitive["indices"]).ravel(), [0, 1, 2])
    assert "TEXCOORD_0" not in primitive["attributes"]
    # v is counted from the upper edge.
    coordinates = content["meshes"][1]["primitives"][0]["attributes"]["TEXCOORD_0"]
    np.testing.assert_allclose(accessor(coordinates), [[0.0, 1.0], [1.0, 1.0], [0.0, 0.75]])
    for number, record in enumerate(content["accessors"]):
        if "min" in record:
            np.testing.assert_allclose(accessor(number).min(axis=0), record["min"])


@pytest.mark.parametrize("name", ["taro", "ict"])
def test_no_two_places_of_the_skin_share_one_of_its_texture(name):
    skin, *_ = FaceScene(Head.load(name), divisions=2).shapes(Head.load(name).tissue.parameters)
    assert skin.layout.min() > 0.0 and skin.layout.max() < 1.0
    first, second, third = (skin.layout[skin.faces[:, k]] for k in range(3))
    along, across = second - first, third - first
    double = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
    assert double.min() > 0.0
    # With one orientation everywhere, points that lie in one triangle at most prove the rest.
    points = np.random.default_rng(0).uniform(0.0, 1.0, (2000, 1, 2)) - first
    b = (points[..., 0] * across[:, 1] - points[..., 1] * across[:, 0]) / double
    c = (along[:, 0] * points[..., 1] - along[:, 1] * points[..., 0]) / double
    hits = ((b > 0.0) & (c > 0.0) & (b + c < 1.0)).sum(axis=1)
    assert hits.max() == 1 and hits.mean() == pytest.approx(0.5 * double.sum(), abs=0.03)


def test_heads_of_one_template_share_the_layout_and_the_halves_meet():
    scenes = [FaceScene(Head.load(name), divisions=1) for name in ("taro", "ict")]
    np.testing.assert_array_equal(scenes[0].layout, scenes[1].layout)
    scene, rest = scenes[0], scenes[0].skin_points(Head.load("taro").tissue.parameters)
    middle = np.abs(rest[:, 0] - scene.skin_mirror.plane) < 1e-3
    np.testing.assert_allclose(scene.layout[middle, 0], 0.5)
    assert ((scene.layout[:, 0] > 0.5) == (rest[:, 0] > scene.skin_mirror.plane + 1e-3)).all()


def test_vtu_is_read_back(tmp_path):
    import pyvista

    mesh = block()
    volume = tessellate(mesh, 2)
    points = volume.points(mesh.parameters)
    moved = np.full(points.shape, 2.0)
    path = tmp_path / "tissue.vtu"
    write_vtu(path, points, volume.cells, {"displacement": moved, "J": np.ones(len(points))})
    read = pyvista.read(path)
    assert read.n_cells == 6 * 8
    assert read.volume == pytest.approx(6000.0)
    assert set(read.point_data) == {"displacement", "J"}
    np.testing.assert_array_equal(read.point_data["displacement"], moved)


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (lambda path: write_vtu(path, np.zeros((7, 3)), np.arange(8)[None], {}), "hexahedra: 7"),
        (lambda path: write_vtu(path, np.zeros((8, 3)), np.arange(6)[None], {}), "6 corners"),
        (lambda path: write_vtu(path, np.zeros((8, 2)), np.arange(8)[None], {}), "points: shape"),
        (
            lambda path: write_vtu(path, np.zeros((8, 3)), np.arange(8)[None], {"J": np.ones(3)}),
            "J: shape",
        ),
        (lambda path: write_glb(path, [], {}), "shapes"),
        (lambda path: write_glb(path, [SKIN], {"nose": {"a": SKIN.vertices}}), "0 shapes"),
        (lambda path: write_glb(path, [SKIN, SKIN], {"skin": {"a": SKIN.vertices}}), "2 shapes"),
        (lambda path: write_glb(path, [SKIN], {"skin": {"a": SKIN.vertices[:2]}}), "a: shape"),
        (lambda path: write_glb(path, [SKIN], {"skin": {"a": np.nan * SKIN.vertices}}), "a: .*NaN"),
    ],
)
def test_what_makes_no_file_is_refused(tmp_path, write, words):
    with pytest.raises(InputError, match=words):
        write(tmp_path / "file")
    assert not list(tmp_path.iterdir())


def test_a_place_that_cannot_be_written_is_named(tmp_path, capfd):
    with pytest.raises(OSError, match="gone") as error:
        write_vtu(tmp_path / "gone" / "a.vtu", np.zeros((8, 3)), np.arange(8)[None], {})
    assert error.value.filename.endswith("a.vtu")
    assert capfd.readouterr() == ("", "")


def test_an_animation_lets_the_targets_come_and_go(tmp_path):
    up, down = SKIN.vertices + 1.0, SKIN.vertices - 1.0
    path = tmp_path / "face.glb"
    write_glb(path, [SKIN], {"skin": {"up": up, "down": down}}, keys=in_turn(2, 3.0))
    content, accessor = read_glb(path)
    (animation,) = content["animations"]
    (channel,), (sampler,) = animation["channels"], animation["samplers"]
    assert channel["target"] == {"node": 0, "path": "weights"}
    np.testing.assert_allclose(accessor(sampler["input"]).ravel(), [0.0, 1.5, 3.0, 4.5, 6.0])
    weights = accessor(sampler["output"]).reshape(5, 2)
    assert weights.tolist() == [[0, 0], [1, 0], [0, 0], [0, 1], [0, 0]]

    other = replace(SKIN, name="teeth")
    with pytest.raises(InputError, match="targets"):
        write_glb(
            path, [SKIN, other], {"skin": {"up": up}, "teeth": {"down": down}}, keys=in_turn(1, 1.0)
        )


def test_in_betweens_correct_a_target_on_its_way(tmp_path):
    """Played by the keys, the surface passes through every state that was given."""
    ways = {
        "nod": {1.0: [0.0, 3.0, 0.0], 1 / 3: [1.0, 1.0, 0.5], 2 / 3: [0.5, 2.5, 0.0]},
        "tilt": {1.0: [0.0, 0.0, 4.0], 1 / 3: [0.0, -1.0, 1.0], 2 / 3: [0.0, 0.0, 3.5]},
    }
    bend = np.array([[0.0], [1.0], [2.0]])
    targets, between = {}, {}
    for name, way in ways.items():
        for share, shift in way.items():
            part = name if share == 1.0 else f"{name}_{100 * share:.0f}"
            targets[part] = SKIN.vertices + bend * shift
            if share < 1.0:
                between[part] = name, share
    path = tmp_path / "face.glb"
    write_glb(path, [SKIN], {"skin": targets}, keys=in_turn(2, 3.0, 2), between=between)
    content, accessor = read_glb(path)
    (sampler,) = content["animations"][0]["samplers"]
    times = accessor(sampler["input"]).ravel()
    np.testing.assert_allclose(times, np.linspace(0.0, 6.0, 13))
    weights = accessor(sampler["output"]).reshape(len(times), -1)
    primitive = content["meshes"][0]["primitives"][0]
    for kind, scale in (("POSITION", 1000.0), ("NORMAL", 1.0)):
        deltas = np.stack([accessor(target[kind]) for target in primitive["targets"]])
        played = scale * (
            accessor(primitive["attributes"][kind]) + np.einsum("tk,kni->tni", weights, deltas)
        )
        for number, name in enumerate(ways):
            for step, part in enumerate([f"{name}_33", f"{name}_67", name, f"{name}_67"], 1):
                there = targets[part]
                if kind == "NORMAL":
                    there = vertex_normals(there, SKIN.faces)
                np.testing.assert_allclose(
                    played[6 * number + step], there[:, [0, 2, 1]] * [1, 1, -1], atol=1e-5
                )
    with pytest.raises(InputError, match="nod_33: in-between of shake"):
        write_glb(path, [SKIN], {"skin": targets}, between={"nod_33": ("shake", 0.3)})


def played_by_usd(path, code, name="skin"):
    """Return the points of a mesh at a time, as the library's own evaluation of skeletons has."""
    usd, skel = pytest.importorskip("pxr.Usd"), pytest.importorskip("pxr.UsdSkel")
    vt = pytest.importorskip("pxr.Vt")
    stage = usd.Stage.Open(str(path))
    mesh = stage.GetPrimAtPath(f"/Face/{name}")
    cache = skel.Cache()
    cache.Populate(skel.Root(stage.GetPrimAtPath("/Face")), usd.TraverseInstanceProxies())
    skeleton = cache.GetSkelQuery(skel.Skeleton(stage.GetPrimAtPath("/Face/Skeleton")))
    animation = skeleton.GetAnimQuery()
    names, weights = animation.GetBlendShapeOrder(), animation.ComputeBlendShapeWeights(code)
    order = cache.GetSkinningQuery(mesh).GetBlendShapeOrder()
    assert list(names) == list(order)
    shapes = skel.BlendShapeQuery(skel.BindingAPI(mesh))
    parts = shapes.ComputeSubShapeWeights(weights)
    points = vt.Vec3fArray(mesh.GetAttribute("points").Get())
    assert shapes.ComputeDeformedPoints(
        *parts,
        shapes.ComputeBlendShapePointIndices(),
        shapes.ComputeSubShapePointOffsets(),
        points,
    )
    return np.array(points), stage


def test_usd_knows_in_betweens(tmp_path):
    layout = np.array([[0.1, 0.2], [0.9, 0.2], [0.1, 0.8]])
    skin = replace(SKIN, layout=layout)
    way = {"smile-open": [0.0, 3.0, 0.0], "smile-open_25": [1.0, 1.0, 0.5], "up": [0.0, 0.0, 1.0]}
    targets = {name: SKIN.vertices + shift for name, shift in way.items()}
    path = tmp_path / "faces.usdc"
    between = {"smile-open_25": ("smile-open", 0.25)}
    write_usd(path, [skin], {"skin": targets}, "somebody", in_turn(2, 2.0), between)
    # A second has 24 codes: a quarter of the smile comes after a quarter of a second.
    for code, expected in [
        (0, SKIN.vertices),
        (6, targets["smile-open_25"]),
        (15, 0.5 * (targets["smile-open_25"] + targets["smile-open"])),
        (24, targets["smile-open"]),
        (72, targets["up"]),
    ]:
        points, stage = played_by_usd(path, code)
        np.testing.assert_allclose(points, expected, atol=1e-6)
    mesh = stage.GetPrimAtPath("/Face/skin")
    np.testing.assert_allclose(np.array(mesh.GetAttribute("primvars:st").Get()), layout)
    assert stage.GetMetadata("upAxis") == "Z" and stage.GetMetadata("metersPerUnit") == 0.001
    assert stage.GetRootLayer().customLayerData["copyright"] == "somebody"
    with pytest.raises(InputError, match="nod"):
        write_usd(path, [skin], {"skin": targets}, between={"up": ("nod", 0.5)})


def test_a_stage_that_cannot_be_written_is_named(tmp_path):
    pytest.importorskip("pxr.Usd")
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="could not write"):
        write_usd(tmp_path / "file" / "faces.usdc", [SKIN], {})


def test_usd_without_its_library_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr.Gf", None)
    with pytest.raises(InputError, match="extra usd"):
        write_usd(tmp_path / "faces.usdc", [SKIN], {})


@pytest.fixture(scope="module")
def states(tmp_path_factory):
    """Folders with two states of the shipped head, made by hand."""
    folder, head = tmp_path_factory.mktemp("states"), Head.load("taro")
    rest = head.tissue.parameters
    pressure = np.zeros(len(head.tissue.corner_nodes()[1]))
    for name, factor, jaw in [("wide", 1.02, 0.0), ("open", 1.0, 0.1)]:
        (folder / name).mkdir()
        file = folder / name / STATE_FILE
        moved, settings = rest * [factor, 1.0, 1.0], FaceSettings(sigma_max=250.0)
        save_state(file, name, head, "taro", moved, pressure, {}, jaw, settings=settings)
    return folder


def test_results_become_shape_keys_of_one_model(states, tmp_path, capsys):
    sources = [str(states / name) for name in ("wide", "open")]
    with pytest.raises(SystemExit) as left:
        main(["export", *sources, "--glb", str(tmp_path / "faces"), "--seconds", "2", "--json"])
    assert left.value.code == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["shape_keys"], record["seconds"]) == (["wide", "open"], 4.0)
    content, accessor = read_glb(Path(record["files"]["model"]))
    names = [node["name"] for node in content["nodes"]]
    keys = {
        name: mesh["extras"]["targetNames"]
        for name, mesh in zip(names, content["meshes"], strict=True)
        if "extras" in mesh
    }
    assert set(keys) == {"skin", "lining", "teeth_lower", "gums_lower", "mouth", "tongue"}
    assert all(value == ["wide", "open"] for value in keys.values())
    skin = content["meshes"][names.index("skin")]["primitives"][0]
    rest = accessor(skin["attributes"]["POSITION"])
    wide, still = (accessor(target["POSITION"]) for target in skin["targets"])
    # Half a head, widened from the origin and mirrored: its left half moves with the factor.
    left_half = rest[:, 0] > 0.0
    np.testing.assert_allclose(wide[left_half, 0], 0.02 * rest[left_half, 0], atol=2e-6)
    assert not still.any()
    assert len(content["animations"][0]["channels"]) == 6
    assert "CC" in (tmp_path / "faces/LICENSE").read_text()


def test_a_result_is_not_replaced_by_its_export(states, tmp_path, capsys):
    for name, option in [("wide", "--glb"), ("open", "--ex")]:
        shutil.copytree(states / name, tmp_path / name)
        # As simulate leaves it.
        (tmp_path / name / "report.json").write_text("{}")
        with pytest.raises(SystemExit) as left:
            main(["export", str(tmp_path / name), option, str(tmp_path / name)])
        assert left.value.code == 2
        assert f"{option} {tmp_path / name}: " in capsys.readouterr().err
        assert (tmp_path / name / STATE_FILE).is_file()


def test_states_on_the_way_are_computed_and_correct_the_key(states, tmp_path, capsys, monkeypatch):
    head, asked = Head.load("taro"), []
    rest = head.tissue.parameters

    def solve(self, activations, jaw, start, report):
        asked.append((self.settings.sigma_max, jaw, start is None))
        return SimpleNamespace(parameters=rest, load=Load(jaw=jaw))

    monkeypatch.setattr(Face, "solve", solve)
    target = tmp_path / "faces"
    with pytest.raises(SystemExit) as left:
        main(["export", str(states / "open"), "--glb", str(target), "--inbetweens", "3", "--json"])
    assert left.value.code == 0
    record = json.loads(capsys.readouterr().out)
    assert record["shape_keys"] == ["open", "open_25", "open_50", "open_75"]
    assert asked == [(250.0, 0.1 * share, share == 0.25) for share in (0.25, 0.5, 0.75)]
    content, accessor = read_glb(target / "faces.glb")
    names = [node["name"] for node in content["nodes"]]
    teeth = content["meshes"][names.index("teeth_lower")]["primitives"][0]
    whole, _, half, _ = (accessor(part["POSITION"]) for part in teeth["targets"])
    shown = {
        jaw: {shape.name: shape.vertices for shape in FaceScene(head).shapes(rest, jaw=jaw)}
        for jaw in (0.0, 0.05)
    }
    moved = 1e-3 * (shown[0.05]["teeth_lower"] - shown[0.0]["teeth_lower"])
    np.testing.assert_allclose(0.5 * whole + half, moved[:, [0, 2, 1]] * [1, 1, -1], atol=1e-6)
    # What a turning jaw makes of the straight line: a tenth of a millimetre here.
    assert 5e-5 < np.abs(half).max() < 5e-4


def test_results_become_blend_shapes_of_a_stage(states, tmp_path, capsys):
    pytest.importorskip("pxr.Usd")
    sources = [str(states / name) for name in ("wide", "open")]
    with pytest.raises(SystemExit) as left:
        main(["export", *sources, "--usd", str(tmp_path / "faces"), "--seconds", "2", "--json"])
    assert left.value.code == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["shape_keys"], record["seconds"]) == (["wide", "open"], 4.0)
    head = Head.load("taro")
    scene, rest = FaceScene(head), head.tissue.parameters
    shown = {shape.name: shape.vertices for shape in scene.shapes(rest, jaw=0.1)}
    for name in ("skin", "teeth_lower"):
        points, _ = played_by_usd(record["files"]["model"], 72, name)
        np.testing.assert_allclose(points, shown[name], atol=2e-4)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["wide", "wide"], "already"),
        (["wide", "none"], "none"),
        (["wide", "--seconds", "nan"], "--seconds"),
        (["wide", "--inbetweens", "10"], "--inbetweens 10"),
        (["wide", "--cmgui"], "--cmgui"),
    ],
)
def test_what_makes_no_model_is_refused(states, tmp_path, monkeypatch, capsys, arguments, word):
    monkeypatch.chdir(states)
    with pytest.raises(SystemExit) as left:
        main(["export", *arguments, "--glb", str(tmp_path / "faces")])
    error = capsys.readouterr().err
    assert left.value.code == 2 and error.count("\n") == 1 and word in error
    assert not list(tmp_path.iterdir())
