"""A head on a finer mesh is the same head."""

from dataclasses import replace

import numpy as np
import pytest

from modiolus.errors import InputError
from modiolus.face.expression import Expression, resolve
from modiolus.face.head import Attachment, Head
from modiolus.face.refine import at_gauss, child_points, parent_points, refined
from modiolus.hermite import gauss
from modiolus.mechanics import Continuation, State
from modiolus.mechanics.convergence import inherited
from modiolus.mechanics.face import FaceSettings, face_problem
from modiolus.mechanics.timing import without_contact

COUNTS = [(2, 2, 1), (1, 1, 2), (2, 1, 3)]


@pytest.mark.parametrize("counts", COUNTS)
def test_shape_places_and_volume_stay(block_head, counts):
    finer = refined(block_head, counts)
    assert finer.tissue.n_elements == block_head.tissue.n_elements * np.prod(counts)
    assert finer.tissue.measures().sum() == pytest.approx(block_head.tissue.measures().sum())
    for name, point in block_head.landmark_points().items():
        assert np.allclose(finer.landmark_points()[name], point, atol=1e-12)
    for name, (elements, axis, side) in block_head.sides.items():
        area = block_head.tissue.face(elements, axis, side).measures().sum()
        assert finer.tissue.face(*finer.sides[name]).measures().sum() == pytest.approx(area)


@pytest.mark.parametrize("counts", COUNTS)
def test_what_holds_at_points_does_at_so_many_more(block_head, counts):
    """Each point of a rule is shared among its cell: same sum, same middle, all children."""
    finer = refined(block_head, counts)
    for kind in ("attachments", "insertions", "sheets"):
        for name, item in getattr(block_head, kind).items():
            there = getattr(finer, kind)[name]
            assert len(there.stiffness) == counts[0] * counts[1] * len(item.stiffness)
            assert there.stiffness.sum() == pytest.approx(item.stiffness.sum())
            held = np.unique(item.elements)
            inner = np.unique(parent_points(there.elements, there.xi, counts)[0])
            assert np.array_equal(inner, held)
            assert len(np.unique(there.elements)) == counts[0] * counts[1] * len(held)


def test_a_refined_head_is_kept(taro, tmp_path):
    finer = refined(taro, (2, 1, 1))
    finer.save(tmp_path)
    assert Head.load(tmp_path).fineness == finer.fineness == 2
    table = tmp_path / "head.toml"
    table.write_text(table.read_text().replace("fineness = 2", "fineness = 1.5"))
    with pytest.raises(InputError, match="fineness is"):
        Head.load(tmp_path)


def test_points_of_no_rule_stay(block_head):
    rng = np.random.default_rng(2)
    item = Attachment(
        "ligament", np.array([0, 2, 2]), rng.random((3, 3)), np.array([1.0, 2.0, 3.0])
    )
    head = replace(block_head, attachments={"ligament": item})
    finer = refined(head, (2, 2, 1))
    there = finer.attachments["ligament"]
    before = head.tissue.evaluate(item.elements, item.xi)
    after = finer.tissue.evaluate(there.elements, there.xi)
    assert np.allclose(after, before, atol=1e-12)
    assert np.array_equal(there.stiffness, item.stiffness)


def test_ends_of_muscles_are_bound_anew(taro):
    """A refined head's bonds are as many times denser, and as stiff in all."""
    finer = refined(taro, (2, 2, 1))
    for kind in ("attachments", "insertions"):
        for name, item in getattr(taro, kind).items():
            there = getattr(finer, kind)[name]
            assert there.stiffness.sum() == pytest.approx(item.stiffness.sum()), name
            if name in taro.muscles:
                assert len(there.stiffness) > 1.5 * len(item.stiffness), name
                weights = [x.stiffness / x.stiffness.sum() for x in (item, there)]
                middles = [
                    share @ head.tissue.evaluate(x.elements, x.xi)
                    for head, x, share in zip((taro, finer), (item, there), weights, strict=True)
                ]
                # Where they begin is known to the distance between two of them.
                assert np.linalg.norm(middles[1] - middles[0]) < 1.0, name


def test_points_go_to_children_and_back():
    rng = np.random.default_rng(0)
    elements, xi = rng.integers(0, 5, 200), rng.random((200, 3))
    xi[:40] = np.round(xi[:40])
    children, inside = child_points(elements, xi, (2, 1, 3))
    assert inside.min() >= 0.0 and inside.max() <= 1.0
    back, again = parent_points(children, inside, (2, 1, 3))
    assert np.array_equal(back, elements) and np.allclose(again, xi, atol=1e-12)


def test_a_linear_field_is_interpolated_between_gauss_points():
    xi = gauss(3, 4)[0]
    finer = gauss(3, 3)[0]
    slopes = np.array([1.0, -2.0, 0.5])
    values = np.stack([xi @ slopes, 3.0 - xi @ slopes])
    found = at_gauss(values, 3)
    assert np.allclose(found, np.stack([finer @ slopes, 3.0 - finer @ slopes]))


@pytest.mark.parametrize("counts", COUNTS)
def test_a_field_has_the_same_energies(block_head, counts):
    rng = np.random.default_rng(1)
    finer = refined(block_head, counts)
    tissue = block_head.tissue
    moved = tissue.parameters + 0.05 * tissue.parameters @ rng.standard_normal((3, 3))
    found = []
    for head, parameters in (
        (block_head, moved),
        (finer, tissue.with_parameters(moved).refine(counts).parameters),
    ):
        problem = face_problem(head)
        load = problem.load({"strap": 0.3})
        found.append(problem.evaluate(parameters, problem.rest().pressure, load).energies)
    for name in ("attachments", "insertions", "fibres", "smas"):
        # Springs to bone grow with the square of the way: divided cells sum it by another rule.
        divided = name == "attachments" and counts[:2] != (1, 1)
        rel = 6e-3 if divided else 1e-3
        assert found[1].get(name, 0.0) == pytest.approx(found[0].get(name, 0.0), rel=rel)
    # The skin is half as thick as its layer of Gauss points.
    assert found[1]["tissue"] == pytest.approx(found[0]["tissue"], rel=0.02)


def test_a_small_contraction_is_nearly_the_same(block_head):
    moves = []
    for head, settings in (
        (block_head, FaceSettings()),
        (refined(block_head, (1, 1, 2)), FaceSettings()),
        (block_head, FaceSettings(gauss_order=5)),
    ):
        problem = face_problem(head, settings)
        state = Continuation(problem).run(problem.load({"strap": 0.05}))
        rest, moved = head.landmark_points(), head.landmark_points(state.parameters)
        moves.append(np.array([moved[name] - rest[name] for name in rest]))
    assert np.abs(moves[0]).max() > 0.01
    # Eight elements with a skin on top are coarse.
    for other, least in zip(moves[1:], (0.2, 0.05), strict=True):
        assert np.linalg.norm(other - moves[0]) < least * np.linalg.norm(moves[0])


@pytest.mark.slow
def test_the_smile_contracts_under_refinement(taro):
    """The second refinement moves the corner of the mouth by less than half of what the first does.

    At a tenth of the load, where the tangent at rest tells no more: sheets and passive fibres are
    taut at their points alone.
    """
    activations = resolve(Expression.named("smile-closed").activations, taro.muscles)
    ways: list[float] = []
    known: State | None = None
    for times in range(3):
        counts = (2**times, 2**times, 1)
        half = refined(taro, counts) if times else taro
        problem = without_contact(face_problem(half))
        load = problem.load({name: 0.1 * value for name, value in activations.items()})
        start = None if known is None else inherited(problem, known, counts)
        state = Continuation(problem, start).run(load)
        known = known or state
        moved = half.landmark_points(state.parameters)["mouth_corner_left"]
        ways.append(float(np.linalg.norm(moved - half.landmark_points()["mouth_corner_left"])))
    first, second = np.diff(ways)
    assert first > 0.0 and abs(second) < 0.5 * first


def test_what_cannot_be_refined_is_refused(block_head):
    with pytest.raises(InputError, match="counts"):
        refined(block_head, (0, 1, 1))
    with pytest.raises(InputError, match="counts"):
        refined(block_head, (2.5, 1, 1))
    with pytest.raises(InputError, match="has been refined"):
        refined(refined(block_head, (2, 1, 1)), (2, 2, 1))
    with pytest.raises(InputError, match="refine its half"):
        refined(block_head.whole, (1, 1, 2))
