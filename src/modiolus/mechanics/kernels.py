"""Compiled element loops.

Residuals and tangents are collected by element. With ``m`` the greatest number of global
functions on an element of a pattern, an element has a residual ``(m, 3)``, a tangent of
six ``(m, m)`` blocks for the component pairs ``(0,0) (0,1) (0,2) (1,1) (1,2) (2,2)`` and a
coupling of three ``(m, 8)`` blocks with its pressures. Padded places carry zero functions.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange

from .laws import fibre, passive


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
def evaluate(parameters: Any, params: Any, hosts: Any, functions: Any) -> Any:
    """Evaluate vector functionals ``v = Σ_a s_a x_a`` at points; (n, 3)."""
    n, m = functions.shape
    out = np.zeros((n, 3))
    for point in prange(n):
        e = hosts[point]
        for a in range(m):
            s = functions[point, a]
            for i in range(3):
                out[point, i] += s * parameters[params[e, a], i]
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
    """Add point contributions to their host elements.

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
        first, last = starts[e], starts[e + 1]
        active = 0
        for point in range(first, last):
            moved = False
            for i in range(3):
                moved = moved or forces[point, i] != 0.0
            if with_tangent:
                for i in range(6):
                    moved = moved or stiffness[point, i] != 0.0
            if moved:
                active += 1
        if active == 0:
            continue
        s = np.empty((active, m))
        chosen = np.empty(active, np.int64)
        active = 0
        for point in range(first, last):
            moved = False
            for i in range(3):
                moved = moved or forces[point, i] != 0.0
            if with_tangent:
                for i in range(6):
                    moved = moved or stiffness[point, i] != 0.0
            if moved:
                chosen[active] = point
                for a in range(m):
                    s[active, a] = functions[point, a]
                active += 1
        for row in range(active):
            for a in range(m):
                for i in range(3):
                    residual[e, a, i] += s[row, a] * forces[chosen[row], i]
        if with_tangent:
            scaled = np.empty((active, m))
            block = np.empty((m, m))
            for pair in range(6):
                for row in range(active):
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
