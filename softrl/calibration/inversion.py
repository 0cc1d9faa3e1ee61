"""The pressures at which a simulator rests where the robot was seen to rest."""

import numpy as np
from scipy.optimize import least_squares

from softrl.core.progress import progress
from softrl.core.simulator import Simulator

# weights of a misplaced tip and of a pressure away from the commanded one; the latter only decides what the
# tip leaves open (more chambers than the tip has directions)
TIP_SCALE_M, PRESSURE_SCALE_PA = 1e-4, 1e6


def pressure_by_simulator(
    simulator: Simulator, tip: np.ndarray, start: np.ndarray, settle_s: float, dt_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return P_S (holds, n) Pa at which ``simulator`` settles at ``tip`` (holds, 3) m, and the distances left (holds,) m.

    Parameters
    ----------
    start : (holds, n) Pa, the commanded pressures; the search begins there
    settle_s : how long a constant pressure is simulated until the tip is taken to rest
    """
    pairs = list(zip(tip, start, strict=True))
    found = [_invert(simulator, *pair, settle_s, dt_s) for pair in progress(pairs, "pressure inversion")]
    return np.array([pressure for pressure, _ in found]), np.array([distance for _, distance in found])


def steady_tip(simulator: Simulator, pressure: np.ndarray, settle_s: float, dt_s: float) -> np.ndarray:
    """Return the tip (3,) m that ``simulator`` reaches from rest after ``settle_s`` of constant ``pressure`` (n,) Pa."""
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
