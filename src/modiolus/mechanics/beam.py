"""A beam bent and twisted by a slab of muscle inside it.

The smallest problem with an embedded muscle: fibres along the beam shorten its upper side and
bend it upwards; fibres at an angle to the axis, lying in the slab, also shear that side and so
twist the beam. After figure 4 of Wu et al. 2013.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import InputError
from ..face.muscle import Muscle
from ..hermite import HermiteMesh, gauss, grid
from ..progress import Report
from .constraints import clamp
from .continuation import Continuation
from .laws import FAT, MUSCLE, Array, mix
from .problem import Problem, State
from .terms import FibreQuadrature, Fibres

#: Length, width and height of the beam in mm, along x, y and z; its root is at x = 0.
SIZE = (100.0, 20.0, 20.0)
#: The slab in mm: all along the beam, near its top and clear of its sides.
SLAB = ((0.0, 100.0), (2.0, 18.0), (13.0, 18.0))
ELEMENTS = (8, 2, 2)


@dataclass(frozen=True)
class BeamResult:
    """Where the tip of the beam went.

    Attributes
    ----------
    angle : float
        Of the fibres to the axis, in degrees, positive from +x towards +y.
    state : State
    tip : (3,) array
        Displacement of the middle of the end section in mm.
    bend, twist : float
        Rotation of the end section in degrees: of its normal away from the axis of the beam,
        and about the axis of the beam (right-handed about +x).
    """

    angle: float
    state: State
    tip: Array
    bend: float
    twist: float


def beam_mesh() -> HermiteMesh:
    """Return the beam at rest."""
    axes = [np.linspace(0.0, size, n + 1) for size, n in zip(SIZE, ELEMENTS, strict=True)]
    return grid(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))


def slab_mesh() -> HermiteMesh:
    """Return the slab of muscle at rest."""
    axes = [
        np.linspace(low, high, n + 1)
        for (low, high), n in zip(SLAB, (ELEMENTS[0], 2, 1), strict=True)
    ]
    return grid(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))


def slab(angle: float) -> Muscle:
    """Return the slab with its fibres at an angle in degrees, as Euler angles of its nodes."""
    mesh = slab_mesh()
    angles = np.tile([np.radians(angle), 0.0, 0.0], (mesh.n_params // 8, 1))
    return Muscle("slab", mesh, "sheet", angles)


def fibre_direction(angle: float) -> Array:
    """Return the unit fibre direction (3,) for an angle in degrees."""
    radians = np.radians(angle)
    return np.array([np.cos(radians), np.sin(radians), 0.0])


def bend_beam(angle: float, activation: float, report: Report | None = None) -> BeamResult:
    """Contract the slab and follow the beam.

    Parameters
    ----------
    angle : float
        Of the fibres to the axis of the beam, in degrees, -90 to 90.
    activation : float
        0..1.
    report : callable, optional
        Called with ``(fraction, message)`` as the activation grows.

    Raises
    ------
    InputError
        If the angle is out of range or not a number.
    SolveError
        If the activation cannot be reached.
    """
    if not -90.0 <= angle <= 90.0:
        raise InputError(f"angle: {angle} is not within -90..90 degrees; mend it")
    mesh, rule = beam_mesh(), slab(angle).quadrature()
    place = mesh.locate(rule.points)
    quadrature = FibreQuadrature(
        place.elements,
        place.xi,
        rule.weights,
        rule.directions,
        np.zeros(len(rule.weights), dtype=np.int64),
    )
    points = mesh.evaluate(*Problem.gauss_points(mesh))
    low, high = np.array(SLAB).T
    inside = ((points >= low) & (points <= high)).all(axis=1)
    coefficients = mix(inside.reshape(mesh.n_elements, -1).astype(float), MUSCLE["wu2013"], FAT)
    root = np.arange(0, mesh.n_elements, ELEMENTS[0])
    problem = Problem(
        mesh,
        coefficients,
        terms=[Fibres(mesh, quadrature, ["slab"])],
        fixed=clamp(mesh, root, 0, 0),
    )
    state = Continuation(problem, report=report).run(problem.load({"slab": activation}))

    end = np.arange(ELEMENTS[0] - 1, mesh.n_elements, ELEMENTS[0])
    xi, _ = gauss(2, 4)
    xi = np.column_stack([np.ones(len(xi)), xi])
    hosts = np.repeat(end, len(xi))
    places = np.tile(xi, (len(end), 1))
    rest = mesh.evaluate(hosts, places)
    moved = state.mesh.evaluate(hosts, places)
    rotation, _ = Rotation.align_vectors(moved - moved.mean(0), rest - rest.mean(0))
    # Swing and twist: the part of the rotation that is about the axis of the beam itself.
    x, _, _, w = rotation.as_quat(canonical=True)
    normal = rotation.apply([1.0, 0.0, 0.0])
    return BeamResult(
        angle=angle,
        state=state,
        tip=moved.mean(0) - rest.mean(0),
        bend=float(np.degrees(np.arccos(np.clip(normal[0], -1.0, 1.0)))),
        twist=float(np.degrees(2.0 * np.arctan2(x, w))),
    )
