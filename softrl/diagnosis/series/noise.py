"""Noise of any colour: its memory, and what it would not show, jumps and errors that come with motion."""

from collections.abc import Sequence
from itertools import compress
from typing import NamedTuple

import numpy as np
from scipy import stats
from scipy.ndimage import maximum_filter1d

from softrl.diagnosis.series.least_squares import UNSEEN

MAX_ORDER = 8  # of an autoregression
STILL, AFTER, MANY = 0.02, 4, 8  # share of the largest move, over so many steps: a rest; so many samples of it tell
CALM = 3.0  # times the median size of a sample: noise is seldom larger
BAND = 0.2  # share of a frequency over which the spectrum of noise drawn anew is averaged


def autoregression(runs: Sequence[np.ndarray]) -> np.ndarray:
    """Return the coefficients (order,) of the series' own past, the order chosen by Schwarz's criterion."""
    count = sum(max(len(run) - MAX_ORDER, 0) for run in runs)
    if count < 4 * MAX_ORDER:
        return np.zeros(0)
    past = [
        np.stack([run[MAX_ORDER - k : len(run) - k] for k in range(1, MAX_ORDER + 1)], axis=1)
        for run in runs
        if len(run) > MAX_ORDER
    ]
    x, y = np.concatenate(past), np.concatenate([run[MAX_ORDER:] for run in runs if len(run) > MAX_ORDER])
    best: tuple[float, np.ndarray] = (count * np.log(max(float(y @ y) / count, 1e-300)), np.zeros(0))
    for order in range(1, MAX_ORDER + 1):
        found = np.linalg.lstsq(x[:, :order], y, rcond=None)[0]
        left = y - x[:, :order] @ found
        score = count * np.log(max(float(left @ left) / count, 1e-300)) + order * np.log(count)
        if score < best[0]:
            best = (score, found)
    return best[1]


def whitened(series: np.ndarray, memory: np.ndarray) -> np.ndarray:
    """Return ``series`` (steps,) less what ``memory`` predicts from its past; the first samples are left out, if need be all."""
    left = series[len(memory) :].copy()
    for k, share in enumerate(memory if len(left) else (), start=1):
        left -= share * series[len(memory) - k : len(series) - k]
    return left


def redrawn(series: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return noise (steps, n) of the size and colour of ``series``, as smooth in frequency as within ``BAND`` either way.

    A line in the spectrum would stay one whatever its phase: where the commands swing at its frequency, or at a whole
    part of it, it follows them still.
    """
    lines = np.fft.rfft(series - series.mean(axis=0), axis=0)
    place = np.arange(1, len(lines))
    first, end = np.maximum(place / (1.0 + BAND), 1.0).astype(int), np.ceil(place * (1.0 + BAND)).astype(int) + 1
    end = np.minimum(end, len(lines))
    total = np.cumsum(np.abs(lines) ** 2, axis=0)
    power = (total[end - 1] - total[first - 1]) / (end - first)[:, None]
    drawn = rng.standard_normal((2, *power.shape))
    lines[0], lines[1:] = 0.0, np.sqrt(0.5 * power) * (drawn[0] + 1j * drawn[1])
    made = np.fft.irfft(lines, len(series), axis=0)
    return np.asarray(made * series.std(axis=0) / np.maximum(made.std(axis=0), 1e-300))


def apart(runs: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return ``runs`` (steps, n), each about its mean, along axes on which channels do not go together.

    Noise is drawn channel by channel: what swings along one line would be drawn as several swings that partly cancel.
    """
    about = [run - run.mean(axis=0) for run in runs]
    axes = np.linalg.eigh(sum(run.T @ run for run in about))[1]
    return [run @ axes for run in about]


class Uneven(NamedTuple):
    """How unlike noise a series is: the chance of it in noise, and the share of its power that is in excess.

    In excess of what its quiet samples have, or of what it has where the drives rest or would, whichever is more.
    """

    p_value: float
    share: float


def unlike_noise(
    runs: Sequence[np.ndarray],
    drives: Sequence[np.ndarray],
    draws: int,
    rng: np.random.Generator,
    slopes: Sequence[np.ndarray] = (),
) -> Uneven:
    """Return how uneven ``runs`` (steps, n) are under ``drives`` (steps, m), beside noise of the same memory.

    Uneven in three ways: their innovations have heavy tails, as after jumps, are larger where the drives move more, or than
    where they have stood still: no sensor's noise waits for a command. What parameters with the derivatives ``slopes``
    (steps, n, p) could take up counts as none: a fit to noise leaves them a little off, and what that does is sharp where the
    drives move.

    Notes
    -----
    Innovations are those of an autoregression fitted to the runs, compared with Gaussian ones of the same correlations
    between channels. Of Gaussian channels the median of the summed squares is that of chi-squared with as many degrees of
    freedom as there are ``directions`` (Satterthwaite's form, exact for equal ones; no equation number checked). A small
    chance says that there is structure, not that it is large: every simulator's body leaves some, which the share tells.
    Runs of a few rows tell no spread, and do not count.
    """
    runs, memories = centred(runs)
    telling = [tells(run, memories) for run in runs]
    runs, drives, slopes = (list(compress(series, telling)) for series in (runs, drives, slopes))
    if not runs:
        return Uneven(1.0, 0.0)
    active = [np.abs(np.diff(drive, axis=0, prepend=drive[:1])).sum(axis=1) for drive in drives]
    news = [innovations(run, memories) for run in runs]
    moves = np.concatenate([move[-len(new) :] for move, new in zip(active, news, strict=True)])
    lately = [maximum_filter1d(move, AFTER, origin=(AFTER - 1) // 2)[-len(new) :] for move, new in zip(active, news, strict=True)]
    still = np.concatenate(lately) <= STILL * moves.max(initial=0.0)
    still &= MANY <= still.sum() <= len(still) - MANY
    size = np.concatenate([np.broadcast_to(np.maximum(new.std(axis=0), 1e-150), new.shape) for new in news])
    ends = np.cumsum([len(new) for new in news])[:-1]
    taken = _taken_up([innovations(slope, memories) for slope in slopes], size)

    def squares(new: np.ndarray) -> np.ndarray:
        new = new - (taken @ (taken.T @ new.ravel())).reshape(new.shape)
        parts = np.split(new, ends)
        return np.concatenate([(x - x.mean(axis=0)) ** 2 / np.maximum(x.var(axis=0), 1e-300) for x in parts])

    def uneven(square: np.ndarray) -> np.ndarray:
        power = np.sqrt(square.sum(axis=1))
        slope = np.corrcoef(moves, power)[0, 1] if np.ptp(moves) > 0.0 and np.ptp(power) > 0.0 else 0.0
        waits = power[~still].mean() - power[still].mean() if still.any() else 0.0
        return np.array([np.mean(square**2), slope, waits])

    new = np.concatenate(news) / size
    found = squares(new)
    seen, basis = np.linalg.eigh(new.T @ new / len(new))
    mix = (basis * np.sqrt(np.maximum(seen, 0.0))).T
    drawn = np.array([uneven(squares(rng.standard_normal(new.shape) @ mix)) for _ in range(draws)])
    ranks = (1.0 + np.sum(drawn >= uneven(found), axis=0)) / (draws + 1.0)
    return Uneven(float(min(1.0, len(ranks) * ranks.min())), _in_excess(found, directions(_calm(new)), moves, still))


def directions(series: np.ndarray) -> float:
    """Return in how many independent, equally large directions ``series`` (steps, n) points, in sum as one of that many."""
    spread = series.T @ series
    return float(max(np.trace(spread) ** 2 / max(float(np.sum(spread**2)), 1e-300), 1.0))


def _calm(series: np.ndarray) -> np.ndarray:
    """Return ``series`` (steps, n) with samples larger than ``CALM`` times the median made as large: jumps have their own way."""
    size = np.linalg.norm(series, axis=1)
    return np.asarray(series * np.minimum(1.0, CALM * np.median(size) / np.maximum(size, 1e-300))[:, None])


def _in_excess(square: np.ndarray, channels: float, moves: np.ndarray, still: np.ndarray) -> float:
    """Return the share of the power of ``square`` (steps, n) beyond that of quiet samples, of no ``moves`` (steps,) or rests.

    ``channels`` is how many independent ones there are in it.
    """
    power = square.sum(axis=1)
    quiet = float(np.median(power)) * channels / float(stats.chi2.median(channels))
    change = moves - moves.mean()
    slope = max(float(change @ power) / max(float(change @ change), 1e-300), 0.0)
    rest = min(quiet, float(power.mean() - slope * moves.mean()), float(power[still].mean()) if still.any() else np.inf)
    return float(np.clip(1.0 - rest / max(float(power.mean()), 1e-300), 0.0, 1.0))


def innovations(run: np.ndarray, memories: Sequence[np.ndarray]) -> np.ndarray:
    """Return ``run`` (steps, n, ...) less what each channel's memory predicts; equally many first samples left out."""
    whole = [whitened(run[:, k], memory) for k, memory in enumerate(memories)]
    longest = _longest(memories)
    return np.stack([column[longest - len(m) :] for column, m in zip(whole, memories, strict=True)], axis=1)


def centred(runs: Sequence[np.ndarray]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return ``runs`` (steps, n) each about its mean, and the memory of every channel."""
    about = [run - run.mean(axis=0) for run in runs]
    return about, [autoregression([run[:, k] for run in about]) for k in range(about[0].shape[1])]


def tells(run: np.ndarray, memories: Sequence[np.ndarray]) -> bool:
    """Return whether ``run`` (steps, n) has so many innovations that their spread is known."""
    return len(run) - _longest(memories) >= MANY


def _longest(memories: Sequence[np.ndarray]) -> int:
    return max(len(memory) for memory in memories)


def _taken_up(slopes: Sequence[np.ndarray], size: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis (rows, q) of what parameters with derivatives ``slopes`` (steps, n, p) can do."""
    if not slopes:
        return np.zeros((size.size, 0))
    columns = (np.concatenate(list(slopes)) / size[:, :, None]).reshape(size.size, -1)
    columns = columns[:, columns.any(axis=0)]
    basis, seen, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), full_matrices=False)
    return np.asarray(basis[:, seen > UNSEEN])
