"""f_SP and its inverse, evaluated without torch: pressures to grouped joint commands and back."""

import numpy as np

from softrl.artifacts.surrogate import Surrogate
from softrl.core.scaling import Scaler

POLISH_STEPS = 6
DAMPING = 1e-9


class PressureToJoints:
    """f_SP (eq. 14) and its inverse; both clip nothing but what lies outside the range of motion or of pressures."""

    def __init__(self, surrogate: Surrogate) -> None:
        s = surrogate
        self._forward, self._inverse = s.forward, s.inverse
        self._pressure = Scaler(s.pressure_mean, s.pressure_spread)
        self._joints = Scaler(s.joint_mean, s.joint_spread)
        self._low, self._high = self._pressure.scale(s.pressure_low), self._pressure.scale(s.pressure_high)

    def joints(self, pressure: np.ndarray) -> np.ndarray:
        """Return theta (B, 3) rad, rad, m under ``pressure`` (B, n) Pa; pressures beyond the sampled range are clipped."""
        scaled = np.clip(self._pressure.scale(np.asarray(pressure, dtype=float)), self._low, self._high)
        return self._joints.unscale(network(self._forward, scaled))

    def pressure(self, theta: np.ndarray) -> np.ndarray:
        """Return the pressures (B, n) Pa within the sampled range whose joints come nearest to ``theta`` (B, 3).

        Notes
        -----
        The inverse network gives a start; a few damped Gauss-Newton steps on f_SP, held in the range, take away its
        error. A step that does not come nearer is not taken.
        """
        target = self._joints.scale(np.asarray(theta, dtype=float))
        scaled = np.clip(network(self._inverse, target), self._low, self._high)
        error = network(self._forward, scaled) - target
        for _ in range(POLISH_STEPS):
            slope = network_jacobian(self._forward, scaled)
            gradient = np.einsum("bij,bi->bj", slope, error)
            held = ((scaled <= self._low) & (gradient > 0.0)) | ((scaled >= self._high) & (gradient < 0.0))
            slope = np.where(held[:, None, :], 0.0, slope)
            normal = np.einsum("bij,bik->bjk", slope, slope) + DAMPING * np.eye(scaled.shape[1])
            step = np.linalg.solve(normal, np.einsum("bij,bi->bj", slope, error)[..., None])[..., 0]
            trial = np.clip(scaled - step, self._low, self._high)
            trial_error = network(self._forward, trial) - target
            better = (trial_error**2).sum(axis=1) < (error**2).sum(axis=1)
            scaled, error = np.where(better[:, None], trial, scaled), np.where(better[:, None], trial_error, error)
        return self._pressure.unscale(scaled)

    def pressure_by_network(self, theta: np.ndarray) -> np.ndarray:
        """Return what the inverse network alone says, (B, n) Pa: as fast as a network, less exact."""
        scaled = network(self._inverse, self._joints.scale(np.asarray(theta, dtype=float)))
        return self._pressure.unscale(np.clip(scaled, self._low, self._high))


def network(weights: dict[str, np.ndarray], inputs: np.ndarray) -> np.ndarray:
    """Return the outputs (B, k) of a tanh network with a linear path beside it, at scaled inputs (B, n)."""
    layers = sum(name.startswith("weight_") for name in weights)
    hidden = inputs
    for i in range(layers - 1):
        hidden = np.tanh(hidden @ weights[f"weight_{i}"] + weights[f"bias_{i}"])
    return inputs @ weights["skip"] + hidden @ weights[f"weight_{layers - 1}"] + weights[f"bias_{layers - 1}"]


def network_jacobian(weights: dict[str, np.ndarray], inputs: np.ndarray) -> np.ndarray:
    """Return d outputs / d inputs (B, k, n) of ``network``."""
    layers = sum(name.startswith("weight_") for name in weights)
    hidden = inputs
    slope = np.broadcast_to(np.eye(inputs.shape[1]), (len(inputs), *(2 * [inputs.shape[1]])))
    for i in range(layers - 1):
        hidden = np.tanh(hidden @ weights[f"weight_{i}"] + weights[f"bias_{i}"])
        slope = (slope @ weights[f"weight_{i}"]) * (1.0 - hidden**2)[:, None, :]
    return np.swapaxes(weights["skip"] + slope @ weights[f"weight_{layers - 1}"], 1, 2)
