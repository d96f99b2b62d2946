"""Surfaces of the tissue against each other: forces, tangents, sliding, no crossing."""

import numpy as np
import pytest
import scipy.sparse as sp

from modiolus import hermite
from modiolus.mechanics import Continuation, Load, Problem, Settings, SurfaceContact, facing


def block(counts, low, high):
    ticks = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, counts, strict=True)]
    return hermite.grid(np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1))


def joined(*meshes):
    """Several bodies as one mesh."""
    extraction = sp.csr_matrix(sp.block_diag([mesh.extraction for mesh in meshes]))
    return hermite.HermiteMesh(3, np.concatenate([m.parameters for m in meshes]), extraction)


def stacked(gap=0.0, lower=(2, 2, 1), upper=(3, 2, 1)):
    """Two blocks one above the other with their facing sides: the mesh, upper and lower side."""
    below = block(lower, (0, 0, -6), (20, 16, 0))
    above = block(upper, (2, 1, gap), (17, 15, gap + 6))
    top = np.arange(below.n_elements)
    return joined(below, above), (below.n_elements + np.arange(above.n_elements), 2, 0), (top, 2, 1)


def bent(mesh, amount=0.3, seed=3):
    rng = np.random.default_rng(seed)
    return mesh.parameters + rng.uniform(-amount, amount, mesh.parameters.shape)


def upper_part(mesh, upper):
    """Parameters of the upper block."""
    rows = upper[0][:, None] * 64 + np.arange(64)
    return np.unique(mesh.extraction[rows.ravel()].indices)


@pytest.mark.parametrize("flanked", [False, True])
@pytest.mark.parametrize("gap", [0.3, 1e-4])
def test_force_and_tangent_match_finite_differences(gap, flanked):
    mesh, upper, lower = stacked(gap)
    flanks = ((), [(lower[0][1::2], 0, 1)] if flanked else ())
    contact = SurfaceContact(mesh, upper, lower, stiffness=50.0, flanks=flanks)
    problem = Problem(mesh, [2.0, 0.5, 0.0], terms=[contact, *filter(None, [contact.edges])])
    state = problem.rest()
    moved = bent(mesh)
    moved[upper_part(mesh, upper)[::8]] -= [0.4, -0.2, gap + 0.2]
    state.parameters[:] = moved

    found = problem.evaluate(moved, state.pressure, Load(), tangent=True)
    assert found.energies["surface contact"] > 10.0
    full = problem.tangent()
    full = full + sp.triu(full, 1).T
    rng = np.random.default_rng(7)
    for _ in range(3):
        direction = rng.normal(size=problem.n_unknowns)
        h = 1e-6
        ahead, behind = (
            problem.evaluate(
                *problem.add(state.parameters, state.pressure, sign * h * direction), Load()
            )
            for sign in (1, -1)
        )
        name = "surface contact"
        slope = (ahead.energy - behind.energy) / (2 * h)
        assert slope == pytest.approx(found.residual @ direction, rel=1e-5)
        assert ahead.energies[name] != behind.energies[name]
        rate = (ahead.residual - behind.residual) / (2 * h)
        assert np.abs(rate - full @ direction).max() < 1e-5 * np.abs(rate).max()


def test_resting_surfaces_do_not_push():
    mesh, upper, lower = stacked(0.0)
    contact = SurfaceContact(mesh, upper, lower)
    problem = Problem(mesh, [2.0, 0.0, 0.0], terms=[contact])
    rest = problem.rest()
    found = problem.evaluate(rest.parameters, rest.pressure, Load())
    assert found.energies["surface contact"] == 0.0
    assert contact.penetration(rest.parameters) < 1e-9


def test_force_follows_a_point_that_slides_over_the_border_of_an_element():
    mesh, upper, lower = stacked(0.0)
    contact = SurfaceContact(mesh, upper, lower, stiffness=20.0, onset=0.0)
    problem = Problem(mesh, [2.0, 0.0, 0.0], terms=[contact])
    values = upper_part(mesh, upper)[::8]
    for slide in (0.0, 2.0, 4.9, -1.9):
        moved = mesh.parameters.copy()
        moved[values] += [slide, 0.5, -0.4]
        pressure = np.zeros(len(problem.assembly.pressure_equations))
        energies = problem.evaluate(moved, pressure, Load()).energies
        # The whole side of 15 by 14 mm overlaps by 0.4 mm; 2 mm hang out over the end of the
        # lower block at most, where it is continued.
        assert energies["surface contact"] == pytest.approx(0.5 * 20 * 0.4**2 * 15 * 14)
        if abs(slide) < 4.0:
            assert contact.penetration(moved) == pytest.approx(0.4)


def test_only_points_that_are_pressed_are_followed():
    mesh, upper, lower = stacked(0.0)
    contact = SurfaceContact(mesh, upper, lower)
    moved = mesh.parameters.copy()
    values = upper_part(mesh, upper)[::8]
    # One end of the upper block sinks in, the other rises.
    moved[values, 2] += 0.05 * (moved[values, 0] - 9.0)
    depth = contact.depth(moved, Load())
    assert 0 < (depth > 0.0).sum() < len(depth)
    assert len(contact.follow(moved, Load())[0]) == 6 * (depth > 0.0).sum()
    # Offsets press points that do not touch yet.
    pressed = Load(offsets={contact.name: np.full(len(depth), 1.0)})
    assert len(contact.follow(moved, pressed)[0]) == 6 * len(depth)


def test_a_body_without_flanks_goes_on_for_its_own_width():
    mesh, upper, lower = stacked(0.0, (1, 1, 1), (1, 1, 1))
    contact = SurfaceContact(mesh, upper, lower, stiffness=20.0, onset=0.0)
    problem = Problem(mesh, [2.0, 0.0, 0.0], terms=[contact])
    energies = []
    for slide in (0.0, 19.0, 30.0, 40.0):
        moved = mesh.parameters.copy()
        moved[upper_part(mesh, upper)[::8]] += [slide, 0.0, -0.4]
        pressure = np.zeros(len(problem.assembly.pressure_equations))
        energies.append(problem.evaluate(moved, pressure, Load()).energies["surface contact"])
    whole = 0.5 * 20 * 0.4**2 * 15 * 14
    np.testing.assert_allclose(energies[:2], whole)
    assert 0.0 < energies[2] < whole and energies[3] == 0.0


def over_an_edge(shift, wide=20, high=6):
    """Energy and overlap of a block moved by ``shift`` over a block whose side to +x is a flank."""
    below, above = (
        block((1, 1, 1), (0, 0, -high), (wide, 16, 0)),
        block((1, 1, 1), (0, 1, 0), (wide, 15, high)),
    )
    mesh, one, other = joined(below, above), np.array([1]), np.array([0])
    flanks = [(one, 0, 0)], [(other, 0, 1)]
    contact = SurfaceContact(mesh, (one, 2, 0), (other, 2, 1), 20.0, 0.0, flanks=flanks)
    problem = Problem(mesh, [2.0, 0.0, 0.0], terms=[contact, contact.edges])
    moved = mesh.parameters.copy()
    moved[upper_part(mesh, (one, 2, 0))[::8]] += shift
    found = problem.evaluate(moved, problem.rest().pressure, Load())
    return found.energy - found.energies["tissue"], contact.penetration(moved)


def test_a_body_before_another_meets_its_flank():
    # 2 mm below the other's top: its edge, a column of points, is pushed sideways.
    edge = 20 * 14 / 12
    energy, overlap = over_an_edge([19.9, 0.0, -2.0])
    assert energy == pytest.approx(0.5 * 20 * 0.1**2 * edge)
    assert overlap == pytest.approx(0.1)
    assert over_an_edge([19.95, 0.0, -2.0])[0] == pytest.approx(0.25 * energy)
    assert over_an_edge([19.9, 0.0, -2.1])[0] == pytest.approx(energy)
    assert over_an_edge([20.1, 0.0, -2.0]) == (0.0, 0.0)


@pytest.mark.parametrize("depth", [facing.DEEPEST + 0.1, 8.0, 18.0])
def test_a_body_far_before_another_meets_its_flank(depth):
    # The other's top is far away: narrower than high, it has no sample as near as its flank.
    energy, _ = over_an_edge([3.95, 0.0, -1.0], 4, 20)
    assert energy > 0.1
    assert over_an_edge([3.95, 0.0, -depth], 4, 20)[0] == pytest.approx(energy)
    assert over_an_edge([4.05, 0.0, -depth], 4, 20)[0] == 0.0
    # Beyond the lower end of the flank is nothing.
    assert over_an_edge([3.95, 0.0, -21.0], 4, 20)[0] == 0.0


def test_what_hangs_out_over_a_flank_is_not_held():
    # Of seven columns of points three are beyond the edge.
    share = 1 / 12 + 3 / 6
    energy, overlap = over_an_edge([9.0, 0.0, -0.05])
    assert energy == pytest.approx(0.5 * 20 * 0.05**2 * 20 * 14 * share)
    assert overlap == pytest.approx(0.05)


def test_overlap_counts_what_lies_deep_inside():
    assert over_an_edge([5.0, 0.0, -4.5])[1] == pytest.approx(4.5)


def test_far_surfaces_cost_nothing_and_do_not_meet():
    mesh, upper, lower = stacked(3.0)
    contact = SurfaceContact(mesh, upper, lower)
    assert contact.penetration(mesh.parameters) == 0.0
    moved = mesh.parameters.copy()
    moved[upper_part(mesh, upper)[::8]] += [0.0, 0.0, 30.0]
    functions, _ = contact.follow(moved, Load())
    assert len(functions) == 0


def test_augmentation_takes_the_overlap_away():
    mesh, upper, lower = stacked(0.0, (1, 1, 1), (1, 1, 1))
    contact = SurfaceContact(mesh, upper, lower, stiffness=20.0)
    values = mesh.parameters[:, 2].copy()
    fixed = np.zeros((mesh.n_params, 3), dtype=bool)
    fixed[np.abs(values + 6.0) < 1e-9] = True
    top = np.abs(values - 6.0) < 1e-9
    fixed[top] = True
    prescribed = np.zeros(mesh.parameters.shape)
    prescribed[top, 2] = -1.0
    problem = Problem(mesh, [5.0, 0.0, 0.0], terms=[contact], fixed=fixed)
    load = Load(prescribed=prescribed)
    soft = Continuation(problem, settings=Settings(augmentations=0)).run(load)
    held = Continuation(problem, settings=Settings(penetration=0.02)).run(load)
    assert soft.statistics.max_penetration_mm > 0.05
    assert held.statistics.max_penetration_mm < 0.02
    # Bodies that cannot overlap press harder, and not by much.
    forces = [contact.pressure(s.parameters, s.load)[1] @ contact.areas for s in (soft, held)]
    assert 1.0 < forces[1] / forces[0] < 1.2
    # They fade on the way to another load.
    assert held.load.towards(Load(), 1.0).offsets == {}


def test_patches_know_their_edges_to_neighbours():
    mesh, _, lower = stacked(lower=(3, 2, 1))
    inner = facing.Patches.of(mesh, lower).inner
    # 3 x 2 patches have 4 edges across the first and 3 across the second direction, each twice.
    assert inner[:, :2].sum() == 2 * 4 and inner[:, 2:].sum() == 2 * 3


def test_an_edge_is_round():
    edge, r = 20 * 14 / 12, facing.EDGE
    # As far below the top as behind the flank: a quarter of the rounding is taken off.
    energy, _ = over_an_edge([19.9, 0.0, -0.1])
    assert energy == pytest.approx(0.5 * 20 * (0.1 - r / 4) ** 2 * edge)
    # From there to where either side is alone the energy goes on without a jump or a kink.
    across = np.array([over_an_edge([20 - d, 0.0, -0.15])[0] for d in np.arange(0.0, 0.5, 0.005)])
    steps = np.diff(across)
    assert (steps > -1e-12).all() and across[0] == 0.0
    assert np.abs(np.diff(steps)).max() < 0.15 * steps.max()
    assert across[-1] == pytest.approx(0.5 * 20 * 0.15**2 * edge)


@pytest.mark.parametrize("shift", [[19.92, 0.0, -0.1], [19.85, 0.1, -0.2]])
def test_force_and_tangent_at_an_edge_match_finite_differences(shift):
    mesh, upper, lower = stacked(0.0, (1, 1, 1), (1, 1, 1))
    contact = SurfaceContact(mesh, upper, lower, 50.0, flanks=((), [(lower[0], 0, 1)]))
    problem = Problem(mesh, [2.0, 0.5, 0.0], terms=[contact, contact.edges])
    state = problem.rest()
    state.parameters[:] = bent(mesh, 0.02)
    state.parameters[upper_part(mesh, upper)[::8]] += np.subtract(shift, [2.0, 0.0, 0.0])
    found = problem.evaluate(state.parameters, state.pressure, Load(), tangent=True)
    assert found.energies["surface contact, edges"] > 0.01
    full = problem.tangent()
    full = full + sp.triu(full, 1).T
    direction = np.random.default_rng(7).normal(size=problem.n_unknowns)
    h = 1e-6
    ahead, behind = (
        problem.evaluate(
            *problem.add(state.parameters, state.pressure, sign * h * direction), Load()
        )
        for sign in (1, -1)
    )
    slope = (ahead.energy - behind.energy) / (2 * h)
    assert slope == pytest.approx(found.residual @ direction, rel=1e-5)
    rate = (ahead.residual - behind.residual) / (2 * h)
    assert np.abs(rate - full @ direction).max() < 1e-5 * np.abs(rate).max()


def test_points_far_inside_a_body_are_let_go():
    mesh, upper, lower = stacked()
    slave, master = facing.Patches.of(mesh, upper), facing.Patches.of(mesh, lower)
    patches, xi, _ = slave.points(*hermite.gauss(2, 3))
    meeting = facing.Facing(slave, master, patches, xi)
    sunk = upper_part(mesh, upper)

    def distance(depth):
        moved = mesh.parameters.copy()
        moved[sunk[::8], 2] -= depth
        return meeting.project(moved).distance

    np.testing.assert_allclose(distance(facing.DEEPEST - 0.1), 0.1 - facing.DEEPEST)
    np.testing.assert_array_equal(distance(facing.DEEPEST + 0.1), np.inf)
    np.testing.assert_array_equal(distance(-30.0), np.inf)
