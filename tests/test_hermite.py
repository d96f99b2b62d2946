"""The Hermite space: continuity, exact refinement, point location, measures."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from modiolus.errors import InputError
from modiolus.hermite import (
    HermiteMesh,
    assemble,
    basis,
    bricks,
    gauss,
    grid,
    linear,
    trapezoidal,
)
from modiolus.hermite.rows import same_rows
from modiolus.hermite.tessellate import tessellate


def block(seed: int = 0, shape: tuple[int, int, int] = (4, 3, 2)) -> HermiteMesh:
    """Return a distorted block of (shape - 1) elements."""
    rng = np.random.default_rng(seed)
    points = np.stack(np.meshgrid(*[np.arange(float(n)) for n in shape], indexing="ij"), axis=-1)
    return grid(points + 0.1 * rng.normal(size=points.shape))


def cubes() -> HermiteMesh:
    """Return eight unit cubes."""
    return bricks([np.arange(3.0)] * 3)


def scaled(mesh: HermiteMesh, seed: int = 1) -> HermiteMesh:
    """Return the same field with awkward parameters: scale factors and reversed directions."""
    rng = np.random.default_rng(seed)
    factor = rng.uniform(0.4, 2.5, mesh.n_params) * rng.choice([-1.0, 1.0], mesh.n_params)
    return HermiteMesh(
        mesh.dim,
        mesh.parameters / factor[:, None],
        sp.csr_matrix(mesh.extraction @ sp.diags(factor)),
    )


def places(mesh: HermiteMesh, count: int, seed: int = 2) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.integers(0, mesh.n_elements, count), rng.random((count, mesh.dim))


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_the_values_of_the_basis_sum_to_one_and_the_slopes_interpolate(dim: int) -> None:
    xi = np.random.default_rng(0).random((20, dim))
    values = basis(dim, xi)
    assert np.allclose(values[:, :: 2**dim].sum(axis=1), 1.0)
    corner = basis(dim, np.ones((1, dim)), [1] * dim)[0]
    assert np.argmax(np.abs(corner)) == 4**dim - 1
    assert corner[-1] == pytest.approx(1.0)


@given(degree=st.integers(0, 7), n=st.integers(1, 5))
def test_gauss_integrates_polynomials_of_degree_2n_minus_1(degree: int, n: int) -> None:
    xi, weights = gauss(1, n)
    error = abs(weights @ xi[:, 0] ** degree - 1.0 / (degree + 1))
    assert (error < 1e-14) == (degree < 2 * n)


@given(n=st.integers(2, 6))
def test_the_trapezoidal_rule_reaches_the_borders(n: int) -> None:
    xi, weights = trapezoidal((n, n + 2))
    assert set(np.unique(xi)) >= {0.0, 1.0} and len(xi) == n * (n + 2)
    assert weights @ (1.0 + xi[:, 0] - 2.0 * xi[:, 1]) == pytest.approx(0.5)
    assert weights @ xi[:, 0] ** 2 == pytest.approx(1.0 / 3.0 + 1.0 / (6.0 * (n - 1) ** 2))


@pytest.mark.parametrize("change", [lambda mesh: mesh, scaled])
@pytest.mark.parametrize("counts", [(2, 1, 1), (2, 3, 2)])
def test_refinement_reproduces_the_field_to_round_off(change, counts) -> None:
    mesh = change(block())
    fine = mesh.refine(counts)
    elements, xi = places(fine, 200)
    parent, child = np.divmod(elements, np.prod(counts))
    start = np.stack(
        [child % counts[0], child // counts[0] % counts[1], child // (counts[0] * counts[1])], 1
    )
    expected = mesh.evaluate(parent, (start + xi) / counts)
    assert np.abs(fine.evaluate(elements, xi) - expected).max() < 1e-13
    n = np.array([4, 3, 2]) - 1
    assert fine.n_params == 8 * np.prod(n * counts + 1)


def test_a_refined_mesh_is_still_continuously_differentiable() -> None:
    fine = scaled(block()).refine((2, 2, 2))
    rng = np.random.default_rng(3)
    moved = fine.with_parameters(rng.normal(size=fine.parameters.shape))
    cross = rng.random((6, 2))
    left = moved.jacobian([0] * 6, np.insert(cross, 0, 1.0, axis=1))
    right = moved.jacobian([1] * 6, np.insert(cross, 0, 0.0, axis=1))
    assert np.allclose(left, right)


def test_versions_keep_their_freedom_when_refined() -> None:
    """Two curves that share a node but not its slope stay apart in slope."""
    curve = grid(np.array([[0.0, 0, 0], [1, 0, 0], [2, 1, 0]]))
    extraction = curve.extraction.tolil()
    extraction.resize((8, 7))
    extraction[5, 3], extraction[5, 6] = 0.0, 1.0
    mesh = HermiteMesh(
        1, np.vstack([curve.parameters, [[1.0, 1.0, 0.0]]]), sp.csr_matrix(extraction)
    )
    fine = mesh.refine((2,))
    assert fine.n_params == mesh.n_params + 4
    ends = fine.jacobian([1, 2], [[1.0], [0.0]])[:, :, 0]
    assert not np.allclose(ends[0], ends[1])


def test_a_collapsed_edge_has_no_parameter_of_its_own() -> None:
    mesh = grid(np.array([[[0.0, 0, 0], [0, 0, 0]], [[1, 0, 0], [1, 1, 0]]]))
    rows = mesh.extraction.tolil()
    for row in range(4**2):
        corner, kind = divmod(row, 4)
        if corner in (0, 2) and kind in (2, 3):
            rows[row] = 0.0
    rows[8] = rows[0].copy()
    collapsed = HermiteMesh(2, mesh.parameters, sp.csr_matrix(rows))
    edge = collapsed.evaluate([0] * 5, np.stack([np.zeros(5), np.linspace(0, 1, 5)], 1))
    assert np.ptp(edge, axis=0).max() < 1e-15
    fine = collapsed.refine((2, 2))
    assert fine.measures(5).sum() == pytest.approx(collapsed.measures(5).sum(), rel=1e-6)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 1000))
def test_points_of_the_mesh_are_found_again(seed: int) -> None:
    mesh = block(seed)
    elements, xi = places(mesh, 40, seed)
    points = mesh.evaluate(elements, xi)
    found = mesh.locate(points)
    assert found.inside.all()
    assert np.abs(mesh.evaluate(found.elements, found.xi) - points).max() < 1e-9


def test_points_outside_are_said_to_be_outside_with_their_distance() -> None:
    found = cubes().locate([[1.0, 1.0, 3.5], [-3.0, 1.0, -4.0], [0.3, 0.4, 0.5]])
    assert found.inside.tolist() == [False, False, True]
    assert found.distance == pytest.approx([1.5, 5.0, 0.0], abs=1e-9)


def test_lengths_areas_and_volumes_of_simple_bodies() -> None:
    turn = np.arange(16) * np.pi / 8
    circle = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    assert grid(circle, [True]).measures().sum() == pytest.approx(2 * np.pi, rel=2e-3)
    plate = grid(np.stack(np.meshgrid([0.0, 2.0], [0.0, 3.0], [0.0], indexing="ij"), -1)[:, :, 0])
    assert plate.measures().sum() == pytest.approx(6.0)
    assert block().subset([2]).measures().sum() == pytest.approx(block().measures()[2])


def test_a_linear_mesh_is_represented_exactly() -> None:
    rng = np.random.default_rng(0)
    corners = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)], dtype=float)
    vertices = corners + 0.1 * rng.normal(size=corners.shape)
    mesh = linear(vertices, [list(range(8))])
    xi = rng.random((30, 3))
    weights = np.prod(np.where(corners[None] > 0.5, xi[:, None], 1.0 - xi[:, None]), axis=2)
    assert np.allclose(mesh.evaluate([0] * 30, xi), weights @ vertices)
    assert mesh.n_params == 8


def test_faces_share_the_parameters_of_the_volume() -> None:
    mesh = block()
    face = mesh.face([0, 3], 2, 1)
    xi = np.random.default_rng(0).random((2, 2))
    expected = mesh.evaluate([0, 3], np.column_stack([xi, [1.0, 1.0]]))
    assert np.allclose(face.evaluate([0, 1], xi), expected)
    assert face.parameters is mesh.parameters


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((4, np.zeros((2, 3)), sp.csr_matrix((4, 2))), "dim"),
        ((1, np.zeros((2, 2)), sp.csr_matrix((4, 2))), "parameters"),
        ((1, np.zeros((2, 3)), sp.csr_matrix((5, 2))), "extraction"),
    ],
)
def test_arrays_that_make_no_mesh_are_refused(arguments, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        HermiteMesh(*arguments)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda mesh: mesh.functions([99_999_999], [[0, 0, 0]]), "elements: 99999999"),
        (lambda mesh: mesh.evaluate([-1], [[0, 0, 0]]), "elements: -1"),
        (lambda mesh: mesh.evaluate([0.7], [[0, 0, 0]]), "whole numbers"),
        (lambda mesh: mesh.face(np.ones(8, dtype=bool), 0, 0), "whole numbers"),
        (lambda mesh: mesh.evaluate([0, 1], np.zeros((3, 2))), r"xi: shape \(3, 2\)"),
        (lambda mesh: mesh.evaluate([0, 1], np.zeros((1, 3))), "xi: 1 for 2 elements"),
        (lambda mesh: mesh.evaluate([0], [[0, 0, np.nan]]), "xi: .*NaN"),
        (lambda mesh: mesh.evaluate([0], [[0, 0, 0]], (1, 0)), "derivative"),
        (lambda mesh: mesh.face([0], 3, 0), "axis 3"),
        (lambda mesh: mesh.face([0], 0, 2), "side 2"),
        (lambda mesh: mesh.face_parameters([8], 0, 0), "elements: 8"),
        (lambda mesh: mesh.subset([[0]]), "elements: shape"),
        (lambda mesh: mesh.refine((2, 2)), "counts"),
        (lambda mesh: mesh.refine((2, 2, 0)), "counts"),
        (lambda mesh: mesh.locate(np.zeros((3, 2))), r"points: shape \(3, 2\)"),
        (lambda mesh: mesh.locate([[0, 0, np.inf]]), "points: .*infinity"),
        (lambda mesh: mesh.locate([[0, 0, 0]], 0), "candidates"),
        (lambda mesh: mesh.with_parameters(np.nan * mesh.parameters), "parameters: .*NaN"),
        (lambda mesh: tessellate(mesh, 0), "divisions"),
        (lambda mesh: HermiteMesh(3, mesh.parameters, mesh.extraction.tocsc()), "CSR"),
        (lambda mesh: grid(np.zeros((4, 3, 2))), r"points: shape \(4, 3, 2\)"),
        (lambda mesh: grid(np.zeros(3)), "no grid"),
        (lambda mesh: grid(np.zeros((4, 4, 3)), [True]), "periodic"),
        (lambda mesh: grid(np.zeros((2, 3)), [True]), "3 where it closes"),
        (lambda mesh: bricks([[0, 1]] * 2), "ticks"),
        (lambda mesh: bricks([[0, 1], [0, 2], [1, 0]]), "ticks"),
        (lambda mesh: linear(np.zeros((4, 3)), [[0, 1, 2, 4]]), "cells: 4"),
        (lambda mesh: linear(np.zeros((4, 3)), [[0, 1, 2]]), "give 2, 4 or 8"),
        (lambda mesh: assemble([[0, 2]], np.zeros((2, 2, 3))), "corners: 2"),
        (lambda mesh: assemble([[0, 1]], np.zeros((2, 4, 3))), "derivatives: shape"),
        (lambda mesh: gauss(3, 0), "rule"),
        (lambda mesh: trapezoidal((2, 1)), "rule"),
    ],
)
def test_what_does_not_fit_the_mesh_is_refused_in_one_line(call, words: str) -> None:
    with pytest.raises(InputError, match=words) as error:
        call(cubes())
    assert "\n" not in str(error.value) and ";" in str(error.value)


def test_a_mesh_keeps_its_own_parameters() -> None:
    mesh = cubes()
    moved = mesh.parameters + 1.0
    other = mesh.with_parameters(moved)
    moved[:] = 0.0
    assert np.allclose(other.evaluate([0], [[0, 0, 0]]), 1.0)
    assert len({mesh, other}) == 2


def test_rows_are_told_apart_but_for_round_off() -> None:
    tie = 0.3000000005
    rows = np.array(
        [[0, 0, 0], [tie, 1, 0], [np.nextafter(tie, 1), 1, 0], [2 * tie, 2, 0], [1, 0, 0]]
    )
    index, factor, first = same_rows(sp.csr_matrix(rows))
    assert index.tolist() == [-1, 0, 0, 1, 2]
    assert factor.tolist() == [0, 1, 1, 1, 1] and first.tolist() == [1, 3, 4]
    index, factor, first = same_rows(sp.csr_matrix(rows), scaled=True)
    assert index.tolist() == [-1, 0, 0, 0, 1]
    assert factor.tolist() == [0, 1, 1, 2, 1] and first.tolist() == [1, 4]
    index, _, _ = same_rows(sp.csr_matrix(rows), scaled=True, apart=np.array([0, 0, 1, 0, 1]))
    assert index.tolist() == [-1, 0, 1, 0, 2]
