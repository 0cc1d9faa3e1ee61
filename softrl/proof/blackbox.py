"""A black box of equal data: ridge regressions from filtered pressures to the tip, with or without feedback."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from softrl.recordings.recording import Recording

GRID_S = 0.02
FILTERS_S = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
CURVED = (0, 2, 4)  # filters whose squares and products enter too
RIDGES = (1e-6, 1e-4, 1e-2, 1.0)
FED_BACK = 2  # past outputs that the autoregressive form sees


@dataclass(frozen=True)
class BlackBox:
    """A fitted regression.

    Attributes
    ----------
    weights : (features, 3) m per feature
    scale : (inputs,) Pa, of the pressures
    feedback : past outputs that enter, 0 for none
    """

    weights: np.ndarray
    scale: np.ndarray
    feedback: int

    def predict(self, run: Recording) -> np.ndarray:
        """Return the tip (samples, 3) m simulated freely from the run's commands and its first sample alone."""
        grid = _grid(run)
        inputs = _features(_command(run, grid) / self.scale)
        if self.feedback == 0:
            tip = inputs @ self.weights
        else:
            past, tip = np.tile(_present(run.position)[0], self.feedback), np.empty((len(grid), 3))
            driven, kept = inputs @ self.weights[: inputs.shape[1]], self.weights[inputs.shape[1] :]
            for k in range(len(grid)):
                tip[k] = driven[k] + past @ kept
                past = np.r_[tip[k], past[:-3]]
        tip = np.nan_to_num(tip, nan=1e3, posinf=1e3, neginf=-1e3).clip(-1e3, 1e3)
        return np.stack([np.interp(run.time, grid, column) for column in tip.T], axis=1)


def fit(runs: Sequence[Recording]) -> BlackBox:
    """Return the best of all forms and ridges: chosen on the last of ``runs`` in free simulation, then fitted on all."""
    scale = np.maximum(np.abs(np.concatenate([run.pressure_cmd for run in runs])).max(axis=0), 1.0)
    inner, judge = (runs[:-1], runs[-1]) if len(runs) > 1 else (runs, runs[0])
    choices: list[tuple[float, int, float]] = []
    for feedback in (0, FED_BACK):
        solve = _solver(inner, scale, feedback)
        for ridge in RIDGES:
            apart = BlackBox(solve(ridge), scale, feedback).predict(judge) - _present(judge.position)
            choices.append((float(np.mean(apart**2)), feedback, ridge))
    _, feedback, ridge = min(choices)
    return BlackBox(_solver(runs, scale, feedback)(ridge), scale, feedback)


def _solver(runs: Sequence[Recording], scale: np.ndarray, feedback: int) -> Callable[[float], np.ndarray]:
    rows, targets = [], []
    for run in runs:
        grid = _grid(run)
        tip = np.stack([np.interp(grid, run.time, column) for column in _present(run.position).T], axis=1)
        made = _features(_command(run, grid) / scale)
        past = [np.vstack([np.tile(tip[0], (lag, 1)), tip[:-lag]]) for lag in range(1, feedback + 1)]
        rows.append(np.hstack([made, *past]))
        targets.append(tip)
    x, y = np.concatenate(rows), np.concatenate(targets)
    size = np.sqrt(np.mean(x**2, axis=0)) + 1e-12
    gram, cross = (x / size).T @ (x / size) / len(x), (x / size).T @ y / len(x)
    return lambda ridge: np.linalg.solve(gram + ridge * np.eye(len(gram)), cross) / size[:, None]


def _grid(run: Recording) -> np.ndarray:
    return np.asarray(run.time[0] + GRID_S * np.arange(int(np.ptp(run.time) / GRID_S) + 2))


def _command(run: Recording, grid: np.ndarray) -> np.ndarray:
    return run.pressure_cmd[np.searchsorted(run.time, grid - 1e-6).clip(max=len(run.time) - 1)]


def _features(pressure: np.ndarray) -> np.ndarray:
    """Return one, pressures, their first-order filters, and products of some of these (steps, features)."""
    banks = []
    for tau in FILTERS_S:
        share, state = -np.expm1(-GRID_S / tau), np.zeros(pressure.shape[1])
        bank = np.empty_like(pressure)
        for k, row in enumerate(pressure):
            state = state + share * (row - state)
            bank[k] = state
        banks.append(bank)
    some = np.hstack([banks[k] for k in CURVED])
    i, j = np.triu_indices(some.shape[1])
    return np.hstack([np.ones((len(pressure), 1)), pressure, *banks, some[:, i] * some[:, j]])


def _present(values: np.ndarray | None) -> np.ndarray:
    assert values is not None
    return values
