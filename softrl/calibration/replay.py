"""How far the simulator stays from held-out recordings, with and without the calibrated pressures."""

from collections.abc import Callable

import numpy as np
from scipy.signal import savgol_filter

from softrl.calibration.holds import Holds
from softrl.calibration.kinematics import angle_between, arc, rotation_vector
from softrl.core.simulator import Motion, Simulator
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

# velocities of both sides are slopes of parabolas over this window, so that camera noise is no velocity
VELOCITY_WINDOW_S = 0.11
SMALLEST_SPAN = 1e-9  # in SI; less than that is rounding


def replay(simulator: Simulator, recording: Recording, pressure: np.ndarray) -> Motion:
    """Return the motion at the recording's times under ``pressure`` (steps, n) Pa, each row held until its time."""
    dt_s = float(np.median(np.diff(recording.time)))
    uniform = np.arange(recording.time[0], recording.time[-1] + 0.5 * dt_s, dt_s)
    row = np.clip(np.searchsorted(recording.time, uniform - 1e-9), 0, len(pressure) - 1)
    motion = simulator.simulate(uniform - uniform[0] + dt_s, pressure[row])
    nearest = np.clip(np.round((recording.time - uniform[0]) / dt_s).astype(int), 0, len(uniform) - 1)
    return Motion(recording.time, motion.position[nearest], motion.quaternion[nearest], motion.pressure[nearest])


def replay_errors(
    simulator: Simulator,
    robot: Robot,
    runs: dict[int, Recording],
    holds: Holds,
    pressure_of: Callable[[np.ndarray], np.ndarray],
) -> dict[str, float]:
    """Return rms errors on ``runs`` (number -> recording) by name with unit: at ``holds``, and over all rows.

    Notes
    -----
    Paper Table 1: backbone length l, curvature kappa, orientation q, tip position p and its rate; l and kappa
    are those of the constant-curvature arc to the tip. Over all rows the lags of valve and body count too,
    which no static map can remove. Fig. 7b: the same errors in per cent of what the measured quantity spans over the
    runs (``_pct``), a vector by the diagonal of its box.
    """
    ranges = _ranges(robot, list(runs.values()))
    at_holds: dict[str, list[np.ndarray]] = {}
    over_runs: dict[str, list[np.ndarray]] = {}
    for number, recording in runs.items():
        motion = replay(simulator, recording, pressure_of(recording.pressure_cmd))
        errors = _errors(robot, recording, motion)
        rows = holds.last_row[holds.run == number]
        for name, error in errors.items():
            over_runs.setdefault(f"{name}_run", []).append(error)
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
        measured["orientation"] = rotation_vector(np.concatenate([r.quaternion for r in recordings]))
    ranges = {name: float(np.linalg.norm(np.ptp(values, axis=0))) for name, values in measured.items()}
    return {name: ranges.get(name, 0.0) for name in UNITS}


def _errors(robot: Robot, recording: Recording, motion: Motion) -> dict[str, np.ndarray]:
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
    dt_s = float(np.median(np.diff(time)))
    window = min(max(2 * round(0.5 * VELOCITY_WINDOW_S / dt_s) + 1, 5), len(time) - 1 + len(time) % 2)
    return np.asarray(savgol_filter(position, window, 2, deriv=1, delta=dt_s, axis=0))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
