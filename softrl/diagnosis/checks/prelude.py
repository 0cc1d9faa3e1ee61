"""What a run that does not begin at rest was under before its first sample, read from where it was first seen."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from softrl.recordings.check import driven
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

LAGS_S = (0.0, 0.1, 0.3, 1.0)  # with which motion may follow its pressures, for the map that follows it best
ROWS = 2000  # of a session that the map is fitted to
SHRINK = 1e-3  # of the mean square response: pressures that hardly move the tip are left as they were
TRUSTED = 0.3  # share of the motion that the map must explain


class Response(NamedTuple):
    """An affine map from pressures to motion: level (n,), slope (chambers, n), and rms of what it does not explain."""

    level: np.ndarray
    slope: np.ndarray
    error: float

    def missing(self, pressure: np.ndarray, motion: np.ndarray) -> np.ndarray:
        """Return how far (n,) ``motion`` (n,) is from where ``pressure`` (chambers,) holds it."""
        return np.asarray(motion - self.level - pressure @ self.slope)


def preludes(training: Sequence[Recording], runs: Sequence[Recording], robot: Robot) -> dict[str, tuple[float, ...]]:
    """Return by run the constant pressures (chambers,) Pa that bring the tip where the run's first sample shows it.

    A run that begins while a chamber fills is not yet where its first pressures would hold it, and one that was driven
    before is not yet back. From the first sample alone, and an affine map from pressures to motion that is fitted to the
    training runs of the same session, follows the constant pressure which stands for that past: the run's first one, or
    none, where the map cannot tell. Runs of sessions without such a map are left out.
    """
    found: dict[str, tuple[float, ...]] = {}
    moved = list(driven(training, robot))
    for session in dict.fromkeys(run.session for run in training):
        response = _affine([run for run in training if run.session == session], moved)
        if response is None:
            continue
        for run in (run for run in runs if run.session == session):
            before = acting(run)[0].copy()
            before[moved] = _before(response, before[moved], _motion(run)[0])
            found[run.name] = tuple(float(p) for p in np.clip(before, robot.pressure_min_pa, robot.pressure_max_pa))
    return found


def _before(response: Response, first: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Return the constant pressures (chambers,) Pa under which the tip was where it was seen first, ``motion`` (n,)."""
    plain = min((first, np.zeros_like(first)), key=lambda p: float(np.linalg.norm(response.missing(p, motion))))
    if np.linalg.norm(response.missing(plain, motion)) < response.error:
        return plain
    stiff = response.slope @ response.slope.T
    inverse = np.linalg.inv(stiff + SHRINK * np.trace(stiff) / len(stiff) * np.eye(len(stiff)))
    return np.asarray(first + inverse @ response.slope @ response.missing(first, motion))


def acting(run: Recording) -> np.ndarray:
    """Return the pressures (steps, chambers) Pa that are known to act: measured, or else commanded."""
    return run.pressure_cmd if run.pressure_meas is None else run.pressure_meas


def _affine(runs: Sequence[Recording], moved: list[int]) -> Response | None:
    """Return the map from the pressures ``moved`` that explains most, as they are or behind a lag; None if it is little."""
    motion = np.concatenate([_motion(run) for run in runs])
    every = max(len(motion) // ROWS, 1)
    level = motion[::every].mean(axis=0)
    y = motion[::every] - level
    found, least = None, (1.0 - TRUSTED) * float(np.sum(y**2))
    for lag_s in LAGS_S:
        pressure = np.concatenate([_lagged(run, acting(run)[:, moved], lag_s) for run in runs])[::every]
        x = pressure - pressure.mean(axis=0)
        slope = np.linalg.lstsq(x, y, rcond=SHRINK)[0]
        left = float(np.sum((y - x @ slope) ** 2))
        if left <= least:
            found, least = Response(level - pressure.mean(axis=0) @ slope, slope, float(np.sqrt(left / len(y)))), left
    return found


def _lagged(run: Recording, pressure: np.ndarray, lag_s: float) -> np.ndarray:
    """Return ``pressure`` (steps, n) behind a first-order lag, from where it begins."""
    if lag_s == 0.0:
        return pressure
    keep = float(np.exp(-np.median(np.diff(run.time)) / lag_s))
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], pressure, axis=0, zi=keep * pressure[:1])[0])


def _motion(run: Recording) -> np.ndarray:
    return np.asarray(run.position if run.position is not None else np.asarray(run.bend_angle)[:, None])
