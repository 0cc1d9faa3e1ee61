"""What a run that does not begin at rest was under before its first sample, read from where it was first seen."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from softrl.core.polynomial import Basis, basis, count
from softrl.diagnosis.checks.quality import motion_of
from softrl.recordings.check import driven
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

LAGS_S = (0.0, 0.1, 0.3, 1.0)  # with which motion may follow its pressures, for the map that follows it best
ROWS = 2000  # of a session that the map is fitted to
SHRINK = 1e-3  # of the mean square response: pressures that hardly move the tip are left as they were
TRUSTED = 0.3  # share of the motion that the map must explain
DEGREES = (1, 2, 3)  # of the map
TERM_ROWS = 2  # for each term of the map at least
USUAL = 0.95  # of rows miss their map by less than what is told from none
STILL_S, STILL = 0.5, 0.1  # a tip that moves by less, in shares of the way, in so long a time is not under way


class Response(NamedTuple):
    """A polynomial from pressures to motion.

    Attributes
    ----------
    scale : Pa, over which pressures are its variables
    terms : its monomials
    numbers : (monomials, n) their coefficients
    spread : (monomials, monomials) covariance of these, where rows err by one
    error : what rows usually err by
    """

    scale: float
    terms: Basis
    numbers: np.ndarray
    spread: np.ndarray
    error: float

    def missing(self, pressure: np.ndarray, motion: np.ndarray) -> np.ndarray:
        """Return how far (n,) ``motion`` (n,) is from where ``pressure`` (chambers,) holds it."""
        return np.asarray(motion - self._values(pressure) @ self.numbers)

    def may_hold(self, pressure: np.ndarray, motion: np.ndarray) -> bool:
        """Return whether ``motion`` (n,) is where ``pressure`` (chambers,) holds it, for all that the map knows."""
        values = self._values(pressure)
        error = self.error * np.sqrt(1.0 + values @ self.spread @ values)
        return bool(np.linalg.norm(self.missing(pressure, motion)) < error)

    def _values(self, pressure: np.ndarray) -> np.ndarray:
        return self.terms.values(pressure[None] / self.scale)[0]


def preludes(
    training: Sequence[Recording], runs: Sequence[Recording], robot: Robot, one_frame: bool = False
) -> dict[str, tuple[float, ...]]:
    """Return by run the constant pressures (chambers,) Pa that bring the tip where the run's first sample shows it.

    A run that begins while a chamber fills is not yet where its first pressures would hold it, and one that was driven
    before is not yet back. From the first sample alone, and a map from pressures to motion that is fitted to the training
    runs of the same session, follows the constant pressure which stands for that past: the run's first one, or none, where
    the map cannot tell. The map is a polynomial: rest is at a corner of the pressures' range, which a plane misses.

    Where all sessions have ``one_frame``, one map of all training runs tells of sessions without a map of their own, such as
    those that were held out whole; else their runs are left out. Something may have held the tip elsewhere in these: who
    stands still there is not under way.
    """
    found: dict[str, tuple[float, ...]] = {}
    moved = list(driven(training, robot))
    limits = robot.pressure_min_pa, robot.pressure_max_pa
    together = _response(training, moved, robot) if one_frame else None
    for session in dict.fromkeys(run.session for run in (*training, *runs)):
        own = _response([run for run in training if run.session == session], moved, robot)
        response = own or together
        if response is None:
            continue
        for run in (run for run in runs if run.session == session):
            before = np.clip(acting(run)[0], *limits)
            if own is not None or not _stands(run, motion_of(run, robot), response, before[moved]):
                before[moved] = _before(response, before[moved], motion_of(run, robot)[0], limits)
            found[run.name] = tuple(float(p) for p in before)
    return found


def _stands(run: Recording, motion: np.ndarray, response: Response, first: np.ndarray) -> bool:
    """Return whether ``motion`` (steps, n) hardly goes on under the ``first`` pressures (chambers,) Pa to where they hold it."""
    changes = np.any(run.pressure_cmd != run.pressure_cmd[0], axis=1)
    end = int(np.argmax(changes)) if changes.any() else len(motion)
    end = min(end, int(np.searchsorted(run.time, run.time[0] + max(LAGS_S))))
    if end < 2 or run.time[end - 1] - run.time[0] < STILL_S:
        return False
    moved = motion[end // 2 : end].mean(axis=0) - motion[: end // 2].mean(axis=0)
    return bool(np.linalg.norm(moved) < STILL * np.linalg.norm(response.missing(first, motion[0])))


def _before(response: Response, first: np.ndarray, motion: np.ndarray, limits: tuple[float, float]) -> np.ndarray:
    """Return the constant pressures (chambers,) Pa under which the tip was where it was seen first, ``motion`` (n,)."""
    rest = np.full_like(first, np.clip(0.0, *limits))
    plain = min((first, rest), key=lambda p: float(np.linalg.norm(response.missing(p, motion))))
    if response.may_hold(plain, motion):
        return plain
    slopes = response.numbers[1 : 1 + len(first)]
    held = np.sqrt(SHRINK * np.sum(slopes**2) / len(first))

    def left(x: np.ndarray) -> np.ndarray:
        return np.concatenate([response.missing(response.scale * x, motion), held * (x - start)])

    start = first / response.scale
    found = least_squares(left, start, bounds=tuple(limit / response.scale for limit in limits))
    return np.asarray(response.scale * found.x)


def acting(run: Recording) -> np.ndarray:
    """Return the pressures (steps, chambers) Pa that are known to act: measured, or else commanded."""
    return run.pressure_cmd if run.pressure_meas is None else run.pressure_meas


def _response(runs: Sequence[Recording], moved: list[int], robot: Robot) -> Response | None:
    """Return the map from the pressures ``moved`` that explains most, as they are or behind a lag; None if it is little.

    What a run was under before is not known, so its beginning tells nothing of the map.
    """
    if not runs:
        return None
    rows = np.flatnonzero(np.concatenate([run.time - run.time[0] >= max(LAGS_S) for run in runs]))
    rows = rows[:: max(len(rows) // ROWS, 1)]
    degrees = [degree for degree in DEGREES if len(rows) >= TERM_ROWS * count(len(moved), degree)]
    if not (moved and degrees):
        return None
    y = np.concatenate([motion_of(run, robot) for run in runs])[rows]
    found, least = None, (1.0 - TRUSTED) * float(np.sum(np.var(y, axis=0)))
    for lag_s in LAGS_S:
        pressure = np.concatenate([_lagged(run, acting(run)[:, moved], lag_s) for run in runs])[rows]
        for degree in degrees:
            response, left = _fitted(pressure, y, basis(len(moved), degree))
            if left <= least:
                found, least = response, left
    return found


def _fitted(pressure: np.ndarray, motion: np.ndarray, terms: Basis) -> tuple[Response, float]:
    """Return the map of ``terms`` and the mean square that it leaves, made up for the numbers that are fitted."""
    scale = float(np.abs(pressure).max()) or 1.0
    x = terms.values(pressure / scale)
    numbers = np.linalg.lstsq(x, motion, rcond=SHRINK)[0]
    missing = np.linalg.norm(motion - x @ numbers, axis=1) * np.sqrt(len(x) / (len(x) - terms.monomials))
    spread = np.linalg.pinv(x.T @ x, rcond=SHRINK**2)
    return Response(scale, terms, numbers, spread, float(np.quantile(missing, USUAL))), float(np.mean(missing**2))


def _lagged(run: Recording, pressure: np.ndarray, lag_s: float) -> np.ndarray:
    """Return ``pressure`` (steps, n) behind a first-order lag, from where it begins."""
    if lag_s == 0.0:
        return pressure
    keep = float(np.exp(-np.median(np.diff(run.time)) / lag_s))
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], pressure, axis=0, zi=keep * pressure[:1])[0])
