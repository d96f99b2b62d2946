"""The jaw is a rigid body that carries what is tied to it."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from modiolus.cli import main
from modiolus.errors import InputError
from modiolus.export.mouth import mouth
from modiolus.export.scene import FaceScene
from modiolus.face.embed import TRAGUS
from modiolus.face.head import Head
from modiolus.face.jaw import GLIDE, SLOPE, WIDEST, Jaw, opening
from modiolus.mechanics import Continuation, Load, RigidContact
from modiolus.mechanics.face import Face, face_load, face_problem

RNG = np.random.default_rng(11)


@pytest.fixture(scope="module")
def taro():
    return Head.load("taro")


@pytest.mark.parametrize("degrees", [0.0, 1.0, 12.0, 30.0])
def test_pose_is_a_rigid_motion_about_gliding_condyles(block_head, degrees):
    jaw, angle = block_head.jaw, math.radians(degrees)
    rotation, shift = jaw.pose(angle)
    assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert np.trace(rotation) == pytest.approx(1.0 + 2.0 * math.cos(angle))
    glide = rotation @ jaw.hinge + shift - jaw.hinge
    assert_allclose(
        glide, GLIDE * angle * np.array([0.0, -math.cos(SLOPE), -math.sin(SLOPE)]), atol=1e-12
    )
    # What lies before the axis goes down.
    front = jaw.hinge + np.array([0.0, -40.0, 0.0])
    assert (rotation @ front + shift - front)[2] <= 0.0


def test_condyles_of_taro_lie_before_the_tragus(taro):
    _, y, z = taro.jaw.hinge
    assert -15.0 < y - TRAGUS[1] < 5.0 and abs(z - TRAGUS[2]) < 10.0
    assert taro.jaw.hinge[0] == taro.midplane


def test_incisors_of_taro_part_as_far_as_those_of_people(taro):
    # Kordaß et al. 2014: 44.3 ± 7.4 mm at 32.2°.
    teeth = taro.deep["teeth_lower"].distance.surface().vertices
    front = teeth[teeth[:, 1] < teeth[:, 1].min() + 8.0]
    edge = front[front[:, 2].argmax()]
    rotation, shift = taro.jaw.pose(math.radians(32.2))
    assert abs(np.linalg.norm(rotation @ edge + shift - edge) - 44.3) < 7.4


def test_what_is_tied_to_the_mandible_follows_it(taro):
    for name, follows in {
        "depressor_anguli_oris": 1.0,
        "depressor_labii_inferioris": 1.0,
        "mentalis": 1.0,
        "mandibular_ligament": 1.0,
        "mental_ligament": 1.0,
        "zygomaticus_major": 0.0,
        "levator_labii_superioris": 0.0,
        "corrugator_supercilii": 0.0,
        "zygomatic_ligament": 0.0,
    }.items():
        item = taro.attachments[name]
        share = taro.jaw.share(taro.tissue.evaluate(item.elements, item.xi))
        assert_allclose(share, follows, atol=0.01, err_msg=name)
    # Buccinator comes from both jaws.
    item = taro.attachments["buccinator"]
    share = taro.jaw.share(taro.tissue.evaluate(item.elements, item.xi))
    assert share.min() < 0.01 and share.max() > 0.99
    points = RNG.uniform([-60.0, -190.0, 1410.0], [60.0, -100.0, 1600.0], (500, 3))
    share = taro.jaw.share(points)
    assert share.min() == 0.0 and 0.9 < share.max() <= 1.0
    assert_allclose(taro.jaw.share(taro.mirror(points)), share, atol=1e-12)


def test_contact_moves_with_the_jaw(block_head):
    jaw, surface = block_head.jaw, block_head.distance("mandible")
    load = Load(jaw=math.radians(9.0))
    elements, xi, areas = np.zeros(60, dtype=int), RNG.uniform(size=(60, 3)), np.full(60, 2.0)
    contact = RigidContact(
        block_head.tissue, surface, elements, xi, areas, 50.0, slide=0.1 * np.ones(60),
        motion=lambda given: jaw.pose(given.jaw),
    )  # fmt: skip
    rotation, shift = jaw.pose(load.jaw)
    inside = RNG.uniform([-20.0, 10.0, -30.0], [20.0, 16.0, -2.0], (60, 3))
    moved = inside @ rotation.T + shift
    # The body and everything about it have moved alike.
    assert_allclose(contact.sample(moved, load)[0], surface.sample(inside).distance, atol=1e-12)
    answer = contact.respond(moved, load)
    assert np.count_nonzero(answer.energies) > 30
    h, pairs = 1e-6, {(0, 0): 0, (0, 1): 1, (0, 2): 2, (1, 1): 3, (1, 2): 4, (2, 2): 5}
    for k, step in enumerate(h * np.eye(3)):
        low, high = contact.respond(moved - step, load), contact.respond(moved + step, load)
        force = (high.energies - low.energies) / (2.0 * h)
        assert_allclose(force, answer.forces[:, k], rtol=1e-5, atol=1e-4)
        stiffness = (high.forces - low.forces) / (2.0 * h)
        for i in range(3):
            found = answer.stiffness()[:, pairs[min(i, k), max(i, k)]]
            assert_allclose(stiffness[:, i], found, rtol=1e-5, atol=1e-2)


def test_an_open_jaw_carries_the_lower_tissue_and_leaves_the_upper(block_head):
    angle = math.radians(5.0)
    problem = face_problem(block_head)
    state = Continuation(problem).run(face_load(problem, block_head, {}, angle))
    assert state.statistics.converged and state.load.jaw == angle
    rest, moved = block_head.landmark_points(), block_head.landmark_points(state.parameters)
    rotation, shift = block_head.jaw.pose(angle)
    carried = rotation @ rest["chin"] + shift
    assert np.linalg.norm(carried - rest["chin"]) > 2.0
    assert np.linalg.norm(moved["chin"] - carried) < 0.5
    # There is no galea to hold the loose scalp.
    travel = np.linalg.norm(carried - rest["chin"])
    assert np.linalg.norm(moved["brow"] - rest["brow"]) < 0.1 * travel
    # The cut through the neck follows by its share, in its plane as far as what lies beyond lets
    # it, and the mouth has opened.
    elements, axis, side = block_head.sides["neck"]
    xi = np.insert(RNG.uniform(size=(len(elements), 2)), axis, side, axis=1)
    cut = problem.mesh.evaluate(elements, xi)
    expected = block_head.jaw.displacement(cut, angle, block_head.jaw.share(cut))
    gone = state.mesh.evaluate(elements, xi) - cut
    assert_allclose(gone[:, 2], expected[:, 2], atol=0.05)
    assert_allclose(gone, expected, atol=0.1)
    assert state.mesh.evaluate([4], [(0.0, 0.0, 1.0)])[0, 2] - moved["corner_left"][2] > 1.0


@pytest.mark.parametrize("degrees", [math.nan, -0.5, WIDEST + 0.1, math.inf])
def test_an_impossible_opening_is_refused(degrees):
    with pytest.raises(InputError, match="--jaw-open"):
        opening(degrees)


def test_openings_are_angles():
    assert opening(0.0) == 0.0
    assert opening(WIDEST) == pytest.approx(math.pi / 6.0)


@pytest.mark.parametrize("degrees", ["nan", "-3", "45"])
def test_the_command_refuses_it_in_one_line(degrees, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as left:
        main(["simulate", "terror", f"--jaw-open={degrees}"])
    assert left.value.code == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1 and "--jaw-open" in message
    assert list(tmp_path.iterdir()) == []


def test_a_head_without_a_mandible_keeps_its_mouth_shut(block_head):
    deep = {"skull": block_head.deep["skull"]}
    head = replace(block_head, deep=deep)
    assert head.jaw is None
    assert Jaw.of({}, 0.0) is None
    problem = face_problem(head)
    assert face_load(problem, head, {}).jaw == 0.0
    with pytest.raises(InputError, match="no mandible"):
        face_load(problem, head, {}, 0.1)


def test_lower_teeth_are_drawn_where_the_jaw_takes_them(taro):
    scene, angle = FaceScene(taro, 2), math.radians(12.0)
    rest = {s.name: s.vertices for s in scene.shapes(taro.tissue.parameters)}
    open_ = {s.name: s.vertices for s in scene.shapes(taro.tissue.parameters, jaw=angle)}
    rotation, shift = taro.jaw.pose(angle)
    for name in ("teeth_lower", "gums_lower", "tongue"):
        assert_allclose(open_[name], rest[name] @ rotation.T + shift)
    for name in ("teeth_upper", "gums_upper", "eye_left", "skin"):
        assert_allclose(open_[name], rest[name])
    # Roof and upper edge of the cavity stand still, floor and lower edge go with the jaw.
    gone = np.abs(open_["mouth"] - rest["mouth"]).max(axis=1) > 0.0
    assert_allclose(open_["mouth"][gone], rest["mouth"][gone] @ rotation.T + shift)
    assert rest["mouth"][gone, 2].max() < rest["mouth"][~gone, 2].min()


@pytest.mark.parametrize("name", ["taro", "ict"])
def test_the_tongue_lies_within_the_lower_arch_and_closes_it_to_the_eye(name):
    head = Head.load(name)
    shown = {shape.name: shape.vertices for shape, _ in mouth(head)}
    teeth, tongue = shown["teeth_lower"], shown["tongue"]
    for y in np.arange(tongue[:, 1].min(), tongue[:, 1].max(), 3.0):
        slab = tongue[np.abs(tongue[:, 1] - y) < 1.5]
        if len(slab):
            beside = teeth[np.abs(teeth[:, 1] - y) < 3.0]
            assert np.ptp(slab[:, 0]) < np.ptp(beside[:, 0])
    # Above the edges of the front teeth, close behind them, in their whole width.
    front = teeth[:, 1].min()
    edge = teeth[teeth[:, 1] < front + 5.0, 2].max()
    close = tongue[(tongue[:, 1] < front + 18.0) & (tongue[:, 2] > edge + 1.0)]
    assert tongue[:, 1].min() > front + 5.0
    assert np.ptp(close[:, 0]) > 15.0


def test_teeth_are_drawn_alike_on_both_sides_without_a_gap(taro):
    shapes = {s.name: s for s in FaceScene(taro, 2).shapes(taro.tissue.parameters)}
    for name in ("gums_upper", "gums_lower"):
        vertices, faces = shapes[name].vertices, shapes[name].faces
        edges = np.sort(np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        pairs, times = np.unique(edges, axis=0, return_counts=True)
        # Open where the face is cut off, at the back, and nowhere else.
        assert (vertices[pairs[times == 1], 1] > vertices[:, 1].max() - 2.0).all()


def test_a_yawn_opens_the_mouth_and_is_reported(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as left:
        main(["simulate", "--jaw-open", "8", "--json"])
    assert left.value.code == 0
    record = json.loads(capsys.readouterr().out)
    moved = {name: place["displacement"] for name, place in record["landmarks"].items()}
    assert record["converged"] and record["jaw_open"] == pytest.approx(8.0)
    # A step's prediction that lets the mandible into tissue takes three times as many.
    assert record["factorisations"] < 50
    assert moved["lower_lip_mid"][2] < -8.0
    assert np.linalg.norm(moved["upper_lip_mid"]) < 1.5
    assert moved["chin"][2] < -8.0
    assert np.abs(moved["inner_brow_left"]).max() < 0.1


@pytest.mark.parametrize("angle", [-0.1, 12.0, np.nan])
def test_an_angle_that_is_none_of_a_jaw_is_refused(block_head, angle):
    with pytest.raises(InputError, match=r"jaw_open: .* radians; give .*opening\(12\.0\)"):
        Face(block_head).solve({}, angle)
