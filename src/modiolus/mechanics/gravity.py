"""Gravity: the shape without it, found from a shape with it, and the shape upright.

A head measured lying on its back is not at rest: its tissue hangs towards the back of the head.
Its shape without gravity is the one whose equilibrium under the weight is the measured shape. The
fixed point

    X_{k+1} = X_k - (x(X_k) - x_measured)

finds it, where x(X) is the equilibrium of the reference shape X under the weight (Sellier 2011).
Where soft tissue is squeezed between muscles full steps overshoot, and where it is held they are
too short; so each round combines the last ones such that their distances, combined alike, are
least (Anderson 1965).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError, SolveError
from ..face.head import Head
from ..face.moved import moved_head
from ..hermite import HermiteMesh
from ..progress import Report
from .continuation import Continuation, Settings
from .face import FaceSettings, face_problem
from .laws import Array
from .problem import Problem, State
from .terms import DeadForces, Load

__all__ = ["DENSITY", "SUPINE", "UPRIGHT", "Unloaded", "Upright", "unloaded", "upright", "weight"]

#: Density of soft tissue (kg/m³).
DENSITY = 1040.0
#: Acceleration of gravity (m/s²).
ACCELERATION = 9.81
#: Where gravity points when the subject lies face up, and when it stands (LPS).
SUPINE = (0.0, 1.0, 0.0)
UPRIGHT = (0.0, 0.0, -1.0)
#: The weight's load.
LOAD = Load(forces={"weight": 1.0})
#: The rounds repeat what the continuation leaves open: an equilibrium within 0.001 mm needs
#: this, and one that is found by its contacts' pressures would depend on the way to it.
TIGHT = Settings(tolerance=1e-6, augmentations=0)
#: How many rounds are combined with the last one at most.
MEMORY = 12
#: Rounds after which the fixed point is given up. Where tissue rests on bone the last of them are
#: many: a shape that differs by a tenth of a millimetre there comes to rest a hundredth away.
MOST_ROUNDS = 40

#: Makes the problem of a reference shape with its weight under the name ``weight``.
Build = Callable[[HermiteMesh], Problem]


def weight(direction: tuple[float, float, float] | Array, density: float = DENSITY) -> Array:
    """Return the weight of tissue in mN/mm³, (3,), for gravity along a unit direction."""
    return np.asarray(direction, dtype=float) * density * ACCELERATION * 1e-6


@dataclass(frozen=True)
class Unloaded:
    """A shape without gravity.

    Attributes
    ----------
    mesh : HermiteMesh
    state : State
        Its equilibrium under the weight.
    gaps : list of float
        Greatest distance in mm of that equilibrium from the given shape in every round.
    """

    mesh: HermiteMesh
    state: State
    gaps: list[float]


def unloaded(
    build: Build,
    shape: HermiteMesh,
    tolerance: float = 0.01,
    settings: Settings | None = None,
    report: Report | None = None,
) -> Unloaded:
    """Find the shape whose equilibrium under its weight is a given one.

    Parameters
    ----------
    build : callable
        Makes the problem of a reference shape; its weight is the `DeadForces` named ``weight``.
    shape : HermiteMesh
        As measured, under the weight.
    tolerance : float
        Greatest distance (mm) between equilibrium and given shape at 4 x 4 x 4 points an element.
    settings : Settings, optional
        Of the continuation in the weight.
    report : callable, optional

    Raises
    ------
    SolveError
        The equilibrium is not found, or the rounds do not converge.
    """
    elements, xi, _ = shape.gauss_points(4)
    points = shape.functions(elements, xi)
    reference, gaps = shape, []
    # What the rounds before began with, and by how much they missed.
    references: list[Array] = []
    excesses: list[Array] = []
    for count in range(1, MOST_ROUNDS + 1):
        try:
            problem = build(reference)
        except InputError as error:
            raise SolveError(
                f"gravity: the shape without it folds in round {count} ({error}); stiffer tissue "
                "or a smaller density would help"
            ) from error
        state = Continuation(problem, settings=settings).run(LOAD)
        excess = state.parameters - shape.parameters
        gap = points @ excess
        gaps.append(float(np.linalg.norm(gap, axis=1).max()))
        if report is not None:
            done = np.log(2.0 * gaps[0] / gaps[-1]) / np.log(4.0 * gaps[0] / tolerance)
            report(
                float(np.clip(done, 0.05, 0.95)),
                f"round {count}: equilibrium within {gaps[-1]:.3f} mm of the shape",
            )
        if gaps[-1] <= tolerance:
            return Unloaded(reference, state, gaps)
        references = [*references, reference.parameters][-MEMORY - 1 :]
        excesses = [*excesses, excess][-MEMORY - 1 :]
        last = reference.parameters - excess
        if len(excesses) > 1:
            changes = [(points @ (excess - other)).ravel() for other in excesses[:-1]]
            shares = np.linalg.lstsq(np.transpose(changes), gap.ravel(), rcond=1e-6)[0]
            for share, began, other in zip(shares, references, excesses, strict=False):
                last = last - share * (reference.parameters - began - (excess - other))
        reference = reference.with_parameters(last)
    told = ", ".join(f"{gap:.3f}" for gap in gaps)
    raise SolveError(
        f"gravity: the rounds do not converge (distances {told} mm); allow a larger tolerance"
    )


def heavy_face(
    head: Head,
    shape: HermiteMesh,
    direction: tuple[float, float, float],
    density: float = DENSITY,
    settings: FaceSettings | None = None,
) -> Problem:
    """Return the problem of a head's face whose tissue at rest has another shape, with weight.

    Deep structures are where they were measured: the tissue touches them without force in the
    shape of `head`. Springs, and lips and lids against each other, are at rest in `shape`.

    Parameters
    ----------
    head : Head
        As measured.
    shape : HermiteMesh
        Its tissue without gravity.
    direction : (3,)
        Unit direction of gravity.
    density : float
        In kg/m³.
    settings : FaceSettings, optional
    """
    load = DeadForces.body(shape, weight(direction, density))
    return face_problem(replace(head, tissue=shape), settings, terms=[load], measured=head)


@dataclass(frozen=True)
class Upright:
    """A head that was measured lying on its back, standing.

    Attributes
    ----------
    free : Head
        Without gravity.
    head : Head
        Upright.
    gaps : list of float
        See `Unloaded`.
    state : State
        The equilibrium upright; its reference is the shape without gravity.
    """

    free: Head
    head: Head
    gaps: list[float]
    state: State


def upright(
    head: Head,
    density: float = DENSITY,
    tolerance: float = 0.05,
    settings: FaceSettings | None = None,
    report: Report | None = None,
) -> Upright:
    """Turn a head that was measured lying on its back upright.

    Parameters
    ----------
    head : Head
        Half, in its shape under gravity towards the back of the head.
    density : float
        Of the tissue (kg/m³).
    tolerance : float
        See `unloaded`.
    settings : FaceSettings, optional
    report : callable, optional
    """
    free = unloaded(
        lambda shape: heavy_face(head, shape, SUPINE, density, settings),
        head.tissue,
        tolerance,
        TIGHT,
        report,
    )
    problem = heavy_face(head, free.mesh, UPRIGHT, density, settings)
    state = Continuation(problem, settings=TIGHT).run(LOAD)
    return Upright(
        moved_head(head, free.mesh.parameters),
        moved_head(head, state.parameters),
        free.gaps,
        state,
    )
