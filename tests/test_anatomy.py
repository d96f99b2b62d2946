import os
import struct
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from modiolus.anatomy import (
    DEEP_STRUCTURES,
    MIDPLANE,
    STRUCTURES,
    BodyParts3D,
    DistanceGrid,
    MirroredDistance,
    Surface,
    deep_distances,
    read_surface,
)
from modiolus.anatomy.ply import read_ply
from modiolus.anatomy.surface import check_face
from modiolus.errors import InputError

FOLDER = Path(
    os.environ.get("MODIOLUS_ANATOMY", Path(__file__).parents[2] / "shared/anatomy/bodyparts3d")
)
needs_anatomy = pytest.mark.skipif(
    not FOLDER.is_dir(), reason=f"no BodyParts3D at {FOLDER}; set MODIOLUS_ANATOMY to the folder"
)


def box(size=(2.0, 3.0, 4.0), at=(0.0, 0.0, 0.0)):
    corners = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)], float)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return Surface(corners * size + at, faces, "box")


def ball(radius, n=48):
    import pyvista as pv

    mesh = pv.Sphere(radius=radius, theta_resolution=2 * n, phi_resolution=n)
    return Surface(mesh.points, mesh.regular_faces, "ball")


def write_ply(surface, path):
    head = (
        f"ply\nformat ascii 1.0\nelement vertex {len(surface.vertices)}\nproperty float x\n"
        f"property float y\nproperty float z\nelement face {len(surface.faces)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    rows = [" ".join(map(str, v)) for v in surface.vertices]
    rows += ["3 " + " ".join(map(str, f)) for f in surface.faces]
    path.write_text(head + "\n".join(rows) + "\n")


def test_box_has_its_volume_area_and_outward_normals():
    surface = box()
    assert_allclose(surface.volume, 24.0, rtol=1e-14)
    assert_allclose(surface.area, 2 * (6 + 8 + 12), rtol=1e-14)
    outward = surface.vertices[surface.faces].mean(axis=1) - surface.vertices.mean(axis=0)
    assert ((outward * surface.normals).sum(axis=1) > 0).all()


def test_mirror_image_keeps_its_volume():
    mirrored = box().mirrored()
    assert_allclose(mirrored.volume, 24.0, rtol=1e-14)
    assert_allclose(mirrored.bounds[:, 0], [2 * MIDPLANE - 2.0, 2 * MIDPLANE])


def test_largest_component_drops_fragments():
    fragment = Surface([[9.0, 0, 0], [10, 0, 0], [9, 1, 0]], [[0, 1, 2]])
    whole = Surface.joined([fragment, box()])
    assert len(whole.components()) == 2
    assert_allclose(whole.largest_component().volume, 24.0)


def test_closest_point_and_signed_distance_of_a_box():
    surface = box()
    points = np.array([[1.0, 1.5, 0.25], [1.0, 1.5, 6.0], [-1.0, -1.0, 1.0]])
    assert_allclose(surface.signed_distance(points), [-0.25, 2.0, np.sqrt(2.0)], rtol=1e-12)
    assert_allclose(surface.closest(points).points[1], [1.0, 1.5, 4.0], atol=1e-12)


def test_samples_lie_on_the_surface_and_cover_it_evenly():
    surface = box()
    points = surface.samples(0.1)
    assert len(points) == round(surface.area / 0.01)
    assert_allclose(surface.closest(points).distance, 0.0, atol=1e-12)
    assert_allclose(points[np.isclose(points[:, 2], 4.0)].mean(axis=0), [1, 1.5, 4], atol=0.02)
    assert_array_equal(points, surface.samples(0.1))
    with pytest.raises(InputError, match="spacing 0"):
        surface.samples(0.0)


def test_reader_reads_what_was_written(tmp_path):
    write_ply(box(), tmp_path / "box.ply")
    surface = read_surface(tmp_path / "box.ply")
    assert surface.name == "box"
    assert_allclose(surface.volume, 24.0)


def test_reader_merges_the_vertices_of_stl(tmp_path):
    import pyvista as pv

    pv.Box().triangulate().save(tmp_path / "box.stl")
    assert read_surface(tmp_path / "box.stl").vertices.shape == (8, 3)


HEADER = (
    "ply\nformat {} 1.0\ncomment made by hand\nelement vertex 5\nproperty float x\n"
    "property double y\nproperty uchar red\nproperty float z\n{}element face {}\n"
    "property list {} int vertex_indices\nproperty short part\nend_header\n"
)
ROWS = [
    (0.0, 0.0, 9, 0.5),
    (1.0, 0.0, 9, 0.5),
    (1.0, 2.0, 9, 0.5),
    (0.0, 2.0, 9, 0.5),
    (3, 1, 9, 1),
]
KINDS = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}


def write_polygons(path, order, faces, grid="", counted="uchar"):
    """Write the points of `ROWS` and some polygons; `grid` is an element of lists before them."""
    lists = [] if not grid else [(), (7,), (), (8, 9)]
    between = f"element {grid} {len(lists)}\nproperty list uchar int indices\n" if grid else ""
    head = HEADER.format(KINDS[order], between, len(faces), counted)
    if not order:
        lines = [*ROWS, *((len(row), *row) for row in lists)]
        lines += [(len(face), *face, 1) for face in faces]
        body = "\n".join(" ".join(str(value) for value in line) for line in lines).encode()
    else:
        length = {"uchar": "B", "int": "i"}[counted]
        body = b"".join(struct.pack(f"{order}fdBf", *row) for row in ROWS)
        body += b"".join(struct.pack(f"{order}B{len(row)}i", len(row), *row) for row in lists)
        for face in faces:
            body += struct.pack(f"{order}{length}{len(face)}ih", len(face), *face, 1)
    path.write_bytes(head.encode() + body)


@pytest.mark.parametrize("order", KINDS)
@pytest.mark.parametrize("grid", ["", "range_grid"])
def test_polygons_of_any_size_and_byte_order_are_read(tmp_path, order, grid):
    path = tmp_path / "face.ply"
    write_polygons(path, order, [(0, 1, 2), (1, 4, 2)], grid)
    points, polygons = read_ply(path)
    assert_allclose(points, np.array(ROWS, dtype=float)[:, [0, 1, 3]])
    assert polygons.tolist() == [3, 0, 1, 2, 3, 1, 4, 2]
    # A line is no polygon.
    write_polygons(path, order, [(0, 1, 2, 3), (3, 4), (1, 4, 2)], grid, "int")
    assert read_ply(path)[1].tolist() == [4, 0, 1, 2, 3, 3, 1, 4, 2]
    assert read_surface(path).area == pytest.approx(2.0 + 0.5 * np.hypot(4.0, 1.0))
    write_polygons(path, order, [], grid)
    assert len(read_ply(path)[1]) == 0


@pytest.mark.parametrize("order", KINDS)
def test_a_ply_that_promises_what_it_has_not_is_refused(tmp_path, order):
    path = tmp_path / "face.ply"
    for corner in (5, -1, 2**31 - 1):
        write_polygons(path, order, [(0, 1, 2), (1, corner, 2)])
        with pytest.raises(InputError, match=r"face\.ply: cannot be read"):
            read_surface(path)
    write_polygons(path, order, [(0, 1, 2), (1, 4, 2)])
    whole = path.read_bytes()
    for content in (
        whole[:-5],
        whole.replace(b"vertex 5", b"vertex -5"),
        whole.replace(b"vertex 5", b"vertex 4000000000"),
        whole.replace(b"float z", b"float w"),
        whole.replace(b"float z", b"quad z"),
        whole.replace(b"face 2", b"face 1e9"),
        whole.replace(b"end_header", b"end_of_it"),
    ):
        path.write_bytes(content)
        with pytest.raises(ValueError):
            read_ply(path)
    # The length of a list is all bits, or negative, or no number.
    bad = b"\xff" * 40 if order else b"3 0 nan 2 1\n"
    path.write_bytes(whole[: whole.index(b"end_header\n") + 11] + bad * 60)
    with pytest.raises(ValueError):
        read_ply(path)


def test_a_ply_with_other_line_ends_is_read(tmp_path):
    lines = [
        "ply",
        "format ascii 1.0",
        "element vertex 3",
        "property float x",
        "property float y",
        "property float z",
        "element face 1",
        "property list uchar int vertex_indices",
        "end_header",
        "0 0 0",
        "1 0 0",
        "0 1 0",
        "3 0 1 2",
        "",
    ]
    path = tmp_path / "face.ply"
    path.write_bytes("\r\n".join(lines).encode())
    assert read_surface(path).faces.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize("kept", [0, 10, 200, -9])
def test_truncated_file_is_refused(tmp_path, kept):
    path = tmp_path / "box.ply"
    write_ply(box(), path)
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(InputError, match=r"box\.ply: cannot be read"):
        read_surface(path)


def test_missing_and_strange_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_surface(tmp_path / "none.ply")
    (tmp_path / "note.txt").write_text("hello")
    with pytest.raises(InputError, match="not a surface file"):
        read_surface(tmp_path / "note.txt")


def test_unsound_arrays_are_refused():
    with pytest.raises(InputError, match="not finite"):
        Surface([[0, 0, np.nan], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    with pytest.raises(InputError, match="missing vertices"):
        Surface([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 3]])


def test_distance_grid_of_a_ball():
    grid = DistanceGrid.of([ball(10.0)], spacing=1.0)
    direction = np.array([[0.6, 0.0, 0.8], [0.0, -1.0, 0.0], [0.48, 0.6, 0.64]])
    for radius in (6.0, 10.0, 13.0):
        sample = grid.sample(radius * direction)
        assert_allclose(sample.distance, radius - 10.0, atol=0.08)
        assert_allclose(sample.gradient, direction, atol=0.03)
        tangent = np.eye(3) - direction[:, :, None] * direction[:, None, :]
        assert_allclose(sample.hessian, tangent / radius, atol=0.06)


def test_distance_grid_derivatives_match_differences():
    grid = DistanceGrid.of([ball(5.0), box(at=(3.0, 0, 0))], spacing=1.0)
    points = np.random.default_rng(1).uniform(grid.bounds[0], grid.bounds[1], (200, 3))
    step = 1e-5
    sample = grid.sample(points)
    for axis in range(3):
        shift = np.zeros(3)
        shift[axis] = step
        after, before = grid.sample(points + shift), grid.sample(points - shift)
        slope = (after.distance - before.distance) / (2 * step)
        bend = (after.gradient - before.gradient) / (2 * step)
        assert_allclose(sample.gradient[:, axis], slope, atol=1e-7)
        assert_allclose(sample.hessian[:, axis], bend, atol=1e-7)


def test_distance_grid_outside_its_box_is_flat():
    grid = DistanceGrid.of([ball(5.0)], spacing=1.0)
    sample = grid.sample(np.array([[100.0, 0.0, 0.0]]))
    assert_array_equal(sample.distance, grid.band)
    assert_array_equal(sample.gradient, 0.0)
    assert_array_equal(sample.hessian, 0.0)


def test_distance_grid_survives_its_arrays_and_draws_its_surface():
    grid = DistanceGrid.of([ball(8.0)], spacing=1.0)
    again = DistanceGrid.from_arrays(grid.arrays())
    assert_array_equal(again.values, grid.values)
    assert_allclose(again.surface().volume, 4 / 3 * np.pi * 8.0**3, rtol=0.03)


def test_mirrored_distance_draws_the_left_half_with_a_rim_on_the_plane():
    grid = DistanceGrid.of([ball(8.0)], spacing=1.0)
    half = MirroredDistance(grid, 2.3).surface()
    # A ball whose centre is beyond the plane, and the cap of its image: they meet in a circle.
    rim = half.vertices[half.vertices[:, 0] < 2.3 + 1e-4]
    assert_allclose(half.vertices[:, 0].min(), 2.3, atol=1e-5)
    assert_allclose(np.linalg.norm(rim[:, 1:], axis=1), np.sqrt(8.0**2 - 2.3**2), atol=0.1)
    assert_allclose(half.vertices[:, 0].max(), 8.0, atol=0.1)


def test_distance_grid_refuses_unsound_arrays():
    arrays = DistanceGrid.of([ball(3.0)], spacing=1.0).arrays()
    with pytest.raises(InputError, match="missing"):
        DistanceGrid.from_arrays({key: arrays[key] for key in ("origin", "spacing")})
    with pytest.raises(InputError, match="spacing"):
        DistanceGrid.from_arrays({**arrays, "spacing": np.array(-1.0)})
    with pytest.raises(InputError, match="deltas"):
        DistanceGrid.from_arrays({**arrays, "deltas": arrays["deltas"].astype(float)})


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda points: points[:400], "400 points"),
        (lambda points: points * [1.0, 0.0, 1.0], "plane"),
        (lambda points: points * 1e30, "span"),
        (lambda points: points * 1e-30, "span"),
        (lambda points: np.vstack([points, [[0.0, 1e20, 0.0]]]), "span"),
        (lambda points: np.vstack([points, [[0.0, np.inf, 0.0]]]), "not finite"),
    ],
)
def test_points_that_cannot_be_a_face_are_refused(change, word):
    points = ball(80.0).vertices
    check_face("scan", points)
    with pytest.raises(InputError, match=f"^scan: .*{word}"):
        check_face("scan", change(points))


def test_folder_without_parts_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        BodyParts3D(tmp_path / "none")
    with pytest.raises(InputError, match=r"manifest\.csv"):
        BodyParts3D(tmp_path)
    (tmp_path / "manifest.csv").write_text("fma_id,n_vertices,n_faces\n")
    with pytest.raises(InputError, match=r"FMA46813\.ply: missing, the part for zygomaticus_major"):
        BodyParts3D(tmp_path)


@needs_anatomy
def test_structures_are_of_the_left_side():
    anatomy = BodyParts3D(FOLDER)
    for name in ("zygomaticus_major", "eyeball", "ear", "mentalis"):
        assert anatomy.surface(name).bounds[0, 0] > MIDPLANE
    # The ring around the orbit is the larger one, whatever the source calls it.
    ring, lids = (anatomy.surface(f"orbicularis_oculi_{n}") for n in ("orbital", "palpebral"))
    assert ring.volume > 3 * lids.volume
    with pytest.raises(InputError, match="did you mean zygomaticus_ma"):
        anatomy.surface("zygomaticus_mayor")


@needs_anatomy
def test_every_deep_structure_is_made_of_known_parts():
    for parts in DEEP_STRUCTURES.values():
        assert set(parts) <= set(STRUCTURES)


@needs_anatomy
def test_eyeball_grid_agrees_with_its_surface():
    anatomy = BodyParts3D(FOLDER)
    grid = deep_distances(anatomy, ["eyeball"])["eyeball"]
    points = anatomy.surface("eyeball").samples(1.0)
    assert_allclose(grid.sample(points).distance, 0.0, atol=0.1)
    with pytest.raises(InputError, match="deep structure"):
        deep_distances(anatomy, ["eyeballs"])
