"""Constitutive laws: the passive tissue and the muscle fibres.

Energies are per reference volume in kPa (= mN mm / mm³). Everything that a kernel needs
is a small compiled function here, so that the equations stand in one place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

#: Component pairs (i, j) with i <= j, in the order in which 3 × 3 blocks are stored.
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


@dataclass(frozen=True)
class Coefficients:
    """Coefficients of the isochoric energy of one tissue.

    ``W = c10 (Ī1 - 3) + c01 (Ī2 - 3) + c20 (Ī1 - 3)²``

    Attributes
    ----------
    c10, c01, c20 : float
        In kPa.
    source : str
        Where the values come from.
    """

    c10: float
    c01: float
    c20: float
    source: str

    def array(self) -> Array:
        """Return ``(c10, c01, c20)``."""
        return np.array([self.c10, self.c01, self.c20])


#: Subcutaneous fat.
FAT = Coefficients(0.42, 0.0, 0.0, "Tran et al. 2007, hypodermis, C10 = 0.42 ± 0.05 kPa")

#: Passive muscle by the name of the parameter set.
MUSCLE: dict[str, Coefficients] = {
    "wu2013": Coefficients(
        2.5, 1.175, 0.0, "Wu et al. 2013, table 1, with c2 in kPa as in Nazari et al. 2010"
    ),
    "wu2013-as-printed": Coefficients(
        2.5, 1.175e-3, 0.0, "Wu et al. 2013, table 1, with c2 in Pa as printed"
    ),
    "yeoh-nazari2010": Coefficients(
        2.5, 0.0, 1.175, "Nazari et al. 2010, Yeoh form as in the ArtiSynth face"
    ),
}


def mix(fraction: ArrayLike, muscle: Coefficients, fat: Coefficients = FAT) -> Array:
    """Interpolate coefficients linearly in the muscle volume fraction.

    Parameters
    ----------
    fraction : (...) array
        Muscle fraction, 0 (fat) to 1 (muscle).
    muscle, fat : Coefficients

    Returns
    -------
    (..., 3) array
        ``(c10, c01, c20)`` in kPa.
    """
    phi = np.asarray(fraction, dtype=float)[..., None]
    return phi * muscle.array() + (1.0 - phi) * fat.array()


@dataclass(frozen=True)
class FibreLaw:
    """Active and passive force-stretch curves of a muscle fibre (Blemker et al. 2005).

    The first Piola stress is ``ψ'(λ) n ⊗ f0`` with
    ``ψ' = (σ_max / λ_ofl) (a f_act(λ / λ_ofl) + f_pas(λ / λ_slack))``, which is the
    Cauchy stress of Blemker et al. for an incompressible tissue.

    Attributes
    ----------
    sigma_max : float
        Greatest active stress in kPa.
    optimal : float
        λ_ofl, the stretch at which the active force is greatest.
    p1, p2 : float
        Factor and exponent of the passive curve.
    linear_from : float
        λ*, relative to the slack length, from which the passive curve is straight.
    toe : float
        Stretch beyond the slack length over which the passive stiffness grows from zero to
        that of the curve, which it has at once when this is 0 (as published). A sudden
        stiffness in every resting muscle at λ = 1 costs Newton's method many iterations.
    """

    sigma_max: float = 300.0
    optimal: float = 1.0
    p1: float = 0.05
    p2: float = 6.6
    linear_from: float = 1.4
    toe: float = 0.02

    def array(self) -> Array:
        """Return the parameters in the order that the kernels expect."""
        return np.array(
            [self.sigma_max, self.optimal, self.p1, self.p2, self.linear_from, self.toe]
        )
