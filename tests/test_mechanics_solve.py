"""Whole solutions: patch test, closed forms, contact, failures and interruption."""

import numpy as np
import pytest
from scipy.optimize import brentq

from modiolus import hermite
from modiolus.errors import InputError, SolveError
from modiolus.mechanics import (
    Continuation,
    DeadForces,
    FibreLaw,
    FibreQuadrature,
    Fibres,
    Load,
    Problem,
    RigidContact,
    Settings,
    Springs,
    clamp,
    face_points,
    solve,
    symmetry_plane,
)
from modiolus.mechanics.beam import bend_beam
from modiolus.mechanics.kernels import fibre
from modiolus.mechanics.linear import Pardiso, SuperLU, symmetric_product

FINE = Settings(tolerance=1e-10)


def box(counts, size):
    ticks = [np.linspace(0.0, s, n + 1) for n, s in zip(counts, size, strict=True)]
    return hermite.grid(np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1))


def cube_with_fibres(activation_law=None, c10=2.0):
    """A cube free to change its shape, with fibres along x everywhere."""
    mesh = box((1, 1, 1), (1.0, 1.0, 1.0))
    elements, xi, weights = mesh.gauss_points(4)
    directions = np.tile([1.0, 0.0, 0.0], (len(elements), 1))
    rule = FibreQuadrature(elements, xi, weights, directions, np.zeros(len(elements), dtype=int))
    fixed = np.zeros((mesh.n_params, 3), dtype=bool)
    for axis in range(3):
        within, across = mesh.face_parameters([0], axis, 0)
        fixed[within, axis] = True
        fixed[np.ix_(across, [k for k in range(3) if k != axis])] = True
    return Problem(
        mesh,
        [c10, 0.0, 0.0],
        kappa=50.0,
        fixed=fixed,
        terms=[Fibres(mesh, rule, ["all"], activation_law)],
    )


@pytest.mark.parametrize(("amount", "tolerance"), [(0.0, 1e-8), (2.0, 1e-2)])
def test_patch_of_uneven_elements_stretches_evenly(amount, tolerance):
    # Uneven elements are integrated exactly; the Jacobians of bent ones are polynomials of
    # too high a degree for any usual rule, and the error is that of the quadrature.
    ticks = [np.array([0.0, 7.0, 20.0]), np.array([0.0, 12.0, 20.0]), np.array([0.0, 9.0, 20.0])]
    mesh = hermite.grid(np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1))
    bent = mesh.parameters.copy()
    bent[8 * 13 : 8 * 14] += np.random.default_rng(1).uniform(-amount, amount, (8, 3))
    mesh = mesh.with_parameters(bent)
    # Rollers on three sides, the end pulled along x, the other two sides free.
    stretch = np.array([1.2, 1.2**-0.5, 1.2**-0.5])
    elements = np.arange(8)
    fixed = np.zeros((mesh.n_params, 3), dtype=bool)
    for axis, side in ((0, 0), (1, 0), (2, 0), (0, 1)):
        held, _ = mesh.face_parameters(elements[(elements >> axis) & 1 == side], axis, side)
        fixed[held, axis] = True
    prescribed = np.where(fixed, mesh.parameters * (stretch - 1.0), 0.0)
    problem = Problem(mesh, [2.0, 1.0, 0.0], fixed=fixed)
    state = solve(problem, Load(prescribed=prescribed), settings=FINE)
    assert np.abs(state.parameters - mesh.parameters * stretch).max() < tolerance
    assert state.statistics.J_min == pytest.approx(1.0, abs=tolerance)
    assert state.statistics.J_max == pytest.approx(1.0, abs=tolerance)
    # No lateral stress: p = -W1 dI1/dF - W2 dI2/dF along the free sides, in closed form.
    lateral = stretch[1]
    expected = -lateral * (
        2.0 * (2.0 * lateral - 2.0 / 3.0 * (stretch**2).sum() / lateral)
        + 1.0
        * (
            2.0 * ((stretch**2).sum() * lateral - lateral**3)
            - 4.0 / 3.0 * (1.0 / stretch**2).sum() / lateral
        )
    )
    found = state.pressure_at(*Problem.gauss_points(mesh))
    assert np.abs(found - expected).max() < 100.0 * tolerance


@pytest.mark.parametrize("activation", [0.01, 0.1, 1.0])
def test_free_cube_shortens_to_the_closed_form(activation):
    problem = cube_with_fibres()
    state = solve(problem, problem.load({"all": activation}), settings=FINE)
    law = FibreLaw().array()

    # Uniaxial and incompressible: dW/dλ + ψ'(λ) = 0 with W = c10 (λ² + 2/λ - 3).
    def balance(stretch):
        return 2.0 * 2.0 * (stretch - stretch**-2) + fibre(stretch, activation, 1.0, law)[1]

    expected = brentq(balance, 0.3, 1.0)
    centre = ([0], [[0.5, 0.5, 0.5]])
    assert state.stretch(*centre, [[1.0, 0.0, 0.0]])[0] == pytest.approx(expected, abs=1e-5)
    assert state.volume_ratio(*centre)[0] == pytest.approx(1.0, abs=1e-6)
    assert state.statistics.wrong_pivots == 0
    assert state.activations == {"all": activation}


def test_small_changes_reuse_the_factors():
    problem = cube_with_fibres()
    run = Continuation(problem)
    run.run(problem.load({"all": 0.3}))
    state = run.run(problem.load({"all": 0.303}))
    assert state.statistics.factorisations <= 4


@pytest.mark.parametrize(("force", "unstable"), [(0.008, 0), (0.03, 2)])
def test_a_straight_column_says_that_it_would_buckle(force, unstable):
    """Beyond Euler's load of 0.0123 mN the column stays straight, and is stable no more."""
    mesh = box((2, 1, 1), (10.0, 1.0, 1.0))
    last = np.array([mesh.evaluate([0, 1], np.full((2, 3), 0.5))[:, 0].argmax()])
    elements, xi, areas = face_points(mesh, last, 0, 1)
    push = DeadForces(mesh, elements, xi, areas[:, None] * [-1.0, 0.0, 0.0], "push")
    first = 1 - last
    problem = Problem(
        mesh, [1.0, 0.0, 0.0], kappa=50.0, terms=[push], fixed=clamp(mesh, first, 0, 0)
    )
    state = solve(problem, Load(forces={"push": force}))
    assert state.statistics.wrong_pivots == unstable
    assert any("buckle" in doubt for doubt in state.statistics.doubts) == (unstable > 0)


def test_what_stops_forces_is_named():
    problem = cube_with_fibres()
    push = DeadForces(problem.mesh, [0], [[1.0, 0.5, 0.5]], [[1.0, 0.0, 0.0]], "pull")
    held = Problem(problem.mesh, [2.0, 0.0, 0.0], terms=[push], fixed=problem.fixed)
    with pytest.raises(SolveError, match=r"of the load \(pull\)"):
        solve(held, Load(forces={"pull": 1e4}), settings=Settings(max_steps=2))


@pytest.fixture(scope="module")
def shallow_arch():
    """Half of a shallow arch, clamped at its end and pressed down at its crown."""
    x, y, z = np.linspace(0.0, 20.0, 5), np.array([0.0, 4.0]), np.array([0.0, 1.5])
    corners = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
    corners[..., 2] += 3.0 * np.cos(np.pi * corners[..., 0] / 40.0) ** 2
    mesh = hermite.grid(corners)
    order = mesh.evaluate(np.arange(4), np.full((4, 3), 0.5))[:, 0].argsort()
    fixed = clamp(mesh, order[-1:], 0, 1) | symmetry_plane(mesh, order[:1], 0, 0)
    for side in (0, 1):
        fixed[mesh.face_parameters(np.arange(4), 1, side)[0], 1] = True
    at = np.array([[0.1, 0.25, 0.5], [0.1, 0.75, 0.5], [0.3, 0.25, 0.5], [0.3, 0.75, 0.5]])
    push = DeadForces(mesh, np.repeat(order[:1], 4), at, np.tile([0.0, 0.0, -0.25], (4, 1)), "push")
    problem = Problem(mesh, [2.0, 0.0, 0.0], kappa=200.0, terms=[push], fixed=fixed)

    def sag(state):
        moved = state.mesh.with_parameters(state.displacement)
        return -moved.evaluate(order[:1], [[0.0, 0.5, 0.5]])[0, 2]

    return problem, sag


def test_an_arch_snaps_through(shallow_arch):
    problem, sag = shallow_arch
    seen = []
    run = Continuation(problem)
    run.report = lambda fraction, text: seen.append((fraction, sag(run.state)))
    run.run(Load(forces={"push": 0.3}))
    # It gives way little at first, then jumps from above the chord to below it.
    sags = np.array([found for _, found in seen])
    jump = int(np.argmax(np.diff(sags)))
    assert sags[jump] < 2.0 and sags[jump + 1] > 4.5
    assert run.state.statistics.wrong_pivots == 0


@pytest.mark.parametrize(
    ("load", "words"),
    [
        (Load(forces={"pusch": 0.3}), "force 'pusch': no such force; did you mean push"),
        (Load(forces={"push": np.nan}), "push: factor nan"),
        (Load({"mentalis": 0.3}), "muscle 'mentalis'"),
        (Load(prescribed=np.zeros((3, 3))), "prescribed: shape"),
        (Load(jaw=np.inf), "jaw: angle inf"),
    ],
)
def test_a_load_of_what_there_is_not_is_refused(shallow_arch, load, words):
    with pytest.raises(InputError, match=words):
        solve(shallow_arch[0], load)


def test_relaxation_finds_the_equilibrium_beyond_a_jump(shallow_arch):
    problem, sag = shallow_arch
    before = Continuation(problem).run(Load(forces={"push": 0.12}))
    assert sag(before) < 1.5
    load = Load(forces={"push": 0.25})
    path = Continuation(problem).run(load)
    settings = Settings(first_step=1.0, least_step=0.5)
    relaxed = Continuation(problem, before, settings=settings).run(load)
    assert relaxed.statistics.jumps == 1 and path.statistics.jumps == 0
    assert sag(path) > 4.5
    assert sag(relaxed) == pytest.approx(sag(path), abs=5e-3)


class Floor:
    """The half space below a height."""

    def __init__(self, height):
        self.height = height

    def sample(self, points):
        n = len(points)
        up = np.tile([0.0, 0.0, 1.0], (n, 1))
        return points[:, 2] - self.height, up, np.zeros((n, 3, 3))


def test_block_pressed_on_a_floor_stops_there():
    mesh = box((2, 2, 1), (20.0, 20.0, 10.0))
    top = clamp(mesh, np.arange(4), 2, 1)
    down = np.zeros((mesh.n_params, 3))
    values = np.zeros(mesh.n_params, dtype=bool)
    values[::8] = True
    down[values & top[:, 2], 2] = -1.0
    floor = RigidContact(mesh, Floor(-0.4), *face_points(mesh, np.arange(4), 2, 0))
    problem = Problem(mesh, [2.0, 1.0, 0.0], terms=[floor], fixed=top)
    seen = []
    state = solve(problem, Load(prescribed=down), report=lambda f, text: seen.append((f, text)))
    assert 0.0 < state.statistics.max_penetration_mm < 0.3
    assert abs(state.statistics.volume_change) < 1e-6
    assert [f for f, _ in seen] == sorted(f for f, _ in seen)
    assert seen[-1][0] == 1.0


def test_springs_hold_a_floating_block_where_it_is():
    mesh = box((1, 1, 1), (10.0, 10.0, 10.0))
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    springs = Springs(mesh, np.zeros(4, dtype=int), corners, 1e3)
    elements, xi, weights = mesh.gauss_points(2)
    rule = FibreQuadrature(
        elements, xi, weights, np.tile([0.0, 0.0, 1.0], (8, 1)), np.zeros(8, dtype=int)
    )
    problem = Problem(mesh, [1.0, 0.0, 0.0], terms=[springs, Fibres(mesh, rule, ["upright"])])
    state = solve(problem, problem.load({"upright": 0.02}))
    moved = state.mesh.evaluate(np.zeros(4, dtype=int), corners) - mesh.evaluate([0] * 4, corners)
    force = moved[:, 2] * 1e3
    assert force.sum() == pytest.approx(0.0, abs=1e-3 * np.abs(force).max())
    assert state.statistics.converged


def test_scipy_gives_the_same_state():
    problem = cube_with_fibres()
    states = [
        Continuation(problem, solver=solver, settings=FINE).run(problem.load({"all": 0.2}))
        for solver in (Pardiso(), SuperLU())
    ]
    assert np.abs(states[0].parameters - states[1].parameters).max() < 1e-6
    assert states[1].statistics.wrong_pivots is None


def test_pressures_are_eliminated_after_what_they_act_on_and_no_pivot_is_perturbed():
    problem = cube_with_fibres()
    state = problem.rest()
    load = problem.load({"all": 0.2})
    problem.evaluate(state.parameters, state.pressure, load, tangent=True)
    matrix = problem.tangent()
    solver = Pardiso(single=False)
    order = solver._order(matrix)
    assert (np.sort(order) == np.arange(problem.n_unknowns)).all()
    place = np.argsort(order)
    rows, columns = matrix.nonzero()
    pressures = columns >= problem.assembly.n_displacements
    assert (place[rows[pressures]] < place[columns[pressures]]).all()
    solver.factorise(matrix)
    assert solver._pardiso.get_iparm(14) == 0
    assert solver.negative_pivots == problem.assembly.n_pressures
    right = np.cos(np.arange(problem.n_unknowns))
    assert np.abs(symmetric_product(matrix, solver.solve(right)) - right).max() < 1e-10


def test_an_expected_structure_gives_the_same_factors():
    problem = cube_with_fibres()
    state = problem.rest()
    problem.evaluate(state.parameters, state.pressure, problem.load({"all": 0.2}), tangent=True)
    matrix = problem.tangent()
    right = np.cos(np.arange(problem.n_unknowns))
    found = []
    for expected in (False, True):
        solver = Pardiso()
        if expected:
            solver.expect(problem.assembly.structure)
        solver.factorise(matrix)
        found.append(solver.solve(right))
    assert (found[0] == found[1]).all()


@pytest.mark.parametrize("value", [-0.1, 1.2, float("nan")])
def test_impossible_activation_is_refused(value):
    with pytest.raises(InputError, match="all: activation"):
        cube_with_fibres().load({"all": value})


def test_unknown_muscle_is_refused_with_the_nearest_name():
    with pytest.raises(InputError, match="did you mean all"):
        cube_with_fibres().load({"al": 0.1})


def test_inverted_mesh_is_refused():
    mesh = box((1, 1, 1), (1.0, 1.0, 1.0))
    with pytest.raises(InputError, match="element 0 is inverted"):
        Problem(mesh.with_parameters(mesh.parameters * [-1.0, 1.0, 1.0]), [1.0, 0.0, 0.0])


def test_failure_says_how_far_it_came_and_keeps_the_last_state():
    mesh = box((1, 1, 1), (10.0, 10.0, 10.0))
    fixed = clamp(mesh, [0], 2, 1) | clamp(mesh, [0], 2, 0)
    through = np.zeros((mesh.n_params, 3))
    through[8 * 4 :: 8, 2] = -12.0  # the upper nodes are pushed through the lower ones
    problem = Problem(mesh, [1.0, 0.0, 0.0], fixed=fixed)
    run = Continuation(problem, settings=Settings(max_steps=25))
    with pytest.raises(SolveError, match=r"stopped at \d+\.\d% of the load.*smallest J.*try"):
        run.run(Load(prescribed=through))
    assert run.state.statistics.J_min > 0.05
    assert 0.0 < run.state.displacement[8 * 4, 2] / -12.0 < 0.9


def test_interruption_keeps_the_last_state():
    problem = cube_with_fibres()

    def stop(fraction, message):
        if fraction > 0.1:
            raise KeyboardInterrupt

    run = Continuation(problem, report=stop)
    with pytest.raises(KeyboardInterrupt):
        run.run(problem.load({"all": 0.5}))
    reached = run.state.activations["all"]
    assert 0.05 < reached < 0.5
    run.report = None
    assert run.run(problem.load({"all": 0.5})).activations == {"all": 0.5}


@pytest.fixture(scope="module")
def beams():
    return {angle: bend_beam(angle, 0.02) for angle in (0.0, 36.0, 60.0)}


def test_beam_with_straight_fibres_bends_towards_the_slab_and_does_not_twist(beams):
    straight = beams[0.0]
    assert straight.tip[2] > 20.0
    assert straight.tip[0] < 0.0
    assert abs(straight.tip[1]) < 1e-3
    assert abs(straight.twist) < 1e-3


def test_beam_with_oblique_fibres_twists(beams):
    # Shortening from +x towards +y shears the upper side, which goes to -y on the way to the
    # tip: a right-handed turn of the tip about +x.
    assert beams[36.0].twist > 10.0
    assert beams[60.0].twist > 10.0
    assert beams[0.0].bend > beams[36.0].bend > beams[60.0].bend
    ratios = [abs(beams[a].twist) / beams[a].bend for a in (0.0, 36.0, 60.0)]
    assert ratios == sorted(ratios)


def test_beam_refuses_an_impossible_angle():
    with pytest.raises(InputError, match="angle: 120"):
        bend_beam(120.0, 0.02)
