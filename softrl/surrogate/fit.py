"""Joint commands that put the chain's tip where the body's tip is, within joint limits (eqs. 12-13, Algorithm 1)."""

from typing import NamedTuple

import numba as nb
import numpy as np
from scipy.optimize import minimize

from softrl.surrogate.kinematics import Chain, grouped_pose, grouped_poses

ITERATIONS = 60
TOLERANCE_M = 1e-10


class Fit(NamedTuple):
    """Grouped commands ``theta`` (B, 3) and the distance ``residual`` (B,) m left between the tips."""

    theta: np.ndarray
    residual: np.ndarray


def fit_joints(chain: Chain, tip: np.ndarray, low: np.ndarray, high: np.ndarray) -> Fit:
    """Return the commands in ``low`` .. ``high`` (3,) that reach tips (B, 3) m, by damped, projected Gauss-Newton."""
    theta, residual = _gauss_newton(
        np.ascontiguousarray(tip, dtype=float), low.astype(float), high.astype(float), chain
    )
    return Fit(theta, residual)


def fit_joints_lbfgsb(chain: Chain, tip: np.ndarray, low: np.ndarray, high: np.ndarray) -> Fit:
    """Return the same by L-BFGS-B with the analytic gradient, one sample after the other.

    Notes
    -----
    Algorithm 1 of the paper minimises the squared tip distance with L-BFGS-B, the simulator inside the objective; the
    closed form replaces the simulator here. Variables are scaled to the limits, the objective to mm^2.
    """
    span = high - low
    theta = np.empty((len(tip), 3))

    def objective(x: np.ndarray, target: np.ndarray) -> tuple[float, np.ndarray]:
        at, _, jacobian = grouped_poses((low + x * span)[None], chain)
        error = 1e3 * (at[0] - target)
        return float(error @ error), 2e3 * (error @ jacobian[0]) * span

    start = np.clip(-low / span, 0.0, 1.0)
    for b, target in enumerate(tip):
        options = {"maxiter": 200, "ftol": 1e-15, "gtol": 1e-10}
        found = minimize(objective, start, (target,), "L-BFGS-B", jac=True, bounds=[(0.0, 1.0)] * 3, options=options)
        theta[b] = low + found.x * span
    return Fit(theta, np.linalg.norm(grouped_poses(theta, chain)[0] - tip, axis=1))


@nb.njit(cache=True)
def _gauss_newton(
    targets: np.ndarray, low: np.ndarray, high: np.ndarray, chain: Chain
) -> tuple[np.ndarray, np.ndarray]:
    batch, joints = len(targets), 3 * len(chain.below)
    theta, residual = np.empty((batch, 3)), np.empty(batch)
    q, rotation, jacobian = np.empty(joints), np.empty((3, 3)), np.empty((3, joints))
    tip, grouped = np.empty(3), np.empty((3, 3))
    scale = high - low
    for b in range(batch):
        now = np.minimum(np.maximum(np.zeros(3), low), high)
        grouped_pose(now, chain, q, tip, rotation, jacobian, grouped)
        error = tip - targets[b]
        cost, damping = error @ error, 1e-6
        for _ in range(ITERATIONS):
            if np.sqrt(cost) < TOLERANCE_M:
                break
            scaled = grouped * scale  # columns per unit of the range: angles and slide weigh alike
            gradient = scaled.T @ error
            normal = scaled.T @ scaled
            # a variable that presses against its limit is held, so that the others solve a problem of their own
            for j in range(3):
                pressed = (now[j] <= low[j] and gradient[j] > 0.0) or (now[j] >= high[j] and gradient[j] < 0.0)
                if pressed:
                    normal[j, :] = 0.0
                    normal[:, j] = 0.0
                    normal[j, j] = 1.0
                    gradient[j] = 0.0
            level = damping * (normal[0, 0] + normal[1, 1] + normal[2, 2]) / 3.0 + 1e-18
            step = np.linalg.solve(normal + level * np.eye(3), gradient)
            trial = np.minimum(np.maximum(now - step * scale, low), high)
            grouped_pose(trial, chain, q, tip, rotation, jacobian, grouped)
            trial_error = tip - targets[b]
            trial_cost = trial_error @ trial_error
            if trial_cost < cost:
                now, error, cost, damping = trial, trial_error, trial_cost, 0.2 * damping
            else:
                damping = max(10.0 * damping, 1e-6)
                grouped_pose(now, chain, q, tip, rotation, jacobian, grouped)
                if damping > 1e8:
                    break
        theta[b], residual[b] = now, np.sqrt(cost)
    return theta, residual
