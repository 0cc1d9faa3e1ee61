"""f_RS and its inverse as plain NumPy: P_R -> P_S by the networks, P_S -> P_R by Newton's method on them."""

import numpy as np

from softrl.artifacts.calibration import Calibration
from softrl.core.errors import SolverError

TOLERANCE_PA, MAX_ITERATIONS = 1e-3, 60


class PressureMap:
    """The calibrated map of one robot.

    Notes
    -----
    Paper eq. 1. Beyond the pressures seen in training the correction P_S - P_R keeps its value at the border (each
    chamber clipped by itself), so that the map stays the identity plus a bounded correction.
    """

    def __init__(self, calibration: Calibration) -> None:
        self._c = calibration
        self._w = calibration.weights

    def real_to_sim(self, pressure: np.ndarray) -> np.ndarray:
        """Return P_S (T, n) Pa of the simulator for P_R (T, n) Pa at the driver; also (n,) -> (n,)."""
        rows = np.atleast_2d(pressure)
        return (rows + self._corrections(rows)[0].mean(axis=0)).reshape(np.shape(pressure))

    def spread(self, pressure: np.ndarray) -> np.ndarray:
        """Return the standard deviation (T, n) Pa of the members' answers: what the data left open at P_R (T, n) Pa."""
        return self._corrections(np.atleast_2d(pressure))[0].std(axis=0).reshape(np.shape(pressure))

    def sim_to_real(self, pressure: np.ndarray) -> np.ndarray:
        """Return P_R (T, n) Pa with ``real_to_sim(P_R)`` = ``pressure`` (T, n) Pa, to 0.001 Pa.

        Raises
        ------
        SolverError
            If Newton's method finds no solution: the map folds there, so its training data were poor.
        """
        target = np.atleast_2d(pressure).astype(float)
        found = target.copy()
        for _ in range(MAX_ITERATIONS):
            correction, slope = self._corrections(found)
            miss = found + correction.mean(axis=0) - target
            if np.abs(miss).max() < TOLERANCE_PA:
                return found.reshape(np.shape(pressure))
            try:
                found = self._descend(found, miss, slope.mean(axis=0), target)
            except np.linalg.LinAlgError:
                break  # the map is flat there; told below
        worst = int(np.abs(miss).max(axis=1).argmax())
        raise SolverError(
            f"f_RS cannot be inverted at P_S={np.round(target[worst] / 1e3, 3).tolist()} kPa: "
            f"{np.abs(miss).max():.3g} Pa left; record more holds there, or raise stage.weight_decays of calibration"
        )

    def _descend(self, found: np.ndarray, miss: np.ndarray, slope: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Return the Newton step (T, n) Pa, halved per row until the miss shrinks."""
        step = np.linalg.solve(np.eye(found.shape[1]) + slope, miss[..., None])[..., 0]
        size, share = np.abs(miss).max(axis=1), np.ones((len(found), 1))
        for _ in range(8):
            trial = found - share * step
            left = np.abs(trial + self._corrections(trial)[0].mean(axis=0) - target).max(axis=1)
            worse = left > size
            if not worse.any():
                break
            share[worse] *= 0.5
        return trial

    def _corrections(self, pressure: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return P_S - P_R of all members (members, T, n) Pa and its slope (members, T, n, n) by P_R."""
        c, w = self._c, self._w
        inside = np.clip(pressure, c.pressure_low, c.pressure_high)
        scaled = (inside - c.pressure_mean) / c.pressure_spread
        first = np.tanh(scaled @ w["weight_0"] + w["bias_0"][:, None])
        second = np.tanh(first @ w["weight_1"] + w["bias_1"][:, None])
        value = scaled @ w["skip"] + w["bias"][:, None] + second @ w["weight_2"]
        # rows: output, columns: input
        inner = np.swapaxes(w["weight_1"], 1, 2)[:, None] * (1.0 - second**2)[..., None]
        inner = (inner * (1.0 - first**2)[:, :, None]) @ np.swapaxes(w["weight_0"], 1, 2)[:, None]
        slope = np.swapaxes(w["skip"], 1, 2)[:, None] + np.swapaxes(w["weight_2"], 1, 2)[:, None] @ inner
        moving = (inside == pressure) / c.pressure_spread
        return value * c.correction_spread, slope * c.correction_spread[:, None] * moving[:, None]
