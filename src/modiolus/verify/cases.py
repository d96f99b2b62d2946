"""All cases by name."""

from __future__ import annotations

from collections.abc import Sequence

from ..errors import unknown_name
from . import closed, contact, derivatives, febio, land, opencmiss, patch, rates
from .case import Case

#: In the order in which they run.
CASES = {
    case.name: case
    for case in (
        Case(
            "derivatives",
            "every term agrees with finite differences",
            derivatives.finite_differences,
        ),
        Case("rigid-motion", "turning and moving costs nothing", derivatives.rigid_motion),
        Case("patch", "even deformation of elements of any shape and extraction", patch.patches),
        Case("plane-strain", "closed form of a cube, both readings of c2", closed.plane_strain),
        Case("muscle-work", "the work of a muscle is the energy stored", closed.muscle_work),
        Case("giving-way", "a path along which the load turns back twice", closed.giving_way),
        Case("manufactured", "rates of convergence to a known solution", rates.manufactured),
        Case("inf-sup", "the pressure is stable under refinement", rates.inf_sup),
        Case("contact-patch", "even pressure between unlike meshes", contact.even_pressure),
        Case("hertz", "two round bodies against Hertz", contact.hertz),
        Case("opencmiss-cantilever", "cantilever under its own weight", opencmiss.cantilever),
        Case("opencmiss-extension", "tricubic axial extension", opencmiss.extension),
        Case("febio-mu02", "FEBio's muscle, slack", febio.mu02),
        Case("febio-mu03", "FEBio's muscle, taut", febio.mu03),
        Case("land-1", "Land et al. 2015, beam under a following pressure", land.beam),
        Case("land-2", "Land et al. 2015, inflated ventricle", land.inflated),
        Case("land-3", "Land et al. 2015, contracting ventricle", land.contracting),
    )
}


def choose(names: Sequence[str]) -> list[Case]:
    """Return the cases of some names, or all of them when there are none.

    Raises
    ------
    InputError
        If a name is not known.
    """
    for name in names:
        if name not in CASES:
            raise unknown_name("case", name, CASES)
    return [case for case in CASES.values() if not names or case.name in names]
