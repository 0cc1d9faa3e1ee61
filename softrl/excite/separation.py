"""How far two hypotheses are apart under a program, after each was allowed to change its parameters."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from softrl.core.errors import SolverError
from softrl.core.simulator import Motion
from softrl.effects.chain import Plant, simulate_batch
from softrl.effects.replay import bend_angle
from softrl.excite.rival import Rival
from softrl.robots.robot import Robot

STEP = 0.02  # of a scaled parameter, for differences


@dataclass(frozen=True)
class Sensing:
    """What is compared.

    Attributes
    ----------
    dt_s : step of the simulation
    sample_s : time between samples whose noise is independent
    position_noise_m : standard deviation of each coordinate of the tip; of an angle-only robot, arc length
    pressure_noise_pa : of each measured chamber pressure, or None if none is measured
    """

    dt_s: float
    sample_s: float
    position_noise_m: float
    pressure_noise_pa: float | None

    def seen(self, robot: Robot, motion: Motion) -> np.ndarray:
        """Return the sampled channels (samples, channels) in standard deviations of their noise."""
        stride = max(round(self.sample_s / self.dt_s), 1)
        if robot.output == "bend_angle":
            moved = robot.length_m * bend_angle(robot, motion.quaternion)[:, None]
        else:
            moved = motion.position
        channels = [moved / self.position_noise_m]
        if self.pressure_noise_pa is not None:
            channels.append(motion.pressure / self.pressure_noise_pa)
        whole = len(moved) // stride * stride
        means = np.hstack(channels)[:whole].reshape(whole // stride, stride, -1).mean(axis=1)
        return np.asarray(means)


@dataclass(frozen=True)
class Tangent:
    """A rival's response to one program and how its parameters change it: rows (n,) and Jacobian (n, p)."""

    response: np.ndarray
    jacobian: np.ndarray


def responses(plants: list[Plant], pressure: np.ndarray, sensing: Sensing) -> list[np.ndarray]:
    """Return the flat response (n,) of each plant to ``pressure`` (steps, chambers) Pa, in noise units."""
    time = sensing.dt_s * np.arange(1, len(pressure) + 1)
    made = simulate_batch(plants, time, pressure)
    seen = [sensing.seen(plants[0].chain.robot, motion).ravel() for motion in made]
    if not all(np.isfinite(rows).all() for rows in seen):
        raise SolverError("a response did not stay finite; try a smaller stage.sensing.dt_s")
    return seen


def tangent(rival: Rival, point: np.ndarray, pressure: np.ndarray, sensing: Sensing) -> Tangent:
    """Return response and Jacobian of a rival at a scaled ``point`` (p,)."""
    low, high = rival.bounds
    steps = np.where(point + STEP <= high, STEP, -STEP)
    moved = [np.clip(point + step * np.eye(len(point))[k], low, high) for k, step in enumerate(steps)]
    base, *others = responses([rival.at(p) for p in (point, *moved)], pressure, sensing)
    columns = [(rows - base) / step for rows, step in zip(others, steps, strict=True)]
    return Tangent(base, np.stack(columns, axis=1) if columns else np.zeros((len(base), 0)))


def refitted(rival: Rival, start: np.ndarray, target: np.ndarray, pressure: np.ndarray, sensing: Sensing,
             evaluations: int) -> tuple[np.ndarray, float]:  # fmt: skip
    """Return the scaled point (p,) at which a rival comes closest to ``target`` (n,), and the distance left, in sigma.

    Bounded least squares from ``start``. A weak pull towards it (one unit of noise per unit of a scaled parameter)
    keeps directions that nothing determines where they are.
    """

    def residual(point: np.ndarray) -> np.ndarray:
        rows = responses([rival.at(point)], pressure, sensing)[0] - target
        return np.concatenate([rows, point - start])

    def jacobian(point: np.ndarray) -> np.ndarray:
        return np.vstack([tangent(rival, point, pressure, sensing).jacobian, np.eye(len(start))])

    low, high = rival.bounds
    margin = 1e-6 * np.maximum(high - low, 1e-6)
    inside = np.clip(start, low + margin, high - margin)
    if len(start) == 0:
        return start, float(np.linalg.norm(residual(start)))
    found = least_squares(residual, inside, jacobian, (low, high), max_nfev=evaluations, ftol=1e-4, xtol=1e-4)
    return found.x, float(np.linalg.norm(found.fun[: len(target)]))


@dataclass(frozen=True)
class Normal:
    """Sums over samples from which the distance to a tangent space follows; sums of programs add up.

    Attributes
    ----------
    square : squared difference of the responses
    slope : (p,) Jacobian's product with the difference
    matrix : (p, p) the Jacobian's square
    """

    square: float
    slope: np.ndarray
    matrix: np.ndarray

    def __add__(self, other: "Normal") -> "Normal":
        return Normal(self.square + other.square, self.slope + other.slope, self.matrix + other.matrix)

    def distance(self) -> float:
        """Return the distance in sigma that is left after the best change of the parameters.

        Notes
        -----
        ``min over d of |r - J d|^2 + |d|^2``: a scaled parameter that moves by one costs as much as one unit of noise,
        which keeps the linear search within reach (the T-criterion of Atkinson and Fedorov with the rival linearised;
        no equation number checked).
        """
        matrix = self.matrix + np.eye(len(self.slope))
        left = self.square - float(self.slope @ np.linalg.solve(matrix, self.slope))
        return float(np.sqrt(max(left, 0.0)))


def normal(truth: np.ndarray, rival: Tangent) -> Normal:
    """Return the sums for the response (n,) of one hypothesis against the tangent space of another."""
    gap = truth - rival.response
    return Normal(float(gap @ gap), rival.jacobian.T @ gap, rival.jacobian.T @ rival.jacobian)
