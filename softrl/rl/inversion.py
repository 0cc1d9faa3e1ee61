"""Commands for targets that are known beforehand: a simulator with all its effects, inverted over the whole sequence.

What delays and distorts a motion (slow valves, creeping walls, the moving average, the slew) is in the simulation, so its
inverse asks for it in advance. The controllers on a robot and the expert of a policy's training both stand on it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.optimize import lsq_linear

from softrl.core.errors import ConfigError
from softrl.effects.chain import Plant
from softrl.rl.filter import moving_average
from softrl.robots.robot import Robot

SHARES = (1.0, 0.5, 0.25)  # of a correction, tried in this order
LEAST_GAIN = 0.02  # of the cost, for which another correction is worth its time
# tip positions (steps, 3) m -> what is compared with the targets, (steps, 3) m, by the simulation
Reading = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Inversion:
    """How commands are planned.

    Attributes
    ----------
    dt_s : step of the simulation, a part of the time between commands
    memory_steps : commands whose influence on a reading is linearised; older ones act through the simulation only
    probe_kpa : change of a command for the finite differences
    rounds, refinements : linearisations, and corrections with each of them
    smoothness_mm_per_kpa : reading error that counts as much as this bend of the command sequence (second difference)
    approach_weight : of the errors before the rollout counts
    """

    key: ClassVar[str] = "stage.motion.planning"  # where it stands in the configuration

    dt_s: float
    memory_steps: int
    probe_kpa: float
    rounds: int
    refinements: int
    smoothness_mm_per_kpa: float
    approach_weight: float

    def __post_init__(self) -> None:
        for name in (
            "dt_s", "memory_steps", "probe_kpa", "rounds", "refinements", "smoothness_mm_per_kpa", "approach_weight",
        ):  # fmt: skip
            if getattr(self, name) <= 0:
                raise ConfigError(f"{self.key}.{name}={getattr(self, name):g} must be positive")

    @property
    def bend_weight(self) -> float:
        """What a bend of the command sequence weighs, m per Pa."""
        return 1e-6 * self.smoothness_mm_per_kpa


@dataclass(frozen=True)
class Route:
    """What stands between a request and a reading: the moving average, the driver's slew, the plant.

    Attributes
    ----------
    robot, plant : the robot's limits; the simulator with its effects
    period_s : time between requests;  dt_s : step of the simulation
    average_window : requests in the moving average
    reading : of the tip at the end of each period
    """

    robot: Robot
    plant: Plant
    period_s: float
    dt_s: float
    average_window: int
    reading: Reading

    @property
    def hold(self) -> int:
        """Steps of the simulation in a period."""
        return max(round(self.period_s / self.dt_s), 1)

    @property
    def step_s(self) -> float:
        """The step of the simulation that fits into a period."""
        return self.period_s / self.hold

    def predict(self, request: np.ndarray, tip_force: np.ndarray | None = None) -> np.ndarray:
        """Return the readings (steps, 3) m at the ends of the periods of ``request`` (steps, n) Pa, from rest.

        One period without a request comes before, as in a rollout. ``tip_force`` (3,) N acts throughout.
        """
        last, blocks = np.zeros(self.robot.chambers), [np.zeros((self.hold, self.robot.chambers))]
        for wanted in moving_average(request, self.average_window):
            blocks.append(self.sent(last, wanted))
            last = blocks[-1][-1]
        command = np.concatenate(blocks)
        force = None if tip_force is None else np.tile(tip_force, (len(command), 1))
        motion = self.plant.simulate(self.step_s * np.arange(1, len(command) + 1), command, force)
        return self.reading(motion.position[2 * self.hold - 1 :: self.hold])

    def sent(self, last: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """Return the setpoints (hold, n) Pa on the way from ``last`` to ``wanted`` (n,), within range and slew.

        A vented robot whose range leaves out zero begins at the limit next to it, as drivers and programs do.
        """
        begun, goal = (np.clip(p, self.robot.pressure_min_pa, self.robot.pressure_max_pa) for p in (last, wanted))
        reach = self.robot.slew_pa_per_s * self.step_s * np.arange(1, self.hold + 1)[:, None]
        return np.asarray(begun + np.clip(goal - begun, -reach, reach))


@dataclass(frozen=True)
class Plan:
    """Requests with what they are expected to bring.

    Attributes
    ----------
    request : (steps, n) Pa, the approach included
    predicted, target : (steps, 3) m
    response : (steps, 3, memory, n) m/Pa, of a reading to the request ``j`` periods before, j = 0 .. memory - 1, of the even
        route if there is one, as last linearised: the corrections since then are small enough for a feedback
    """

    request: np.ndarray
    predicted: np.ndarray
    target: np.ndarray
    response: np.ndarray

    def effect(self, change: np.ndarray, k: int) -> np.ndarray:
        """Return what changes (steps, n) Pa of the requests add to reading ``k``, (3,) m."""
        past = np.arange(min(self.response.shape[2], k + 1))
        return np.asarray(np.einsum("ojc,jc->o", self.response[k][:, past], change[k - past]))

    def correction(self, at: int, left: np.ndarray, bend_weight: float) -> np.ndarray:
        """Return by how much (n,) Pa to change all requests from ``at`` on, to take ``left`` (ahead, 3) m away.

        Parameters
        ----------
        bend_weight : m per Pa of the change
        """
        memory, n = self.response.shape[2:]
        held = [self.response[at + i][:, : min(i + 1, memory)].sum(axis=1) for i in range(len(left))]
        stacked = np.vstack([*held, bend_weight * np.eye(n)])
        return np.asarray(np.linalg.lstsq(stacked, np.concatenate([-left.ravel(), np.zeros(n)]), rcond=None)[0])

    def renewed(self, sent: np.ndarray, shift: np.ndarray, bend_weight: float) -> np.ndarray:
        """Return the requests (ahead, n) Pa that come nearest to the next targets, whatever was sent before.

        Unlike ``correction`` it does not hold on to the plan, which serves to linearise about: what it returns follows from
        the state of the plant and the next targets alone.

        Parameters
        ----------
        sent : (at, n) Pa, the requests so far
        shift : (ahead, 3) m, what moves the readings besides
        bend_weight : m per Pa, of second differences, those with the last requests included
        """
        (at, n), ahead = sent.shape, len(shift)
        change = np.zeros_like(self.request)
        change[:at] = sent - self.request[:at]
        matrix, right = np.zeros((3 * ahead, ahead * n)), np.empty(3 * ahead)
        for i in range(ahead):
            rows = slice(3 * i, 3 * i + 3)
            right[rows] = (self.target - self.predicted)[at + i] - shift[i] - self.effect(change, at + i)
            for j in range(min(i + 1, self.response.shape[2])):
                columns = slice((i - j) * n, (i - j + 1) * n)
                matrix[rows, columns] = self.response[at + i][:, j]
                right[rows] += self.response[at + i][:, j] @ self.request[at + i - j]
        past = np.concatenate([np.zeros((2, n)), sent])[-2:]
        bend = bend_weight * np.diff(np.eye(ahead + 2), n=2, axis=0)
        rows = np.concatenate([right, -(bend[:, :2] @ past).ravel()])
        found = np.linalg.lstsq(np.vstack([matrix, np.kron(bend[:, 2:], np.eye(n))]), rows, rcond=None)[0]
        return np.asarray(found.reshape(ahead, n))


def plan(
    route: Route, target: np.ndarray, start: np.ndarray, approach: int, settings: Inversion, even: Route | None = None
) -> Plan:
    """Return the requests that bring the readings to ``target`` (steps, 3) m, the first of them ``approach`` periods early.

    Parameters
    ----------
    start : (steps, n) Pa, a first guess: the static inverse
    even : a route that answers to small changes as to large ones, linearised before ``route`` itself: its slopes lead past
        where that sticks or lets go, from where its own lead on
    """
    ahead = np.concatenate([np.zeros(approach, dtype=int), np.arange(len(target))])
    wanted, request = target[ahead], start[ahead]
    weight = np.where(np.arange(len(wanted)) < approach, settings.approach_weight, 1.0)
    predicted = route.predict(request)
    ways, response = (route,) if even is None else (even, route), {}
    for way in ways * settings.rounds:
        slopes = linearise(way, request, predicted if way is route else way.predict(request), settings)
        response[way is route] = slopes
        for _ in range(settings.refinements):
            turn = _correction(route.robot, request, predicted - wanted, slopes, weight, settings)
            least = (1.0 - LEAST_GAIN) * _cost(request, predicted - wanted, weight, settings)
            trials = ((trial, route.predict(trial)) for trial in (request + share * turn for share in SHARES))
            better = next((t for t in trials if _cost(t[0], t[1] - wanted, weight, settings) < least), None)
            if better is None:
                break
            request, predicted = better
    return Plan(request, predicted, wanted, response[even is None])


def linearise(route: Route, request: np.ndarray, predicted: np.ndarray, settings: Inversion) -> np.ndarray:
    """Return the response (steps, 3, memory, n) m/Pa of the readings to the requests before them.

    Requests ``memory_steps`` apart are changed together: each reading then answers to the last of them. They are changed
    towards no pressure, or away from it where that is beyond an end of the range: nothing is sent there.
    """
    (steps, n), memory, probe = request.shape, settings.memory_steps, 1e3 * settings.probe_kpa
    low, high = route.robot.pressure_min_pa, route.robot.pressure_max_pa
    nudge = np.where(request > 0.0, -probe, probe)
    nudge = np.where((request + nudge < low) | (request + nudge > high), -nudge, nudge)
    response = np.zeros((steps, 3, memory, n))
    for chamber in range(n):
        for first in range(memory):
            changed = request.copy()
            changed[first::memory, chamber] += nudge[first::memory, chamber]
            size = nudge[:, chamber]
            moved = route.predict(changed) - predicted
            for k in range(first, steps):
                j = (k - first) % memory
                response[k, :, j, chamber] = moved[k] / size[k - j]
    return response


def _correction(
    robot: Robot, request: np.ndarray, error: np.ndarray, response: np.ndarray, weight: np.ndarray, settings: Inversion
) -> np.ndarray:
    """Return the change (steps, n) Pa of the requests that takes ``error`` (steps, 3) m away within the range."""
    steps, n = request.shape
    slope = np.zeros((steps, 3, steps, n))
    for j in range(response.shape[2]):
        later = np.arange(j, steps)
        slope[later, :, later - j] = response[later, :, j]
    bend = np.kron(_second_difference(steps), np.eye(n)) * settings.bend_weight
    matrix = np.vstack([(weight[:, None, None, None] * slope).reshape(3 * steps, steps * n), bend])
    right = np.concatenate([-(weight[:, None] * error).ravel(), -bend @ request.ravel()])
    # in kPa, so that the solver's tolerances mean something
    low, high = ((limit - request.ravel()) / 1e3 for limit in (robot.pressure_min_pa, robot.pressure_max_pa))
    found = lsq_linear(1e6 * matrix, 1e3 * right, (np.minimum(low, -1e-9), np.maximum(high, 1e-9)), method="trf")
    return np.asarray(1e3 * found.x.reshape(steps, n))


def _cost(request: np.ndarray, error: np.ndarray, weight: np.ndarray, settings: Inversion) -> float:
    bend = settings.bend_weight * np.diff(request, n=2, axis=0)
    return float(np.sum((weight[:, None] * error) ** 2) + np.sum(bend**2))


def _second_difference(steps: int) -> np.ndarray:
    return np.diff(np.eye(steps), n=2, axis=0)
