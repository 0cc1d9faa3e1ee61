"""A chain of rigid links joined by universal joints and slides: kinematics, mass matrix, one step in time.

Link by link a half link, a joint that turns about two axes, and another half link; both halves grow with the
link's slide. Coordinates of link ``j`` are ``q[3 j : 3 j + 3]`` = (turn towards +x, turn towards +y, elongation).
The order of the two axes alternates from joint to joint, so that the twist of one cancels that of the next. Each
link's mass sits at its joint, a payload at the tip.
"""

import math

import numba as nb
import numpy as np

THETA = 0.55


@nb.njit(cache=True)
def _cross(a: np.ndarray, b: np.ndarray, out: np.ndarray) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@nb.njit(cache=True)
def _turn(R: np.ndarray, axis: int, angle: float) -> None:
    """Multiply ``R`` (3, 3) from the right by a rotation about its own x (0) or y (1) axis."""
    c, s = math.cos(angle), math.sin(angle)
    for i in range(3):
        if axis == 0:
            y, z = R[i, 1], R[i, 2]
            R[i, 1], R[i, 2] = c * y + s * z, c * z - s * y
        else:
            x, z = R[i, 0], R[i, 2]
            R[i, 0], R[i, 2] = c * x - s * z, c * z + s * x


@nb.njit(cache=True)
def kinematics(
    q: np.ndarray,
    v: np.ndarray,
    length: float,
    points: np.ndarray,
    speeds: np.ndarray,
    biases: np.ndarray,
    jacobian: np.ndarray,
    R: np.ndarray,
) -> None:
    """Fill place, velocity, velocity-product acceleration (n + 1, 3) and Jacobian (n + 1, 3, 3 n) of all joints and the tip.

    ``R`` (3, 3) ends as the tip's orientation.
    """
    n = len(q) // 3
    half = 0.5 * length / n
    o, od, odd = np.zeros(3), np.zeros(3), np.zeros(3)
    w, al = np.zeros(3), np.zeros(3)
    u, t1, t2 = np.zeros(3), np.zeros(3), np.zeros(3)
    axes = np.zeros((n, 2, 3))
    along = np.zeros((n, 2, 3))
    R[:] = 0.0
    R[0, 0] = R[1, 1] = R[2, 2] = 1.0
    jacobian[:] = 0.0
    for j in range(n):
        s, sd = half * (1.0 + q[3 * j + 2]), half * v[3 * j + 2]
        for side in range(2):
            for k in range(3):
                u[k] = R[k, 2]
                along[j, side, k] = half * u[k]
            _cross(w, u, t1)
            _cross(w, t1, t2)
            for k in range(3):
                odd[k] += s * t2[k] + 2.0 * sd * t1[k]
            _cross(al, u, t2)
            for k in range(3):
                o[k] += s * u[k]
                od[k] += s * t1[k] + sd * u[k]
                odd[k] += s * t2[k]
            if side == 1:
                break
            points[j], speeds[j], biases[j] = o, od, odd
            for turn in range(2):
                towards = (turn + j) % 2  # 0: towards +x, about y; 1: towards +y, about -x
                sign = 1.0 if towards == 0 else -1.0
                column = 1 if towards == 0 else 0
                for k in range(3):
                    axes[j, towards, k] = sign * R[k, column]
                rate = v[3 * j + towards]
                _cross(w, axes[j, towards], t1)
                for k in range(3):
                    al[k] += t1[k] * rate
                    w[k] += axes[j, towards, k] * rate
                _turn(R, column, sign * q[3 * j + towards])
    points[n], speeds[n], biases[n] = o, od, odd
    arm = np.zeros(3)
    for p in range(n + 1):
        for j in range(min(p + 1, n)):
            if j < p:
                for k in range(3):
                    arm[k] = points[p, k] - points[j, k]
                for towards in range(2):
                    _cross(axes[j, towards], arm, t1)
                    for k in range(3):
                        jacobian[p, k, 3 * j + towards] = t1[k]
            for k in range(3):
                jacobian[p, k, 3 * j + 2] = along[j, 0, k] + (along[j, 1, k] if j < p else 0.0)


@nb.njit(cache=True)
def weigh(
    masses: np.ndarray,
    gravity: np.ndarray,
    tip_force: np.ndarray,
    biases: np.ndarray,
    jacobian: np.ndarray,
    M: np.ndarray,
    force: np.ndarray,
) -> None:
    """Fill the mass matrix ``M`` (m, m) and add weight, tip force and inertia of the velocities to ``force`` (m,)."""
    m = len(force)
    M[:] = 0.0
    for p in range(len(masses)):
        mass = masses[p]
        last = min(3 * (p + 1), m)
        for a in range(last):
            Q = 0.0
            for k in range(3):
                load = mass * (gravity[k] - biases[p, k])
                if p == len(masses) - 1:
                    load += tip_force[k]
                Q += jacobian[p, k, a] * load
            force[a] += Q
            if mass > 0.0:
                for b in range(a + 1):
                    inner = 0.0
                    for k in range(3):
                        inner += jacobian[p, k, a] * jacobian[p, k, b]
                    M[a, b] += mass * inner
    for a in range(m):
        for b in range(a):
            M[b, a] = M[a, b]


@nb.njit(cache=True)
def solve_symmetric(A: np.ndarray, x: np.ndarray) -> None:
    """Solve ``A x = b`` in place for a positive definite ``A``, whose lower triangle is overwritten."""
    m = len(x)
    for i in range(m):
        for j in range(i + 1):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            if i == j:
                A[i, i] = math.sqrt(total)
            else:
                A[i, j] = total / A[j, j]
    for i in range(m):
        total = x[i]
        for k in range(i):
            total -= A[i, k] * x[k]
        x[i] = total / A[i, i]
    for i in range(m - 1, -1, -1):
        total = x[i]
        for k in range(i + 1, m):
            total -= A[k, i] * x[k]
        x[i] = total / A[i, i]


@nb.njit(cache=True)
def advance(
    q: np.ndarray,
    v: np.ndarray,
    between: np.ndarray,
    h: float,
    M: np.ndarray,
    force: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
    A: np.ndarray,
    x: np.ndarray,
) -> None:
    """Advance ``q`` and ``v`` by ``h``, springs and dampers implicitly; ``between`` (m,) becomes the velocity amid the step.

    Theta method: just behind the midpoint, so that stiff slides do not ring, and nearly of second order. Mass matrix
    and other forces are given, as they are at the midpoint to which the last velocity leads: one linear solve a step.
    """
    m = len(q)
    forth = THETA * h
    for i in range(m):
        x[i] = forth * (force[i] - stiffness[i] * q[i])
        for j in range(m):
            x[i] += M[i, j] * v[j]
            A[i, j] = M[i, j]
        A[i, i] += forth * damping[i] + forth * forth * stiffness[i]
    solve_symmetric(A, x)
    for i in range(m):
        q[i] += h * x[i]
        between[i] = x[i]
        v[i] += (x[i] - v[i]) / THETA
