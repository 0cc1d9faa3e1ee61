"""f_RS and its inverse as plain NumPy: P_R -> P_S by the networks, P_S -> P_R by Newton's method on them."""

from typing import NamedTuple

import numba as nb
import numpy as np

from softrl.artifacts.calibration import Calibration
from softrl.core.errors import SolverError

TOLERANCE_PA, MAX_ITERATIONS, HALVINGS = 1e-3, 60, 8
WEIGHTS = ("skip", "bias", "weight_0", "bias_0", "weight_1", "bias_1", "weight_2")


class PressureTables(NamedTuple):
    """The arrays of a ``Calibration`` that compiled code reads; names and shapes as there, all of them contiguous."""

    skip: np.ndarray
    bias: np.ndarray
    weight_0: np.ndarray
    bias_0: np.ndarray
    weight_1: np.ndarray
    bias_1: np.ndarray
    weight_2: np.ndarray
    mean: np.ndarray
    spread: np.ndarray
    correction: np.ndarray
    low: np.ndarray
    high: np.ndarray


def tables_of(calibration: Calibration) -> PressureTables:
    """Return the arrays of f_RS as compiled code takes them."""
    c = calibration
    scalers = (c.pressure_mean, c.pressure_spread, c.correction_spread, c.pressure_low, c.pressure_high)
    arrays = [c.weights[name] for name in WEIGHTS] + list(scalers)
    return PressureTables(*(np.ascontiguousarray(array, dtype=float) for array in arrays))


def refusal(pressure: np.ndarray, left_pa: float) -> SolverError:
    """Return the error for P_S = ``pressure`` (n,) Pa to which no P_R was found, ``left_pa`` being left."""
    return SolverError(
        f"f_RS cannot be inverted at P_S={np.round(pressure / 1e3, 3).tolist()} kPa: "
        f"{left_pa:.3g} Pa left; record more holds there, or raise stage.weight_decays of calibration"
    )


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
        self.tables = tables_of(calibration)

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
        target = np.atleast_2d(pressure)
        found, left = self.sought(target)
        if not left.max() < TOLERANCE_PA:
            raise refusal(target[int(np.nanargmax(left))], float(np.nanmax(left)))
        return found.reshape(np.shape(pressure))

    def sought(self, pressure: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the P_R (T, n) Pa found for P_S (T, n) Pa, and what is left (T,) Pa: ``TOLERANCE_PA`` or more is no inverse."""
        return _invert_rows(np.ascontiguousarray(pressure, dtype=float), self.tables)

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


@nb.njit(cache=True)
def correct(pressure: np.ndarray, tables: PressureTables) -> tuple[np.ndarray, np.ndarray]:
    """Return the members' mean correction (n,) Pa at P_R ``pressure`` (n,) Pa, and its slope (n, n): output by input."""
    members, n, width = tables.weight_0.shape
    inside = np.minimum(np.maximum(pressure, tables.low), tables.high)
    scaled = (inside - tables.mean) / tables.spread
    value, slope = np.zeros(n), np.zeros((n, n))
    first, second = np.empty(width), np.empty(width)
    turn, inner = np.empty((width, n)), np.empty((width, n))
    for m in range(members):
        for h in range(width):
            total = tables.bias_0[m, h]
            for i in range(n):
                total += scaled[i] * tables.weight_0[m, i, h]
            first[h] = np.tanh(total)
            for i in range(n):
                turn[h, i] = tables.weight_0[m, i, h] * (1.0 - first[h] ** 2)
        second[:], inner[:] = tables.bias_1[m], 0.0
        for g in range(width):
            for h in range(width):
                second[h] += first[g] * tables.weight_1[m, g, h]
                for i in range(n):
                    inner[h, i] += tables.weight_1[m, g, h] * turn[g, i]
        for k in range(n):
            value[k] += tables.bias[m, k]
            for i in range(n):
                value[k] += scaled[i] * tables.skip[m, i, k]
                slope[k, i] += tables.skip[m, i, k]
        for h in range(width):
            high = np.tanh(second[h])
            for k in range(n):
                value[k] += high * tables.weight_2[m, h, k]
                for i in range(n):
                    slope[k, i] += tables.weight_2[m, h, k] * (1.0 - high**2) * inner[h, i]
    for k in range(n):
        value[k] *= tables.correction[k] / members
        for i in range(n):
            moves = 1.0 if inside[i] == pressure[i] else 0.0
            slope[k, i] *= moves * tables.correction[k] / (tables.spread[i] * members)
    return value, slope


@nb.njit(cache=True)
def invert_pressure(wanted: np.ndarray, tables: PressureTables) -> tuple[np.ndarray, float]:
    """Return P_R (n,) Pa for P_S ``wanted`` (n,) Pa by Newton's method with halved steps, and what is left, Pa."""
    n = len(wanted)
    found = wanted.copy()
    value, slope = correct(found, tables)
    miss = found + value - wanted
    left = np.abs(miss).max()
    for _ in range(MAX_ITERATIONS):
        if left < TOLERANCE_PA:
            break
        matrix = np.eye(n) + slope
        if abs(np.linalg.det(matrix)) < 1e-12:
            break  # the map is flat there
        step = np.linalg.solve(matrix, miss)
        share = 1.0
        for _ in range(HALVINGS):
            trial = found - share * step
            value, slope = correct(trial, tables)
            if np.abs(trial + value - wanted).max() <= left:
                break
            share *= 0.5
        found = trial
        miss = found + value - wanted
        left = np.abs(miss).max()
    return found, left


@nb.njit(cache=True)
def _invert_rows(wanted: np.ndarray, tables: PressureTables) -> tuple[np.ndarray, np.ndarray]:
    found, left = np.empty_like(wanted), np.empty(len(wanted))
    for t in range(len(wanted)):
        found[t], left[t] = invert_pressure(wanted[t], tables)
    return found, left
