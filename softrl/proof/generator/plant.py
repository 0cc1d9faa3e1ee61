"""The plant: supply, chambers and the chain of links with hidden laws, from commands to motion."""

import math
from dataclasses import dataclass

import numba as nb
import numpy as np

from softrl.proof.generator import laws
from softrl.proof.generator.body import advance, kinematics, weigh


@dataclass(frozen=True)
class Body:
    """A robot in plain numbers.

    Attributes
    ----------
    direction : (chambers, 2) unit vectors from the backbone to the chambers
    radius_m, area_m2, length_m, mass_kg : chambers' lever and area; backbone; moving mass
    pressure_pa : the largest pressure, the unit of all pressures in the laws
    bending_j, axial_j : stiffness per rad^2 and per squared elongation of the whole body
    damping_s : damping over stiffness
    gravity : (3,) m/s^2
    links : of the chain
    """

    direction: np.ndarray
    radius_m: float
    area_m2: float
    length_m: float
    mass_kg: float
    pressure_pa: float
    bending_j: float
    axial_j: float
    damping_s: float
    gravity: np.ndarray
    links: int

    @property
    def spring(self) -> float:
        """Stiffness of one chamber's wall, Pa per unit elongation: the three together carry all bending."""
        share = 0.5 * len(self.direction) * self.area_m2 * self.radius_m**2 / self.length_m
        return min(self.bending_j / share, self.axial_j / (len(self.direction) * self.area_m2 * self.length_m))


@dataclass(frozen=True)
class Motion:
    """Tip (steps, 3) m, orientation (steps, 3, 3), pressure behind the valves (steps, chambers) Pa."""

    position: np.ndarray
    rotation: np.ndarray
    pressure: np.ndarray


@nb.njit(cache=True)
def _run(
    times: np.ndarray,
    command: np.ndarray,
    tip_force: np.ndarray,
    step: float,
    P: np.ndarray,
    sticking: np.ndarray,
    direction: np.ndarray,
    numbers: np.ndarray,
    gravity: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    position: np.ndarray,
    rotation: np.ndarray,
    pressure: np.ndarray,
    energy: np.ndarray,
) -> None:
    radius, area, length, mass, unit, bending, axial, damping_s, spring = numbers
    m = len(q)
    n, chambers = m // 3, len(direction)
    stiffness, rest = np.empty(m), np.zeros(m)
    for j in range(n):
        stiffness[3 * j] = stiffness[3 * j + 1] = bending * n
        stiffness[3 * j + 2] = axial / n
        rest[3 * j + 2] = mass * gravity[2] * length / n * (n - j - 0.5) / n  # weight that the rest length includes
    damping = damping_s * stiffness
    masses = np.full(n + 1, mass / n)
    masses[n] = P[laws.MASS, 0] * mass
    points, speeds, biases = np.zeros((n + 1, 3)), np.zeros((n + 1, 3)), np.zeros((n + 1, 3))
    jacobian, R, M = np.zeros((n + 1, 3, m)), np.zeros((3, 3)), np.zeros((m, m))
    A, x, force, between = np.zeros((m, m)), np.zeros(m), np.zeros(m), np.zeros(m)
    mid_q, mid_v = np.zeros(m), np.zeros(m)
    supplies, chamber = np.zeros((chambers, laws.SUPPLY_SLOTS)), np.zeros((chambers, 2))
    walls, modes = np.zeros((chambers, laws.WALL_SLOTS)), np.zeros((3, laws.MODES))
    joints = np.zeros((n, 2))
    p, acting, pushed = np.zeros(chambers), np.zeros(chambers), np.zeros(3)
    e_rest, s_rest = np.zeros(chambers), np.zeros(3)
    between[:] = v
    unseen = True
    tilted = gravity.copy()
    if P[laws.TILT, 0] != 0.0 or P[laws.TILT, 1] != 0.0:
        a, b = P[laws.TILT, 0], P[laws.TILT, 1]
        y, z = math.cos(a) * gravity[1] - math.sin(a) * gravity[2], math.sin(a) * gravity[1] + math.cos(a) * gravity[2]
        tilted[0], tilted[1] = math.cos(b) * gravity[0] + math.sin(b) * z, y
        tilted[2] = math.cos(b) * z - math.sin(b) * gravity[0]
    t = times[0]
    for row in range(len(times)):
        span = times[row] - t
        count = max(math.ceil(span / step - 1e-9), 0)
        h = span / max(count, 1)
        for k in range(count):
            now = t + (k + 0.5) * h
            for c in range(chambers):
                p[c] = laws.supply(P, c, now, h, command[row, c], supplies[c], sticking)
            laws.inflate(P, now, h, p, chamber, acting)
            for i in range(m):
                mid_q[i], mid_v[i] = q[i] + 0.5 * h * between[i], between[i]
            kinematics(mid_q, mid_v, length, points, speeds, biases, jacobian, R)
            pushed[:] = tip_force[row]
            laws.pull(P, now, points[n], speeds[n], length, pushed)
            force[:] = 0.0
            weigh(masses, tilted, pushed, biases, jacobian, M, force)
            shape, rates = np.zeros(3), np.zeros(3)
            for j in range(n):
                for k3 in range(3):
                    scale = 1.0 / n if k3 == 2 else 1.0
                    shape[k3] += scale * mid_q[3 * j + k3]
                    rates[k3] += scale * mid_v[3 * j + k3]
            if unseen:
                s_rest[:] = shape
            generalized = np.zeros(3)
            for c in range(chambers):
                lever = radius / length
                e = shape[2] - lever * (shape[0] * direction[c, 0] + shape[1] * direction[c, 1])
                rate = rates[2] - lever * (rates[0] * direction[c, 0] + rates[1] * direction[c, 1])
                if unseen:
                    e_rest[c] = e
                added = laws.resist(P, c, now, h, e - e_rest[c], rate, p[c], spring / unit, walls[c])
                net = (acting[c] - added) * unit * area * length
                generalized[0] -= net * lever * direction[c, 0]
                generalized[1] -= net * lever * direction[c, 1]
                generalized[2] += net
            unseen = False
            whole = (bending, bending, axial)
            if P[laws.POWERLAW, 0] > 0.0 and P[laws.POWERLAW, laws.CHAMBER] < 0.0:
                for k3 in range(3):
                    generalized[k3] -= whole[k3] * laws.relaxed(P[laws.POWERLAW, 0], h, rates[k3] * h, modes[k3])
            if P[laws.RELAX, 0] != 0.0:
                since = max(now - max(P[laws.RELAX, laws.LATE], 0.0), 0.0)
                lost = P[laws.RELAX, 0] * (1.0 - math.exp(-since / P[laws.RELAX, 1]))
                for k3 in range(3):
                    generalized[k3] += lost * whole[k3] * (shape[k3] - s_rest[k3])
            for j in range(n):
                force[3 * j] += generalized[0]
                force[3 * j + 1] += generalized[1]
                force[3 * j + 2] += generalized[2] / n - rest[3 * j + 2]
                if P[laws.JOINT, 0] > 0.0:
                    laws.rub(P, h, n, mid_v[3 * j : 3 * j + 2], joints[j])
                    for k3 in range(2):
                        force[3 * j + k3] -= P[laws.JOINT, 0] * unit * area * radius * joints[j, k3]
            advance(q, v, between, h, M, force, stiffness, damping, A, x)
        t = times[row]
        kinematics(q, v, length, points, speeds, biases, jacobian, R)
        position[row], rotation[row], pressure[row] = points[n], R, p * unit
        energy[row] = 0.0
        for i in range(m):
            energy[row] += 0.5 * stiffness[i] * q[i] ** 2 + rest[i] * q[i]
        for k in range(n + 1):
            for a3 in range(3):
                energy[row] += masses[k] * (0.5 * speeds[k, a3] ** 2 - tilted[a3] * points[k, a3])


SETTLE_S = 4.0
SETTLE_DAMPING_S = 0.2


def simulate(
    body: Body,
    table: np.ndarray,
    times: np.ndarray,
    command: np.ndarray,
    step_s: float,
    tip_force: np.ndarray | None = None,
    sticking: np.ndarray | None = None,
) -> Motion:
    """Return the motion at ``times`` (steps,) s from rest under ``command`` (steps, chambers) Pa, each held until its time.

    Parameters
    ----------
    table : of the laws, see ``generator.laws``
    step_s : longest step of the integrator
    sticking : (times stuck, 3) start s, end s, chamber: when a valve does not move
    """
    q, v = equilibrium(body, table)
    return trace(body, table, times, command, step_s, q, v, tip_force, sticking)[0]


def equilibrium(body: Body, table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates and velocity (3 links,) after long rest without pressure under the loads alone."""
    loads = laws.neutral_table()
    for law in (laws.MASS, laws.TILT, laws.REBOUND, laws.STRING):
        loads[law] = table[law]
    slow = Body(**(vars(body) | {"damping_s": SETTLE_DAMPING_S}))
    q, v = np.zeros(3 * body.links), np.zeros(3 * body.links)
    times = np.array([0.0, SETTLE_S])
    trace(slow, loads, times, np.zeros((2, len(body.direction))), 4e-3, q, v)
    v[:] = 0.0
    return q, v


def trace(
    body: Body,
    table: np.ndarray,
    times: np.ndarray,
    command: np.ndarray,
    step_s: float,
    q: np.ndarray,
    v: np.ndarray,
    tip_force: np.ndarray | None = None,
    sticking: np.ndarray | None = None,
) -> tuple[Motion, np.ndarray]:
    """Return the motion from the state (q, v), which is advanced in place, and the mechanical energy (steps,) J."""
    steps, chambers = len(times), len(body.direction)
    position, rotation = np.empty((steps, 3)), np.empty((steps, 3, 3))
    pressure, energy = np.zeros((steps, chambers)), np.empty(steps)
    numbers = np.array(
        [body.radius_m, body.area_m2, body.length_m, body.mass_kg, body.pressure_pa, body.bending_j, body.axial_j,
         body.damping_s, body.spring]
    )  # fmt: skip
    force = np.zeros((steps, 3)) if tip_force is None else np.ascontiguousarray(tip_force, dtype=float)
    stuck = np.zeros((0, 3)) if sticking is None else sticking
    _run(np.ascontiguousarray(times), np.ascontiguousarray(command / body.pressure_pa), force, step_s,
         np.ascontiguousarray(table), stuck, np.ascontiguousarray(body.direction), numbers,
         np.array(body.gravity, dtype=float), q, v, position, rotation, pressure, energy)  # fmt: skip
    return Motion(position, rotation, pressure), energy
