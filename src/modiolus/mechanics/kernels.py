"""Compiled laws and element loops.

Residuals and tangents are collected by element. With ``m`` the greatest number of global
functions on an element of a pattern, an element has a residual ``(m, 3)``, a tangent of
six ``(m, m)`` blocks for the component pairs ``(0,0) (0,1) (0,2) (1,1) (1,2) (2,2)`` and a
coupling of three ``(m, 8)`` blocks with its pressures. Padded places carry zero functions.

Laws and loops share this file because Numba's cache does not see changes of other files.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange

from .laws import Law, Volume

# Numba takes these for compile-time constants.
PLAIN, GUCCIONE = int(Law.PLAIN), int(Law.GUCCIONE)
MULTIPLIER, INVERSE = int(Volume.MULTIPLIER), int(Volume.INVERSE)
#: Functionals below which a second thread costs more than it saves.
FEW = 2000


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
def passive_force(r: Any, p1: Any, p2: Any, linear_from: Any, toe: Any) -> Any:
    """Return the integral, value and slope of the passive curve ``f_pas(r)``.

    In the toe the value is the cubic from (1, 0) with slope 0 to the curve and its slope.
    """
    if r <= 1.0:
        return 0.0, 0.0, 0.0
    offset = 0.0
    if toe > 0.0:
        e = np.exp(p2 * toe)
        a = 3.0 * p1 * (e - 1.0) - toe * p1 * p2 * e
        b = toe * p1 * p2 * e - 2.0 * p1 * (e - 1.0)
        t = min((r - 1.0) / toe, 1.0)
        integral = toe * t**3 * (a / 3.0 + b * t / 4.0)
        if t < 1.0:
            return integral, t * t * (a + b * t), t * (2.0 * a + 3.0 * b * t) / toe
        offset = integral - p1 * ((e - 1.0) / p2 - toe)
    s = min(r, linear_from) - 1.0
    e = np.exp(p2 * s)
    integral = offset + p1 * ((e - 1.0) / p2 - s)
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
    law : (6,) array
        `FibreLaw.array`.

    Returns
    -------
    energy, force, stiffness : float
        ``ψ``, ``ψ'`` and ``ψ''`` in kPa.
    """
    sigma, optimal, p1, p2 = law[0], law[1], law[2], law[3]
    ai, av, ad = active_force(stretch / optimal)
    pi, pv, pd = passive_force(stretch / slack, p1, p2, law[4], law[5])
    energy = sigma * (activation * ai + pi * slack / optimal)
    force = sigma / optimal * (activation * av + pv)
    stiffness = sigma / optimal * (activation * ad / optimal + pd / slack)
    return energy, force, stiffness


@njit(cache=True)
def add_curl(f: Any, factor: Any, tangent: Any) -> None:
    """Add ``factor ∂²J/∂F_iK∂F_jL = factor ε_ijn ε_KLM F_nM`` to the pairs of a tangent."""
    for pair, n, sign in ((1, 2, 1.0), (2, 1, -1.0), (4, 0, 1.0)):
        s = sign * factor
        tangent[pair, 0, 1] += s * f[n, 2]
        tangent[pair, 1, 0] -= s * f[n, 2]
        tangent[pair, 1, 2] += s * f[n, 0]
        tangent[pair, 2, 1] -= s * f[n, 0]
        tangent[pair, 2, 0] += s * f[n, 1]
        tangent[pair, 0, 2] -= s * f[n, 1]


@njit(cache=True)
def isochoric(
    f: Any, h: Any, det: Any, c: Any, stress: Any, tangent: Any, with_tangent: Any
) -> Any:
    """Evaluate ``c10 (Ī1 - 3) + c01 (Ī2 - 3) + c20 (Ī1 - 3)²``, see `passive`.

    ``Ī1 = J^(-2/3) tr C`` and ``Ī2 = J^(-4/3) (tr² C - tr C²) / 2``.
    """
    cg = np.empty((3, 3))
    bg = np.empty((3, 3))
    d1 = np.empty((3, 3))
    e2 = np.empty((3, 3))
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
    for i in range(3):
        for k in range(3):
            fc = f[i, 0] * cg[0, k] + f[i, 1] * cg[1, k] + f[i, 2] * cg[2, k]
            e2[i, k] = 2.0 * (i1 * f[i, k] - fc)
            d1[i, k] = 2.0 * alpha * f[i, k] - (2.0 / 3.0) * i1b / det * h[i, k]
            d2 = beta * e2[i, k] - (4.0 / 3.0) * i2b / det * h[i, k]
            stress[i, k] = w1 * d1[i, k] + w2 * d2
    energy = c[0] * (i1b - 3.0) + c[1] * (i2b - 3.0) + c[2] * (i1b - 3.0) ** 2
    if not with_tangent:
        return energy
    fh = -(4.0 / 3.0) * w1 * alpha / det
    eh = -(4.0 / 3.0) * w2 * beta / det
    hh = ((10.0 / 9.0) * w1 * i1b + (28.0 / 9.0) * w2 * i2b) / (det * det)
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
            pair += 1
    add_curl(f, -((2.0 / 3.0) * w1 * i1b + (4.0 / 3.0) * w2 * i2b) / det, tangent)
    return energy


@njit(cache=True)
def push(f: Any, s: Any, d: Any, stress: Any, tangent: Any, with_tangent: Any) -> None:
    """Turn the second Piola stress ``S`` and ``D = ∂S/∂E`` into those of `passive`.

    ``P = F S`` and ``∂P_iK/∂F_jL = δ_ij S_KL + F_iM D_MKNL F_jN``.
    """
    for i in range(3):
        for k in range(3):
            stress[i, k] = f[i, 0] * s[0, k] + f[i, 1] * s[1, k] + f[i, 2] * s[2, k]
    if not with_tangent:
        return
    pair = 0
    for i in range(3):
        for j in range(i, 3):
            for k in range(3):
                for m in range(3):
                    value = s[k, m] if i == j else 0.0
                    for a in range(3):
                        for b in range(3):
                            value += f[i, a] * d[a, k, b, m] * f[j, b]
                    tangent[pair, k, m] = value
            pair += 1


@njit(cache=True)
def cauchy_green(f: Any, cg: Any) -> Any:
    """Write ``C = Fᵀ F`` into ``cg`` and return ``tr C`` and ``tr C²``."""
    trace = 0.0
    square = 0.0
    for i in range(3):
        for j in range(3):
            cg[i, j] = f[0, i] * f[0, j] + f[1, i] * f[1, j] + f[2, i] * f[2, j]
            square += cg[i, j] * cg[i, j]
        trace += cg[i, i]
    return trace, square


@njit(cache=True)
def plain(f: Any, c: Any, stress: Any, tangent: Any, with_tangent: Any) -> Any:
    """Evaluate ``c10 (I1 - 3) + c01 (I2 - 3)``, see `passive`."""
    cg = np.empty((3, 3))
    i1, square = cauchy_green(f, cg)
    i2 = 0.5 * (i1 * i1 - square)
    s = np.empty((3, 3))
    d = np.empty((3, 3, 3, 3))
    for a in range(3):
        for b in range(3):
            s[a, b] = -2.0 * c[1] * cg[a, b]
            if a == b:
                s[a, b] += 2.0 * c[0] + 2.0 * c[1] * i1
            for k in range(3):
                for m in range(3):
                    value = 2.0 if a == b and k == m else 0.0
                    if a == k and b == m:
                        value -= 1.0
                    if a == m and b == k:
                        value -= 1.0
                    d[a, b, k, m] = 2.0 * c[1] * value
    push(f, s, d, stress, tangent, with_tangent)
    return c[0] * (i1 - 3.0) + c[1] * (i2 - 3.0)


@njit(cache=True)
def guccione(f: Any, c: Any, stress: Any, tangent: Any, with_tangent: Any) -> Any:
    """Evaluate ``C/2 (exp Q - 1)`` of Guccione et al. (1991), see `passive`.

    With the Green strain ``E``, the fibre ``f``, ``a = f·E f`` and ``b = |E f|²``, the form
    ``Q = bf E_ff² + bt (E_ss² + E_nn² + 2 E_sn²) + 2 bfs (E_fs² + E_fn²)`` is
    ``(bf + bt - 2 bfs) a² + 2 (bfs - bt) b + bt tr E²``. `c` holds ``C, bf, bt, bfs, f``.
    """
    scale, bf, bt, bfs = c[0], c[1], c[2], c[3]
    n = c[4:7]
    strain = np.empty((3, 3))
    cauchy_green(f, strain)
    along = np.empty(3)
    a = 0.0
    b = 0.0
    square = 0.0
    for i in range(3):
        strain[i, i] -= 1.0
        for j in range(3):
            strain[i, j] *= 0.5
            square += strain[i, j] * strain[i, j]
        along[i] = strain[i, 0] * n[0] + strain[i, 1] * n[1] + strain[i, 2] * n[2]
        a += n[i] * along[i]
        b += along[i] * along[i]
    ca, cb = bf + bt - 2.0 * bfs, 2.0 * (bfs - bt)
    form = ca * a * a + cb * b + bt * square
    factor = 0.5 * scale * np.exp(form)
    first = np.empty((3, 3))
    s = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            first[i, j] = (
                2.0 * ca * a * n[i] * n[j]
                + cb * (n[i] * along[j] + along[i] * n[j])
                + 2.0 * bt * strain[i, j]
            )
            s[i, j] = factor * first[i, j]
    d = np.empty((3, 3, 3, 3))
    if with_tangent:
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    for m in range(3):
                        value = first[i, j] * first[k, m] + 2.0 * ca * n[i] * n[j] * n[k] * n[m]
                        # The strain is symmetric: halves of both orders of its indices.
                        if i == k:
                            value += 0.5 * cb * n[j] * n[m]
                            if j == m:
                                value += bt
                        if i == m:
                            value += 0.5 * cb * n[j] * n[k]
                            if j == k:
                                value += bt
                        if j == k:
                            value += 0.5 * cb * n[i] * n[m]
                        if j == m:
                            value += 0.5 * cb * n[i] * n[k]
                        d[i, j, k, m] = factor * value
    push(f, s, d, stress, tangent, with_tangent)
    return 0.5 * scale * (np.exp(form) - 1.0)


@njit(cache=True)
def square_acosh(y: Any) -> Any:
    """Return ``acosh² y`` and its first two derivatives, smooth through ``y = 1``."""
    s = y - 1.0
    if s < 3e-3:
        return (
            s * (2.0 + s * (-1.0 / 3.0 + s * (4.0 / 45.0 + s * (-1.0 / 35.0 + s * 16.0 / 1575.0)))),
            2.0 + s * (-2.0 / 3.0 + s * (4.0 / 15.0 + s * (-4.0 / 35.0 + s * 16.0 / 315.0))),
            -2.0 / 3.0 + s * (8.0 / 15.0 + s * (-12.0 / 35.0 + s * 64.0 / 315.0)),
        )
    arc = np.arccosh(y)
    root = y * y - 1.0
    slope = 2.0 * arc / np.sqrt(root)
    return arc * arc, slope, (2.0 - y * slope) / root


@njit(cache=True)
def muscle_curvature(
    c: Any,
    det: Any,
    i1: Any,
    i4: Any,
    i5: Any,
    y: Any,
    shear: Any,
    tension: Any,
    dy: Any,
    dl: Any,
    stretch: Any,
) -> Any:
    """Return the second derivatives (4, 4) of the energy of `muscle` by I1, I4, I5 and J.

    Parameters
    ----------
    c : (13,) array
        As in `muscle`.
    det, i1, i4, i5 : float
        The invariants.
    y, stretch : float
        ``cosh B2`` and ``λ̄``.
    shear, tension : (float, float)
        First and second derivative of ``B2²`` by ``y``, and of ``ψ`` by ``λ̄``.
    dy, dl : (4,) arrays
        Derivatives of ``y`` and ``λ̄`` by the invariants.
    """
    g1, g2 = shear
    psi1, psi2 = tension
    root = np.sqrt(i4)
    ddy = np.zeros((4, 4))
    ddy[0, 1] = 1.0 / (4.0 * det * root)
    ddy[1, 1] = -i1 / (4.0 * det * root**3) - dy[1] / (2.0 * i4) + y / (2.0 * i4**2)
    ddy[1, 2] = 1.0 / (4.0 * det * root**3)
    for a in range(3):
        ddy[a, 3] = -dy[a] / det
    ddy[3, 3] = 2.0 * y / det**2
    ddl = np.zeros((4, 4))
    ddl[1, 1] = -stretch / (4.0 * i4**2)
    ddl[1, 3] = -stretch / (6.0 * i4 * det)
    ddl[3, 3] = 4.0 * stretch / (9.0 * det**2)
    ww = np.empty((4, 4))
    for a in range(4):
        for b in range(a, 4):
            ww[a, b] = (
                c[1] * (g1 * ddy[a, b] + g2 * dy[a] * dy[b])
                + psi1 * ddl[a, b]
                + psi2 * dl[a] * dl[b]
            )
    ww[1, 1] += 6.0 * c[0] * i5 / i4**4
    ww[1, 2] -= 2.0 * c[0] / i4**3
    for a in range(4):
        for b in range(a):
            ww[a, b] = ww[b, a]
    return ww


@njit(cache=True)
def muscle_moduli(n: Any, det: Any, w: Any, ww: Any, slopes: Any, inverse: Any, d: Any) -> None:
    """Write ``D = ∂S/∂E`` of `muscle` into ``d``.

    Parameters
    ----------
    n : (3,) array
        The fibre.
    det : float
        ``J``.
    w, ww : (4,), (4, 4) arrays
        First and second derivatives of the energy by I1, I4, I5 and J.
    slopes : (4, 3, 3) array
        Derivatives of the invariants by ``C``.
    inverse : (3, 3) array
        ``C⁻¹``.
    d : (3, 3, 3, 3) array, written
    """
    for i in range(3):
        for j in range(3):
            for k in range(3):
                for m in range(3):
                    value = 0.0
                    for a in range(4):
                        for b in range(4):
                            value += ww[a, b] * slopes[a, i, j] * slopes[b, k, m]
                    mixed = 0.0
                    if j == k:
                        mixed += n[i] * n[m]
                    if j == m:
                        mixed += n[i] * n[k]
                    if i == k:
                        mixed += n[j] * n[m]
                    if i == m:
                        mixed += n[j] * n[k]
                    value += 0.5 * w[2] * mixed
                    value += (
                        0.25
                        * w[3]
                        * det
                        * (
                            inverse[i, j] * inverse[k, m]
                            - inverse[i, k] * inverse[j, m]
                            - inverse[i, m] * inverse[j, k]
                        )
                    )
                    d[i, j, k, m] = 4.0 * value


@njit(cache=True)
def muscle(f: Any, h: Any, det: Any, c: Any, stress: Any, tangent: Any, with_tangent: Any) -> Any:
    """Evaluate the muscle of Blemker et al. (2005), matrix and fibres in one, see `passive`.

    ``G1 B1² + G2 B2² + ψ(λ̄)`` with the shears along and across the fibre ``f``,
    ``B1² = I5/I4² - 1`` and ``cosh B2 = (I1 I4 - I5) / (2 J √I4)``, and the potential ψ of
    `fibre` at the isochoric stretch ``λ̄ = J^(-1/3) √I4``. `c` holds ``G1, G2``, activation,
    slack, the array of the `FibreLaw` and ``f``.
    """
    n = c[10:13]
    cg = np.empty((3, 3))
    i1, _ = cauchy_green(f, cg)
    along = np.empty(3)
    i4 = 0.0
    i5 = 0.0
    for i in range(3):
        along[i] = cg[i, 0] * n[0] + cg[i, 1] * n[1] + cg[i, 2] * n[2]
        i4 += n[i] * along[i]
        i5 += along[i] * along[i]
    root = np.sqrt(i4)
    y = (i1 * i4 - i5) / (2.0 * det * root)
    g0, g1, g2 = square_acosh(y)
    stretch = root * det ** (-1.0 / 3.0)
    psi0, psi1, psi2 = fibre(stretch, c[2], c[3], c[4:10])
    energy = c[0] * (i5 / i4**2 - 1.0) + c[1] * g0 + psi0

    # Derivatives by the invariants I1, I4, I5 and J.
    dy = np.empty(4)
    dy[0] = root / (2.0 * det)
    dy[1] = i1 / (2.0 * det * root) - y / (2.0 * i4)
    dy[2] = -1.0 / (2.0 * det * root)
    dy[3] = -y / det
    dl = np.zeros(4)
    dl[1] = stretch / (2.0 * i4)
    dl[3] = -stretch / (3.0 * det)
    w = np.empty(4)
    for a in range(4):
        w[a] = c[1] * g1 * dy[a] + psi1 * dl[a]
    w[1] -= 2.0 * c[0] * i5 / i4**3
    w[2] += c[0] / i4**2
    inverse = np.empty((3, 3))
    slopes = np.zeros((4, 3, 3))
    s = np.empty((3, 3))
    for i in range(3):
        slopes[0, i, i] = 1.0
        for j in range(3):
            product = h[0, i] * h[0, j] + h[1, i] * h[1, j] + h[2, i] * h[2, j]
            inverse[i, j] = product / det**2
            slopes[1, i, j] = n[i] * n[j]
            slopes[2, i, j] = n[i] * along[j] + along[i] * n[j]
            slopes[3, i, j] = 0.5 * det * inverse[i, j]
            s[i, j] = 0.0
            for a in range(4):
                s[i, j] += 2.0 * w[a] * slopes[a, i, j]
    d = np.zeros((3, 3, 3, 3))
    if with_tangent:
        ww = muscle_curvature(c, det, i1, i4, i5, y, (g1, g2), (psi1, psi2), dy, dl, stretch)
        muscle_moduli(n, det, w, ww, slopes, inverse, d)
    push(f, s, d, stress, tangent, with_tangent)
    return energy


@njit(cache=True)
def volumetric(volume: Any, det: Any, kappa: Any, p: Any) -> Any:
    """Evaluate the part of the energy that depends on ``J`` alone.

    Returns
    -------
    energy : float
    q, slope : float
        First and second derivative of the energy by ``J``.
    excess : float
        What the constraint makes zero on average.
    share : float
        ``∂q/∂p``.
    """
    if volume == MULTIPLIER:
        excess = det - 1.0
        return (0.5 * kappa * excess + p) * excess, kappa * excess + p, kappa, excess, 1.0
    log = np.log(det)
    if volume == INVERSE:
        # The residual of the pressure is not the derivative of this energy, which is 2 ln J.
        return (
            2.0 * p * log,
            2.0 * p / det,
            -2.0 * p / det**2,
            2.0 * (det - 1.0),
            2.0 / det,
        )
    return 0.5 * kappa * log**2, kappa * log / det, kappa * (1.0 - log) / det**2, 0.0, 0.0


@njit(cache=True)
def passive(
    f: Any,
    law: Any,
    c: Any,
    volume: Any,
    kappa: Any,
    p: Any,
    h: Any,
    stress: Any,
    tangent: Any,
    with_tangent: Any,
) -> Any:
    """Evaluate the passive energy and its derivatives at one point.

    Parameters
    ----------
    f : (3, 3) array
        Deformation gradient with ``J > 0``.
    law : int or None
        `laws.Law`; None stands for `Law.ISOCHORIC`.
    c : (n,) array
        Coefficients of the law.
    volume : int
        `laws.Volume`.
    kappa, p : float
        Volumetric stiffness and pressure in kPa.
    h : (3, 3) array, written
        Cofactor of ``f``.
    stress : (3, 3) array, written
        First Piola stress ``P_iK = ∂W/∂F_iK``.
    tangent : (6, 3, 3) array, written when ``with_tangent``
        ``[pair (i, j), K, L] = ∂P_iK/∂F_jL``.

    Returns
    -------
    energy, J : float
    excess, share : float
        As in `volumetric`.
    """
    det = cofactor(f, h)
    # For None, Numba does not even compile the other laws.
    if law is None:
        energy = isochoric(f, h, det, c, stress, tangent, with_tangent)
    elif law == PLAIN:
        energy = plain(f, c, stress, tangent, with_tangent)
    elif law == GUCCIONE:
        energy = guccione(f, c, stress, tangent, with_tangent)
    else:
        energy = muscle(f, h, det, c, stress, tangent, with_tangent)
    more, q, slope, excess, share = volumetric(volume, det, kappa, p)
    for i in range(3):
        for k in range(3):
            stress[i, k] += q * h[i, k]
    if with_tangent:
        pair = 0
        for i in range(3):
            for j in range(i, 3):
                for k in range(3):
                    for m in range(3):
                        tangent[pair, k, m] += slope * h[i, k] * h[j, m]
                pair += 1
        add_curl(f, q, tangent)
    return energy + more, det, excess, share


@njit(cache=True)
def gathered(parameters: Any, params: Any) -> Any:
    """Return the parameters (m, 3) of an element's functions."""
    x = np.empty((len(params), 3))
    for a in range(len(params)):
        for i in range(3):
            x[a, i] = parameters[params[a], i]
    return x


@njit(cache=True)
def stiffen(g: Any, weights: Any, moduli: Any, tangent: Any) -> None:
    """Write the tangent (6, m, m) of an element: ``Σ_q w ∂N_a/∂X_K D_KL ∂N_b/∂X_L``.

    Parameters
    ----------
    g : (3 q, m) array
        Gradients of the functions.
    weights : (q,) array
    moduli : (q, 6, 3, 3) array
        As `passive` writes them.
    tangent : (6, m, m) array, written
    """
    m = g.shape[1]
    scaled = np.empty((3 * len(weights), m))
    for pair in range(6):
        for q in range(len(weights)):
            w = weights[q]
            for k in range(3):
                t0 = w * moduli[q, pair, k, 0]
                t1 = w * moduli[q, pair, k, 1]
                t2 = w * moduli[q, pair, k, 2]
                for a in range(m):
                    scaled[3 * q + k, a] = (
                        t0 * g[3 * q, a] + t1 * g[3 * q + 1, a] + t2 * g[3 * q + 2, a]
                    )
        np.dot(g.T, scaled, tangent[pair])


@njit(cache=True)
def couple(g: Any, cofactors: Any, psi: Any, coupling: Any) -> None:
    """Write how the pressures of an element push: ``Σ_q w ∂J/∂F_iK ∂N_a/∂X_K ψ_s``.

    Parameters
    ----------
    g : (3 q, m) array
        Gradients of the functions.
    cofactors : (3, q, 3) array
        ``[i, q, K]``, times the weights.
    psi : (q, 8) array
        Functions of the pressure.
    coupling : (3, m, 8) array, written
    """
    m = g.shape[1]
    n_points = len(psi)
    normal = np.empty((n_points, m))
    for i in range(3):
        for q in range(n_points):
            h0 = cofactors[i, q, 0]
            h1 = cofactors[i, q, 1]
            h2 = cofactors[i, q, 2]
            for a in range(m):
                normal[q, a] = h0 * g[3 * q, a] + h1 * g[3 * q + 1, a] + h2 * g[3 * q + 2, a]
        np.dot(normal.T, psi, coupling[i])


@njit(cache=True, parallel=True)
def bulk(
    parameters: Any,
    pressures: Any,
    params: Any,
    vertices: Any,
    gradients: Any,
    psi: Any,
    weights: Any,
    law: Any,
    coefficients: Any,
    volume: Any,
    kappa: Any,
    with_tangent: Any,
    residual: Any,
    tangent: Any,
    coupling: Any,
    pressure_residual: Any,
    volume_ratio: Any,
) -> Any:
    """Integrate the passive tissue and the volume constraint over every element.

    Parameters
    ----------
    parameters : (n_params, 3) array
        Deformed parameters.
    pressures : (n_vertices,) array
    params : (e, m) int array
        Global parameter of each function of an element.
    vertices : (e, 8) or (e, 0) int array
        Pressure of each corner; none where volume is a matter of energy alone.
    gradients : (e, 3 q, m) array
        ``[e, 3 g + K, a] = ∂N_a/∂X_K`` at Gauss point ``g``.
    psi : (q, 8) or (q, 0) array
        Trilinear functions at the Gauss points.
    weights : (e, q) array
        Reference volumes in mm³.
    law, volume : int
        As in `passive`.
    coefficients : (e, q, n) array
    kappa : float
    residual, tangent, coupling, pressure_residual : arrays, overwritten
    volume_ratio : (e, q) array, overwritten
        ``J``. Where it is not positive nothing is integrated.

    Returns
    -------
    float
        Energy in mN mm.
    """
    n_elements = len(params)
    n_points = weights.shape[1]
    n_corners = vertices.shape[1]
    energies = np.zeros(n_elements)
    for e in prange(n_elements):
        g = gradients[e]
        p = np.empty(n_corners)
        for s in range(n_corners):
            p[s] = pressures[vertices[e, s]]
        deformation = np.dot(g, gathered(parameters, params[e]))
        stresses = np.zeros((3 * n_points, 3))
        stress = np.empty((3, 3))
        f = np.empty((3, 3))
        h = np.empty((3, 3))
        moduli = np.zeros((n_points, 6, 3, 3))
        cofactors = np.zeros((3, n_points, 3))
        excess = np.zeros(n_points)
        for q in range(n_points):
            w = weights[e, q]
            for k in range(3):
                for i in range(3):
                    f[i, k] = deformation[3 * q + k, i]
            det = cofactor(f, h)
            volume_ratio[e, q] = det
            if not det > 1e-6:
                continue
            pressure = 0.0
            for s in range(n_corners):
                pressure += psi[q, s] * p[s]
            density, det, rise, share = passive(
                f,
                law,
                coefficients[e, q],
                volume,
                kappa,
                pressure,
                h,
                stress,
                moduli[q],
                with_tangent,
            )
            energies[e] += w * density
            excess[q] = w * rise
            for k in range(3):
                for i in range(3):
                    stresses[3 * q + k, i] = w * stress[i, k]
                    cofactors[i, q, k] = w * share * h[i, k]
        residual[e] = np.dot(g.T, stresses)
        if n_corners:
            pressure_residual[e] = np.dot(psi.T, excess)
        if with_tangent:
            stiffen(g, weights[e], moduli, tangent[e])
            if n_corners:
                couple(g, cofactors, psi, coupling[e])
    return energies.sum()


@njit(cache=True)
def _evaluated(e: Any, parameters: Any, params: Any, starts: Any, functions: Any, out: Any) -> None:
    first, last = starts[e], starts[e + 1]
    if first < last:
        out[first:last] = np.dot(functions[first:last], gathered(parameters, params[e]))


@njit(cache=True, parallel=True)
def evaluate(parameters: Any, params: Any, starts: Any, functions: Any) -> Any:
    """Evaluate vector functionals ``v = Σ_a s_a x_a`` at points sorted by element; (n, 3)."""
    out = np.empty((len(functions), 3))
    if len(functions) < FEW:
        for e in range(len(starts) - 1):
            _evaluated(e, parameters, params, starts, functions, out)
    else:
        for e in prange(len(starts) - 1):
            _evaluated(e, parameters, params, starts, functions, out)
    return out


@njit(cache=True)
def _add_force(e: Any, m: Any, starts: Any, functions: Any, forces: Any, residual: Any) -> None:
    first, last = starts[e], starts[e + 1]
    if first == last:
        return
    width = forces.shape[1]
    force = np.zeros((3, m))
    for row in range(first, last):
        f = forces[row // width, row % width]
        if f[0] == 0.0 and f[1] == 0.0 and f[2] == 0.0:
            continue
        for i in range(3):
            for a in range(m):
                force[i, a] += functions[row, a] * f[i]
    residual[e, :m] += force.T


@njit(cache=True, parallel=True)
def add_forces(counts: Any, starts: Any, functions: Any, forces: Any, residual: Any) -> None:
    """Add the forces of points to their elements.

    Parameters
    ----------
    counts : (e,) int array
        Functions of each element, before the padding.
    starts : (e + 1,) int array
        Rows of element ``e`` are ``starts[e] : starts[e + 1]``.
    functions : (n k, m) array
        The ``k`` functionals of a point one after the other.
    forces : (n, k, 3) array
        Derivative of the energy by the functionals' values.
    residual : (e, m, 3) array, added to
    """
    if len(functions) < FEW:
        for e in range(len(counts)):
            _add_force(e, counts[e], starts, functions, forces, residual)
    else:
        for e in prange(len(counts)):
            _add_force(e, counts[e], starts, functions, forces, residual)


@njit(cache=True, parallel=True)
def add_stiffness(
    counts: Any,
    starts: Any,
    functions: Any,
    stiffness: Any,
    tangent: Any,
    stiff: Any,
) -> None:
    """Add the stiffness of points to their elements.

    Parameters
    ----------
    counts, starts, functions
        See `add_forces`.
    stiffness : (n, 6, k, k) array
        Second derivatives for the six component pairs.
    tangent : array, added to
    stiff : (e,) bool array
        Which elements have a tangent already; others get theirs overwritten.
    """
    width = stiffness.shape[2]
    for e in prange(len(starts) - 1):
        m = counts[e]
        first, last = starts[e] // width, starts[e + 1] // width
        chosen = np.empty(last - first, np.int64)
        n = 0
        for point in range(first, last):
            acts = False
            for i in range(6):
                for c in range(width):
                    for d in range(width):
                        acts = acts or stiffness[point, i, c, d] != 0.0
            if acts:
                chosen[n] = point
                n += 1
        if n == 0:
            continue
        s = np.empty((n * width, m))
        for k in range(n):
            for c in range(width):
                s[k * width + c] = functions[chosen[k] * width + c, :m]
        scaled = np.empty((n * width, m))
        block = np.empty((m, m))
        for pair in range(6):
            for k in range(n):
                for c in range(width):
                    row = k * width + c
                    factor = stiffness[chosen[k], pair, c, 0]
                    for a in range(m):
                        scaled[row, a] = factor * s[k * width, a]
                    for d in range(1, width):
                        factor = stiffness[chosen[k], pair, c, d]
                        for a in range(m):
                            scaled[row, a] += factor * s[k * width + d, a]
            np.dot(s.T, scaled, block)
            for a in range(m):
                for b in range(m):
                    before = tangent[e, pair, a, b] if stiff[e] else 0.0
                    tangent[e, pair, a, b] = before + block[a, b]
        stiff[e] = True


@njit(cache=True, parallel=True)
def fibres(
    vectors: Any,
    weights: Any,
    muscles: Any,
    activations: Any,
    slacks: Any,
    law: Any,
    convex: Any,
    energies: Any,
    forces: Any,
    stiffness: Any,
) -> None:
    """Evaluate the fibre potential at points with current fibre vectors ``F f0`` (n, 3).

    ``energies`` (n,), ``forces`` (n, 3) and ``stiffness`` (n, 6) are overwritten.
    """
    for point in prange(len(weights)):
        v0, v1, v2 = vectors[point, 0], vectors[point, 1], vectors[point, 2]
        length = np.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
        muscle = muscles[point]
        w = weights[point]
        energy, force, slope = fibre(length, activations[muscle], slacks[muscle], law)
        if convex:
            slope = max(slope, 0.0)
        energies[point] = w * energy
        geometric = w * force / length
        normal = (w * slope - geometric) / (length * length)
        forces[point, 0] = geometric * v0
        forces[point, 1] = geometric * v1
        forces[point, 2] = geometric * v2
        stiffness[point, 0] = geometric + normal * v0 * v0
        stiffness[point, 1] = normal * v0 * v1
        stiffness[point, 2] = normal * v0 * v2
        stiffness[point, 3] = geometric + normal * v1 * v1
        stiffness[point, 4] = normal * v1 * v2
        stiffness[point, 5] = geometric + normal * v2 * v2


@njit(cache=True, parallel=True)
def gather(
    tangent: Any,
    coupling: Any,
    stiff: Any,
    params: Any,
    counts: Any,
    vertices: Any,
    first: Any,
    hosts: Any,
    places: Any,
    equations: Any,
    pressures: Any,
    indptr: Any,
    indices: Any,
    out: Any,
) -> None:
    """Add the element tangents of one pattern to the upper triangle of the matrix.

    Parameters
    ----------
    tangent : (e, 6, m, m) array
    coupling : (e, 3, m, v) array
    stiff : (e,) bool array
        Which elements have a tangent.
    params, counts, vertices : (e, m), (e,), (e, v) int arrays
        Of the pattern.
    first : (n_params + 1,) int array
        Where the elements of each parameter begin in ``hosts``.
    hosts, places : (k,) int arrays
        An element of a parameter, and the parameter's place from 1 among those of the element.
    equations : (n_params, 3) int array
        Row of each component, one after the other, -1 where there is none.
    pressures : (n_pressures,) int array
        The same for the pressures, beyond all the others.
    indptr, indices : (n + 1,), (entries,) int arrays
        Where each row begins, and the columns, ascending in a row.
    out : (entries,) array, added to
    """
    n = len(indptr) - 1
    v = vertices.shape[1]
    for a in prange(len(equations)):
        r0, r1, r2 = equations[a]
        head = r0 if r0 >= 0 else r1 if r1 >= 0 else r2
        if head < 0 or first[a] == first[a + 1]:
            continue
        # A parameter's rows have the columns of its first one from their own diagonals on.
        place = np.empty(n, np.int32)
        for k in range(indptr[head], indptr[head + 1]):
            place[indices[k]] = k - indptr[head]
        least = (
            r0 - head if r0 >= 0 else n,
            r1 - head if r1 >= 0 else n,
            r2 - head if r2 >= 0 else n,
        )
        start = (indptr[r0] - least[0], indptr[r1] - least[1], indptr[r2] - least[2])
        for t in range(first[a], first[a + 1]):
            e, own = hosts[t], places[t] - 1
            if not stiff[e]:
                continue
            block = tangent[e]
            for b in range(own, counts[e]):
                for j in range(3):
                    column = equations[params[e, b], j]
                    if column < 0:
                        continue
                    k = place[column]
                    for i in range(3):
                        if k >= least[i]:
                            # Of the blocks 00, 01, 02, 11, 12, 22.
                            pair = i + j + min(i, j, 1)
                            value = block[pair, own, b] if i <= j else block[pair, b, own]
                            out[start[i] + k] += value
            for s in range(v):
                column = pressures[vertices[e, s]]
                if column >= 0:
                    for i in range(3):
                        if least[i] < n:
                            out[start[i] + place[column]] += coupling[e, i, own, s]
