"""How far the simulator stays from held-out recordings, with and without the calibrated pressures."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from softrl.calibration.holds import Holds, end_of_hold
from softrl.calibration.kinematics import angle_between, arc, continued, rotation_vector
from softrl.effects.chain import Plant
from softrl.effects.replay import replay as effects_replay
from softrl.recordings.recording import Recording, RecordingSet
from softrl.robots.robot import Robot

# velocities of both sides are slopes of parabolas over this window, so that camera noise is no velocity
VELOCITY_WINDOW_S = 0.11
PressureOf = Callable[[np.ndarray], np.ndarray]  # commanded (steps, n) Pa -> that of the simulator
# between recordings on one clock, or rows of the earlier one; after a longer pause nobody knows what happened meanwhile
PAUSE_S, PAUSE_ROWS = 0.5, 1.5
SMALLEST_SPAN = 1e-9  # in SI; less than that is rounding


class Stepping(NamedTuple):
    """How recordings are replayed.

    Attributes
    ----------
    dt_s : step of the simulation, s, however far apart the rows are
    stood_s : how long, s, a robot that does not begin at rest is taken to have stood under its first row
    """

    dt_s: float
    stood_s: float


def replay(plant: Plant, recordings: Sequence[Recording], pressure_of: PressureOf, stepping: Stepping) -> list[Recording]:
    """Return what the plant does at the recordings' times under ``pressure_of`` the commands, each row held until its time.

    A recorded force on the tip acts on the simulated one too.
    Recordings that follow each other on one clock are one motion of the robot: what an earlier one left in valves and walls
    is there in the next.
    """
    motions: list[Recording] = []
    for chain in _follow_ups(recordings):
        whole = _replayed(plant, _joined(chain, pressure_of), stepping)
        ends = np.cumsum([len(recording.time) for recording in chain])
        motions += [
            replace(from_row(whole, int(end) - len(run.time), int(end)), name=run.name)
            for run, end in zip(chain, ends, strict=True)
        ]
    return motions


def from_row(recording: Recording, first: int, end: int | None = None) -> Recording:
    """Return the rows of a recording from ``first`` on, up to but not ``end``, without markers."""
    return replace(recording, **recording.part(slice(first, end)) | {"markers": {}})


def _follow_ups(recordings: Sequence[Recording]) -> list[list[Recording]]:
    """Return the recordings in order, those together that go on where the one before ended."""
    chains: list[list[Recording]] = []
    for recording in recordings:
        goes_on = bool(chains) and _goes_on(chains[-1][-1], recording)
        chains = [*chains[:-1], [*chains[-1], recording]] if goes_on else [*chains, [recording]]
    return chains


def _goes_on(last: Recording, following: Recording) -> bool:
    """Return whether a recording is of the motion that the ``last`` one saw the beginning of."""
    longest_s = max(PAUSE_S, PAUSE_ROWS * float(np.median(np.diff(last.time))))
    return last.session == following.session and 0.0 < following.time[0] - last.time[-1] < longest_s


def _forces(recordings: Sequence[Recording]) -> np.ndarray | None:
    """Return the forces (steps, 3) N on the tip over ``recordings``, zero in those without; None if none has any."""
    if all(recording.tip_force is None for recording in recordings):
        return None
    return np.concatenate([np.zeros((len(r.time), 3)) if r.tip_force is None else r.tip_force for r in recordings])


def _joined(chain: Sequence[Recording], pressure_of: PressureOf) -> Recording:
    """Return recordings that go on from each other as one, with ``pressure_of`` their commands; gauges showed other ones."""
    return replace(
        chain[0],
        time=np.concatenate([run.time for run in chain]),
        pressure_cmd=pressure_of(np.concatenate([run.pressure_cmd for run in chain])),
        position=_in_all(chain, "position"),
        tip_force=_forces(chain),
        temperature=_in_all(chain, "temperature"),
        pressure_meas=None,
        quaternion=None,
        bend_angle=None,
        markers={},
        unseen=None,
    )


def _in_all(chain: Sequence[Recording], channel: str) -> np.ndarray | None:
    """Return a channel over all of ``chain``; None if one lacks it."""
    values = [getattr(run, channel) for run in chain]
    return None if any(v is None for v in values) else np.concatenate(values)


def _replayed(plant: Plant, recording: Recording, stepping: Stepping) -> Recording:
    """Return the motion from rest, or from where the robot came to under the first row: where its first pose is nearer."""
    from_rest = effects_replay(plant, recording, stepping.dt_s)
    if recording.position is None or plant.chain.robot.is_at_rest(recording.pressure_cmd[0]):
        return from_rest
    stood = effects_replay(plant, recording, stepping.dt_s, settle_s=stepping.stood_s)
    away = [np.linalg.norm(made.position[0] - recording.position[0]) for made in (from_rest, stood)]
    return stood if away[1] < away[0] else from_rest


def simulated_holds(
    plant: Plant, recordings: RecordingSet, holds: Holds, pressure_of: PressureOf, average_s: float, stepping: Stepping
) -> Holds:
    """Return the holds as ``plant`` passes them when it replays the whole recordings with ``pressure_of`` the commands."""
    position = np.empty_like(holds.position)
    motions = replay(plant, recordings.recordings, pressure_of, stepping)
    for run in np.unique(holds.run):
        moved = replace(recordings.recordings[int(run)], position=motions[int(run)].position)
        for k in np.flatnonzero(holds.run == run):
            position[k] = end_of_hold(moved, 0, int(holds.last_row[k]), average_s)[0]
    return replace(holds, position=position)


def replay_errors(
    plant: Plant, recordings: RecordingSet, holds: Holds, since: Mapping[int, int], pressure_of: PressureOf, stepping: Stepping
) -> dict[str, float]:
    """Return rms errors by name with unit: at ``holds``, and over the rows of the runs ``since``, from the row there on.

    Notes
    -----
    Paper Table 1: backbone length l, curvature kappa, orientation q, tip position p and its rate; l and kappa
    are those of the constant-curvature arc to the tip. Over rows the lags of valve and body count too,
    which no static map can remove. Fig. 7b: the same errors in per cent of what the measured quantity spans over the
    runs (``_pct``), a vector by the diagonal of its box.
    """
    robot = plant.chain.robot
    motions = replay(plant, recordings.recordings, pressure_of, stepping)
    runs = {number: from_row(recordings.recordings[number], first) for number, first in since.items()}
    ranges = _ranges(robot, list(runs.values()))
    at_holds: dict[str, list[np.ndarray]] = {}
    over_runs: dict[str, list[np.ndarray]] = {}
    for number, recording in runs.items():
        errors = _errors(robot, recording, from_row(motions[number], since[number]))
        rows = holds.last_row[holds.run == number] - since[number]
        for name, error in errors.items():
            over_runs.setdefault(f"{name}_run", []).append(error[recording.seen])
            if not name.startswith("velocity"):
                at_holds.setdefault(f"{name}_hold", []).append(error[rows])
    errors = {name: _rms(np.concatenate(e)) for name, e in (at_holds | over_runs).items()}
    shares = {
        f"{name}_pct": 100.0 * error / ranges[_quantity(name)]
        for name, error in errors.items()
        if ranges[_quantity(name)] > SMALLEST_SPAN  # a robot that does not move spans nothing
    }
    return {_with_unit(name): error * UNITS[_quantity(name)][1] for name, error in errors.items()} | shares


UNITS = {
    "position": ("mm", 1e3),
    "arc_length": ("mm", 1e3),
    "curvature": ("per_m", 1.0),
    "orientation": ("deg", 180.0 / np.pi),
    "velocity": ("mm_s", 1e3),
}


def _with_unit(name: str) -> str:
    return f"{name}_{UNITS[_quantity(name)][0]}"


def _quantity(name: str) -> str:
    return name.rsplit("_", 1)[0]


def _ranges(robot: Robot, recordings: list[Recording]) -> dict[str, float]:
    """Return what each measured quantity spans over all ``recordings``, in SI."""
    position = np.concatenate([recording.position for recording in recordings])
    length, curvature = arc(position, robot.axis)
    velocity = np.concatenate([_velocity(recording.time, recording.position) for recording in recordings])
    measured = {"position": position, "arc_length": length, "curvature": curvature, "velocity": velocity}
    if all(recording.quaternion is not None for recording in recordings):
        measured["orientation"] = np.concatenate([continued(rotation_vector(r.quaternion)) for r in recordings])
    ranges = {name: float(np.linalg.norm(np.ptp(values, axis=0))) for name, values in measured.items()}
    return {name: ranges.get(name, 0.0) for name in UNITS}


def _errors(robot: Robot, recording: Recording, motion: Recording) -> dict[str, np.ndarray]:
    """Return the size of each error (steps,) in SI."""
    measured, simulated = arc(recording.position, robot.axis), arc(motion.position, robot.axis)
    errors = {
        "position": np.linalg.norm(motion.position - recording.position, axis=1),
        "arc_length": simulated[0] - measured[0],
        "curvature": simulated[1] - measured[1],
        "velocity": np.linalg.norm(_velocity(recording.time, motion.position - recording.position), axis=1),
    }
    if recording.quaternion is not None:
        errors["orientation"] = angle_between(motion.quaternion, recording.quaternion)
    return errors


def _velocity(time: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Return the slopes (steps, 3) m/s of parabolas through ``position`` (steps, 3) m, also where rows are uneven in time."""
    if len(time) < 3:  # the end of a run of slow rows
        return np.asarray(np.gradient(position, time, axis=0))
    dt_s = float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1] + 0.5 * dt_s, dt_s)  # the filter knows no other
    window = min(max(2 * round(0.5 * VELOCITY_WINDOW_S / dt_s) + 1, 5), len(even) - 1 + len(even) % 2)
    slope = savgol_filter(_at(even, time, position), window, 2, deriv=1, delta=dt_s, axis=0)
    return _at(time, even, slope)


def _at(wanted: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the columns of ``values`` (steps, n) at the times ``wanted``, linearly between those of ``time``."""
    return np.stack([np.interp(wanted, time, column) for column in values.T], axis=1)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
