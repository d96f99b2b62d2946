"""Constitutive laws: the passive tissue and the muscle fibres.

Energies are per reference volume in kPa (= mN mm / mm³). Everything that a kernel needs
is a small compiled function here, so that the equations stand in one place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
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


@njit(cache=True, inline="always")
def cofactor(f: Any, h: Any) -> Any:
    """Write the cofactor ``∂J/∂F`` of ``f`` into ``h`` and return ``J``."""
    h[0, 0] = f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1]
    h[0, 1] = f[1, 2] * f[2, 0] - f[1, 0] * f[2, 2]
    h[0, 2] = f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0]
    h[1, 0] = f[0, 2] * f[2, 1] - f[0, 1] * f[2, 2]
    h[1, 1] = f[0, 0] * f[2, 2] - f[0, 2] * f[2, 0]
    h[1, 2] = f[0, 1] * f[2, 0] - f[0, 0] * f[2, 1]
    h[2, 0] = f[0, 1] * f[1, 2] - f[0, 2] * f[1, 1]
    h[2, 1] = f[0, 2] * f[1, 0] - f[0, 0] * f[1, 2]
    h[2, 2] = f[0, 0] * f[1, 1] - f[0, 1] * f[1, 0]
    return f[0, 0] * h[0, 0] + f[0, 1] * h[0, 1] + f[0, 2] * h[0, 2]


@njit(cache=True)
def passive(
    f: Any, c: Any, kappa: Any, p: Any, stress: Any, tangent: Any, with_tangent: Any
) -> Any:
    """Evaluate the passive energy and its derivatives at one point.

    ``W(F, p) = c10 (Ī1 - 3) + c01 (Ī2 - 3) + c20 (Ī1 - 3)² + κ/2 (J - 1)² + p (J - 1)``
    with ``Ī1 = J^(-2/3) tr C`` and ``Ī2 = J^(-4/3) (tr² C - tr C²) / 2``.

    Parameters
    ----------
    f : (3, 3) array
        Deformation gradient with ``J > 0``.
    c : (3,) array
        ``(c10, c01, c20)`` in kPa.
    kappa, p : float
        Volumetric stiffness and Lagrange multiplier in kPa.
    stress : (3, 3) array, written
        First Piola stress ``P_iK = ∂W/∂F_iK``.
    tangent : (6, 3, 3) array, written when ``with_tangent``
        ``[pair (i, j), K, L] = ∂P_iK/∂F_jL``.

    Returns
    -------
    energy, J : float
    """
    h = np.empty((3, 3))
    cg = np.empty((3, 3))
    bg = np.empty((3, 3))
    d1 = np.empty((3, 3))
    e2 = np.empty((3, 3))
    d2 = np.empty((3, 3))
    det = cofactor(f, h)
    for i in range(3):
        for j in range(3):
            cg[i, j] = f[0, i] * f[0, j] + f[1, i] * f[1, j] + f[2, i] * f[2, j]
            bg[i, j] = f[i, 0] * f[j, 0] + f[i, 1] * f[j, 1] + f[i, 2] * f[j, 2]
    i1 = cg[0, 0] + cg[1, 1] + cg[2, 2]
    i2 = 0.0
    for i in range(3):
        for j in range(3):
            i2 -= cg[i, j] * cg[i, j]
    i2 = 0.5 * (i1 * i1 + i2)
    alpha = det ** (-2.0 / 3.0)
    beta = alpha * alpha
    i1b = alpha * i1
    i2b = beta * i2
    w1 = c[0] + 2.0 * c[2] * (i1b - 3.0)
    w2 = c[1]
    w11 = 2.0 * c[2]
    q = kappa * (det - 1.0) + p
    for i in range(3):
        for k in range(3):
            fc = f[i, 0] * cg[0, k] + f[i, 1] * cg[1, k] + f[i, 2] * cg[2, k]
            e2[i, k] = 2.0 * (i1 * f[i, k] - fc)
            d1[i, k] = 2.0 * alpha * f[i, k] - (2.0 / 3.0) * i1b / det * h[i, k]
            d2[i, k] = beta * e2[i, k] - (4.0 / 3.0) * i2b / det * h[i, k]
            stress[i, k] = w1 * d1[i, k] + w2 * d2[i, k] + q * h[i, k]
    energy = (
        c[0] * (i1b - 3.0)
        + c[1] * (i2b - 3.0)
        + c[2] * (i1b - 3.0) ** 2
        + 0.5 * kappa * (det - 1.0) ** 2
        + p * (det - 1.0)
    )
    if not with_tangent:
        return energy, det
    fh = -(4.0 / 3.0) * w1 * alpha / det
    eh = -(4.0 / 3.0) * w2 * beta / det
    hh = ((10.0 / 9.0) * w1 * i1b + (28.0 / 9.0) * w2 * i2b) / (det * det) + kappa
    curl = q - ((2.0 / 3.0) * w1 * i1b + (4.0 / 3.0) * w2 * i2b) / det
    b2 = 2.0 * w2 * beta
    unit = 2.0 * w1 * alpha + b2 * i1
    pair = 0
    for i in range(3):
        for j in range(i, 3):
            for k in range(3):
                for m in range(3):
                    value = (
                        fh * (f[i, k] * h[j, m] + h[i, k] * f[j, m])
                        + eh * (e2[i, k] * h[j, m] + h[i, k] * e2[j, m])
                        + hh * h[i, k] * h[j, m]
                        + w11 * d1[i, k] * d1[j, m]
                        + b2 * (2.0 * f[i, k] * f[j, m] - f[i, m] * f[j, k])
                    )
                    if k == m:
                        value -= b2 * bg[i, j]
                        if i == j:
                            value += unit
                    if i == j:
                        value -= b2 * cg[k, m]
                    tangent[pair, k, m] = value
            if i != j:
                # ∂²J/∂F_iK∂F_jL = ε_ijn ε_KLM F_nM
                n = 3 - i - j
                s = curl if (i + 1) % 3 == j else -curl
                tangent[pair, 0, 1] += s * f[n, 2]
                tangent[pair, 1, 0] -= s * f[n, 2]
                tangent[pair, 1, 2] += s * f[n, 0]
                tangent[pair, 2, 1] -= s * f[n, 0]
                tangent[pair, 2, 0] += s * f[n, 1]
                tangent[pair, 0, 2] -= s * f[n, 1]
            pair += 1
    return energy, det


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
    """

    sigma_max: float = 300.0
    optimal: float = 1.0
    p1: float = 0.05
    p2: float = 6.6
    linear_from: float = 1.4

    def array(self) -> Array:
        """Return the parameters in the order that the kernels expect."""
        return np.array([self.sigma_max, self.optimal, self.p1, self.p2, self.linear_from])


@njit(cache=True)
def active_force(r: Any) -> Any:
    """Return the integral, value and slope of the active curve ``f_act(r)``."""
    # Integrals over the three pieces: 0.024, 0.8 - 8/3 0.4³ = 0.629333…, 0.024.
    if r <= 0.4:
        return 0.0, 0.0, 0.0
    if r <= 0.6:
        return 3.0 * (r - 0.4) ** 3, 9.0 * (r - 0.4) ** 2, 18.0 * (r - 0.4)
    if r < 1.4:
        s = r - 1.0
        return (
            0.024 + (s - 4.0 / 3.0 * s**3) - (-0.4 + 4.0 / 3.0 * 0.064),
            1.0 - 4.0 * s * s,
            -8.0 * s,
        )
    total = 0.024 + 0.8 - 8.0 / 3.0 * 0.064 + 0.024
    if r < 1.6:
        return total + 3.0 * (r - 1.6) ** 3, 9.0 * (r - 1.6) ** 2, 18.0 * (r - 1.6)
    return total, 0.0, 0.0


@njit(cache=True)
def passive_force(r: Any, p1: Any, p2: Any, linear_from: Any) -> Any:
    """Return the integral, value and slope of the passive curve ``f_pas(r)``."""
    if r <= 1.0:
        return 0.0, 0.0, 0.0
    s = min(r, linear_from) - 1.0
    e = np.exp(p2 * s)
    integral = p1 * ((e - 1.0) / p2 - s)
    value = p1 * (e - 1.0)
    slope = p1 * p2 * e
    if r > linear_from:
        t = r - linear_from
        integral += value * t + 0.5 * slope * t * t
        value += slope * t
    return integral, value, slope


@njit(cache=True)
def fibre(stretch: Any, activation: Any, slack: Any, law: Any) -> Any:
    """Evaluate the fibre potential ``ψ(λ)`` at fixed activation.

    Parameters
    ----------
    stretch : float
        λ, relative to the resting fibre.
    activation : float
        0..1.
    slack : float
        Stretch from which the passive fibre is taut.
    law : (5,) array
        `FibreLaw.array`.

    Returns
    -------
    energy, force, stiffness : float
        ``ψ``, ``ψ'`` and ``ψ''`` in kPa.
    """
    sigma, optimal, p1, p2, linear_from = law[0], law[1], law[2], law[3], law[4]
    ai, av, ad = active_force(stretch / optimal)
    pi, pv, pd = passive_force(stretch / slack, p1, p2, linear_from)
    energy = sigma * (activation * ai + pi * slack / optimal)
    force = sigma / optimal * (activation * av + pv)
    stiffness = sigma / optimal * (activation * ad / optimal + pd / slack)
    return energy, force, stiffness
