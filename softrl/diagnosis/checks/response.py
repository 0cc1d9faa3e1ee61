"""Step responses read straight from recordings, without any model: how long until 63 % of a step is done."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from softrl.recordings.recording import Recording

STEP_SHARE = 0.2  # a command that jumps by this share of its range in the run is a step
HOLD_S = 3.0  # it must then be held at least this long
DONE = 1.0 - np.exp(-1.0)
LARGER = 1.5  # times the size of small steps: less says nothing about how time depends on size
GROWS = 1.3  # times as long: more is no lag


@dataclass(frozen=True)
class StepResponse:
    """Median times to 63 % of the change that a step brought by the end of its hold.

    Attributes
    ----------
    pressure_fill_s, pressure_vent_s : of the measured pressure; None without steps or without measured pressure
    motion_fill_s, motion_vent_s : of the tip, or of the bend angle
    steps : number of steps found
    pressure_fill_growth, pressure_vent_growth : that time of the largest third of the steps over that of the smallest;
        None unless the former are at least ``LARGER`` times as large. One for a lag, whatever its order.
    """

    pressure_fill_s: float | None
    pressure_vent_s: float | None
    motion_fill_s: float | None
    motion_vent_s: float | None
    steps: int
    pressure_fill_growth: float | None = None
    pressure_vent_growth: float | None = None

    def sentence(self) -> str | None:
        """Return the finding in words, or None if no step was found."""
        pairs = {"chamber pressure": (self.pressure_fill_s, self.pressure_vent_s),
                 "motion": (self.motion_fill_s, self.motion_vent_s)}  # fmt: skip
        told = [
            f"{what} lags its command and has done 63 % " + " and ".join(
                f"{time:.2f} s after {kind}" for kind, time in (("filling", fill), ("venting", vent)) if time is not None)
            for what, (fill, vent) in pairs.items() if fill is not None or vent is not None
        ]  # fmt: skip
        steps = "one step" if self.steps == 1 else f"{self.steps} steps"
        return f"Read from {steps} without a model: {'; '.join(told)}.{self._by_size()}" if told else None

    def _by_size(self) -> str:
        """Return what the time of large steps against that of small ones says, or nothing."""
        ways = {"filling": self.pressure_fill_growth, "venting": self.pressure_vent_growth}
        told = [
            f"{way} takes {growth:.2g} times as long for the largest steps as for the smallest, "
            + ("as with a limited flow; a lag would take equally long" if growth > GROWS else "much as with a lag")
            for way, growth in ways.items()
            if growth is not None
        ]
        return f" {'; '.join(told).capitalize()}." if told else ""


def step_responses(runs: Sequence[Recording]) -> StepResponse:
    """Return the median response times over all steps of all chambers in ``runs``."""
    times: dict[tuple[str, bool], list[float]] = {}
    sized: dict[bool, list[tuple[float, float]]] = {True: [], False: []}
    steps = 0
    for run in runs:
        for chamber, window, fills in _steps(run):
            steps += 1
            for what, values in _channels(run, chamber):
                time = rise_time(run.time[window], values[window])
                if time is not None:
                    times.setdefault((what, fills), []).append(time)
                    if what == "pressure":
                        sized[fills].append((abs(float(values[window][-1, 0] - values[window][0, 0])), time))

    def middle(what: str, fills: bool) -> float | None:
        found = times.get((what, fills))
        return float(np.median(found)) if found else None

    return StepResponse(
        middle("pressure", True),
        middle("pressure", False),
        middle("motion", True),
        middle("motion", False),
        steps,
        _growth(sized[True]),
        _growth(sized[False]),
    )


def _growth(sized: list[tuple[float, float]]) -> float | None:
    """Return the median time of the largest third of steps (size, time s) over that of the smallest third."""
    third = len(sized) // 3
    if third < 2:
        return None
    ordered = np.array(sorted(sized))
    small, large = np.median(ordered[:third], axis=0), np.median(ordered[-third:], axis=0)
    return float(large[1] / small[1]) if large[0] >= LARGER * small[0] else None


def rise_time(time: np.ndarray, values: np.ndarray) -> float | None:
    """Return when ``values`` (steps, k) have done 63 % of their way to the end, s after the first sample.

    None if they hardly move beyond their noise.
    """
    way = values[-max(len(values) // 10, 3) :].mean(axis=0) - values[0]
    size = float(way @ way)
    noise = np.linalg.norm(np.diff(values, axis=0).std(axis=0)) / np.sqrt(2.0)
    if size == 0.0 or size < (5.0 * noise) ** 2:
        return None
    share = (values - values[0]) @ way / size
    after = int(np.argmax(share >= DONE))
    if after == 0:
        return None
    part = (DONE - share[after - 1]) / (share[after] - share[after - 1])
    return float(time[after - 1] + part * (time[after] - time[after - 1]) - time[0])


def _steps(run: Recording) -> Iterator[tuple[int, slice, bool]]:
    """Yield (chamber, samples from the last before the step to the next change of any command, whether it fills).

    A command acts until its row's time, so a step comes right behind the row before: what is quicker than a row has happened
    at the row of the step.
    """
    change = np.diff(run.pressure_cmd, axis=0)
    moved = np.flatnonzero(np.any(change != 0.0, axis=1)) + 1
    ends = np.r_[moved[1:], len(run.time)][: len(moved)]
    span = np.ptp(run.pressure_cmd, axis=0)
    for start, end in zip(moved, ends, strict=True):
        jump = change[start - 1]
        chamber = int(np.argmax(np.abs(jump)))
        alone = np.count_nonzero(jump) == 1
        if alone and abs(jump[chamber]) > STEP_SHARE * span[chamber] and run.time[end - 1] - run.time[start] >= HOLD_S:
            yield chamber, slice(start - 1, end), bool(jump[chamber] > 0.0)


def _channels(run: Recording, chamber: int) -> Iterator[tuple[str, np.ndarray]]:
    if run.pressure_meas is not None:
        yield "pressure", run.pressure_meas[:, chamber : chamber + 1]
    motion = run.position if run.position is not None else run.bend_angle
    if motion is not None:
        yield "motion", motion.reshape(len(motion), -1)
