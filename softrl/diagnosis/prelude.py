"""What a run that does not begin at rest was under before its first sample, read from where it was first seen."""

from collections.abc import Sequence

import numpy as np

from softrl.recordings.check import driven
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

FIRST_SAMPLES = 3  # whose mean says where a run begins
ROWS = 2000  # of a session that the map is fitted to
SHRINK = 1e-3  # of the mean square response: pressures that hardly move the tip are left as they were
TRUSTED = 0.3  # share of the motion that the map must explain


def preludes(training: Sequence[Recording], runs: Sequence[Recording], robot: Robot) -> dict[str, tuple[float, ...]]:
    """Return by run the constant pressures (chambers,) Pa that bring the tip where the run's first samples show it.

    A run that begins while a chamber fills is not yet where its first pressures would hold it, and one that was driven
    before is not yet back. From the first samples alone, and an affine map from pressures to motion that is fitted to the
    training runs of the same session, follows the constant pressure which stands for that past. Runs of sessions without
    such a map are left out.
    """
    found: dict[str, tuple[float, ...]] = {}
    moved = list(driven(training, robot))
    for session in dict.fromkeys(run.session for run in training):
        mine = [run for run in training if run.session == session]
        response = _affine(mine, moved)
        if response is None:
            continue
        level, slope = response
        stiff = slope @ slope.T
        inverse = np.linalg.inv(stiff + SHRINK * np.trace(stiff) / len(stiff) * np.eye(len(stiff)))
        for run in (run for run in runs if run.session == session):
            before = acting(run)[:FIRST_SAMPLES].mean(axis=0)
            missing = _motion(run)[:FIRST_SAMPLES].mean(axis=0) - level - before[moved] @ slope
            before[moved] += inverse @ slope @ missing
            found[run.name] = tuple(float(p) for p in np.clip(before, robot.pressure_min_pa, robot.pressure_max_pa))
    return found


def acting(run: Recording) -> np.ndarray:
    """Return the pressures (steps, chambers) Pa that are known to act: measured, or else commanded."""
    return run.pressure_cmd if run.pressure_meas is None else run.pressure_meas


def _affine(runs: Sequence[Recording], moved: list[int]) -> tuple[np.ndarray, np.ndarray] | None:
    """Return level (n,) and slope (chambers, n) of the motion over the pressures ``moved``; None if it explains little."""
    pressure = np.concatenate([acting(run)[:, moved] for run in runs])
    motion = np.concatenate([_motion(run) for run in runs])
    every = max(len(pressure) // ROWS, 1)
    pressure, motion = pressure[::every], motion[::every]
    x, y = pressure - pressure.mean(axis=0), motion - motion.mean(axis=0)
    slope = np.linalg.lstsq(x, y, rcond=SHRINK)[0]
    if np.sum((y - x @ slope) ** 2) > (1.0 - TRUSTED) * np.sum(y**2):
        return None
    return motion.mean(axis=0) - pressure.mean(axis=0) @ slope, slope


def _motion(run: Recording) -> np.ndarray:
    return np.asarray(run.position if run.position is not None else np.asarray(run.bend_angle)[:, None])
