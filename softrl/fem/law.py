"""Hyperelastic laws, compiled: each fills energy, stress and tangent of a deformation gradient."""

import numba as nb
import numpy as np

ENERGY, STRESS, TANGENT = 0, 1, 2  # orders: what a kernel must fill
VISCOUS = 3  # the tangent alone, of a stress that has no energy
POLAR_ITERATIONS, POLAR_TOLERANCE = 40, 1e-15

_vector = nb.types.Array(nb.float64, 1, "C")
_matrix = nb.types.Array(nb.float64, 2, "C")
# law(parameters, F (3, 3), P (3, 3) out, A (9, 9) out, order) -> energy density, J/m^3; inf where the law ends
LAW = nb.float64(_vector, _matrix, _matrix, _matrix, nb.int64)


@nb.njit(cache=True)
def cofactor_of(f: np.ndarray, c: np.ndarray) -> float:
    """Fill ``c`` with the cofactor of ``f`` and return the determinant."""
    for i in range(3):
        i1, i2 = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            j1, j2 = (j + 1) % 3, (j + 2) % 3
            c[i, j] = f[i1, j1] * f[i2, j2] - f[i1, j2] * f[i2, j1]
    return f[0, 0] * c[0, 0] + f[0, 1] * c[0, 1] + f[0, 2] * c[0, 2]


@nb.njit(cache=True)
def _squared_norm(f: np.ndarray) -> float:
    """Return I1 = F:F."""
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += f[i, j] * f[i, j]
    return total


@nb.njit(cache=True)
def _second_invariant(f: np.ndarray, i1: float) -> float:
    """Return I2 = (I1^2 - |F'F|^2) / 2."""
    total = 0.0
    for i in range(3):
        for j in range(3):
            entry = f[0, i] * f[0, j] + f[1, i] * f[1, j] + f[2, i] * f[2, j]
            total += entry * entry
    return 0.5 * (i1 * i1 - total)


@nb.njit(cache=True)
def add_second_derivative_of_volume(factor: float, f: np.ndarray, a: np.ndarray) -> None:
    """Add ``factor`` d2J/dF dF to ``a`` (9, 9): e_ikn e_jmq F_nq."""
    for i in range(3):
        i1_, i2_ = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            j1_, j2_ = (j + 1) % 3, (j + 2) % 3
            row = 3 * i + j
            a[row, 3 * i1_ + j1_] += factor * f[i2_, j2_]
            a[row, 3 * i2_ + j2_] += factor * f[i1_, j1_]
            a[row, 3 * i1_ + j2_] -= factor * f[i2_, j1_]
            a[row, 3 * i2_ + j1_] -= factor * f[i1_, j2_]


@nb.njit(cache=True)
def _assemble(
    f: np.ndarray,
    c: np.ndarray,
    first: tuple[float, float, float],
    second: tuple[float, float, float, float, float, float],
    p: np.ndarray,
    a: np.ndarray,
    order: int,
) -> None:
    """Fill stress and tangent of W(I1, I2, J) from its derivatives.

    ``first`` = (W_1, W_2, W_J), ``second`` = (W_11, W_22, W_JJ, W_12, W_1J, W_2J); ``c`` is the cofactor of ``f``.
    """
    w1, w2, wj = first
    w11, w22, wjj, w12, w1j, w2j = second
    with_i2 = w2 != 0.0 or w22 != 0.0 or w12 != 0.0 or w2j != 0.0
    i1 = _squared_norm(f)
    h = np.zeros((3, 3))  # dI2/dF = 2 (I1 F - F F'F)
    left = np.zeros((3, 3))  # F F'
    right = np.zeros((3, 3))  # F'F
    if with_i2:
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    left[i, j] += f[i, k] * f[j, k]
                    right[i, j] += f[k, i] * f[k, j]
        for i in range(3):
            for j in range(3):
                h[i, j] = 2.0 * i1 * f[i, j]
                for k in range(3):
                    h[i, j] -= 2.0 * left[i, k] * f[k, j]
    for i in range(3):
        for j in range(3):
            p[i, j] = 2.0 * w1 * f[i, j] + w2 * h[i, j] + wj * c[i, j]
    if order < TANGENT:
        return
    for i in range(3):
        for j in range(3):
            g, hh, cc = 2.0 * f[i, j], h[i, j], c[i, j]
            u1 = w11 * g + w12 * hh + w1j * cc
            u2 = w12 * g + w22 * hh + w2j * cc
            u3 = w1j * g + w2j * hh + wjj * cc
            row = 3 * i + j
            for k in range(3):
                for m in range(3):
                    a[row, 3 * k + m] = u1 * 2.0 * f[k, m] + u2 * h[k, m] + u3 * c[k, m]
            a[row, row] += 2.0 * w1
    add_second_derivative_of_volume(wj, f, a)
    if with_i2:
        for i in range(3):
            for j in range(3):
                row = 3 * i + j
                a[row, row] += 2.0 * w2 * i1
                for k in range(3):
                    a[row, 3 * i + k] -= 2.0 * w2 * right[k, j]
                    a[row, 3 * k + j] -= 2.0 * w2 * left[i, k]
                    for m in range(3):
                        a[row, 3 * k + m] += w2 * (4.0 * f[i, j] * f[k, m] - 2.0 * f[i, m] * f[k, j])


@nb.njit(LAW, cache=True)
def stable_neo_hookean(parameters: np.ndarray, f: np.ndarray, p: np.ndarray, a: np.ndarray, order: int) -> float:
    """W = mu/2 (I1 - 3) - mu (J - 1) + (lambda + mu)/2 (J - 1)^2; finite for any F."""
    lam, mu = parameters[0], parameters[1]
    c = np.empty((3, 3))
    j = cofactor_of(f, c)
    i1 = _squared_norm(f)
    if order >= STRESS:
        first = (0.5 * mu, 0.0, (lam + mu) * (j - 1.0) - mu)
        _assemble(f, c, first, (0.0, 0.0, lam + mu, 0.0, 0.0, 0.0), p, a, order)
    return 0.5 * mu * (i1 - 3.0) - mu * (j - 1.0) + 0.5 * (lam + mu) * (j - 1.0) ** 2


@nb.njit(LAW, cache=True)
def yeoh(parameters: np.ndarray, f: np.ndarray, p: np.ndarray, a: np.ndarray, order: int) -> float:
    """W = sum_i c_i (I1 J^-2/3 - 3)^i + kappa/2 (J - 1)^2, infinite where J <= 0."""
    c1, c2, c3, kappa = parameters[0], parameters[1], parameters[2], parameters[3]
    c = np.empty((3, 3))
    j = cofactor_of(f, c)
    if j <= 0.0:
        return np.inf
    i1 = _squared_norm(f)
    s = j ** (-2.0 / 3.0)
    x = i1 * s - 3.0
    if order >= STRESS:
        d1 = c1 + x * (2.0 * c2 + 3.0 * c3 * x)
        d2 = 2.0 * c2 + 6.0 * c3 * x
        xj = -2.0 / 3.0 * i1 * s / j
        xjj = 10.0 / 9.0 * i1 * s / (j * j)
        first = (d1 * s, 0.0, d1 * xj + kappa * (j - 1.0))
        w1j = d2 * s * xj - d1 * 2.0 / 3.0 * s / j
        second = (d2 * s * s, 0.0, d2 * xj * xj + d1 * xjj + kappa, 0.0, w1j, 0.0)
        _assemble(f, c, first, second, p, a, order)
    return x * (c1 + x * (c2 + x * c3)) + 0.5 * kappa * (j - 1.0) ** 2


@nb.njit(LAW, cache=True)
def mooney_rivlin(parameters: np.ndarray, f: np.ndarray, p: np.ndarray, a: np.ndarray, order: int) -> float:
    """W = c10 (I1 J^-2/3 - 3) + c01 (I2 J^-4/3 - 3) + kappa/2 (J - 1)^2, infinite where J <= 0."""
    c10, c01, kappa = parameters[0], parameters[1], parameters[2]
    c = np.empty((3, 3))
    j = cofactor_of(f, c)
    if j <= 0.0:
        return np.inf
    i1 = _squared_norm(f)
    i2 = _second_invariant(f, i1)
    s, t = j ** (-2.0 / 3.0), j ** (-4.0 / 3.0)
    if order >= STRESS:
        wj = -2.0 / 3.0 * c10 * i1 * s / j - 4.0 / 3.0 * c01 * i2 * t / j + kappa * (j - 1.0)
        wjj = (10.0 / 9.0 * c10 * i1 * s + 28.0 / 9.0 * c01 * i2 * t) / (j * j) + kappa
        w1j, w2j = -2.0 / 3.0 * c10 * s / j, -4.0 / 3.0 * c01 * t / j
        _assemble(f, c, (c10 * s, c01 * t, wj), (0.0, 0.0, wjj, 0.0, w1j, w2j), p, a, order)
    return c10 * (i1 * s - 3.0) + c01 * (i2 * t - 3.0) + 0.5 * kappa * (j - 1.0) ** 2


@nb.njit(LAW, cache=True)
def st_venant_kirchhoff(parameters: np.ndarray, f: np.ndarray, p: np.ndarray, a: np.ndarray, order: int) -> float:
    """W = lambda/2 tr(E)^2 + mu E:E with E = (F'F - I)/2."""
    lam, mu = parameters[0], parameters[1]
    c = np.empty((3, 3))
    cofactor_of(f, c)
    i1 = _squared_norm(f)
    i2 = _second_invariant(f, i1)
    if order >= STRESS:
        first = (0.25 * lam * (i1 - 3.0) + 0.5 * mu * (i1 - 1.0), -0.5 * mu, 0.0)
        _assemble(f, c, first, (0.25 * lam + 0.5 * mu, 0.0, 0.0, 0.0, 0.0, 0.0), p, a, order)
    return 0.125 * lam * (i1 - 3.0) ** 2 + 0.25 * mu * (i1 * i1 - 2.0 * i2 - 2.0 * i1 + 3.0)


@nb.njit(cache=True)
def _rotation_of(f: np.ndarray, j: float, r: np.ndarray) -> None:
    """Fill ``r`` with the rotation of F = R S, by Newton's iteration on R = (R + R^-T) / 2; ``j`` = det F > 0."""
    c = np.empty((3, 3))
    r[:] = f
    for _ in range(POLAR_ITERATIONS):
        scale = j ** (-1.0 / 3.0)  # of unit determinant: far fewer iterations where F is far from a rotation
        cofactor_of(r, c)
        change = 0.0
        for a in range(3):
            for b in range(3):
                new = 0.5 * (scale * r[a, b] + c[a, b] / (j * scale))
                change = max(change, abs(new - r[a, b]))
                r[a, b] = new
        if change < POLAR_TOLERANCE:
            return
        j = cofactor_of(r, c)


@nb.njit(LAW, cache=True)
def corotational(parameters: np.ndarray, f: np.ndarray, p: np.ndarray, a: np.ndarray, order: int) -> float:
    """W = mu |F - R|^2 + lambda/2 (tr S - 3)^2 with F = R S, infinite where J <= 0."""
    lam, mu = parameters[0], parameters[1]
    r, s, g = np.empty((3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    j = cofactor_of(f, g)
    if j <= 0.0:
        return np.inf
    _rotation_of(f, j, r)
    for i in range(3):
        for k in range(3):
            for n in range(3):
                s[i, k] += 0.5 * (r[n, i] * f[n, k] + r[n, k] * f[n, i])
    trace = s[0, 0] + s[1, 1] + s[2, 2]
    energy = 0.5 * lam * (trace - 3.0) ** 2
    for i in range(3):
        for k in range(3):
            energy += mu * (f[i, k] - r[i, k]) ** 2
    if order < STRESS:
        return energy
    pull = lam * (trace - 3.0) - 2.0 * mu  # W depends on R through tr S alone, and d tr S / dF = R
    for i in range(3):
        for k in range(3):
            p[i, k] = 2.0 * mu * f[i, k] + pull * r[i, k]
    if order < TANGENT:
        return energy
    # dR = R [w]x with (tr S I - S) w = axial vector of R'dF - dF'R
    for i in range(3):
        for k in range(3):
            g[i, k] = -s[i, k]
        g[i, i] += trace
    inverse = np.empty((3, 3))
    determinant = cofactor_of(g, inverse)  # g is symmetric, so its inverse is its cofactor over its determinant
    turn = np.empty((9, 3))  # column m: R [e_m]x
    for i in range(3):
        for m in range(3):
            m1, m2 = (m + 1) % 3, (m + 2) % 3
            turn[3 * i + m, m] = 0.0
            turn[3 * i + m1, m] = r[i, m2]
            turn[3 * i + m2, m] = -r[i, m1]
    for row in range(9):
        for column in range(9):
            value = lam * r[row // 3, row % 3] * r[column // 3, column % 3]
            for m in range(3):
                for n in range(3):
                    value += pull / determinant * turn[row, m] * inverse[m, n] * turn[column, n]
            a[row, column] = value
        a[row, row] += 2.0 * mu
    return energy
