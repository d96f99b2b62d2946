"""The verification cases, and the command that runs them."""

import json
import math

import numpy as np
import pytest

from modiolus.cli import main
from modiolus.errors import InputError, SolveError
from modiolus.mechanics import DeadForces, FollowerPressure, Load, Problem, Tension
from modiolus.verify import CASES, Case, Check, choose
from modiolus.verify.land import Ventricle, ellipsoid
from modiolus.verify.meshes import box, scaled, side
from modiolus.verify.patch import bent, split, turned

SLOW = {"land-2", "land-3"}


@pytest.mark.parametrize("name", [name for name in CASES if name not in SLOW])
def test_case_passes(name):
    for check in CASES[name].run(False):
        assert check.passed, check


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(SLOW))
def test_slow_case_passes(name):
    for check in CASES[name].run(False):
        assert check.passed, check


@pytest.mark.parametrize(
    ("check", "error", "passed"),
    [
        (Check("absolute", 2.0, 2.1, 0.2), 0.1, True),
        (Check("relative", -2.0, -2.1, 0.01, relative=True), 0.05, False),
        (Check("above", 3.8, 3.9, 0.0, at_least=True), 0.0, True),
        (Check("below", 3.8, 3.7, 0.0, at_least=True), 0.1, False),
    ],
)
def test_check_measures_its_error(check, error, passed):
    assert check.error == pytest.approx(error)
    assert check.passed is passed


@pytest.mark.parametrize("at_least", [False, True])
@pytest.mark.parametrize("got", [math.nan, math.inf])
def test_what_is_not_a_number_fails(got, at_least):
    assert not Check("nothing", 1.0, got, 1e9, at_least=at_least).passed


def test_unknown_case_is_refused_with_the_nearest_names():
    with pytest.raises(InputError, match=r"case 'land-4'.*did you mean .*land-1"):
        choose(["patch", "land-4"])
    assert [case.name for case in choose(["patch", "derivatives"])] == ["derivatives", "patch"]
    assert len(choose([])) == len(CASES)


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as left:
        main(["verify", *arguments])
    return left.value.code, capsys.readouterr()


def test_command_prints_one_json_object(capsys):
    code, printed = run(capsys, "plane-strain", "--json")
    rows = json.loads(printed.out)["cases"]
    assert code == 0
    assert len(rows) == 4
    assert {row["verdict"] for row in rows} == {"pass"}
    assert {"case", "expected", "got", "error", "tolerance"} <= set(rows[0])


def test_command_prints_a_table(capsys):
    code, printed = run(capsys, "plane-strain", "--quiet")
    assert (code, printed.out) == (0, "")
    code, printed = run(capsys, "plane-strain")
    assert code == 0
    assert "4 checks, 0 failed" in printed.out


def test_command_lists_the_cases(capsys):
    code, printed = run(capsys, "--list")
    assert code == 0
    assert [line.split()[0] for line in printed.out.splitlines()] == list(CASES)
    _, printed = run(capsys, "patch", "--list", "--json")
    assert [row["case"] for row in json.loads(printed.out)["cases"]] == ["patch"]


def fails(fine):
    raise SolveError("nothing converges")


def test_command_fails_with_a_case(capsys, monkeypatch):
    wrong = Case("wrong", "wrong", lambda fine: [Check("value", 1.0, 2.0, 0.1)])
    monkeypatch.setitem(CASES, "wrong", wrong)
    monkeypatch.setitem(CASES, "unsolved", Case("unsolved", "unsolved", fails))
    code, printed = run(capsys, "wrong", "unsolved", "--json")
    first, second = json.loads(printed.out)["cases"]
    assert code == 1
    assert (first["verdict"], first["error"]) == ("fail", 1.0)
    assert (second["verdict"], second["got"]) == ("fail", None)
    assert "nothing converges" in second["quantity"]


def test_command_refuses_an_unknown_case(capsys):
    code, printed = run(capsys, "plain-strain", "--json")
    assert code == 2
    assert printed.out == ""
    assert "did you mean plane-strain" in printed.err


def sample(mesh, seed=0):
    rng = np.random.default_rng(seed)
    return rng.integers(0, mesh.n_elements, 30), rng.uniform(size=(30, 3))


def test_awkward_extractions_describe_the_same_block():
    mesh = bent()
    at = sample(mesh)
    factors = np.random.default_rng(1).uniform(0.5, 2.0, mesh.n_params)
    assert np.allclose(scaled(mesh, factors).evaluate(*at), mesh.evaluate(*at))
    turn = turned(mesh, 0, (1, 2, 0), (False, True, True))
    hosts, xi = np.zeros(30, dtype=int), at[1]
    # New direction a runs along old direction (1, 2, 0)[a], the last two backwards.
    old = np.stack([1.0 - xi[:, 2], xi[:, 0], 1.0 - xi[:, 1]], axis=1)
    assert np.allclose(turn.evaluate(hosts, xi), mesh.evaluate(hosts, old))
    assert np.linalg.det(turn.jacobian(hosts, xi)).min() > 0.0
    kinked = split(mesh, np.array([1, 3, 5, 7]), 0, 0)
    assert kinked.n_params == mesh.n_params + 9 * 4
    assert np.allclose(kinked.evaluate(hosts, xi), mesh.evaluate(hosts, xi))


def test_ventricle_is_the_ellipsoid():
    ventricle = Ventricle.build((8, 2, 16))
    elements, xi = sample(ventricle.mesh)
    points = ventricle.mesh.evaluate(elements, xi)
    exact = [ellipsoid(*c, (0, 0, 0)) for c in ventricle.coordinates(elements, xi).tolist()]
    assert np.abs(points - exact).max() < 0.03
    through = ventricle.coordinates(elements, xi)[:, 1]
    short, long = 7.0 + 3.0 * through, 17.0 + 3.0 * through
    radius = np.hypot(points[:, 0], points[:, 1])
    assert np.allclose((radius / short) ** 2 + (points[:, 2] / long) ** 2, 1.0, atol=3e-3)
    base = ventricle.elements(0, True)
    edge = ventricle.mesh.evaluate(base, np.tile([1.0, 0.4, 0.7], (len(base), 1)))
    assert np.allclose(edge[:, 2], 5.0)


def test_ventricle_is_smooth_at_its_apex():
    ventricle = Ventricle.build((3, 1, 8))
    mesh = ventricle.mesh
    moved = mesh.with_parameters(
        mesh.parameters + np.random.default_rng(2).normal(size=mesh.parameters.shape)
    )
    apex = ventricle.elements(0, False)
    places = np.tile([0.0, 0.3, 0.0], (len(apex), 1))
    assert np.ptp(moved.evaluate(apex, places), axis=0).max() < 1e-12
    slopes = moved.evaluate(apex, places, (1, 0, 0))
    # Opposite meridians go through the apex in one line.
    assert np.allclose(slopes[:4], -slopes[4:])


def test_fibres_turn_through_the_wall():
    ventricle = Ventricle.build((3, 1, 8))
    hosts = np.full(3, ventricle.elements(0, True)[0])
    xi = np.array([[0.5, through, 0.0] for through in (0.0, 0.5, 1.0)])
    inner, middle, outer = ventricle.fibres(hosts, xi)
    tangents = ventricle.mesh.jacobian(hosts, xi)
    along = tangents[:, :, 0] / np.linalg.norm(tangents[:, :, 0], axis=1, keepdims=True)
    assert np.allclose(inner, along[0], atol=2e-3)
    assert np.allclose(middle, [0.0, 1.0, 0.0], atol=1e-9)
    assert np.allclose(outer, -along[2], atol=2e-3)


def test_weight_and_pressure_add_up():
    mesh = box((2.0, 3.0, 5.0), (1, 2, 1))
    weight = DeadForces.body(mesh, [0.0, 0.0, -2.0])
    pressure = FollowerPressure(mesh, side(mesh, 1, 3.0), 1, 1)
    problem = Problem(mesh, [1.0, 0.0, 0.0], terms=[weight, pressure])
    rest = problem.rest()
    for load, expected in (
        (Load(forces={"weight": 1.5}), [0.0, 0.0, 1.5 * 2.0 * 30.0]),
        (Load(forces={"pressure": 0.7}), [0.0, 0.7 * 10.0, 0.0]),
        (Load(), [0.0, 0.0, 0.0]),
    ):
        problem.evaluate(rest.parameters, rest.pressure, load)
        # The values' parameters carry the whole force: their functions add up to one.
        assert problem.assembly.forces()[::8].sum(axis=0) == pytest.approx(expected, abs=1e-12)


def test_forces_grow_with_the_load():
    load = Load(forces={"weight": 1.0}).towards(Load(forces={"pressure": 2.0}), 0.25)
    assert load.forces == {"weight": 0.75, "pressure": 0.5}


def test_tension_is_the_energy_of_a_constant_stress():
    mesh = box((1.0, 1.0, 1.0), (1, 1, 1))
    rule = mesh.quadrature()
    directions = np.tile([1.0, 0.0, 0.0], (rule.size, 1))
    tension = Tension(mesh, rule.elements, rule.xi, rule.weights, directions)
    problem = Problem(mesh, [1.0, 0.0, 0.0], terms=[tension])
    moved = mesh.parameters * [1.3, 1.0, 1.0 / 1.3]
    found = problem.evaluate(moved, np.zeros(8), Load(forces={"tension": 4.0}))
    assert found.energies["tension"] == pytest.approx(0.5 * 4.0 * 1.3**2)
