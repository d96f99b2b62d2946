"""Constitutive laws: the passive tissue and the muscle fibres.

Energies are per reference volume in kPa (= mN mm / mm³). What stands here are their parameters; the
compiled functions that evaluate them are in `kernels`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

#: Component pairs (i, j) with i <= j, in the order in which 3 × 3 blocks are stored.
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


class Law(IntEnum):
    """Which passive energy the coefficients of a problem belong to.

    Attributes
    ----------
    ISOCHORIC
        ``c10 (Ī1 - 3) + c01 (Ī2 - 3) + c20 (Ī1 - 3)²`` of `Coefficients`: the face.
    PLAIN
        ``c10 (I1 - 3) + c01 (I2 - 3)`` of `Coefficients`, with the invariants as they are.
    GUCCIONE
        Heart muscle, `Guccione`.
    MUSCLE
        Skeletal muscle, matrix and fibres in one, `BlemkerMuscle`.
    """

    ISOCHORIC = 0
    PLAIN = 1
    GUCCIONE = 2
    MUSCLE = 3


class Volume(IntEnum):
    """How the volume is held.

    Attributes
    ----------
    MULTIPLIER
        ``p (J - 1) + κ/2 (J - 1)²``: the face.
    INVERSE
        The stress ``2 p C⁻¹`` with the constraint ``J = 1``. The two do not derive from one
        energy; the tangent takes ``2/J`` for 2 in the constraint and stays symmetric, so that
        corrections contract by about ``|J - 1|``.
    LOGARITHM
        ``κ/2 ln² J`` without a pressure: compressible.
    """

    MULTIPLIER = 0
    INVERSE = 1
    LOGARITHM = 2


@dataclass(frozen=True)
class Formulation:
    """The form of a problem's passive energy; by default that of the face.

    Attributes
    ----------
    law : Law
    volume : Volume
    """

    law: Law = Law.ISOCHORIC
    volume: Volume = Volume.MULTIPLIER


#: Numbers that a law needs at a point.
WIDTHS = {Law.ISOCHORIC: 3, Law.PLAIN: 3, Law.GUCCIONE: 7, Law.MUSCLE: 13}


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

    def times(self, factor: float) -> Coefficients:
        """Return those of a tissue that is stiffer by a factor."""
        c10, c01, c20 = (factor * self.array()).tolist()
        return Coefficients(c10, c01, c20, f"{factor:g} times: {self.source}")


#: Subcutaneous fat.
FAT = Coefficients(0.42, 0.0, 0.0, "Tran et al. 2007, hypodermis, C10 = 0.42 ± 0.05 kPa")

#: Cartilage of the nose: a sixth of Young's modulus.
CARTILAGE = Coefficients(
    350.0, 0.0, 0.0, "Griffin et al. 2016, alar cartilage, Young's modulus 2.09 ± 0.81 MPa"
)

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


@dataclass(frozen=True)
class Guccione:
    """Transversely isotropic heart muscle of Guccione et al. (1991).

    ``W = C/2 (exp Q - 1)`` with
    ``Q = bf E_ff² + bt (E_ss² + E_nn² + E_sn² + E_ns²) + bfs (E_fs² + E_sf² + E_fn² + E_nf²)``.

    Attributes
    ----------
    c : float
        In kPa.
    bf, bt, bfs : float
    """

    c: float
    bf: float
    bt: float
    bfs: float

    def array(self, directions: ArrayLike) -> Array:
        """Return the coefficients at points with unit fibre directions (..., 3); (..., 7)."""
        return _at_fibres(np.array([self.c, self.bf, self.bt, self.bfs]), directions)


@dataclass(frozen=True)
class BlemkerMuscle:
    """Skeletal muscle of Blemker et al. (2005): matrix and fibres as one material.

    ``W = G1 B1² + G2 B2² + ψ(λ̄)`` with the shears along and across the fibre, and the fibre's
    potential at the isochoric stretch.

    Attributes
    ----------
    g1, g2 : float
        Shear moduli along and across the fibre in kPa.
    fibre : FibreLaw
    activation : float
        0..1.
    slack : float
        Stretch from which the passive fibre is taut.
    """

    g1: float
    g2: float
    fibre: FibreLaw = field(default_factory=FibreLaw)
    activation: float = 0.0
    slack: float = 1.0

    def array(self, directions: ArrayLike) -> Array:
        """Return the coefficients at points with unit fibre directions (..., 3); (..., 13)."""
        head = np.array([self.g1, self.g2, self.activation, self.slack, *self.fibre.array()])
        return _at_fibres(head, directions)


def _at_fibres(head: Array, directions: ArrayLike) -> Array:
    directions = np.asarray(directions, dtype=float)
    return np.concatenate(
        [np.broadcast_to(head, (*directions.shape[:-1], len(head))), directions], axis=-1
    )
