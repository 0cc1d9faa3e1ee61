"""Acting in motion on what a policy sees: the tips to come are told from its past, and led to the targets.

An expert that knows the plant's state answers to what a policy cannot see, and a clone of it has to guess. What follows
from the past alone is found here by least squares on what happened, and inverted over the targets in sight. All of it is
in differences from the present (``moving.differences``), so that a policy rests nowhere but at its target, whatever has
shifted the tip.
"""

from typing import NamedTuple

import numpy as np

from softrl.core.errors import ConfigError
from softrl.rl.batch import THETA, TIP

ROBUST_ROUNDS = 5
ROBUST_SIZE = 1.5  # of the median residual: rows beyond, at the pressures' limits, count less
RIDGE = 1e-6  # of a column's variance


class Trace(NamedTuple):
    """Steps of episodes side by side: observations (steps, B, k), and the episodes' clocks (steps, B) there."""

    seen: np.ndarray
    elapsed: np.ndarray


class Prediction(NamedTuple):
    """How the tip will have moved after 1 .. h periods: ``past.T @ p + command.T @ u``, (3 h,), told as joints.

    Attributes
    ----------
    past : (6 memory, 3 h), of past tips less the tip and past commands less the last one
    command : (3 h, 3 h), of the commands to come less the last one; none acts on what came before it
    left : (h,) median size of the error per axis in what it was fitted to
    """

    past: np.ndarray
    command: np.ndarray
    left: np.ndarray


def predict(traces: list[Trace], differences: np.ndarray, horizon: int) -> Prediction:
    """Return the linear prediction that fits what happened.

    Parameters
    ----------
    differences : (k, 3 horizon + 6 memory), see ``moving.differences``

    Raises
    ------
    ConfigError
        If episodes or traces are too short for a past and a future.
    """
    past, command, tip = (np.concatenate(rows) for rows in zip(*(_rows(t, differences, horizon) for t in traces), strict=True))
    of_past = np.zeros((past.shape[1], 3 * horizon))
    of_command, left = np.zeros((3 * horizon, 3 * horizon)), np.empty(horizon)
    for k in range(horizon):
        until, now = slice(0, 3 * k + 3), slice(3 * k, 3 * k + 3)
        found, left[k] = _robust(np.hstack([past, command[:, until]]), tip[:, now])
        of_past[:, now], of_command[until, now] = found[: past.shape[1]], found[past.shape[1] :]
    return Prediction(of_past, of_command, left)


def answer(prediction: Prediction, differences: np.ndarray, bend: float) -> np.ndarray:
    """Return the map (k, 3) from observations to actions that brings the predicted tips nearest to the targets.

    Parameters
    ----------
    bend : error of a tip that counts as much as a second difference of the commands, both as actions
    """
    targets = len(prediction.command)
    horizon, first = targets // 3, targets + len(prediction.past) // 2
    second = bend * np.kron(np.diff(np.eye(horizon + 2), n=2, axis=0), np.eye(3))
    # of the commands: the one before the last, the last (zero in differences from it), those to come
    inverse = np.linalg.pinv(np.vstack([prediction.command.T, second[:, 6:]]))[:3]
    gain = np.zeros((3, differences.shape[1]))
    gain[:, :targets] = inverse[:, :targets]
    gain[:, targets:] = -inverse[:, :targets] @ prediction.past.T
    gain[:, first : first + 3] -= inverse[:, targets:] @ second[:, :3]
    found = differences @ gain.T
    found[THETA] += np.eye(3)
    return np.asarray(found)


def _rows(trace: Trace, differences: np.ndarray, horizon: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return past (rows, 6 memory), commands to come (rows, 3 h) and tips to come (rows, 3 h), in differences."""
    seen, elapsed = trace
    steps, memory = max(len(seen) - horizon, 0), (differences.shape[1] - 3 * horizon) // 6
    # no episode ends on the way; a hidden force that came with its beginning is told by no past that was before it
    whole = (elapsed[horizon:] == elapsed[:steps] + horizon) & (elapsed[:steps] >= memory)
    if not whole.any():
        raise ConfigError(
            f"no step of training has stage.motion.memory_steps={memory} before it and stage.motion.horizon={horizon} after it "
            f"in one episode; expected agent.steps={len(seen)} and task.episode_steps above {memory + horizon}"
        )
    now = seen[:steps][whole]
    ahead = np.stack([seen[k : k + steps][whole] for k in range(1, horizon + 1)], axis=1)
    moved = [(ahead[:, :, part] - now[:, None, part]).reshape(len(now), -1) for part in (THETA, TIP)]
    return now @ differences[:, 3 * horizon :], moved[0], moved[1]


def _robust(inputs: np.ndarray, outputs: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the map (k, 3) from ``inputs`` to ``outputs`` by least squares with Huber's weights, and what it leaves."""
    size = inputs.std(axis=0) + 1e-12
    scaled, weight = inputs / size, np.ones(len(inputs))
    for _ in range(ROBUST_ROUNDS):
        weighted = weight[:, None] * scaled
        normal = weighted.T @ scaled
        normal[np.diag_indices_from(normal)] += RIDGE * len(scaled)
        found = np.linalg.solve(normal, weighted.T @ outputs)
        left = np.linalg.norm(scaled @ found - outputs, axis=1)
        usual = float(np.median(left))
        weight = np.minimum(1.0, ROBUST_SIZE * usual / np.maximum(left, 1e-12))
    return found / size[:, None], usual / 3**0.5
