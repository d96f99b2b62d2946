"""Beginning at earlier states, what is said when a load is not reached, what settings change."""

import json
from dataclasses import replace

import numpy as np
import pytest

from modiolus.cli import main
from modiolus.errors import InputError, SolveError
from modiolus.face.head import Head
from modiolus.mechanics import Continuation, Load, LoadNotReached, Settings, Stride, trace
from modiolus.mechanics.contact import known_offsets
from modiolus.mechanics.convergence import Study, discretisation_error, variants
from modiolus.mechanics.face import Face, face_problem
from modiolus.scans.result import save_state


@pytest.fixture(scope="module")
def face(block_head):
    return Face(block_head)


@pytest.fixture(scope="module")
def contracted(face):
    return face.solve({"strap": 0.2})


def apart(face, one, other):
    """Return the greatest distance in mm between two states of the half, anywhere."""
    tissue = face.head.tissue
    elements, xi, _ = tissue.gauss_points(4)
    moved = tissue.with_parameters(one - other).evaluate(elements, xi)
    return np.linalg.norm(moved, axis=1).max()


def test_an_earlier_state_saves_work_and_changes_nothing(face, contracted):
    cold = face.solve({"strap": 0.22})
    warm = face.solve({"strap": 0.22}, start=contracted)
    assert apart(face, warm.parameters, cold.parameters) < 5e-3
    assert warm.statistics.factorisations < cold.statistics.factorisations


def test_a_path_by_its_length_meets_that_by_the_load(face, contracted):
    load = face.half.load({"strap": 0.2})
    *_, (before, _), (share, last) = trace(face.half, load, stride=Stride(length=0.1))
    assert before < 1.0 <= share
    there = face.solve({"strap": last.activations["strap"]})
    assert apart(face, last.parameters, there.parameters) < 5e-3
    less = face.half.load({"strap": 0.1})
    back = list(trace(face.half, less, contracted, Stride(0.005, states=3)))
    assert len(back) == 3
    assert back[-1][1].activations["strap"] < 0.2


def test_a_path_leads_through_activations_and_forces(face, contracted):
    load = replace(face.half.load({"strap": 0.1}), jaw=0.1)
    with pytest.raises(InputError, match="keep what is held"):
        next(trace(face.half, load))
    with pytest.raises(InputError, match="ropes"):
        next(trace(face.half, Load(forces={"ropes": 1.0})))
    with pytest.raises(InputError, match="changes nothing"):
        next(trace(face.half, contracted.load, contracted))


def test_one_side_can_begin_at_a_state_of_both(face, contracted):
    arrays = contracted.parameters, contracted.pressure
    start = face.state(*arrays, contracted.activations, both=True)
    same = face.solve({"strap_left": 0.2, "strap_right": 0.2}, start=start)
    left, right = face.head.halves(same.parameters)
    assert len(same.parameters) == face.head.both.mesh.n_params
    assert apart(face, left, contracted.parameters) < 5e-3
    assert apart(face, right, left) < 5e-3
    wink = face.solve({"strap_left": 0.22}, start=same)
    left, right = face.head.halves(wink.parameters)
    assert np.abs(right - left).max() > 0.05
    back = face.solve({"strap": 0.2}, start=wink)
    there = face.head.landmark_points(contracted.parameters)
    for name, point in face.head.landmark_points(back.parameters).items():
        assert np.linalg.norm(point - there[name]) < 0.02


def test_a_state_is_made_again_of_its_arrays(face, contracted):
    arrays = contracted.parameters, contracted.pressure
    again = face.state(*arrays, contracted.activations)
    assert face.problem(again) is face.half
    assert again.activations == contracted.activations
    both = face.state(*arrays, contracted.activations, both=True)
    assert face.problem(both) is face.whole
    assert both.activations == {"strap_left": 0.2, "strap_right": 0.2}
    with pytest.raises(InputError, match="do not fit the head"):
        face.state(contracted.parameters, contracted.pressure[:-1], {})


@pytest.fixture(scope="module")
def pressed(face):
    """A state whose lips are pressed apart."""
    path = Continuation(face.half, settings=Settings(penetration=0.02))
    state = path.run(face.half.load({"strap": 0.9}))
    assert max(offsets.max() for offsets in state.load.offsets.values()) > 0.02
    return state


@pytest.mark.parametrize("both", [False, True])
def test_an_earlier_state_is_in_equilibrium(face, pressed, both):
    arrays = pressed.parameters, pressed.pressure, pressed.activations, pressed.load.jaw
    start = face.state(*arrays, both=both, offsets=pressed.load.offsets)
    problem = face.problem(start)
    assert (problem is face.whole) == both

    def unbalanced(load):
        return np.abs(problem.evaluate(start.parameters, start.pressure, load).residual).max()

    assert unbalanced(start.load) < 1e-2 * unbalanced(replace(start.load, offsets={}))


def test_conjugate_corrections_follow_the_exact_tangent(face, pressed):
    problem, path = face.half, Continuation(face.half)
    load = replace(pressed.load, activations={"strap": 0.92})
    place = pressed.parameters, pressed.pressure, load
    residual = problem.evaluate(*place).residual
    path._factorise(pressed, load)
    exact = -path.solver.solve(residual)
    path._factorise(pressed, load, convex=True, damping=3e-3)
    rough = -path.solver.solve(residual)
    problem.evaluate(*place, tangent=True)
    better = path._conjugate(residual)
    assert problem.size(rough - exact) > 0.1 * problem.size(exact)
    assert problem.size(better - exact) < 0.03 * problem.size(exact)


def test_a_load_that_is_reached_roughly_is_told(block_head):
    problem = face_problem(block_head)
    load = problem.load({"strap": 0.2})
    # No correction is as short as this.
    settings = Settings(tolerance=1e-18, rough=1e-2, max_iterations=12, max_steps=20)
    statistics = Continuation(problem, settings=settings).run(load).statistics
    assert statistics.converged and 1e-18 < statistics.correction_mm < 1e-2
    with pytest.raises(LoadNotReached):
        Continuation(problem, settings=replace(settings, rough=1e-18)).run(load)


def test_contacts_that_cannot_be_pressed_apart_are_told(face, monkeypatch):
    def stuck(*_):
        raise SolveError("stuck")

    monkeypatch.setattr(face.half, "augment", stuck)
    path = Continuation(face.half, settings=Settings(penetration=0.02))
    statistics = path.run(face.half.load({"strap": 0.9})).statistics
    assert statistics.converged and not statistics.pressed
    assert "could not be pressed farther apart" in statistics.doubts[0]


def test_offsets_of_no_contact_are_refused(face, pressed):
    offsets = dict(pressed.load.offsets)
    mesh = face.half.mesh
    assert known_offsets(face.half.terms, mesh, offsets, 0.0).keys() == offsets.keys()
    for name, values in (
        ("contact of the upper lip", np.zeros(7)),
        ("contact with skull", np.zeros(0)),
        ("contact with nothing", np.zeros(7)),
    ):
        with pytest.raises(InputError, match=f"{name}.*simulate it anew"):
            known_offsets(face.half.terms, mesh, {**offsets, name: values}, 0.0)


def test_an_expression_is_solved_by_its_file(face, contracted, tmp_path):
    (tmp_path / "pull.toml").write_text("[activations]\nstrap = 0.2\n")
    told = []
    state = face.express(
        str(tmp_path / "pull.toml"), report=lambda share, message: told.append(share)
    )
    assert np.array_equal(state.parameters, contracted.parameters)
    assert told[-1] == 1.0


def test_a_failure_names_place_muscle_term_and_remedy(block_head):
    problem = face_problem(block_head)
    path = Continuation(problem, settings=Settings(least_ratio=0.97, max_steps=40))
    with pytest.raises(LoadNotReached) as caught:
        path.run(problem.load({"strap": 1.0}))
    text = str(caught.value)
    for word in ("% of the load (strap)", "smallest J 0.", "mm from", "strap contracts", "less of"):
        assert word in text
    assert "\n" not in text
    assert 0.0 < caught.value.reached < 1.0
    assert caught.value.state is path.state
    assert path.state.activations["strap"] == pytest.approx(caught.value.reached)


def test_a_study_compares_with_its_default(block_head):
    landmarks = {**block_head.landmarks, "mouth_corner": block_head.landmarks["corner"]}
    study = Study(replace(block_head, landmarks=landmarks), {"strap": 0.1}, 0.0)
    rows = [study.row(variant) for variant in variants() if "2 x 2" not in variant.name]
    first, *others = rows
    assert first["rms_change_mm"] == first["corner_change_mm"] == 0.0
    assert first["corner_mm"] > 1e-3
    by_kind = {}
    for row in others:
        assert row["converged"] and 0.0 <= row["rms_change_mm"] <= row["max_change_mm"]
        by_kind.setdefault(row["kind"], []).append(row["rms_change_mm"])
    assert set(by_kind) == {"step", "quadrature", "kappa", "contact", "layers"}
    # The way to a state leaves less in it than the mesh.
    assert by_kind["step"][0] < 2e-3 < by_kind["layers"][0]
    total = by_kind["step"][0] + by_kind["quadrature"][0] + by_kind["layers"][0]
    assert discretisation_error(rows) == pytest.approx(total)
    # Of two refinements along the face the one that changes more counts.
    finer = [{**rows[-1], "kind": "mesh", "rms_change_mm": change} for change in (0.3, 0.4)]
    assert discretisation_error([*rows, *finer]) == pytest.approx(total + 0.4)
    json.dumps(rows, allow_nan=False)
    # What could not be refined is no error of nothing.
    failed = {**rows[-1], "kind": "mesh", "rms_change_mm": None}
    assert discretisation_error([*rows, failed]) is None


def test_a_state_of_another_head_is_refused(capsys, tmp_path):
    taro = Head.load("taro")
    parameters = taro.tissue.parameters
    save_state(tmp_path / "state.npz", "x", taro, "taro", parameters, np.zeros(8), {}, 0.0)
    for folder, head, words in (
        (tmp_path, "ict", "a state of the head taro, not of ict"),
        (tmp_path / "none", "taro", "no state.npz"),
        (tmp_path, "taro", "do not fit the head"),
    ):
        out = str(tmp_path / "out")
        arguments = ["simulate", "sad", "--head", head, "--from", str(folder), "--out", out]
        with pytest.raises(SystemExit) as left:
            main(arguments)
        printed = capsys.readouterr()
        assert left.value.code == 2 and printed.out == ""
        assert words in printed.err and printed.err.count("\n") == 1
        assert not (tmp_path / "out").exists()
