"""How far the simulator stays from held-out recordings, with and without the calibrated pressures."""

from collections.abc import Callable

import numpy as np
from scipy.signal import savgol_filter

from softrl.calibration.holds import Holds
from softrl.calibration.kinematics import angle_between, arc
from softrl.core.simulator import Motion, Simulator
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

# velocities of both sides are slopes of parabolas over this window, so that camera noise is no velocity
VELOCITY_WINDOW_S = 0.11


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
    which no static map can remove.
    """
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
    return {
        _with_unit(name): _rms(np.concatenate(e)) * UNITS[name.rsplit("_", 1)[0]][1]
        for name, e in (at_holds | over_runs).items()
    }


UNITS = {
    "position": ("mm", 1e3),
    "arc_length": ("mm", 1e3),
    "curvature": ("per_m", 1.0),
    "orientation": ("deg", 180.0 / np.pi),
    "velocity": ("mm_s", 1e3),
}


def _with_unit(name: str) -> str:
    return f"{name}_{UNITS[name.rsplit('_', 1)[0]][0]}"


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
