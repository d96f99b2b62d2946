"""Every term's residual is the derivative of its energy, every tangent that of its residual."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from modiolus import hermite
from modiolus.errors import InputError
from modiolus.mechanics import (
    DeadForces,
    FibreQuadrature,
    Fibres,
    GlidingFibres,
    GlidingQuadrature,
    Load,
    Problem,
    RigidContact,
    Sheet,
    Springs,
    clamp,
    face_points,
    symmetry_plane,
)
from modiolus.mechanics.kernels import active_force, fibre, passive, passive_force
from modiolus.mechanics.laws import MUSCLE, BlemkerMuscle, FibreLaw, Guccione, Law, Volume

RNG = np.random.default_rng(20)


class Sphere:
    """Signed distance of a sphere."""

    def __init__(self, centre, radius):
        self.centre, self.radius = np.asarray(centre, dtype=float), radius

    def sample(self, points):
        away = points - self.centre
        length = np.linalg.norm(away, axis=1)
        normal = away / length[:, None]
        outer = normal[:, :, None] * normal[:, None, :]
        return length - self.radius, normal, (np.eye(3) - outer) / length[:, None, None]


def distorted(counts=(2, 2, 1), size=(20.0, 16.0, 6.0), amount=0.6, seed=3):
    rng = np.random.default_rng(seed)
    ticks = [np.linspace(0.0, s, n + 1) for n, s in zip(counts, size, strict=True)]
    mesh = hermite.grid(np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1))
    noise = rng.uniform(-amount, amount, mesh.parameters.shape)
    noise[7::8] *= 0.3
    return mesh.with_parameters(mesh.parameters + noise)


def scattered(mesh, n=40, muscles=2, seed=4):
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(n, 3))
    return FibreQuadrature(
        rng.integers(0, mesh.n_elements, n),
        rng.uniform(0.0, 1.0, (n, 3)),
        rng.uniform(5.0, 20.0, n),
        directions / np.linalg.norm(directions, axis=1, keepdims=True),
        rng.integers(0, muscles, n),
    )


def gliding(rule, each=4, seed=7):
    """Fibres of some points each, of one muscle after the other."""
    muscles = np.sort(rule.muscles)
    fibres = 100 * muscles + np.arange(len(muscles)) // each
    pulls = np.random.default_rng(seed).uniform(0.0, 0.04, len(muscles))
    return GlidingQuadrature(
        rule.elements, rule.xi, rule.weights, rule.directions, muscles, fibres, pulls
    )


MESH = distorted()
LOAD = Load({"first": 0.7, "second": 0.2}, jaw=0.3)


def terms(mesh=MESH):
    rng = np.random.default_rng(5)
    inner = face_points(mesh, np.arange(mesh.n_elements), 2, 0, 3)
    return {
        "tissue": None,
        "fibres": Fibres(
            mesh, scattered(mesh), ("first", "second"), FibreLaw(optimal=1.1), {"second": 0.9}
        ),
        "gliding fibres": GlidingFibres(
            mesh,
            gliding(scattered(mesh)),
            ("first", "second"),
            carry=lambda points, _: lambda load: points * (1.0 + load.jaw),
        ),
        "springs": Springs(
            mesh, rng.integers(0, 4, 12), rng.uniform(size=(12, 3)), rng.uniform(1, 50, 12)
        ),
        "sheet": Sheet(
            mesh, rng.integers(0, 4, 12), rng.uniform(size=(12, 3)), rng.uniform(1, 50, 12)
        ),
        "contact": RigidContact(
            mesh, Sphere((10, 8, -30), 30.3), *inner, slide=np.full(len(inner[0]), 0.2)
        ),
    }


TERMS = terms()


def problem(name):
    if name == "tissue":
        chosen = []
    elif name == "all":
        chosen = [term for term in TERMS.values() if term is not None]
    else:
        chosen = [TERMS[name]]
    coefficients = np.array([2.0, 1.1, 0.4])
    fixed = clamp(MESH, [0, 2], 0, 0)
    return Problem(MESH, coefficients, kappa=20.0, terms=chosen, fixed=fixed)


def somewhere(problem, amount=0.4, seed=6):
    rng = np.random.default_rng(seed)
    rest = problem.rest()
    moved = rng.uniform(-amount, amount, rest.parameters.shape)
    # Squeezed in direction 1.
    moved[:, 1] -= 0.25 * rest.parameters[:, 1]
    moved[problem.fixed] = 0.0
    return rest.parameters + moved, rng.uniform(-3.0, 3.0, rest.pressure.shape)


NAMES = ["tissue", "fibres", "gliding fibres", "springs", "sheet", "contact", "all"]


@pytest.mark.parametrize("name", NAMES)
def test_residual_and_tangent_match_finite_differences(name):
    p = problem(name)
    parameters, pressure = somewhere(p)
    state = p.rest()
    state.parameters[:], state.pressure[:] = parameters, pressure
    found = p.evaluate(parameters, pressure, LOAD, tangent=True)
    upper = p.tangent()
    full = (upper + sp.triu(upper, 1).T).toarray()
    if name not in ("tissue", "all"):
        assert found.energies[TERMS[name].name] > 0.0
    rng = np.random.default_rng(7)
    for _ in range(4):
        direction = rng.normal(size=p.n_unknowns)
        h = 1e-5
        ahead = p.evaluate(*p.add(state.parameters, state.pressure, h * direction), LOAD)
        behind = p.evaluate(*p.add(state.parameters, state.pressure, -h * direction), LOAD)
        slope = (ahead.energy - behind.energy) / (2 * h)
        assert slope == pytest.approx(found.residual @ direction, rel=2e-6, abs=1e-6)
        rate = (ahead.residual - behind.residual) / (2 * h)
        expected = full @ direction
        assert np.abs(rate - expected).max() < 2e-6 * np.abs(expected).max()


def test_product_with_fixed_parameters_matches_finite_differences():
    p = problem("all")
    parameters, pressure = somewhere(p)
    direction = np.random.default_rng(8).normal(size=parameters.shape)
    p.evaluate(parameters, pressure, LOAD, tangent=True)
    product = p.assembly.multiply(direction)
    h = 1e-5
    ahead = p.evaluate(parameters + h * direction, pressure, LOAD).residual
    behind = p.evaluate(parameters - h * direction, pressure, LOAD).residual
    assert np.abs((ahead - behind) / (2 * h) - product).max() < 2e-6 * np.abs(product).max()


def at_point(f, c, kappa, p, law=Law.ISOCHORIC, volume=Volume.MULTIPLIER):
    """Energy, J, stress and tangent of the passive tissue at one point."""
    h, stress, tangent = np.empty((3, 3)), np.empty((3, 3)), np.empty((6, 3, 3))
    form = (None if law == Law.ISOCHORIC else int(law), np.asarray(c), int(volume))
    energy, ratio, _, _ = passive(f, *form, kappa, p, h, stress, tangent, True)
    return energy, ratio, stress, tangent


FIBRE = np.array([0.6, 0.0, 0.8])
LAWS = {
    Law.ISOCHORIC: MUSCLE["yeoh-nazari2010"].array(),
    Law.PLAIN: MUSCLE["wu2013"].array(),
    Law.GUCCIONE: Guccione(2.0, 8.0, 2.0, 4.0).array(FIBRE),
    Law.MUSCLE: BlemkerMuscle(0.5, 0.7, FibreLaw(), 0.2).array(FIBRE),
}


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("volume", Volume)
@pytest.mark.parametrize("amount", [1e-3, 0.1])
def test_law_has_the_derivatives_it_says(law, volume, amount):
    rng = np.random.default_rng(11)
    f = np.diag([1.05, 0.98, 1.02]) + amount * rng.uniform(-1, 1, (3, 3))
    _, _, stress, tangent = at_point(f, LAWS[law], 20.0, 1.5, law, volume)
    h = 1e-6
    pairs = {(0, 0): 0, (0, 1): 1, (0, 2): 2, (1, 1): 3, (1, 2): 4, (2, 2): 5}
    for j, m in np.ndindex(3, 3):
        step = np.zeros((3, 3))
        step[j, m] = h
        ahead = at_point(f + step, LAWS[law], 20.0, 1.5, law, volume)
        behind = at_point(f - step, LAWS[law], 20.0, 1.5, law, volume)
        assert (ahead[0] - behind[0]) / (2 * h) == pytest.approx(stress[j, m], abs=1e-7)
        rates = (ahead[2] - behind[2]) / (2 * h)
        for i, k in np.ndindex(3, 3):
            found = tangent[pairs[i, j], k, m] if i <= j else tangent[pairs[j, i], m, k]
            assert rates[i, k] == pytest.approx(found, abs=2e-6), (i, k, j, m)


@given(st.integers(0, 10**6), st.sampled_from(sorted(MUSCLE)))
@settings(max_examples=30, deadline=None)
def test_passive_law_is_frame_indifferent_and_symmetric(seed, name):
    rng = np.random.default_rng(seed)
    f = np.eye(3) + 0.3 * rng.uniform(-1, 1, (3, 3))
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotation *= np.linalg.det(rotation)
    c = MUSCLE[name].array()
    energy, ratio, stress, tangent = at_point(f, c, 20.0, 1.5)
    assert ratio == pytest.approx(np.linalg.det(f))
    turned_energy, _, turned, _ = at_point(rotation @ f, c, 20.0, 1.5)
    assert turned_energy == pytest.approx(energy)
    assert np.allclose(turned, rotation @ stress)
    cauchy = stress @ f.T
    assert np.allclose(cauchy, cauchy.T)
    for pair in (0, 3, 5):
        assert np.allclose(tangent[pair], tangent[pair].T)


def test_passive_law_is_at_rest_without_deformation():
    energy, _, stress, tangent = at_point(np.eye(3), MUSCLE["wu2013"].array(), 20.0, 0.0)
    assert energy == pytest.approx(0.0, abs=1e-14)
    assert np.abs(stress).max() < 1e-14
    # Shear modulus 2 (c1 + c2) = 7.35 kPa.
    assert tangent[0, 1, 1] == pytest.approx(7.35)


def taut(r):
    return passive_force(r, 0.05, 6.6, 1.4, 0.02)


@given(st.floats(0.35, 2.0))
@settings(max_examples=60, deadline=None)
def test_fibre_curves_are_derivatives_of_each_other(r):
    h = 1e-6
    kinks = np.array([0.4, 0.6, 1.0, 1.02, 1.4, 1.6])
    if np.abs(kinks - r).min() < 2 * h:
        return
    for curve in (active_force, taut):
        (a, fa, _), (b, fb, _) = curve(r - h), curve(r + h)
        _, value, slope = curve(r)
        assert (b - a) / (2 * h) == pytest.approx(value, abs=1e-7)
        assert (fb - fa) / (2 * h) == pytest.approx(slope, abs=1e-5)


def test_toe_joins_the_published_curve():
    for r in (1.02, 1.1, 1.5):
        toe, plain = (passive_force(r, 0.05, 6.6, 1.4, width)[1:] for width in (0.02, 0.0))
        assert toe == pytest.approx(plain)


def test_fibre_curve_has_the_published_values():
    # Blemker et al. 2005: f_act(1) = 1, f_act(0.5) = 0.09; FEBio mu02 rests at 0.673.
    assert active_force(1.0)[1] == pytest.approx(1.0)
    assert active_force(0.5)[1] == pytest.approx(0.09)
    assert active_force(1 / 1.4)[1] == pytest.approx(0.673, abs=5e-4)
    assert taut(1.2)[1] == pytest.approx(0.05 * (np.exp(1.32) - 1))
    energy, force, _ = fibre(0.95, 0.0, 1.0, FibreLaw().array())
    assert energy == force == 0.0
    assert fibre(1.1, 0.0, 1.2, FibreLaw().array())[1] == 0.0


@pytest.mark.parametrize("name", ["tissue", "fibres"])
def test_rigid_motion_costs_nothing(name):
    chosen = [] if name == "tissue" else [TERMS["fibres"]]
    p = Problem(MESH, [2.0, 1.1, 0.4], terms=chosen)
    rest = p.rest()
    rotation, _ = np.linalg.qr(RNG.normal(size=(3, 3)))
    rotation *= np.linalg.det(rotation)
    turned = rest.parameters @ rotation.T
    turned[::8] += [3.0, -2.0, 5.0]
    load = LOAD if name == "fibres" else Load()
    before = p.evaluate(rest.parameters, rest.pressure, load)
    forces = p.assembly.forces()
    after = p.evaluate(turned, rest.pressure, load)
    assert after.energy == pytest.approx(before.energy, abs=1e-9)
    assert np.allclose(p.assembly.forces(), forces @ rotation.T, atol=1e-7)
    if name == "tissue":
        assert np.abs(after.residual).max() < 1e-9


def test_at_rest_nothing_pushes():
    p = problem("all")
    rest = p.rest()
    passive_only = p.evaluate(rest.parameters, rest.pressure, Load())
    # The second muscle's passive fibres are taut at rest here, and nothing else acts.
    energies = passive_only.energies
    assert {k: v for k, v in energies.items() if k != "fibres"} == pytest.approx(
        {"tissue": 0.0, "springs": 0.0, "sheet": 0.0, "contact": 0.0, "gliding fibres": 0.0},
        abs=1e-10,
    )
    assert p.penetration(rest.parameters) < 1e-12


def test_fibre_at_a_point_follows_the_closed_form():
    # A unit cube stretched along x by 1.2 at constant volume: psi(1.2) per volume.
    mesh = hermite.grid(np.stack(np.meshgrid(*[[0.0, 1.0]] * 3, indexing="ij"), axis=-1))
    elements, xi, weights = mesh.gauss_points(4)
    directions = np.tile([1.0, 0.0, 0.0], (len(elements), 1))
    rule = FibreQuadrature(elements, xi, weights, directions, np.zeros(len(elements), dtype=int))
    p = Problem(mesh, [0.5, 0.0, 0.0], terms=[Fibres(mesh, rule, ["only"])])
    stretch = 1.2
    moved = mesh.parameters * [stretch, stretch**-0.5, stretch**-0.5]
    found = p.evaluate(moved, np.zeros(8), Load({"only": 0.3}))
    energy, force, _ = fibre(stretch, 0.3, 1.0, FibreLaw().array())
    assert found.energies["fibres"] == pytest.approx(energy)
    # Work conjugate of the stretch, from all nodal forces.
    rate = mesh.parameters * [1.0, -0.5 * stretch**-1.5, -0.5 * stretch**-1.5]
    p.evaluate(moved, np.zeros(8), Load())
    without = (p.assembly.forces() * rate).sum()
    p.evaluate(moved, np.zeros(8), Load({"only": 0.3}))
    with_passive = fibre(stretch, 0.0, 1.0, FibreLaw().array())[1]
    assert (p.assembly.forces() * rate).sum() - without == pytest.approx(force - with_passive)


@pytest.mark.parametrize("angle", [0.0, 20.0, 45.0, 70.0])
def test_a_taut_sheet_is_alike_in_all_directions_and_a_crimped_one_slack(angle):
    mesh = hermite.grid(
        np.stack(np.meshgrid([0.0, 4.0], [0.0, 4.0], [0.0, 2.0], indexing="ij"), -1)
    )
    sheet = Sheet(mesh, [0, 0], [[0.3, 0.4, 0.5], [0.6, 0.1, 0.5]], [30.0, 50.0])
    way = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0.0])

    def energy(along, across):
        side = np.cross([0.0, 0.0, 1.0], way)
        gradient = np.eye(3) + along * np.outer(way, way) + across * np.outer(side, side)
        vectors = sheet.functions @ (mesh.parameters @ gradient.T)
        return sheet.respond(vectors, Load()).energies.sum()

    # Stretched both ways the fibres have a strain a + b cos(2 t), beyond the toe all of them; a
    # difference of the strains of a tenth changes their lengths by its square.
    mean, half, toe = 0.25, 0.02, Sheet.TOE
    expected = 80.0 * ((mean**2 + half**2 / 2 - toe * mean) / 2 + toe**2 / 6)
    assert energy(mean + half, mean - half) == pytest.approx(expected, rel=2e-3)
    assert energy(-0.1, -0.2) == 0.0


def test_a_gliding_fibre_spans_from_bone_to_tissue():
    axes = [[0.0, 10.0], [0.0, 1.0], [0.0, 1.0]]
    mesh = hermite.grid(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))
    along = np.array([0.1, 0.4, 0.7, 0.9])
    nothing = np.zeros(4, dtype=int)
    rule = GlidingQuadrature(
        nothing,
        np.column_stack([along, [0.5] * 4, [0.5] * 4]),
        np.full(4, 1.5),
        np.tile([1.0, 0.0, 0.0], (4, 1)),
        nothing,
        nothing,
        # Bound to the tissue in two places, 8 mm from the bone on the mean.
        np.array([0.0, 0.0, 0.5, 0.5]) / 8.0,
    )

    def carry(points, _):
        return lambda load: points + np.array([load.jaw, 0.0, 0.0])

    def pull(along, jaw):
        fibres = GlidingFibres(mesh, rule, ["only"], carry=carry)
        moved = mesh.parameters.copy()
        moved[::8, 0] += along
        problem = Problem(mesh, [0.5, 0.0, 0.0], terms=[fibres])
        found = problem.evaluate(moved, np.zeros(8), Load({"only": 0.3}, jaw=jaw))
        # What pulls on the tissue is the tension of the fibre: 6 mm³ over 8 mm.
        return found.energies["gliding fibres"], problem.assembly.forces()[::8, 0].sum()

    law = FibreLaw().array()
    for along, jaw in ((0.0, 0.0), (1.5, 0.0), (-1.5, 0.0), (1.5, 1.5)):
        psi, tension, _ = fibre(1.0 + (along - jaw) / 8.0, 0.3, 1.0, law)
        assert pull(along, jaw) == pytest.approx((6.0 * psi, 0.75 * tension))


def test_a_gliding_fibre_turns_with_its_bone():
    rule = gliding(scattered(MESH))
    turn = Rotation.from_rotvec([0.2, -0.1, 0.4]).as_matrix()

    def carry(points, _):
        return lambda load: points @ turn.T + [1.0, 2.0, 3.0]

    fibres = GlidingFibres(MESH, rule, ["first", "second"], carry=carry)
    moved = MESH.parameters @ turn.T
    moved[::8] += [1.0, 2.0, 3.0]
    # Where tissue and bone turn together the fibres turn too, and none is stretched.
    expected = fibres.quadrature.directions @ turn.T
    np.testing.assert_allclose(fibres.vectors(moved, Load()), expected, atol=1e-12)


def test_unsound_gliding_fibres_are_refused():
    rule = gliding(scattered(MESH))
    with pytest.raises(InputError, match="of several muscles"):
        GlidingFibres(MESH, replace(rule, fibres=0 * rule.fibres), ["first", "second"])
    with pytest.raises(InputError, match="bound nowhere"):
        GlidingFibres(MESH, replace(rule, pulls=0.0 * rule.pulls), ["first", "second"])


def test_contact_measures_gap_and_penetration():
    mesh = hermite.grid(np.stack(np.meshgrid(*[[0.0, 10.0]] * 3, indexing="ij"), axis=-1))
    points = face_points(mesh, [0], 2, 0, 4)
    assert points[2].sum() == pytest.approx(100.0)
    assert np.allclose(mesh.evaluate(*points[:2])[:, 2], 0.0)
    radius = 1e6
    # A nearly plane body 0.3 mm below the face.
    body = Sphere((5, 5, -radius - 0.3), radius)
    contact = RigidContact(mesh, body, *points, stiffness=50.0, onset=0.1)
    sunk = mesh.parameters.copy()
    sunk[::8, 2] -= 0.5
    vectors = contact.functions @ sunk
    assert contact.penetration(sunk) == pytest.approx(0.2, abs=1e-4)
    answer = contact.respond(vectors, Load())
    # Integrals of a stiffness that grows to 50 kPa/mm over the first 0.1 mm, over 100 mm².
    assert answer.forces.sum(axis=0) == pytest.approx([0, 0, -50 * 0.15 * 100], rel=1e-3, abs=0.1)
    assert answer.energies.sum() == pytest.approx(
        50 * 100 * (0.1**2 / 6 + (0.2**2 - 0.1**2) / 2 - 0.05 * 0.1), rel=1e-3
    )
    # Lifted off, only the sliding zone holds back.
    lifted = vectors + np.array([0.0, 0.0, 1.0])
    assert contact.respond(lifted, Load()).energies.sum() == 0.0
    held = RigidContact(mesh, body, *points, stiffness=50.0, slide=np.full(16, 0.1))
    # 1 - 0.5 mm from the distance at rest, held with a tenth of the stiffness.
    assert held.respond(lifted, Load()).energies.sum() == pytest.approx(
        0.5 * 5.0 * 0.5**2 * 100, rel=1e-3
    )


def test_mirror_condition_keeps_the_mirrored_field_smooth():
    mesh = distorted((2, 1, 1), amount=0.0)
    fixed = symmetry_plane(mesh, [0], 0, 0)
    rng = np.random.default_rng(9)
    moved = rng.normal(size=fixed.shape)
    moved[fixed] = 0.0
    field = mesh.with_parameters(moved)
    at = (np.zeros(5, dtype=int), np.column_stack([np.zeros(5), rng.uniform(size=(5, 2))]))
    assert np.abs(field.evaluate(*at)[:, 0]).max() < 1e-14
    assert np.abs(field.evaluate(*at, (1, 0, 0))[:, 1:]).max() < 1e-14
    assert np.abs(field.evaluate(*at, (1, 0, 0))[:, 0]).max() > 0.1


@pytest.mark.parametrize(
    ("given", "word"),
    [
        ({"coefficients": [1.0, 0.0]}, "coefficients"),
        ({"coefficients": [np.nan, 0.0, 0.0]}, "coefficients"),
        ({"fixed": np.zeros(3, dtype=bool)}, "fixed"),
        ({"fixed": np.zeros((MESH.n_params, 3), dtype=int)}, "fixed"),
        ({"kappa": np.nan}, "kappa"),
        ({"kappa": -1.0}, "kappa"),
    ],
)
def test_a_problem_refuses_what_does_not_fit(given, word):
    with pytest.raises(InputError, match=word):
        Problem(MESH, **{"coefficients": [1.0, 0.0, 0.0], **given})


def test_terms_refuse_what_does_not_fit():
    place = [0], [[0.5, 0.5, 0.5]]
    other = MESH.with_parameters(MESH.parameters)
    assert Problem(other, [1.0, 0.0, 0.0], terms=[Springs(MESH, *place, 1.0)])
    smaller = hermite.bricks([[0.0, 1.0]] * 3)
    with pytest.raises(InputError, match="another mesh"):
        Problem(MESH, [1.0, 0.0, 0.0], terms=[Springs(smaller, *place, 1.0)])
    with pytest.raises(InputError, match="stiffness"):
        Springs(MESH, *place, [1.0, 2.0])
    with pytest.raises(InputError, match="weight"):
        DeadForces(MESH, *place, [0.0, 0.0, 1.0])
