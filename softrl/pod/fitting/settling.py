"""Which energies hold a body: where it must stand, and whether it comes to rest there.

A polynomial of high degree follows the samples closely and may have wells and saddles beyond them, where weight and fast
motion lead.
"""

from dataclasses import replace

import numpy as np
from scipy.stats.qmc import Sobol

from softrl.artifacts.reduced_model import ReducedModel
from softrl.core.polynomial import basis, degree_of
from softrl.pod.fitting.equilibria import Equilibria
from softrl.pod.rom import EMPTY, NO_HOOKS, STILL, static_points
from softrl.pod.step.kernel import run_kernel
from softrl.pod.step.potential import Tables, fill_potential, make_room
from softrl.pod.step.tables import gradient_of, hessian_at_rest, mass_at_rest, tables_of
from softrl.robots.robot import Robot

LOST = 0.1  # of the mean motion: a body that rests farther off was caught by a well
PRESSURES = 512  # all over their range, at which the body has to stand
ANCHORS, BEYOND = 256, 1.2  # equilibria to which a high degree is held; their pressures over the robot's range
LEAD_STEPS, LEAD_STEP = 40, 0.4  # under each load, in radians of the slowest motion at rest
FLIGHT_STEPS, FLIGHT_STEP = 60, 0.1  # the same before, of a body that is thrown


def settles(model: ReducedModel, loads: np.ndarray, thrown: bool) -> bool:
    """Return whether the body stands under each of ``loads`` (S, r), and comes to rest where statics says.

    Under its weight it is led from load to load, well damped all the time, or if ``thrown`` only once it has flown with
    its own damping: that brings it farther beyond the samples.
    """
    if not stands(model):
        return False
    root = np.linalg.inv(np.linalg.cholesky(hessian_at_rest(model.energy, model.order)))
    slowest = 1.0 / np.sqrt(np.linalg.eigvalsh(root @ mass_at_rest(model) @ root.T)[-1])
    points, lost = static_points(tables_of(model), loads)
    if lost.any() or _least_stiffness(tables_of(model), points) <= 0.0:
        return False
    damped = tables_of(replace(model, rayleigh_mass_per_s=max(model.rayleigh_mass_per_s, slowest)))
    stages = [(tables_of(model), FLIGHT_STEPS, FLIGHT_STEP / slowest)] if thrown else []
    stages.append((damped, LEAD_STEPS, LEAD_STEP / slowest))
    least = LOST * np.linalg.norm(points @ model.frame.T[:, -3:], axis=1).mean()
    state = *np.zeros((2, model.order)), STILL.copy(), np.zeros(model.order)
    for load, point in zip(loads, points, strict=True):
        for tables, steps, step in stages:
            held = np.tile(load, (steps, 1))
            failed, *_ = run_kernel(*state, step, held, tables, NO_HOOKS, held[:0], *EMPTY)
        # a step of the flight may fail: what counts is where it comes to rest
        if failed > 0 or not np.linalg.norm(((state[0] - point) @ model.frame.T)[-3:]) < least:
            return False
    return True


def stands(model: ReducedModel) -> bool:
    """Return whether the body is stable at rest."""
    return bool(np.linalg.eigvalsh(hessian_at_rest(model.energy, model.order)).min() > 0.0)


def trial_loads(robot: Robot, samples: Equilibria) -> np.ndarray:
    """Return loads (S, r) under which a body with its weight must stand.

    They are those of the samples, tip forces no larger than the robot's limit, and pressures all over their range.
    """
    n = robot.chambers
    sampled = samples.load.copy()
    pull = np.linalg.norm(sampled[:, n:], axis=1, keepdims=True)
    sampled[:, n:] *= np.minimum(1.0, robot.tip_force_max_n / np.maximum(pull, 1e-12))
    pressures = np.zeros((PRESSURES, n + 3))
    span = robot.pressure_max_pa - robot.pressure_min_pa
    pressures[:, :n] = robot.pressure_min_pa + span * Sobol(n, seed=0).random(PRESSURES)
    return np.concatenate([sampled, pressures])


def anchor_loads(draft: ReducedModel) -> np.ndarray:
    """Return loads (ANCHORS, r) all over the pressures and a little beyond, and tip forces as large as samples' and weight.

    A moving body is not where its pressures alone would bring it: inertia loads it like weight does.
    """
    n = draft.chambers
    unit = Sobol(n + 3, seed=1).random(ANCHORS)
    middle = 0.5 * (draft.pressure_max_pa + draft.pressure_min_pa)
    half = 0.5 * BEYOND * (draft.pressure_max_pa - draft.pressure_min_pa)
    sink = gradient_of(draft.centre_of_mass, draft.order)[:, :, 0] @ draft.gravity_m_s2
    weight = draft.mass * sink @ np.linalg.inv(draft.frame)
    centre = 0.5 * (draft.load_low + draft.load_high)[n:]
    largest = 0.5 * (draft.load_high - draft.load_low)[n:].max() + np.linalg.norm(weight[n:])
    height, turn, radius = 2.0 * unit[:, n] - 1.0, 2.0 * np.pi * unit[:, n + 1], np.sqrt(unit[:, n + 2])
    flat = np.sqrt(1.0 - height**2)
    force = largest * radius[:, None] * np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    return np.hstack([middle + half * (2.0 * unit[:, :n] - 1.0), centre + force])


def equilibria_of(model: ReducedModel, loads: np.ndarray) -> Equilibria:
    """Return the stable equilibria of ``model`` without weight under ``loads`` (S, r), as far as they are found.

    They hold what the fit of an energy reads: coordinates, loads, energies, compliances and their slopes.
    """
    r, inverse = model.order, np.linalg.inv(model.frame)
    points, lost = static_points(tables_of(model, np.zeros(3)), loads)
    points = points[~lost & (np.linalg.norm(points, axis=1) <= 1.0)]
    table = basis(r, degree_of(r, len(model.energy)))
    slope, curve, third = table.gradient_rows(points), table.hessian_rows(points), table.third_rows(points)
    hessian = inverse.T @ (curve @ model.energy) @ inverse
    stable = np.linalg.eigvalsh(curve @ model.energy)[:, 0] > 0.0
    hessian, points = hessian[stable], points[stable]
    compliance = np.linalg.inv(hessian)
    moved = compliance @ inverse.T  # dy/dload
    bent = -np.einsum("sia,sjb,skc,sabc->sijk", moved, moved, moved, third[stable] @ model.energy, optimize=True)
    return Equilibria(
        (slope[stable] @ model.energy) @ inverse, points @ model.frame.T, table.values(points) @ model.energy,
        {"compliance": compliance}, {"compliance": bent}, np.zeros((0, 0)),
    )


def _least_stiffness(tables: Tables, points: np.ndarray) -> float:
    """Return the smallest eigenvalue of the potential's Hessian at ``points`` (S, r), J: negative at a saddle."""
    r = points.shape[1]
    room, gradient, hessian = make_room(tables), np.empty(r), np.empty((r, r))
    least = np.inf
    for point in points:
        fill_potential(point, tables, room, gradient, hessian)
        least = min(least, float(np.linalg.eigvalsh(hessian)[0]))
    return least
