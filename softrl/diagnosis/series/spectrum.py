"""A line in a spectrum that is smooth else."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

MIN_FREQUENCIES = 32  # fewer do not show whether a spectrum is smooth
NEAR, FAR = 4, 16  # frequencies whose power says how high a spectrum is around one: farther than a line is wide
DRIVEN_LEVEL = 1e-3  # chance of a peak in a drive's spectrum that marks a frequency as driven
EULER = 0.5772  # mean of minus the logarithm of an exponential variable


class Line(NamedTuple):
    """The highest peak: the chance that noise with a smooth spectrum shows one as high, and its cycles a step."""

    chance: float
    cycles: float


def spectral_line(runs: Sequence[np.ndarray], drives: Sequence[np.ndarray]) -> Line:
    """Return the highest peak in the spectra of ``runs`` (steps, n).

    Frequencies at which the ``drives`` (steps, m) of the same runs swing themselves are left out.

    Notes
    -----
    The logarithm of each periodogram, along the direction of largest power, is fitted by a cubic in the logarithm of
    the frequency; about a smooth spectrum the ratio to it is exponential. A peak has to stand out from the median of its
    neighbours as well, for a cubic does not follow a spectrum that falls onto a floor. The chance is corrected for the number
    of frequencies and runs looked at (textbook form, no equation number checked).
    """
    lines, count = [Line(1.0, 0.0)], 0
    for run, drive in zip(runs, drives, strict=True):
        if len(run) // 2 - 2 < MIN_FREQUENCIES:
            continue
        centred = run - run.mean(axis=0)
        seen = _periodogram(centred @ np.linalg.svd(centred.T @ centred)[0][:, 0])
        height = np.minimum(_above_smooth(seen), _above_near(seen))
        driven = np.zeros(len(height), dtype=bool)
        for pressure in drive.T:
            if np.ptp(pressure) > 0.0:
                driven |= _above_smooth(_periodogram(pressure - pressure.mean())) > np.log(-np.log(DRIVEN_LEVEL))
        free = np.flatnonzero(~(driven | np.roll(driven, 1) | np.roll(driven, -1)))
        if len(free):
            peak = free[np.argmax(height[free])]
            lines.append(Line(float(np.exp(-np.exp(min(float(height[peak]), 6.0)))), float(peak + 2) / len(run)))
            count += len(free)
    chance, cycles = min(lines)
    return Line(min(1.0, chance * max(count, 1)), cycles)


def _periodogram(series: np.ndarray) -> np.ndarray:
    """Return the logarithm (frequencies,) of the power of ``series`` (steps,), the lowest and the highest left out."""
    return np.asarray(np.log(np.maximum(np.abs(np.fft.rfft(series * np.hanning(len(series)))[2:-1]) ** 2, 1e-300)))


def _above_smooth(height: np.ndarray) -> np.ndarray:
    """Return by how much the periodogram ``height`` (frequencies,) exceeds a cubic."""
    place = np.log(np.arange(2, len(height) + 2))
    smooth = np.polynomial.Polynomial.fit(place, height, 3, w=np.sqrt(1.0 / np.arange(2, len(height) + 2)))
    return np.asarray(height - smooth(place) - EULER)


def _above_near(height: np.ndarray) -> np.ndarray:
    """Return by how much the periodogram ``height`` (frequencies,) exceeds what the median around says of the mean power."""
    beside = np.abs(np.arange(-FAR, FAR + 1)) >= NEAR
    around = sliding_window_view(np.pad(height, FAR, constant_values=np.nan), 2 * FAR + 1)[:, beside]
    return np.asarray(height - np.nanmedian(around, axis=1) + np.log(np.log(2.0)))
