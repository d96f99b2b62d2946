import os
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from modiolus.anatomy import MIDPLANE, BodyParts3D, Surface
from modiolus.anatomy.sheet import clean_skin, ring, strip
from modiolus.errors import InputError, SolveError
from modiolus.face.expression import GROUPS
from modiolus.face.muscles import FITTED, MUSCLES, build_muscles, muscle_quality, muscle_table
from modiolus.hermite import grid
from modiolus.hermite.tessellate import tessellate

FOLDER = Path(
    os.environ.get("MODIOLUS_ANATOMY", Path(__file__).parents[2] / "shared/anatomy/bodyparts3d")
)
needs_anatomy = pytest.mark.skipif(
    not FOLDER.is_dir(), reason=f"no BodyParts3D at {FOLDER}; set MODIOLUS_ANATOMY to the folder"
)

#: Millimetres between the boundary and its source, by kind of muscle.
RMS = {"strap": 0.7, "sheet": 1.2, "ring": 1.2}


def closed(points, periodic=(False, False, False)):
    """Triangulate the outside of a grid of points."""
    mesh = grid(points, periodic)
    vertices, faces, start = [], [], 0
    for axis in range(3):
        for side in (0, 1):
            if periodic[axis]:
                continue
            n = np.array(points.shape[:3]) - ~np.array(periodic)
            cells = np.arange(mesh.n_elements).reshape(n[::-1]).transpose(2, 1, 0)
            outer = np.take(cells, -side, axis=axis).ravel()
            cut = tessellate(mesh.face(outer, axis, side), 4, 2 * (side ^ (axis == 1)) - 1)
            vertices.append(cut.points(mesh.parameters))
            faces.append(cut.cells + start)
            start += len(vertices[-1])
    merged, index = np.unique(np.round(np.concatenate(vertices), 9), axis=0, return_inverse=True)
    return Surface(merged, index.ravel()[np.concatenate(faces)], "body")


def plate():
    """A plate of 20 × 8 × 1.2 mm in front of the face, its length along x."""
    axes = [np.linspace(0, 20, 11), np.linspace(-200, -198.8, 2), np.linspace(1500, 1508, 5)]
    return closed(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))


def annulus():
    """A flat ring with radii 10 and 14 mm in front of the face."""
    angle = 2 * np.pi * np.arange(24) / 24
    a, r, y = np.meshgrid(angle, [10.0, 12.0, 14.0], [-200.0, -198.8], indexing="ij")
    points = np.stack([30 + r * np.cos(a), y, 1525 + r * np.sin(a)], axis=-1)
    return closed(points, (True, False, False))


def test_clean_skin_keeps_the_volume_of_a_plate():
    surface = plate()
    assert_allclose(surface.volume, 192.0, rtol=1e-6)
    assert_allclose(clean_skin(surface, 0.4, 1.0).volume, 192.0, rtol=0.08)
    with pytest.raises(SolveError, match="not a body with 1 handles"):
        clean_skin(surface, 0.4, 1.0, handles=1)


def test_coordinates_of_a_plate_are_linear():
    skin = clean_skin(plate(), 0.4, 1.0)
    sheet = strip(skin, 0.4, ((-1, 0, -1), (-1, 0, 1), (1, 0, 1), (1, 0, -1)))
    s, t = (g.ravel() for g in np.meshgrid(np.linspace(0.1, 0.9, 5), [0.2, 0.5, 0.8]))
    for side, y in ((0, -198.8), (1, -200.0)):
        points = sheet.points(side, s, t)
        assert_allclose(points[:, 0], 20 * s, atol=0.5)
        assert_allclose(points[:, 1], y, atol=0.15)
        assert_allclose(points[:, 2], 1500 + 8 * t, atol=0.5)


def test_coordinates_of_a_ring_are_its_angle_and_harmonic_radius():
    skin = clean_skin(annulus(), 0.4, 1.0, handles=1)
    sheet = ring(skin, 0.4, (0, 0, 1))
    turn = np.linspace(0.0, 1.0, 12, endpoint=False)
    points = sheet.points(1, turn, np.full(12, 0.5)) - [30, 0, 1525]
    # Anti-clockwise for someone who looks at the face: from the top to the subject's right.
    expected = np.stack([-np.sin(2 * np.pi * turn), np.cos(2 * np.pi * turn)], axis=1)
    radius = np.sqrt(10.0 * 14.0)
    assert_allclose(points[:, [0, 2]], radius * expected, atol=0.5)


def test_unknown_muscle_is_refused(tmp_path):
    with pytest.raises(InputError, match="did you mean zygomaticus_major"):
        build_muscles(None, ["zygomaticus_mayor"])


def test_groups_are_made_of_muscles():
    for members in GROUPS.values():
        assert set(members) <= set(MUSCLES)


@needs_anatomy
def test_zygomaticus_minor_runs_from_the_cheekbone_to_the_lip():
    anatomy = BodyParts3D(FOLDER)
    muscles = build_muscles(anatomy, ["zygomaticus_minor"])
    muscle = muscles["zygomaticus_minor"]
    rows = muscle_quality(muscles, anatomy)
    (quality,) = rows
    assert quality.rms < RMS["strap"]
    assert_allclose(quality.volume, quality.source_volume, rtol=0.15)
    assert quality.jacobian > 0
    start = muscle.end(0)[0].mean(axis=0)
    cheek = anatomy.surface("zygomatic_bone")
    assert cheek.closest(start[None]).distance[0] < 5.0
    assert muscle.insertion()[2] < start[2] - 20.0
    assert muscle.insertion()[0] < start[0] - 25.0
    assert "zygomaticus_minor" in muscle_table(rows)
    again = build_muscles(anatomy, ["zygomaticus_minor"])["zygomaticus_minor"]
    assert_array_equal(again.mesh.parameters, muscle.mesh.parameters)


@pytest.mark.slow
@needs_anatomy
def test_every_muscle_stands_for_its_source():
    anatomy = BodyParts3D(FOLDER)
    muscles = build_muscles(anatomy)
    assert tuple(muscles) == FITTED
    for quality in muscle_quality(muscles, anatomy):
        assert quality.rms < RMS[quality.kind], quality
        assert_allclose(quality.volume, quality.source_volume, rtol=0.15, err_msg=quality.name)
        assert quality.scaled_jacobian > 0.05, quality
    for name, muscle in muscles.items():
        assert muscle.bounds()[0, 0] + 0.5 > MIDPLANE - 0.05, name
    # Expected ends: which way insertion lies from origin, up (+) or down (-).
    for name, way in {
        "zygomaticus_major": -1,
        "levator_labii_superioris": -1,
        "levator_labii_superioris_alaeque_nasi": -1,
        "levator_anguli_oris": -1,
        "depressor_anguli_oris": 1,
        "depressor_labii_inferioris": 1,
        "mentalis": -1,
        "platysma": 1,
        "frontalis_medial": -1,
        "frontalis_lateral": -1,
        "corrugator_supercilii": 1,
        "procerus": 1,
        "depressor_septi_nasi": 1,
    }.items():
        start = muscles[name].end(0)[0].mean(axis=0)
        assert way * (muscles[name].insertion() - start)[2] > 2.0, name
