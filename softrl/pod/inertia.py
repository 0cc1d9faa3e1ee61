"""What a time step's inertia is: the full model's own differences of positions, compiled.

Its nodes x change by ``M (x_1 - 2 x_0 + x_-1) / dt^2``. On the reduced body that is the derivative by the arrival of
``(d(1, 0)^2 - d(1, -1)^2 / 2) / dt^2``, d the distance of two states in the masses, see ``pod.chord``. So a body that turns
is led along its curve.
"""

from typing import Any

import numpy as np

from softrl.core.compiled import borrowing
from softrl.pod.chord import fill_chord
from softrl.pod.inside import AXES, fill_mass, shared_energy
from softrl.pod.potential import square_of


@borrowing
def fill_inertia(
    start: np.ndarray, before: np.ndarray, by: np.ndarray, tables: Any, work: Any, held: Any
) -> None:
    """Fill the masses half way of the step ``by`` (r,) from ``start``, and half way of that from ``before``.

    Beside each stands the force of its slope. ``work`` and ``held`` are those of ``pod.kernel``; the inside's masses are those
    half way of the step.
    """
    middle, further, back, slopes = work[3], work[2][2], held[1], held[2]
    for i in range(len(by)):
        middle[i] = 0.5 * (before[i] + start[i] + by[i])
        further[i] = start[i] - before[i] + by[i]
    fill_chord((tables.mass_root, tables.mass_factor), middle, further, 0, tables, work, back, slopes[1])
    fill_masses_of(start, by, tables, work, held)


@borrowing
def fill_masses_of(start: np.ndarray, by: np.ndarray, tables: Any, work: Any, held: Any) -> None:
    """Fill the mass half way of the step ``by`` (r,) from ``start`` with the force of its slope, and the inside's masses."""
    values, middle, root, mass, slopes, inside = work[0], work[3], work[4], held[0], held[2], held[5]
    for i in range(len(by)):
        middle[i] = start[i] + 0.5 * by[i]
    metric, least = (tables.mass_root, tables.mass_factor), tables.give_root.shape[1]
    fill_chord(metric, middle, by, least, tables, work, mass, slopes[0])
    fill_mass(root, tables, values, inside)


@borrowing
def kinetic_energy(velocity: np.ndarray, inner: np.ndarray, held: Any) -> float:
    """Return twice the kinetic energy, at mass scale 1, of a step at ``velocity`` and the rate of ``inner``."""
    return square_of(held[0], velocity) + shared_energy(velocity, inner, held[5])


@borrowing
def work_of_inertia(
    velocity: np.ndarray, former: np.ndarray, giving: np.ndarray, formerly: np.ndarray, dt: float, held: Any
) -> float:
    """Return twice the work in a step that the other forces do, by those of inertia which they balance, at mass scale 1.

    Parameters
    ----------
    velocity, former : (r,) of this step and of the last
    giving, formerly : (3,) rate of the inside, likewise
    """
    mass, back, slopes, _, _, inside = held
    total = 0.0
    for i in range(len(velocity)):
        force = (2.0 * slopes[0, i] - slopes[1, i]) / dt
        for j in range(len(velocity)):
            force += 2.0 * mass[i, j] * velocity[j] - back[i, j] * (velocity[j] + former[j])
        for k in range(AXES):
            force += inside.couple[i, k] * (giving[k] - formerly[k])
            total += inside.couple[i, k] * (velocity[i] - former[i]) * giving[k]
        total += force * velocity[i]
    for j in range(AXES):
        for k in range(AXES):
            total += giving[j] * inside.own[j, k] * (giving[k] - formerly[k])
    return 2.0 * total
