"""Fits to clouds, surfaces and points."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import scipy.sparse as sp

from modiolus.anatomy import Surface
from modiolus.errors import InputError, SolveError
from modiolus.fitting import (
    CloudTarget,
    PairTarget,
    PointTarget,
    Smoothing,
    SurfaceTarget,
    fit,
    sobolev,
)
from modiolus.fitting.definite import Definite
from modiolus.hermite import HermiteMesh, grid


def patch(n: int = 4, height: float = 8.0) -> HermiteMesh:
    x, y = np.meshgrid(np.linspace(-5, 5, n), np.linspace(-5, 5, n), indexing="ij")
    return grid(np.stack([x, y, np.full_like(x, height)], axis=-1))


def sphere(radius: float = 10.0) -> Surface:
    import pyvista

    ball = pyvista.Icosphere(radius=radius, nsub=5)
    return Surface(ball.points, ball.regular_faces, "sphere")


def itself(mesh: HermiteMesh) -> HermiteMesh:
    return mesh


def test_a_patch_settles_on_a_sphere() -> None:
    target = SurfaceTarget("sphere", itself, sphere())
    result = fit(patch(), [target], Smoothing(second=1e-4))
    radius = np.linalg.norm(result.mesh.evaluate(*result.mesh.gauss_points(6)[:2]), axis=1)
    assert np.abs(radius - 10.0).max() < 0.03
    assert result.groups["sphere"].rms < 0.02


def test_a_cloud_is_fitted_and_its_report_is_that_of_the_residual() -> None:
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-4, 4, (400, 2)), np.zeros(400)])
    points[:, 2] = 8.0 + 0.1 * points[:, 0] ** 2
    result = fit(patch(), [CloudTarget("cloud", itself, points)], Smoothing(second=1e-5))
    place = result.mesh.locate(points)
    assert result.groups["cloud"].rms == pytest.approx(
        np.sqrt(np.mean(place.distance**2)), abs=2e-4
    )
    assert place.distance.max() < 0.02


def test_far_points_are_left_out() -> None:
    points = np.array([[0.0, 0.0, 8.5], [1.0, 1.0, 30.0]])
    target = CloudTarget("cloud", itself, points, reject=5.0)
    assert fit(patch(), [target]).groups["cloud"].count == 1


def test_pairs_come_to_be_so_far_apart() -> None:
    mesh = patch()
    first, second = (np.array([0]), np.array([[0.0, 0.0]])), (np.array([8]), np.array([[1.0, 1.0]]))
    apart = np.array([[-9.0, -10.0, 1.0]])
    pair = PairTarget("pair", first, second, apart, 1e3)
    result = fit(mesh, [pair], Smoothing(first=1e-3, second=1e-3, relative=True), iterations=1)
    found = result.mesh.evaluate(*first) - result.mesh.evaluate(*second)
    np.testing.assert_allclose(found, apart, atol=1e-3)
    with pytest.raises(InputError, match="give one each"):
        PairTarget("pair", first, second, np.zeros((2, 3)))


def test_penalties_add_up_each_from_its_own_mesh() -> None:
    mesh = patch()
    up, down = (mesh.with_parameters(mesh.parameters * [1.0, 1.0, factor]) for factor in (1.5, 0.5))
    bent = mesh.with_parameters(mesh.parameters + 0.1)
    held = PointTarget("held", np.array([0]), np.array([[0.0, 0.0]]), np.array([[-5.0, -5.0, 8.0]]))
    penalties = [Smoothing(first=1.0, relative=rest) for rest in (up, down)]
    found = fit(bent, [held], penalties, iterations=1).mesh
    np.testing.assert_allclose(found.parameters, mesh.parameters, atol=1e-4)


def test_fixed_parameters_stay_and_constraints_hold() -> None:
    mesh = patch()
    fixed = np.zeros((mesh.n_params, 3), dtype=bool)
    fixed[:, 0] = True
    matrix = sp.csr_matrix(([1.0, -1.0], ([0, 0], [3 * 0 + 2, 3 * 4 + 2])), (1, 3 * mesh.n_params))
    target = PointTarget("pull", np.array([4]), np.array([[0.5, 0.5]]), np.array([[9.0, 9.0, 9.0]]))
    result = fit(mesh, [target], Smoothing(second=1e-3), fixed, (matrix, np.array([0.25])))
    moved = result.mesh.parameters
    assert np.array_equal(moved[:, 0], mesh.parameters[:, 0])
    assert moved[0, 2] - moved[4, 2] == pytest.approx(0.25, abs=1e-8)


def test_sliding_lets_data_go_along_the_surface() -> None:
    points = np.array([[0.5, 0.0, 8.4]])
    stuck, slid = (
        fit(patch(), [CloudTarget("c", itself, points, sliding=s)], iterations=1).mesh.parameters
        for s in (1.0, 0.0)
    )
    assert np.abs(slid - stuck).max() < 1e-6


def test_smoothing_is_zero_for_what_it_does_not_penalise() -> None:
    mesh = patch()
    bend = sobolev(mesh, Smoothing(first=0.0, second=1.0))
    assert np.abs(bend @ mesh.parameters).max() < 1e-10
    stretch = sobolev(mesh, Smoothing(first=(1.0, 0.0), second=0.0))
    area = np.trace(mesh.parameters.T @ (stretch @ mesh.parameters))
    assert area == pytest.approx(9 * (10.0 / 3) ** 2)


def test_a_fit_without_targets_or_with_a_wrong_mask_is_refused() -> None:
    mesh = patch()
    with pytest.raises(InputError, match="nothing to fit"):
        fit(mesh, [])
    target = PointTarget("p", np.array([0]), np.array([[0.5, 0.5]]), np.zeros((1, 3)))
    with pytest.raises(InputError, match="fixed"):
        fit(mesh, [target], fixed=np.zeros((2, 3), dtype=bool))
    # Of whole numbers, `~` would be no mask at all.
    with pytest.raises(InputError, match="fixed: int"):
        fit(mesh, [target], fixed=np.ones((mesh.n_params, 3), dtype=int))
    with pytest.raises(InputError, match="constraints"):
        fit(mesh, [target], constraints=(sp.csr_matrix((1, 5)), np.zeros(1)))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: CloudTarget("c", itself, np.zeros((2, 2))), r"c: shape \(2, 2\)"),
        (lambda: CloudTarget("c", itself, np.full((2, 3), np.nan)), "c: .*NaN"),
        (lambda: CloudTarget("c", itself, np.zeros((2, 3)), np.ones(3)), "c: weights"),
        (lambda: CloudTarget("c", itself, np.zeros((2, 3)), -1.0), "c: weights"),
        (lambda: CloudTarget("c", itself, np.zeros((2, 3)), sliding=2.0), "c: sliding"),
        (lambda: SurfaceTarget("s", itself, sphere(), weight=np.nan), "s: weights"),
        (lambda: PointTarget("p", np.zeros(2, int), np.zeros((2, 2)), np.zeros((1, 3))), "places"),
        (
            lambda: PointTarget(
                "p", np.zeros(1, int), np.zeros((1, 2)), np.zeros((1, 3)), normals=np.zeros(3)
            ),
            "p: normals",
        ),
        (lambda: sobolev(patch(), Smoothing(second=(1.0, 2.0))), "smoothing: second"),
        (lambda: sobolev(patch(), Smoothing(first=-1.0)), "smoothing: first"),
        (
            lambda: fit(patch(), [CloudTarget("c", lambda m: m.subset([0]), np.zeros((1, 3)))]),
            "c: its part",
        ),
    ],
)
def test_targets_that_do_not_fit_are_refused(make, words: str) -> None:
    with pytest.raises(InputError, match=words):
        make()


def test_a_fit_without_a_unique_solution_says_so() -> None:
    target = CloudTarget("c", itself, np.zeros((1, 3)))
    with pytest.raises(SolveError, match=r"fit: .*smoothing"):
        fit(patch(), [target], Smoothing(second=0.0), damping=0.0)


@pytest.mark.parametrize("mkl", [True, False])
def test_systems_of_one_structure_are_solved_one_after_another(
    mkl: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not mkl:
        monkeypatch.setitem(sys.modules, "pypardiso", None)
    chain = sp.diags([[-1.0] * 19, [3.0] * 20, [-1.0] * 19], [-1, 0, 1], format="csr")
    wider = chain + sp.csr_matrix(([1.0], ([0], [0])), (20, 20))
    full = sp.csr_matrix(chain.toarray() + 1.0)
    wanted, solver = np.arange(20.0), Definite()
    # The last is not definite, and has its solution all the same.
    for matrix in (chain, wider, full, sp.csr_matrix(full - 2.0 * sp.identity(20))):
        found = solver.solve(matrix, matrix @ wanted)
        np.testing.assert_allclose(found, wanted, atol=1e-10)
    with pytest.raises(RuntimeError, match="singular"):
        solver.solve(sp.diags([1.0] * 19 + [0.0], format="csr"), wanted)


def test_the_report_is_of_what_is_minimised_and_joins_targets_of_one_name() -> None:
    place, points = (np.array([4]), np.array([[0.5, 0.5]])), np.array([[0.3, 0.0, 8.4]])
    up = np.array([[0.0, 0.0, 1.0]])
    far, near = (PointTarget("p", *place, points + k, 1.0, up, 0.25) for k in ([0, 0, 1], 0))
    groups = fit(patch(), [far, near], iterations=0).groups
    # 1.4 and 0.4 mm along the normal, 0.3 mm across it.
    squares = [1.4**2 + 0.25 * 0.3**2, 0.4**2 + 0.25 * 0.3**2]
    assert groups["p"].count == 2
    assert groups["p"].rms == pytest.approx(np.sqrt(np.mean(squares)))
