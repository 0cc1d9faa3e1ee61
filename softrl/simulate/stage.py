"""Stage simulate: replay a dataset's commands through any simulator, with effects and noise."""

import logging
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from softrl.core.errors import ConfigError, RecordingError
from softrl.core.progress import progress
from softrl.core.simulator import Simulator
from softrl.core.tracking import Tracker
from softrl.effects.chain import EffectChain, Plant
from softrl.effects.replay import replay
from softrl.recordings.acting import ACTS, UNTIL
from softrl.recordings.check import check
from softrl.recordings.marked import DISTURBED, OUTSIDE, without
from softrl.recordings.mistaken import mistaken
from softrl.recordings.recording import Recording, RecordingSet
from softrl.recordings.store import DATASET
from softrl.recordings.write import write
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)

SIMULATED = "simulated_by"  # note in dataset.yaml
_SPREADS = (
    ("position", "noise_m"),
    ("orientation", "noise_rad"),
    ("bend_angle", "noise_rad"),
    ("pressure", "noise_pa"),
    ("position", "colour_m"),
    ("bend_angle", "colour_rad"),
    ("pressure", "colour_pa"),
)


@dataclass(frozen=True)
class Config:
    """Replay of recorded commands.

    Attributes
    ----------
    dt_s : step of the simulation; samples are taken at the recording's own times
    drive : "command", or "measured" to put the measured pressures behind the valve
    settle_s : time under the first row before the first sample, for recordings that do not begin at rest
    position_noise_m, orientation_noise_rad, bend_angle_noise_rad, pressure_noise_pa : standard deviation of
        white noise
    position_colour_m, bend_angle_colour_rad, pressure_colour_pa : standard deviation of coloured noise beside it
    colour_s : time in which the coloured noise forgets; the same for all channels
    dropped_share : of the samples after the first one of each run, at random, that are lost
    measured_pressure, orientation : whether the robot measures chamber pressures, and the tip's orientation
    out : folder of a dataset to write, or null
    seed : of the noise
    """

    dt_s: float
    drive: str
    settle_s: float
    position_noise_m: float
    orientation_noise_rad: float
    bend_angle_noise_rad: float
    pressure_noise_pa: float
    position_colour_m: float
    bend_angle_colour_rad: float
    pressure_colour_pa: float
    colour_s: float
    dropped_share: float
    measured_pressure: bool
    orientation: bool
    out: str | None
    seed: int

    def __post_init__(self) -> None:
        if not self.dt_s > 0.0:
            raise ConfigError(f"stage.dt_s={self.dt_s:g} must be positive")
        if self.drive not in ("command", "measured"):
            raise ConfigError(f"stage.drive={self.drive} is unknown; expected command or measured")
        for name in ("settle_s", *(f"{channel}_{kind}" for channel, kind in _SPREADS)):
            if not getattr(self, name) >= 0.0:
                raise ConfigError(f"stage.{name}={getattr(self, name):g} must not be negative")
        if not self.colour_s > 0.0:
            raise ConfigError(f"stage.colour_s={self.colour_s:g} s must be positive")
        if not 0.0 <= self.dropped_share < 1.0:
            raise ConfigError(f"stage.dropped_share={self.dropped_share:g} must lie in 0..1, below 1")


def run(
    config: Config,
    robot: Robot,
    simulator: Simulator,
    effects: EffectChain,
    recordings: RecordingSet,
    *,
    tracker: Tracker,
) -> RecordingSet:
    """Return the recordings as the simulator would have made them, with the same runs, sessions and times.

    What is odd about recordings is warned of as a diagnosis does.
    """
    for line in check(recordings, robot).warnings:
        log.warning("%s", line)
    plant, started = Plant(simulator, effects), time.perf_counter()
    streams = np.random.SeedSequence(config.seed).spawn(len(recordings.recordings))
    simulated, replayed = [], {}
    for recording, stream in zip(progress(recordings.recordings, "replay"), streams, strict=True):
        clean = replay(plant, recording, config.dt_s, config.drive, config.settle_s)
        replayed[recording.name] = clean
        simulated.append(add_noise(clean, config, np.random.default_rng(stream)))
    seconds = time.perf_counter() - started
    _warn_of_mistakes(recordings, replayed, robot)
    # the effects stay out of the notes: whoever diagnoses the data shall not read the answer beside them
    notes = {SIMULATED: type(simulator).__name__, "seed": config.seed, ACTS: UNTIL}
    notes |= {OUTSIDE: recordings.notes[OUTSIDE]} if OUTSIDE in recordings.notes else {}  # what only judges goes on doing so
    result = RecordingSet(robot_name=robot.name, recordings=tuple(simulated), notes=notes)
    _report(recordings, result, seconds, tracker)
    return result


def _warn_of_mistakes(recordings: RecordingSet, replayed: dict[str, Recording], robot: Robot) -> None:
    """Warn where recorded motion shows that columns cannot be what they are called, beside what was ``replayed``, by run."""
    channel = "bend_angle" if robot.output == "bend_angle" else "position"
    runs = [run for run in without(recordings, DISTURBED).recordings if getattr(run, channel) is not None]
    told = mistaken(runs, [replayed[run.name] for run in runs], robot) if runs else None
    if told is not None:
        log.warning("the recordings cannot be what they are called: %s", told)


def write_out(config: Config, robot: Robot, simulated: RecordingSet) -> None:
    """Write the dataset to the folder ``config.out``, if one is named; the pipeline calls this for a reused run, too."""
    if config.out is not None:
        write_dataset(Path(config.out).expanduser(), simulated)


def require_own(folder: Path) -> None:
    """Raise ``RecordingError`` unless ``folder`` is new, empty, or holds an earlier simulated dataset and no other runs."""
    if (folder / DATASET).is_file():
        head = yaml.safe_load((folder / DATASET).read_text()) or {}
        if SIMULATED not in head:
            raise RecordingError(f"out={folder} holds recordings that were not simulated; choose another folder")
        if others := sorted({file.name for file in folder.glob("*.csv")} - _files_of(head)):
            raise RecordingError(
                f"out={folder} holds {', '.join(others)}, which its {DATASET} does not list as simulated; choose another folder"
            )
    elif folder.exists() and (folder.is_file() or any(folder.iterdir())):
        raise RecordingError(f"out={folder} holds something else than a simulated dataset; choose another folder")


def _files_of(head: Mapping[str, Any]) -> set[str]:
    """Return the names of the files of the runs that a simulated dataset lists."""
    sessions = (head.get("sessions") or {}).values()
    return {f"{run}.csv" for session in sessions for run in (session["runs"] if isinstance(session, Mapping) else session)}


def write_dataset(folder: Path, simulated: RecordingSet) -> None:
    """Write ``simulated`` to ``folder``, see ``require_own``."""
    require_own(folder)
    for old in folder.glob("*.csv"):
        old.unlink()
    write(folder, simulated)
    log.info("wrote %d runs to %s", len(simulated.recordings), folder)


def add_noise(recording: Recording, config: Config, rng: np.random.Generator) -> Recording:
    """Return ``recording`` as its sensors report it: with noise, samples lost, and only the channels that there are.

    The commands stay exact.
    """
    noisy: dict[str, Any] = {}
    for channel, white, coloured in (
        ("pressure_meas", config.pressure_noise_pa, config.pressure_colour_pa),
        ("position", config.position_noise_m, config.position_colour_m),
        ("bend_angle", config.bend_angle_noise_rad, config.bend_angle_colour_rad),
        ("quaternion", 0.5 * config.orientation_noise_rad, 0.0),  # half: a quaternion turns by half the angle
    ):
        values = getattr(recording, channel)
        if values is not None:
            changed = values + white * rng.standard_normal(values.shape)
            if coloured > 0.0:
                changed += coloured * coloured_noise(recording.time, values.shape, config.colour_s, rng)
            noisy[channel] = changed
    turned = noisy.get("quaternion")
    if turned is not None:
        noisy["quaternion"] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    if not config.orientation:
        noisy["quaternion"] = None
    if not config.measured_pressure:
        noisy["pressure_meas"] = None
    return _thinned(replace(recording, **noisy), config.dropped_share, rng)


def coloured_noise(time: np.ndarray, shape: tuple[int, ...], colour_s: float, rng: np.random.Generator) -> np.ndarray:
    """Return noise of unit variance whose correlation falls as ``exp(-|t - s| / colour_s)``, at any times (steps,) s.

    Notes
    -----
    Ornstein-Uhlenbeck process, sampled exactly (textbook form, no equation number checked).
    """
    kept = np.exp(-np.diff(time, prepend=time[0]) / colour_s)
    kept[0] = 0.0
    fresh = rng.standard_normal(shape)
    noise = np.empty(shape)
    last = np.zeros(shape[1:])
    for k, share in enumerate(kept):
        noise[k] = last = share * last + np.sqrt(1.0 - share * share) * fresh[k]
    return noise


def _thinned(recording: Recording, share: float, rng: np.random.Generator) -> Recording:
    """Return ``recording`` without a ``share`` of its samples, lost at random; the first one is kept."""
    if share == 0.0:
        return recording
    kept = rng.random(len(recording.time)) >= share
    kept[:2] = True
    return replace(recording, **recording.part(kept))


def _report(recorded: RecordingSet, simulated: RecordingSet, seconds: float, tracker: Tracker) -> None:
    """Log the speed, and the difference to what was recorded, where motion was seen."""
    span = sum(float(np.ptp(r.time)) for r in recorded.recordings)
    tracker.metric("replay_speed_times_real_time", span / max(seconds, 1e-9))
    pairs = list(zip(recorded.recordings, simulated.recordings, strict=True))
    for channel, name, scale in (
        ("position", "tip_difference_mm", 1e3),
        ("bend_angle", "bend_difference_deg", 180 / np.pi),
    ):
        squares = [
            ((getattr(ours, channel) - getattr(theirs, channel)) ** 2).reshape(len(theirs.time), -1).sum(axis=1)[theirs.seen]
            for theirs, ours in pairs
            if len(ours.time) == len(theirs.time)  # none was dropped
            and getattr(theirs, channel) is not None
            and getattr(ours, channel) is not None
        ]
        if squares:
            tracker.metric(f"recorded/{name}", scale * float(np.sqrt(np.mean(np.concatenate(squares)))))
