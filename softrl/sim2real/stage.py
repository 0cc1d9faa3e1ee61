"""The policy on the robot: rollouts of its task, and sessions that a diagnosis can learn from."""

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
from softrl.recordings.keep import keeping
from softrl.recordings.recording import Recording, RecordingSet
from softrl.rl.workspace import Workspace
from softrl.robots.robot import Robot
from softrl.sim2real.bandwidth import Bandwidth, measure, predict
from softrl.sim2real.controllers import Models
from softrl.sim2real.course import courses, task_of
from softrl.sim2real.disturbance import Breakable, Disturbance
from softrl.sim2real.figures import draw_bandwidth, draw_recovery, draw_rollouts, draw_session
from softrl.sim2real.identification import Identification, record_sessions
from softrl.sim2real.planning import Planning
from softrl.sim2real.report import report_bandwidth, report_recovery, report_rollouts
from softrl.sim2real.rollout import Pace, Rollout
from softrl.sim2real.trial import LINE_OFF, Trial, mount

log = logging.getLogger(__name__)
STREAM = 7102  # keeps these programs, and the noise of a rig, apart from those of stage=calibration with the same seed
RUN_NOTES = {
    "policy": "policy on the tip's position, through the surrogate's joints and the pressure calibration",
    "open_loop": "inverse of the surrogate without feedback and without the pressure calibration",
    "feedforward": "commands planned for the whole sequence by inverting a simulator, without feedback",
    "planned": "the same commands, corrected by the tip's position as it comes in",
    "identification": "program sent directly: steps, multisine, triangles at several rates, staircase; rests between",
    "bandwidth": "program sent directly: tones of one chamber, from slow to fast",
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
    disturbance : an air line is pulled off, if the driver lets it; in free space only
    bandwidth : tones of one chamber; in free space only
    identification : the programs sent directly; in free space only
    seed : of the programs; the driver's noise has its own
    """

    command_rate_hz: float
    average_window: int
    shape_steps: int
    radius_share: float
    approach_steps: int
    planning: Planning
    disturbance: Disturbance
    bandwidth: Bandwidth
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

    @property
    def pace(self) -> Pace:
        """How a rollout runs."""
        return Pace(1.0 / self.command_rate_hz, self.average_window, self.approach_steps)


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
    """Return all that was recorded while controllers followed courses and while programs were sent directly.

    ``effects``, with the parameters of ``simulator``, are what a diagnosis found: the planned controllers invert them. The
    courses are those of the task that the policy was trained for.
    """
    surrogate.require_robot(robot.name, robot.gravity_m_s2)
    _require_pace(config, policy)
    task = task_of(policy, config.shape_steps, config.radius_share)
    models = Models(robot, policy, Workspace(surrogate), task, calibration, Plant(simulator, effects))
    trial = Trial(models, driver, config.planning, config.pace)
    if models.surface is None:
        _require_fit(config, robot, task.curves, driver)
    else:
        task.check_forces(robot.tip_force_max_n, models.space)  # of the robot at hand, not the one that was trained for
    mount(driver, models)
    recordings: list[Recording] = []
    with keeping(recordings, driver, robot, tracker):
        rollouts: dict[str, dict[str, Rollout]] = {}
        for course in progress(list(courses(task, models.space)), "rollouts"):
            rollouts[course.name] = {}
            for name, rollout in trial.follow(course):
                rollouts[course.name][name] = rollout
                recordings.append(rollout.recording)
        if models.surface is None:
            _disturb(config, trial, recordings, tracker)
            _sweep(config, models, driver, recordings, tracker)
            _identify(config, driver, robot, recordings, tracker)
        # within the block: whatever is wrong with a session at a robot is found out while its recordings are kept
        made = _recorded(robot, recordings)
        made.validate()
        report_rollouts(rollouts, config.average_window, tracker)
        tracker.figure("rollouts", draw_rollouts(rollouts))
        tracker.metric("samples", sum(len(r.time) for r in recordings))
        tracker.metric("recorded_s", sum(float(np.ptp(r.time)) for r in recordings))
    return made


def _recorded(robot: Robot, recordings: list[Recording]) -> RecordingSet:
    """Return the recordings with what each run was, and which were disturbed."""
    notes = {r.name: next(text for kind, text in RUN_NOTES.items() if kind in r.name) for r in recordings}
    disturbed = [r.name for r in recordings if r.session.endswith(LINE_OFF)]
    return RecordingSet(
        robot_name=robot.name, recordings=tuple(recordings), notes={"run_notes": notes, "disturbed": disturbed}
    )


def _require_pace(config: Config, policy: Policy) -> None:
    """Refuse a policy that learnt in motion at another pace."""
    if not policy.memory:
        return
    learnt, asked = (policy.step_s, policy.average_window), (config.pace.period_s, config.average_window)
    if abs(learnt[0] - asked[0]) > 1e-9 or learnt[1] != asked[1]:
        raise ConfigError(
            f"the policy learnt in motion at {1.0 / learnt[0]:g} Hz behind a moving average of {learnt[1]}, but "
            f"stage.command_rate_hz={config.command_rate_hz:g}, stage.average_window={asked[1]}; take its own, or train "
            "with stage=rl task.step_s=.. stage.motion.average_window=.."
        )
    log.info("the policy learnt in motion; effects of its simulator: %s", ", ".join(policy.effects) or "none")


def _require_fit(config: Config, robot: Robot, curves: tuple[str, ...], driver: Driver) -> None:
    """Refuse, before anything moves, what would be found out late in the session only."""
    config.bandwidth.require_fit(robot)
    cut = config.disturbance
    if not isinstance(driver, Breakable):
        return
    if cut.course not in curves:
        raise ConfigError(f"stage.disturbance.course={cut.course} is unknown; expected one of {', '.join(curves)}")
    if not 0 <= cut.chamber < robot.chambers:
        raise ConfigError(f"stage.disturbance.chamber={cut.chamber}; expected 0 to {robot.chambers - 1}")
    cut.steps(config.shape_steps, config.pace.period_s)


def _disturb(config: Config, trial: Trial, recordings: list[Recording], tracker: Tracker) -> None:
    """Roll out with an air line off for a while."""
    if not isinstance(trial.driver, Breakable):
        log.info("no rollout with an air line off: this driver cannot pull one")
        return
    rollouts = {}
    for name, rollout in trial.disturbed(config.disturbance):
        rollouts[name] = rollout
        recordings.append(rollout.recording)
    report_recovery(rollouts, config.disturbance, config.pace.period_s, tracker)
    tracker.figure("recovery", draw_recovery(rollouts, config.disturbance, config.pace.period_s))


def _sweep(config: Config, models: Models, driver: Driver, recordings: list[Recording], tracker: Tracker) -> None:
    """Measure the bandwidth beside what the simulator says of it."""
    recording, measured = measure(driver, models.robot, config.bandwidth)
    recordings.append(recording)
    predicted = predict(models.robot, models.plant, config.bandwidth)
    report_bandwidth(measured, predicted, tracker)
    tracker.figure("bandwidth", draw_bandwidth(measured, predicted))


def _identify(config: Config, driver: Driver, robot: Robot, recordings: list[Recording], tracker: Tracker) -> None:
    """Record the sessions for a diagnosis."""
    sessions = record_sessions(driver, robot, config.identification, np.random.default_rng([config.seed, STREAM]))
    for number, session in enumerate(progress(sessions, "identification", config.identification.sessions)):
        recordings.append(session)
        if number == 0:
            tracker.figure("identification", draw_session(session))
