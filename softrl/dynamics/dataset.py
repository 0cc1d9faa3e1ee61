"""Trajectories for learning: random pressures and tip forces rolled through a body, as windows of states and loads."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch

from softrl.artifacts.snapshots import Snapshots
from softrl.calibration.kinematics import arc, continued, rotation_vector
from softrl.robots.robot import Robot

# a state is tip (3), arc length, curvature, rotation vector (3), then the volumes
TIP, POSE = slice(0, 3), 8
KINDS = (TIP, slice(3, 4), slice(4, 5), slice(5, POSE), slice(POSE, None))


class Body(Protocol):
    """What is learned from: a reduced model in batches. Coordinates z are (volumes, tip) from stress-free rest, SI."""

    @property
    def chambers(self) -> int:
        """Number of chambers n; z has n + 3 numbers."""
        ...

    @property
    def rest_tip(self) -> np.ndarray:
        """(3,) m, tip at z = 0."""
        ...

    @property
    def rest(self) -> np.ndarray:
        """(n + 3,) z at rest under weight alone."""
        ...

    def roll(self, load: np.ndarray, start: np.ndarray, velocity: np.ndarray, dt_s: float) -> np.ndarray:
        """Return z (B, steps, n + 3) under ``load`` (B, steps, n + 3), from ``start`` and ``velocity`` (B, n + 3)."""
        ...

    def residual(self, path: torch.Tensor, load: torch.Tensor, dt_s: float) -> torch.Tensor:
        """Return what the last step of ``path`` (B, K, n + 3), K >= 3, leaves in the balance of forces (B, n + 3), Pa and N.

        ``load`` (B, n + 3) is held over that step; differentiable by its end.
        """
        ...

    def quaternion(self, z: np.ndarray) -> np.ndarray:
        """Return orientations (B, 4) w x y z of the tip at ``z`` (B, n + 3)."""
        ...


@dataclass(frozen=True)
class Trajectories:
    """Runs on one time step.

    Attributes
    ----------
    load : (runs, steps, n + 3) Pa and N, held over the step that ends at the row's time
    state : (runs, steps, 8 + n) SI, see ``ForwardDynamics``
    rate : (runs, steps, 8 + n), (state - state one step before) / dt; zero in the first row
    dt_s : s
    """

    load: np.ndarray
    state: np.ndarray
    rate: np.ndarray
    dt_s: float

    def __len__(self) -> int:
        return len(self.load)

    def part(self, runs: slice) -> "Trajectories":
        """Return some of the runs."""
        return Trajectories(self.load[runs], self.state[runs], self.rate[runs], self.dt_s)

    @property
    def rows(self) -> np.ndarray:
        """(runs, steps - 1, features): state and rate at k with the load held from k to k + 1."""
        return np.concatenate([self.state[:, :-1], self.rate[:, :-1], self.load[:, 1:]], axis=2)


def coordinates_of(state: torch.Tensor, rest_tip: torch.Tensor) -> torch.Tensor:
    """Return z (..., n + 3), volumes first, that lie in a state (..., 8 + n)."""
    return torch.cat([state[..., POSE:], state[..., TIP] - rest_tip], dim=-1)


def trajectories_from(
    z: np.ndarray, quaternion: np.ndarray, load: np.ndarray, rest_tip: np.ndarray, axis: str, dt_s: float
) -> Trajectories:
    """Return trajectories of coordinates ``z`` (runs, steps, n + 3)."""
    n = z.shape[2] - 3
    tip = rest_tip + z[..., n:]
    length, curvature = arc(tip, axis)
    turn = continued(rotation_vector(quaternion))
    state = np.concatenate([tip, length[..., None], curvature[..., None], turn, z[..., :n]], axis=2)
    rate = np.diff(state, axis=1, prepend=state[:, :1]) / dt_s
    return Trajectories(load, state, rate, dt_s)


def rolled(body: Body, load: np.ndarray, axis: str, dt_s: float) -> Trajectories:
    """Return the motion of ``body`` under ``load`` (runs, steps, n + 3); the first row is at rest, its load unused."""
    runs, _, size = load.shape
    start = np.tile(body.rest, (runs, 1))
    path = body.roll(load[:, 1:], start, np.zeros((runs, size)), dt_s)
    z = np.concatenate([start[:, None], path], axis=1)
    quaternion = body.quaternion(z.reshape(-1, size)).reshape(*z.shape[:2], 4)
    return trajectories_from(z, quaternion, load, body.rest_tip, axis, dt_s)


def full_order(snapshots: Snapshots, gravity_m_s2: np.ndarray, axis: str, dt_s: float) -> Trajectories | None:
    """Return the full model's trajectories as a test set, or None if it has none on ``dt_s`` under ``gravity_m_s2``."""
    step_s = float(np.median(np.diff(snapshots.trajectory_time))) if len(snapshots.trajectory_time) > 1 else 0.0
    if not len(snapshots.trajectory_load) or abs(step_s - dt_s) > 1e-6:
        return None
    if not np.allclose(snapshots.trajectory_gravity_m_s2, gravity_m_s2):
        return None
    return trajectories_from(
        snapshots.trajectory_coordinate,
        snapshots.trajectory_quaternion,
        snapshots.trajectory_load,
        snapshots.rest_tip,
        axis,
        dt_s,
    )


def random_loads(
    robot: Robot, low: np.ndarray, high: np.ndarray, runs: int, steps: int, dt_s: float, rng: np.random.Generator,
    first: int = 0,
) -> np.ndarray:  # fmt: skip
    """Return loads (runs, steps, n + 3) within ``low`` and ``high`` (n + 3,).

    Even runs are steps, odd ones multisines, counted from ``first`` on. Every run starts without load; a tip force acts in
    every other pair of runs. Pressures obey the robot's slew limit.
    """
    n = robot.chambers
    load = np.zeros((runs, steps, n + 3))
    for run in range(runs):
        make = _random_steps if (first + run) % 2 == 0 else _multisine
        load[run, :, :n] = _slewed(make(low[:n], high[:n], steps, dt_s, rng), robot.slew_pa_per_s * dt_s)
        if (first + run) % 4 < 2:
            load[run, :, n:] = make(low[n:], high[n:], steps, dt_s, rng)
    return load


def _random_steps(low: np.ndarray, high: np.ndarray, steps: int, dt_s: float, rng: np.random.Generator) -> np.ndarray:
    """Return (steps, channels) of levels that change together after 0.1 to 1 s."""
    durations = rng.uniform(0.1, 1.0, size=steps)
    level_of = np.searchsorted(np.cumsum(durations), dt_s * np.arange(steps))
    return rng.uniform(low, high, size=(steps, len(low)))[level_of]


def _multisine(low: np.ndarray, high: np.ndarray, steps: int, dt_s: float, rng: np.random.Generator) -> np.ndarray:
    """Return (steps, channels) of five tones of 0.1 to 4 Hz around a random level, within the range."""
    tone = 2.0 * np.pi * np.geomspace(0.1, 4.0, 5)[:, None] * rng.uniform(0.8, 1.25, (5, len(low)))
    phase = rng.uniform(0.0, 2.0 * np.pi, (5, len(low)))
    wave = np.sin(dt_s * np.arange(steps)[:, None, None] * tone + phase).mean(axis=1)
    middle = rng.uniform(low, high)
    return np.clip(middle + (high - low) * wave, low, high)


def _slewed(wanted: np.ndarray, reach: float) -> np.ndarray:
    sent = np.zeros_like(wanted)
    for k in range(1, len(wanted)):
        sent[k] = sent[k - 1] + np.clip(wanted[k] - sent[k - 1], -reach, reach)
    return sent


class Windows:
    """Windows of ``window`` rows of trajectories, cut on demand.

    With ``from_rest`` the runs begin at rest, and before their start the robot stood there without load;
    without it only windows that lie in the runs are cut.
    """

    def __init__(self, trajectories: Trajectories, window: int, from_rest: bool = True) -> None:
        rows, next_rate = trajectories.rows, trajectories.rate[:, 1:]
        if from_rest:
            rest = rows[:, :1].copy()
            rest[..., 2 * trajectories.state.shape[2] :] = 0.0
            rows = np.concatenate([np.repeat(rest, window - 1, axis=1), rows], axis=1)
        else:
            rows, next_rate = rows[:, 1:], next_rate[:, window:]  # the first row has no rate yet
        self.rows = torch.tensor(rows, dtype=torch.float32)
        self.next_rate = torch.tensor(next_rate, dtype=torch.float32)
        self.window = window
        self.per_run = next_rate.shape[1]

    def __len__(self) -> int:
        return len(self.rows) * self.per_run

    def take(self, index: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return windows (B, window, features) and the rate (B, 8 + n) one step after each."""
        run, end = index // self.per_run, index % self.per_run
        span = end[:, None] + torch.arange(self.window)
        return self.rows[run[:, None], span], self.next_rate[run, end]

    def take_segments(self, index: torch.Tensor, steps: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return windows, the loads (B, steps, n + 3) from their last row on, and the true rates (B, steps, 8 + n)."""
        run = index // self.per_run
        end = torch.clamp(index % self.per_run, max=self.per_run - steps)
        span = end[:, None] + torch.arange(self.window)
        ahead = end[:, None] + torch.arange(steps)
        size = self.next_rate.shape[2]
        load = self.rows[run[:, None], ahead + self.window - 1, 2 * size :]
        return self.rows[run[:, None], span], load, self.next_rate[run[:, None], ahead]
