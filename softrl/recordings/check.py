"""How good the data are before anything is concluded: sampling, clipping, excitation, noise floor."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from softrl.recordings.frame import axis_vector
from softrl.recordings.lost import MOTION
from softrl.recordings.marked import DISTURBED, OUTSIDE, without
from softrl.recordings.recording import Recording, RecordingSet
from softrl.recordings.repeatability import repeatability, sensed
from softrl.recordings.rhythm import periods
from softrl.recordings.scale import UNIT_FACTOR, scale_of
from softrl.recordings.validate import SLOW_S
from softrl.robots.robot import Robot

LONG_S = 7200.0  # a run of slow rows that lasts longer: milliseconds may have been taken for seconds
GAP_PERIODS = 5.0  # a pause of more than this many periods of the log is a gap
HOLD_S = 1.0  # a command unchanged for twice this long ends in a window of this length at rest
MANY, FREE = 8, 8  # rows of such a window, or else degrees of freedom of all second halves of holds
EXCITED_SHARE = 0.02  # a chamber that moves less than this share of the pressure range is not excited
CLIPPED_SHARE, CLIPPED_ROWS = 0.02, 3  # so many samples at one extreme value are clipping, unless the command holds there
WHOLE = 0.01  # of a digit, by which what is a multiple of it may be off
REST_SHARE = 0.3  # a tip at rest this share of a length away from its place is told in another frame
JUMP_RAD = 0.5  # an orientation that turns farther than this between samples has jumped, unless the tip has moved with it:
SWUNG = 0.2  # lengths a rad, at least: so far apart are the tips of any two arcs of constant curvature bent by up to 4 rad


@dataclass(frozen=True)
class RunCheck:
    """Findings of one run.

    Attributes
    ----------
    name, session : the run
    samples, duration_s, period_s : count, span, and median time between samples
    gaps : (start s, length s) of every pause
    excited : chambers whose command moves
    noise : channel -> standard deviation of its white part, SI units
    noise_from : "holds" or "differences"
    held : channel -> share of samples that repeat the sample before exactly, while the command moves
    rest : (3,) m where the tip is under no pressure, if the run shows it
    misplaced : in a sentence that it is far from one length along the robot's axis from the origin; empty where it is not
    turns_jump : whether the orientation jumps
    warnings : one sentence each
    """

    name: str
    session: str
    samples: int
    duration_s: float
    period_s: float
    gaps: tuple[tuple[float, float], ...]
    excited: tuple[int, ...]
    noise: dict[str, float]
    noise_from: str
    held: dict[str, float]
    rest: np.ndarray | None
    misplaced: str
    turns_jump: bool
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class DataCheck:
    """Findings of a whole set.

    Attributes
    ----------
    runs : one entry a run
    noise_floor : channel -> median of the runs' noise, SI units: no model can be expected to fit better
    repeatability : channel -> rms of the quick difference between runs of a session of equal commands over sqrt 2, SI units;
        empty without repeats
    excited : chambers that move in any run
    """

    runs: tuple[RunCheck, ...]
    noise_floor: dict[str, float]
    repeatability: dict[str, float]
    excited: tuple[int, ...]

    @property
    def warnings(self) -> tuple[str, ...]:
        """All warnings, each with its run."""
        return tuple(f"{run.name}: {warning}" for run in self.runs for warning in run.warnings)


def check(recordings: RecordingSet, robot: Robot) -> DataCheck:
    """Return what the recordings can and cannot tell; nothing is changed and nothing is raised."""
    runs = tuple(check_run(recording, robot) for recording in recordings.recordings)
    channels = {channel for run in runs for channel in run.noise}
    floor = {c: float(np.median([run.noise[c] for run in runs if c in run.noise])) for c in sorted(channels)}
    excited = tuple(sorted({chamber for run in runs for chamber in run.excited}))
    return DataCheck(runs, floor, repeatability(without(recordings, DISTURBED, OUTSIDE).recordings), excited)


def check_run(recording: Recording, robot: Robot) -> RunCheck:
    """Return the findings of one run."""
    step = np.diff(recording.time)
    period = float(np.median(step))
    pauses = np.flatnonzero(step > GAP_PERIODS * periods(step))
    gaps = tuple((float(recording.time[k]), float(step[k])) for k in pauses)
    excited = driven([recording], robot)
    noise = _noise_by_channel(recording)
    held = {channel: _held_share(recording, values) for channel, values in sensed(recording)}
    jumped, rest = tuple(_jump_warnings(recording, robot)), tip_at_rest(recording, robot)
    misplaced = "" if rest is None else _misplaced(rest, robot)
    warnings = (
        *_sampling_warnings(gaps, period, float(np.ptp(recording.time))),
        *_excitation_warnings(excited, robot),
        *_held_warnings(held),
        *_scale_warnings(recording, robot),
        *_clipping_warnings(recording),
        *jumped,
        *([misplaced] if misplaced else []),
    )
    return RunCheck(
        recording.name,
        recording.session,
        len(recording.time),
        float(np.ptp(recording.time)),
        period,
        gaps,
        excited,
        noise,
        "holds" if _hold_windows(recording) else "differences",
        held,
        rest,
        misplaced,
        bool(jumped),
        warnings,
    )


def driven(runs: Sequence[Recording], robot: Robot) -> tuple[int, ...]:
    """Return the chambers whose command moves by more than ``EXCITED_SHARE`` of the robot's range in any run."""
    span = robot.pressure_max_pa - robot.pressure_min_pa
    moved: np.ndarray = np.max([np.ptp(run.pressure_cmd, axis=0) for run in runs], axis=0)
    return tuple(np.flatnonzero(moved > EXCITED_SHARE * span).tolist())


def moved_by_command(recording: Recording, channel: str, component: int) -> np.ndarray:
    """Return at which samples (steps,) a command changes that moves ``channel[component]``: of its own chamber, or any.

    A chamber that is not driven rests at its least pressure, and is not clipped there.
    """
    changes = np.diff(recording.pressure_cmd, axis=0, prepend=recording.pressure_cmd[:1]) != 0.0
    return np.asarray(changes[:, component] if channel == "pressure_meas" else changes.any(axis=1))


def _hold_windows(recording: Recording) -> list[slice]:
    """Return the last ``HOLD_S`` of every command held at least twice that long: settled as far as it gets.

    Where rows are too slow for that, the second halves of such holds.
    """
    time = recording.time
    change = np.flatnonzero(np.any(np.diff(recording.pressure_cmd, axis=0) != 0.0, axis=1)) + 1
    holds = [
        (start, end)
        for start, end in zip(np.r_[0, change], np.r_[change, len(time)], strict=True)
        if time[end - 1] - time[start] >= 2.0 * HOLD_S
    ]
    last = [slice(int(np.searchsorted(time, time[end - 1] - HOLD_S)), int(end)) for _, end in holds]
    last = [window for window in last if window.stop - window.start >= MANY]
    if last:
        return last
    halves = [slice(int(np.searchsorted(time, 0.5 * (time[start] + time[end - 1]))), int(end)) for start, end in holds]
    halves = [half for half in halves if half.stop - half.start >= 2]
    return halves if sum(_freedom(half) for half in halves) >= FREE else []


def _freedom(window: slice) -> int:
    """Return the degrees of freedom of a window about its line, of less than four rows about their mean."""
    rows = window.stop - window.start
    return rows - 2 if rows >= 4 else rows - 1


def _noise_by_channel(recording: Recording) -> dict[str, float]:
    """Return the noise of every channel, of the motion where it was seen: what bridges lost frames has less, or none."""
    seen = replace(recording, **recording.part(recording.seen))
    found = {}
    for run, of_motion in ((recording, False), (seen, True)):
        if len(run.time) > 2:  # of two samples nobody knows what is noise
            windows, motion = _hold_windows(run), (*MOTION, *run.markers)
            found |= {name: _noise(values, windows) for name, values in sensed(run) if (name in motion) == of_motion}
    return found


def _noise(values: np.ndarray, windows: list[slice]) -> float:
    """Return the standard deviation of noise: about a line within holds, or from second differences."""
    if not windows:
        return float(np.sqrt(np.mean(np.median(np.diff(values, n=2, axis=0) ** 2, axis=0) / 0.4549 / 6.0)))
    variance = []
    for window in windows:
        level = values[window] - values[window].mean(axis=0)
        if len(level) >= 4:
            k = np.arange(len(level)) - 0.5 * (len(level) - 1)
            level = level - np.outer(k, k @ level / (k @ k))
        free = _freedom(window)
        variance.append(np.sum(level**2, axis=0) / chi2.median(free))
    return float(np.sqrt(np.mean(np.median(variance, axis=0))))


def resolution(values: np.ndarray) -> np.ndarray:
    """Return of each column of ``values`` (steps, n) the digit (n,) of which all its differences are multiples, or 0."""
    return np.array([_digit(np.unique(column)) for column in values.T])


def _digit(levels: np.ndarray) -> float:
    if len(levels) < 2:
        return 0.0
    digit = float(np.diff(levels).min())
    steps = (levels - levels[0]) / digit
    return digit if np.abs(steps - np.round(steps)).max() < WHOLE else 0.0


def _held_share(recording: Recording, values: np.ndarray) -> float:
    moving = np.any(np.diff(recording.pressure_cmd, axis=0) != 0.0, axis=1)
    if moving.sum() < 10:
        return 0.0
    return float(np.mean(np.all(np.diff(values, axis=0) == 0.0, axis=1)[moving]))


def _sampling_warnings(gaps: tuple[tuple[float, float], ...], period: float, duration: float) -> Iterator[str]:
    if period > SLOW_S and duration > LONG_S:
        yield f"lasts {duration / 3600.0:.3g} h in rows of {period:.3g} s: if the times are milliseconds, name the column time_ms"
    if gaps:
        longest = max(gaps, key=lambda gap: gap[1])
        yield (
            f"{len(gaps)} gaps in the samples, the longest {longest[1]:.2f} s at t = {longest[0]:.2f} s "
            f"(median period {1e3 * period:.1f} ms)"
        )


def _excitation_warnings(excited: tuple[int, ...], robot: Robot) -> Iterator[str]:
    still = [str(i + 1) for i in range(robot.chambers) if i not in excited]
    if still:
        yield f"chamber {', '.join(still)} is not driven: nothing can be said about effects in it"


def _held_warnings(held: dict[str, float]) -> Iterator[str]:
    for channel, share in held.items():
        if share > 0.3:
            yield f"{channel} repeats its last value in {share:.0%} of the samples: the sensor is slower"


def _scale_warnings(recording: Recording, robot: Robot) -> Iterator[str]:
    if recording.pressure_meas is None or robot.command != "pressure":
        return
    for i, (command, measured) in enumerate(zip(recording.pressure_cmd.T, recording.pressure_meas.T, strict=True)):
        scale = scale_of(command, measured, robot)
        if not 1.0 / UNIT_FACTOR < scale < UNIT_FACTOR:
            yield (
                f"the measured pressure of chamber {i + 1} follows its command but is {scale:.3g} times as large: "
                "a hose or a regulator that is not sound, or a wrong unit of its column?"
            )


def _clipping_warnings(recording: Recording) -> Iterator[str]:
    for channel, values in sensed(recording):
        for i, series in enumerate(values.T):
            moved = moved_by_command(recording, channel, i)
            for extreme, name in ((series.max(), "maximum"), (series.min(), "minimum")):
                there = (series == extreme) & moved
                if is_clipping(there) and np.ptp(series) > 0.0:
                    yield f"{channel}[{i}] is at its {name} {extreme:g} in {there.mean():.0%} of the samples: clipped?"


def is_clipping(there: np.ndarray) -> bool:
    """Return whether enough of the samples lie ``there`` (steps,), at an extreme value, to be clipped."""
    return bool(there.mean() > CLIPPED_SHARE and there.sum() >= CLIPPED_ROWS)


def _jump_warnings(recording: Recording, robot: Robot) -> Iterator[str]:
    if recording.quaternion is None:
        return
    cosine = np.abs(np.sum(recording.quaternion[1:] * recording.quaternion[:-1], axis=1)).clip(0.0, 1.0)
    turned, swung = 2.0 * np.arccos(cosine), 0.0
    if recording.position is not None:
        swung = np.linalg.norm(np.diff(recording.position, axis=0), axis=1) / robot.length_m
    jumps = np.flatnonzero((turned > JUMP_RAD) & (swung < SWUNG * turned))
    if len(jumps):
        yield (
            f"the orientation jumps {len(jumps)} times, first at t = {recording.time[jumps[0] + 1]:.2f} s: "
            "a marker body was mistaken for its mirror; do not trust the quaternion"
        )


def tip_at_rest(recording: Recording, robot: Robot) -> np.ndarray | None:
    """Return where the tip is (3,) m while no chamber is under pressure; None where that does not show."""
    span = robot.pressure_max_pa - robot.pressure_min_pa
    still = np.all(np.abs(recording.pressure_cmd) < EXCITED_SHARE * span, axis=1)
    if recording.position is None or not still.any():
        return None
    return np.asarray(np.median(recording.position[still], axis=0))


def is_elsewhere(rest: np.ndarray, expected: np.ndarray, robot: Robot) -> bool:
    """Return whether a tip at ``rest`` (3,) m is too far from where it is ``expected`` to be told in the same frame."""
    return bool(np.linalg.norm(rest - expected) > REST_SHARE * robot.length_m)


def _misplaced(rest: np.ndarray, robot: Robot) -> str:
    """Return what is wrong if the tip at ``rest`` (3,) m is not one length along the robot's axis from the origin."""
    expected = robot.length_m * axis_vector(robot.axis)
    if not is_elsewhere(rest, expected, robot):
        return ""
    return (
        f"under no pressure the tip is at {_in_mm(rest)} mm; expected about {_in_mm(expected)} mm, one length along "
        f"{robot.axis} from the base: move the origin to the base, or correct robot.length_m or the session's axis"
    )


def _in_mm(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{1e3 * value + 0.0:.0f}" for value in point) + ")"
