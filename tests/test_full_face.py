"""Both sides: the whole head is the half and its mirror image, and may differ left and right."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose

from modiolus import hermite
from modiolus.anatomy import MirroredDistance
from modiolus.cli import main
from modiolus.face.head import Head
from modiolus.hermite import MirroredMesh
from modiolus.mechanics import Continuation, Settings
from modiolus.mechanics.face import face_load, face_problem

RNG = np.random.default_rng(7)


@pytest.fixture(scope="module")
def block_states(block_head):
    """The block head under a load, once on each of its two meshes."""
    # Those on the way too: contact takes its choices and offsets from them.
    fine = Settings(tolerance=1e-11, passing=1e-11)

    def solve(head, activations, jaw=0.0):
        problem = face_problem(head)
        load = face_load(problem, head, activations, jaw)
        return Continuation(problem, settings=fine).run(load)

    return solve


def material(head):
    """Operator that evaluates a field of the tissue at its Gauss points."""
    elements, xi, _ = head.tissue.gauss_points(4)
    return head.tissue.functions(elements, xi)


def test_mirrored_mesh_is_the_half_and_its_image(block_head):
    half, both = block_head.tissue, block_head.both
    elements, xi, _ = half.gauss_points(3)
    there = both.points(elements, xi)
    assert_allclose(both.mesh.evaluate(elements, xi), half.evaluate(elements, xi))
    assert_allclose(both.mesh.evaluate(*there), block_head.mirror(half.evaluate(elements, xi)))
    assert np.linalg.det(both.mesh.jacobian(*there)).min() > 0.0
    assert both.mesh.measures().sum() == pytest.approx(2.0 * half.measures().sum())
    # The vertices of the mid-plane are shared.
    vertices, first = both.mesh.corner_nodes()
    on_plane = np.abs(
        both.mesh.evaluate(first[:, 0], np.eye(8)[first[:, 1]] @ _CORNERS)[:, 0] + 0.5
    )
    assert len(first) == 2 * len(half.corner_nodes()[1]) - (on_plane < 1e-9).sum()
    assert vertices.max() == len(first) - 1


_CORNERS = (np.arange(8)[:, None] >> np.arange(3) & 1).astype(float)


def test_any_field_on_both_sides_is_smooth_across_the_plane(block_head):
    both = block_head.both
    field = both.mesh.with_parameters(RNG.normal(size=both.mesh.parameters.shape))
    elements = block_head.sides["midplane"][0]
    here = np.column_stack([np.zeros(4), *RNG.uniform(size=(2, 4))])
    there = both.points(elements, here)
    for order in ((0, 0, 0), (1, 0, 0), (0, 1, 1)):
        assert_allclose(
            field.evaluate(*there, order), field.evaluate(elements, here, order), atol=1e-12
        )


def test_a_state_of_both_sides_is_two_of_the_half(block_head):
    both = block_head.both
    state = both.mesh.parameters + RNG.normal(size=both.mesh.parameters.shape)
    left, right = block_head.halves(state)
    elements, xi, _ = block_head.tissue.gauss_points(2)
    moved, half = both.mesh.with_parameters(state), block_head.tissue
    assert_allclose(half.with_parameters(left).evaluate(elements, xi), moved.evaluate(elements, xi))
    assert_allclose(
        block_head.mirror(half.with_parameters(right).evaluate(elements, xi)),
        moved.evaluate(*both.points(elements, xi)),
        atol=1e-12,
    )
    assert_allclose(both.whole(half.parameters), both.mesh.parameters, atol=1e-12)
    same, also = block_head.halves(half.parameters)
    assert same is also is half.parameters


def test_a_mirror_plane_is_a_face_in_that_plane(block_head):
    half = block_head.tissue
    with pytest.raises(ValueError, match="not in the mirror plane"):
        MirroredMesh.of(half, *block_head.sides["midplane"], plane=3.0)
    with pytest.raises(ValueError, match="constant xi1"):
        MirroredMesh.of(half, *block_head.sides["neck"], plane=-0.5)
    skew = hermite.linear(np.array(_CORNERS), np.arange(8)[None])
    with pytest.raises(ValueError, match="own nodes"):
        MirroredMesh.of(skew, np.array([0]), 0, 0, 0.0)


def test_distance_of_both_sides_is_symmetric_and_smooth(block_head):
    field = block_head.distance("skull")
    assert isinstance(field, MirroredDistance)
    points = np.column_stack(
        [RNG.uniform(-6.0, 5.0, 300), RNG.uniform(6.0, 14.0, 300), RNG.uniform(0.0, 20.0, 300)]
    )
    here, there = field.sample(points), field.sample(block_head.mirror(points))
    assert_allclose(here.distance, there.distance, atol=1e-12)
    assert_allclose(here.gradient, there.gradient * [-1.0, 1.0, 1.0], atol=1e-12)
    h = 1e-5
    for k, step in enumerate(h * np.eye(3)):
        low, high = field.sample(points - step), field.sample(points + step)
        slope = (high.distance - low.distance) / (2.0 * h)
        assert_allclose(slope, here.gradient[:, k], atol=1e-7)
        bend = (high.gradient - low.gradient) / (2.0 * h)
        assert_allclose(bend, here.hessian[:, :, k], atol=1e-7)


def test_the_whole_head_names_its_sides(block_head):
    whole = block_head.whole
    assert set(whole.muscles) == {"strap_left", "strap_right"}
    assert set(whole.attachments) == {"ligament_left", "ligament_right"}
    assert {"ear_left", "ear_right", "neck"} <= set(whole.sides)
    assert "midplane" not in whole.sides
    assert whole.whole is whole and whole.half is block_head
    rest = block_head.landmark_points()
    assert set(rest) == {"chin", "brow", "corner_left", "corner_right"}
    for name, point in whole.landmark_points().items():
        assert_allclose(point, rest[name], atol=1e-12)
    for name, (element, xi) in whole.landmarks.items():
        assert_allclose(whole.tissue.evaluate([element], [xi])[0], rest[name], atol=1e-12)
    left, right = (whole.muscles[f"strap_{side}"] for side in ("left", "right"))
    assert left.volume == pytest.approx(right.volume)
    assert_allclose(block_head.mirror(left.insertion()), right.insertion(), atol=1e-9)


@pytest.mark.parametrize("degrees", [0.0, 2.0])
def test_half_and_whole_agree_when_the_sides_do(block_head, block_states, degrees):
    jaw = np.radians(degrees)
    half = block_states(block_head, {"strap": 0.4}, jaw)
    whole = block_states(block_head.whole, {"strap_left": 0.4, "strap_right": 0.4}, jaw)
    problem = face_problem(block_head)
    energies = problem.evaluate(half.parameters, half.pressure, half.load).energies
    if not jaw:
        assert energies["contact of the upper lip"] > 0.0
    evaluate = material(block_head)
    assert np.abs(evaluate @ half.displacement).max() > 0.5
    for side in block_head.halves(whole.parameters):
        assert np.abs(evaluate @ (side - half.parameters)).max() < 1e-8


def test_one_side_pulls_and_the_other_side_is_its_mirror_image(block_head, block_states):
    left = block_states(block_head.whole, {"strap_left": 0.4})
    right = block_states(block_head.whole, {"strap_right": 0.4})
    active, rested = block_head.halves(left.parameters)
    other, also = block_head.halves(right.parameters)
    evaluate = material(block_head)
    rest = block_head.tissue.parameters
    assert np.abs(evaluate @ (active - rest)).max() > np.abs(evaluate @ (rested - rest)).max()
    assert np.abs(evaluate @ (active - also)).max() < 1e-8
    assert np.abs(evaluate @ (rested - other)).max() < 1e-8
    points, still = block_head.landmark_points(left.parameters), block_head.landmark_points()
    moved = {name: np.linalg.norm(points[name] - still[name]) for name in points}
    assert moved["corner_left"] > 1.5 * moved["corner_right"] > 0.0


@pytest.mark.parametrize("side", ["both", "rihgt"])
def test_an_unknown_side_is_refused(side, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as left:
        main(["simulate", "smile-closed", "--palsy", side])
    assert left.value.code == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1 and f"palsied side '{side}'" in message
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_half_and_whole_taro_agree_when_the_sides_do():
    head, fine = Head.load("taro"), Settings(tolerance=1e-11, passing=1e-11)
    found = []
    for chosen, sides in ((head, ("",)), (head.whole, ("_left", "_right"))):
        problem = face_problem(chosen)
        activations = {f"zygomaticus_major{side}": 0.2 for side in sides}
        load = face_load(problem, chosen, activations, np.radians(2.0))
        found.append(Continuation(problem, settings=fine).run(load))
    half, whole = found
    evaluate = material(head)
    for side in head.halves(whole.parameters):
        assert np.abs(evaluate @ (side - half.parameters)).max() < 1e-8


@pytest.mark.slow
def test_a_wink_closes_one_eye_and_is_reported_on_both_sides(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as left:
        main(["simulate", "wink", "--json"])
    assert left.value.code == 0
    record = json.loads(capsys.readouterr().out)
    moved = {name: place["displacement"] for name, place in record["landmarks"].items()}
    assert record["converged"] and record["elements"] == 2 * Head.load("taro").tissue.n_elements
    assert all(name.endswith("_left") for name in record["activations"])
    assert moved["upper_lid_mid_left"][2] < -3.0
    assert np.abs(moved["upper_lid_mid_right"]).max() < 0.1
    assert moved["mouth_corner_left"][2] > 10.0 * abs(moved["mouth_corner_right"][2])
