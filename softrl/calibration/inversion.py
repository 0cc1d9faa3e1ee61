"""The pressures at which a simulator rests where the robot was seen to rest."""

from dataclasses import replace
from typing import TypeGuard

import numpy as np
from scipy.optimize import least_squares

from softrl.core.progress import progress
from softrl.core.simulator import Simulator
from softrl.pod.rom import pressure_for_tip, static_points
from softrl.pod.simulator import RomSimulator
from softrl.pod.step.tables import tables_of
from softrl.robots.robot import Robot

# weights of a misplaced tip and of a pressure away from the commanded one; the latter only decides what the
# tip leaves open (more chambers than the tip has directions)
TIP_SCALE_M, PRESSURE_SCALE_PA = 1e-4, 1e6
# how far beyond the robot's range P_S may lie, in parts of it: a robot at its limit may act like a simulator above it
MARGIN = 0.25


def has_exact_inverse(simulator: Simulator, robot: Robot) -> TypeGuard[RomSimulator]:
    """Return whether the reduced model answers at once: three chambers for three directions."""
    return isinstance(simulator, RomSimulator) and robot.chambers == 3


def pressure_by_reduced_model(simulator: RomSimulator, robot: Robot, tip: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return P_S (holds, 3) Pa at which the reduced model rests at ``tip`` (holds, 3) m, and the distances left, m."""
    margin = MARGIN * (robot.pressure_max_pa - robot.pressure_min_pa)
    wide = replace(
        simulator.reduced_model,
        pressure_min_pa=robot.pressure_min_pa - margin,
        pressure_max_pa=robot.pressure_max_pa + margin,
    )
    # with the simulator's scales: a retuned body rests elsewhere than its model
    gravity = np.array(robot.gravity_m_s2)
    tables = tables_of(wide, gravity, **simulator.parameters, layer_scales=simulator.layer_scales)
    pressure, miss = pressure_for_tip(wide, tip, tables=tables)
    clipped = (pressure <= wide.pressure_min_pa) | (pressure >= wide.pressure_max_pa)
    # beyond its samples the model is a wall: there a tip tells nothing about the pressure
    point, failed = static_points(tables, np.pad(pressure, ((0, 0), (0, 3))))
    outside = failed | (np.linalg.norm(point, axis=1) > 1.0)
    return pressure, np.where(clipped.any(axis=1) | outside, np.inf, miss)


def pressure_by_simulator(
    simulator: Simulator, tip: np.ndarray, start: np.ndarray, settle_s: float, dt_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return P_S (holds, n) Pa at which ``simulator`` settles at ``tip`` (holds, 3) m, and the distances left, m.

    Parameters
    ----------
    start : (holds, n) Pa, the commanded pressures; the search begins there
    settle_s : how long a constant pressure is simulated until the tip is taken to rest
    """
    pairs = list(zip(tip, start, strict=True))
    found = [_invert(simulator, *pair, settle_s, dt_s) for pair in progress(pairs, "pressure inversion")]
    return np.array([pressure for pressure, _ in found]), np.array([distance for _, distance in found])


def steady_tip(simulator: Simulator, pressure: np.ndarray, settle_s: float, dt_s: float) -> np.ndarray:
    """Return the tip (3,) m that ``simulator`` reaches after ``settle_s`` of constant ``pressure`` (n,) Pa."""
    time = dt_s * np.arange(1, round(settle_s / dt_s) + 1)
    return simulator.simulate(time, np.tile(pressure, (len(time), 1))).position[-1]


def _invert(
    simulator: Simulator, tip: np.ndarray, start: np.ndarray, settle_s: float, dt_s: float
) -> tuple[np.ndarray, float]:
    def miss(pressure: np.ndarray) -> np.ndarray:
        away = steady_tip(simulator, pressure, settle_s, dt_s) - tip
        return np.concatenate([away / TIP_SCALE_M, (pressure - start) / PRESSURE_SCALE_PA])

    solve = least_squares(miss, start, x_scale=1e3, diff_step=1e-3, method="trf", xtol=1e-8, max_nfev=30)
    return solve.x, float(np.linalg.norm(solve.fun[:3]) * TIP_SCALE_M)
