"""Commands for targets that are known beforehand: a simulator with all its effects, inverted over the whole sequence.

What delays and distorts a motion (slow valves, creeping walls, the moving average, the slew) is in the simulation, so its
inverse asks for it in advance. Feedback then takes away what the simulation does not know.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from softrl.core.driver import Sample
from softrl.core.errors import ConfigError
from softrl.effects.chain import Plant
from softrl.robots.robot import Robot
from softrl.sim2real.filter import moving_average
from softrl.sim2real.watch import LineWatch, Watch

log = logging.getLogger(__name__)

# tip positions (steps, 3) m -> what is compared with the targets, (steps, 3) m, by the simulation
Reading = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Planning:
    """How commands are planned and corrected.

    Attributes
    ----------
    dt_s : step of the simulation, a part of the time between commands
    memory_steps : commands whose influence on a reading is linearised; older ones act through the simulation only
    probe_kpa : change of a command for the finite differences
    rounds, refinements : linearisations, and corrections with each of them
    smoothness_mm_per_kpa : reading error that counts as much as this bend of the command sequence (second difference)
    approach_weight : of the errors before the rollout counts
    feedback : share of a new misfit between prediction and reading that is taken as lasting, 0..1
    horizon_steps : commands over which a misfit is taken away
    watch : of the air lines; what a broken one does is not taken as lasting
    """

    dt_s: float
    memory_steps: int
    probe_kpa: float
    rounds: int
    refinements: int
    smoothness_mm_per_kpa: float
    approach_weight: float
    feedback: float
    horizon_steps: int
    watch: Watch

    def __post_init__(self) -> None:
        for name in (
            "dt_s", "memory_steps", "probe_kpa", "rounds", "refinements", "smoothness_mm_per_kpa", "approach_weight",
            "horizon_steps",
        ):  # fmt: skip
            if getattr(self, name) <= 0:
                raise ConfigError(f"stage.planning.{name}={getattr(self, name):g} must be positive")
        if not 0.0 <= self.feedback <= 1.0:
            raise ConfigError(f"stage.planning.feedback={self.feedback:g}; expected a share between 0 and 1")


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

    def predict(self, request: np.ndarray) -> np.ndarray:
        """Return the readings (steps, 3) m at the ends of the periods of ``request`` (steps, n) Pa, from rest.

        One period without a request comes before, as in a rollout.
        """
        hold = max(round(self.period_s / self.dt_s), 1)
        dt_s = self.period_s / hold
        sent = self._sent(moving_average(request, self.average_window), hold, dt_s)
        command = np.concatenate([np.zeros((hold, self.robot.chambers)), sent])
        motion = self.plant.simulate(dt_s * np.arange(1, len(command) + 1), command)
        return self.reading(motion.position[2 * hold - 1 :: hold])

    def _sent(self, wanted: np.ndarray, hold: int, dt_s: float) -> np.ndarray:
        """Return the setpoints (steps * hold, n) Pa on the way to each row of ``wanted``, within range and slew."""
        goals = np.clip(wanted, self.robot.pressure_min_pa, self.robot.pressure_max_pa)
        reach = self.robot.slew_pa_per_s * dt_s * np.arange(1, hold + 1)[:, None]
        last, blocks = np.zeros(self.robot.chambers), []
        for goal in goals:
            blocks.append(last + np.clip(goal - last, -reach, reach))
            last = blocks[-1][-1]
        return np.concatenate(blocks)


@dataclass(frozen=True)
class Plan:
    """Requests with what they are expected to bring.

    Attributes
    ----------
    request : (steps, n) Pa, the approach included
    predicted, target : (steps, 3) m
    response : (steps, 3, memory, n) m/Pa, of a reading to the request ``j`` periods before, j = 0 .. memory - 1, as last
        linearised: the corrections since then are small enough for a feedback
    """

    request: np.ndarray
    predicted: np.ndarray
    target: np.ndarray
    response: np.ndarray


def plan(route: Route, target: np.ndarray, start: np.ndarray, approach: int, settings: Planning) -> Plan:
    """Return the requests that bring the readings to ``target`` (steps, 3) m, the first of them ``approach`` periods early.

    Parameters
    ----------
    start : (steps, n) Pa, a first guess: the static inverse
    """
    ahead = np.concatenate([np.zeros(approach, dtype=int), np.arange(len(target))])
    wanted, request = target[ahead], start[ahead]
    weight = np.where(np.arange(len(wanted)) < approach, settings.approach_weight, 1.0)
    predicted = route.predict(request)
    for _ in range(settings.rounds):
        response = linearise(route, request, predicted, settings)
        for _ in range(settings.refinements):
            trial = request + _correction(route.robot, request, predicted - wanted, response, weight, settings)
            trial_predicted = route.predict(trial)
            if _cost(trial, trial_predicted - wanted, weight, settings) >= _cost(
                request, predicted - wanted, weight, settings
            ):
                break
            request, predicted = trial, trial_predicted
    left_mm = 1e3 * np.sqrt(np.mean(np.sum((predicted - wanted)[approach:] ** 2, axis=1)))
    log.info("plan: %.3f mm rms from the targets in the simulation", left_mm)
    return Plan(request, predicted, wanted, response)


def linearise(route: Route, request: np.ndarray, predicted: np.ndarray, settings: Planning) -> np.ndarray:
    """Return the response (steps, 3, memory, n) m/Pa of the readings to the requests before them.

    Requests ``memory_steps`` apart are changed together: each reading then answers to the last of them.
    """
    (steps, n), memory, probe = request.shape, settings.memory_steps, 1e3 * settings.probe_kpa
    response = np.zeros((steps, 3, memory, n))
    for chamber in range(n):
        for first in range(memory):
            changed = request.copy()
            changed[first::memory, chamber] -= probe * np.where(changed[first::memory, chamber] > 0.0, 1.0, -1.0)
            size = (changed - request)[:, chamber]
            moved = route.predict(changed) - predicted
            for k in range(first, steps):
                j = (k - first) % memory
                response[k, :, j, chamber] = moved[k] / size[k - j]
    return response


def _correction(
    robot: Robot, request: np.ndarray, error: np.ndarray, response: np.ndarray, weight: np.ndarray, settings: Planning
) -> np.ndarray:
    """Return the change (steps, n) Pa of the requests that takes ``error`` (steps, 3) m away within the range."""
    steps, n = request.shape
    slope = np.zeros((steps, 3, steps, n))
    for j in range(response.shape[2]):
        later = np.arange(j, steps)
        slope[later, :, later - j] = response[later, :, j]
    bend = np.kron(_second_difference(steps), np.eye(n)) * _bend_weight(settings)
    matrix = np.vstack([(weight[:, None, None, None] * slope).reshape(3 * steps, steps * n), bend])
    right = np.concatenate([-(weight[:, None] * error).ravel(), -bend @ request.ravel()])
    # in kPa, so that the solver's tolerances mean something
    low, high = ((limit - request.ravel()) / 1e3 for limit in (robot.pressure_min_pa, robot.pressure_max_pa))
    found = lsq_linear(1e6 * matrix, 1e3 * right, (np.minimum(low, -1e-9), np.maximum(high, 1e-9)), method="trf")
    return np.asarray(1e3 * found.x.reshape(steps, n))


def _cost(request: np.ndarray, error: np.ndarray, weight: np.ndarray, settings: Planning) -> float:
    bend = _bend_weight(settings) * np.diff(request, n=2, axis=0)
    return float(np.sum((weight[:, None] * error) ** 2) + np.sum(bend**2))


def _bend_weight(settings: Planning) -> float:
    """Return m per Pa."""
    return 1e-6 * settings.smoothness_mm_per_kpa


def _second_difference(steps: int) -> np.ndarray:
    return np.diff(np.eye(steps), n=2, axis=0)


class PlannedController:
    """Sends a plan; a misfit between reading and prediction is taken as lasting and taken away by the commands to come.

    While an air line is broken, and until the tip has forgotten it, the misfit learnt before is kept: commands that make up
    for a line that is off would throw the tip far out once it is back on. What the fault leaves behind, in walls that creep
    and remember, has nothing to do with the misfit before: the first readings after it are taken as lasting wholly.

    Parameters
    ----------
    prepared : the plan, whose first ``approach`` steps come before step 0
    read : reading (3,) m from the tip's position (3,) m and the force on it (3,) N
    """

    def __init__(
        self, prepared: Plan, approach: int, settings: Planning, robot: Robot,
        read: Callable[[np.ndarray, np.ndarray | None], np.ndarray],
    ) -> None:
        self._plan, self._approach, self._settings, self._robot, self._read = prepared, approach, settings, robot, read
        self._change = np.zeros_like(prepared.request)
        self._lasting = np.zeros(3)
        self._lines = LineWatch(settings.watch)
        self._afresh = 0

    def watch(self, arrived: Sequence[Sample], step: int) -> None:
        """Take in the samples of the period before the command of ``step``; in the approach the robot counts as whole."""
        trusted = self._lines.trusted
        self._lines.advance(arrived, healthy=step <= 0)
        if trusted and not self._lines.trusted:
            log.info("step %d: an air line is off", step)
        if self._lines.trusted and not trusted:
            log.info("step %d: all air lines are on again", step)
            self._afresh = self._settings.watch.afresh_steps

    def pressure(self, position: np.ndarray, step: int, tip_force: np.ndarray | None = None) -> np.ndarray:
        """Return (n,) Pa for the target of ``step`` (negative in the approach), the tip being at ``position`` (3,) m."""
        at = step + self._approach
        if at > 0 and self._settings.feedback > 0.0:
            if self._lines.trusted:
                self._observe(at - 1, self._read(position, tip_force))
            self._correct(at)
        return np.asarray(self._plan.request[at] + self._change[at])

    def _observe(self, k: int, reading: np.ndarray) -> None:
        expected = self._plan.predicted[k] + self._effect(k)
        share = 1.0 if self._afresh > 0 else self._settings.feedback
        self._afresh = max(self._afresh - 1, 0)
        self._lasting += share * (reading - expected - self._lasting)

    def _effect(self, k: int) -> np.ndarray:
        """Return what the changes so far add to reading ``k``, (3,) m."""
        past = np.arange(min(self._plan.response.shape[2], k + 1))
        return np.asarray(np.einsum("ojc,jc->o", self._plan.response[k][:, past], self._change[k - past]))

    def _correct(self, at: int) -> None:
        """Choose the changes from ``at`` on; those beyond the horizon keep the last one's value."""
        change, response = self._change, self._plan.response
        steps, n = change.shape
        ahead = min(self._settings.horizon_steps, steps - at)
        # changes are counted from the last one sent, so that a lasting misfit keeps its correction
        change[at:] = change[at - 1]
        matrix, right = np.zeros((3 * ahead, ahead * n)), np.empty(3 * ahead)
        for i in range(ahead):
            rows = slice(3 * i, 3 * i + 3)
            right[rows] = -self._lasting - self._effect(at + i)
            for j in range(min(i + 1, response.shape[2])):
                matrix[rows, (i - j) * n : (i - j + 1) * n] = response[at + i][:, j]
        bend = _bend_weight(self._settings) * np.kron(np.diff(np.eye(ahead + 1), axis=0)[:, 1:], np.eye(n))
        found = np.linalg.lstsq(np.vstack([matrix, bend]), np.concatenate([right, np.zeros(ahead * n)]), rcond=None)[0]
        request = self._plan.request[at : at + ahead] + change[at : at + ahead] + found.reshape(ahead, n)
        # a correction never asks for more than the robot may have, or it would wind up
        request = np.clip(request, self._robot.pressure_min_pa, self._robot.pressure_max_pa)
        change[at : at + ahead] = request - self._plan.request[at : at + ahead]
        change[at + ahead :] = change[at + ahead - 1]
