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


@njit(cache=True, parallel=True)
def bulk(
    parameters: Any,
    pressures: Any,
    params: Any,
    vertices: Any,
    gradients: Any,
    psi: Any,
    weights: Any,
    coefficients: Any,
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
    vertices : (e, 8) int array
        Pressure of each corner.
    gradients : (e, 3 q, m) array
        ``[e, 3 g + K, a] = ∂N_a/∂X_K`` at Gauss point ``g``.
    psi : (q, 8) array
        Trilinear functions at the Gauss points.
    weights : (e, q) array
        Reference volumes in mm³.
    coefficients : (e, q, 3) array
    kappa : float
    residual, tangent, coupling, pressure_residual : arrays, overwritten
    volume_ratio : (e, q) array, overwritten
        ``J``. Where it is not positive nothing is integrated.

    Returns
    -------
    float
        Energy in mN mm.
    """
    n_elements, m = params.shape
    n_points = weights.shape[1]
    energies = np.zeros(n_elements)
    for e in prange(n_elements):
        g = gradients[e]
        x = np.empty((m, 3))
        for a in range(m):
            for i in range(3):
                x[a, i] = parameters[params[e, a], i]
        p = np.empty(8)
        for s in range(8):
            p[s] = pressures[vertices[e, s]]
        deformation = np.dot(g, x)
        stresses = np.zeros((3 * n_points, 3))
        stress = np.empty((3, 3))
        f = np.empty((3, 3))
        moduli = np.zeros((n_points, 6, 3, 3))
        cofactors = np.zeros((3, n_points, 3))
        excess = np.zeros(n_points)
        for q in range(n_points):
            w = weights[e, q]
            for k in range(3):
                for i in range(3):
                    f[i, k] = deformation[3 * q + k, i]
            h0 = f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1]
            h1 = f[1, 2] * f[2, 0] - f[1, 0] * f[2, 2]
            h2 = f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0]
            det = f[0, 0] * h0 + f[0, 1] * h1 + f[0, 2] * h2
            volume_ratio[e, q] = det
            if not det > 1e-6:
                continue
            pressure = 0.0
            for s in range(8):
                pressure += psi[q, s] * p[s]
            density, det = passive(
                f, coefficients[e, q], kappa, pressure, stress, moduli[q], with_tangent
            )
            energies[e] += w * density
            excess[q] = w * (det - 1.0)
            for k in range(3):
                for i in range(3):
                    stresses[3 * q + k, i] = w * stress[i, k]
            for i in range(3):
                a = (i + 1) % 3
                b = (i + 2) % 3
                for k in range(3):
                    c = (k + 1) % 3
                    d = (k + 2) % 3
                    cofactors[i, q, k] = w * (f[a, c] * f[b, d] - f[a, d] * f[b, c])
        residual[e] = np.dot(g.T, stresses)
        pressure_residual[e] = np.dot(psi.T, excess)
        if with_tangent:
            scaled = np.empty((3 * n_points, m))
            for pair in range(6):
                for q in range(n_points):
                    w = weights[e, q]
                    for k in range(3):
                        t0 = w * moduli[q, pair, k, 0]
                        t1 = w * moduli[q, pair, k, 1]
                        t2 = w * moduli[q, pair, k, 2]
                        for a in range(m):
                            scaled[3 * q + k, a] = (
                                t0 * g[3 * q, a] + t1 * g[3 * q + 1, a] + t2 * g[3 * q + 2, a]
                            )
                np.dot(g.T, scaled, tangent[e, pair])
            normal = np.empty((n_points, m))
            for i in range(3):
                for q in range(n_points):
                    h0 = cofactors[i, q, 0]
                    h1 = cofactors[i, q, 1]
                    h2 = cofactors[i, q, 2]
                    for a in range(m):
                        normal[q, a] = (
                            h0 * g[3 * q, a] + h1 * g[3 * q + 1, a] + h2 * g[3 * q + 2, a]
                        )
                np.dot(normal.T, psi, coupling[e, i])
    return energies.sum()


@njit(cache=True, parallel=True)
def evaluate(parameters: Any, params: Any, starts: Any, functions: Any) -> Any:
    """Evaluate vector functionals ``v = Σ_a s_a x_a`` at points sorted by element; (n, 3)."""
    n, m = functions.shape
    out = np.empty((n, 3))
    for e in prange(len(starts) - 1):
        if starts[e] == starts[e + 1]:
            continue
        x = np.empty((m, 3))
        for a in range(m):
            for i in range(3):
                x[a, i] = parameters[params[e, a], i]
        out[starts[e] : starts[e + 1]] = np.dot(functions[starts[e] : starts[e + 1]], x)
    return out


@njit(cache=True, parallel=True)
def scatter_points(
    starts: Any,
    functions: Any,
    forces: Any,
    stiffness: Any,
    with_tangent: Any,
    residual: Any,
    tangent: Any,
) -> None:
    """Add point contributions to their elements.

    Parameters
    ----------
    starts : (e + 1,) int array
        Points of element ``e`` are ``starts[e] : starts[e + 1]``.
    functions : (n, m) array
    forces : (n, 3) array
        Derivative of the energy by the functional's value.
    stiffness : (n, 6) array
        Second derivatives for the six component pairs.
    residual, tangent : arrays, added to
    """
    m = functions.shape[1]
    for e in prange(len(starts) - 1):
        chosen = np.empty(starts[e + 1] - starts[e], np.int64)
        n = 0
        for point in range(starts[e], starts[e + 1]):
            acts = False
            for i in range(3):
                acts = acts or forces[point, i] != 0.0
            for i in range(6):
                acts = acts or stiffness[point, i] != 0.0
            if acts:
                chosen[n] = point
                n += 1
        if n == 0:
            continue
        s = np.empty((n, m))
        force = np.empty((n, 3))
        for row in range(n):
            s[row] = functions[chosen[row]]
            force[row] = forces[chosen[row]]
        residual[e] += np.dot(s.T, force)
        if with_tangent:
            scaled = np.empty((n, m))
            block = np.empty((m, m))
            for pair in range(6):
                for row in range(n):
                    c = stiffness[chosen[row], pair]
                    for a in range(m):
                        scaled[row, a] = c * s[row, a]
                np.dot(s.T, scaled, block)
                for a in range(m):
                    for b in range(m):
                        tangent[e, pair, a, b] += block[a, b]


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
def gather(starts: Any, sources: Any, values: Any, out: Any) -> None:
    """Sum ``values[sources[starts[k] : starts[k + 1]]]`` into ``out[k]``."""
    for k in prange(len(starts) - 1):
        total = 0.0
        for s in range(starts[k], starts[k + 1]):
            total += values[sources[s]]
        out[k] = total
