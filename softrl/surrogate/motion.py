"""How the surrogate moves in PyBullet beside the reduced body that it was made of: answers to steps of pressure."""

import logging

import numpy as np

from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.surrogate import Surrogate
from softrl.core.errors import SolverError
from softrl.core.tracking import Tracker
from softrl.pod.rom import roll_poses, static_coordinates
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
STEPS, STEP_S, DT_S = 8, 0.5, 0.01  # pressures, and how long each of them is watched


def report_motion(s: Surrogate, robot: Robot, reduced_model: ReducedModel, tracker: Tracker) -> None:
    """Log how far the tip is from the reduced body's in the first half second after pressures are put on at rest.

    The pressures are held-out ones. Beside it stands a chain that is at its new rest at once.
    """
    from softrl.surrogate.simulator import SurrogateSimulator  # PyBullet starts slowly

    chain, errors = SurrogateSimulator(robot, s, 1.0, 1.0, 1.0), []
    time = DT_S * np.arange(1, round(STEP_S / DT_S) + 1)
    pressures = s.sample_pressure[s.heldout][:STEPS]
    for pressure, body in zip(pressures, body_steps(reduced_model, pressures, len(time), robot.gravity_m_s2), strict=True):
        try:
            moved = chain.simulate(time, np.tile(pressure, (len(time), 1))).position
        except SolverError as error:
            log.warning("one of the compared steps of pressure is not told: %s", error)
            continue
        there = chain.world.pose(chain.world.at_rest(chain.joint_targets(pressure)[0]))[0]
        errors.append([np.mean(np.sum((tip - body) ** 2, axis=1)) for tip in (moved, there)])
    chain.world.close()
    tracker.metric("heldout/steps_count", len(errors))
    if errors:
        for name, error in zip(("step_mm", "at_once_step_mm"), 1e3 * np.sqrt(np.mean(errors, axis=0)), strict=True):
            tracker.metric(f"heldout/{name}", float(error))


def body_steps(model: ReducedModel, pressure: np.ndarray, steps: int, gravity_m_s2: tuple[float, ...]) -> np.ndarray:
    """Return the reduced body's tips (S, steps, 3) m after ``pressure`` (S, n) Pa is put on at rest."""
    n, gravity = model.chambers, np.array(gravity_m_s2)
    loads = np.zeros((len(pressure), steps, n + 3))
    loads[:, :, :n] = pressure[:, None]
    start = np.repeat(static_coordinates(model, np.zeros((1, n + 3)), gravity), len(pressure), axis=0)
    # one by one: so few are as fast so, and what does many at once compiles for a minute
    return roll_poses(model, DT_S, loads, start, gravity_m_s2=gravity).coordinate[:, :, n:] + model.rest_tip
