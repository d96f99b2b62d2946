"""Registration of surfaces: similarity, closest points, unknown pose and unit."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from modiolus.anatomy import Surface
from modiolus.errors import InputError
from modiolus.face.embed import boundary_surface
from modiolus.face.head import Head
from modiolus.fitting.register import Registration, icp, register, similarity


@pytest.fixture(scope="module")
def skin() -> Surface:
    head = Head.load("taro")
    half = boundary_surface(head.tissue, head.sides["outer"], 4)
    return Surface.joined([half, half.mirrored(head.midplane)], "taro")


def gap(pose: Registration, moved: Surface, skin: Surface) -> float:
    """Greatest distance of the vertices from where they came from."""
    return float(np.linalg.norm(pose.apply(moved.vertices) - skin.vertices, axis=1).max())


def test_similarity_recovers_scale_rotation_and_translation() -> None:
    points = np.random.default_rng(1).normal(size=(7, 3))
    turn = Rotation.random(random_state=2).as_matrix()
    pose = similarity(points, 2.5 * points @ turn.T + [1.0, -2.0, 3.0])
    assert pose.scale == pytest.approx(2.5, rel=1e-12)
    np.testing.assert_allclose(pose.rotation, turn, atol=1e-12)
    np.testing.assert_allclose(pose.undo(pose.apply(points)), points, atol=1e-12)
    assert pose.rms < 1e-12


def test_poses_are_done_one_after_the_other() -> None:
    rng = np.random.default_rng(4)
    points, centre = rng.standard_normal((5, 3)), rng.standard_normal(3)
    first, second = (
        Registration(scale, Rotation.random(rng=rng).as_matrix(), rng.standard_normal(3), unit=10.0)
        for scale in (2.0, 0.3)
    )
    both = second.after(first)
    assert both.apply(points) == pytest.approx(second.apply(first.apply(points)), abs=1e-12)
    assert both.unit == 10.0
    step = 0.1 * rng.standard_normal(6)
    moved = first.stepped(step, centre, 1.1)
    arms = Rotation.from_rotvec(step[:3]).apply(first.apply(points) - centre)
    assert moved.apply(points) == pytest.approx(1.1 * arms + centre + step[3:], abs=1e-12)


def test_similarity_never_mirrors() -> None:
    points = np.random.default_rng(3).normal(size=(9, 3))
    pose = similarity(points, points * [-1.0, 1.0, 1.0])
    assert np.linalg.det(pose.rotation) == pytest.approx(1.0)
    assert pose.rms > 0.1


@pytest.mark.parametrize("points", [np.eye(3)[:2], np.outer(np.arange(5.0), [1.0, 2.0, 3.0])])
def test_similarity_refuses_too_few_and_collinear_landmarks(points: np.ndarray) -> None:
    with pytest.raises(InputError, match="landmarks"):
        similarity(points, points)


def test_icp_recovers_a_small_rigid_motion(skin: Surface) -> None:
    turn = Rotation.from_euler("xyz", [4.0, -3.0, 5.0], degrees=True).as_matrix()
    centre = skin.vertices.mean(axis=0)
    moved = Surface((skin.vertices - centre) @ turn.T + centre + [3.0, -8.0, 5.0], skin.faces)
    pose = icp(moved, skin)
    assert pose.scale == 1.0
    assert pose.rms < 0.02
    assert gap(pose, moved, skin) < 0.1


@pytest.mark.parametrize(
    ("unit", "axes"),
    [
        (1e-3, Rotation.from_euler("z", 180, degrees=True)),
        (0.1, Rotation.from_matrix([[1, 0, 0], [0, 0, 1], [0, -1, 0]])),
        (1.0, Rotation.from_euler("xyz", [100, 40, -130], degrees=True)),
    ],
    ids=["metres, upside down", "centimetres, y up", "tumbled"],
)
def test_register_finds_any_pose_and_unit(skin: Surface, unit: float, axes: Rotation) -> None:
    moved = Surface(unit * 1.1 * axes.apply(skin.vertices) + 7.0, skin.faces, "scan")
    pose = register(moved, skin)
    assert pose.scale * unit * 1.1 == pytest.approx(1.0, abs=1e-3)
    assert pose.unit == pytest.approx(1.0 / unit)
    assert pose.facing > 0.99
    assert gap(pose, moved, skin) < 0.2


def test_register_bears_noise_and_a_missing_half(skin: Surface) -> None:
    turn = Rotation.from_euler("y", 180, degrees=True)
    noise = np.random.default_rng(5).normal(scale=0.3, size=skin.vertices.shape)
    moved = Surface(turn.apply(skin.vertices) + noise, skin.faces[: len(skin.faces) // 2], "scan")
    pose = register(moved, skin)
    left = np.unique(moved.faces)
    away = np.linalg.norm(pose.apply(turn.apply(skin.vertices)) - skin.vertices, axis=1)
    assert away[left].max() < 0.5


def test_a_mirrored_scan_faces_the_other_way(skin: Surface) -> None:
    moved = Surface(skin.vertices * [-1.0, 1.0, 1.0], skin.faces, "scan")
    assert register(moved, skin).facing < -0.9


def test_landmarks_give_the_first_pose(skin: Surface) -> None:
    turn = Rotation.from_euler("xyz", [10, 170, 25], degrees=True)
    moved = Surface(turn.apply(skin.vertices) / 1000.0, skin.faces, "scan")
    picked = [100, 900, 2000, 3000]
    pose = register(moved, skin, (moved.vertices[picked], skin.vertices[picked]))
    assert gap(pose, moved, skin) < 0.05
