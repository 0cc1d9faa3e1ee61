"""The policy on the robot: rollouts of shapes, and sessions that a diagnosis can learn from."""

import logging
from dataclasses import dataclass

import numpy as np

from softrl.artifacts.calibration import Calibration
from softrl.artifacts.policy import Policy
from softrl.artifacts.surrogate import Surrogate
from softrl.core.driver import Driver
from softrl.core.errors import ConfigError
from softrl.core.progress import progress
from softrl.core.simulator import Simulator
from softrl.core.tracking import Tracker
from softrl.effects.chain import EffectChain, Plant
from softrl.recordings.recording import RecordingSet
from softrl.rl.tasks.curves import CURVES
from softrl.rl.workspace import Workspace
from softrl.robots.robot import Robot
from softrl.sim2real.controllers import Models, controllers
from softrl.sim2real.figures import draw_rollouts, draw_session
from softrl.sim2real.filter import moving_average
from softrl.sim2real.identification import Identification, record_sessions
from softrl.sim2real.planning import Planning
from softrl.sim2real.rollout import Pace, Rollout, follow

log = logging.getLogger(__name__)
SHAPES = ("circle", "star", "figure_eight")
RUN_NOTES = {
    "policy": "policy on the tip's position, through the surrogate's joints and the pressure calibration",
    "open_loop": "inverse of the surrogate without feedback and without the pressure calibration",
    "feedforward": "commands planned for the whole sequence by inverting a simulator, without feedback",
    "planned": "the same commands, corrected by the tip's position as it comes in",
    "identification": "program sent directly: steps, multisine, triangles at several rates, staircase; rests between",
}


@dataclass(frozen=True)
class Config:
    """Rollouts and identification sessions on a robot.

    Attributes
    ----------
    command_rate_hz : rate at which rollouts send pressures
    average_window : commands in the moving average before the driver
    shape_steps : targets along one shape
    radius_share : size of the shapes in the largest that the tip can reach
    approach_steps : commands at the first target before a rollout counts
    planning : of the controllers that invert the simulator
    identification : the programs sent directly
    seed : of the programs; the driver's noise has its own
    """

    command_rate_hz: float
    average_window: int
    shape_steps: int
    radius_share: float
    approach_steps: int
    planning: Planning
    identification: Identification
    seed: int

    def __post_init__(self) -> None:
        for name in ("command_rate_hz", "average_window", "shape_steps"):
            if getattr(self, name) <= 0:
                raise ConfigError(f"stage.{name}={getattr(self, name):g} must be positive")
        if not 0.0 < self.radius_share <= 1.0:
            raise ConfigError(f"stage.radius_share={self.radius_share:g}; expected a share above 0 and at most 1")
        if self.approach_steps < 0:
            raise ConfigError(f"stage.approach_steps={self.approach_steps} must not be negative")


def run(
    config: Config,
    robot: Robot,
    policy: Policy,
    surrogate: Surrogate,
    calibration: Calibration,
    simulator: Simulator,
    effects: EffectChain,
    driver: Driver,
    *,
    tracker: Tracker,
) -> RecordingSet:
    """Return all that was recorded while controllers followed shapes and while programs were sent directly.

    ``effects``, with the parameters of ``simulator``, are what a diagnosis found: the planned controllers invert them.
    """
    if policy.task_name != "track":
        raise ConfigError(
            f"the policy was trained for task={policy.task_name}, but shapes are followed in free space here; "
            "run stage=rl task=track"
        )
    models = Models(robot, policy, surrogate, calibration, Plant(simulator, effects))
    targets = _targets(config, Workspace(surrogate))
    rollouts = {
        shape: _follow_shape(config, models, driver, shape, targets[shape]) for shape in progress(SHAPES, "rollouts")
    }
    sessions = list(
        progress(
            record_sessions(driver, robot, config.identification, np.random.default_rng(config.seed)),
            "identification", config.identification.sessions,
        )
    )  # fmt: skip
    _report(rollouts, config.average_window, tracker)
    tracker.figure("rollouts", draw_rollouts(rollouts))
    tracker.figure("identification", draw_session(sessions[0]))
    recordings = (*(r.recording for runs in rollouts.values() for r in runs.values()), *sessions)
    tracker.metric("samples", sum(len(r.time) for r in recordings))
    tracker.metric("recorded_s", sum(float(np.ptp(r.time)) for r in recordings))
    notes = {r.name: next(text for kind, text in RUN_NOTES.items() if kind in r.name) for r in recordings}
    return RecordingSet(robot_name=robot.name, recordings=recordings, notes={"run_notes": notes})


def _targets(config: Config, space: Workspace) -> dict[str, np.ndarray]:
    """Return the shapes (steps, 3) m about the centre of what the tip can reach."""
    unit = {shape: CURVES[shape](config.shape_steps) for shape in SHAPES}
    return {
        shape: space.centre + config.radius_share * space.largest(points, space.centre) * points
        for shape, points in unit.items()
    }


def _follow_shape(
    config: Config, models: Models, driver: Driver, shape: str, target: np.ndarray
) -> dict[str, Rollout]:
    """Return the rollouts of one shape by controller; each starts from rest, all belong to one session."""
    pace = Pace(1.0 / config.command_rate_hz, config.average_window, config.approach_steps)
    return {
        name: follow(driver, models.robot, controller, target, pace, f"{shape}_{name}", shape)
        for name, controller in controllers(models, config.planning, pace, target).items()
    }


def _report(rollouts: dict[str, dict[str, Rollout]], window: int, tracker: Tracker) -> None:
    """Log each shape's error beside those of the other controllers, and against what the moving average asked for."""
    for shape, runs in rollouts.items():
        averaged = moving_average(runs["policy"].target, window)
        for controller, rollout in runs.items():
            name = shape if controller == "policy" else f"{shape}_{controller}"
            tracker.metric(f"{name}_mm", 1e3 * rollout.error_m(rollout.target))
            log.info("%s, %s: %.2f mm rms", shape, controller, 1e3 * rollout.error_m(rollout.target))
        tracker.metric(f"{shape}_to_average_mm", 1e3 * runs["policy"].error_m(averaged))
    for controller, name in (("policy", "inference_hz"), ("planned", "planned_inference_hz")):
        decisions = np.concatenate([runs[controller].decision_s for runs in rollouts.values()])
        tracker.metric(name, 1.0 / float(np.mean(decisions)))
