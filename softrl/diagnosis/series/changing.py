"""What follows the pressures, but not always in the same way: warmth that comes and goes, a valve that sticks at times."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softrl.diagnosis.series.noise import apart, redrawn

WINDOW_S = 6.0  # in which it is taken to follow them in one way
TURN = 1e-6  # of the largest singular value of a window's pressures: less is no motion of theirs


class Changing(NamedTuple):
    """How plainly a series follows the pressures within windows: the chance of it in noise, and the share of its power."""

    p_value: float
    share: float


def follows_at_times(
    runs: Sequence[np.ndarray], drives: Sequence[np.ndarray], window: int, draws: int, rng: np.random.Generator
) -> Changing:
    """Return how plainly ``runs`` (steps, n) follow ``drives`` (steps, m) within windows of ``window`` steps.

    Notes
    -----
    In every window the series is regressed on the drives, and the squares so explained are summed over all windows. The
    same is done with noise of the series' own spectrum, drawn anew: a Monte Carlo test.
    """
    runs = apart(runs)
    bases = [_bases(drive, window) for drive in drives]
    whole = sum(float(np.sum(run**2)) for run in runs)

    def explained(series: Sequence[np.ndarray]) -> float:
        pairs = (pair for run, basis in zip(series, bases, strict=True) for pair in zip(_cut(run, window), basis, strict=True))
        return sum(float(np.sum((basis.T @ (part - part.mean(axis=0))) ** 2)) for part, basis in pairs)

    found = explained(runs)
    drawn = np.array([explained([redrawn(run, rng) for run in runs]) for _ in range(draws)])
    chance = float(drawn.mean())  # of the rest, too, so much is explained
    share = max(found - chance, 0.0) / max(whole - chance, 1e-300)
    return Changing(float((1.0 + np.sum(drawn >= found)) / (draws + 1.0)), min(share, 1.0))


def _cut(series: np.ndarray, window: int) -> list[np.ndarray]:
    """Return ``series`` (steps, n) in parts of at least ``window`` steps."""
    return np.array_split(series, max(len(series) // window, 1))


def _bases(drive: np.ndarray, window: int) -> list[np.ndarray]:
    """Return for every part of ``drive`` (steps, m) an orthonormal basis (steps, q) of its motion."""
    found = []
    for part in _cut(drive, window):
        basis, size, _ = np.linalg.svd(part - part.mean(axis=0), full_matrices=False)
        found.append(basis[:, size > TURN * max(float(size[0]), 1e-300)])
    return found
