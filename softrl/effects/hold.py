"""A sensor that is read less often than it is recorded."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numba as nb
import numpy as np

from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

SCANNED = 1000  # samples of each run, from its start, on which all periods are tried
FINEST = 1.15  # median times between samples: a shorter period does not show
PAUSE = 2.5  # the same for a time between samples in which any sensor moves further
BRIEF = 0.5  # the same for one so short that noise alone would seem to be fast
NEXT = 0.5  # by which the last reading moves between two periods that are tried, in samples
NEAR, FINER = 2.0, 0.2  # steps either side of the best that are tried again on whole runs, by how much finer
TELLS = 0.15  # correlation of changes with readings above which a period is taken to be one
CHANCE = 6.0  # and this many times what chance gives it, for very many periods are tried
FIRST = -1e12  # number of the reading before the first


@nb.njit(SIGNAL_KERNEL, cache=True)
def hold_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Take a new pose whenever a period begins and repeat it in between; periods are counted from the first sample.

    A period begins between two steps, where the pose is interpolated: the staircase must not depend on the step.
    """
    period, count = parameters[0], len(value)
    if period <= 1e-6 * dt:
        return
    held, last = state[2 : 2 + count], state[2 + count :]
    reading = math.floor(state[0] / period + 1e-6)
    if reading != state[1]:
        late = min(max(state[0] - reading * period, 0.0) / dt, 1.0) if state[1] != FIRST else 0.0
        for i in range(count):
            held[i] = value[i] - late * (value[i] - last[i])
        norm = math.sqrt(held[3] ** 2 + held[4] ** 2 + held[5] ** 2 + held[6] ** 2)
        for i in range(3, 7):
            held[i] /= norm
        state[1] = reading
    state[0] += dt
    for i in range(count):
        last[i] = value[i]
        value[i] = held[i]


@dataclass(frozen=True)
class Hold(Effect):
    """Sample-and-hold of the reported pose: a staircase, half a period late on average.

    Notes
    -----
    Zero-order hold, ``x(t) = pose(period floor(t / period))`` with the time t since the first sample (textbook form, no
    equation number checked).
    """

    site: ClassVar[str] = "sensor"
    title: ClassVar[str] = "sample-and-hold of the pose sensor"
    kernel: ClassVar = hold_kernel
    exact: ClassVar[bool] = True
    sized: ClassVar[bool] = False
    clock: ClassVar = 0

    # a slightly longer period makes the last readings of a run much later: what is plain to see is far below the period
    period_s: float = parameter("s", 0.0, 1.0, 0.0, typical=0.15, scale=1e-4)

    def reset(self, robot: Robot) -> np.ndarray:
        """Return the time since the first sample, the number of the reading, the pose held and that of the step before."""
        return np.array([0.0, FIRST, *np.zeros(14)])

    def taken_at(self, time: np.ndarray) -> np.ndarray:
        """Return the time (steps,) s of the last reading."""
        return self.period_s * np.floor(time / self.period_s + 1e-6) if self.period_s > 0.0 else time

    @classmethod
    def seen_in(cls, runs: Sequence[Recording]) -> list[dict[str, float]]:
        """Return the period at which the motion jumps and rests in between, if it does in ``runs``."""
        period = reading_period([(run.time, _motion(run)) for run in runs])
        return [] if period is None else [{"period_s": period}]


def _motion(run: Recording) -> np.ndarray:
    return np.asarray(run.position if run.position is not None else np.asarray(run.bend_angle)[:, None])


def reading_period(series: Sequence[tuple[np.ndarray, np.ndarray]]) -> float | None:
    """Return the period, s, at which series of (times (steps,) s, values (steps, n)) change, None if there is none.

    Periods are tried so closely that the last reading falls between the same samples for one of them, and the one is
    taken whose readings coincide best with changes of the values.
    """
    whole = _Changes.of([(time, values) for time, values in series if len(time) > PAUSE])
    if whole is None:
        return None
    part = _Changes.of([(time[:SCANNED], values[:SCANNED]) for time, values in series])
    low, high = FINEST * whole.sample_s, float(Hold.__dataclass_fields__["period_s"].metadata["high"])
    if part is None or low >= high:
        return None
    best = part.best(low, high, NEXT)
    if part.coincidence(best) < max(TELLS, CHANCE / math.sqrt(len(part.sizes))):
        return None
    wide = NEAR * NEXT * part.sample_s / part.longest_s
    return whole.best(best * (1.0 - wide), best * (1.0 + wide), FINER * NEXT)


@dataclass(frozen=True)
class _Changes:
    """Changes between samples of all runs, about their mean, and when each begins and ends, s since the run's first sample.

    All are (changes,) arrays, without those across pauses, in which any sensor moves further; sizes for equal times.
    """

    begin: np.ndarray
    end: np.ndarray
    sizes: np.ndarray
    sample_s: float
    longest_s: float

    @classmethod
    def of(cls, series: Sequence[tuple[np.ndarray, np.ndarray]]) -> "_Changes | None":
        """Return the changes of ``series``, None if nothing changes."""
        if not series:
            return None
        begin = np.concatenate([time[:-1] - time[0] for time, _ in series])
        end = np.concatenate([time[1:] - time[0] for time, _ in series])
        # their size, not its square: a few fast motions would outweigh all others
        sizes = np.concatenate([np.linalg.norm(np.diff(values, axis=0), axis=1) for _, values in series])
        sample = float(np.median(end - begin))
        kept = end - begin < PAUSE * sample
        sizes /= np.maximum(end - begin, BRIEF * sample) / sample  # what takes longer moves further, and holds more readings
        if not kept.any() or not np.ptp(sizes[kept]):
            return None
        return cls(begin[kept], end[kept], sizes[kept] - sizes[kept].mean(), sample, float(end.max()))

    def best(self, low: float, high: float, apart: float) -> float:
        """Return the period of ``low`` to ``high`` whose readings coincide best with the changes.

        Between two periods that are tried the last reading moves by ``apart`` samples.
        """
        count = int(np.log(high / low) * self.longest_s / (apart * self.sample_s)) + 2
        return max(np.geomspace(low, high, count).tolist(), key=self.coincidence)

    def coincidence(self, period: float) -> float:
        """Return the correlation of the changes with whether a period begins between their samples."""
        begins = np.floor(self.end / period + 1e-6) > np.floor(self.begin / period + 1e-6)
        share = float(begins.mean())
        if not 0.0 < share < 1.0:
            return 0.0
        power = float(self.sizes @ self.sizes) * len(begins) * share * (1.0 - share)
        return float(self.sizes[begins].sum() / np.sqrt(power))
