from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from modiolus.errors import InputError
from modiolus.face.muscle import Muscle
from modiolus.hermite import grid


def beam(size=(30.0, 6.0, 2.0), counts=(3, 2, 1)):
    axes = [np.linspace(0.0, s, n + 1) for s, n in zip(size, counts, strict=True)]
    return Muscle("beam", grid(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)), "strap")


def ring(radius=20.0, width=4.0, height=2.0, n=12):
    angle = 2 * np.pi * np.arange(n) / n
    r, z = radius + np.array([0.0, width]), np.array([0.0, height])
    a, r, z = np.meshgrid(angle, r, z, indexing="ij")
    points = np.stack([r * np.cos(a), r * np.sin(a), z], axis=-1)
    return Muscle("ring", grid(points, (True, False, False)), "ring")


def bend(points):
    x, y, z = np.asarray(points).T
    return np.stack([x + 0.01 * y * z, y + 0.002 * x**2, z + 0.003 * x * y], axis=1)


def test_quadrature_of_a_beam_has_its_volume_and_straight_fibres():
    rule = beam().quadrature()
    assert rule.points.shape == (6 * 16, 3)
    assert_allclose(rule.weights.sum(), 360.0, rtol=1e-12)
    assert_allclose(rule.weights @ rule.points / 360.0, [15.0, 3.0, 1.0], rtol=1e-12)
    assert_allclose(rule.directions, np.tile([1.0, 0.0, 0.0], (96, 1)), atol=1e-12)


def test_fibre_angle_turns_the_fibres_in_the_sheet():
    muscle = beam()
    n = muscle.mesh.n_params // 8
    for angles, expected in (
        ([0.5, 0.0, 0.0], [np.cos(0.5), np.sin(0.5), 0.0]),
        ([0.0, 0.5, 0.0], [np.cos(0.5), 0.0, -np.sin(0.5)]),
        ([0.0, 0.0, 0.5], [1.0, 0.0, 0.0]),
    ):
        turned = Muscle("beam", muscle.mesh, "sheet", np.tile(angles, (n, 1)))
        rule = turned.quadrature()
        assert_allclose(rule.directions, np.tile(expected, (len(rule.weights), 1)), atol=1e-12)
        frame = turned.frame(rule.elements, rule.xi)
        assert_allclose(
            frame @ frame.transpose(0, 2, 1), np.tile(np.eye(3), (96, 1, 1)), atol=1e-12
        )


def test_lengths_and_ends_of_a_beam():
    muscle = beam()
    assert_allclose(muscle.length(), 30.0, rtol=1e-12)
    assert_allclose(muscle.span(), 30.0, rtol=1e-12)
    assert_allclose(muscle.span(lambda x: x * [0.8, 1.0, 1.0]), 24.0, rtol=1e-12)
    assert_allclose(muscle.insertion(), [30.0, 3.0, 1.0], rtol=1e-12)
    points, areas = muscle.end(0)
    assert_allclose(points[:, 0], 0.0, atol=1e-12)
    assert_allclose(areas.sum(), 12.0, rtol=1e-12)
    points, volumes = muscle.end_points(0.12)
    assert points[:, 0].max() < 3.6
    assert_allclose(volumes.sum() / 360.0, 0.12, atol=0.04)


def test_points_across_a_broad_muscle_are_no_farther_apart_than_elements_of_a_face():
    for width, count in ((4.0, 2), (17.0, 5), (33.0, 9)):
        muscle = beam((30.0, width, 2.0), (3, 1, 1))
        assert muscle.across() == count
        for points in (muscle.quadrature((4, count, 2)).points, muscle.end_points(0.3)[0]):
            across = np.unique(points[:, 1].round(6))
            assert len(across) == count and np.diff(across).max() < 6.0


def test_a_fading_muscle_keeps_its_volume_and_fades_towards_its_borders():
    muscle = beam(counts=(4, 2, 1))
    rule = muscle.quadrature((4, 8, 2))
    assert muscle.faded(rule) is rule
    faded = replace(muscle, fading=0.5).faded(rule)
    assert_array_equal(faded.points, rule.points)
    assert faded.weights.sum() == pytest.approx(rule.weights.sum())
    share = faded.weights / rule.weights
    x, y = rule.points[:, 0] / 30.0, rule.points[:, 1] / 6.0
    middle = abs(y - 0.5) < 0.2
    assert share[middle & (x < 0.5)].min() > 1.2
    assert share[(y < 0.05) | (y > 0.95)].max() < 0.1
    assert share[x > 0.98].max() < 0.1
    with pytest.raises(InputError, match="share of the length"):
        replace(muscle, fading=1.2)


def test_a_gliding_muscle_stretches_by_what_its_bound_part_moves():
    rule = beam().quadrature()
    held = np.ones(len(rule.points), dtype=bool)
    muscle = replace(beam(), glide=0.7)
    fibres, pulls = muscle.pulls(rule, held)
    assert_array_equal(pulls > 0.0, rule.points[:, 0] > 21.0)
    lines = np.unique(np.column_stack([fibres, rule.points[:, 1:].round(6)]), axis=0)
    assert len(lines) == fibres.max() + 1
    # Stretched evenly from its bone, every fibre feels just that stretch.
    stretch = np.bincount(fibres, pulls * 0.1 * rule.points[:, 0])
    assert_allclose(stretch, 0.1, rtol=1e-12)
    # What the tissue does not hold does not count.
    held &= rule.points[:, 0] < 27.0
    assert_allclose(np.bincount(*[fibres, muscle.pulls(rule, held)[1] * rule.points[:, 0]]), 1.0)
    assert not muscle.pulls(rule, np.zeros_like(held))[1].any()
    for wrong in (-0.1, 1.0, np.nan):
        with pytest.raises(InputError, match="share of the length"):
            replace(beam(), glide=wrong)


def test_a_muscle_with_two_loose_ends_pulls_at_both_alike():
    rule = beam().quadrature()
    held = np.ones(len(rule.points), dtype=bool)
    muscle = replace(beam(), glide=0.7, loose=0.2)
    fibres, pulls = muscle.pulls(rule, held)
    assert_array_equal(pulls > 0.0, rule.points[:, 0] > 21.0)
    assert_array_equal(pulls < 0.0, rule.points[:, 0] < 6.0)
    # Moved with the tissue it feels nothing, stretched evenly just that stretch.
    assert_allclose(np.bincount(fibres, pulls), 0.0, atol=1e-12)
    assert_allclose(np.bincount(fibres, pulls * 0.1 * rule.points[:, 0]), 0.1, rtol=1e-12)
    # Where the tissue holds one end only, the other is at its bone.
    held = rule.points[:, 0] > 6.0
    assert_allclose(muscle.pulls(rule, held)[1], replace(muscle, loose=0.0).pulls(rule, held)[1])
    for wrong in (-0.1, 0.8, np.nan):
        with pytest.raises(InputError, match="share of the length that glides"):
            replace(beam(), glide=0.7, loose=wrong)


def test_a_ring_is_closed():
    muscle = ring()
    assert_allclose(muscle.length(), 2 * np.pi * 22.0, rtol=1e-3)
    rule = muscle.quadrature()
    radial = rule.points[:, :2] / np.linalg.norm(rule.points[:, :2], axis=1, keepdims=True)
    assert_allclose((rule.directions[:, :2] * radial).sum(axis=1), 0.0, atol=0.01)
    with pytest.raises(InputError, match="no ends"):
        muscle.span()


def test_transformed_follows_the_map_with_its_derivatives():
    muscle = beam()
    moved = muscle.transformed(bend)
    rule = muscle.quadrature((5, 3, 3))
    new = moved.mesh.evaluate(rule.elements, rule.xi)
    # The map is quadratic, of degree one in each cross direction: the space holds it exactly.
    assert_allclose(new, bend(rule.points), atol=1e-6)


def test_mirrored_keeps_its_volume_and_turns_its_fibres():
    muscle = beam().transformed(bend)
    rng = np.random.default_rng(3)
    angles = rng.normal(0.0, 0.3, (muscle.mesh.n_params // 8, 3))
    muscle = Muscle("beam", muscle.mesh, "sheet", angles)
    mirrored = muscle.mirrored(-0.67)
    assert_allclose(mirrored.volume, muscle.volume, rtol=1e-12)
    rule = muscle.quadrature()
    xi = rule.xi * [1.0, -1.0, 1.0] + [0.0, 1.0, 0.0]
    image = rule.points * [-1.0, 1.0, 1.0] + [-1.34, 0.0, 0.0]
    assert_allclose(mirrored.mesh.evaluate(rule.elements, xi), image, atol=1e-12)
    expected = rule.directions * [-1.0, 1.0, 1.0]
    assert_allclose(mirrored.directions(rule.elements, xi), expected, atol=1e-12)


def test_muscle_survives_its_arrays():
    muscle = Muscle("beam", beam().mesh, "sheet", np.full((24, 3), 0.1), 1.2, 0.7, 0.2, 0.5)
    again = Muscle.from_arrays("beam", muscle.arrays())
    assert (again.kind, again.slack) == ("sheet", 1.2)
    assert (again.glide, again.loose, again.fading) == (0.7, 0.2, 0.5)
    assert_array_equal(again.mesh.parameters, muscle.mesh.parameters)
    assert_array_equal(again.corners, muscle.corners)
    assert_array_equal(again.angles, muscle.angles)


def test_unsound_muscles_are_refused():
    muscle = beam()
    with pytest.raises(InputError, match="choose from strap, sheet, ring"):
        Muscle("beam", muscle.mesh, "rope")
    with pytest.raises(InputError, match="three for each of the 24 nodes"):
        Muscle("beam", muscle.mesh, "strap", np.zeros((23, 3)))
    arrays = muscle.arrays()
    with pytest.raises(InputError, match="beam: no sound muscle"):
        Muscle.from_arrays("beam", {**arrays, "corners": arrays["corners"] + 1})
    with pytest.raises(InputError, match="beam: no sound muscle"):
        Muscle.from_arrays("beam", {k: v for k, v in arrays.items() if k != "slack"})
