"""A sensor that is read less often than it is recorded."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, NamedTuple

import numba as nb
import numpy as np

from softrl.core.compiled import standing_as
from softrl.core.identity import Same
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

SCANNED = 1000  # samples of each run, from its start, on which all periods are tried
READ = 100_000  # the same on which those near the best are: more would tell it no better than a fit needs to begin
FINEST = 1.15  # median times between samples: a shorter period does not show
PAUSE = 2.5  # the same for a time between samples in which any sensor moves further
BRIEF = 0.5  # the same for one so short that noise alone would seem to be fast
NEXT = 0.5  # by which the last reading moves between two periods that are tried, in samples
NEAR, FINER = 2.0, 0.2  # steps either side of the best that are tried again on whole runs, by how much finer
PHASES = 8  # times of a reading that are tried within an interval between samples
FINE = 1000  # the same where the period is known
NEARLY = 0.99  # of the best coincidence: the middle of the periods, or phases, that reach it is taken
TELLS = 0.15  # correlation of changes with readings above which a period is taken to be one
CHANCE = 5.0  # and this many times what chance gives it, for very many periods are tried
BESIDE = 0.5  # of that correlation: what coincides more with the samples beside the readings is no jump
HELD_SHARE = 0.3  # of the samples, which repeat the one before to the last digit where a sensor is slower
KEPT_RUNS, KEPT_PHASES = 128, 256  # recordings whose changes are kept, and phases: columns of a Jacobian share them
FIRST = -1e12  # number of the reading before the first


@standing_as(SIGNAL_KERNEL)
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
    equation number checked). A camera that runs freely is anywhere in its period by then: where a recording is compared,
    readings are taken when it shows them, see ``reading_phase``.
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

    def taken_at(self, time: np.ndarray, phase_s: float = 0.0) -> np.ndarray:
        """Return the time (steps,) s of the last reading, where one is taken ``phase_s`` after the first sample."""
        if self.period_s <= 0.0:
            return time
        return np.asarray(phase_s + self.period_s * np.floor((time - phase_s) / self.period_s + 1e-6))

    @classmethod
    def seen_in(cls, runs: Sequence[Recording], longest_s: float) -> list[dict[str, float]]:
        """Return the period at which the motion jumps and rests in between, if it does in ``runs``."""
        period = reading_period([(run.time, _motion(run)) for run in runs])
        return [] if period is None else [{"period_s": period}]


def _motion(run: Recording) -> np.ndarray:
    return np.asarray(run.position if run.position is not None else np.asarray(run.bend_angle)[:, None])


def reading_period(series: Sequence[tuple[np.ndarray, np.ndarray]]) -> float | None:
    """Return the period, s, at which series of (times (steps,) s, values (steps, n)) change, None if there is none.

    Periods are tried so closely that the last reading falls between the same samples for one of them, and the one is
    taken whose readings coincide best with changes of the values. In every series the first reading may come at any time: a
    camera that runs freely is somewhere in its period when a recording begins.
    """
    series = [(time, values) for time, values in series if len(time) > PAUSE]
    whole, part = _Changes.of(series, READ), _Changes.of(series, SCANNED)
    if whole is None or part is None:
        return None
    low, high = FINEST * whole.sample_s, float(Hold.__dataclass_fields__["period_s"].metadata["high"])
    if low >= high:
        return None
    best = part.best(low, high, NEXT)
    if not part.shows(best, part.phases(best)):
        return None
    wide = NEAR * NEXT * part.sample_s / part.longest_s
    return whole.best(best * (1.0 - wide), best * (1.0 + wide), FINER * NEXT)


class Phase(NamedTuple):
    """When a slow sensor is read, s after a run's first sample: at the latest, and by how much earlier at most, s."""

    latest_s: float
    open_s: float


@lru_cache(maxsize=KEPT_PHASES)
def reading_phase(same: Same[Recording], period_s: float) -> Phase:
    """Return when a slow sensor that is read every ``period_s`` was read in a recording.

    It is read off the motion as it was measured; at the first sample where that shows no such readings.
    """
    changes = _changes_of(same)
    found = None if changes is None or period_s < FINEST * changes.sample_s else changes.phase(period_s)
    return found or Phase(0.0, 0.0)


@lru_cache(maxsize=KEPT_RUNS)
def _changes_of(same: Same[Recording]) -> "_Changes | None":
    """Return the changes of a recording's motion, kept: fits ask for its phase at very many periods."""
    run = same.thing
    seen = run.position is not None or run.bend_angle is not None
    return _Changes.of([(run.time, _motion(run))], READ) if seen and len(run.time) > PAUSE else None


@dataclass(frozen=True)
class _Changes:
    """Changes between samples of all runs, about each run's mean, and when each begins and ends, s since its first sample.

    All are (changes,) arrays, without those across pauses, in which any sensor moves further, and without what comes so late
    that the periods tried would have to be much closer; sizes for equal times. ``runs`` (runs + 1,) is where those of each run
    begin.
    """

    begin: np.ndarray
    end: np.ndarray
    sizes: np.ndarray
    runs: np.ndarray
    sample_s: float
    longest_s: float

    @classmethod
    def of(cls, series: Sequence[tuple[np.ndarray, np.ndarray]], most: int) -> "_Changes | None":
        """Return the changes of the first ``most`` samples of each of ``series``, None if nothing changes."""
        if not series:
            return None
        series = [(time[:most], values[:most]) for time, values in series]
        begin = np.concatenate([time[:-1] - time[0] for time, _ in series])
        end = np.concatenate([time[1:] - time[0] for time, _ in series])
        # their size, not its square: a few fast motions would outweigh all others
        sizes = np.concatenate([np.linalg.norm(np.diff(values, axis=0), axis=1) for _, values in series])
        if np.mean(sizes == 0.0) > HELD_SHARE:  # readings stand between others: when, not how far, tells them
            sizes = (sizes > 0.0).astype(float)
        sample = float(np.median(end - begin))
        kept = (end - begin < PAUSE * sample) & (end < PAUSE * sample * most)
        sizes /= np.maximum(end - begin, BRIEF * sample) / sample  # what takes longer moves further, and holds more readings
        if not kept.any() or not np.ptp(sizes[kept]):
            return None
        run = np.repeat(np.arange(len(series)), [len(time) - 1 for time, _ in series])[kept]
        count = np.bincount(run, minlength=len(series))
        mean = np.bincount(run, sizes[kept], len(series)) / np.maximum(count, 1)
        runs = np.r_[0, np.cumsum(count)]
        return cls(begin[kept], end[kept], sizes[kept] - mean[run], runs, sample, float(end[kept].max()))

    def best(self, low: float, high: float, apart: float) -> float:
        """Return the period of ``low`` to ``high`` whose readings coincide best with the changes.

        Between two periods that are tried the last reading moves by ``apart`` samples. Where readings keep pace with samples
        a range of periods does equally well, and its middle is taken.
        """
        count = int(np.log(high / low) * self.longest_s / (apart * self.sample_s)) + 2
        periods = np.geomspace(low, high, count)
        met = np.array([self.coincidence(period) for period in periods.tolist()])
        first, last = _nearly_best(met)
        return float(0.5 * (periods[first] + periods[last]))

    def coincidence(self, period: float) -> float:
        """Return the correlation of the changes with whether a reading falls between their samples, at the best phases."""
        _, total, count = self._best(period)
        return self._correlation(total, count)

    def phases(self, period: float) -> np.ndarray:
        """Return when (runs,) s after the first sample of each run readings coincide best with its changes."""
        return self._best(period)[0]

    def shows(self, period: float, phases: np.ndarray) -> bool:
        """Return whether the motion jumps at readings with these ``phases`` (runs,) s, and more than by chance.

        The best of many phases is good by chance in every run. A motion that is swift at times, after each step of a command,
        is so at the samples beside them, too.
        """
        met = self._at(period, phases)
        lucky = math.sqrt(2.0 * np.count_nonzero(np.diff(self.runs)) * math.log(2.0 * period / self.sample_s))
        if met < max(TELLS, (CHANCE + lucky) / math.sqrt(len(self.sizes))):
            return False
        beside = max(self._at(period, phases - self.sample_s), self._at(period, phases + self.sample_s))
        return period < 2.0 * self.sample_s or beside <= BESIDE * met

    def phase(self, period: float) -> Phase | None:
        """Return when readings of a single run are taken, None where none are seen.

        All phases that do nearly as well have their middle where the best alone would jump about as a fit moves the period.
        Readings that keep pace with the samples may come at any time in the interval before the sample that first shows them.
        """
        met, _ = _met(period, self.begin, self.end, self.sizes, math.ceil(FINE * period / self.sample_s))
        turned = len(met) // 2 - int(np.argmax(met))
        middle = (0.5 * (sum(_nearly_best(np.roll(met, turned))) + 1) - turned) / len(met) * period
        before = period * np.floor((self.end - middle) / period)
        read = self._read(period, middle)
        if not read.any():
            return None
        latest, earliest = float(np.min((self.end - before)[read])), float(np.max((self.begin - before)[read]))
        return Phase(latest, max(latest - earliest, 0.0)) if self.shows(period, np.array([latest])) else None

    def _best(self, period: float) -> tuple[np.ndarray, float, int]:
        tried = math.ceil(PHASES * period / self.sample_s)
        return _best_phases(period, self.begin, self.end, self.sizes, self.runs, tried)

    def _at(self, period: float, phases: np.ndarray) -> float:
        """Return the correlation of the changes with whether a reading falls between their samples, at ``phases`` (runs,) s."""
        read = self._read(period, np.repeat(phases, np.diff(self.runs)))
        return self._correlation(float(self.sizes[read].sum()), int(np.count_nonzero(read)))

    def _read(self, period: float, phase: np.ndarray | float) -> np.ndarray:
        """Return whether (changes,) a reading falls between their samples."""
        begin, end = (np.floor((time - phase) / period + 1e-6) for time in (self.begin, self.end))
        return np.asarray(end > begin)

    def _correlation(self, total: float, count: int) -> float:
        """Return the correlation of the sizes with being one of ``count`` changes whose sizes add up to ``total``."""
        share = count / len(self.sizes)
        power = float(self.sizes @ self.sizes) * len(self.sizes) * share * (1.0 - share)
        return total / math.sqrt(power) if power > 0.0 else 0.0


def _nearly_best(values: np.ndarray) -> tuple[int, int]:
    """Return the first and the last of ``values`` (n,) around the largest that are nearly as large."""
    best = int(np.argmax(values))
    less = np.flatnonzero(values < NEARLY * values[best])
    after = int(np.searchsorted(less, best))
    return int(less[after - 1]) + 1 if after else 0, int(less[after]) - 1 if after < len(less) else len(values) - 1


@nb.njit(cache=True, nogil=True)
def _met(
    period: float, begin: np.ndarray, end: np.ndarray, sizes: np.ndarray, tried: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the sum and the number of the changes between whose samples a reading falls, for ``tried`` phases of one run.

    Those of one change follow one another: it is noted where they begin and end. Beyond the last it goes on at the first.
    """
    size, number = np.zeros(2 * tried + 1), np.zeros(2 * tried + 1, dtype=np.int64)
    for i in range(len(sizes)):
        first = math.floor(begin[i] / period * tried - 0.5) + 1
        after = min(math.floor(end[i] / period * tried - 0.5) + 1, first + tried)
        back = tried * (first // tried)
        size[first - back] += sizes[i]
        size[after - back] -= sizes[i]
        number[first - back] += 1
        number[after - back] -= 1
    size, number = np.cumsum(size), np.cumsum(number)
    return size[:tried] + size[tried : 2 * tried], number[:tried] + number[tried : 2 * tried]


@nb.njit(cache=True, nogil=True)
def _best_phases(
    period: float, begin: np.ndarray, end: np.ndarray, sizes: np.ndarray, runs: np.ndarray, tried: int
) -> tuple[np.ndarray, float, int]:
    """Return the best phase (runs,) s of every run, and the sum and number of the changes between whose samples readings fall."""
    phases, total, count = np.empty(len(runs) - 1), 0.0, 0
    for run in range(len(runs) - 1):
        own = slice(runs[run], runs[run + 1])
        size, number = _met(period, begin[own], end[own], sizes[own], tried)
        best = np.argmax(size)
        phases[run] = (best + 0.5) / tried * period
        total += size[best]
        count += number[best]
    return phases, total, count
