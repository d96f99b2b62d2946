"""Expressions: what they say, and which muscles that means."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from modiolus.errors import InputError
from modiolus.face.expression import GROUPS, Expression, expression_names, resolve

MUSCLES = ("zygomaticus_major", "mentalis", *GROUPS["frontalis"])


def test_the_four_expressions_use_the_muscles_of_wu_2013():
    # Wu et al. 2013, table 2; orbicularis oris keeps the lips of the closed smile together.
    table = {
        "smile-closed": {
            "buccinator",
            "levator_anguli_oris",
            "orbicularis_oculi_orbital",
            "orbicularis_oris",
            "risorius",
            "zygomaticus_major",
            "zygomaticus_minor",
        },
        "smile-open": {
            "depressor_labii_inferioris",
            "levator_anguli_oris",
            "levator_labii_superioris_alaeque_nasi",
            "orbicularis_oculi_orbital",
            "zygomaticus_major",
            "zygomaticus_minor",
        },
        "sad": {
            "corrugator_supercilii",
            "depressor_anguli_oris",
            "frontalis",
            "mentalis",
            "orbicularis_oris",
            "platysma",
            "risorius",
        },
        "terror": {
            "depressor_anguli_oris",
            "depressor_labii_inferioris",
            "frontalis",
            "mentalis",
            "platysma",
            "risorius",
        },
    }
    assert set(table) <= set(expression_names())
    whole = {part: group for group, parts in GROUPS.items() for part in parts}
    for name, muscles in table.items():
        used = set(Expression.shipped(name).activations)
        both = {whole.get(muscle, muscle) for muscle in muscles}
        assert {whole.get(muscle, muscle) for muscle in used} == both


def test_a_part_counts_more_than_its_whole():
    assert resolve({"frontalis_medial": 0.1, "frontalis": 0.4}, MUSCLES) == {
        "frontalis_medial": 0.1,
        "frontalis_lateral": 0.4,
    }


def test_both_sides_are_the_muscle():
    sides = {"mentalis_left": 0.3, "mentalis_right": 0.3}
    assert resolve(sides, MUSCLES) == resolve({"mentalis": 0.3}, MUSCLES) == {"mentalis": 0.3}


@given(value=st.floats())
def test_activations_are_within_0_and_1(value):
    if 0.0 <= value <= 1.0:
        expected = {"mentalis": value} if value > 0.0 else {}
        assert resolve({"mentalis": value}, MUSCLES) == expected
    else:
        with pytest.raises(InputError, match="mentalis: activation"):
            resolve({"mentalis": value}, MUSCLES)


PARTS = ("medial", "lateral")


def test_muscles_have_a_side_where_the_sides_differ():
    given = {"mentalis_left": 0.3, "frontalis": 0.2, "zygomaticus_major": 0.0}
    assert resolve(given, MUSCLES) == {
        "mentalis_left": 0.3,
        **{f"frontalis_{part}_{side}": 0.2 for part in PARTS for side in ("left", "right")},
    }


def test_palsy_lets_one_side_rest():
    assert resolve({"mentalis": 0.3}, MUSCLES, "right") == {"mentalis_left": 0.3}
    assert resolve({"mentalis_right": 0.3}, MUSCLES, "right") == {}
    with pytest.raises(InputError, match=r"palsied side 'rihgt'.*right"):
        resolve({"mentalis": 0.3}, MUSCLES, "rihgt")


def test_jaw_is_read_and_checked(tmp_path):
    path = tmp_path / "yawn.toml"
    path.write_text("jaw_open = 20\n")
    assert Expression.named(str(path)) == Expression("yawn", jaw_open=20.0)
    for value in ("-1", "31", "nan", "inf", "true", "'wide'"):
        path.write_text(f"jaw_open = {value}\n")
        with pytest.raises(InputError, match=r"yawn\.toml: jaw_open"):
            Expression.named(str(path))


def test_file_is_read(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('title = "Mine"\n[activations]\nmentalis = 1\n')
    assert Expression.named(str(path)) == Expression("mine", {"mentalis": 1.0}, "Mine")
