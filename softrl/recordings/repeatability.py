"""How well a robot and its sensors repeat themselves: what runs of equal commands differ by."""

from collections.abc import Iterator, Sequence

import numpy as np

from softrl.recordings.recording import Recording

REPEAT_S, REPEAT_SAMPLES = 1.0, 5  # what lasts longer than this, and than so many samples, is no noise between repeats
REPEATED_S = 3.0  # shorter stretches of equal commands do not tell how well a robot repeats itself


def sensed(recording: Recording) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the measured channels as (steps, components)."""
    for channel, values in recording.channels():
        if channel not in ("time", "pressure_cmd"):
            yield channel, values.reshape(len(values), -1)


def repeatability(runs: Sequence[Recording], clean: Sequence[Recording] = ()) -> dict[str, float]:
    """Return the rms difference over sqrt 2 between runs of a session whose commands agree, on the shorter run's times.

    Of the difference only what is faster than ``REPEAT_S`` is noise: a wall that ages, or a load that came in between, is
    not. Nor does it count where no command changes: from what came before a body may still be coming back. Samples that
    the ``clean`` run of the same name has no more, if there is one, are no noise either.
    """
    squares: dict[str, list[float]] = {}
    kept = {run.name: run.time[run.seen] for run in clean}
    for i, one in enumerate(runs):
        for other in [run for run in runs[i + 1 :] if run.session == one.session]:
            count = min(len(one.time), len(other.time))
            same_time = np.allclose(np.diff(one.time[:count]), np.diff(other.time[:count]), rtol=0.01)
            long = one.time[count - 1] - one.time[0] >= REPEATED_S and np.ptp(one.pressure_cmd[:count], axis=0).any()
            if not long or not same_time or not np.allclose(one.pressure_cmd[:count], other.pressure_cmd[:count], rtol=1e-6):
                continue
            theirs = dict(sensed(other))
            sound = np.all([np.isin(run.time[:count], kept.get(run.name, run.time)) for run in (one, other)], axis=0)
            for channel, values in sensed(one):
                if channel in theirs:
                    difference = values[:count] - theirs[channel][:count]
                    squares.setdefault(channel, []).append(_quick_square(one.time[:count], difference, sound))
    return {channel: float(np.sqrt(np.mean(found) / 2.0)) for channel, found in squares.items()}


def _quick_square(time: np.ndarray, values: np.ndarray, sound: np.ndarray) -> float:
    """Return the mean square of the ``sound`` among ``values`` (steps, n) about their means over ``REPEAT_S``.

    It is per degree of freedom.
    """
    period = float(np.median(np.diff(time))) if len(time) > 1 else REPEAT_S
    block = np.arange(len(values)) // max(round(REPEAT_S / period), REPEAT_SAMPLES)
    values, block = values[sound], np.unique(block[sound], return_inverse=True)[1]
    count = np.bincount(block)
    mean = np.stack([np.bincount(block, column) for column in values.T], axis=1) / count[:, None]
    return float(np.sum((values - mean[block]) ** 2) / (values.size - mean.size)) if len(values) > len(mean) else 0.0
