"""What an identification may find: activations, the opening of the jaw, stiffness of the tissue."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, unknown_name
from ..face.expression import GROUPS
from ..face.head import Head
from ..face.jaw import WIDEST
from ..mechanics.continuation import Continuation
from ..mechanics.face import Face, FaceSettings, face_load, other_tissue
from ..mechanics.problem import Problem
from ..mechanics.terms import Load

__all__ = ["FURTHER", "JAW", "TABLE_2", "Driven", "Unknown", "muscle_set", "unknowns"]

Array = NDArray[np.float64]

#: Muscles of the four expressions in table 2 of Wu et al. (2013), by expression. The malar part of
#: orbicularis oculi belongs to the orbital one, which the table names.
TABLE_2: dict[str, tuple[str, ...]] = {
    "smile-closed": (
        *("buccinator", "levator_anguli_oris", "risorius"),
        *("orbicularis_oculi_orbital", "orbicularis_oculi_malar"),
        *("zygomaticus_major", "zygomaticus_minor"),
    ),
    "smile-open": (
        *("depressor_labii_inferioris", "levator_anguli_oris"),
        *("levator_labii_superioris_alaeque_nasi", "orbicularis_oculi_orbital"),
        *("orbicularis_oculi_malar", "zygomaticus_major", "zygomaticus_minor"),
    ),
    "sad": (
        *("corrugator_supercilii", "depressor_anguli_oris", "frontalis", "mentalis"),
        *("orbicularis_oris", "platysma", "risorius"),
    ),
    "terror": (
        *("depressor_anguli_oris", "depressor_labii_inferioris", "frontalis", "mentalis"),
        *("platysma", "risorius"),
    ),
}
#: The opening of the jaw, and the fields of `FaceSettings` that may be unknown.
JAW, FURTHER = "jaw", ("jaw", "sigma_max", "fat", "passive", "skin")
#: Activation at which a muscle shows what it does, by its kind.
SCALES = {"strap": 1.0, "sheet": 0.2, "ring": 0.2}
#: Cost of a muscle outside the prior set.
OUTSIDER = 4.0
#: The jaw shows what it does at this angle (radians).
_JAW_SCALE = math.radians(10.0)
#: A stiffness is sought up to this many times its usual value, and down to its inverse.
_SPAN = 4.0
#: Step of the differences of the residual, in units of the scales.
_STEP = 1e-4


@dataclass(frozen=True)
class Unknown:
    """A number to be found.

    Attributes
    ----------
    name : str
        A muscle of the half or of the whole head, or one of `FURTHER`.
    low, high : float
        Bounds.
    scale : float
        Change that shows.
    usual : float
        Value where nothing tells of it.
    cost : float
        Weight of its size, where that is to be small.
    """

    name: str
    low: float
    high: float
    scale: float
    usual: float = 0.0
    cost: float = 0.0


def muscle_set(names: Sequence[str], head: Head) -> list[str]:
    """Return the muscles of a head that some names mean.

    Parameters
    ----------
    names : sequence of str
        Muscles, groups of `modiolus.face.expression.GROUPS`, or expressions of `TABLE_2`; of a
        head with both sides also those of one side.
    head : Head

    Raises
    ------
    InputError
        A name is not known.
    """
    half = head.half or head
    groups: dict[str, tuple[str, ...]] = {**{name: (name,) for name in half.muscles}, **GROUPS}
    if head.half is not None:
        sided = {
            f"{name}_{side}": tuple(f"{part}_{side}" for part in parts)
            for name, parts in groups.items()
            for side in ("left", "right")
        }
        groups = {
            name: (*sided[f"{name}_left"], *sided[f"{name}_right"]) for name in groups
        } | sided
    wanted: set[str] = set()
    for name in names:
        for part in TABLE_2.get(name, (name,)):
            if part not in groups:
                raise unknown_name("muscle", part, [*groups, *TABLE_2])
            wanted.update(groups[part])
    return [name for name in head.muscles if name in wanted]


def unknowns(
    head: Head,
    muscles: Sequence[str] | None = None,
    prior: Sequence[str] = (),
    further: Sequence[str] = (),
    settings: FaceSettings | None = None,
) -> list[Unknown]:
    """Return what is to be found.

    Parameters
    ----------
    head : Head
        The half, or the whole where sides may differ.
    muscles : sequence of str, optional
        Those that are free, see `muscle_set`; all by default.
    prior : sequence of str
        Those that are expected; the others cost more. None: all cost the same.
    further : sequence of str
        Of `FURTHER`: the angle of the jaw (radians), the greatest fibre stress (kPa), the
        stiffness of fat and of passive muscle (factors), and that of the skin (kPa).
    settings : FaceSettings, optional
        Of the face, for what is usual.

    Raises
    ------
    InputError
        A name is not known, or the head has no jaw.
    """
    usual = FaceSettings() if settings is None else settings
    free = list(head.muscles) if muscles is None else muscle_set(muscles, head)
    expected = muscle_set(prior, head)
    found = [
        Unknown(
            name,
            0.0,
            1.0,
            SCALES[head.muscles[name].kind],
            cost=1.0 if not expected or name in expected else OUTSIDER,
        )
        for name in free
    ]
    for name in further:
        if name not in FURTHER:
            raise unknown_name("unknown", name, FURTHER)
        if name == JAW:
            if head.jaw is None:
                raise InputError(f"{head.name}: the head has no mandible; leave its jaw closed")
            found.append(Unknown(JAW, 0.0, math.radians(WIDEST), _JAW_SCALE))
        else:
            value = float(getattr(usual, name))
            found.append(Unknown(name, value / _SPAN, value * _SPAN, value, value))
    if not found:
        raise InputError("unknowns: there are none; name a muscle")
    return found


class Driven:
    """A face that some unknowns drive; other muscles rest.

    Parameters
    ----------
    face : Face
    unknowns : sequence of k Unknown
        Where a muscle has a side, all have, and both sides of the face are computed.

    Attributes
    ----------
    head : Head
        The half, or the whole.
    """

    def __init__(self, face: Face, unknowns: Sequence[Unknown]) -> None:
        self.face, self.unknowns = face, list(unknowns)
        self._muscles = [k for k, item in enumerate(unknowns) if item.name not in FURTHER]
        half = all(self.unknowns[k].name in face.head.muscles for k in self._muscles)
        self.head = face.head if half else face.head.whole
        self._base = face.half if half else face.whole

    def problem(self, values: Array) -> Problem:
        """Return the problem with the tissue that values (k,) mean."""
        changed: dict[str, Any] = {
            item.name: float(value)
            for item, value in zip(self.unknowns, values, strict=True)
            if item.name in FURTHER and item.name != JAW
        }
        if not changed:
            return self._base
        return other_tissue(self._base, self.head, replace(self.face.settings, **changed))

    def load(self, values: Array) -> Load:
        """Return the load that values (k,) mean."""
        by_name = {u.name: float(value) for u, value in zip(self.unknowns, values, strict=True)}
        jaw = by_name.get(JAW, 0.0)
        active = {self.unknowns[k].name: float(values[k]) for k in self._muscles if values[k] > 0.0}
        return face_load(self._base, self.head, active, jaw)

    def slopes(self, path: Continuation, values: Array) -> Array:
        """Return the derivatives of a converged state by the unknowns, (n_params, 3, k).

        Those by activations are exact. The residual at fixed deformation is linear in the
        coefficients of the tissue and in the greatest stress, so that its differences are exact,
        too; those by the angle of the jaw are central ones.
        """
        state = path.state
        k = len(self.unknowns)
        slopes = np.zeros((path.problem.n_unknowns, k))
        held = np.zeros((*state.parameters.shape, k))
        names = [self.unknowns[j].name for j in self._muscles]
        slopes[:, self._muscles] = path.problem.activation_slopes(
            state.parameters, names, state.load
        )
        for j in sorted({*range(k)} - {*self._muscles}):
            step = _STEP * self.unknowns[j].scale
            for sign in (1.0, -1.0):
                there = values.copy()
                there[j] += sign * step
                problem = self.problem(there)
                load = replace(self.load(there), offsets=state.load.offsets)
                residual = problem.evaluate(state.parameters, state.pressure, load).residual
                slopes[:, j] += sign * residual / (2.0 * step)
                held[:, :, j] += sign * problem.prescribe(load) / (2.0 * step)
        held[~path.problem.fixed] = 0.0
        return path.answers(slopes, held)
