"""f_SP and its inverse, evaluated without torch: pressures to grouped joint commands and back."""

from typing import NamedTuple

import numba as nb
import numpy as np

from softrl.artifacts.surrogate import Surrogate
from softrl.core.scaling import Scaler

POLISH_STEPS = 6
DAMPING = 1e-9
POLISHED = 1e-20  # squared scaled miss at which there is nothing left to polish


class Network(NamedTuple):
    """A tanh network with a linear path beside it: ``skip`` (n, k), layers (in, out) and biases (out,) in order."""

    skip: np.ndarray
    weights: tuple[np.ndarray, ...]
    biases: tuple[np.ndarray, ...]


class MapTables(NamedTuple):
    """What the compiled inverse reads: both networks, scalers of pressures (n,) and joints (3,), scaled range (n,)."""

    forward: Network
    inverse: Network
    pressure_mean: np.ndarray
    pressure_spread: np.ndarray
    joint_mean: np.ndarray
    joint_spread: np.ndarray
    low: np.ndarray
    high: np.ndarray


class Inverted(NamedTuple):
    """Pressures (B, n) Pa and what their joints miss of the wanted ones, ``miss`` (B, 3) rad, rad, m."""

    pressure: np.ndarray
    miss: np.ndarray


class PressureToJoints:
    """f_SP (eq. 14) and its inverse, whose pressures are within the sampled range; f_SP goes on beyond it by its slope."""

    def __init__(self, surrogate: Surrogate) -> None:
        s = surrogate
        self._forward, self._inverse = s.forward, s.inverse
        self._pressure = Scaler(s.pressure_mean, s.pressure_spread)
        self._joints = Scaler(s.joint_mean, s.joint_spread)
        self._low, self._high = self._pressure.scale(s.pressure_low), self._pressure.scale(s.pressure_high)
        self.tables = tables_of(surrogate)

    def joints(self, pressure: np.ndarray) -> np.ndarray:
        """Return theta (B, 3) rad, rad, m under ``pressure`` (B, n) Pa.

        Notes
        -----
        Beyond the sampled range f_SP goes on from the nearest pressures within it, by its slope there (to first order): a
        softer body or one whose valves give too much bends further, and what the network would say there is arbitrary.
        """
        scaled = np.atleast_2d(self._pressure.scale(np.asarray(pressure, dtype=float)))
        within = np.clip(scaled, self._low, self._high)
        answer = network(self._forward, within)
        if not np.array_equal(within, scaled):
            answer = answer + _beyond(within, scaled - within, self.tables.forward)
        return self._joints.unscale(answer)

    def pressure(self, theta: np.ndarray) -> np.ndarray:
        """Return the pressures (B, n) Pa within the sampled range whose joints come nearest to ``theta`` (B, 3)."""
        return self.invert(theta).pressure

    def invert(self, theta: np.ndarray) -> Inverted:
        """Return the pressures within the sampled range that come nearest to ``theta`` (B, 3), and what they miss.

        Notes
        -----
        The inverse network gives a start; a few damped Gauss-Newton steps on f_SP, held in the range, take away its
        error. A step that does not come nearer ends the search. Joints out of reach get the nearest that is in reach
        (in units of the scaler), and the miss says so.
        """
        wanted = np.ascontiguousarray(np.atleast_2d(theta), dtype=float)
        return Inverted(*_invert_rows(wanted, self.tables))

    def pressure_by_network(self, theta: np.ndarray) -> np.ndarray:
        """Return what the inverse network alone says, (B, n) Pa: as fast as a network, less exact."""
        scaled = network(self._inverse, self._joints.scale(np.asarray(theta, dtype=float)))
        return self._pressure.unscale(np.clip(scaled, self._low, self._high))


def tables_of(surrogate: Surrogate) -> MapTables:
    """Return the arrays of f_SP and its inverse as compiled code takes them."""
    s = surrogate
    low, high = ((limit - s.pressure_mean) / s.pressure_spread for limit in (s.pressure_low, s.pressure_high))
    scalers = (s.pressure_mean, s.pressure_spread, s.joint_mean, s.joint_spread, low, high)
    return MapTables(network_of(s.forward), network_of(s.inverse), *map(_plain, scalers))


def network_of(weights: dict[str, np.ndarray]) -> Network:
    """Return the arrays ``skip``, ``weight_i`` and ``bias_i`` in order, contiguous, in double precision."""
    layers = range(sum(name.startswith("weight_") for name in weights))
    return Network(
        _plain(weights["skip"]),
        tuple(_plain(weights[f"weight_{i}"]) for i in layers),
        tuple(_plain(weights[f"bias_{i}"]) for i in layers),
    )


def _plain(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, dtype=float)


def network(weights: dict[str, np.ndarray], inputs: np.ndarray) -> np.ndarray:
    """Return the outputs (B, k) of a tanh network with a linear path beside it, at scaled inputs (B, n)."""
    layers = sum(name.startswith("weight_") for name in weights)
    hidden = inputs
    for i in range(layers - 1):
        hidden = np.tanh(hidden @ weights[f"weight_{i}"] + weights[f"bias_{i}"])
    return inputs @ weights["skip"] + hidden @ weights[f"weight_{layers - 1}"] + weights[f"bias_{layers - 1}"]


@nb.njit(cache=True)
def evaluate(net: Network, inputs: np.ndarray, slope: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the outputs (k,) at scaled inputs (n,), and, if ``slope``, d outputs / d inputs as (n, k)."""
    n, outputs, layers = len(inputs), net.skip.shape[1], len(net.weights)
    rows = 1 + n if slope else 1  # the value, then its derivative by each input
    now = np.zeros((rows, n))
    for i in range(n):
        now[0, i] = inputs[i]
        if slope:
            now[1 + i, i] = 1.0
    result = np.zeros((rows, outputs))
    for r in range(rows):
        for i in range(n):
            for k in range(outputs):
                result[r, k] += now[r, i] * net.skip[i, k]
    for layer in range(layers):
        weight, bias = net.weights[layer], net.biases[layer]
        after = np.zeros((rows, weight.shape[1]))
        for r in range(rows):
            for i in range(weight.shape[0]):
                for k in range(weight.shape[1]):
                    after[r, k] += now[r, i] * weight[i, k]
        after[0] += bias
        if layer < layers - 1:
            for k in range(weight.shape[1]):
                after[0, k] = np.tanh(after[0, k])
                fall = 1.0 - after[0, k] ** 2
                for r in range(1, rows):
                    after[r, k] *= fall
        now = after
    result += now
    return result[0], result[1:]


@nb.njit(cache=True)
def _beyond(within: np.ndarray, left: np.ndarray, net: Network) -> np.ndarray:
    """Return what the slopes at ``within`` (B, n) add to the outputs (B, k) over the rest of the way, ``left`` (B, n)."""
    added = np.zeros((len(within), net.skip.shape[1]))
    for b in range(len(within)):
        if np.any(left[b] != 0.0):
            added[b] = left[b] @ evaluate(net, within[b], True)[1]
    return added


@nb.njit(cache=True)
def invert_joints(theta: np.ndarray, tables: MapTables) -> tuple[np.ndarray, np.ndarray]:
    """Return the pressures (n,) Pa and their joints' miss (3,) for wanted joints ``theta`` (3,)."""
    low, high, n = tables.low, tables.high, len(tables.low)
    target = (theta - tables.joint_mean) / tables.joint_spread
    found = np.minimum(np.maximum(evaluate(tables.inverse, target, False)[0], low), high)
    value, slope = evaluate(tables.forward, found, True)
    error = value - target
    for _ in range(POLISH_STEPS):
        if error @ error < POLISHED:
            break
        gradient = slope @ error
        normal = slope @ slope.T
        for j in range(n):  # a pressure at its limit is held, so that the others solve a problem of their own
            if (found[j] <= low[j] and gradient[j] > 0.0) or (found[j] >= high[j] and gradient[j] < 0.0):
                normal[j, :] = 0.0
                normal[:, j] = 0.0
                gradient[j] = 0.0
            normal[j, j] += DAMPING
        trial = np.minimum(np.maximum(found - np.linalg.solve(normal, gradient), low), high)
        value, trial_slope = evaluate(tables.forward, trial, True)
        trial_error = value - target
        if trial_error @ trial_error >= error @ error:
            break
        found, error, slope = trial, trial_error, trial_slope
    return found * tables.pressure_spread + tables.pressure_mean, error * tables.joint_spread


@nb.njit(cache=True)
def _invert_rows(theta: np.ndarray, tables: MapTables) -> tuple[np.ndarray, np.ndarray]:
    pressure, miss = np.empty((len(theta), len(tables.low))), np.empty((len(theta), len(tables.joint_mean)))
    for b in range(len(theta)):
        pressure[b], miss[b] = invert_joints(theta[b], tables)
    return pressure, miss
