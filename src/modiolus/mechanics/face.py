"""The mechanical problem of a head: tissue, muscles, bone, lips and lids."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..face.head import Head
from .constraints import clamp, symmetry_plane
from .contact import PairContact, RigidContact, face_points
from .laws import FAT, MUSCLE, Array, FibreLaw, mix
from .problem import Problem
from .terms import FibreQuadrature, Fibres, PointTerm, Springs


@dataclass(frozen=True)
class FaceSettings:
    """Parameters of the face's mechanics.

    Attributes
    ----------
    muscle : str
        Parameter set of passive muscle, see `modiolus.mechanics.laws.MUSCLE`.
    sigma_max : float
        Greatest active fibre stress (kPa), Blemker et al. 2005.
    kappa : float
        Volumetric stiffness beside the pressure (kPa).
    modiolus : float
        c10 of the modiolus (kPa).
    contact : float
        Penalty of all contacts (kPa/mm).
    slide : float
        Fraction of that penalty with which tissue that touches bone resists lift-off.
    reach : float
        Tissue within this distance (mm) of bone at rest slides on it.
    """

    muscle: str = "wu2013"
    sigma_max: float = 300.0
    kappa: float = 50.0
    modiolus: float = 30.0
    contact: float = 250.0
    slide: float = 0.05
    reach: float = 2.0


#: Deep structures that the tissue keeps to when it is pulled away: bone under thin tissue.
SLIDING = ("skull", "mandible")


def face_problem(head: Head, settings: FaceSettings | None = None) -> Problem:
    """Set up the equilibrium of a head's half face.

    Parameters
    ----------
    head : Head
    settings : FaceSettings, optional

    Returns
    -------
    Problem
        Driven by the activations of the head's muscles.
    """
    settings = FaceSettings() if settings is None else settings
    mesh = head.tissue
    coefficients = mix(head.fraction, MUSCLE[settings.muscle], FAT)
    knot = head.firmness[..., None]
    coefficients = (1.0 - knot) * coefficients + knot * np.array([settings.modiolus, 0.0, 0.0])
    fixed = symmetry_plane(mesh, *head.sides["midplane"])
    for name in ("ear", "neck", "scalp"):
        fixed = fixed | clamp(mesh, *head.sides[name])
    terms: list[PointTerm] = [fibres(head, settings), *_springs(head)]
    terms += [*_deep_contacts(head, settings), *_slit_contacts(head, settings)]
    return Problem(mesh, coefficients, kappa=settings.kappa, terms=terms, fixed=fixed)


def fibres(head: Head, settings: FaceSettings) -> Fibres:
    """Embed the muscles: their own quadrature points, located once in the tissue."""
    parts = []
    for index, muscle in enumerate(head.muscles.values()):
        rule = muscle.quadrature()
        place = head.tissue.locate(rule.points)
        inside = place.distance < 0.05
        parts.append(
            FibreQuadrature(
                place.elements[inside],
                place.xi[inside],
                rule.weights[inside],
                rule.directions[inside],
                np.full(int(inside.sum()), index),
            )
        )
    slacks = {name: muscle.slack for name, muscle in head.muscles.items()}
    law = FibreLaw(sigma_max=settings.sigma_max)
    return Fibres(head.tissue, FibreQuadrature.concatenate(parts), list(head.muscles), law, slacks)


def _springs(head: Head) -> Iterator[Springs]:
    for item in head.attachments.values():
        yield Springs(head.tissue, item.elements, item.xi, item.stiffness, "attachments")


def _deep_contacts(head: Head, settings: FaceSettings) -> Iterator[RigidContact]:
    """Put the inner surface against every deep structure that it may reach."""
    elements, xi, areas = face_points(head.tissue, *head.sides["inner"])
    points = head.tissue.evaluate(elements, xi)
    for name, surface in head.deep.items():
        distance = surface.distance.sample(points).distance
        near = distance < surface.distance.band - 0.2
        if not near.any():
            continue
        slide = settings.slide * (distance[near] < settings.reach) * (name in SLIDING)
        yield RigidContact(
            head.tissue,
            surface.distance,
            elements[near],
            xi[near],
            areas[near],
            settings.contact,
            slide=slide,
            name=f"contact with {name}",
        )


def _slit_contacts(head: Head, settings: FaceSettings) -> Iterator[PairContact]:
    """Put upper against lower lip and lid, point by matching point of the slit."""
    for part in ("lip", "lid"):
        sides = [face_points(head.tissue, *head.sides[f"{part}_{s}"]) for s in ("upper", "lower")]
        (upper, upper_xi, areas), (lower, lower_xi, other) = sides
        mean: Array = 0.5 * (areas + other)
        yield PairContact(
            head.tissue,
            (upper, upper_xi),
            (lower, lower_xi),
            1,
            mean,
            settings.contact,
            name=f"contact of the {part}s",
        )
