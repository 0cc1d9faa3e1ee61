"""What a run that does not begin at rest was under before its first sample, read from where it was first seen."""

from collections.abc import Sequence
from itertools import combinations_with_replacement, product
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from softrl.recordings.check import driven
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

LAGS_S = (0.0, 0.1, 0.3, 1.0)  # with which motion may follow its pressures, for the map that follows it best
ROWS = 2000  # of a session that the map is fitted to
SHRINK = 1e-3  # of the mean square response: pressures that hardly move the tip are left as they were
TRUSTED = 0.3  # share of the motion that the map must explain
DEGREES = (1, 2, 3)  # of the map
TERM_ROWS = 2  # rows for each number of a map beyond the affine one
USUAL = 0.95  # of rows miss their map by less than what is told from none


class Response(NamedTuple):
    """A map from pressures over ``scale`` to motion: ``numbers`` (terms, n), their unit covariance, and the usual error."""

    scale: float
    degree: int
    numbers: np.ndarray
    spread: np.ndarray
    error: float

    def missing(self, pressure: np.ndarray, motion: np.ndarray) -> np.ndarray:
        """Return how far (n,) ``motion`` (n,) is from where ``pressure`` (chambers,) holds it."""
        return np.asarray(motion - self._terms(pressure) @ self.numbers)

    def may_hold(self, pressure: np.ndarray, motion: np.ndarray) -> bool:
        """Return whether ``motion`` (n,) is where ``pressure`` (chambers,) holds it, for all that the map knows."""
        terms = self._terms(pressure)
        return bool(np.linalg.norm(self.missing(pressure, motion)) < self.error * np.sqrt(1.0 + terms @ self.spread @ terms))

    def _terms(self, pressure: np.ndarray) -> np.ndarray:
        return np.asarray(_terms(pressure[None] / self.scale, self.degree)[0])


def preludes(training: Sequence[Recording], runs: Sequence[Recording], robot: Robot) -> dict[str, tuple[float, ...]]:
    """Return by run the constant pressures (chambers,) Pa that bring the tip where the run's first sample shows it.

    A run that begins while a chamber fills is not yet where its first pressures would hold it, and one that was driven
    before is not yet back. From the first sample alone, and an affine map from pressures to motion that is fitted to the
    training runs of the same session, follows the constant pressure which stands for that past: the run's first one, or
    none, where the map cannot tell. Runs of sessions without such a map are left out.
    """
    found: dict[str, tuple[float, ...]] = {}
    moved = list(driven(training, robot))
    limits = robot.pressure_min_pa, robot.pressure_max_pa
    for session in dict.fromkeys(run.session for run in training):
        response = _response([run for run in training if run.session == session], moved)
        if response is None:
            continue
        for run in (run for run in runs if run.session == session):
            before = np.clip(acting(run)[0], *limits)
            before[moved] = _before(response, before[moved], _motion(run)[0], limits)
            found[run.name] = tuple(float(p) for p in before)
    return found


def _before(response: Response, first: np.ndarray, motion: np.ndarray, limits: tuple[float, float]) -> np.ndarray:
    """Return the constant pressures (chambers,) Pa under which the tip was where it was seen first, ``motion`` (n,)."""
    plain = min((first, np.zeros_like(first)), key=lambda p: float(np.linalg.norm(response.missing(p, motion))))
    if response.may_hold(plain, motion):
        return plain
    slopes = response.numbers[1 : 1 + len(first)]
    held = np.sqrt(SHRINK * np.sum(slopes**2) / len(first))

    def left(x: np.ndarray) -> np.ndarray:
        return np.concatenate([response.missing(response.scale * x, motion), held * (x - start)])

    start = first / response.scale
    found = least_squares(left, start, bounds=(limits[0] / response.scale, limits[1] / response.scale))
    return np.asarray(response.scale * found.x)


def acting(run: Recording) -> np.ndarray:
    """Return the pressures (steps, chambers) Pa that are known to act: measured, or else commanded."""
    return run.pressure_cmd if run.pressure_meas is None else run.pressure_meas


def _response(runs: Sequence[Recording], moved: list[int]) -> Response | None:
    """Return the map from the pressures ``moved`` that explains most, as they are or behind a lag; None if it is little.

    What a run was under before is not known, so its beginning tells nothing of the map.
    """
    rows = np.flatnonzero(np.concatenate([run.time - run.time[0] >= max(LAGS_S) for run in runs]))
    rows = rows[:: max(len(rows) // ROWS, 1)]
    y = np.concatenate([_motion(run) for run in runs])[rows]
    found, least = None, (1.0 - TRUSTED) * float(np.sum(np.var(y, axis=0)))
    for lag_s, degree in product(LAGS_S, DEGREES):
        pressure = np.concatenate([_lagged(run, acting(run)[:, moved], lag_s) for run in runs])[rows]
        response = _fitted(pressure, y, degree)
        if response is not None and response[1] <= least:
            found, least = response
    return found


def _fitted(pressure: np.ndarray, motion: np.ndarray, degree: int) -> tuple[Response, float] | None:
    """Return the map of ``degree`` and the mean square that it leaves; None where there are too few rows for it."""
    scale = float(np.abs(pressure).max(initial=0.0)) or 1.0
    x = _terms(pressure / scale, degree)
    rows, terms = x.shape
    if rows <= terms or (degree > 1 and rows < TERM_ROWS * terms):
        return None
    numbers = np.linalg.lstsq(x, motion, rcond=SHRINK)[0]
    missing = np.linalg.norm(motion - x @ numbers, axis=1) * np.sqrt(rows / (rows - terms))
    spread = np.linalg.pinv(x.T @ x, rcond=SHRINK**2)
    return Response(scale, degree, numbers, spread, float(np.quantile(missing, USUAL))), float(np.mean(missing**2))


def _terms(x: np.ndarray, degree: int) -> np.ndarray:
    """Return the monomials up to ``degree`` of ``x`` (rows, n), those of a lower degree first: (rows, terms)."""
    columns = [c for d in range(degree + 1) for c in combinations_with_replacement(range(x.shape[1]), d)]
    return np.stack([np.prod(x[:, c], axis=1) for c in columns], axis=1)


def _lagged(run: Recording, pressure: np.ndarray, lag_s: float) -> np.ndarray:
    """Return ``pressure`` (steps, n) behind a first-order lag, from where it begins."""
    if lag_s == 0.0:
        return pressure
    keep = float(np.exp(-np.median(np.diff(run.time)) / lag_s))
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], pressure, axis=0, zi=keep * pressure[:1])[0])


def _motion(run: Recording) -> np.ndarray:
    return np.asarray(run.position if run.position is not None else np.asarray(run.bend_angle)[:, None])
